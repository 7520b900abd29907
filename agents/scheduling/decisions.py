"""Decisions of a schedule: the maneuver of the next parcel, and its clearance. A maneuver, or
option, is a position and an angle at which a parcel turns off to its exit. A candidate is an option
with a level of clearance for the parcel at the gate, where parcels wait to enter. A booked parcel
has its maneuver and time of entry. A gap is the time between two entries.

A decision is made once for a parcel, when it could enter. The gate opens at the chosen time.

A network sees numeric features of the candidate maneuvers, of other parcels and of the line. Their
number does not depend on the number of exits, positions or parcels, so one network serves any line.
"""

import math
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
from surface_gym.tasks.features import encode

from ..base import Booleans, Integers, Numbers, Singles, is_fresh
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
from .maneuvers import MARGIN, Library, find_delay, find_rears, make_library
from .scheduler import LONGEST_GAP, Scheduler, entrance_bound, renew
from .trajectories import DT, SIGNATURE, SPEED_STEP

# Levels of clearance, from just apart (0) to a margin plus a control period (1).
LEVELS = np.array([0.0, 0.15, 0.3, 0.45, 0.6, 0.8, 1.0, 1.5, 2.5, 4.0])
USUAL = 4  # index of the level used for costs
GONE = 6  # number of the last departed parcels in the features
TOKENS = 24  # maximum number of parcels in the features: waiting, on the line, and departed last

MANEUVER = (
    "place", "straight on", "angle", "duration", "length", "width", "entry speed", "delay",
    "exit speed", "to the exit's end",
)  # fmt: skip
CHOSEN = [MANEUVER.index(each) for each in ("place", "angle", "duration", "delay", "exit speed")]
STATIC, SEEN = len(MANEUVER), 3  # numbers of a maneuver; deviations from it (x, y, speed)
MOVING = [COLUMN.time, COLUMN.past_the_exit_s_start, COLUMN.lateral_offset, COLUMN.forward_speed]
KINDS = 3  # of tokens: parcels on the line, departed, and waiting
AT_SIDE, AT_STATIC = KINDS, slice(KINDS + 1, KINDS + 1 + STATIC)  # columns of a token
AT_MOVING = slice(AT_STATIC.stop, AT_STATIC.stop + len(MOVING))
TOKEN = AT_MOVING.stop + SEEN
OPTION = 2 * STATIC + SEEN + len(LEVELS) + 6
ABOUT = 9  # features of the line
# Units that scale most features to about 1.
GAP, LENGTH, SIZE, SPEED_MEAN = 0.1, 6.0, 0.35, 1.5  # [s], [m], [m], [m/s]
DEVIATION = np.array([0.1, 0.1, 0.5])  # [m, m, m/s]
MOST = 5.0  # features are clipped to -5 and 5
SPEED = COLUMN.forward_speed.place
AT_SPEED = SIGNATURE.index(SPEED)
ABSENT = 1e6  # cost of a missing option


class Candidates(NamedTuple):
    """Candidates of every parcel that waits at a gate and may enter in this control period."""

    env: Integers  # (decisions,) index of the environment
    queue: Integers  # (decisions, DEPTH) kinds of waiting parcels, next first; NOBODY: none
    entry: Numbers  # (decisions, options, levels) [s] time of entry
    binding: Integers  # (decisions, options) booked parcel to wait for, or NOBODY
    cost: Numbers  # (decisions, options) [s] delay of later parcels relative to the best option


class ParcelHistory(NamedTuple):
    """Memory of parcels on the line, and of the last departed parcels."""

    held: Integers  # (num_envs, parcels) maneuver of the parcel in each row
    seen: Numbers  # (num_envs, parcels, SEEN) deviation from the maneuver
    gone: Integers  # (num_envs, GONE) maneuvers of the last departed parcels
    left: Numbers  # (num_envs, GONE) [s] time of departure
    last: Numbers  # (num_envs, GONE, SEEN) last deviation


