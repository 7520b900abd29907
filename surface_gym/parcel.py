"""Parcels: bases, mass and load, and random assortments."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surface_gym import checks
from surface_gym.physics.types import Bodies, Body


class Base(Protocol):
    """The interface of a base. All lengths are in the base's own frame.

    A base is convex. Its points are inside of all edges, and inside of a circle around the
    centroid.
    """

    @property
    def centroid(self) -> tuple[float, float]:
        """Return the centre [m] of the area."""

    @property
    def gyration(self) -> float:
        """Return the squared radius of gyration [m^2] about the centroid, for an even load."""

    @property
    def reach(self) -> float:
        """Return the distance [m] from the centroid to the farthest point."""

    @property
    def edges(self) -> NDArray[np.float64]:
        """Return one row per edge, shape (edges, 3).

        A row has the outward normal and the distance [m] to the centroid. Discs have no edges.
        """

    @property
    def outline(self) -> NDArray[np.float64]:
        """Return the perimeter (points, 2) [m], anti-clockwise."""

    def functions(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Return the signed distances (edges, ...) [m] of points (...) from the edges.

        A distance is negative if the point is on the inner side of the edge. The distances are the
        functions F_lambda of the paper's Section 3.2. A disc has a single edge, its rim.
        """

    def scaled(self, factor: float) -> "Base":
        """Return the same shape with every length multiplied by a factor."""


def check_base(base: Any) -> None:
    """Raise a ValueError if an object lacks members of `Base`, or if their values are invalid."""
    asked = ("centroid", "gyration", "reach", "edges", "outline", "functions", "scaled")
    lacks = [name for name in asked if isinstance(base, type) or not hasattr(base, name)]
    if lacks:
        raise ValueError(
            f"base must be a Rectangle, a Disc or a Polygon, got {base!r}; "
            f"a Base of your own must have {', '.join(lacks)} too"
        )
    if not isinstance(base, (Rectangle, Disc, Polygon)):
        checks.array("base.edges", base.edges, (None, 3))
        checks.array("base.outline", base.outline, (None, 2))
        checks.array("base.centroid", base.centroid, (2,))
        reach = checks.positive("base.reach", base.reach, *checks.LENGTH)
        least, most = ((part * reach) ** 2 for part in checks.GYRATION)
        checks.positive("base.gyration", base.gyration, least, most)
        try:
            hash(base)
        except TypeError:
            raise ValueError(
                f"base must be hashable, as a frozen dataclass is, got {base!r}"
            ) from None


def _edge_functions(
    edges: NDArray[np.float64], centroid: tuple[float, float], x: ArrayLike, y: ArrayLike
) -> NDArray[np.float64]:
    dx = np.asarray(x, dtype=np.float64) - centroid[0]
    dy = np.asarray(y, dtype=np.float64) - centroid[1]
    return np.stack([nx * dx + ny * dy - distance for nx, ny, distance in edges])


def _read_only(array: NDArray[np.float64]) -> NDArray[np.float64]:
    """Make an array read-only, so that it can be shared, and return it."""
    array.flags.writeable = False
    return array


