"""Actuators, and the domain randomisation of parcels and surfaces."""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.parcel import Base, Parcel


@dataclass(frozen=True)
class Actuators:
    """The modules' actuators."""

    axis_speed: float = math.inf  # [rad/s] at which an axis turns, through the angles between
    stuck: tuple[tuple[int, int], ...] = ()  # (row, column) of modules that ignore commands
    stuck_share: float = 0.0  # [-] probability of any other to be stuck, drawn at each start

    def __post_init__(self) -> None:
        if self.axis_speed != math.inf:
            checks.positive("axis_speed", self.axis_speed, *checks.AXIS_SPEED)
        checks.within("stuck_share", self.stuck_share, 0.0, 1.0)
        if not isinstance(self.stuck, (tuple, list)):
            raise ValueError(f"stuck must hold (row, column) pairs, got {self.stuck!r}")
        for module in self.stuck:
            if not (isinstance(module, tuple) and len(module) == 2):
                raise ValueError(f"stuck must hold (row, column) pairs, got {module!r}")
            for place in module:
                checks.integer("stuck", place, least=0)


ANYWHERE = (-math.inf, math.inf)  # [m]
MOST_SPREAD = 0.99  # [-] of mass and size, which may then be a hundredth: not nothing
MOST_DRAWS = 1000  # of a start aside: of ordinary ones one in 20 is drawn twice at most


class RandomDraw(NamedTuple):
    """A start and the surface under it as drawn."""

    parcel: Parcel
    aside: float  # [m] of the start in y
    turned: float  # [rad] of the start's theta
    friction: tuple[float, float, float]  # factors of mu_max, mu_min and mu_support
    stiffness: NDArray[np.float64] | None  # (rows, columns) [-]; None: all the same


@dataclass(frozen=True)
class Randomisation:
    """Spreads of parcel and surface from episode to episode; nothing varies by default.

    Mass alone changes nothing, since it cancels out of Eq. (1)-(4): what `mass` varies is the
    load's mass at a given inertia, so how hard the parcel is to turn.
    """

    friction: float = 0.0  # [-] mu_max times uniform(1 - friction, 1 + friction)
    rolling: float = 0.0  # [-] mu_min and mu_support, each times uniform(1 - rolling, 1 + rolling)
    mass: float = 0.0  # [-] mass at the same inertia, times uniform(1 - mass, 1 + mass)
    size: float = 0.0  # [-] base times uniform(1 - size, 1 + size)
    # [-] centre of mass, x and y uniform within this share of half the base's extent; drawn again
    # where that is not over the base
    com_offset: float = 0.0
    stiffness: float = 0.0  # [-] log-normal spread of each element's: it bears more or less
    # [m] normal spread of the start in y, at most a quarter of the surface's width; drawn again
    # where the centre of mass would not be over the surface
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
        """Return whether there is anything to draw."""
        return self != Randomisation()

    def largest(self, base: Base) -> Base:
        """Return the base at the largest size that may be drawn."""
        return base.scaled(1.0 + self.size)

    def least(self, base: Base) -> Base:
        """Return the base at the least size that may be drawn."""
        return base.scaled(1.0 - self.size)

    def draw(
        self,
        rng: np.random.Generator,
        parcel: Parcel,
        shape: tuple[int, ...],
        room: tuple[float, float] = ANYWHERE,
    ) -> RandomDraw:
        """Vary a start of a parcel and the surface (rows, columns); only what varies is drawn.

        `room` is [m] from the start to the surface's edges in y, the first negative.
        """
        friction = self.draw_friction(rng)
        parcel, aside, turned = self.draw_entry(rng, parcel, room)
        return RandomDraw(parcel, aside, turned, friction, self.draw_stiffness(rng, shape))

    def draw_friction(self, rng: np.random.Generator) -> tuple[float, float, float]:
        """Draw factors of mu_max, mu_min and mu_support of a surface."""
        return (
            _factor(rng, self.friction),
            _factor(rng, self.rolling),
            _factor(rng, self.rolling),
        )

    def draw_stiffness(
        self, rng: np.random.Generator, shape: tuple[int, ...]
    ) -> NDArray[np.float64] | None:
        """Draw the stiffness [-] of each element (rows, columns); None: all the same."""
        return np.exp(self.stiffness * rng.standard_normal(shape)) if self.stiffness else None

    @property
    def varies_parcels(self) -> bool:
        """Return whether there is anything to draw of a parcel itself."""
        return bool(self.mass or self.size or self.com_offset)

    def draw_entry(
        self, rng: np.random.Generator, parcel: Parcel, room: tuple[float, float] = ANYWHERE
    ) -> tuple[Parcel, float, float]:
        """Draw a parcel, how far [m] aside and how far [rad] turned it starts."""
        if self.varies_parcels:
            parcel = self._draw_parcel(rng, parcel)
        aside = self._draw_aside(rng, parcel, room) if self.lateral else 0.0
        turned = self.heading * float(rng.standard_normal()) if self.heading else 0.0
        return parcel, aside, turned

    def _draw_aside(
        self, rng: np.random.Generator, parcel: Parcel, room: tuple[float, float]
    ) -> float:
        reach = math.hypot(*parcel.centre_of_mass)  # from the frame's origin, however it is turned
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
