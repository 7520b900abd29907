"""What rates of parcels a controller holds: replications at one rate, and the search for the best.

A rate is held where nearly all deliveries are right and nothing jams.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from surface_gym.flow.arrivals import HOUR
from surface_gym.flow.batch import FlowBatch
from surface_gym.flow.memory import BETWEEN, JAM
from surface_gym.flow.statistics import statistics_of
from surface_gym.state import RUNNING

from ..controller import Controller
from ..evaluation.statistics import CONFIDENCE
from .cases import LEAST_RIGHT, Case
from .contenders import FlowContender
from .packing import Numbers

REPLICATIONS = 30
SEED = 20_261_121  # of every replication's draws, with its number
WARM_UP = 8.0  # [s] at least, in which nothing counts: at 1 m/s one takes 6.5 s to the line's end
PRECISION = 1.02  # [-] between a rate that is held and one that is not
LEAST = 1.0 / 16.0  # [-] of the ceiling: who does not hold this has no capacity
EASED = 0.8  # [-] of the capacity, offered to see how well it goes with room to spare
CARRIED = 0.98  # [-] of what is offered: nobody waits longer and longer
LOOK = 10  # control periods between looks at whether a rate can still be held


@dataclass(frozen=True)
class Measured:
    """What came of parcels offered at one rate, replication by replication."""

    offered: float  # [parcels/h]
    right: list[int]  # (replications,) deliveries by the parcel's own exit, after the warm-up
    delivered: list[int]  # (replications,) by any
    touches: list[float]  # (replications,) times that two of these began to touch
    waiting: list[float]  # (replications,) [s] at the entry, mean over those that came and entered
    jams: int  # replications that ended in one
    counted: float  # [s] after the warm-up

    @property
    def rates(self) -> Numbers:
        """(replications,) [parcels/h] delivered right."""
        return HOUR * np.array(self.right) / self.counted

    @property
    def rate(self) -> float:
        """[parcels/h] delivered right, mean."""
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

    def is_held(self, case: Case) -> bool:
        """Whether nearly all went right."""
        return self.jams == 0 and self.share_right >= LEAST_RIGHT[case.condition]


def half_interval(values: Numbers) -> float:
    """Half of Student's 95 % interval of a mean of independent values (n,), at least two."""
    count = len(values)
    spread = float(values.std(ddof=1)) / math.sqrt(count)
    return float(student.ppf(0.5 + CONFIDENCE / 2.0, count - 1)) * spread


def counted_time(duration: float, rate: float) -> float:
    """[s] of an episode's end that count: whole gaps, so that it makes no difference when the first
    parcel came; one gap at least.
    """
    gap = HOUR / rate
    return min(duration, gap * max(1, math.floor((duration - WARM_UP) / gap + 1e-9)))


def measure(
    contender: FlowContender, controller: Controller, case: Case, rate: float, whole: bool = True
) -> Measured | None:
    """Offer parcels at a rate [parcels/h].

    Args:
        contender: who decides.
        controller: the contender's, made for the case.
        case: which parcels, how fast, and under what condition.
        rate: [parcels/h] of the parcels that come, evenly.
        whole: whether to go on to the end even where the rate is plainly not held.

    Returns:
        What came of it; None where it was broken off.
    """
    settings = contender.settings(case, rate)
    batch = FlowBatch(settings, REPLICATIONS)
    for lane in range(REPLICATIONS):
        batch.seed(lane, np.random.default_rng((SEED, lane)))
    batch.start(np.arange(REPLICATIONS))
    counted = counted_time(settings.duration, rate)
    begin = settings.duration - counted
    arrivals = int(batch.streams.arrivals.sum())
    most_wrong = (1.0 - LEAST_RIGHT[case.condition]) * arrivals
    actions = settings.flow_actions
    state, period = None, 0
    while (batch.outcome == RUNNING).any():
        action, state = controller.predict(batch.observation, state)
        batch.advance(actions.commands(action, REPLICATIONS))
        period += 1
        if not whole and period % LOOK == 0 and _is_lost(batch, begin, most_wrong):
            return None
    return _measured(batch, rate, counted)


def _is_lost(batch: FlowBatch, begin: float, most_wrong: float) -> bool:
    flows = batch.streams
    wrong = (flows.left >= begin) & (flows.taken >= BETWEEN) & (flows.taken != flows.exit)
    return bool((flows.outcome == JAM).any() or wrong.sum() > most_wrong)


def _measured(batch: FlowBatch, rate: float, counted: float) -> Measured:
    flows = batch.streams
    begin = batch.settings.duration - counted
    right, delivered, touches, waiting = [], [], [], []
    for lane in range(REPLICATIONS):
        found = statistics_of(flows, lane, bool(flows.outcome[lane] == JAM), 1, begin)
        some = found.delivered > 0
        delivered.append(found.delivered)
        right.append(round(found.delivered * (1.0 - found.missort_rate)) if some else 0)
        touches.append(found.touches_per_1000 * found.delivered / 1000.0 if some else 0.0)
        waiting.append(0.0 if math.isnan(found.waiting_mean) else found.waiting_mean)
    jams = int((flows.outcome == JAM).sum())
    return Measured(rate, right, delivered, touches, waiting, jams, counted)


def find_capacity(contender: FlowContender, controller: Controller, case: Case) -> Measured | None:
    """The greatest rate that a controller holds, to 2 %; None where it holds not even the least.

    The ceiling comes first: who keeps parcels waiting at a gate may hold whatever is offered. Who
    holds it without a gate, by parcels that push each other on, may deliver more where fewer come.
    Else the rate is halved until it is held, and then searched for between that and the last that
    was not.
    """

    def held(rate: float) -> Measured | None:
        found = measure(contender, controller, case, rate, whole=False)
        return found if found is not None and found.is_held(case) else None

    high = low = case.ceiling
    best = held(low)
    if best is not None and not contender.gate:
        return _most_carried(held, best)
    while best is None:
        if low <= LEAST * case.ceiling:
            return None
        high, low = low, 0.5 * low
        best = held(low)
    while high > PRECISION * low:
        middle = math.sqrt(low * high)
        found = held(middle)
        if found is None:
            high = middle
        else:
            low, best = middle, found
    return best


def _most_carried(held: Callable[[float], Measured | None], most: Measured) -> Measured:
    """The most delivered: at the greatest rate of which nearly all is carried, or at the ceiling.

    Args:
        held: what came of a rate [parcels/h]; None where it is not held.
        most: what came of the ceiling.
    """
    low, high = most.rate, most.offered
    while high > PRECISION * low:
        middle = math.sqrt(low * high)
        found = held(middle)
        if found is not None and found.rate > most.rate:
            most = found
        if found is not None and found.rate >= CARRIED * middle:
            low = middle
        else:
            high = middle
    return most