@dataclass(frozen=True)
class Rectangle:
    """A rectangular base, centred on its frame's origin. The paper calls the sides b and h.

    >>> Rectangle(0.25, 0.25).functions(0.0, 0.2).max() <= 0  # (0, 0.2) is outside
    np.False_
    """

    length: float  # [m] b, along the base's x
    width: float  # [m] h, along its y

    def __post_init__(self) -> None:
        length = (checks.positive, *checks.LENGTH)
        checks.settle(self, length=length, width=length)

    @cached_property
    def centroid(self) -> tuple[float, float]:
        return (0.0, 0.0)

    @cached_property
    def gyration(self) -> float:
        return (self.length**2 + self.width**2) / 12.0  # Table 1

    @cached_property
    def reach(self) -> float:
        return math.hypot(self.length, self.width) / 2.0

    @cached_property
    def edges(self) -> NDArray[np.float64]:
        b, h = self.length / 2.0, self.width / 2.0
        return _read_only(np.array([[1.0, 0.0, b], [-1.0, 0.0, b], [0.0, 1.0, h], [0.0, -1.0, h]]))

    @cached_property
    def outline(self) -> NDArray[np.float64]:
        b, h = self.length / 2.0, self.width / 2.0
        return _read_only(np.array([[-b, -h], [b, -h], [b, h], [-b, h]]))

    def functions(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        return _edge_functions(self.edges, self.centroid, x, y)

    def scaled(self, factor: float) -> "Rectangle":
        return Rectangle(self.length * factor, self.width * factor)


@dataclass(frozen=True)
class Disc:
    """A round base, centred on its frame's origin."""

    radius: float  # [m]

    def __post_init__(self) -> None:
        checks.settle(self, radius=(checks.positive, *checks.LENGTH))

    @cached_property
    def centroid(self) -> tuple[float, float]:
        return (0.0, 0.0)

    @cached_property
    def gyration(self) -> float:
        return self.radius**2 / 2.0

    @cached_property
    def reach(self) -> float:
        return self.radius

    @cached_property
    def edges(self) -> NDArray[np.float64]:
        return _read_only(np.zeros((0, 3)))

    @cached_property
    def outline(self) -> NDArray[np.float64]:
        angle = np.linspace(0.0, 2.0 * np.pi, 64, endpoint=False)
        return _read_only(self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1))

    def functions(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        distance = np.hypot(np.asarray(x, dtype=np.float64), np.asarray(y, dtype=np.float64))
        return (distance - self.radius)[np.newaxis]

    def scaled(self, factor: float) -> "Disc":
        return Disc(self.radius * factor)


@dataclass(frozen=True, eq=False)
class Polygon:
    """A convex base given by its vertices, clockwise or anti-clockwise."""

    vertices: NDArray[np.float64]  # (vertices, 2) [m] in the base's frame

    def __post_init__(self) -> None:
        vertices = checks.array("vertices", self.vertices, (None, 2))
        checks.limited("vertices", vertices, checks.LENGTH[1])
        if len(vertices) < 3:
            raise ValueError(f"vertices must be at least 3, got {len(vertices)}")
        side = np.roll(vertices, -1, axis=0) - vertices
        if (np.hypot(side[:, 0], side[:, 1]) == 0.0).any():
            raise ValueError(f"vertices must differ from their neighbours, got {vertices.tolist()}")
        after = np.roll(side, -1, axis=0)
        turn = np.arctan2(
            side[:, 0] * after[:, 1] - side[:, 1] * after[:, 0], (side * after).sum(axis=1)
        )
        # At a vertex within a side, the turn is only round-off. A negative turn is not convex.
        one_way = (turn > -1e-9).all() or (turn < 1e-9).all()
        turns_back = (np.abs(turn) > np.pi - 1e-9).any()
        if turns_back or not (one_way and abs(abs(turn.sum()) - 2.0 * np.pi) < 1e-6):
            raise ValueError(f"vertices must form a convex polygon, got {vertices.tolist()}")
        x, y = vertices.T
        area = 0.5 * abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1))))
        if area < checks.LENGTH[0] ** 2:
            raise ValueError(
                f"vertices must enclose at least {checks.LENGTH[0] ** 2:g} m^2, got {area:g} m^2"
            )
        checks.set_fields(self, vertices=vertices)

    def __reduce__(self) -> tuple[Any, ...]:
        """Let `pickle` and `copy` call the constructor, so that the array becomes read-only."""
        return (Polygon, (self.vertices,))

    @cached_property
    def outline(self) -> NDArray[np.float64]:
        x, y = self.vertices.T
        anti_clockwise = np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) > 0.0
        return _read_only(np.array(self.vertices if anti_clockwise else self.vertices[::-1]))

    @cached_property
    def _triangles(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return three arrays that describe the triangles between the first vertex and each side.

        The first array (sides,) [m^2] holds twice the area of each triangle. The next two arrays
        (sides, 2) [m] hold the start and the end of each side, relative to the first vertex.
        """
        start = self.outline - self.outline[0]
        end = np.roll(start, -1, axis=0)
        return start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0], start, end

    @cached_property
    def centroid(self) -> tuple[float, float]:
        area, start, end = self._triangles
        x, y = self.outline[0] + (area @ (start + end)) / (3.0 * area.sum())
        return (float(x), float(y))

    @cached_property
    def gyration(self) -> float:
        area, start, end = self._triangles
        squares = (start**2 + start * end + end**2).sum(axis=1)
        offset = np.array(self.centroid) - self.outline[0]
        return float(area @ squares / (6.0 * area.sum()) - offset @ offset)

    @cached_property
    def reach(self) -> float:
        offset = self.vertices - np.array(self.centroid)
        return float(np.hypot(offset[:, 0], offset[:, 1]).max())

    @cached_property
    def edges(self) -> NDArray[np.float64]:
        corner = self.outline - np.array(self.centroid)
        side = np.roll(corner, -1, axis=0) - corner
        normal = np.stack([side[:, 1], -side[:, 0]], axis=-1)
        normal /= np.hypot(side[:, 0], side[:, 1])[:, np.newaxis]
        return _read_only(np.column_stack([normal, (normal * corner).sum(axis=1)]))

    def functions(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        return _edge_functions(self.edges, self.centroid, x, y)

    def scaled(self, factor: float) -> "Polygon":
        return Polygon(self.vertices * factor)


@dataclass(frozen=True)
class Parcel:
    """A rigid parcel. Its pose is the pose of its base's frame. Defaults are from Table 1.

    Raises:
        ValueError: the base is not a `Base`, the centre of mass is not over the base, or a number
            is outside the limits of `surface_gym.checks`.

    >>> from surface_gym import Rectangle
    >>> round(Parcel(Rectangle(0.25, 0.25)).moment_of_inertia, 4)  # m (b^2 + h^2) / 12
    0.1042
    """

    base: Base
    mass: float = 10.0  # [kg]
    com_height: float = 0.1  # [m] z_g, centre of mass above the base
    inertia: float | None = None  # [kg m^2] about the vertical axis through the centre of mass
    com_offset: tuple[float, float] = (0.0, 0.0)  # [m] centre of mass from the base's centroid

    def __post_init__(self) -> None:
        check_base(self.base)
        height = (checks.not_negative, checks.COM_HEIGHT)
        checks.settle(self, mass=(checks.positive, *checks.MASS), com_height=height)
        if self.inertia is not None:
            least, most = (self.mass * (part * self.base.reach) ** 2 for part in checks.GYRATION)
            checks.settle(self, inertia=(checks.positive, least, most))
        checks.settle(self, com_offset=checks.place)
        if self.base.functions(*self.centre_of_mass).max() > 0.0:
            raise ValueError(
                f"com_offset must keep the centre of mass over the base, got {self.com_offset}"
            )

    @cached_property
    def centre_of_mass(self) -> tuple[float, float]:
        """Return the projection [m] of the centre of mass on the base, in the base's frame."""
        x, y = self.base.centroid
        return (x + self.com_offset[0], y + self.com_offset[1])

    @cached_property
    def rear(self) -> float:
        """Return the x distance [m] from the base's rearmost point to the base frame's origin."""
        return -float(self.base.outline[:, 0].min())

    @property
    def moment_of_inertia(self) -> float:
        """Return the moment of inertia J [kg m^2]. If `inertia` is None, mass is evenly spread."""
        return self.mass * self.base.gyration if self.inertia is None else self.inertia

    @cached_property
    def body(self) -> Body:
        """Return the parcel as input of the compiled physics."""
        return Body(
            edges=np.asarray(self.base.edges, dtype=np.float64),
            radius=self.base.reach,
            com_x=self.com_offset[0],
            com_y=self.com_offset[1],
            com_height=self.com_height,
            gyration=self.base.gyration if self.inertia is None else self.inertia / self.mass,
        )

    @cached_property
    def row(self) -> NDArray[np.float64]:
        """Return the parcel's row (7,) of `Bodies.body`."""
        half_length = -float((self.base.outline - np.array(self.base.centroid))[:, 0].min())
        return _read_only(np.array([*self.body[1:], half_length, self.mass]))

    @cached_property
    def corners(self) -> NDArray[np.float64]:
        """Return corners (n, 2) [m] relative to the centroid. A disc has one corner, at (0, 0)."""
        outline = self.base.outline - np.array(self.base.centroid)
        return _read_only(outline if len(self.body.edges) else np.zeros((1, 2)))


NO_EDGE = (0.0, 1.0, 1e9)  # padding: no point lies beyond it


def filled_up(
    edges: NDArray[np.float64], corners: NDArray[np.float64], sides: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Pad a base's edges to (sides, 3) and corners to (sides, 2) [m]. The base stays the same."""
    more = (NO_EDGE,) * (sides - len(edges))
    repeats = np.repeat(corners[:1], sides - len(corners), axis=0)
    return np.concatenate([edges, np.reshape(more, (-1, 3))]), np.concatenate([corners, repeats])


def make_bodies(parcels: Sequence[Parcel]) -> Bodies:
    """Return parcels as input of the compiled physics. Each parcel has one row."""
    sides = max(3, *(len(parcel.corners) for parcel in parcels))
    bases = [filled_up(parcel.body.edges, parcel.corners, sides) for parcel in parcels]
    edges, corners = map(np.stack, zip(*bases, strict=True))
    return Bodies(np.stack([parcel.row for parcel in parcels]), edges, corners)


CORNERS = (5, 8)  # range of a polygon's number of corners, the upper end excluded
MOST_DRAWS = 1000  # maximum per polygon; one draw in three is rejected


def assortment(
    count: int,
    seed: int,
    sizes: tuple[float, float] = (0.2, 0.45),
    load: float = 0.03,
) -> tuple[Parcel, ...]:
    """Draw parcels whose bases are squares, rectangles, discs and convex polygons in turn.

    The same `seed` gives the same parcels. Length and width are uniform in `sizes`. A polygon's
    length is the diameter of its circumscribed circle. The centre of mass is uniform in the part of
    the base that is at most `load` [m] from the centroid.

    Args:
        sizes: [m] smallest and largest length and width.
        load: [m] maximum distance of the centre of mass from the centroid.
    """
    checks.integer("count", count, least=1)
    low, high = checks.array("sizes", sizes, (2,)).tolist()
    if not checks.LENGTH[0] <= low <= high <= checks.LENGTH[1]:
        raise ValueError(f"sizes must rise within {checks.LENGTH} m, got {sizes!r}")
    checks.not_negative("load", load, checks.LENGTH[1])
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
    """Draw corners uniformly on a circle of diameter `length` [m] until the polygon is wide enough.

    The polygon's extents in x and y must be at least the smaller of `low` [m] and 0.75 * `length`.
    """
    least = min(low, 0.75 * length)
    for _ in range(MOST_DRAWS):
        angle = np.sort(rng.uniform(0.0, 2.0 * math.pi, rng.integers(*CORNERS)))
        corners = 0.5 * length * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        if np.ptp(corners, axis=0).min() >= least and _is_convex_around(angle):
            return Polygon(corners)
    raise ValueError(f"sizes must let a polygon be drawn, got {low:g} m and {length:g} m")


def _is_convex_around(angle: NDArray[np.float64]) -> bool:
    """Return whether the directions of neighbouring corners differ by 0.1 rad to 0.9 pi rad.

    The array `angle` (corners,) [rad] holds the directions from the centre, in ascending order.
    """
    gaps = np.diff(angle, append=angle[0] + 2.0 * math.pi)
    return bool(gaps.max() < 0.9 * math.pi and gaps.min() > 0.1)


def _loaded(rng: np.random.Generator, base: Base, load: float) -> Parcel:
    """Return a parcel with this base. Its centre of mass is up to `load` [m] from the centroid."""
    for _ in range(MOST_DRAWS):
        offset = load * rng.uniform(-1.0, 1.0, 2)
        x, y = np.array(base.centroid) + offset
        if np.hypot(*offset) <= load and base.functions(x, y).max() <= 0.0:
            return Parcel(base, com_offset=(float(offset[0]), float(offset[1])))
    raise ValueError(f"load must lie over most bases, got {load:g} m")