class Features:
    """Computes the features of candidates and parcels that a network reads.

    `delay` (maneuvers,) [s] is `Library.delay` of a library whose gaps have the usual clearance.
    """

    def __init__(self, config: EnvConfig, library: Library, delay: Numbers) -> None:
        lead, own, run = library.lead, library.maneuvers, library.runs[0][0]
        self._library = library
        self._parcels = config.stream_task.max_parcels
        exits = [config.exits.exits[config.exits.place(name)] for _, _, name in lead.kinds]
        self._kind_side = np.array([each.side for each in exits])
        self._side = self._kind_side[own.kind]
        across = (run.pose[..., 1] - config.chosen_line.line_y) * self._side[:, np.newaxis]
        speed = np.gradient(run.pose[..., 0], DT, axis=1)
        self._path = np.stack([find_rears(run), across, speed], axis=2)  # (.., moments, SEEN)
        self._moments, self._origin = run.moments, lead.origin[own.kind]
        straight = ~np.isfinite(own.place)
        place = np.where(straight, 0.0, own.place) + self._origin
        last = np.array([min(each.last, config.rotors_end) for each in exits])[own.kind]
        angles = np.abs((np.array(config.chosen_orientations) + np.pi / 2) % np.pi - np.pi / 2)
        size = np.array([np.ptp(parcel.base.outline, axis=0) for parcel, _, _ in lead.kinds])
        entering = np.array([speed for _, speed, _ in lead.kinds])
        end = speed[np.arange(len(own.kind)), np.maximum(0, run.moments - 2)]
        static = [
            np.where(straight, 0.0, place / LENGTH),
            straight,
            angles[own.choice] / (0.5 * np.pi),
            encode(COLUMN.time, DT * run.moments),
            *(size[own.kind] / SIZE - 1.0).T,
            entering[own.kind] - SPEED_MEAN,
            delay / GAP,
            end - SPEED_MEAN,
            np.where(straight, 0.0, (last - place) / 2.0),
        ]
        self._static = np.stack(static, axis=1).clip(-3.0, 3.0).astype(np.float32)
        self._of_kind = self._static[library.options[:, 0]]
        self._of_kind[:, CHOSEN] = 0.0
        drawn, actuators = config.randomisation, config.actuators
        about = [
            0.5 * math.pi / actuators.axis_speed / 0.1,
            config.control_period / 0.04 - 1.0,
            len(angles) / 4.0 - 1.0,
            float(isinstance(config.sensors, Exact)),
            drawn.friction / 0.2,
            drawn.com_offset / 0.2,
            actuators.stuck_share / 0.02,
            HOUR / entrance_bound(config) / 0.3 - 1.0,
            (config.rotors_end - lead.zone_x) / LENGTH,
        ]
        self.about = np.array(about, dtype=np.float32)

    def start(self, num_envs: int) -> ParcelHistory:
        """Return the memory at the start of an episode."""
        rows, gone = (num_envs, self._parcels), (num_envs, GONE)
        return ParcelHistory(
            np.full(rows, NOBODY), np.zeros((*rows, SEEN)),
            np.full(gone, NOBODY), np.zeros(gone), np.zeros((*gone, SEEN)),
        )  # fmt: skip

    def watch(self, tables: Singles, book: Book, before: ParcelHistory) -> ParcelHistory:
        """Update the history `before` by one control period, and return the new history.

        The observations `tables` show how far parcels deviate from their planned trajectories, and
        `book` shows which parcels have departed.
        """
        seen, gone = before.seen.copy(), before.gone.copy()
        left, last = before.left.copy(), before.last.copy()
        was_here = (before.held != NOBODY) & (book.rows != before.held)
        for env, place in np.argwhere(was_here).tolist():
            gone[env], left[env] = np.roll(gone[env], 1), np.roll(left[env], 1)
            last[env] = np.roll(last[env], 1, axis=0)
            gone[env, 0], left[env, 0] = before.held[env, place], book.clock[env]
            last[env, 0] = seen[env, place]
        i, row = np.nonzero(book.rows != NOBODY)
        own, rows = book.rows[i, row], tables[i, row].astype(np.float64)
        time, past, aside, speed = (column.of(rows) for column in MOVING)
        moment = np.rint(time / DT).astype(np.int64)
        now = np.stack([past + self._origin[own], aside, speed], axis=1)
        known = moment < self._moments[own]
        path = self._path[own, moment.clip(0, self._moments[own] - 1)]
        deviation = ((now - path) / DEVIATION).clip(-3.0, 3.0)
        seen[i, row] = np.where(known[:, np.newaxis], deviation, seen[i, row])
        seen[book.rows == NOBODY] = 0.0
        return ParcelHistory(book.rows, seen, gone, left, last)

    def options(
        self, tables: Singles, book: Book, watched: ParcelHistory, given: Candidates
    ) -> Singles:
        """Return features (decisions, options, OPTION) of all options.

        If a parcel with an option must wait for a booked parcel, the option's features also
        describe the booked parcel. `tables` are (num_envs, rows, features), `watched` is the memory
        from `watch`, and `given` are the candidates of all decisions.
        """
        env, each = given.env, given.env[:, np.newaxis]
        head = given.queue[:, 0]
        options = self._library.options[head]
        usual = given.entry[..., USUAL]
        tightest = np.where(options >= 0, given.entry[..., 0], np.inf).min(axis=1)
        # The booked parcel, and its deviation if it is on the line.
        behind = given.binding.clip(0)
        ahead, entered = book.booked[each, behind], book.entered[each, behind]
        since = book.clock[each] - COLUMN.time.of(tables[env, : self._parcels])
        same = np.abs(since[:, np.newaxis] - entered[..., np.newaxis]) < 0.1
        same &= book.rows[env][:, np.newaxis] == ahead[..., np.newaxis]
        deviation = watched.seen[each, same.argmax(axis=2)] * same.any(axis=2)[..., np.newaxis]
        faster = tables[env, self._parcels, SPEED] - self._library.signature[head, AT_SPEED]
        binds = given.binding != NOBODY
        of_ahead = [
            binds[..., np.newaxis],
            self._static[ahead],
            (self._side[ahead] * self._kind_side[head][:, np.newaxis])[..., np.newaxis],
            (usual - entered)[..., np.newaxis],
            deviation,
        ]
        parts = [
            self._static[options.clip(0)],
            (given.entry[..., 1:] - given.entry[..., :1]) / GAP,
            (given.entry[..., :1] - tightest[:, np.newaxis, np.newaxis]) / GAP,
            given.cost[..., np.newaxis] / GAP,
            (usual - book.clock[each])[..., np.newaxis] / GAP,
            *(binds[..., np.newaxis] * part for part in of_ahead),
            np.broadcast_to((faster / SPEED_STEP)[:, np.newaxis, np.newaxis], (*usual.shape, 1)),
        ]
        found: Singles = np.concatenate(parts, axis=2).clip(-MOST, MOST).astype(np.float32)
        return found

    def tokens(
        self, tables: Singles, book: Book, watched: ParcelHistory, given: Candidates
    ) -> tuple[Singles, Booleans]:
        """Return features (decisions, TOKENS, TOKEN) of parcels, and a mask (decisions, TOKENS).

        A token holds the features of one parcel that waits, is on the line, or was among the last
        to depart. The mask is true where a token has a parcel. Arguments are as in `options`.
        """
        env, side = given.env, self._kind_side[given.queue[:, 0]][:, np.newaxis]
        gone, rows = watched.gone[env], book.rows[env]
        kinds = np.concatenate([given.queue, rows, gone], axis=1)
        shown = kinds != NOBODY
        token = np.zeros((*kinds.shape, TOKEN), dtype=np.float32)
        waiting, line = slice(DEPTH), slice(DEPTH, DEPTH + self._parcels)
        left = slice(DEPTH + self._parcels, None)
        for column, part in enumerate((line, left, waiting)):
            token[:, part, column] = 1.0
        sides = self._kind_side[given.queue], self._side[rows], self._side[gone]
        static = self._of_kind[given.queue], self._static[rows], self._static[gone]
        token[..., AT_SIDE] = np.concatenate(sides, axis=1) * side
        token[..., AT_STATIC] = np.concatenate(static, axis=1)
        moving = tables[env, : self._parcels][..., [column.place for column in MOVING]]
        unit = np.array([1.0, 0.1, 1.0, 1.0], dtype=np.float32)
        token[:, line, AT_MOVING] = moving * unit
        since = book.clock[env][:, np.newaxis] - watched.left[env]
        token[:, left, AT_MOVING.start] = encode(COLUMN.time, since)
        token[:, line, -SEEN:], token[:, left, -SEEN:] = watched.seen[env], watched.last[env]
        # Only the first departed parcels are left out.
        order = np.argsort(~shown, axis=1, kind="stable")[:, :TOKENS]
        shown = np.take_along_axis(shown, order, axis=1)
        token = np.take_along_axis(token, order[..., np.newaxis], axis=1)
        token[~shown] = 0.0
        return token.clip(-MOST, MOST), shown


