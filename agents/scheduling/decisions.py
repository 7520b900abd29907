"""Decisions of a schedule: the maneuver of the next parcel, and its clearance.

A decision concerns the parcel at the gate. Candidates are pairs of a maneuver and a level of
clearance. The decision is made once, when the parcel could enter. The gate opens at the chosen
time.
"""

from abc import abstractmethod
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from surface_gym import Randomisation, checks
from surface_gym.compiler.jit import compiled
from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import HOUR
from surface_gym.flow.task import COLUMN
from surface_gym.sensors import Exact

from ..base import Booleans, Integers, Numbers, Singles, is_fresh
from .bounds import entrance_bound
from .features import LEVELS, USUAL, Candidates, Features, ParcelHistory
from .leading import (
    DEPTH,
    NOBODY,
    SHUT,
    Book,
    Workspace,
    enter,
    find_next,
    follow,
    lead,
    recognise_row,
)
from .maneuvers import MARGIN, Library, find_delay, make_library
from .scheduler import LONGEST_GAP, Scheduler, renew

ABSENT = 1e6  # cost of a missing option


class Decisions(NamedTuple):
    """Due decisions with their features; see `features`."""

    env: Integers  # (decisions,) index of the environment
    cost: Singles  # (decisions, options, levels) [parcels] deliveries lost meanwhile
    option: Singles  # (decisions, options, OPTION)
    token: Singles  # (decisions, TOKENS, TOKEN)
    shown: Booleans  # (decisions, TOKENS)
    about: Singles  # (decisions, ABOUT) of the line


class Choice(NamedTuple):
    """Decision for the parcel at the gate, per environment."""

    maneuver: Integers  # (num_envs,) NOBODY: undecided
    entry: Numbers  # (num_envs,) [s] time of entry


@compiled
def find_entries(
    tight: Numbers, wide: Numbers, levels: Numbers, options: Integers, booked: Integers,
    entered: Numbers, now: float, entry: Numbers, binding: Integers,
) -> None:  # fmt: skip
    """Find the earliest entry time for each option and level of clearance.

    Args:
        entry: (options, levels) output: earliest entry time [s].
        binding: (options, levels) output: index of the booked parcel to wait for; -1: none.
    """
    for o in range(options.shape[0]):
        for level in range(levels.shape[0]):
            entry[o, level], binding[o, level] = now, -1
            for k in range(booked.shape[0] if options[o] >= 0 else 0):
                low, high = tight[booked[k], options[o]], wide[booked[k], options[o]]
                time = entered[k] + low + levels[level] * (high - low)
                if time > entry[o, level]:
                    entry[o, level], binding[o, level] = time, k


@compiled
def find_costs(
    gaps: Numbers, delay: Numbers, options: Integers, queue: Integers, booked: Integers,
    entered: Numbers, now: float, space: Workspace, cost: Numbers,
) -> None:  # fmt: skip
    """Write the least cost [s] found by `search` for each option of the first parcel.

    Args:
        options: (kinds + 1, most) options of a library, and a scratch row of -1 except for its
            first entry.
        queue: (parcels,) queue for `search`; the first entry is overwritten.
    """
    last = options.shape[0] - 1
    kind = queue[0]
    queue[0] = last
    for o in range(options.shape[1]):
        cost[o] = np.inf
        if options[kind, o] >= 0:
            options[last, 0] = options[kind, o]
            find_next(gaps, delay, options, queue, booked, entered, now, space)
            cost[o] = space.cost[queue.shape[0] - 1, 0]


