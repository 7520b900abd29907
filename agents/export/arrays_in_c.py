"""Arrays as C has them."""

import textwrap
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

WIDTH = 100  # of a line


def single(value: float) -> str:
    """A float that reads back as the same."""
    return f"{_with_point(f'{value:.9g}')}f"


def double(value: float) -> str:
    """A double that reads back as the same."""
    return _with_point(repr(float(value)))


def table_of_singles(name: str, values: NDArray[np.float32]) -> str:
    """Floats, row by row."""
    return _table("float", name, map(single, values.ravel().tolist()), values.size)


def table_of_doubles(name: str, values: ArrayLike) -> str:
    """Doubles."""
    given = np.asarray(values, dtype=np.float64)
    return _table("double", name, map(double, given.tolist()), given.size)


def table_of_integers(name: str, values: NDArray[np.int64]) -> str:
    """Whole numbers, row by row."""
    return _table("int", name, map(str, values.ravel().tolist()), values.size)


def _with_point(digits: str) -> str:
    """A number that C does not take for a whole one."""
    return digits if set(digits) & set(".e") else f"{digits}.0"


def _table(kind: str, name: str, values: Iterable[str], size: int) -> str:
    rows = textwrap.fill(", ".join(values), WIDTH, initial_indent="    ", subsequent_indent="    ")
    return f"static const {kind} {name}[{size}] = {{\n{rows}\n}};\n"
