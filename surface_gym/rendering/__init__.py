"""Drawing of a `Scene` as a picture. Only this package imports pygame."""

import os

os.environ.setdefault("PYGAME_HIDE_SUPPORT_PROMPT", "1")  # keeps standard output clean

from surface_gym.rendering.painter import Painter, Window, draw, side_by_side, with_caption
from surface_gym.rendering.scene import (
    ExitMark,
    ExitSide,
    ExitSpeed,
    Heading,
    InletMark,
    Path,
    Scene,
    SceneParcel,
    StopLine,
    Traffic,
)

__all__ = [
    "ExitMark", "ExitSide", "ExitSpeed", "Heading", "InletMark", "Painter", "Path", "Scene",
    "SceneParcel", "StopLine", "Traffic", "Window", "draw", "side_by_side", "with_caption",
]  # fmt: skip
