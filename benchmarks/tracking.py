"""`python -m benchmarks.tracking`: control of streams by pictures that do not identify parcels.

Each stream runs twice from one seed: controlled by `StreamLoop` with a tracker, and as an
environment whose camera identifies each parcel. Time is simulated, so results depend only on seeds.
Friction and loads differ from the tracker's model.
"""

import time
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import itemgetter
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray
from rich.console import Console
from rich.progress import track

import surface_gym as sg
from benchmarks.figure import Figure, figure_table
from surface_gym.agents import library
from surface_gym.agents.base import Controller
from surface_gym.agents.rules import find_rules
from surface_gym.agents.runtime import controller as runtime, protocol
from surface_gym.agents.runtime.config import WorldOptions
from surface_gym.agents.runtime.controller import StreamLoop
from surface_gym.agents.runtime.tracker import StreamTracker
from surface_gym.agents.runtime.worlds import SimulatedStream, SimulatedWorld
from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.flow.arrivals import Poisson
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import CORRECT, ENTERED
from surface_gym.flow.stream import Stream
from surface_gym.machine import messages as ms
from surface_gym.physics.types import Integers

MISTAKEN = 5  # successive periods after which a parcel counts as swapped or lost
OFF = 0.1  # [m] distance from a parcel to its estimate beyond which the parcel is lost
LATE = 0.04  # [s] delay of pictures
SHARE = 0.05  # [-] share of poses that are missing, and of poses that are false
MERGED = 0.1  # [-] share of touching pairs that are shown as one
DURATION = 3600.0  # [s] of the task, longer than any run
VARIED = sg.Randomisation(friction=0.2, com_offset=0.1)
FULL = 28  # minimum number of parcels in the timed periods
EARLY = 1e-6  # [s] by which a message may be early, for round-off
BRAKE, ROLL = 0, 3  # choices of the default orientations


@dataclass(frozen=True)
class TrackingOptions:
    """Compare control by pictures that do not identify parcels with control of known parcels."""

    flows: int = 10
    """Number of streams of Flow, each 60 s."""
    singulations: int = 20
    """Number of streams of Singulate, each 30 s."""
    crowds: int = 10
    """Number of crowds of pushing parcels, each 40 s."""
    seed: int = 0
    """Seed of the first stream."""


class SimulatedClock:
    """A clock that advances only by waiting, so that runs do not depend on the computer."""

    def __init__(self) -> None:
        self.time = 0.0  # [s]

    def now(self) -> float:
        return self.time

    def sleep_until(self, moment: float) -> None:
        self.time = max(self.time, moment)


class SimulatedDevice:
    """A `Device` that simulates the machine in the same process."""

    def __init__(self, world: SimulatedWorld, clock: protocol.Clock) -> None:
        self._world, self._clock = world, clock
        self._outbox: list[tuple[float, ms.Message]] = []
        self._command = 0

    def connect(self) -> None:
        """Do nothing."""

    def close(self) -> None:
        """Do nothing."""

    def read(self) -> list[ms.Message]:
        now = self._clock.now()
        self._outbox += self._world.advance(now - 0.5 * self._world.dt)  # the physics is at `now`
        self._outbox.sort(key=itemgetter(0))
        due = bisect_right(self._outbox, now + EARLY, key=itemgetter(0))
        messages = [message for _, message in self._outbox[:due]]
        del self._outbox[:due]
        return messages

    def set_axes(self, angles: ms.Angles) -> int:
        self._command += 1
        self._outbox.append((self._clock.now(), self._world.set_axes(self._command, angles)))
        return self._command

    def open_gate(self, begin: float, end: float) -> None:
        self._world.open_gate(begin, end)


class TimedTracker(StreamTracker):
    """A tracker that measures its CPU time in each control period."""

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config)
        self.spent = 0.0  # [s] CPU time of this period
        self.periods: list[tuple[int, float]] = []  # parcels, and CPU time [s]

    def correct(self, picture: ms.Detections) -> bool:
        begun = time.thread_time()
        used = super().correct(picture)
        self.spent += time.thread_time() - begun
        return used

    def observe(self, now: float) -> NDArray[np.float32]:
        begun = time.thread_time()
        table = super().observe(now)
        spent = self.spent + time.thread_time() - begun
        self.periods.append((int((self.numbers >= 0).sum()), spent))
        self.spent = 0.0
        return table


@dataclass
class Comparison:
    """Compares a tracker with the true stream after each period."""

    world: SimulatedStream
    tracker: StreamTracker
    swapped: set[int] = field(default_factory=set)  # parcels whose estimate is nearer to another
    lost: set[int] = field(default_factory=set)  # parcels whose estimate is absent or far away
    _wrong: dict[tuple[str, int], int] = field(default_factory=dict)

    def compare(self, _: float) -> None:
        numbers, poses = self.world.poses
        shown, estimates = self.tracker.numbers, self.tracker.estimates[:, :2]
        for k, number in enumerate(numbers.tolist()):
            own = np.flatnonzero(shown == number)
            away = np.linalg.norm(poses[:, :2] - estimates[own[:1]], axis=1) if len(own) else None
            is_swapped = away is not None and int(away.argmin()) != k
            self._note("swapped", self.swapped, number, is_swapped)
            self._note("lost", self.lost, number, away is None or bool(away[k] > OFF))

    def _note(self, name: str, found: set[int], number: int, is_so: bool) -> None:
        count = self._wrong.get((name, number), 0) + 1 if is_so else 0
        self._wrong[name, number] = count
        if count >= MISTAKEN:
            found.add(number)


