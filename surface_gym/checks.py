"""Checks of arguments, and bounds of numbers.

A check returns its argument if the argument is allowed. Otherwise it raises a ValueError. The
message names the argument, its value and the allowed values.

If all numbers are within the bounds of this file, no square or quotient in a physics step overflows
or underflows. The bounds are wide: a value outside is a wrong unit or a typing error.
"""

import inspect
import math
import numbers
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surface_gym import checks

# [m] of a base, a pitch or a line: from a tenth of the smallest module to more than any hall.
LENGTH = (1e-4, 1e3)
# [m] absolute x or y. Its round-off, 2e-12 m, is far below the tolerance of 1e-9 m for an
# element on a base's perimeter.
FARTHEST = 1e4
# [rad] absolute heading of a parcel, which counts whole turns. Its round-off, 1e-10 rad, is
# negligible
TURNED = 1e6
TURN = 2.0 * math.pi + 1e-6  # [rad] any other absolute angle, with float32's round-off
SPEED = 100.0  # [m/s] absolute speed: twenty times the fastest sorter
SPIN = 1e3  # [rad/s] absolute speed: 10 000 revolutions per minute
FRICTION = 100.0  # [-] of any coefficient: rubber on rubber has 4
MASS = (1e-6, 1e6)  # [kg] from a grain of sand to a ship's crane
COM_HEIGHT = 100.0  # [m] of a centre of mass above its base: a tower
# [-] radius of gyration over the base's reach: from a mast on a wide foot to a beam on a point
GYRATION = (1e-3, 1e3)
STIFFNESS = (1e-9, 1e9)  # [-] of an element; only ratios count
STIFFNESS_RATIO = 1e6  # [-] of the stiffest to the softest element: more than steel to foam
# [-] log-normal sigma: one element in six is at least 7 times stiffer than the median
STIFFNESS_SPREAD = 2.0
STEP = (1e-6, 1.0)  # [s] time step
DURATION = (1e-9, 1e6)  # [s] of a simulation: up to eleven days
CONTROL_PERIOD = (1e-6, 10.0)  # [s]
EPISODE = 86_400.0  # [s] a day
PATIENCE = (1e-6, EPISODE)  # [s]
AHEAD = 100.0  # [s] longer than any parcel stays
RATE = (1e-6, 1e5)  # [parcels/h]: up to 28 parcels a second
ODDS = (1e-9, 1e9)  # [-]
AXIS_SPEED = (1e-6, 1e9)  # [rad/s] turning speed of an axis, unless infinite
FRAME_RATE = (1e-3, 1e6)  # [Hz] of a sensor
POSITION_ERROR = 10.0  # [m] standard deviation of a sensor: many parcels
ANGLE_ERROR = TURN  # [rad] a whole turn: the angle is unknown
TOLERANCE = (1e-6, 1.0)  # [m] tolerance of a switch
# [m^2/s^3] and [rad^2/s^3] process noise: from a perfect model to a useless one
DENSITY = (1e-12, 1e9)
# [-] of the friction factor and [m] of the load's position: from known to unknown
LEARNED_SPREAD = (1e-6, 1.0)
FRICTION_ERROR = 10.0  # [-] share by which friction may be off
ELEMENTS = 1_000_000  # maximum number of elements of a line
ORIENTATIONS = 1000  # maximum number, a fifth of a degree apart; "any" is finer
PER_CORE = 32  # maximum processes or threads; more would only wait for each other

DEGREES = "degrees become radians by np.radians"  # hint for an angle out of bounds


def set_fields(instance: Any, **values: Any) -> None:
    """Set fields of `instance`, a frozen dataclass, while it is being constructed."""
    for name, value in values.items():
        object.__setattr__(instance, name, value)


def settle(instance: Any, **allowed: Any) -> None:
    """Replace fields of a frozen dataclass by their checked values.

    If a field is None, and if None is the field's default, the field stays None.

    Args:
        allowed: for each field, a function of this file that checks the field's value, or a tuple
            of the function and its limits.
    """
    for name, check in allowed.items():
        function, *limits = check if isinstance(check, tuple) else (check,)
        value = getattr(instance, name)
        if value is not None or getattr(type(instance), name, name) is not None:
            object.__setattr__(instance, name, function(name, value, *limits))


