"""Section 5.2 and 5.3: how much a slowing area takes of a parcel's speed, and what stops it."""

import math

import numpy as np

from surface_gym import layouts
from surface_gym.paper.comparison import Cell, SlowingLayout
from surface_gym.paper.integration import CONVERGED, PAPER_STEP, Integration
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


def exit_speed(surface: Surface, size: str, speed: float, integration: Integration) -> float:
    """[m/s] of a box as its base leaves the task's last column; 0 where it stops before.

    Args:
        surface: of `slowing_surface` or `stopping_surface`.
        size: of the box.
        speed: [m/s] at which it starts.
        integration: method and step.
    """
    trajectory = integration.run(surface, size, speed, LONGEST)
    first, _ = rotor_columns(surface, size, trajectory.pose)
    past = first >= surface.columns - layouts.LEAD_IN[size]
    return float(trajectory.velocity[np.argmax(past), 0]) if past.any() else 0.0


def smallest_layout(size: str, speed: float, integration: Integration) -> SlowingLayout | None:
    """The fewest columns with 0.5 v0 >= v_out > 0, or None where no layout does that."""
    for columns in range(1, MOST_COLUMNS + 1):
        for angle in ANGLES:
            layout = SlowingLayout(columns, angle)
            left = exit_speed(slowing_surface(size, layout), size, speed, integration)
            if 0.5 * speed >= left > 0.0:
                return layout
    return None


def table4_cell(size: str, speed: float, paper: SlowingLayout) -> Cell:
    """An entry of Table 4."""
    coarse = smallest_layout(size, speed, PAPER_STEP)
    fine = smallest_layout(size, speed, CONVERGED)
    return Cell(f"{speed:.1f}", f"{size}-box", paper, coarse, fine)


def ratio_cell(size: str, speed: float, layout: SlowingLayout, paper: float) -> Cell:
    """A slowing ratio v_out / v0 of Section 5.2."""
    surface = slowing_surface(size, layout)
    coarse, fine = (
        exit_speed(surface, size, speed, integration) / speed
        for integration in (PAPER_STEP, CONVERGED)
    )
    return Cell(f"columns: {layout}", f"{size}-box", paper, coarse, fine, 2)


def stopping_cell(size: str, speed: float, layout: SlowingLayout) -> Cell:
    """The speed left behind Table 4's layout and one more column; the paper says none is."""
    surface = stopping_surface(size, layout)
    coarse, fine = (
        exit_speed(surface, size, speed, integration) for integration in (PAPER_STEP, CONVERGED)
    )
    return Cell(f"{speed:.1f}", f"{size}-box", 0.0, coarse, fine, 3)