def run_tracked(
    tracker: StreamTracker, config: EnvConfig, controller: Controller, seed: int, seconds: float,
    options: WorldOptions,
) -> Comparison:  # fmt: skip
    """Control a simulated machine with a tracker for a time [s]; return the mistakes."""
    clock = SimulatedClock()
    world = SimulatedStream(config, seed, clock.now(), options)
    tracker.clear()
    comparison = Comparison(world, tracker)
    device, timing = SimulatedDevice(world, clock), runtime.LoopConfig(config.control_period)
    loop = StreamLoop(device, tracker, controller, config, clock, timing)
    loop.run(seconds, comparison.compare)
    return comparison


def run_known(config: EnvConfig, controller: Controller, seed: int, seconds: float) -> Integers:
    """Control an environment whose camera identifies parcels for a time [s]; return the tally."""
    batch = StreamBatch(config, 1)
    batch.seed(0, np.random.default_rng(np.random.SeedSequence(seed).spawn(2)[0]))
    batch.reset(np.zeros(1, dtype=np.int64))
    state = None
    for _ in range(round(seconds / config.control_period)):
        action, state = controller.predict(batch.observation, state)
        batch.step(config.action_kind.commands(action, 1))
    return batch.streams.tally[0].copy()


class CrowdController:
    """Brakes parcels on the lower half of a slope for 4 s, so that they push, then for 1 s not."""

    def predict(self, observation: Any, state: Any = None, *_: Any, **__: Any) -> tuple[Any, Any]:
        periods = 0 if state is None else state
        choices = np.full((*observation.shape[:2], 2), ROLL)
        if periods % 125 < 100:
            choices[ta.COLUMN.to_the_end.of(observation) < 2.5] = BRAKE
        return choices.reshape(len(observation), -1), periods + 1


def make_config(task: str, latency: float = LATE, **given: Any) -> EnvConfig:
    """Return the configuration of a stream with a camera."""
    camera = sg.sensors.Camera(latency=latency, drop=SHARE)
    return EnvConfig(task, actions="parcels", sensors=camera, duration=DURATION, **given)


def compare_streams(
    name: str, config: EnvConfig, controller: Controller, seeds: Sequence[int], seconds: float,
    least: float,
) -> list[Figure]:  # fmt: skip
    """Compare deliveries with a tracker and with known parcels; count the tracker's mistakes."""
    tracker, options = StreamTracker(config), WorldOptions(false=SHARE)
    by_tracker = by_camera = swapped = lost = 0
    for seed in track(seeds, name, console=Console(stderr=True)):
        run = run_tracked(tracker, config, controller, seed, seconds, options)
        by_tracker += int(run.world.streams.tally[0, CORRECT])
        by_camera += int(run_known(config, controller, seed, seconds)[CORRECT])
        swapped, lost = swapped + len(run.swapped), lost + len(run.lost)
    return [
        Figure(f"{name}: swapped", swapped, "parcels", most=0),
        Figure(f"{name}: lost", lost, "parcels"),
        Figure(f"{name}: delivered correctly", by_tracker, "parcels"),
        Figure(f"{name}: over known parcels", by_tracker / by_camera, "", least=least),
    ]


def compare_crowds(seeds: Sequence[int]) -> list[Figure]:
    """Measure the share of swapped or lost parcels in pushing crowds, and the time of a period."""
    figures = []
    for latency, most in ((0.0, 0.03), (LATE, 0.08)):
        crowd = {"stream": ta.bulk(14_000.0), "max_parcels": 30, "randomisation": VARIED}
        config = make_config("singulate", latency, **crowd)
        tracker, options = TimedTracker(config), WorldOptions(false=SHARE, merged=MERGED)
        entered = swapped = mistaken = 0
        name = f"crowd that pushes, {1e3 * latency:g} ms late"
        for seed in track(seeds, name, console=Console(stderr=True)):
            run = run_tracked(tracker, config, CrowdController(), seed, 40.0, options)
            entered += int(run.world.streams.tally[0, ENTERED])
            swapped, mistaken = swapped + len(run.swapped), mistaken + len(run.swapped | run.lost)
        figures += [
            Figure(f"{name}: parcels", entered, ""),
            Figure(f"{name}: swapped", swapped / entered, "", most=most),
            Figure(f"{name}: swapped or lost", mistaken / entered, ""),
        ]
    spent = [1e3 * seconds for parcels, seconds in tracker.periods if parcels >= FULL]
    name = f"a period with {FULL} to 30 parcels"
    figures.append(Figure(f"{name}, median", float(np.percentile(spent, 50)), "ms", most=10.0))
    return [*figures, Figure(f"{name}, 99 %", float(np.percentile(spent, 99)), "ms", most=20.0)]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run all comparisons, and print a table."""
    options = tyro.cli(TrackingOptions, prog="python -m benchmarks.tracking", args=arguments)
    figures, first = [], options.seed
    if options.flows:
        stream = Stream(Poisson(3000.0), ("S", "B"), speeds=1.5)
        config = make_config("flow", gate=True, queue=library.QUEUE, stream=stream, exits="sides")
        policy = library.load("flow-schedule", config=config.replace(duration=60.0))
        seeds = range(first, first + options.flows)
        figures += compare_streams("Flow, flow-schedule", config, policy, seeds, 60.0, 0.99)
    if options.singulations:
        config = make_config("singulate", randomisation=VARIED)
        rule = find_rules("singulate")[0].make(config)
        seeds = range(first, first + options.singulations)
        figures += compare_streams("Singulate, time slots", config, rule, seeds, 30.0, 0.95)
    if options.crowds:
        figures += compare_crowds(range(first, first + options.crowds))
    Console().print(figure_table(figures, "5 % of poses lost, 5 % false, 40 ms late"))


if __name__ == "__main__":
    main()