class DecidingScheduler(Scheduler):
    """Scheduler that decides once per parcel at the gate, among its candidates.

    Args:
        config: configuration of the environment, with a gate and actions "parcels".
        library: library of maneuvers; None: made from single parcels on a nominal surface.
    """

    def __init__(self, config: EnvConfig, library: Library | None = None) -> None:
        made = make_model_library(config) if library is None else library
        super().__init__(config, made)
        close = made.with_one_speed(0.0, 0.0)
        wide = made.with_clearance(MARGIN, config.control_period / made.lead.ahead)
        self.tight = np.minimum(close.gaps, LONGEST_GAP)
        self.wide = np.clip(wide.gaps, self.tight, LONGEST_GAP)
        self._gaps = self.tight + LEVELS[USUAL] * (self.wide - self.tight)
        self._delay = find_delay(self._gaps, made.options)
        self._options = np.pad(made.options, ((0, 1), (0, 0)), constant_values=NOBODY)
        self._features = Features(config, made, self._delay)
        self._mean_gap = HOUR / entrance_bound(config)  # [s]

    @abstractmethod
    def choose(self, decisions: Decisions) -> tuple[Integers, Integers]:
        """Choose an option and a level of clearance for each decision (decisions,)."""

    def _predict(
        self, batch: Singles, state: Any, episode_start: Any, **_: bool
    ) -> tuple[Integers, Any]:
        num_envs = len(batch)
        book, watched = self._start(num_envs), self._features.start(num_envs)
        chosen = Choice(np.full(num_envs, NOBODY), np.zeros(num_envs))
        if state is not None:
            fresh = is_fresh(num_envs, state, episode_start)
            checks.alike("state", state, (book, watched, chosen))
            book = Book(*renew(book, state[0], fresh))
            watched = ParcelHistory(*renew(watched, state[1], fresh))
            chosen = Choice(*renew(chosen, state[2], fresh))
        follow(batch, self._orders, book)
        watched = self._features.watch(batch, book, watched)
        chosen = self._decide(batch, book, watched, chosen)
        opens, chosen = self._let_in(batch, book, chosen)
        actions = self._rest(num_envs)
        lead(batch, self._way, book.rows, book.stands, actions)
        actions[:, -1] = opens
        book.clock[:] += self._orders.period
        return actions, (book, watched, chosen)

    def _decide(
        self, tables: Singles, book: Book, watched: ParcelHistory, chosen: Choice
    ) -> Choice:
        """Decide for undecided parcels at the gate that may enter now."""
        waits = COLUMN.present.of(tables[:, self._parcels]) > 0.5
        maneuver, entry = np.where(waits, chosen.maneuver, NOBODY), chosen.entry.copy()
        found = self._candidates(tables, book, np.nonzero(waits & (maneuver == NOBODY))[0])
        if found is not None:
            option, level = self.choose(self._describe(tables, book, watched, found))
            each = np.arange(len(option))
            maneuver[found.env] = self.library.options[found.queue[:, 0], option]
            entry[found.env] = found.entry[each, option, level]
        return Choice(maneuver, entry)

    def _let_in(self, tables: Singles, book: Book, chosen: Choice) -> tuple[Integers, Choice]:
        """Open the gate (num_envs,) for due parcels, and book them."""
        opens = np.full(len(tables), SHUT)
        late = (chosen.entry - book.clock) / self._orders.dt - 1e-6
        step = np.ceil(late).astype(np.int64).clip(1)
        now = (chosen.maneuver != NOBODY) & (step <= self._orders.steps)
        opens[now] = step[now]
        enter(tables, self._orders, book, chosen.maneuver, opens)
        return opens, chosen._replace(maneuver=np.where(now, NOBODY, chosen.maneuver))

    def _candidates(self, tables: Singles, book: Book, undecided: Integers) -> Candidates | None:
        """Return the candidates for undecided parcels that may enter now, or None.

        A parcel may enter now if the smallest clearance allows an entry within this period.
        """
        most = self.library.options.shape[1]
        found = []
        for i in undecided.tolist():
            waiting = tables[i, self._parcels : self._parcels + DEPTH]
            there = waiting[COLUMN.present.of(waiting) > 0.5]
            queue = np.array([recognise_row(row, self._orders.signature) for row in there])
            entry, binding = np.empty((most, len(LEVELS))), np.empty((most, len(LEVELS)), np.int64)
            options, now = self.library.options[queue[0]], book.clock[i] + self._orders.dt
            find_entries(
                self.tight, self.wide, LEVELS, options, book.booked[i], book.entered[i], now, entry,
                binding,
            )  # fmt: skip
            is_option = options >= 0
            if entry[is_option, 0].min() > book.clock[i] + self._orders.period:
                continue
            cost = np.empty(most)
            find_costs(
                self._gaps, self._delay, self._options, queue.copy(), book.booked[i],
                book.entered[i], now, self._space, cost,
            )  # fmt: skip
            whole = np.full(DEPTH, NOBODY)
            whole[: len(queue)] = queue
            cost = np.where(is_option, cost - cost.min(), 1.0)
            found.append(Candidates(np.array(i), whole, entry, binding[:, USUAL], cost))
        return Candidates(*map(np.array, zip(*found, strict=True))) if found else None

    def _describe(
        self, tables: Singles, book: Book, watched: ParcelHistory, found: Candidates
    ) -> Decisions:
        later = found.entry - found.entry[..., USUAL, np.newaxis]
        spent = (found.cost[..., np.newaxis] + later) / self._mean_gap
        spent[self.library.options[found.queue[:, 0]] == NOBODY] = ABSENT
        token, shown = self._features.tokens(tables, book, watched, found)
        return Decisions(
            found.env,
            spent.astype(np.float32),
            self._features.options(tables, book, watched, found),
            token,
            shown,
            np.tile(self._features.about, (len(found.env), 1)),
        )


def make_model_library(config: EnvConfig) -> Library:
    """Make the library of the nominal surface, without randomisation and sensor errors."""
    actuators = replace(config.actuators, stuck_share=0.0)
    model = config.replace(sensors=Exact(), randomisation=Randomisation(), actuators=actuators)
    return make_library(model, margin=0.0, slack=0.0)
