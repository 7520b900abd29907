"""The layouts of a zone as rows of numbers, as a search takes them."""

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]

QUARTER = math.pi / 2.0
DECIMALS = 2  # of degrees, where any angle may be
ALL_AT_ONCE = 256  # arrangements of a column that are tried together; of more, module by module
SHIFTS = np.radians([-22.5, -5.0, -1.0, 1.0, 5.0, 22.5])  # tried where any angle may be


@dataclass(frozen=True)
class Space:
    """The layouts that are searched: a number a module, row by row.

    It is the place of the module's axis among the orientations, or the axis itself [rad].
    """

    rows: int
    columns: int
    orientations: tuple[float, ...] | None  # [rad] on offer, rising; None: any

    @property
    def modules(self) -> int:
        """How many there are."""
        return self.rows * self.columns

    @property
    def bounds(self) -> tuple[float, float]:
        """Least and greatest number of a module."""
        return (-QUARTER, QUARTER) if self.orientations is None else (0, len(self.orientations) - 1)

    def axes(self, members: Numbers) -> Numbers:
        """Axes (members, rows, columns) [rad] of members (members, modules)."""
        shape = (len(members), self.rows, self.columns)
        if self.orientations is None:
            return np.radians(np.degrees(members).round(DECIMALS)).reshape(shape)
        return np.array(self.orientations)[np.rint(members).astype(int)].reshape(shape)

    def members(self, axes: Numbers) -> Numbers:
        """Members (layouts, modules) nearest to axes (layouts, rows, columns) [rad]."""
        flat = axes.reshape(len(axes), -1)
        if self.orientations is None:
            return np.arctan(np.tan(flat))
        apart = np.abs(np.sin(flat[..., np.newaxis] - np.array(self.orientations)))
        return apart.argmin(axis=-1).astype(np.float64)

    def drawn(self, rng: np.random.Generator, count: int) -> Numbers:
        """Members (count, modules) by chance."""
        low, high = self.bounds
        if self.orientations is None:
            return rng.uniform(low, high, (count, self.modules))
        return rng.integers(0, len(self.orientations), (count, self.modules)).astype(np.float64)

    def neighbours(self, member: Numbers, column: int) -> Numbers:
        """Members (some, modules) that differ from one (modules,) in a column."""
        own = np.arange(self.rows) * self.columns + column
        if self.orientations is None:
            one = SHIFTS[:, np.newaxis, np.newaxis] * np.eye(self.rows)
            every = SHIFTS[:, np.newaxis] * np.ones(self.rows)
            tried = member[own] + np.concatenate([one.reshape(-1, self.rows), every])
            tried = np.arctan(np.tan(tried))
        elif len(self.orientations) ** self.rows <= ALL_AT_ONCE:
            every_way = itertools.product(range(len(self.orientations)), repeat=self.rows)
            tried = np.array(list(every_way), dtype=np.float64)
        else:
            places = np.arange(len(self.orientations), dtype=np.float64)
            tried = np.tile(member[own], (self.rows, len(places), 1))
            tried[np.arange(self.rows), :, np.arange(self.rows)] = places
            tried = tried.reshape(-1, self.rows)
        around = np.tile(member, (len(tried), 1))
        around[:, own] = tried
        return around
