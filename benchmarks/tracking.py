"""A stream led by pictures without identity, beside a camera that knows who is who.

Run it by `python -m benchmarks.tracking`. Time is simulated, so figures depend on seeds only; the
time of a period is the exception.
"""

import math
import time
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

import surface_gym as sg
from surface_gym.agents import library
from surface_gym.agents.base import Controller
from surface_gym.agents.rules import RULES
from surface_gym.agents.runtime import controller as runtime
from surface_gym.agents.runtime.config import WorldOptions
from surface_gym.agents.runtime.stream_loop import StreamLoop
from surface_gym.agents.runtime.stream_simulator import (
    SimulatedClock,
    SimulatedDevice,
    SimulatedStream,
)
from surface_gym.agents.runtime.tracker import StreamTracker
from surface_gym.config import EnvConfig
from surface_gym.flow.state import CORRECT, ENTERED, TOUCHES, WRONG
from surface_gym.physics.types import Array

MISTAKEN_FOR = 5  # periods in which an estimate is nearer to another parcel, or far from its own
OFF = 0.1  # [m] an estimate this far from its parcel has lost it


@dataclass
class Watch:
    """Compares the tracker with the truth after each period."""

    world: SimulatedStream
    tracker: StreamTracker
    swapped: set[int] = field(default_factory=set)  # parcels whose estimate followed another one
    lost: set[int] = field(default_factory=set)  # parcels without a near estimate
    errors: list[float] = field(default_factory=list)  # [m]
    touching: list[int] = field(default_factory=list)
    count: list[int] = field(default_factory=list)
    _wrong: dict[int, int] = field(default_factory=dict)
    _off: dict[int, int] = field(default_factory=dict)

    def look(self, _: float) -> None:
        numbers, poses = self.world.poses
        shown, estimates = self.tracker.numbers, self.tracker.estimates
        self.count.append(len(numbers))
        for k, number in enumerate(numbers.tolist()):
            row = np.flatnonzero(shown == number)
            if not len(row):
                self._note(self._off, self.lost, number, True)
                continue
            away = np.linalg.norm(poses[:, :2] - estimates[row[0], :2], axis=1)
            self.errors.append(float(away[k]))
            self._note(self._wrong, self.swapped, number, bool(away.argmin() != k))
            self._note(self._off, self.lost, number, bool(away[k] > OFF))

    @staticmethod
    def _note(counts: dict[int, int], found: set[int], number: int, is_so: bool) -> None:
        counts[number] = counts.get(number, 0) + 1 if is_so else 0
        if counts[number] >= MISTAKEN_FOR:
            found.add(number)


def run_tracked(
    config: EnvConfig, controller: Controller, seed: int, seconds: float, options: WorldOptions,
    tracker: StreamTracker, watch_time: list[float] | None = None,
) -> tuple[Any, Watch, Any]:
    clock = SimulatedClock()
    world = SimulatedStream(config, seed, clock.now(), options)
    tracker.clear()
    watch = Watch(world, tracker)
    loop = StreamLoop(
        SimulatedDevice(world, clock), tracker, runtime.Decider(controller, config),
        runtime.AxisLimits(tracker.shape, None), config.observation_space(), clock,
        runtime.LoopConfig(config.control_period),
    )
    if watch_time is not None:
        observe, correct = tracker.observe, tracker.correct
    loop.run(seconds, watch.look)
    return world.streams.tally[0].copy(), watch, loop


def run_known(config: EnvConfig, controller: Controller, seed: int, seconds: float) -> Any:
    """Run the environment's own camera, which knows each parcel; return the tally."""
    from surface_gym.flow.batch import StreamBatch

    batch = StreamBatch(config, 1)
    generator = np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[0])
    batch.seed(0, generator)
    batch.reset(np.zeros(1, dtype=np.int64))
    state = None
    for _ in range(round(seconds / config.control_period)):
        action, state = controller.predict(batch.observation, state)
        batch.step(config.action_kind.commands(action, 1))
    return batch.streams.tally[0].copy()