def number(name: str, value: Any) -> float:
    """Return `value` as a float; raise an error for NaN, infinity, booleans and strings."""
    try:
        is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
        result = float(value) if is_number else math.nan
    except OverflowError:
        result = math.inf
    if not math.isfinite(result):
        raise ValueError(f"{name} must be a finite number, got {value!r}")
    return result


def positive(name: str, value: Any, least: float = 0.0, most: float = math.inf) -> float:
    """Return `value`, or raise an error unless `value` is above 0 and in [least, most]."""
    result = number(name, value)
    if result <= 0.0:
        raise ValueError(f"{name} must be greater than 0, got {value!r}")
    return _limited(name, value, result, least, most)


def not_negative(name: str, value: Any, most: float = math.inf) -> float:
    """Return `value` if it is a finite number in [0, most], or raise an error."""
    result = number(name, value)
    if result < 0.0:
        raise ValueError(f"{name} must be at least 0, got {value!r}")
    return _limited(name, value, result, 0.0, most)


def within(name: str, value: Any, low: float, high: float) -> float:
    """Return `value` if it is a finite number in [low, high], or raise an error."""
    return _limited(name, value, number(name, value), low, high)


def angle(name: str, value: Any, low: float = -TURN, high: float = TURN) -> float:
    """Return an angle [rad] in [low, high], or raise an error that says how to convert degrees."""
    return _limited(name, value, number(name, value), low, high, " rad", f"; {DEGREES}")


def coordinate(name: str, value: Any) -> float:
    """Return `value` if it is an x or y [m] within physical bounds, or raise an error."""
    return within(name, value, -checks.FARTHEST, checks.FARTHEST)


def _limited(
    name: str, value: Any, result: float, low: float, high: float, unit: str = "", hint: str = ""
) -> float:
    if not low <= result <= high:
        raise ValueError(f"{name} must be between {low:g} and {high:g}{unit}, got {value!r}{hint}")
    return result


