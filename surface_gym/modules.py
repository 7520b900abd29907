"""Kinds of modules: idle rotors, and driven modules whose surface moves.

An idle rotor drags along its axis and rolls across it; its only motor turns the axis. The surface
of a driven module moves under the parcel, and grips alike in all directions with `mu_max`. Friction
acts against the motion of the base relative to that surface.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from surface_gym import checks
from surface_gym.layouts import ROLLING
from surface_gym.physics.types import Array, Integers
from surface_gym.registry import Registry

QUARTER = math.pi / 2.0
SAME = 1e-6  # [rad] and [m/s] modes that differ by less are the same
FASTEST = 10.0  # [m/s] maximum speed of a driven surface


class Mode(NamedTuple):
    """Axis angle and surface velocity of a module. Each choice in an action stands for a mode."""

    angle: float  # [rad] axis
    along: float = 0.0  # [m/s] velocity of the surface along the axis, at `angle`
    across: float = 0.0  # [m/s] across it, at `angle` + 90 deg
    driven: float = 0.0  # [-] 1: grips alike in all directions; 0: an idle rotor


# Columns of modes.
ANGLE, ALONG, ACROSS, DRIVEN = range(len(Mode._fields))
MODULES: "Registry[ModuleKind]" = Registry("modules")


@dataclass(frozen=True)
class ModuleKind(ABC):
    """A kind of module; every module of a surface is of one kind.

    The method `modes` returns one row for each choice. A last row is the mode of modules without a
    command. All modules are in this mode until the first command. Modules outside the zone and
    stuck modules always stay in this mode.
    """

    acceleration: float = math.inf  # [m/s^2] by which the surface's velocity changes
    drives: ClassVar[bool] = True  # whether modules are driven: they may move a parcel at rest
    motors: ClassVar[tuple[int, int]]  # motors of a module that move its surface, and turn its axis

    @abstractmethod
    def modes(self, orientations: tuple[float, ...]) -> Array:
        """Return the modes, shape (choices + 1, 4). The last row is the mode without a command.

        Args:
            orientations: [rad] the line's available axis angles.
        """

    def images(self, orientations: tuple[float, ...]) -> Integers:
        """Return indices (choices,). Entry k is the choice that mirrors choice k in y.

        Raises:
            ValueError: a choice has no mirror image.
        """
        modes = self.modes(orientations)[:-1]
        mirrored = _effects(modes * [-1.0, 1.0, -1.0, 1.0])
        apart = np.abs(_effects(modes) - mirrored[:, np.newaxis]).max(axis=-1)
        nearest: Integers = apart.argmin(axis=1)
        if (apart[np.arange(len(modes)), nearest] > SAME).any():
            raise ValueError(
                "orientations and modules must hold the mirror image of each choice, "
                f"got {orientations} and {self!r}"
            )
        return nearest


def _effects(modes: Array) -> Array:
    """Return rows (count, 5) for modes (count, 4). Rows are equal if modes move parcels alike.

    The row of an idle rotor holds cosine and sine of twice the axis angle, because an axis turned
    by pi is the same axis. The row of a driven module holds the velocity of the surface.
    """
    angle, driven = modes[:, ANGLE], modes[:, DRIVEN]
    axis = np.stack([np.cos(2.0 * angle), np.sin(2.0 * angle)], axis=1)
    return np.column_stack(
        [(driven == 0.0)[:, np.newaxis] * axis, surface_velocities(modes), driven]
    )


def surface_velocities(modes: Array) -> Array:
    """Return the surfaces' velocities (count, 2) [m/s] along x and y for modes (count, 4)."""
    angle, along, across = modes[:, ANGLE], modes[:, ALONG], modes[:, ACROSS]
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.stack([cosine * along - sine * across, sine * along + cosine * across], axis=1)


@dataclass(frozen=True)
class IdleRotor(ModuleKind):
    """The study's module, an idle rotor. Its choices are the orientations of the line."""

    drives = False
    motors = 0, 1

    def modes(self, orientations: tuple[float, ...]) -> Array:
        return np.array([Mode(angle) for angle in (*orientations, ROLLING)])


