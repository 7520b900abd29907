"""Paths y(x) on a field: curves for x from `start` to `end` [m], with a method `y(x)` [m]."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.layouts import LINE_Y

Numbers = NDArray[np.float64]

START, END = 0.4, 5.6  # [m] default start and end of a path


def _check_range(start: float, end: float) -> None:
    if not checks.coordinate("start", start) < checks.coordinate("end", end):
        raise ValueError(f"start must lie before end, got {start!r} and {end!r}")


@dataclass(frozen=True)
class Sine:
    """A sine wave about a straight line. With a positive amplitude, the wave begins towards +y."""

    amplitude: float = 0.15  # [m]
    wavelength: float = 2.6  # [m]
    start: float = START  # [m] x of a first crossing of the middle
    end: float = END  # [m]
    middle: float = LINE_Y  # [m] y

    def __post_init__(self) -> None:
        _check_range(self.start, self.end)
        checks.coordinate("amplitude", self.amplitude)
        checks.positive("wavelength", self.wavelength, *checks.LENGTH)
        checks.coordinate("middle", self.middle)

    def y(self, x: Numbers) -> Numbers:
        phase = 2.0 * math.pi * (x - self.start) / self.wavelength
        return self.middle + self.amplitude * np.sin(phase)


@dataclass(frozen=True)
class LaneChange:
    """A lane change between two straight parts. Slope and curvature are continuous."""

    offset: float = 0.4  # [m] in y from its start to its end
    length: float = 1.5  # [m] of the change, along x
    change: float = 2.0  # [m] x of its start
    start: float = START  # [m]
    end: float = END  # [m]
    middle: float = LINE_Y  # [m] y halfway

    def __post_init__(self) -> None:
        _check_range(self.start, self.end)
        checks.coordinate("offset", self.offset)
        checks.positive("length", self.length, *checks.LENGTH)
        checks.coordinate("change", self.change)
        checks.coordinate("middle", self.middle)

    def y(self, x: Numbers) -> Numbers:
        u = np.clip((x - self.change) / self.length, 0.0, 1.0)
        done = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        return self.middle + self.offset * (done - 0.5)


@dataclass(frozen=True)
class _Through:
    """Base class of paths through points with increasing x."""

    points: tuple[tuple[float, float], ...]  # (points, 2) [m] points, as tuples or an array

    def __post_init__(self) -> None:
        points = checks.array("points", self.points, (None, 2))
        checks.limited("points", points, checks.FARTHEST)
        if len(points) < 2 or not (np.diff(points[:, 0]) > 0.0).all():
            raise ValueError(f"points must be at least two of rising x, got {points.tolist()}")
        object.__setattr__(self, "points", tuple(map(tuple, points.tolist())))

    @property
    def start(self) -> float:
        return self.points[0][0]

    @property
    def end(self) -> float:
        return self.points[-1][0]


@dataclass(frozen=True)
class Polyline(_Through):
    """A path of straight segments."""

    def y(self, x: Numbers) -> Numbers:
        along, across = np.array(self.points).T
        return np.interp(x, along, across)


@dataclass(frozen=True)
class Spline(_Through):
    """A natural cubic spline through the points. The curvature is 0 at the two ends."""

    def y(self, x: Numbers) -> Numbers:
        from scipy.interpolate import CubicSpline  # half of the package's import time

        along, across = np.array(self.points).T
        return CubicSpline(along, across, bc_type="natural")(x)


BasePath: TypeAlias = Sine | LaneChange | Polyline | Spline


def _random_sine(numbers: Numbers) -> Sine:
    side = 1.0 if numbers[0] < 0.5 else -1.0
    return Sine(side * (0.1 + 0.1 * numbers[1]), 1.8 + 1.4 * numbers[2])


def _random_lane_change(numbers: Numbers) -> LaneChange:
    side = 1.0 if numbers[0] < 0.5 else -1.0
    return LaneChange(
        side * (0.2 + 0.4 * numbers[1]), 1.0 + numbers[2], change=1.0 + 1.5 * numbers[3]
    )


def _random_polyline(numbers: Numbers) -> Polyline:
    x, y = START, LINE_Y
    points = [(x, y)]
    for level, place in numbers.reshape(-1, 2):
        aside = LINE_Y - 0.3 + 0.6 * place
        ramp = x + 0.4 + 0.4 * level
        if ramp + abs(aside - y) >= END:
            break
        if aside == y:
            continue
        points += [(ramp, y), (ramp + abs(aside - y), aside)]
        x, y = points[-1]
    return Polyline((*points, (END, y)))


def _random_spline(numbers: Numbers) -> Spline:
    y = LINE_Y - 0.2 + 0.4 * numbers[:6]
    y[0] = LINE_Y
    return Spline(tuple(zip(np.linspace(START, END, 6).tolist(), y.tolist(), strict=True)))


_RANDOM: dict[str, Callable[[Numbers], BasePath]] = {
    "sine": _random_sine,
    "lane change": _random_lane_change,
    "polyline": _random_polyline,
    "spline": _random_spline,
}
KINDS = tuple(_RANDOM)
DRAWS = 12  # random numbers per path


def random_path(kind: str, numbers: Numbers) -> BasePath:
    """Return a random path of a kind; `numbers` (DRAWS,) are uniform in [0, 1).

    - "sine": amplitude 0.1 to 0.2 m, wavelength 1.8 to 3.2 m, starting towards +y or -y.
    - "lane change": 0.2 to 0.6 m to a side, 1 to 2 m long, begins at x = 1 to 2.5 m.
    - "polyline": pieces along x (0.4 to 0.8 m) alternate with pieces at 45 deg. Each piece at 45
      deg leads to a random y within 0.3 m of the middle.
    - "spline": six points of the path are evenly spaced in x, and within 0.2 m of the middle.
    """
    return _RANDOM[kind](numbers)


def path_option(value: Any) -> BasePath:
    """Return a path unchanged. If `value` is an array of points (n, 2) [m], return a `Polyline`."""
    if isinstance(value, get_args(BasePath)):
        return value
    try:
        return Polyline(value)
    except ValueError as error:
        names = ", ".join(kind.__name__ for kind in get_args(BasePath))
        raise ValueError(f"path must be a {names} or points (n, 2): {error}") from None
