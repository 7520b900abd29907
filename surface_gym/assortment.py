"""An assortment: parcels as a sorting hall sees them, of many shapes and sizes, loaded unevenly."""

import math

import numpy as np
from numpy.typing import NDArray

from surface_gym import bounds, checks
from surface_gym.bases import Base, Disc, Polygon, Rectangle
from surface_gym.parcel import Parcel

CORNERS = (5, 8)  # of a polygon at least, and fewer than
MOST_DRAWS = 1000  # of a polygon: one in three is drawn again


def assortment(
    count: int,
    seed: int,
    sizes: tuple[float, float] = (0.2, 0.45),
    load: float = 0.03,
) -> tuple[Parcel, ...]:
    """Squares, rectangles, discs and convex polygons in turn, the same for the same seed.

    Length and width: uniform in `sizes`, of a polygon that of the circle it is inscribed in.
    Centre of mass: uniform in a disc of radius `load` around the base's centroid, within the base.

    Args:
        count: of parcels.
        seed: of the draws.
        sizes: [m] least and greatest length and width.
        load: [m] how far off centre the load may lie.

    Raises:
        ValueError: a number that is not allowed.
    """
    checks.integer("count", count, least=1)
    low, high = checks.array("sizes", sizes, (2,)).tolist()
    if not bounds.LENGTH[0] <= low <= high <= bounds.LENGTH[1]:
        raise ValueError(f"sizes must rise within {bounds.LENGTH} m, got {sizes!r}")
    checks.not_negative("load", load, bounds.LENGTH[1])
    rng = np.random.default_rng(checks.integer("seed", seed, least=0))
    return tuple(_loaded(rng, _base(rng, k % 4, low, high), load) for k in range(count))


def _base(rng: np.random.Generator, kind: int, low: float, high: float) -> Base:
    length, width = rng.uniform(low, high, 2).tolist()
    if kind == 0:
        return Rectangle(length, length)
    if kind == 1:
        return Rectangle(length, width)
    if kind == 2:
        return Disc(0.5 * length)
    return _polygon(rng, low, length)


def _polygon(rng: np.random.Generator, low: float, length: float) -> Polygon:
    """Corners uniform on a circle, drawn again until it is as wide as the least size, three
    quarters of it at the least circles, which no other would be.
    """
    least = min(low, 0.75 * length)
    for _ in range(MOST_DRAWS):
        angle = np.sort(rng.uniform(0.0, 2.0 * math.pi, rng.integers(*CORNERS)))
        corners = 0.5 * length * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        if np.ptp(corners, axis=0).min() >= least and _is_convex_around(angle):
            return Polygon(corners)
    raise ValueError(f"sizes must let a polygon be drawn, got {low:g} m and {length:g} m")


def _is_convex_around(angle: NDArray[np.float64]) -> bool:
    """Whether no gap between corners is half the circle, and none so small that they are one."""
    gaps = np.diff(angle, append=angle[0] + 2.0 * math.pi)
    return bool(gaps.max() < 0.9 * math.pi and gaps.min() > 0.1)


def _loaded(rng: np.random.Generator, base: Base, load: float) -> Parcel:
    """A parcel on a base, its load off centre."""
    for _ in range(MOST_DRAWS):
        offset = load * rng.uniform(-1.0, 1.0, 2)
        x, y = np.array(base.centroid) + offset
        if np.hypot(*offset) <= load and base.functions(x, y).max() <= 0.0:
            return Parcel(base, com_offset=(float(offset[0]), float(offset[1])))
    raise ValueError(f"load must lie over most bases, got {load:g} m")
