"""The plants of the environments: which elements are rotors, and which of them obey."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from surface_gym.bases import Base
from surface_gym.lanes.memory import Geometry
from surface_gym.layouts import LINE_Y

PITCH = 0.1  # [m]
ORIGIN = 0.05  # [m] centre of element [0, 0], in x and in y
GEOMETRY = Geometry(ORIGIN, ORIGIN, PITCH, LINE_Y)


class Site(NamedTuple):
    """Where a parcel of some size runs."""

    rotor: NDArray[np.bool_]  # (rows, columns) a rotor, else a support
    zone: tuple[int, int, int, int]  # first row, rows, first column, columns that obey


class Plant(Protocol):
    """What an environment asks of a plant."""

    def __hash__(self) -> int: ...

    @property
    def rows(self) -> int:
        """Elements across."""

    @property
    def columns(self) -> int:
        """Elements along."""

    @property
    def zone_rows(self) -> int:
        """Rows of the widest zone."""

    @property
    def zone_columns(self) -> int:
        """Columns of the zone, where none is given."""

    def site(self, base: Base, zone: tuple[int, int] | None) -> Site:
        """The site for a base; `zone` holds the first and last column that obey."""


@dataclass(frozen=True)
class Line:
    """A line of rotors amid supports, as in the paper's Figure 6.

    Its rows and its lead-in, which stays at 90 deg as a conveyor would, follow the paper's for
    the S-box (2 rows, 3 columns) and the B-box (4 rows, 5 columns).
    """

    rows: int = 20
    columns: int = 30
    zone_rows: int = 4
    zone_columns: int = 16

    def site(self, base: Base, zone: tuple[int, int] | None) -> Site:
        """The line for a base.

        Raises:
            ValueError: the base is too long or too wide for the line.
        """
        length, width = np.ptp(base.outline, axis=0)
        rows = 2 * max(1, int(width / (2.0 * PITCH) + 1e-9))
        lead_in = int(np.ceil(length / PITCH - 1e-9))
        longest = self.columns - self.zone_columns
        if rows > self.zone_rows or lead_in > longest:
            raise ValueError(
                f"parcel must be at most {PITCH * longest:g} m long and less than "
                f"{PITCH * (self.zone_rows + 2):g} m wide, got {length:g} m x {width:g} m"
            )
        first_row = (self.rows - rows) // 2
        rotor = np.zeros((self.rows, self.columns), dtype=bool)
        rotor[first_row : first_row + rows] = True
        first, last = (lead_in, lead_in + self.zone_columns - 1) if zone is None else zone
        return Site(rotor, (first_row, rows, first, last - first + 1))


@dataclass(frozen=True)
class Field:
    """Rotors everywhere."""

    rows: int = 20
    columns: int = 60

    @property
    def zone_rows(self) -> int:
        return self.rows

    @property
    def zone_columns(self) -> int:
        return self.columns

    def site(self, base: Base, zone: tuple[int, int] | None) -> Site:
        """The field, whatever the base."""
        del base
        first, last = (0, self.columns - 1) if zone is None else zone
        rotor = np.ones((self.rows, self.columns), dtype=bool)
        return Site(rotor, (0, self.rows, first, last - first + 1))