class Decisions(NamedTuple):
    """Decisions that the scheduler must make now, and the features of these decisions."""

    env: Integers  # (decisions,) index of the environment
    cost: Singles  # (decisions, options, levels) [parcels] deliveries lost by waiting
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
        tight: (maneuvers, maneuvers) [s] gaps at level 0.
        wide: (maneuvers, maneuvers) [s] gaps at level 1.
        levels: (levels,) [-] levels of clearance; gaps are a linear function of the level.
        options: (options,) maneuvers of the parcel. A negative number means no maneuver.
        booked: (BOOKED,) maneuvers of parcels that entered at `entered` (BOOKED,) [s].
        now: [s] lower bound of the entry time.
        entry: (options, levels) output: earliest entry time [s].
        binding: (options, levels) output: index of the booked parcel to wait for, or -1 if the
            parcel need not wait.
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
    """Write the least cost [s] for each option of the first parcel.

    The cost is the time of entry of the last waiting parcel, plus the delay of this parcel's
    maneuver. For all other arguments see the function `find_next`.

    Args:
        options: (kinds + 1, most) options of a library. The last row is scratch memory. All entries
            of this row except the first are -1.
        queue: (parcels,) kinds of the waiting parcels; the first entry is overwritten.
        cost: (most,) [s] output. Entries without an option are infinite.
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
    """Scheduler that chooses a candidate once for each parcel at the gate.

    Args:
        config: configuration of the environment, with a gate and actions "parcels".
        library: library of maneuvers. The default is the library of `make_model_library`.
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
        """Return the indices (decisions,) of the chosen options, and of the clearance levels."""

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
        """Decide for waiting parcels without a decision. Return `chosen` plus the new decisions."""
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
        """Book the parcels that enter in this period.

        Returns the physics steps (num_envs,) at which gates open, and the decisions for parcels
        that do not enter yet.
        """
        opens = np.full(len(tables), SHUT)
        late = (chosen.entry - book.clock) / self._orders.dt - 1e-6
        step = np.ceil(late).astype(np.int64).clip(1)
        now = (chosen.maneuver != NOBODY) & (step <= self._orders.steps)
        opens[now] = step[now]
        enter(tables, self._orders, book, chosen.maneuver, opens)
        return opens, chosen._replace(maneuver=np.where(now, NOBODY, chosen.maneuver))

    def _candidates(self, tables: Singles, book: Book, undecided: Integers) -> Candidates | None:
        """Return the candidates of parcels that may enter now, or None if no parcel may enter.

        `undecided` are indices of the environments to look at. A parcel may enter now if the
        smallest clearance allows an entry within this period.
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
    """Make the library of maneuvers; ignore randomisation, sensor errors and stuck modules."""
    actuators = replace(config.actuators, stuck_share=0.0)
    model = config.replace(sensors=Exact(), randomisation=Randomisation(), actuators=actuators)
    return make_library(model, margin=0.0, slack=0.0)
