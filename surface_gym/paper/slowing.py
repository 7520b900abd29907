"""Section 5.2 and 5.3: how much a slowing area takes of a parcel's speed, and what stops it."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from surface_gym import layouts
from surface_gym.paper.comparison import Cell, Found, SlowingLayout
from surface_gym.paper.integration import Integration, tipping_share
from surface_gym.paper.occupancy import rotor_columns
from surface_gym.surface import Surface

ANGLES = (0, 45)  # [deg] of Table 4
MOST_COLUMNS = 10
LONGEST = 6.0  # [s] a box may take through the slowing area


def slowing_surface(size: str, layout: SlowingLayout) -> Surface:
    """The layout with as many columns at 90 deg behind the slowing area as before it."""
    return layouts.slowing(
        size,
        math.radians(layout.angle),
        layout.columns,
        columns=layout.columns + 2 * layouts.LEAD_IN[size],
    )


def stopping_surface(size: str, layout: SlowingLayout) -> Surface:
    """Section 5.3: one more column, at 0 deg, at the end of the slowing area."""
    return layouts.stopping(
        size,
        math.radians(layout.angle),
        layout.columns,
        columns=layout.columns + 1 + 2 * layouts.LEAD_IN[size],
    )


class Exit(NamedTuple):
    """How a box leaves the task's columns."""

    speed: float  # [m/s] as its base leaves the last of them; 0 where it stops before
    tipping: float | None  # [-] share of the steps until then that would tip it


def leave(surface: Surface, size: str, speed: float, integration: Integration) -> Exit:
    """Send a box over the task's columns.

    Args:
        surface: of `slowing_surface` or `stopping_surface`.
        size: of the box.
        speed: [m/s] at which it starts.
        integration: method and step.
    """
    trajectory = integration.run(surface, size, speed, LONGEST)
    first, _ = rotor_columns(surface, size, trajectory.pose)
    past = first >= surface.columns - layouts.LEAD_IN[size]
    if not past.any():
        return Exit(0.0, tipping_share(trajectory))
    end = int(np.argmax(past))
    return Exit(float(trajectory.velocity[end, 0]), tipping_share(trajectory, end))


def smallest_layout(size: str, speed: float, integration: Integration) -> Found:
    """The fewest columns with 0.5 v0 >= v_out > 0, or None where no layout does that."""
    for columns in range(1, MOST_COLUMNS + 1):
        for angle in ANGLES:
            layout = SlowingLayout(columns, angle)
            left = leave(slowing_surface(size, layout), size, speed, integration)
            if 0.5 * speed >= left.speed > 0.0:
                return Found(layout, left.tipping)
    return Found(None, None)


def table4_cell(
    size: str, speed: float, paper: SlowingLayout, integrations: Sequence[Integration]
) -> Cell:
    """An entry of Table 4."""
    ours = tuple(smallest_layout(size, speed, integration) for integration in integrations)
    return Cell(f"{speed:.1f}", f"{size}-box", size, paper, ours)


def ratio_cell(
    size: str,
    speed: float,
    layout: SlowingLayout,
    paper: float,
    integrations: Sequence[Integration],
) -> Cell:
    """A slowing ratio v_out / v0 of Section 5.2."""
    surface = slowing_surface(size, layout)
    exits = [leave(surface, size, speed, integration) for integration in integrations]
    ours = tuple(Found(done.speed / speed, done.tipping) for done in exits)
    return Cell(f"columns: {layout}", f"{size}-box", size, paper, ours, 2)


def stopping_cell(
    size: str, speed: float, layout: SlowingLayout, integrations: Sequence[Integration]
) -> Cell:
    """The speed left behind Table 4's layout and one more column; the paper says none is."""
    surface = stopping_surface(size, layout)
    ours = tuple(Found(*leave(surface, size, speed, integration)) for integration in integrations)
    return Cell(f"{speed:.1f}", f"{size}-box", size, 0.0, ours, 3)
