"""A clock and a device that tests control, a loop around them, and faults to try it with."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

import surface_gym as sg
from benchmarks.tracking import SimulatedClock
from surface_gym.agents.runtime import controller as runtime, deciders
from surface_gym.agents.runtime.estimator import StateEstimator
from surface_gym.agents.runtime.protocol import DeviceLost
from surface_gym.config import EnvConfig
from surface_gym.machine.messages import Angles, Frame, Message, ParcelEntry

TOKEN = "0123456789abcdef"
PATIENCE = 120.0  # [s] for another thread or process, on a computer that does other work
QUARTER_TURN = 0.05  # [s]
CONFIG = EnvConfig(
    task="stop",
    actions="halves",
    sensors=sg.sensors.Camera(latency=0.04),
    actuators=sg.Actuators(axis_speed=0.5 * math.pi / QUARTER_TURN),
    observe=("parcel", "rotors"),
)
BRAKE, ROLL = 0, 15  # actions: all axes at 0 deg, and at 90 deg
SQUARE = sg.Parcel(sg.Rectangle(0.25, 0.25))
POSE, VELOCITY = (0.125, 1.0, 0.0), (1.0, 0.0, 0.0)


def entered(number: int = 0, at: float = 0.0, **changed: Any) -> ParcelEntry:
    """A square at 1 m/s, to stop at x = 1 m."""
    fields: dict[str, Any] = {"pose": POSE, "velocity": VELOCITY, "goal": (1.0,), **changed}
    return ParcelEntry(number, at, SQUARE, **fields)


def frame(taken_at: float, number: int | None = 0, x: float | None = None) -> Frame:
    return Frame(taken_at, number, (POSE[0] + taken_at if x is None else x, 1.0, 0.0))


@lru_cache(maxsize=1)
def estimator() -> StateEstimator:
    """One for all tests, with no parcel."""
    made = StateEstimator(CONFIG)
    made.clear()
    return made


@dataclass
class ScriptedDevice:
    """Gives the messages of a script, each at its time."""

    clock: SimulatedClock
    script: list[tuple[float, Message]] = field(default_factory=list)
    away: list[tuple[float, float]] = field(default_factory=list)  # [s] from when to when
    sent: list[Angles] = field(default_factory=list)
    connects: list[float] = field(default_factory=list)  # [s] when it was tried

    def is_away(self) -> bool:
        return any(first <= self.clock.now() < last for first, last in self.away)

    def connect(self) -> None:
        self.connects.append(self.clock.now())
        if self.is_away():
            raise DeviceLost("away")

    def close(self) -> None:
        """Nothing is to be closed."""

    def read(self) -> list[Message]:
        if self.is_away():
            raise DeviceLost("away")
        now = self.clock.now()
        due = [message for at, message in self.script if at <= now]
        self.script = [each for each in self.script if each[0] > now]
        return due

    def set_axes(self, angles: Angles) -> int:
        if self.is_away():
            raise DeviceLost("away")
        self.sent.append(angles)
        return len(self.sent)


class Always:
    """A controller that always does the same, and takes a while for it."""

    def __init__(self, action: Any, clock: SimulatedClock, takes: float = 0.0) -> None:
        self.action, self.clock, self.takes = action, clock, takes
        self.begins: list[bool] = []

    def predict(
        self, _: Any, state: Any = None, episode_start: Any = None, **__: Any
    ) -> tuple[Any, Any]:
        self.begins.append(bool(episode_start[0]))
        self.clock.time += self.takes
        return np.array([self.action]), state


def loop_of(
    device: Any, controller: Any, env_config: EnvConfig = CONFIG, listeners: Any = (),
    **config: float,
) -> runtime.ControlLoop:  # fmt: skip
    held = estimator()
    held.clear()
    layouts = deciders.FixedLayouts(held.config)
    arranger = LocalArranger(layouts), held.resolver(layouts.kind)
    timing = runtime.LoopConfig(**config)
    return runtime.ControlLoop(
        device, held, arranger, controller, env_config, controller.clock, timing, listeners
    )


class LocalArranger:
    """Arranges the latest layout when it is needed, in this process."""

    def __init__(self, layouts: deciders.FixedLayouts) -> None:
        self._layouts = layouts
        self._observation: Any = None
        self._layout: Any = None

    def ask(self, observation: Any) -> None:
        self._observation = observation

    def layout(self) -> Any:
        if self._observation is not None:
            self._layout, self._observation = self._layouts.arrange(self._observation), None
        return self._layout


def nothing(now: float) -> None:
    """Between two periods."""


def of_kind(kind: type, said: list[Any]) -> list[Any]:
    """The messages of a kind, each with the time [s] at which it is due."""
    return [(due, message) for due, message in said if isinstance(message, kind)]


def until(call: Callable[[], Any]) -> Any:
    """What a call returns, once it is something."""
    ends = time.monotonic() + PATIENCE
    while time.monotonic() < ends:
        if found := call():
            return found
        time.sleep(0.005)
    raise TimeoutError
