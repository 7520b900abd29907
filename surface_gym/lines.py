"""Lines: the surfaces of environments, with their rotors and obeying modules."""

import math
from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surface_gym import checks
from surface_gym.layouts import LINE_Y, lead_in_under, rows_under
from surface_gym.parcel import Base
from surface_gym.physics.types import Array, Booleans
from surface_gym.state import Geometry
from surface_gym.surface import Elements, Surface

ORIENTATIONS = (0.0, math.pi / 4, -math.pi / 4, math.pi / 2)  # [rad] the paper's Figure 2b


class Site(NamedTuple):
    """The rotors and the zone of a line. They may depend on the size of the parcel."""

    rotor: Booleans  # (rows, columns) a rotor, else a support
    zone: tuple[int, int, int, int]  # first row, rows, first column, columns that obey


@dataclass(frozen=True, kw_only=True)
class BaseLine(Elements):
    """Elements on a grid, with their friction and possible axis angles. Subclasses place rotors.

    A friction coefficient is one number, or an array (rows, columns) with one value per element.
    """

    pitch: float | tuple[float, float] = 0.1  # [m] distance of neighbours: one number, or x and y
    origin: tuple[float, float] = (0.05, 0.05)  # [m] centre of element [0, 0]
    mu_max: Any = 0.5  # [-] friction along a rotor's axis
    mu_min: Any = 0.01  # [-] friction across it
    mu_support: Any = 0.005  # [-] friction of a support
    orientations: tuple[float, ...] = ORIENTATIONS  # [rad] available axis angles

    def __post_init__(self) -> None:
        checks.settle(self, pitch=checks.pitch, origin=checks.place)
        if self.rows * self.columns > checks.ELEMENTS:
            raise ValueError(
                f"rows times columns must be at most {checks.ELEMENTS:_}, "
                f"got {self.rows} and {self.columns}"
            )
        for name in ("mu_max", "mu_min", "mu_support"):
            mu = checks.friction(name, getattr(self, name), (self.rows, self.columns)).tolist()
            mu = mu if isinstance(mu, float) else tuple(map(tuple, mu))
            checks.set_fields(self, **{name: mu})
        checks.rolling(self.mu_max, self.mu_min)
        checks.settle(self, orientations=checks.orientations)

    @property
    @abstractmethod
    def zone_rows(self) -> int:
        """Return the largest number of rows that a zone can have."""

    @property
    @abstractmethod
    def zone_columns(self) -> int:
        """Return the number of columns of the default zone."""

    @abstractmethod
    def site(self, base: Base, zone: tuple[int, int] | None = None) -> Site:
        """Return rotors and zone for a base. If given, `zone` is the zone's first and last column.

        Raises:
            ValueError: the base is too large for the line.
        """

    @property
    def line_y(self) -> float:
        """Return y [m] at which parcels enter."""
        return self.origin[1] + 0.5 * self.pitch_y * (self.rows - 1)

    @property
    def length(self) -> float:
        """Return the distance [m] along x between the outer edges of the elements."""
        return self.pitch_x * self.columns

    @property
    def width(self) -> float:
        """Return the distance [m] along y between the outer edges of the elements."""
        return self.pitch_y * self.rows

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Return minimum x, maximum x, minimum y and maximum y [m] of the elements' outer edges."""
        left, low = self.column_edge(0), self.origin[1] - 0.5 * self.pitch_y
        return left, left + self.length, low, low + self.width

    @property
    def geometry(self) -> Geometry:
        """Return the positions of the elements for compiled code."""
        return Geometry(*self.origin, self.pitch_x, self.pitch_y, self.line_y)

    def surface(self, axis: Array, rotor: Booleans) -> Surface:
        """Return a surface for `simulate`. `axis` [rad] and `rotor` are arrays (rows, columns)."""
        mu_max, mu_min, mu_support = np.moveaxis(self.friction, -1, 0)
        return Surface(axis, rotor, self.pitch, self.origin, mu_max, mu_min, mu_support)

    def column_edge(self, column: float) -> float:
        """Return x [m] half a pitch before the centre of a column."""
        return self.origin[0] + self.pitch_x * (column - 0.5)


