"""A surface and boxes from above, in the symbols of Figure 6."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D

from surface_gym import layouts
from surface_gym.surface import Surface

AXIS_LENGTH = 0.06  # [m] drawn through a rotor's centre
ROTOR = "red"
SUPPORT = "tab:blue"
BOX = "limegreen"


def draw_surface(panel: Axes, surface: Surface) -> None:
    """Red rotors with their axes, blue supports."""
    x, y = np.meshgrid(surface.x, surface.y)
    rotor = surface.rotor
    panel.plot(x[~rotor], y[~rotor], ".", color=SUPPORT, markersize=4)
    panel.plot(x[rotor], y[rotor], ".", color=ROTOR, markersize=4)
    centre = np.stack([x[rotor], y[rotor]], axis=-1)
    direction = np.stack([np.cos(surface.axis[rotor]), np.sin(surface.axis[rotor])], axis=-1)
    half = 0.5 * AXIS_LENGTH * direction
    axes = np.stack([centre - half, centre + half], axis=1)
    panel.add_collection(LineCollection(list(axes), color=ROTOR, linewidth=1.2))


def draw_box(
    panel: Axes, size: str, pose: Sequence[float], colour: str, style: str = "-", width: float = 2.0
) -> None:
    """The perimeter of the "S" or "B" box at (x, y, theta) [m, m, rad]."""
    x, y, theta = pose
    cosine, sine = math.cos(theta), math.sin(theta)
    outline = layouts.box(size).base.outline @ np.array([[cosine, sine], [-sine, cosine]])
    corners = np.vstack([outline, outline[:1]]) + np.array([x, y])
    panel.plot(corners[:, 0], corners[:, 1], style, color=colour, linewidth=width)


def element_marks() -> list[Line2D]:
    """What a legend says of rotors and supports."""
    return [
        Line2D([], [], marker="|", color=ROTOR, markersize=10, linestyle="", label="rotor axis"),
        Line2D([], [], marker=".", color=SUPPORT, linestyle="", label="support"),
    ]
