"""What every task has in common."""

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.lanes.memory import Lanes
from surface_gym.layouts import box
from surface_gym.parcel import Parcel
from surface_gym.plant import Plant


@dataclass(frozen=True)
class Feature:
    """One number of an observation."""

    name: str
    low: float  # [-] it cannot be below
    high: float  # [-] it cannot be above
    meaning: str  # with the unit it is scaled by


class Start(NamedTuple):
    """How an episode begins."""

    parcel: Parcel
    pose: tuple[float, float, float]  # [m, m, rad] of the base's frame
    velocity: tuple[float, float, float]  # [m/s, m/s, rad/s]
    goal: tuple[float, ...]  # the task's own, at most `lanes.memory.GOALS`
    tilt: float = 0.0  # [rad] of the surface
    path: NDArray[np.float64] | None = None  # (PATH_POINTS,) [m] y of a path to follow


class Task(Protocol):
    """What the environment asks of a task. Its compiled half has the same name in the batch."""

    @property
    def number(self) -> int:
        """Its place in `batch.judgement`."""

    @property
    def plant(self) -> Plant:
        """Where it happens."""

    @property
    def parcels(self) -> Any:
        """Those it draws from, each a Parcel."""

    @property
    def features(self) -> tuple[Feature, ...]:
        """The observation."""

    @property
    def terms(self) -> tuple[str, ...]:
        """The reward's terms."""

    @property
    def figures(self) -> tuple[str, ...]:
        """The task's own numbers in `info`: columns of `Lanes.memory` from `FIGURES` on."""

    @property
    def options(self) -> tuple[str, ...]:
        """What `reset(options=...)` may fix."""

    def readings(self, lanes: Lanes, lane: int) -> list[tuple[str, str]]:
        """The task's own numbers of a lane, as pairs of texts, for drawing."""

    def goal(self, lanes: Lanes, lane: int) -> Any:
        """What drawing shows of a lane's goal, one of `surface_gym.rendering`'s goals."""

    def start(
        self,
        rng: np.random.Generator,
        options: dict[str, Any],
        zone: tuple[int, int] | None,
    ) -> Start:
        """Draw a start; an option takes the place of its draw.

        Args:
            rng: to draw from.
            options: what is fixed.
            zone: first and last column that obey; None for the plant's own.
        """


def parcel_option(value: Any) -> Parcel:
    """The parcel an option asks for: "S", "B" or a Parcel of one's own."""
    if isinstance(value, Parcel):
        return value
    if isinstance(value, str) and value in ("S", "B"):
        return box(value)
    raise ValueError(f"parcel must be 'S', 'B' or a Parcel, got {value!r}")


def parcels_to_draw(parcels: tuple[str | Parcel, ...]) -> tuple[Parcel, ...]:
    """The parcels of a task, or an error that names them."""
    if not parcels:
        raise ValueError(f"parcels must be at least one, got {parcels!r}")
    return tuple(parcel_option(parcel) for parcel in parcels)


def rising(name: str, value: Any, low: float, high: float) -> tuple[float, float]:
    """Two finite numbers in [low, high], the first not above the second, or an error."""
    first, last = checks.array(name, value, (2,)).tolist()
    if not low <= first <= last <= high:
        raise ValueError(
            f"{name} must be two rising numbers between {low:g} and {high:g}, got {value!r}"
        )
    return first, last


def check_options(options: dict[str, Any] | None, allowed: tuple[str, ...]) -> dict[str, Any]:
    """The options, or an error that names the unknown one."""
    if options is None:
        return {}
    if not isinstance(options, dict):
        raise ValueError(f"options must be a dict or None, got {options!r}")
    for name in options:
        checks.one_of("options", name, allowed)
    return options
