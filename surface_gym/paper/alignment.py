"""Section 5.2: whether axes at +-45 deg in alternate rows centre and straighten a box.

The study finds that they seem "promising for the self-alignment of the conveyed material in the
center of the transport line". Each rotor drags a box that moves along x to the side that its axis
points to, so that two rows drag against each other and the one that bears more wins. At +45 deg in
the upper row they push inwards: a box that is off centre loads the row on its own side more, and is
pushed back. At -45 deg there they push outwards.

What comes of it, in short zones: inwards, a box whose base lies on the rows alone (the S-box up to
25 mm off) is brought towards the middle, by six columns past it, and a turned box is turned
further. Outwards it is the other way about: straighter, and farther off. Of boxes that come both
off the middle and turned, at most 2 in 12 end nearer in both by a tenth. The B-box on its four rows
hardly feels either. A zone much longer than the box makes it swing, spin and, outwards, leave the
line.
"""

import math
from dataclasses import dataclass
from itertools import product

import numpy as np

from surface_gym import layouts
from surface_gym.paper.integration import tipping_share
from surface_gym.paper.occupancy import NONE, rotor_columns
from surface_gym.paper.tables import Track, untracked
from surface_gym.paper.targets import SIZES
from surface_gym.simulation import simulate
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory

INWARDS, OUTWARDS = 1, -1  # sign of the outer row's angle at y > 1 m
ZONES = ((2, 1.5), (6, 2.5), (30, 2.5))  # columns, and speed [m/s] at which a box comes
TILTS = (0.0, 10.0)  # [deg]
OFFSETS = (0.01, 0.02, 0.04)  # [m] from the middle, straight
TURNS = (5.0, 10.0)  # [deg] in the middle
LONGEST = 6.0  # [s]
NEARER = 0.9  # [-] of where it came, or less
STEP = 1e-3  # [s] implicit


@dataclass(frozen=True)
class Zone:
    """Slowing columns at +-45 deg in alternate rows, and the speed at which a box comes."""

    size: str  # of the box, "S" or "B"
    towards: int  # INWARDS or OUTWARDS: where the outer rows push
    columns: int
    speed: float  # [m/s]
    tilt: float  # [deg]

    @property
    def surface(self) -> Surface:
        """The line with as many columns at 90 deg behind the zone as before it."""
        return layouts.slowing(
            self.size,
            self.towards * 0.25 * math.pi,
            self.columns,
            columns=self.columns + 2 * layouts.LEAD_IN[self.size],
            tilt=math.radians(self.tilt),
        )


@dataclass(frozen=True)
class Aligned:
    """How boxes leave a zone, or rest in it: off the middle [m] and turned [deg]."""

    zone: Zone
    straight: tuple[tuple[float, float], ...]  # one of OFFSETS, that come straight
    centred: tuple[tuple[float, float], ...]  # one of TURNS, that come in the middle
    nearer: int  # of those both off the middle and turned: nearer in both, by a tenth at least
    mixed: int  # so many came so
    tipping: float  # [-] share of all steps that would tip the box


def study(track: Track = untracked) -> tuple[Aligned, ...]:
    """Every zone, both signs, both boxes, level and tilted."""
    zones = tuple(
        Zone(size, towards, columns, speed, tilt)
        for size, (columns, speed), tilt, towards in product(
            SIZES, ZONES, TILTS, (INWARDS, OUTWARDS)
        )
    )
    return tuple(align(zone) for zone in track(zones, "Alignment"))


def align(zone: Zone) -> Aligned:
    """Send boxes off the middle, turned, and both."""
    mixed = [(offset, side * turn) for offset, turn, side in product(OFFSETS, TURNS, (1.0, -1.0))]
    starts = (*((offset, 0.0) for offset in OFFSETS), *((0.0, turn) for turn in TURNS), *mixed)
    runs = [crossing(zone, *start) for start in starts]
    ends = [end_of(run) for run in runs]
    shares = [tipping_share(run) or 0.0 for run in runs]
    both = sum(
        abs(offset) <= NEARER * abs(came[0]) and abs(turn) <= NEARER * abs(came[1])
        for (offset, turn), came in zip(ends[-len(mixed) :], mixed, strict=True)
    )
    return Aligned(
        zone,
        tuple(ends[: len(OFFSETS)]),
        tuple(ends[len(OFFSETS) : -len(mixed)]),
        both,
        len(mixed),
        float(np.mean(shares)),
    )


def crossing(zone: Zone, offset: float, turn: float) -> Trajectory:
    """A box's way until its base has left the zone's columns, or the line, or it has stopped.

    Args:
        zone: the zone.
        offset: [m] from the middle of the line at the start.
        turn: [deg] at the start.
    """
    surface = zone.surface
    x, y, _ = layouts.start(zone.size)
    run = simulate(
        surface,
        layouts.box(zone.size),
        (x, y + offset, math.radians(turn)),
        (zone.speed, 0.0, 0.0),
        LONGEST,
        STEP,
    )
    first, _ = rotor_columns(surface, zone.size, run.pose)
    past = (first >= surface.columns - layouts.LEAD_IN[zone.size]) | (first == NONE)
    rows = int(np.argmax(past)) + 1 if past.any() else len(past)
    return Trajectory(
        run.time[:rows], run.pose[:rows], run.velocity[:rows], run.tipping[:rows], run.end
    )


def end_of(run: Trajectory) -> tuple[float, float]:
    """Off the middle [m] and turned [deg] at the end."""
    return float(run.pose[-1, 1]) - layouts.LINE_Y, math.degrees(run.pose[-1, 2])
