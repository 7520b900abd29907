"""A clock that a test turns, a device that says what a test has it say, and a loop around them."""

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import numpy as np

import surface_gym as sg
from agents.runtime.arranging import ArrangedHere
from agents.runtime.axis_guard import AxisGuard
from agents.runtime.deciding import Decider, FixedLayouts, bounds_of, on_offer
from agents.runtime.device import Angles, DeviceLost, Entered, Frame, Message
from agents.runtime.loop import Loop, LoopConfig
from agents.runtime.shadow import Shadow
from surface_gym.settings import Settings

QUARTER_TURN = 0.05  # [s]
SETTINGS = Settings(
    task="stop",
    actions="halves",
    sensors=sg.sensors.Camera(latency=0.04),
    actuators=sg.Actuators(axis_speed=0.5 * math.pi / QUARTER_TURN),
    observe=("parcel", "rotors"),
)
BRAKE, ROLL = 0, 15  # actions: all axes at 0 deg, and at 90 deg
SQUARE = sg.Parcel(sg.Rectangle(0.25, 0.25))
POSE, VELOCITY = (0.125, 1.0, 0.0), (1.0, 0.0, 0.0)


def entered(number: int = 0, at: float = 0.0, **changed: Any) -> Entered:
    """A square at 1 m/s, to stop at x = 1 m."""
    fields: dict[str, Any] = {"pose": POSE, "velocity": VELOCITY, "goal": (1.0,), **changed}
    return Entered(number, at, SQUARE, **fields)


def frame(taken: float, number: int | None = 0, x: float | None = None) -> Frame:
    """A frame of it as it rolls on."""
    return Frame(taken, number, (POSE[0] + taken if x is None else x, 1.0, 0.0))


@lru_cache(maxsize=1)
def shadow() -> Shadow:
    """One for all tests, with no parcel."""
    made = Shadow(SETTINGS)
    made.leave()
    return made


class TurnedClock:
    """Time passes by waiting, and by what is spent."""

    def __init__(self) -> None:
        self.time = 0.0

    def now(self) -> float:
        return self.time

    def sleep_until(self, moment: float) -> None:
        self.time = max(self.time, moment)


@dataclass
class ToldDevice:
    """Says what it is told to say, each at its time."""

    clock: TurnedClock
    says: list[tuple[float, Message]] = field(default_factory=list)
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
        """There is nothing to let go of."""

    def read(self) -> list[Message]:
        if self.is_away():
            raise DeviceLost("away")
        now = self.clock.now()
        due = [message for at, message in self.says if at <= now]
        self.says = [each for each in self.says if each[0] > now]
        return due

    def set_axes(self, angles: Angles) -> int:
        if self.is_away():
            raise DeviceLost("away")
        self.sent.append(angles)
        return len(self.sent)


class Always:
    """A controller that always does the same, and takes a while for it."""

    def __init__(self, action: Any, clock: TurnedClock, takes: float = 0.0) -> None:
        self.action, self.clock, self.takes = action, clock, takes
        self.begins: list[bool] = []

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, **_: Any
    ) -> tuple[Any, Any]:
        del observation
        self.begins.append(bool(episode_start[0]))
        self.clock.time += self.takes
        return np.array([self.action]), state


def loop_of(
    device: ToldDevice, controller: Any, settings: Settings = SETTINGS, **config: float
) -> Loop:
    """A loop on a device."""
    held = shadow()
    held.leave()
    layouts = FixedLayouts(held.settings)
    return Loop(
        device,
        held,
        Decider(controller, settings),
        (ArrangedHere(layouts), held.resolver(layouts.kind)),
        AxisGuard(held.shape, on_offer(settings)),
        bounds_of(settings),
        device.clock,
        LoopConfig(**config),
    )


def nothing(now: float) -> None:
    """Between two periods."""
