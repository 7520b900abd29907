"""Features of observations: scales, columns, and values in SI units.

A feature is one number of an observation: (value - offset) / scale, or the hyperbolic tangent of
this number. Kernels write features, decoders read them, and the documentation lists them.
"""

import hashlib
import math
import re
from collections import namedtuple
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, NamedTuple

from surface_gym import checks
from surface_gym.compiler.jit import kernel_function

DIGITS = 12  # hexadecimal digits of a digest


@dataclass(frozen=True)
class Feature:
    """Definition of one number of an observation."""

    name: str
    low: float  # [-] lower bound
    high: float  # [-] upper bound
    meaning: str = ""
    unit: str = ""  # unit of value, offset and scale
    scale: float = 1.0
    offset: float = 0.0
    bent: bool = False  # whether it is the hyperbolic tangent, which cannot be decoded

    def __post_init__(self) -> None:
        checks.positive(f"scale of feature {self.name!r}", self.scale)
        checks.number(f"offset of feature {self.name!r}", self.offset)
        if not self.low < self.high:
            raise ValueError(
                f"low of feature {self.name!r} must be below high, got {self.low!r} and {self.high!r}"
            )

    @property
    def formula(self) -> str:
        """Return the formula of the feature, for tables."""
        unit = f" {self.unit}" if self.unit else ""
        text = f"value - {self.offset:g}{unit}" if self.offset else "value"
        if self.scale != 1.0 or self.unit:
            text = f"({text})" if self.offset else text
            text = f"{text} / {self.scale:g}{unit}"
        return f"tanh({text})" if self.bent else text


class Column(NamedTuple):
    """Column and scale of a feature, compiled into kernels as constants."""

    place: int
    offset: float
    scale: float
    low: float
    high: float

    def of(self, table: Any) -> Any:
        """Return the feature's values (...) in SI units from observations (..., features)."""
        return decode(self, table[..., self.place])


def find_columns(features: Iterable[Feature]) -> dict[str, Column]:
    """Return the `Column` of each feature by the feature's name."""
    found: dict[str, Column] = {}
    for place, each in enumerate(features):
        if each.name in found:
            raise ValueError(f"features must have names that differ, got {each.name!r} twice")
        found[each.name] = Column(place, each.offset, each.scale, each.low, each.high)
    return found


def columns(features: Iterable[Feature]) -> Any:
    """Return the `Column`s of features as attributes, e.g. `columns(FEATURES).lateral_offset`.

    Letters and digits of a name stay; all other characters become underscores. A missing name
    raises an AttributeError in Python, and a compiler error in a kernel.
    """
    found = find_columns(features)
    names = [re.sub("[^0-9a-z]+", "_", name.lower()).strip("_") for name in found]
    make: Any = namedtuple  # its names are not literals
    return make("Columns", names)(*found.values())


def compute_digest(features: Iterable[Feature]) -> str:
    """Compute a digest of the names and formulas of features. A policy's card stores the digest."""
    shown = [(each.name, each.offset, each.scale, each.bent) for each in features]
    return hashlib.sha256(repr(shown).encode()).hexdigest()[:DIGITS]


@kernel_function
def encode(column: Column, value: float) -> float:
    """Return the feature [-], i.e. (value - offset) / scale, of a value in SI units."""
    return (value - column.offset) / column.scale


@kernel_function
def decode(column: Column, shown: Any) -> Any:
    """Convert the observed feature `shown` [-], a number or an array, to a value in SI units."""
    value = shown if column.scale == 1.0 else column.scale * shown
    return value if column.offset == 0.0 else column.offset + value


@kernel_function
def read(row: Any, column: Column) -> float:
    """Read the value of a feature, in SI units, from an observation `row` (features,)."""
    return decode(column, row[column.place])


@kernel_function
def show(see: Any, column: Column, value: float) -> None:
    """Encode `value`, in SI units, and write the feature into the observation `see` (features,)."""
    see[column.place] = encode(column, value)


@kernel_function
def show_within(see: Any, column: Column, value: float) -> None:
    """Write the feature of a value in SI units into `see`. The feature is clipped to its bounds."""
    see[column.place] = min(column.high, max(column.low, encode(column, value)))


@kernel_function
def show_bent(see: Any, column: Column, value: float) -> None:
    """Write tanh((value - offset) / scale) of a value in SI units into `see` (features,)."""
    see[column.place] = math.tanh(encode(column, value))
