"""A task of your own, as small as a task can be, and the ways it may be wrong."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

import surface_gym as sg
import surface_gym.extend as own
from surface_gym.extend import EnvState, X, Y, kernel_function

OUTCOMES = ("too late",)
(TOO_LATE,) = own.failures(OUTCOMES)


@dataclass(frozen=True)
class Cross(own.Task):
    """Get beyond an x before the clock says so."""

    far: float = 1.0  # [m]

    line = own.Field(rows=8, columns=20)
    features = (own.Feature("to go", -10.0, 10.0, "1 m"), own.Feature("y", -10.0, 10.0, "1 m"))
    terms = ("way", "success")
    outcomes = OUTCOMES
    metrics = ("left",)
    options = ("speed", "parcel")
    draws = 1
    goals = 1
    memories = 1

    def start(self, draw: own.Draw) -> own.Start:
        speed = draw.within("speed", own.between(1.0, 2.0, draw.numbers[0]), 0.1, 3.0)
        parcel = draw.parcel(self.parcels[:1], draw.numbers[0])
        return own.Start(parcel, (0.3, draw.line.line_y, 0.0), (speed, 0.0, 0.0), (0.3 + self.far,))

    @staticmethod
    @kernel_function
    def begin(state: EnvState) -> None:
        state.memory[0] = state.truth[X]

    @staticmethod
    @kernel_function
    def outcome(state: EnvState) -> int:
        state.metrics[0] = state.goal[0] - state.truth[X]
        if state.metrics[0] < 0.0:
            return own.SUCCESS
        return TOO_LATE if state.clock > 3.0 else own.RUNNING

    @staticmethod
    @kernel_function
    def reward(state: EnvState, outcome: int) -> None:
        state.terms[0] = state.truth[X] - state.memory[0]
        state.terms[1] = 1.0 if outcome == own.SUCCESS else 0.0
        state.memory[0] = state.truth[X]

    @staticmethod
    @kernel_function
    def observe(state: EnvState) -> None:
        state.observation[0] = state.goal[0] - state.sensed[X]
        state.observation[1] = state.sensed[Y]


class Assorted(Cross):
    def start(self, draw: own.Draw) -> own.Start:
        kinds = tuple(
            sg.Parcel(sg.Rectangle(0.2 + 0.2 * number, 0.2)) for number in draw.numbers[0]
        )
        parcels = own.Parcels(kinds, np.arange(len(kinds)))
        return super().start(draw)._replace(parcel=parcels)


class Unjudged(Cross):
    outcome: Any = None


class Plain(Cross):
    @staticmethod
    def outcome(state: EnvState) -> int:
        return own.RUNNING


class Uncompilable(Cross):
    @staticmethod
    @kernel_function
    def outcome(state: EnvState) -> int:
        return state.weight


class Unruly(Cross):
    """Does what a task may not: which of it, `far` says."""

    @staticmethod
    @kernel_function
    def outcome(state: EnvState) -> int:
        if state.goal[0] < 1.0:
            return TOO_LATE + 1
        return own.RUNNING + 1 if state.goal[0] < 2.0 else own.RUNNING

    @staticmethod
    @kernel_function
    def reward(state: EnvState, outcome: int) -> None:
        state.terms[0] = math.nan if state.goal[0] < 3.0 else 1.0
        state.terms[1] = 0.0
        if state.goal[0] > 4.0:
            state.terms[2] = 1.0

    @staticmethod
    @kernel_function
    def observe(state: EnvState) -> None:
        state.observation[0] = 0.0
        state.observation[1] = math.inf if 3.0 < state.goal[0] < 4.0 else 0.0


@dataclass(frozen=True)
class Misled(Cross):
    """Starts as it should not: with something else, or with what it says it does not have."""

    goals: int = 1
    has_path: bool = False
    instead: tuple[str, Any] | None = ("goal", (1.0,))

    def start(self, draw: own.Draw) -> Any:
        if self.instead is None:
            return None
        name, value = self.instead
        return super().start(draw)._replace(**{name: value})


class Unstarted(Cross):
    start = own.Task.start


class Featureless(Cross):
    features: Any = None


# Each with what its error must say.
FAULTY: tuple[tuple[Callable[[], Cross], str], ...] = (
    (Unjudged, r"Unjudged.outcome must be a static method and a kernel_function.* got None"),
    (Plain, r"Plain.outcome must be a static method and a kernel_function"),
    (Uncompilable, r"Uncompilable with Exact does not compile(.|\n)*weight"),
    (partial(Unruly, 0.2), r"Unruly.outcome must return RUNNING, SUCCESS or a failure.* got 4"),
    (partial(Unruly, 1.2), r"Unruly.outcome must return RUNNING, SUCCESS or a failure.* got 1"),
    (partial(Unruly, 2.2), r"Unruly.reward must write finite terms, got {'way': nan"),
    (partial(Unruly, 3.2), r"Unruly.observe.* must write finite features, got others for y"),
    (partial(Unruly, 4.2), r"Unruly with Exact must keep within their arrays.* 2 terms"),
    (partial(Misled, goals=2), r"Misled.start must give a goal of 2 numbers, got 1"),
    (
        partial(Misled, instead=("velocity", ((1.0,) * 7, 0.0, 0.0))),
        r"Misled.start must give a velocity of numbers or arrays",
    ),
    (
        partial(Misled, instead=("pose", (math.nan, 0.4, 0.0))),
        r"Misled.start must give a pose of finite numbers",
    ),
    (partial(Misled, has_path=True), r"Misled.start must give a path of 256 points, got None"),
    (partial(Misled, instead=None), r"Misled.start must give a Start, got None"),
    (Unstarted, r"Unstarted.start must be a method, as Task says"),
    (Featureless, r"Featureless.features must be a tuple"),
)


@dataclass(frozen=True)
class Guess(own.Sensor):
    """Says that the parcel is where it was at the start; counts the physics steps since."""

    sensor_size = 7

    @staticmethod
    @kernel_function
    def begin(numbers: own.Array, state: EnvState) -> None:
        for k in range(6):
            state.sensor_state[k] = state.truth[k]
        state.sensor_state[6] = 0.0

    @staticmethod
    @kernel_function
    def update(numbers: own.Array, state: EnvState, physics: own.Physics) -> None:
        state.sensor_state[6] += 1.0

    @staticmethod
    @kernel_function
    def read(numbers: own.Array, state: EnvState) -> None:
        for k in range(6):
            state.sensed[k] = state.sensor_state[k]


class Senseless(own.Sensor):
    """Forgot `read`."""


class Nonsense(Guess):
    """Says what no number is."""

    @staticmethod
    @kernel_function
    def read(numbers: own.Array, state: EnvState) -> None:
        for k in range(6):
            state.sensed[k] = math.nan


@dataclass(frozen=True)
class Grouped(own.Exact):
    """Reports groups as they are given."""

    given: Any = None

    @property
    def groups(self) -> Any:
        return self.given

    @staticmethod
    @kernel_function
    def show(numbers: own.Array, state: EnvState, see: own.Singles, mirror: float) -> None:
        see[0], see[1] = 1.0, mirror


TWO = own.Group((own.Feature("one", 0.0, 1.0), own.Feature("other", -1.0, 1.0)), Grouped.show)
