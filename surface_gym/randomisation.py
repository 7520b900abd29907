"""What differs from episode to episode, each draw with its law."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.bases import Base
from surface_gym.parcel import Parcel


class Drawn(NamedTuple):
    """What a start and the surface under it are drawn to be."""

    parcel: Parcel
    aside: float  # [m] of the start in y
    turned: float  # [rad] of the start's theta
    friction: tuple[float, float, float]  # factors of mu_max, mu_min and mu_support
    stiffness: NDArray[np.float64] | None  # (rows, columns) [-]; None: all the same


@dataclass(frozen=True)
class Randomisation:
    """Spreads of what is not known of a parcel and a surface; nothing varies by default.

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
    stiffness: float = 0.0  # [-] log-normal spread of each element's, who bears how much
    lateral: float = 0.0  # [m] normal spread of the start in y
    heading: float = 0.0  # [rad] normal spread of the start's theta

    def __post_init__(self) -> None:
        for name in ("friction", "rolling", "mass", "size", "com_offset"):
            if checks.within(name, getattr(self, name), 0.0, 1.0) == 1.0:
                raise ValueError(f"{name} must be less than 1, got {getattr(self, name)!r}")
        for name in ("stiffness", "lateral", "heading"):
            checks.not_negative(name, getattr(self, name))

    @property
    def varies(self) -> bool:
        """Whether there is anything to draw."""
        return self != Randomisation()

    def largest(self, base: Base) -> Base:
        """The base at the largest size that may be drawn."""
        return base.scaled(1.0 + self.size)

    def draw(self, rng: np.random.Generator, parcel: Parcel, shape: tuple[int, ...]) -> Drawn:
        """Vary a start of a parcel and the surface (rows, columns); only what varies is drawn."""
        friction = self.draw_friction(rng)
        parcel, aside, turned = self.draw_entry(rng, parcel)
        return Drawn(parcel, aside, turned, friction, self.draw_stiffness(rng, shape))

    def draw_friction(self, rng: np.random.Generator) -> tuple[float, float, float]:
        """Factors of mu_max, mu_min and mu_support of a surface."""
        return (
            _factor(rng, self.friction),
            _factor(rng, self.rolling),
            _factor(rng, self.rolling),
        )

    def draw_stiffness(
        self, rng: np.random.Generator, shape: tuple[int, ...]
    ) -> NDArray[np.float64] | None:
        """[-] of each element (rows, columns) of a surface; None: all the same."""
        return np.exp(self.stiffness * rng.standard_normal(shape)) if self.stiffness else None

    @property
    def varies_parcels(self) -> bool:
        """Whether there is anything to draw of a parcel itself."""
        return bool(self.mass or self.size or self.com_offset)

    def draw_entry(self, rng: np.random.Generator, parcel: Parcel) -> tuple[Parcel, float, float]:
        """A parcel as it is drawn to be, how far aside [m] and how far turned [rad] it starts."""
        if self.varies_parcels:
            parcel = self._draw_parcel(rng, parcel)
        aside = self.lateral * float(rng.standard_normal()) if self.lateral else 0.0
        turned = self.heading * float(rng.standard_normal()) if self.heading else 0.0
        return parcel, aside, turned

    def _draw_parcel(self, rng: np.random.Generator, parcel: Parcel) -> Parcel:
        mass, size = _factor(rng, self.mass), _factor(rng, self.size)
        base = parcel.base.scaled(size)
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
