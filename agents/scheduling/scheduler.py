"""Scheduler: books each parcel's maneuver and moment of entry together, and leads it so.

Of the parcels that wait it chooses maneuvers by a beam search: those with which the last of them
enters soonest, the mean gap of one more behind it included.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import partial
from operator import itemgetter
from typing import Any, NamedTuple, TypeVar

import numpy as np

from surface_gym import checks
from surface_gym.compiler.jit import compiled
from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import HOUR
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import CORRECT, JAM, TOUCHES, WRONG
from surface_gym.flow.task import COLUMN
from surface_gym.state import RUNNING

from ..base import BatchController, Booleans, Integers, Numbers, Singles, is_fresh
from .bounds import entrance_bound
from .maneuvers import MARGIN, ColumnGroups, Library, make_library
from .trajectories import SIGNATURE

BOOKED = 24  # the latest entries that a new one is held against
WIDTH = 16  # sequences that the search keeps
DEPTH = 8  # parcels that wait and are looked at, at most
SHUT = 0
LONG_AGO = -1e6  # [s]
NOBODY = -1
# What is kept clear, tried in turn: the share of a control period, and the margin [m].
CLEARANCES = ((0.25, MARGIN), (0.5, MARGIN), (0.75, MARGIN), (1.0, MARGIN), (1.5, 2.0 * MARGIN))
SLACKS = np.geomspace(0.1, 4.0, 24)  # [-] that may be kept, where some touches are allowed
LONGEST_GAP = 8.0  # [s] that is waited where two never keep clear
LEAST_RIGHT = 0.999  # [-] of deliveries in a trial
TRIED = 16  # episodes of a trial
TRIAL = 20.0  # [s] of each
TRIAL_SEED = 1_000_003


AnyScheduler = TypeVar("AnyScheduler", bound="Scheduler")


class Workspace(NamedTuple):
    """Sequences of maneuvers that a search keeps, by how many parcels they are for, best first."""

    maneuver: Integers  # (DEPTH, WIDTH) of the last parcel
    time: Numbers  # (DEPTH, WIDTH) [s] when it enters
    before: Integers  # (DEPTH, WIDTH) the sequence that is one parcel shorter
    cost: Numbers  # (DEPTH, WIDTH) [s] when one more behind it is to enter, in the mean


def make_workspace() -> Workspace:
    """Make the arrays of a search."""
    shape = (DEPTH, WIDTH)
    return Workspace(
        np.zeros(shape, dtype=np.int64), np.zeros(shape), np.zeros(shape, dtype=np.int64),
        np.zeros(shape),
    )  # fmt: skip


@compiled
def search(
    gaps: Numbers, delay: Numbers, options: Integers, queue: Integers, booked: Integers,
    entered: Numbers, now: float, space: Workspace,
) -> tuple[int, float]:  # fmt: skip
    """Find the maneuver of the next parcel to enter, and when [s] it enters.

    Args:
        gaps: (maneuvers, maneuvers) [s], `delay` and `options` as `Library` has them.
        queue: (parcels,) kind of each that waits, the next to enter first.
        booked: (BOOKED,) maneuvers that entered at `entered` (BOOKED,) [s].
        now: [s] before which none enters.
    """
    count = 1
    for depth in range(queue.shape[0]):
        maneuver, entry = space.maneuver[depth], space.time[depth]
        before, cost = space.before[depth], space.cost[depth]
        kept = 0
        for sequence in range(count):
            for column in range(options.shape[1]):
                option = options[queue[depth], column]
                if option < 0:
                    break
                time = now
                for k in range(booked.shape[0]):
                    time = max(time, entered[k] + gaps[booked[k], option])
                at = sequence
                for k in range(depth - 1, -1, -1):
                    time = max(time, space.time[k, at] + gaps[space.maneuver[k, at], option])
                    at = space.before[k, at]
                place = kept
                while place > 0 and time + delay[option] < cost[place - 1]:
                    place -= 1
                if place == WIDTH:
                    continue
                kept = min(WIDTH, kept + 1)
                for k in range(kept - 1, place, -1):
                    maneuver[k], entry[k] = maneuver[k - 1], entry[k - 1]
                    before[k], cost[k] = before[k - 1], cost[k - 1]
                maneuver[place], entry[place] = option, time
                before[place], cost[place] = sequence, time + delay[option]
        count = kept
    at = 0
    for k in range(queue.shape[0] - 1, 0, -1):
        at = space.before[k, at]
    return space.maneuver[0, at], space.time[0, at]


def predict_rate(
    library: Library, odds: Numbers, parcels: int = 2000, depth: int = DEPTH, seed: int = 0
) -> float:
    """Predict how many parcels an hour enter where some always wait, of kinds with odds (kinds,)
    independent of each other.
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


class Book(NamedTuple):
    """What a scheduler remembers, per environment."""

    clock: Numbers  # (num_envs,) [s] since the episode began
    booked: Integers  # (num_envs, BOOKED) maneuvers of the latest entries, the last first
    entered: Numbers  # (num_envs, BOOKED) [s]
    due: Numbers  # (num_envs,) [s] when the one that was let in last had come
    pending: Booleans  # (num_envs,) whether that one has yet to be seen to have entered
    rows: Integers  # (num_envs, parcels) maneuver of the parcel in each row, or NOBODY
    stands: Integers  # (num_envs, groups) orientation of each group