def integer(name: str, value: Any, least: int, most: int | None = None) -> int:
    """Return an integer from `least` to `most`, or raise a ValueError; True and 1.0 are refused."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise ValueError(f"{name} must be a whole number of at least {least}, got {value!r}")
    if most is not None and value > most:
        raise ValueError(f"{name} must be a whole number of at most {most}, got {value!r}")
    return int(value)


def one_of(name: str, value: Any, allowed: Iterable[Any]) -> Any:
    """Return `value` as a Python value. Raise an error if `value` is not in `allowed`."""
    choices = tuple(allowed)
    plain = value.item() if isinstance(value, np.generic) else value
    if not any(type(plain) is type(choice) and plain == choice for choice in choices):
        raise ValueError(f"{name} must be one of {', '.join(map(repr, choices))}, got {value!r}")
    return plain


def some_of(name: str, value: Any, allowed: tuple[str, ...]) -> tuple[str, ...]:
    """Return names as a tuple; raise an error if a name is not among the allowed names."""
    if not isinstance(value, (tuple, list)):
        raise ValueError(f"{name} must be some of {allowed}, got {value!r}")
    return tuple(one_of(name, each, allowed) for each in value)


def instance(name: str, value: Any, kind: Any, allowed: str) -> Any:
    """Return `value` if it is an instance of the class `kind`, else raise a ValueError.

    The error names `allowed`, e.g. "a Surface". If `value` is a class, the error says
    that the class must be called.
    """
    if isinstance(value, kind):
        return value
    called = ""
    if isinstance(value, type) and issubclass(value, kind):
        needed = inspect.signature(value).parameters.values()
        inside = "..." if any(each.default is each.empty for each in needed) else ""
        called = f"; call it: {value.__name__}({inside})"
    raise ValueError(f"{name} must be {allowed}, got {value!r}{called}")


def observation(value: Any, shape: tuple[int | None, ...]) -> NDArray[np.float32]:
    """Return one or several observations as float32; raise an error for any other shape.

    `shape` is the shape of one observation. A None in `shape` allows any length.
    """
    given = _numbers("observation", value)
    _check_finite("observation", given)
    several = given.ndim == len(shape) + 1
    if given.size == 0 or not _fits(given.shape[several:], shape):
        one = ", ".join("any" if length is None else str(length) for length in shape)
        raise ValueError(
            f"observation must have the shape ({one}) or (num_envs, {one}), got {given.shape}"
        )
    with np.errstate(over="ignore"):
        single = given.astype(np.float32, order="C", copy=False)
    _check_finite("observation", single)
    return single


def alike(name: str, value: Any, like: Any) -> Any:
    """Return `value` if its arrays have the same types and shapes as the arrays of `like`.

    Otherwise, raise an error. `value` and `like` are arrays, or nested tuples of arrays.
    """
    if isinstance(like, tuple):
        if not isinstance(value, tuple) or len(value) != len(like):
            raise ValueError(f"{name} must be one that predict returned, got {value!r}")
        parts = getattr(like, "_fields", range(len(like)))
        for part, each, model in zip(parts, value, like, strict=True):
            alike(f"{name}.{part}", each, model)
        return value
    if not isinstance(value, np.ndarray):
        raise ValueError(f"{name} must be an array of {like.dtype}, got {value!r}")
    if (value.dtype, value.shape) != (like.dtype, like.shape):
        raise ValueError(
            f"{name} must be {like.dtype} of the shape {like.shape}, got {value.dtype} of "
            f"{value.shape}"
        )
    return value


def path(name: str, value: Any, suffix: str = "") -> Path:
    """Return `value` as a path that ends in `suffix`, e.g. ".html". Otherwise raise an error."""
    if not isinstance(value, (str, os.PathLike)):
        raise ValueError(f"{name} must be a path, got {value!r}")
    if suffix and Path(value).suffix != suffix:
        raise ValueError(f"{name} must end in {suffix}, got {str(value)!r}")
    return Path(value)


def _regular(name: str, value: Any, kind: str) -> NDArray[Any]:
    """Return `value` as an array. Raise an error for masked arrays and rows of unequal length."""
    if isinstance(value, np.ma.MaskedArray):
        raise ValueError(f"{name} must be an array of {kind}, got a masked one")
    try:
        return np.asarray(value)
    except ValueError:  # rows of different lengths
        raise ValueError(f"{name} must be an array of {kind}, got {value!r}") from None


def _numbers(name: str, value: Any) -> NDArray[Any]:
    """Return `value` as an array of integers or floats. Raise an error for all other types."""
    given = _regular(name, value, "numbers")
    if given.dtype.kind not in "iuf":
        raise ValueError(f"{name} must be an array of numbers, got {value!r}")
    return given


def _check_finite(name: str, values: NDArray[Any]) -> None:
    if not np.isfinite(values).all():
        raise ValueError(f"{name} must be finite, got {values[~np.isfinite(values)][0]} in it")


def _fits(shape: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    """Return whether a shape has the wanted lengths. None allows any length."""
    return shape == wanted or (
        len(shape) == len(wanted)
        and all(want in (None, have) for have, want in zip(shape, wanted, strict=True))
    )


def array(name: str, value: Any, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    """Return a read-only, finite array or raise an error. None in `shape` allows any length."""
    result = np.array(_numbers(name, value), dtype=np.float64)
    if not _fits(result.shape, shape):
        wanted = ", ".join("any" if length is None else str(length) for length in shape)
        raise ValueError(f"{name} must have the shape ({wanted}), got {result.shape}")
    _check_finite(name, result)
    result.setflags(write=False)
    return result


def limited(
    name: str, values: NDArray[np.float64], most: ArrayLike, unit: str = "", hint: str = ""
) -> NDArray[np.float64]:
    """Return `values` if they are in [-most, most]; else raise an error with `unit` and `hint`."""
    beyond = np.abs(values) > most
    if beyond.any():
        bound, got = np.broadcast_to(most, values.shape)[beyond][0], values[beyond][0]
        raise ValueError(
            f"{name} must be between {-bound:g} and {bound:g}{unit}, got {got:g} in it{hint}"
        )
    return values


def angles(name: str, values: NDArray[np.float64], most: float = TURN) -> NDArray[np.float64]:
    """Return angles [rad] in [-most, most], or raise an error that says how to convert degrees."""
    return limited(name, values, most, " rad", f"; {DEGREES}")


MOST_POSE = np.array([FARTHEST, FARTHEST, TURNED])
MOST_VELOCITY = np.array([SPEED, SPEED, SPIN])


def pose(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    """Return poses (..., 3) [m, m, rad] within physical bounds, or raise an error."""
    return limited(name, array(name, value, shape), MOST_POSE)


def velocity(name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    """Return velocities (..., 3) [m/s, m/s, rad/s] within physical bounds, or raise an error."""
    return limited(name, array(name, value, shape), MOST_VELOCITY)


def place(name: str, value: ArrayLike) -> tuple[float, float]:
    """Return a point (x, y) [m] within physical bounds, or raise an error."""
    x, y = limited(name, array(name, value, (2,)), checks.FARTHEST).tolist()
    return (x, y)


def booleans(name: str, value: ArrayLike) -> NDArray[np.bool_]:
    """Return a read-only copy (rows, columns) of booleans. An empty array raises ValueError."""
    given = np.array(_regular(name, value, "booleans"))
    if given.dtype != np.bool_:
        raise ValueError(f"{name} must be an array of booleans, got one of {given.dtype}")
    if given.ndim != 2 or given.size == 0:
        raise ValueError(f"{name} must have at least one row and one column, got {given.shape}")
    given.setflags(write=False)
    return given


def pitch(name: str, value: Any) -> float | tuple[float, float]:
    """Return a pitch [m] as one number, or as two numbers (x, y), or raise an error."""
    if isinstance(value, (tuple, list, np.ndarray)):
        if len(value) != 2:
            raise ValueError(f"{name} must be one number or two, in x and in y, got {value!r}")
        return (positive(name, value[0], *checks.LENGTH), positive(name, value[1], *checks.LENGTH))
    return positive(name, value, *checks.LENGTH)


def friction(name: str, value: ArrayLike, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return one friction coefficient or an array (rows, columns), or raise an error."""
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if value is None or np.isscalar(value):
        return np.asarray(not_negative(name, value, checks.FRICTION))
    given = array(name, value, shape)
    if given.min() < 0.0:
        raise ValueError(f"{name} must be at least 0, got {given.min()}")
    if given.max() > checks.FRICTION:
        raise ValueError(f"{name} must be at most {checks.FRICTION:g}, got {given.max()}")
    return given