@dataclass(frozen=True)
class DrivenModule(ModuleKind):
    """A module with a driven surface. A choice is a heading with a speed, or a stop.

    The first choices are all headings at the lowest positive speed, in the given order. Then the
    higher speeds follow. If `speeds` contains 0, the last choice is the stop.

    Raises:
        ValueError: a heading or a speed is not allowed.
    """

    acceleration: float = 10.0  # [m/s^2] by which the surface's velocity changes
    speeds: tuple[float, ...] = (0.0, 0.5, 1.0, 1.5)  # [m/s] in ascending order; 0: a stop
    headings: tuple[float, ...] = (0.0,)  # [rad] directions of motion, anti-clockwise from +x
    conveyor: float | None = None  # [m/s] of modules without commands; None: the highest speed
    idle_outside: bool = False  # whether modules without commands are idle rotors that roll

    def __post_init__(self) -> None:
        if self.acceleration != math.inf:
            checks.positive("acceleration", self.acceleration, 1e-3, 1e6)
        speeds = checks.array("speeds", self.speeds, (None,))
        allowed = len(speeds) > 0 and (np.diff(speeds) > 0.0).all()
        if not (allowed and 0.0 <= speeds[0] <= speeds[-1] <= FASTEST and speeds[-1] > 0.0):
            raise ValueError(
                f"speeds must be rising numbers from 0 to {FASTEST:g}, one of them positive, "
                f"got {self.speeds!r}"
            )
        if self.conveyor is not None:
            checks.within("conveyor", self.conveyor, 0.0, FASTEST)
        headings = checks.array("headings", self.headings, (None,))
        checks.angles("headings", headings)
        if len(headings) == 0:
            raise ValueError(f"headings must be at least one, got {self.headings!r}")
        checks.set_fields(self, speeds=tuple(speeds.tolist()), headings=tuple(headings.tolist()))

    @abstractmethod
    def mode(self, heading: float, speed: float) -> Mode:
        """Return the mode that moves the surface towards `heading` [rad] at `speed` [m/s]."""

    def modes(self, orientations: tuple[float, ...]) -> Array:
        del orientations  # the headings replace them
        moving = [
            self.mode(heading, speed) for speed in self.speeds if speed for heading in self.headings
        ]
        speed = self.speeds[-1] if self.conveyor is None else self.conveyor
        conveyor = Mode(ROLLING) if self.idle_outside else self.mode(0.0, speed)
        stop = [self.mode(0.0, 0.0)] if self.speeds[0] == 0.0 else []
        return np.array([*moving, *stop, conveyor])


@dataclass(frozen=True)
class SteeredRoller(DrivenModule):
    """A driven roller whose axis can be turned. The roller's surface moves across the axis."""

    # [rad] ahead, and 45 and 90 deg to both sides
    headings: tuple[float, ...] = (0.0, 0.5 * QUARTER, -0.5 * QUARTER, QUARTER, -QUARTER)
    motors = 1, 1

    def mode(self, heading: float, speed: float) -> Mode:
        return Mode(heading + QUARTER, across=-speed, driven=1.0)


@dataclass(frozen=True)
class OmniModule(DrivenModule):
    """A module of three omni-wheels. It moves a parcel in any direction without turning an axis."""

    headings: tuple[float, ...] = tuple(
        way * 0.5 * QUARTER for way in (0.0, 1.0, -1.0, 2.0, -2.0, 3.0, -3.0, 4.0)
    )  # [rad] eight directions
    motors = 3, 0

    def mode(self, heading: float, speed: float) -> Mode:
        vx, vy = speed * math.cos(heading), speed * math.sin(heading)
        return Mode(ROLLING, along=vy, across=-vx, driven=1.0)


@dataclass(frozen=True)
class Belt(OmniModule):
    """A short belt or roller that runs along the line only, as in an ordinary conveyor."""

    headings: tuple[float, ...] = (0.0, 2.0 * QUARTER)  # [rad] ahead and back
    motors = 1, 0


@dataclass(frozen=True)
class PopUp(OmniModule):
    """A pop-up transfer. Rollers move a parcel ahead, or belts rise and move the parcel aside."""

    speeds: tuple[float, ...] = (1.5,)  # [m/s]
    headings: tuple[float, ...] = (0.0, QUARTER, -QUARTER)  # [rad] ahead and to both sides
    motors = 2, 0


for _name, _module in {
    "idle": IdleRotor(),
    "steered": SteeredRoller(),
    "omni": OmniModule(),
    "belt": Belt(),
    "popup": PopUp(),
}.items():
    MODULES.register(_name, _module)


def find_module(module: Any) -> ModuleKind:
    """Return the kind of module with the name `module`. A `ModuleKind` is returned unchanged."""
    if isinstance(module, str):
        return MODULES.find(module)
    return checks.instance(
        "modules", module, ModuleKind, f"one of {', '.join(MODULES)} or a ModuleKind"
    )