def renew(start: Iterable[Any], state: Iterable[Any], fresh: Booleans) -> Iterator[Any]:
    """Yield arrays (num_envs, ...) of a memory, as at the start where an episode is fresh."""
    for new, old in zip(start, state, strict=True):
        yield np.where(fresh.reshape(-1, *[1] * (old.ndim - 1)), new, old)


class Scheduler(BatchController):
    """Books maneuvers and entries of the parcels that wait, and leads those on the line.

    Args:
        config: of the environment, with a gate. Its `queue` is how far the scheduler looks ahead.
        library: of maneuvers; None: one is made, where every module obeys by itself.
    """

    def __init__(self, config: EnvConfig, library: Library | None = None) -> None:
        self.library = make_library(config) if library is None else library
        self._shape = (config.rows, len(config.features))
        self._parcels = config.stream_task.max_parcels
        self._period, self._dt = config.control_period, config.timing.dt
        self._steps = config.timing.steps
        self._space = make_workspace()

    def _start(self, num_envs: int) -> Book:
        groups = 0 if self.library.lead.groups is None else len(self.library.lead.spans)
        return Book(
            clock=np.zeros(num_envs),
            booked=np.zeros((num_envs, BOOKED), dtype=np.int64),
            entered=np.full((num_envs, BOOKED), LONG_AGO),
            due=np.full(num_envs, np.nan),
            pending=np.zeros(num_envs, dtype=np.bool_),
            rows=np.full((num_envs, self._parcels), NOBODY),
            stands=np.full((num_envs, groups), self.library.lead.axes.roll),
        )

    def _predict(
        self, batch: Singles, state: Book | None, episode_start: Any, **_: bool
    ) -> tuple[Integers, Book]:
        num_envs = len(batch)
        fresh = is_fresh(num_envs, state, episode_start)
        book = self._start(num_envs)
        if state is not None:
            book = Book(*renew(book, checks.alike("state", state, book), fresh))
        book = self._follow(batch, book)
        opens, book = self._open(batch, book)
        return self._act(batch, book, opens)

    def _act(self, tables: Singles, book: Book, opens: Integers) -> tuple[Integers, Book]:
        """Lead the parcels on the line for a control period, and open the gate (num_envs,)."""
        actions, stands = self.library.lead.choose(
            tables, self.library.maneuvers, book.rows, book.stands
        )
        book = book._replace(clock=book.clock + self._period, stands=stands)
        return np.concatenate([actions, opens[:, np.newaxis]], axis=1), book

    def _follow(self, tables: Singles, book: Book) -> Book:
        """Find the row of the parcel that entered, or take back its entry where it still waits."""
        here = COLUMN.present.of(tables[:, : self._parcels]) > 0.5
        rows = np.where(here, book.rows, NOBODY)
        waits = COLUMN.present.of(tables[:, self._parcels]) > 0.5
        due = book.clock + COLUMN.time.of(tables[:, self._parcels]).astype(np.float64)
        stayed = book.pending & waits & (np.abs(due - book.due) < 1e-3)
        entered, booked = book.entered.copy(), book.booked.copy()
        entered[stayed] = np.roll(entered[stayed], -1, axis=1)
        booked[stayed] = np.roll(booked[stayed], -1, axis=1)
        entered[stayed, -1] = LONG_AGO
        new = here & (rows == NOBODY)
        came = book.pending & ~stayed
        rows = np.where(new & came[:, np.newaxis], booked[:, :1], rows)
        unknown = new & ~came[:, np.newaxis]
        if unknown.any():  # on the line before the scheduler was
            kinds = self._recognise(tables[:, : self._parcels][unknown])
            rows[unknown] = self.library.options[kinds, 0]
        return book._replace(rows=rows, entered=entered, booked=booked)

    def _open(self, tables: Singles, book: Book) -> tuple[Integers, Book]:
        """Choose when the gate opens (num_envs,), and book it."""
        opens, maneuver = np.full(len(tables), SHUT), np.full(len(tables), NOBODY)
        waiting = tables[:, self._parcels :]
        waits = COLUMN.present.of(waiting[:, :DEPTH]) > 0.5
        library, space = self.library, self._space
        for i in np.nonzero(waits[:, 0])[0].tolist():
            clock = book.clock[i]
            queue = self._recognise(waiting[i, : waits[i].sum()])
            chosen, time = search(
                library.gaps, library.delay, library.options, queue, book.booked[i],
                book.entered[i], clock + self._dt, space,
            )  # fmt: skip
            step = int(np.ceil((time - clock) / self._dt - 1e-6))
            if step <= self._steps:
                opens[i], maneuver[i] = step, chosen
        return opens, self._enter(tables, book, maneuver, opens)

    def _enter(self, tables: Singles, book: Book, maneuver: Integers, opens: Integers) -> Book:
        """Book a maneuver (num_envs,) for those for whom the gate opens."""
        now = opens != SHUT
        booked, entered, due = book.booked.copy(), book.entered.copy(), book.due.copy()
        booked[now] = np.roll(booked[now], 1, axis=1)
        entered[now] = np.roll(entered[now], 1, axis=1)
        booked[now, 0] = maneuver[now]
        entered[now, 0] = book.clock[now] + self._dt * opens[now]
        waited = COLUMN.time.of(tables[now, self._parcels]).astype(np.float64)
        due[now] = book.clock[now] + waited
        return book._replace(booked=booked, entered=entered, due=due, pending=now)

    def _recognise(self, rows: Singles) -> Integers:
        """Recognise (parcels,) the kind of each parcel, by what is seen of it."""
        seen = rows[:, SIGNATURE].astype(np.float64)
        apart = np.abs(seen[:, np.newaxis] - self.library.signature).max(axis=2)
        return apart.argmin(axis=1)