def rolling(mu_max: ArrayLike, mu_min: ArrayLike) -> None:
    """Raise a ValueError if friction across a rotor's axis exceeds friction along the axis."""
    most, least = np.broadcast_arrays(mu_max, mu_min)
    if (least > most).any():
        place = int(np.argmax(least > most))
        raise ValueError(
            f"mu_min must be at most mu_max, got {least.flat[place]:g} and {most.flat[place]:g}"
        )


def orientations(name: str, value: ArrayLike) -> tuple[float, ...]:
    """Return axis angles [rad]; raise an error if two are equal or if all axes are parallel."""
    offered = angles(name, array(name, value, (None,)))
    if not 2 <= len(offered) <= checks.ORIENTATIONS:
        least_or_most = "least 2" if len(offered) < 2 else f"most {checks.ORIENTATIONS}"
        given = repr(value) if len(offered) < 2 else f"{len(offered)}"
        raise ValueError(f"{name} must be at {least_or_most}, got {given}")
    if len(np.unique(offered)) < len(offered):
        raise ValueError(f"{name} must differ from each other, got {value!r}")
    # Sines of the differences to the first, since axes have period pi.
    if np.abs(np.sin(offered - offered[0])).max() < 1e-9:
        raise ValueError(f"{name} must hold two axes that differ, got {value!r}")
    return tuple(offered.tolist())
