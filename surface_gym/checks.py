"""Checks of arguments: each error names the argument, the value and what is allowed."""

import math
import numbers
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def number(name: str, value: Any) -> float:
    """A finite number, or an error; booleans and strings are not numbers."""
    try:
        is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
        result = float(value) if is_number else math.nan
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        raise ValueError(f"{name} must be a finite number, got {value!r}")
    return result


def positive(name: str, value: Any) -> float:
    """A finite number above zero, or an error."""
    result = number(name, value)
    if result <= 0.0:
        raise ValueError(f"{name} must be greater than 0, got {value!r}")
    return result


def not_negative(name: str, value: Any) -> float:
    """A finite number of at least zero, or an error."""
    result = number(name, value)
    if result < 0.0:
        raise ValueError(f"{name} must be at least 0, got {value!r}")
    return result


def within(name: str, value: Any, low: float, high: float) -> float:
    """A finite number in [low, high], or an error."""
    result = number(name, value)
    if not low <= result <= high:
        raise ValueError(f"{name} must be between {low:g} and {high:g}, got {value!r}")
    return result


def integer(name: str, value: Any, least: int) -> int:
    """A whole number of at least `least`, or an error; True and 1.0 are not whole numbers."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")
    return int(value)


def one_of(name: str, value: Any, allowed: Iterable[Any]) -> Any:
    """One of the allowed values, or an error that lists them; NumPy's scalars count as Python's."""
    choices = tuple(allowed)
    plain = value.item() if isinstance(value, np.generic) else value
    if not any(type(plain) is type(choice) and plain == choice for choice in choices):
        raise ValueError(f"{name} must be one of {', '.join(map(repr, choices))}, got {value!r}")
    return plain


def array(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    """A read-only copy as finite float64 of a shape (None: any length), or an error."""
    try:
        given = np.asarray(value)
    except ValueError:  # rows of different lengths
        raise ValueError(f"{name} must be an array of numbers, got {value!r}") from None
    if given.dtype.kind not in "iuf":
        raise ValueError(f"{name} must be an array of numbers, got {value!r}")
    result = np.array(given, dtype=np.float64)
    fits = result.ndim == len(shape) and all(
        want is None or have == want for have, want in zip(result.shape, shape, strict=True)
    )
    if not fits:
        wanted = ", ".join("any" if length is None else str(length) for length in shape)
        raise ValueError(f"{name} must have the shape ({wanted}), got {result.shape}")
    if not np.isfinite(result).all():
        raise ValueError(f"{name} must be finite, got {result[~np.isfinite(result)][0]} in it")
    result.setflags(write=False)
    return result


def booleans(name: str, value: ArrayLike) -> NDArray[np.bool_]:
    """A read-only copy as an array (rows, columns) of booleans, not empty, or an error."""
    try:
        given = np.array(value)
    except ValueError:  # rows of different lengths
        raise ValueError(f"{name} must be an array of booleans, got {value!r}") from None
    if given.dtype != np.bool_:
        raise ValueError(f"{name} must be an array of booleans, got one of {given.dtype}")
    if given.ndim != 2 or given.size == 0:
        raise ValueError(f"{name} must have at least one row and one column, got {given.shape}")
    given.setflags(write=False)
    return given


def pitch(name: str, value: Any) -> float | tuple[float, float]:
    """A distance above zero, or two of them, in x and in y; or an error."""
    if isinstance(value, (tuple, list, np.ndarray)):
        if len(value) != 2:
            raise ValueError(f"{name} must be one number or two, in x and in y, got {value!r}")
        return (positive(name, value[0]), positive(name, value[1]))
    return positive(name, value)


def friction(name: str, value: ArrayLike, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Coefficients of at least zero: one (), or one an element (rows, columns); or an error."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if value is None or np.isscalar(value):
        return np.asarray(not_negative(name, value))
    given = array(name, value, shape)
    if given.min() < 0.0:
        raise ValueError(f"{name} must be at least 0, got {given.min()}")
    return given


def orientations(name: str, value: ArrayLike) -> tuple[float, ...]:
    """Two or more axis angles [rad], or an error."""
    angles = array(name, value, (None,))
    if len(angles) < 2:
        raise ValueError(f"{name} must be at least 2, got {value!r}")
    return tuple(angles.tolist())
