"""A short flow led by pictures without identity, for tests."""

from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np

import surface_gym as sg
from benchmarks.tracking import SimulatedClock, SimulatedDevice
from surface_gym.agents.runtime import controller as runtime, protocol
from surface_gym.agents.runtime.config import WorldOptions
from surface_gym.agents.runtime.stream_loop import StreamLoop
from surface_gym.agents.runtime.stream_simulator import SimulatedStream
from surface_gym.agents.runtime.tracker import StreamTracker
from surface_gym.config import EnvConfig
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
) -> protocol.ParcelEntry:
    """A small box at 1 m/s, to the first exit."""
    fields: dict[str, Any] = {"goal": (0.0, 0.0, 0.0), "velocity": SPEED, **changed}
    return protocol.ParcelEntry(number, at, BOX, (x, y, 0.0), **fields)


def picture(at: float, *places: tuple[float, float]) -> protocol.Detections:
    return protocol.Detections(at, tuple((x, y, 0.0) for x, y in places))


def world(seed: int = 0, config: EnvConfig = CONFIG, **options: Any) -> SimulatedStream:
    return SimulatedStream(config, seed, 0.0, WorldOptions(**options))


class Rolls:
    """A controller under which all parcels roll on; it opens the gate whenever it may."""

    def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> tuple[Any, Any]:
        choices = np.full((len(observation), 2 * CONFIG.stream_task.max_parcels), ROLL)
        return choices, state


def lead(
    machine: SimulatedStream, controller: Any, between: Any, seconds: float, **config: Any
) -> StreamLoop:
    """Lead a machine in simulated time."""
    clock = SimulatedClock()
    held = fresh()
    loop = StreamLoop(
        SimulatedDevice(machine, clock), held, runtime.Decider(controller, CONFIG),
        runtime.AxisLimits(held.shape, None), CONFIG.observation_space(), clock,
        replace(runtime.LoopConfig(CONFIG.control_period), **config),
    )  # fmt: skip
    loop.run(seconds, between)
    return loop
