"""Capacity of a line: the highest rate of parcels that a method sustains on a stream.

A rate is sustained where nearly all deliveries are right and nothing jams.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

import surface_gym as sg
from surface_gym import checks
from surface_gym.config import EnvConfig, Preset
from surface_gym.flow.arrivals import HOUR, Steady
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import BETWEEN, CORRECT, JAM, TURNS, compute_statistics
from surface_gym.flow.stream import Stream
from surface_gym.state import RUNNING

from ..base import Controller, Numbers
from ..scheduling.bounds import entrance_bound
from ..scheduling.scheduler import begin_streams
from .benchmark import SEED, half_interval

SPEEDS = (1.0, 1.5, 2.0)  # [m/s]
MIXES = {"S": ("S",), "S and B": ("S", "B")}  # parcels by name, of equal odds
EXITS = {  # by name, at equal odds
    "sides": "left, right (a chute as long as the line on either side) and straight on",
    "chutes": "two chutes on either side and straight on, the environment's default",
}
EXACT = Preset("exact", "exact", "Sensors show pose and velocity as they are.")
STREAM_PRESETS = {
    "exact": EXACT,
    "camera": Preset(
        "camera",
        "camera",
        "A camera's frames, 1 mm and 0.5 deg off and 20 ms late, and a filter; mu_max differs from "
        "parcel to parcel by up to 20 %.",
        sensors=sg.sensors.Camera(),
        randomisation=sg.Randomisation(friction=0.2),
    ),
}
LEAST_RIGHT = {"exact": 0.999, "camera": 0.995}  # [-] of deliveries, for a rate to be sustained

SECONDS = 30.0  # [s] of an episode
REPLICATIONS = 30
WARM_UP = 8.0  # [s] at least, in which nothing counts: at 1 m/s one takes 6.5 s to the line's end
PRECISION = 1.02  # [-] between a rate that is sustained and one that is not
LEAST = 1.0 / 16.0  # [-] of what the entrance takes, below which there is no capacity
CARRIED = 0.98  # [-] of what is offered, so that the queue does not grow
CHECK_EVERY = 10  # control periods between checks whether a rate can still be sustained


@dataclass(frozen=True)
class Case:
    """Parcels at one speed under a preset, at whatever rate they are offered."""

    mix: str  # one of MIXES
    speed: float  # [m/s] at which they enter
    preset: str = "exact"  # one of STREAM_PRESETS
    exits: str = "sides"  # one of EXITS

    @property
    def label(self) -> str:
        return f"{self.mix}, {self.speed:g} m/s"

    @cached_property
    def ceiling(self) -> float:
        """[parcels/h] that no controller can exceed: more do not come through the entrance."""
        return entrance_bound(EnvConfig("flow", stream=self.stream(1.0), exits=self.exits))

    def stream(self, rate: float) -> Stream:
        """Make the stream in which parcels come evenly at a rate [parcels/h]."""
        return Stream(Steady(rate), parcels=MIXES[self.mix], speeds=self.speed)


@dataclass(frozen=True)
class StreamMethod:
    """A controller of streams of parcels."""

    name: str
    actions: str  # kind of action
    gate: bool  # whether it says which parcel may enter when
    # of the environment it acts in; None where it cannot sort such parcels
    make: Callable[[EnvConfig], Controller | None]
    presets: tuple[str, ...] = ("exact", "camera")
    control_period: float = 0.04  # [s]
    orientations: tuple[float, ...] | None = None  # [rad] on offer; None: those of the line
    queue: int = 1  # parcels that wait at the gate, shown

    def config(self, case: Case, rate: float) -> EnvConfig:
        """Configure the environment it acts in, parcels coming evenly at a rate [parcels/h]."""
        preset = STREAM_PRESETS[case.preset]
        return EnvConfig(
            "flow",
            stream=case.stream(rate),
            exits=case.exits,
            actions=self.actions,
            orientations=self.orientations,
            sensors=preset.sensors,
            control_period=self.control_period,
            duration=SECONDS,
            actuators=preset.actuators,
            randomisation=preset.randomisation,
            gate=self.gate,
            queue=self.queue,
        )


@dataclass(frozen=True)
class Measurement:
    """Deliveries of parcels offered at one rate, replication by replication."""

    offered: float  # [parcels/h]
    right: list[int]  # (replications,) deliveries by the parcel's own exit, after the warm-up
    delivered: list[int]  # (replications,) by any
    touches: list[float]  # (replications,) times that two of these began to touch
    waiting: list[float]  # (replications,) [s] at the entry, mean over those that came and entered
    jams: int  # replications that ended in one
    counted: float  # [s] after the warm-up
    turns: float  # [-] of modules' axes per parcel delivered right, of whole episodes

    def __post_init__(self) -> None:
        each: list[Sequence[float]] = [self.right, self.delivered, self.touches, self.waiting]
        if not self.right or len({len(values) for values in each}) > 1:
            raise ValueError(f"each replication must have its deliveries, got {self.right}")
        checks.positive("counted", self.counted)

    @property
    def rates(self) -> Numbers:
        """(replications,) [parcels/h] delivered right."""
        return HOUR * np.array(self.right) / self.counted

    @property
    def rate(self) -> float:
        return float(self.rates.mean())

    @property
    def margin(self) -> float:
        """[parcels/h] half of the mean rate's 95 % interval, Student's."""
        return half_interval(self.rates)

    @property
    def share_right(self) -> float:
        """[-] of deliveries; 0 where there were none."""
        return sum(self.right) / max(1, sum(self.delivered))

    @property
    def touches_per_1000(self) -> float:
        """[-] deliveries."""
        return 1000.0 * sum(self.touches) / max(1, sum(self.delivered))

    @property
    def waited(self) -> float:
        """[s] at the entry, mean."""
        return float(np.mean(self.waiting))

    def is_sustained(self, case: Case) -> bool:
        return self.jams == 0 and self.share_right >= LEAST_RIGHT[case.preset]


def counted_time(duration: float, rate: float) -> float:
    """Compute how much [s] of an episode's end counts.

    It is whole gaps between parcels, at least one, so that it makes no difference when the first
    parcel came.
    """
    gap = HOUR / rate
    return min(duration, gap * max(1, math.floor((duration - WARM_UP) / gap + 1e-9)))


def measure(
    method: StreamMethod, controller: Controller, case: Case, rate: float, whole: bool = True
) -> Measurement | None:
    """Offer parcels at a rate [parcels/h].

    Args:
        whole: whether to go on to the end even where the rate is plainly not sustained.
    """
    least_right = 0.0 if whole else LEAST_RIGHT[case.preset]
    return measure_stream(method.config(case, rate), controller, rate, least_right)


def measure_stream(
    config: EnvConfig, controller: Controller, rate: float, least_right: float = 0.0
) -> Measurement | None:
    """Run replications of a configured stream, which offers parcels at a rate [parcels/h].

    Args:
        least_right: [-] of deliveries; once fewer are sure, or anything jams, it ends with None.
    """
    batch = begin_streams(config, REPLICATIONS, SEED)
    counted = counted_time(config.stream_task.duration, rate)
    begin = config.stream_task.duration - counted
    most_wrong = (1.0 - least_right) * int(batch.streams.arrivals.sum())
    actions = config.action_kind
    state, period = None, 0
    while (batch.outcome == RUNNING).any():
        action, state = controller.predict(batch.observation, state)
        batch.step(actions.commands(action, REPLICATIONS))
        period += 1
        if least_right and period % CHECK_EVERY == 0 and _is_lost(batch, begin, most_wrong):
            return None
    return _count(batch, rate, counted)


def _is_lost(batch: StreamBatch, begin: float, most_wrong: float) -> bool:
    streams = batch.streams
    wrong = (
        (streams.departed >= begin) & (streams.taken >= BETWEEN) & (streams.taken != streams.exit)
    )
    return bool((streams.outcome == JAM).any() or wrong.sum() > most_wrong)


def _count(batch: StreamBatch, rate: float, counted: float) -> Measurement:
    streams = batch.streams
    begin = batch.config.stream_task.duration - counted
    right, delivered, touches, waiting = [], [], [], []
    for k in range(REPLICATIONS):
        found = compute_statistics(streams, k, bool(streams.outcome[k] == JAM), 1, begin)
        some = found.delivered > 0
        delivered.append(found.delivered)
        right.append(round(found.delivered * (1.0 - found.missort_rate)) if some else 0)
        touches.append(found.touches_per_1000 * found.delivered / 1000.0 if some else 0.0)
        waiting.append(0.0 if math.isnan(found.waiting_mean) else found.waiting_mean)
    jams = int((streams.outcome == JAM).sum())
    tally = streams.tally.sum(axis=0)
    turns = float(tally[TURNS] / max(1, tally[CORRECT]))
    return Measurement(rate, right, delivered, touches, waiting, jams, counted, turns)


def find_capacity(method: StreamMethod, controller: Controller, case: Case) -> Measurement | None:
    """Search the greatest rate that a method sustains, to 2 %; None where it sustains none.

    What the entrance takes at most comes first: a method that keeps parcels waiting at a gate may
    sustain whatever is offered. One that sustains it without a gate, by parcels that push each
    other on, may deliver more where fewer come. Else the rate is halved until it is sustained, and
    then searched for between that and the last that was not.
    """

    def sustained(rate: float) -> Measurement | None:
        found = measure(method, controller, case, rate, whole=False)
        return found if found is not None and found.is_sustained(case) else None

    high = low = case.ceiling
    best = sustained(low)
    if best is not None and not method.gate:
        return _most_carried(sustained, best)
    while best is None:
        if low <= LEAST * case.ceiling:
            return None
        high, low = low, 0.5 * low
        best = sustained(low)
    while high > PRECISION * low:
        middle = math.sqrt(low * high)
        found = sustained(middle)
        if found is None:
            high = middle
        else:
            low, best = middle, found
    return best


def _most_carried(
    sustained: Callable[[float], Measurement | None], most: Measurement
) -> Measurement:
    """Find the most delivered: offered most, or at the greatest rate that is carried."""
    low, high = most.rate, most.offered
    while high > PRECISION * low:
        middle = math.sqrt(low * high)
        found = sustained(middle)
        if found is not None and found.rate > most.rate:
            most = found
        if found is not None and found.rate >= CARRIED * middle:
            low = middle
        else:
            high = middle
    return most
