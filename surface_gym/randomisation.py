"""Actuators, and domain randomisation of parcels and surfaces."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.parcel import Base, Parcel

MOST_STEP = math.pi / 2.0  # [rad] largest step and backlash of an axis


@dataclass(frozen=True)
class Actuators:
    """The modules' actuators."""

    axis_speed: float = math.inf  # [rad/s] turning speed of an axis
    stuck: tuple[tuple[int, int], ...] = ()  # (row, column) of modules that ignore commands
    stuck_share: float = 0.0  # [-] probability of other modules to be stuck, drawn at each start
    # whether an axis turns under load; if not, it waits, and keeps its command, until no parcel
    # presses on its module
    turns_loaded: bool = True
    step: float = 0.0  # [rad] between positions of an axis, counted from 90 deg; 0: any angle
    # [rad] play of an axis, which stops half the play before the position that it turns to
    backlash: float = 0.0
    load_limit: float = math.inf  # [kg] load that a module bears; `info["overloaded"]` beyond it
    turn_energy: float = 0.0  # [J] energy of a turn of an axis, by its data sheet
    turn_life: float = math.inf  # turns of an axis until it fails, by its data sheet

    def __post_init__(self) -> None:
        if self.axis_speed != math.inf:
            checks.positive("axis_speed", self.axis_speed, *checks.AXIS_SPEED)
        checks.one_of("turns_loaded", self.turns_loaded, (False, True))
        checks.angle("step", self.step, 0.0, MOST_STEP)
        checks.angle("backlash", self.backlash, 0.0, MOST_STEP)
        checks.not_negative("turn_energy", self.turn_energy)
        if self.turn_life != math.inf:
            checks.positive("turn_life", self.turn_life)
        if self.load_limit != math.inf:
            checks.positive("load_limit", self.load_limit, *checks.MASS)
        checks.within("stuck_share", self.stuck_share, 0.0, 1.0)
        if not isinstance(self.stuck, (tuple, list)):
            raise ValueError(f"stuck must hold (row, column) pairs, got {self.stuck!r}")
        for module in self.stuck:
            if not (isinstance(module, tuple) and len(module) == 2):
                raise ValueError(f"stuck must hold (row, column) pairs, got {module!r}")
            for place in module:
                checks.integer("stuck", place, least=0)

    @property
    def has_limits(self) -> bool:
        """Return whether an axis may stop at an angle that differs from the commanded angle."""
        return bool(not self.turns_loaded or self.step or self.backlash)


ANYWHERE = (-math.inf, math.inf)  # [m]
MOST_SPREAD = 0.99  # [-] maximum spread of mass and size, so that they stay positive
MOST_DRAWS = 1000  # maximum draws of a lateral start; typically at most one in 20 is drawn twice


class RandomDraw(NamedTuple):
    """Random start and surface."""

    parcel: Parcel
    aside: float  # [m] lateral offset of the start
    turned: float  # [rad] theta of the start
    friction: tuple[float, float, float]  # factors of mu_max, mu_min and mu_support
    stiffness: NDArray[np.float64] | None  # (rows, columns) [-]; None: all the same


