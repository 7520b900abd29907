"""One run of the simulator over axes arranged beforehand: how a layout is chosen."""

import numpy as np

import surface_gym as sg
from surface_gym.layouts import ROLLING
from surface_gym.lines import BaseLine

from .lane_rule import Numbers

SAME_SIZE = 0.005  # [m] half lengths are rounded to it; those of the study's boxes are multiples


def sizes_of(half_length: Numbers) -> Numbers:
    """(lanes,) [m] half lengths, rounded, so that a run serves all parcels of about a size."""
    sizes: Numbers = SAME_SIZE * np.round(half_length / SAME_SIZE)
    return sizes


def run_over(
    zone_axis: Numbers,
    half_length: float,
    speed: float,
    site_plan: BaseLine,
    zone: tuple[int, int] | None,
    dt: float,
) -> sg.Trajectory:
    """The trajectory of a square box that enters a line, long enough to cross it by rolling.

    Args:
        zone_axis: (rows, columns) [rad] axes of the widest zone; all others roll along x.
        half_length: [m] of the box.
        speed: [m/s] at which it enters.
        site_plan: the plant.
        zone: first and last column that obey; None for the plant's own.
        dt: [s] step.
    """
    base = sg.Rectangle(2.0 * half_length, 2.0 * half_length)
    rotor, (first_row, rows, first, columns) = site_plan.site(base, zone)
    margin = (len(zone_axis) - rows) // 2
    axis = np.full(rotor.shape, ROLLING)
    axis[first_row : first_row + rows, first : first + columns] = zone_axis[margin : margin + rows]
    return sg.simulate(
        site_plan.surface(axis, rotor),
        sg.Parcel(base),
        (half_length, site_plan.line_y, 0.0),
        (speed, 0.0, 0.0),
        duration=2.0 * site_plan.length / speed,
        dt=dt,
    )