def make_scheduler(
    config: EnvConfig, groups: ColumnGroups | None = None, least_right: float = LEAST_RIGHT
) -> Scheduler | None:
    """Make the scheduler that carries most, of those by which no two parcels touch.

    Parcels are kept the less apart the better their trajectories are known; see `choose_by_trial`.

    Args:
        config: of the environment; actions "parcels" without groups, "modules" with them.
        least_right: [-] of deliveries in a trial; with fewer there is none, and None is returned.
    """
    library = make_library(config, groups)
    apart = (library.with_clearance(margin, slack) for slack, margin in CLEARANCES)
    tried = (Scheduler(config, each) for each in apart if np.isfinite(each.gaps).all())
    return choose_by_trial(config, tried, least_right)


def choose_by_trial(
    config: EnvConfig, schedulers: Iterable[Scheduler], least_right: float = LEAST_RIGHT
) -> Scheduler | None:
    """Choose the first scheduler whose trial has no touch and no jam; if all have, the one with the
    fewest touches.

    Args:
        schedulers: that may be chosen, those that carry most first.
        least_right: [-] of deliveries; if all have fewer, None is returned.
    """
    chosen, fewest = None, math.inf
    for scheduler in schedulers:
        trial = run_trial(config, scheduler, fewest)
        enough = trial.right >= least_right * max(1, trial.right + trial.wrong)
        if trial.jams == 0 and trial.touches < fewest and enough:
            chosen, fewest = scheduler, trial.touches
        if fewest == 0:
            break
    return chosen


def find_quiet(
    config: EnvConfig, make: Callable[[int], AnyScheduler], count: int, most_touches: float = 0.0
) -> tuple[AnyScheduler, int]:
    """Find the first of several schedulers whose trial has no jam and few touches, by bisection;
    the last one where none has. Return it, and how many parcels it delivered right once the line
    was full, 0 there.

    Args:
        make: one by its place; the later it is, the less it carries and the fewer touch.
        count: of schedulers.
        most_touches: [-] per delivery.
    """
    tried = entrance_bound(config) / HOUR * TRIED * TRIAL  # parcels, at most
    found, right = make(count - 1), 0
    low, high = 0, count
    while low < high:
        middle = (low + high) // 2
        scheduler = make(middle)
        trial = run_trial(config, scheduler, most_touches * tried)
        if trial.jams == 0 and trial.touches <= most_touches * (trial.right + trial.wrong):
            found, right, high = scheduler, trial.late, middle
        else:
            low = middle + 1
    return found, right


def find_plain(
    config: EnvConfig, library: Library, most_touches: float = 0.0
) -> tuple[Scheduler, int]:
    """Find the scheduler of a library that keeps the least slack by which few touch, for speeds as
    they vary or for one of each kind, whichever delivers more; see `find_quiet`.
    """

    def make(apart: Callable[[float, float], Library], place: int) -> Scheduler:
        found = apart(MARGIN, SLACKS[place])
        return Scheduler(config, replace(found, gaps=np.minimum(found.gaps, LONGEST_GAP)))

    several = (library.with_clearance, library.with_one_speed)
    found = [find_quiet(config, partial(make, each), len(SLACKS), most_touches) for each in several]
    return max(found, key=itemgetter(1))


def begin_streams(config: EnvConfig, count: int, seed: int) -> StreamBatch:
    """Begin episodes of a stream, each seeded by the seed and its place."""
    batch = StreamBatch(config, count)
    for i in range(count):
        batch.seed(i, np.random.default_rng((seed, i)))
    batch.reset(np.arange(count))
    return batch


class Trial(NamedTuple):
    """Counts of episodes with always a parcel at the gate."""

    right: int  # parcels that left by their exit
    late: int  # of these, in the second half of the episodes
    wrong: int  # by another
    touches: int
    jams: int


def run_trial(config: EnvConfig, scheduler: Scheduler, most_touches: float) -> Trial:
    """Run the episodes of a trial; they end where more touch than `most_touches`."""
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
    right, wrong, touches = tally[:, [CORRECT, WRONG, TOUCHES]].sum(axis=0).tolist()
    return Trial(right, right - early, wrong, touches, int((batch.outcome == JAM).sum()))