@dataclass(frozen=True)
class Randomisation:
    """Spreads of parcel and surface from episode to episode. The default is no variation.

    `mass` varies the mass, but not the moment of inertia, so friction turns heavier parcels faster.
    If mass and inertia were doubled, a lone parcel would move as before: the factor cancels out of
    Eq. (1)-(4).
    """

    friction: float = 0.0  # [-] mu_max times uniform(1 - friction, 1 + friction)
    rolling: float = 0.0  # [-] mu_min and mu_support, each times uniform(1 - rolling, 1 + rolling)
    mass: float = 0.0  # [-] mass at the same inertia, times uniform(1 - mass, 1 + mass)
    size: float = 0.0  # [-] base times uniform(1 - size, 1 + size)
    # [-] centre of mass, x and y uniform within this share of half the base's extent; drawn again
    # if it is not over the base
    com_offset: float = 0.0
    # [-] log-normal spread of each element's stiffness, which changes its load
    stiffness: float = 0.0
    # [m] normal spread of the start in y, at most a quarter of the surface's width; drawn again if
    # the centre of mass is not over the surface
    lateral: float = 0.0
    heading: float = 0.0  # [rad] normal spread of the start's theta

    def __post_init__(self) -> None:
        for name in ("friction", "rolling", "mass", "size", "com_offset"):
            if checks.within(name, getattr(self, name), 0.0, 1.0) == 1.0:
                raise ValueError(f"{name} must be less than 1, got {getattr(self, name)!r}")
        for name in ("mass", "size"):
            checks.within(name, getattr(self, name), 0.0, MOST_SPREAD)
        for name, most in (
            ("stiffness", checks.STIFFNESS_SPREAD),
            ("lateral", checks.LENGTH[1]),
        ):
            checks.not_negative(name, getattr(self, name), most)
        checks.angle("heading", self.heading, 0.0, math.pi)

    @property
    def varies(self) -> bool:
        """Return whether anything varies."""
        return self != Randomisation()

    def largest(self, base: Base) -> Base:
        """Return the base at the largest possible size."""
        return base.scaled(1.0 + self.size)

    def least(self, base: Base) -> Base:
        """Return the base at the smallest possible size."""
        return base.scaled(1.0 - self.size)

    def draw(
        self,
        rng: np.random.Generator,
        parcel: Parcel,
        shape: tuple[int, ...],
        room: tuple[float, float] = ANYWHERE,
    ) -> RandomDraw:
        """Draw a varied parcel, its start, and the friction and stiffness of a surface's elements.

        A quantity that does not vary uses no random number. `shape` is (rows, columns) of the
        elements. `room` holds y [m] of the surface's right edge and left edge. In `room`, y is 0 at
        the parcel's nominal start, so y of the right edge is negative.
        """
        friction = self.draw_friction(rng)
        parcel, aside, turned = self.draw_entry(rng, parcel, room)
        return RandomDraw(parcel, aside, turned, friction, self.draw_stiffness(rng, shape))

    def draw_friction(self, rng: np.random.Generator) -> tuple[float, float, float]:
        """Draw the factors by which a surface's mu_max, mu_min and mu_support are multiplied."""
        return (
            _factor(rng, self.friction),
            _factor(rng, self.rolling),
            _factor(rng, self.rolling),
        )

    def draw_stiffness(
        self, rng: np.random.Generator, shape: tuple[int, ...]
    ) -> NDArray[np.float64] | None:
        """Draw elements' stiffness [-] (rows, columns). Return None if all elements are equal."""
        return np.exp(self.stiffness * rng.standard_normal(shape)) if self.stiffness else None

    @property
    def varies_parcels(self) -> bool:
        """Return whether parcels vary."""
        return bool(self.mass or self.size or self.com_offset)

    def draw_entry(
        self, rng: np.random.Generator, parcel: Parcel, room: tuple[float, float] = ANYWHERE
    ) -> tuple[Parcel, float, float]:
        """Return a varied `parcel`, an offset in y [m], an angle [rad]. For `room` see `draw`."""
        if self.varies_parcels:
            parcel = self._draw_parcel(rng, parcel)
        aside = self._draw_aside(rng, parcel, room) if self.lateral else 0.0
        turned = self.heading * float(rng.standard_normal()) if self.heading else 0.0
        return parcel, aside, turned

    def _draw_aside(
        self, rng: np.random.Generator, parcel: Parcel, room: tuple[float, float]
    ) -> float:
        reach = math.hypot(*parcel.centre_of_mass)  # from the frame's origin, for any angle
        for _ in range(MOST_DRAWS):
            aside = self.lateral * float(rng.standard_normal())
            if room[0] + reach <= aside <= room[1] - reach:
                return aside
        raise ValueError(
            f"lateral must leave a parcel over the surface, got {self.lateral!r} m where it may "
            f"start from {room[0] + reach:g} to {room[1] - reach:g} m aside"
        )

    def _draw_parcel(self, rng: np.random.Generator, parcel: Parcel) -> Parcel:
        mass, size = _factor(rng, self.mass), _factor(rng, self.size)
        base = parcel.base if size == 1.0 else parcel.base.scaled(size)
        half = np.ptp(base.outline, axis=0) / 2.0
        centre = np.array(base.centroid)
        offset = size * np.array(parcel.com_offset)
        while self.com_offset:
            moved = offset + self.com_offset * half * rng.uniform(-1.0, 1.0, 2)
            if base.functions(*(centre + moved)).max() <= 0.0:
                offset = moved
                break
        return replace(
            parcel,
            base=base,
            mass=parcel.mass * mass,
            inertia=parcel.moment_of_inertia * size**2,
            com_offset=tuple(offset.tolist()),
        )


def _factor(rng: np.random.Generator, spread: float) -> float:
    return float(rng.uniform(1.0 - spread, 1.0 + spread)) if spread else 1.0
