"""The elements of a surface as a scene tells of them: what drawing asks for, and the checks."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surface_gym import checks

Zone = tuple[int, int, int, int]  # first row, rows, first column and columns


class Elements(Protocol):
    """A scene, as far as its surface goes."""

    @property
    def axis(self) -> NDArray[np.float64]:
        """(rows, columns) [rad] rotor axis from x, anti-clockwise."""

    @property
    def rotor(self) -> NDArray[np.bool_]:
        """(rows, columns) an orientable rotor, else a support."""

    @property
    def zone(self) -> Zone | None:
        """The modules that obey a controller; None: all do."""

    @property
    def origin(self) -> tuple[float, float]:
        """[m] centre of element [0, 0]."""

    @property
    def rows(self) -> int:
        """Number of elements across the line, in y."""

    @property
    def columns(self) -> int:
        """Number of elements along the line, in x."""

    @property
    def pitches(self) -> tuple[float, float]:
        """[m] from column to column, and from row to row."""

    @property
    def obeys(self) -> NDArray[np.bool_]:
        """(rows, columns) the elements in the zone."""


class OnElements:
    """What every scene says of its surface by the same fields."""

    axis: NDArray[np.float64]
    pitch: float | tuple[float, float]
    zone: Zone | None

    @property
    def rows(self) -> int:
        """Number of elements across the line, in y."""
        return int(self.axis.shape[0])

    @property
    def columns(self) -> int:
        """Number of elements along the line, in x."""
        return int(self.axis.shape[1])

    @property
    def pitches(self) -> tuple[float, float]:
        """[m] from column to column, and from row to row."""
        return (self.pitch, self.pitch) if isinstance(self.pitch, float) else self.pitch

    @property
    def obeys(self) -> NDArray[np.bool_]:
        """(rows, columns) the elements in the zone."""
        return obeying(self.axis.shape, self.zone)


def checked_axis(axis: ArrayLike) -> NDArray[np.float64]:
    """(rows, columns) [rad] of at least one element, or an error."""
    given = checks.array("axis", axis, (None, None))
    if given.size == 0:
        raise ValueError(f"axis must have at least one row and one column, got {given.shape}")
    return given


def checked_rotor(rotor: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Booleans of the axes' shape, or an error."""
    given = np.array(rotor)
    if given.dtype != np.bool_:
        raise ValueError(f"rotor must be an array of booleans, got one of {given.dtype}")
    if given.shape != shape:
        raise ValueError(f"rotor must have the shape of axis, {shape}, got {given.shape}")
    given.setflags(write=False)
    return given


def checked_zone(zone: Zone, rows: int, columns: int) -> Zone:
    """A block of elements within a surface of so many rows and columns, or an error."""
    if len(zone) != 4:
        raise ValueError(f"zone must be first row, rows, first column and columns, got {zone!r}")
    first_row = checks.integer("zone's first row", zone[0], least=0)
    zone_rows = checks.integer("zone's rows", zone[1], least=1)
    first_column = checks.integer("zone's first column", zone[2], least=0)
    zone_columns = checks.integer("zone's columns", zone[3], least=1)
    if first_row + zone_rows > rows or first_column + zone_columns > columns:
        raise ValueError(
            f"zone must lie within the {rows} rows and {columns} columns, got {zone!r}"
        )
    return (first_row, zone_rows, first_column, zone_columns)


def checked_outline(outline: ArrayLike) -> NDArray[np.float64]:
    """(points, 2) [m] of a polygon that encloses an area, or an error."""
    given = checks.array("outline", outline, (None, 2))
    if len(given) < 3:
        raise ValueError(f"outline must have at least 3 points, got {len(given)}")
    x, y = given.T
    if np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) == 0.0:
        raise ValueError(f"outline must enclose an area, got {given.tolist()}")
    return given


def checked_pose(name: str, pose: ArrayLike) -> tuple[float, float, float]:
    """A pose [m, m, rad] as numbers, or an error."""
    x, y, theta = checks.array(name, pose, (3,)).tolist()
    return (x, y, theta)


def check_readings(readings: Any) -> None:
    """Nothing where readings are pairs of texts, else an error."""
    pairs = all(
        isinstance(pair, tuple) and len(pair) == 2 and all(isinstance(t, str) for t in pair)
        for pair in readings
    )
    if not pairs:
        raise ValueError(f"readings must be pairs of label and text, got {readings!r}")


def obeying(shape: tuple[int, ...], zone: Zone | None) -> NDArray[np.bool_]:
    """(rows, columns) the elements in a zone; all without one."""
    if zone is None:
        return np.ones(shape, dtype=bool)
    row, rows, column, columns = zone
    obeys = np.zeros(shape, dtype=bool)
    obeys[row : row + rows, column : column + columns] = True
    return obeys
