"""A short flow led by pictures without identity, for tests."""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np

import surface_gym as sg
from benchmarks.tracking import SimulatedClock, SimulatedDevice
from surface_gym.agents.runtime import controller as runtime
from surface_gym.agents.runtime.config import WorldOptions
from surface_gym.agents.runtime.controller import StreamLoop
from surface_gym.agents.runtime.tracker import StreamTracker
from surface_gym.agents.runtime.worlds import SimulatedStream
from surface_gym.config import EnvConfig
from surface_gym.machine import messages as ms
from tests.flow.flows import BOX, DENSE, SHORT

LATE = 0.04  # [s]
CONFIG = EnvConfig(
    "flow", actions="parcels", line=SHORT, stream=DENSE, max_parcels=8, exits="sides",
    sensors=sg.sensors.Camera(latency=LATE),
)  # fmt: skip
ROLL = 3  # choice of the axes
SPEED = (1.0, 0.0, 0.0)


@lru_cache(maxsize=1)
def tracker() -> StreamTracker:
    """One for all tests, without parcels."""
    return StreamTracker(CONFIG)


def fresh() -> StreamTracker:
    tracker().clear()
    return tracker()


def entry(
    number: int = 0, at: float = 0.0, x: float = 0.2, y: float = 1.0, **changed: Any
) -> ms.ParcelEntry:
    """A small box at 1 m/s, to the first exit."""
    fields: dict[str, Any] = {"goal": (0.0, 0.0, 0.0), "velocity": SPEED, **changed}
    return ms.ParcelEntry(number, at, BOX, (x, y, 0.0), **fields)


def picture(at: float, *places: tuple[float, float]) -> ms.Detections:
    return ms.Detections(at, tuple((x, y, 0.0) for x, y in places))


def world(seed: int = 0, config: EnvConfig = CONFIG, **options: Any) -> SimulatedStream:
    return SimulatedStream(config, seed, 0.0, WorldOptions(**options))


class Rolls:
    """A controller under which all parcels roll on; it opens the gate whenever it may."""

    def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> tuple[Any, Any]:
        choices = np.full((len(observation), 2 * CONFIG.stream_task.max_parcels), ROLL)
        return choices, state


def loop_of(
    device: Any, clock: Any, controller: Any = None, listeners: Sequence[Any] = ()
) -> StreamLoop:
    """A loop with a tracker without parcels."""
    timing = runtime.LoopConfig(CONFIG.control_period)
    return StreamLoop(device, fresh(), controller or Rolls(), CONFIG, clock, timing, listeners)


def lead(machine: SimulatedStream, controller: Any, between: Any, seconds: float) -> StreamLoop:
    """Lead a machine in simulated time."""
    clock = SimulatedClock()
    loop = loop_of(SimulatedDevice(machine, clock), clock, controller)
    loop.run(seconds, between)
    return loop