@dataclass(frozen=True)
class Line(BaseLine):
    """A line of rotors among supports, as in the paper's Figure 6.

    The numbers of rows and lead-in columns depend on the parcel: 2 rows and 3 columns for the
    S-box, 4 rows and 5 columns for the B-box. The lead-in stays at 90 deg, like a conveyor.
    """

    rows: int = 20
    columns: int = 30
    zone_rows: int = 4  # rows of the widest line, an even number
    zone_columns: int = 16
    line_y: float = LINE_Y  # [m] middle of the line, halfway between two rows

    def __post_init__(self) -> None:
        for name in ("rows", "columns", "zone_rows", "zone_columns"):
            checks.integer(name, getattr(self, name), least=1)
        super().__post_init__()
        checks.settle(self, line_y=checks.coordinate)
        between = (self.line_y - self.origin[1]) / self.pitch_y - 0.5
        half = self.zone_rows // 2
        if self.zone_rows % 2 or self.zone_columns >= self.columns:
            raise ValueError(
                f"zone_rows must be even and zone_columns less than columns, "
                f"got {self.zone_rows} and {self.zone_columns} of {self.columns}"
            )
        if abs(between - round(between)) > 1e-6 or not half <= between + 1 <= self.rows - half:
            raise ValueError(
                f"line_y must lie halfway between two rows, {half} or more of them to either side, "
                f"got {self.line_y!r}"
            )

    def site(self, base: Base, zone: tuple[int, int] | None = None) -> Site:
        length, width = np.ptp(base.outline, axis=0)
        rows, lead_in = rows_under(width, self.pitch_y), lead_in_under(length, self.pitch_x)
        longest = self.columns - self.zone_columns
        if rows > self.zone_rows or lead_in > longest:
            raise ValueError(
                f"parcel must be at most {self.pitch_x * longest:g} m long and less than "
                f"{self.pitch_y * (self.zone_rows + 2):g} m wide, got {length:g} m x {width:g} m"
            )
        self.check_capacity(base, (self.columns, self.rows))
        first_row = round((self.line_y - self.origin[1]) / self.pitch_y - 0.5 * (rows - 1))
        rotor = np.zeros((self.rows, self.columns), dtype=bool)
        rotor[first_row : first_row + rows] = True
        first, last = (lead_in, lead_in + self.zone_columns - 1) if zone is None else zone
        return Site(rotor, (first_row, rows, first, last - first + 1))


@dataclass(frozen=True)
class Field(BaseLine):
    """A field with rotors everywhere."""

    rows: int = 20
    columns: int = 60

    def __post_init__(self) -> None:
        checks.integer("rows", self.rows, least=1)
        checks.integer("columns", self.columns, least=1)
        super().__post_init__()

    @property
    def zone_rows(self) -> int:
        return self.rows

    @property
    def zone_columns(self) -> int:
        return self.columns

    def site(self, base: Base, zone: tuple[int, int] | None = None) -> Site:
        self.check_capacity(base, (self.columns, self.rows))
        first, last = (0, self.columns - 1) if zone is None else zone
        rotor = np.ones((self.rows, self.columns), dtype=bool)
        return Site(rotor, (0, self.rows, first, last - first + 1))


@dataclass(frozen=True)
class Pattern(BaseLine):
    """A line with any pattern of rotors and supports.

    Rotors in the first `lead_in` columns stay at 90 deg. All other rotors obey commands. The zone
    extends over the rows from the first obeying rotor to the last obeying rotor. Parcels enter in
    the middle of these rows.
    """

    rotor: ArrayLike  # (rows, columns) of booleans: a rotor, else a support
    lead_in: int = 0  # columns that stay at 90 deg, like a conveyor

    def __post_init__(self) -> None:
        rotor = checks.booleans("rotor", self.rotor)
        checks.integer("lead_in", self.lead_in, least=0)
        if not rotor[:, self.lead_in :].any():
            raise ValueError(f"lead_in must leave a rotor in {rotor.shape}, got {self.lead_in!r}")
        checks.set_fields(self, rotor=tuple(map(tuple, rotor.tolist())))
        super().__post_init__()

    @property
    def rows(self) -> int:
        return len(self._pattern)

    @property
    def columns(self) -> int:
        return len(self._pattern[0])

    @cached_property
    def _pattern(self) -> Booleans:
        return np.array(self.rotor)

    @cached_property
    def _rotor_rows(self) -> tuple[int, int]:
        """Return the first and the last row with a rotor after the lead-in."""
        rows = np.nonzero(self._pattern[:, self.lead_in :].any(axis=1))[0]
        return int(rows[0]), int(rows[-1])

    @property
    def zone_rows(self) -> int:
        first, last = self._rotor_rows
        return last - first + 1

    @property
    def zone_columns(self) -> int:
        return self.columns - self.lead_in

    @property
    def line_y(self) -> float:
        """Return y [m] of the middle of the zone's rows."""
        return self.origin[1] + 0.5 * self.pitch_y * sum(self._rotor_rows)

    def site(self, base: Base, zone: tuple[int, int] | None = None) -> Site:
        self.check_capacity(base, (self.columns, self.rows))
        first, last = (self.lead_in, self.columns - 1) if zone is None else zone
        return Site(self._pattern, (self._rotor_rows[0], self.zone_rows, first, last - first + 1))
