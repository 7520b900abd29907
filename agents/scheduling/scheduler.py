"""Scheduler: books each parcel's maneuver and time of entry, and controls the modules. A maneuver
is a position and an angle at which a parcel turns off to its exit. Parcels wait at a gate. A trial
simulates a stream with a parcel always at the gate. A touch is a contact between two parcels.

A beam search chooses maneuvers of the waiting parcels. It minimises the entry time of the last
waiting parcel, plus the mean gap to one more parcel behind it.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from operator import itemgetter
from typing import Any, NamedTuple, TypeVar

import numpy as np

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import HOUR
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import CORRECT, JAM, TOUCHES, WRONG
from surface_gym.state import RUNNING

from ..base import BatchController, Booleans, Integers, Numbers, Singles, is_fresh
from .leading import BOOKED, DEPTH, LONG_AGO, NOBODY, Book, Orders, make_workspace, schedule, search
from .maneuvers import MARGIN, ColumnGroups, Library, make_library
from .trajectories import list_asked

# Clearances in order of trial: the share of a control period, and the margin [m].
CLEARANCES = ((0.25, MARGIN), (0.5, MARGIN), (0.75, MARGIN), (1.0, MARGIN), (1.5, 2.0 * MARGIN))
SLACKS = np.geomspace(0.1, 4.0, 24)  # [-] slacks to try if some touches are allowed
LONGEST_GAP = 8.0  # [s] gap if two parcels never keep clear
LEAST_CORRECT = 0.999  # [-] minimum share of correct deliveries in a trial
TRIED = 16  # episodes per trial
TRIAL = 20.0  # [s] duration of an episode
TRIAL_SEED = 1_000_003


AnyScheduler = TypeVar("AnyScheduler", bound="Scheduler")


def entrance_bound(config: EnvConfig, odds: Numbers | None = None) -> float:
    """Compute an upper bound [parcels/h] on the throughput of any controller.

    A parcel enters when the first part of the line is clear. The length of this part is the length
    of the parcel's base plus `entry_gap`. The previous parcel does not exceed its own entry speed
    on this part, because the first columns (the lead-in) are at 90 deg. So the time between entries
    is at least the part's length divided by the previous parcel's entry speed. The bound holds if
    the lead-in is long enough, the slope is at most `LEVELLING`, and nothing pushes the parcels.
    The array `odds` (kinds,) has the odds of the kinds that `list_asked` returns. If `odds` is
    None, the odds are equal. The kinds of successive parcels are drawn independently.
    """
    kinds = list_asked(config)
    share = np.full(len(kinds), 1.0 / len(kinds)) if odds is None else odds / odds.sum()
    length = np.array([np.ptp(parcel.base.outline[:, 0]) for parcel, _, _ in kinds])
    speed = np.array([each for _, each, _ in kinds])
    clear = length + config.stream_task.entry_gap
    return float(HOUR / (share @ (1.0 / speed) * (share @ clear)))


def clairvoyant_bound(library: Library, odds: Numbers, parcels: int = 5000, seed: int = 0) -> float:
    """Compute an upper bound [parcels/h] for schedules that know the whole sequence of parcels.

    The bound holds for schedules with the maneuvers of `library`, on one random sequence of
    `parcels` parcels. The choice of maneuvers with the shortest total time gives the bound. This
    time counts only the gaps between successive parcels. Gaps to parcels farther ahead could only
    lengthen the time. Each parcel's kind is drawn with the odds `odds` (kinds,).
    """
    kinds = np.random.default_rng(seed).choice(len(odds), size=parcels, p=odds / odds.sum())
    own = library.options[kinds[0]]
    own = own[own >= 0]
    time = np.zeros(len(own))
    for kind in kinds[1:]:
        after = library.options[kind]
        after = after[after >= 0]
        time = (time[:, np.newaxis] + library.gaps[np.ix_(own, after)]).min(axis=0)
        own = after
    return float(HOUR * (parcels - 1) / time.min())


def predict_rate(
    library: Library, odds: Numbers, parcels: int = 2000, depth: int = DEPTH, seed: int = 0
) -> float:
    """Predict the rate of entries [parcels/h] if `depth` parcels always wait at the gate.

    Each parcel's kind is drawn independently by the odds `odds` (kinds,). The prediction covers the
    entries of `parcels` parcels.
    """
    rng = np.random.default_rng(seed)
    kinds = rng.choice(len(odds), size=parcels + depth, p=odds / odds.sum())
    space = make_workspace()
    booked, entered = np.zeros(BOOKED, dtype=np.int64), np.full(BOOKED, LONG_AGO)
    now = 0.0
    for k in range(parcels):
        chosen, now = search(
            library.gaps, library.delay, library.options, kinds[k : k + depth], booked, entered,
            now, space,
        )  # fmt: skip
        booked, entered = np.roll(booked, 1), np.roll(entered, 1)
        booked[0], entered[0] = chosen, now
    return HOUR * (parcels - 1) / now


def renew(start: Iterable[Any], state: Iterable[Any], fresh: Booleans) -> Iterator[Any]:
    """Yield arrays (num_envs, ...). Rows are from `start` if `fresh` is true, else from `state`."""
    for new, old in zip(start, state, strict=True):
        yield np.where(fresh.reshape(-1, *[1] * (old.ndim - 1)), new, old)


class Scheduler(BatchController):
    """Controller that books maneuvers and entries of parcels, and leads the parcels.

    Args:
        config: configuration with a gate. The scheduler considers `config.queue` waiting parcels.
        library: library of maneuvers. If None, make a new library
            in which every module turns by itself.
    """

    def __init__(self, config: EnvConfig, library: Library | None = None) -> None:
        self.library = make_library(config) if library is None else library
        self._shape = (config.rows, len(config.features))
        self._parcels = config.stream_task.max_parcels
        self._size = config.action_kind.size
        self._way = self.library.lead.describe(self.library.maneuvers)
        self._orders = Orders(
            self.library.gaps, self.library.delay, self.library.options, self.library.signature,
            self._parcels, config.timing.dt, config.timing.steps, config.control_period,
        )  # fmt: skip
        self._space, self._queue = make_workspace(), np.zeros(DEPTH, dtype=np.int64)

    def _start(self, num_envs: int) -> Book:
        groups = 0 if self.library.lead.groups is None else len(self.library.lead.spans)
        return Book(
            clock=np.zeros(num_envs),
            booked=np.zeros((num_envs, BOOKED), dtype=np.int64),
            entered=np.full((num_envs, BOOKED), LONG_AGO),
            due=np.full(num_envs, np.nan),
            pending=np.zeros(num_envs, dtype=np.bool_),
            rows=np.full((num_envs, self._parcels), NOBODY),
            stands=np.full((num_envs, groups), self.library.lead.roll),
        )

    def _predict(
        self, batch: Singles, state: Book | None, episode_start: Any, **_: bool
    ) -> tuple[Integers, Book]:
        book = self._start(len(batch))
        if state is not None:  # copy the memory of continued episodes
            fresh = is_fresh(len(batch), state, episode_start)
            book = Book(*renew(book, checks.alike("state", state, book), fresh))
        opens, actions = np.zeros(len(batch), dtype=np.int64), self._rest(len(batch))
        schedule(*self._arguments(batch, book, opens, actions))
        return actions, book

    def start_arguments(self) -> tuple[Any, ...]:
        """Return the arguments of `schedule` at the start of an episode, for one environment."""
        tables = np.zeros((1, *self._shape), dtype=np.float32)
        return self._arguments(
            tables, self._start(1), np.zeros(1, dtype=np.int64), self._rest(1)
        )  # fmt: skip

    def _arguments(
        self, tables: Singles, book: Book, opens: Integers, actions: Integers
    ) -> tuple[Any, ...]:
        return (
            tables, self._orders, self._way, book, self._space, self._queue,
            np.zeros_like(opens), opens, actions,
        )  # fmt: skip

    def _rest(self, num_envs: int) -> Integers:
        """Make the initial actions (num_envs, size)."""
        return np.full((num_envs, self._size), self.library.lead.roll)


def make_scheduler(config: EnvConfig, groups: ColumnGroups | None = None) -> Scheduler | None:
    """Make the scheduler with the smallest clearance at which a trial has no touches and no jams.

    Trials with jams or with too few correct deliveries are ignored. If all other trials have
    touches, make the scheduler with the fewest touches. If no trial remains, return None. With
    `groups`, `config` must have actions "modules"; without `groups`, `config` must have actions
    "parcels".
    """
    library = make_library(config, groups)
    chosen, fewest = None, math.inf
    for slack, margin in CLEARANCES:
        apart = library.with_clearance(margin, slack)
        if not np.isfinite(apart.gaps).all():
            continue
        scheduler = Scheduler(config, apart)
        trial = run_trial(config, scheduler, fewest)
        enough = trial.correct >= LEAST_CORRECT * max(1, trial.correct + trial.wrong)
        if trial.jams == 0 and trial.touches < fewest and enough:
            chosen, fewest = scheduler, trial.touches
        if fewest == 0:
            break
    return chosen


def find_quiet(
    config: EnvConfig, make: Callable[[int], AnyScheduler], count: int, most_touches: float = 0.0
) -> tuple[AnyScheduler, int]:
    """Find by bisection the first scheduler with no jam and few touches in its trial.

    Returns the scheduler, and its number of correct deliveries in the second half of the trial. If
    all schedulers have jams or too many touches, returns the last scheduler and 0.

    Args:
        make: function from an index to a scheduler; throughput and touches decrease with the index.
        count: number of schedulers.
        most_touches: [-] maximum touches per delivery.
    """
    tried = entrance_bound(config) / HOUR * TRIED * TRIAL  # maximum number of parcels
    found, correct = make(count - 1), 0
    low, high = 0, count
    while low < high:
        middle = (low + high) // 2
        scheduler = make(middle)
        trial = run_trial(config, scheduler, most_touches * tried)
        if trial.jams == 0 and trial.touches <= most_touches * (trial.correct + trial.wrong):
            found, correct, high = scheduler, trial.late, middle
        else:
            low = middle + 1
    return found, correct


def find_plain(
    config: EnvConfig, library: Library, most_touches: float = 0.0
) -> tuple[Scheduler, int]:
    """Find a scheduler with the least slack at which a trial has few touches.

    A trial may have no jam, and at most `most_touches` touches per delivery. `make_library`
    explains slack. The function `find_quiet` finds two schedulers. The first has gaps for variable
    speeds, the second has gaps for one speed per kind. Returns the scheduler with more correct
    deliveries, and the number of these deliveries.
    """

    def make(apart: Callable[[float, float], Library], place: int) -> Scheduler:
        found = apart(MARGIN, SLACKS[place])
        return Scheduler(config, replace(found, gaps=np.minimum(found.gaps, LONGEST_GAP)))

    several = (library.with_clearance, library.with_one_speed)
    found = [find_quiet(config, partial(make, each), len(SLACKS), most_touches) for each in several]
    return max(found, key=itemgetter(1))


def begin_streams(config: EnvConfig, count: int, seed: int) -> StreamBatch:
    """Begin `count` episodes of a stream. The generator of episode i has the seed (`seed`, i)."""
    batch = StreamBatch(config, count)
    for i in range(count):
        batch.seed(i, np.random.default_rng((seed, i)))
    batch.reset(np.arange(count))
    return batch


class Trial(NamedTuple):
    """Counts of parcels, touches and jams over all episodes of a trial."""

    correct: int  # parcels that departed by their own exit
    late: int  # correct departures in the second half of the episodes
    wrong: int  # parcels that departed by another exit
    touches: int
    jams: int


def run_trial(config: EnvConfig, scheduler: Scheduler, most_touches: float) -> Trial:
    """Run the episodes of a trial; stop them after more than `most_touches` touches in total."""
    task_ = config.stream_task
    stream = task_.stream.with_rate(entrance_bound(config))
    busy = config.replace(stream=stream, duration=min(TRIAL, task_.duration))
    batch = begin_streams(busy, TRIED, TRIAL_SEED)
    tally, state = batch.streams.tally, None
    half, early = 0.5 * busy.stream_task.duration, 0
    while (batch.outcome == RUNNING).any() and tally[:, TOUCHES].sum() <= most_touches:
        if batch.streams.clock[0] < half:
            early = int(tally[:, CORRECT].sum())
        action, state = scheduler.predict(batch.observation, state)
        batch.step(busy.action_kind.commands(action, TRIED))
    correct, wrong, touches = tally[:, [CORRECT, WRONG, TOUCHES]].sum(axis=0).tolist()
    return Trial(correct, correct - early, wrong, touches, int((batch.outcome == JAM).sum()))
