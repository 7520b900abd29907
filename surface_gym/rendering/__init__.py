"""Drawing: a `Scene` or a `FlowScene` in, a picture out. Only this package imports pygame."""

import os

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # standard output belongs to the caller

from surface_gym.rendering.caption import with_caption
from surface_gym.rendering.flow_painter import FlowPainter, draw_flow
from surface_gym.rendering.flow_scene import ExitMark, FlowParcel, FlowScene
from surface_gym.rendering.painter import Painter, draw
from surface_gym.rendering.scene import ExitSide, ExitSpeed, Goal, Heading, Path, Scene, StopLine
from surface_gym.rendering.tiles import TilePainter, draw_tiles
from surface_gym.rendering.window import Window

__all__ = [
    "ExitMark",
    "ExitSide",
    "ExitSpeed",
    "FlowPainter",
    "FlowParcel",
    "FlowScene",
    "Goal",
    "Heading",
    "Painter",
    "Path",
    "Scene",
    "StopLine",
    "TilePainter",
    "Window",
    "draw",
    "draw_flow",
    "draw_tiles",
    "with_caption",
]
