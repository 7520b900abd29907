"""Tests of two claims of the paper: axes at 45 deg align a box, and which tilts stop it.

docs/reproduction.md derives the steepest tilt gamma at which a box stops by itself. It is
tan(gamma) = sqrt(2) mu_min on axes at +45 deg, and tan(gamma) = (mu_max + mu_min) / sqrt(2) on
alternate rows at +45 and -45 deg.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from surface_gym import layouts, simulation
from surface_gym.paper.runs import NONE, SIZES, Integration, rotor_columns, tipping_share
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory

# function that shows progress over cases, with a description
Track = Callable[[Sequence[Any], str], Iterable[Any]]

INWARDS, OUTWARDS = 1, -1  # sign of the outer row's angle at y > 1 m
ZONES = ((2, 1.5), (6, 2.5), (30, 2.5))  # columns, and entry speed [m/s] of a box
TILTS = (0.0, 10.0)  # [deg]
OFFSETS = (0.01, 0.02, 0.04)  # [m] offset from the middle of boxes without a turn
TURNS = (5.0, 10.0)  # [deg] turn of boxes in the middle
NEARER = 0.9  # [-] maximum ratio of final to initial offset that counts as nearer
LONGEST_CROSSING = 6.0  # [s]
STEP = 1e-3  # [s] implicit step

METHODS = (Integration("implicit", 5e-3), Integration("explicit", 1e-3))
PUSH = 0.05  # [m/s] along x at the start
LONGEST_PUSH = 60.0  # [s]
STEEPEST = 30.0  # [deg]
RESOLUTION = 0.005  # [deg] resolution of a threshold
ELEMENTS = 80  # elements per side of the field
START = (1.0, 7.0, 0.0)  # [m, m, rad]
# [m/s] With the explicit method, a box at rest still oscillates at some mm/s.
STANDING = 0.02


@dataclass(frozen=True)
class Zone:
    """Slowing columns at +-45 deg in alternate rows, and the entry speed of a box."""

    size: str  # size of the box, "S" or "B"
    towards: int  # INWARDS or OUTWARDS: direction in which the outer rows push
    columns: int
    speed: float  # [m/s]
    tilt: float  # [deg]

    @property
    def surface(self) -> Surface:
        """The line, with equal numbers of columns at 90 deg before and after the zone."""
        return layouts.slowing(
            self.size,
            self.towards * 0.25 * math.pi,
            self.columns,
            columns=self.columns + 2 * layouts.LEAD_IN[self.size],
            tilt=math.radians(self.tilt),
        )


@dataclass(frozen=True)
class Alignment:
    """Offsets [m] and turns [deg] of boxes that leave a zone or stop in it."""

    zone: Zone
    straight: tuple[tuple[float, float], ...]  # for each of OFFSETS, boxes without a turn
    centred: tuple[tuple[float, float], ...]  # for each of TURNS, boxes in the middle
    nearer: int  # number of boxes with offset and turn that end nearer in both
    mixed: int  # number of boxes with offset and turn
    tipping: float  # [-] share of all steps that would tip the box


def study_alignment(track: Track) -> tuple[Alignment, ...]:
    """Study every zone with both signs and both boxes, level and tilted."""
    zones = tuple(
        Zone(size, towards, columns, speed, tilt)
        for size, (columns, speed), tilt, towards in product(
            SIZES, ZONES, TILTS, (INWARDS, OUTWARDS)
        )
    )
    return tuple(align(zone) for zone in track(zones, "Alignment"))


def align(zone: Zone) -> Alignment:
    """Run boxes with an offset, with a turn, and with both."""
    mixed = [(offset, side * turn) for offset, turn, side in product(OFFSETS, TURNS, (1.0, -1.0))]
    starts = (*((offset, 0.0) for offset in OFFSETS), *((0.0, turn) for turn in TURNS), *mixed)
    runs = [cross(zone, *start) for start in starts]
    ends = [end_of_run(run) for run in runs]
    both = sum(
        abs(offset) <= NEARER * abs(came[0]) and abs(turn) <= NEARER * abs(came[1])
        for (offset, turn), came in zip(ends[-len(mixed) :], mixed, strict=True)
    )
    return Alignment(
        zone, tuple(ends[: len(OFFSETS)]), tuple(ends[len(OFFSETS) : -len(mixed)]), both,
        len(mixed), float(np.mean([tipping_share(run) or 0.0 for run in runs])),
    )  # fmt: skip


@simulation.expect_tipping()
def cross(zone: Zone, offset: float, turn: float) -> Trajectory:
    """Run a box with an offset [m] and a turn [deg] until it has departed or stopped."""
    surface = zone.surface
    x, y, _ = layouts.start(zone.size)
    run = simulation.simulate(
        surface, layouts.box(zone.size), (x, y + offset, math.radians(turn)),
        (zone.speed, 0.0, 0.0), LONGEST_CROSSING, STEP,
    )  # fmt: skip
    first, _ = rotor_columns(surface, zone.size, run.pose)
    past = (first >= surface.columns - layouts.LEAD_IN[zone.size]) | (first == NONE)
    rows = int(np.argmax(past)) + 1 if past.any() else len(past)
    return Trajectory(
        run.time[:rows], run.pose[:rows], run.velocity[:rows], run.tipping[:rows], run.end
    )


def end_of_run(run: Trajectory) -> tuple[float, float]:
    """Return the offset from the middle [m] and the turn [deg] at the end."""
    return float(run.pose[-1, 1]) - layouts.LINE_Y, math.degrees(run.pose[-1, 2])


@dataclass(frozen=True)
class SelfStop:
    """The steepest tilt at which a pushed box stops by itself."""

    layout: str
    integration: Integration
    measured: float  # [deg]
    expected: float  # [deg] by the balance of forces
    study: float | None  # [deg] value in Section 6.2; None: not stated for this layout


def wide_field(signs: tuple[int, ...], tilt: float) -> Surface:
    """Build a field tilted by `tilt` [rad] with rows at 45 deg times `signs`, repeated."""
    axis = np.tile(0.25 * math.pi * np.resize(signs, (ELEMENTS, 1)), ELEMENTS)
    return Surface(axis, np.ones(axis.shape, dtype=bool), tilt=tilt)


def study_standstill(track: Track) -> tuple[SelfStop, ...]:
    """Measure both fields by both methods."""
    surface = wide_field((1,), 0.0)
    printed = math.degrees(math.asin(math.sqrt(0.5) * surface.mu_min))
    rolling = math.degrees(math.atan(math.sqrt(2.0) * surface.mu_min))
    both = math.degrees(math.atan(math.sqrt(0.5) * (surface.mu_max + surface.mu_min)))
    fields = (
        ("+45° everywhere", (1,), rolling, printed),
        ("±45° in alternate rows", (-1, 1), both, None),
    )
    return tuple(
        SelfStop(name, integration, steepest_stop(signs, integration), expected, study)
        for (name, signs, expected, study), integration in track(
            tuple(product(fields, METHODS)), "Self-stopping"
        )
    )


def steepest_stop(signs: tuple[int, ...], integration: Integration) -> float:
    """Find by bisection the steepest tilt [deg] at which a pushed box stops by itself."""
    low, high = 0.0, STEEPEST
    while high - low > RESOLUTION:
        middle = 0.5 * (low + high)
        if _stops(wide_field(signs, math.radians(middle)), integration):
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@simulation.expect_tipping()
def _stops(surface: Surface, integration: Integration) -> bool:
    """Push the S-box, and return whether it is at rest in the last quarter of the time."""
    run = simulation.simulate(
        surface, layouts.box("S"), START, (PUSH, 0.0, 0.0), LONGEST_PUSH, integration.dt,
        integration.method,
    )  # fmt: skip
    speed = np.hypot(run.velocity[:, 0], run.velocity[:, 1])
    return run.end != "left the surface" and bool(speed[-len(speed) // 4 :].mean() < STANDING)
