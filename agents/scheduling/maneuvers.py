"""Maneuvers that lead a parcel to its exit, and minimum gaps between maneuvers. A maneuver is a
position on the line and an angle. The parcel rolls until its rear passes the position; then the
axes under the parcel turn to the angle. Parcels wait at a gate. A gap is the time between the
entries of two parcels. A kind is a combination of parcel, speed and exit. Obeying columns are
columns that the controller sets.

A parcel that turns off loses speed along the line. The next parcel never meets it if the next one
turns off farther upstream. So throughput increases with the number of positions, and with gentler
angles. If one actuator turns a group of columns, two parcels that need the group at different
angles must not be over the group at the same time.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from surface_gym import checks
from surface_gym.compiler.jit import compiled
from surface_gym.config import EnvConfig
from surface_gym.flow.task import COLUMN
from surface_gym.modules import surface_velocities
from surface_gym.sensors import Exact

from ..base import Booleans, Integers, Numbers, Singles, axes_apart, find_axes, find_conveyor
from .leading import Way, lead
from .trajectories import (
    DT,
    Asked,
    LoneRuns,
    TimedRuns,
    find_gaps,
    list_asked,
    list_speeds,
    run_alone,
)

MARGIN = 0.02  # [m] minimum clearance between two parcels
PLACES = 9  # number of positions to turn off, evenly along an exit
UPSTREAM = 2.0  # [m] maximum distance before an exit at which a parcel turns off
SLOW, FAST, EARLY, LATE = range(4)
RESERVE = 0.05  # [-] tolerance of a parcel's speed for a correct maneuver
TRIES = 4  # tries per maneuver with sensor errors or randomisation; otherwise one
BEFORE = 0.5  # [m] distance before a parcel at which a zone is turned in advance
NO_GROUP = -1
ROUNDS = 50  # rounds of value iteration


@dataclass(frozen=True)
class ColumnGroups:
    """Consecutive groups of obeying columns; one actuator turns each group."""

    columns: int = 1  # columns per group
    count: int | None = None  # number of groups from the first obeying column; None: as many as fit
    # whether a parcel may enter a group only after the one before has left it; otherwise, parcels
    # that need the same angle may follow each other
    exclusive: bool = False

    def __post_init__(self) -> None:
        checks.integer("columns", self.columns, least=1)
        if self.count is not None:
            checks.integer("count", self.count, least=1)
        checks.one_of("exclusive", self.exclusive, (False, True))

    def spans(self, obeying: int) -> Integers:
        """Return each group's first column, and the column after the group, shape (groups, 2).

        `obeying` is the number of columns to divide.
        """
        most = obeying // self.columns
        if most == 0 or (self.count or 0) > most:
            raise ValueError(
                f"columns must fit on the {obeying} that obey, got {self.count or 1} groups of "
                f"{self.columns}"
            )
        first = self.columns * np.arange(self.count or most)
        return np.stack([first, first + self.columns], axis=1)


class Maneuvers(NamedTuple):
    """Maneuvers in arrays, with an entry for each maneuver."""

    kind: Integers  # (maneuvers,) index of parcel, speed and exit
    # (maneuvers,) [m] position of the rear past the exit's start; infinite: straight ahead
    place: Numbers
    choice: Integers  # (maneuvers,) orientation after the position
    groups: Integers  # (maneuvers, 2) first and last turned group; NO_GROUP: none

    def pick(self, chosen: Integers | Booleans) -> "Maneuvers":
        """Return the chosen maneuvers; `chosen` is an array of indices, or a mask (maneuvers,)."""
        return Maneuvers._make(values[chosen] for values in self)


class Lead:
    """Control of all obeying modules, so that parcels follow their maneuvers.

    With `groups`, the actions of `config` must be "modules". Without `groups`, the actions must be
    "parcels".
    """

    def __init__(self, config: EnvConfig, groups: ColumnGroups | None = None) -> None:
        checks.one_of("actions", config.actions, ("parcels",) if groups is None else ("modules",))
        if config.action_kind.continuous:
            raise ValueError(f"orientations must be some on offer, got {config.orientations!r}")
        self.roll = find_conveyor(config)
        if not config.module_kind.drives:
            find_axes(config)  # raises an error unless axes lead to both sides
        self.groups = groups
        self.kinds = list_asked(config)
        line = config.chosen_line
        _, self._rows, first, self._columns = config.site.zone
        self.zone_x = line.column_edge(first)
        self._pitch = line.pitch_x
        exits = config.exits
        starts = [self.zone_x if each.side == 0 else max(self.zone_x, each.first) for each in exits]
        # [m] x of the origin of a row's rear position
        self.origin = np.array([starts[exits.place(name)] for _, _, name in self.kinds])
        # [s] time between turning a group and its use: a quarter turn of an axis, and the ramp of a
        # driven module from the conveyor's velocity to another one
        velocity = surface_velocities(config.modes)
        ramp = float(np.hypot(*(velocity - velocity[-1]).T).max()) / config.module_kind.acceleration
        turn = 0.5 * math.pi / config.actuators.axis_speed
        self.ahead = config.control_period + (turn + ramp)
        self._config = config
        if groups is not None:
            # The supports after the last rotors have no actuators.
            rotors = np.nonzero(config.site.rotor)[1]
            self.spans = groups.spans(len(np.unique(rotors[rotors >= first])))
            # [m] x of the centres of each group's first and last columns
            self.first_x = line.column_edge(first + 0.5) + self._pitch * self.spans[:, 0]
            self.last_x = line.column_edge(first - 0.5) + self._pitch * self.spans[:, 1]

    def choose(
        self, tables: Singles, maneuvers: Maneuvers, booked: Integers, before: Integers | None
    ) -> tuple[Integers, Integers]:
        """Return actions (num_envs, size), and the groups' new orientations (num_envs, groups).

        The actions have no entry for the gate. `tables` are (num_envs, rows, features). `booked`
        (num_envs, parcels) are the indices of the parcels' maneuvers; a negative index means no
        maneuver. `before` (num_envs, groups) are the groups' previous orientations; None means
        90 deg.
        """
        num_envs, parcels = booked.shape
        way = self.describe(maneuvers)
        shape = (num_envs, len(way.spans))
        stands = np.full(shape, self.roll) if before is None else before.copy()
        size = 2 * parcels if self.groups is None else self._rows * self._columns
        actions = np.empty((num_envs, size), dtype=np.int64)
        lead(np.ascontiguousarray(tables), way, booked, stands, actions)
        return actions, stands

    def describe(self, maneuvers: Maneuvers) -> Way:
        """Return the parameters with which compiled functions lead parcels by these maneuvers."""
        none: Any = np.zeros(0)
        first, last, spans = none, none, np.zeros((0, 2), dtype=np.int64)
        if self.groups is not None:
            first, last, spans = self.first_x, self.last_x, self.spans
        return Way(
            roll=self.roll, kind=np.ascontiguousarray(maneuvers.kind),
            place=np.ascontiguousarray(maneuvers.place),
            choice=np.ascontiguousarray(maneuvers.choice),
            turned=np.ascontiguousarray(maneuvers.groups), origin=self.origin, first=first,
            last=last, spans=spans, ahead=self.ahead, rows=self._rows, columns=self._columns,
        )  # fmt: skip

    def candidates(self, config: EnvConfig, place_count: int) -> Maneuvers:
        """List the maneuvers to try for each kind; for `place_count` see `make_library`."""
        found: list[tuple[int, float, int, int, int]] = []
        for kind, (parcel, _, name) in enumerate(self.kinds):
            leaves = config.exits.exits[config.exits.place(name)]
            length = float(np.ptp(parcel.base.outline[:, 0]))
            if leaves.side == 0:
                found.append((kind, np.inf, self.roll, NO_GROUP, NO_GROUP))
                continue
            low = max(self.zone_x - length, leaves.first - UPSTREAM)
            high = min(leaves.last, config.rotors_end) - length
            every = self._turning_places(low, max(low, high), length, place_count)
            found += [
                (kind, x - self.origin[kind], choice, *turned)
                for choice in self._choices_towards(leaves.side)
                for x, turned in every
            ]
        table = np.array(found)
        whole = table[:, [0, 2, 3, 4]].astype(np.int64)
        return Maneuvers(whole[:, 0], table[:, 1], whole[:, 1], whole[:, 2:])

    def _turning_places(
        self, low: float, high: float, length: float, place_count: int
    ) -> list[tuple[float, tuple[int, int]]]:
        """List positions where a parcel can turn off, and the first and last group that turn there.

        A position is x [m] of the parcel's rear. If single modules or single columns turn, there
        are `place_count` positions from `low` to `high` [m]. If groups of several columns turn,
        each group has two positions. In one, the parcel's rear is at the start of the group. In the
        other, the front of the parcel of `length` [m] is `BEFORE` [m] before the group's start.
        """
        if self.groups is None or self.groups.columns == 1:
            last = NO_GROUP if self.groups is None else len(self.spans) - 1
            return [(x, (min(0, last), last)) for x in np.linspace(low, high, place_count).tolist()]
        # A zone is turned when the parcel is wholly in it, or in advance.
        edge = self.first_x - 0.5 * self._pitch
        # The parcel leaves by this group, or continues over the groups after it.
        count = len(edge)
        return [
            (x, (group, last))
            for group, start in enumerate(edge.tolist())
            for x in (start, start - length - BEFORE)
            for last in sorted({group, min(group + 1, count - 1), count - 1})
        ]

    def _choices_towards(self, side: int) -> list[int]:
        """List the choices that lead to a side: +1 for y > 0, -1 for y < 0.

        An orientation of idle rotors is listed only if its mirror image is available, too. A choice
        of driven modules is listed only if it has the highest speed.
        """
        config = self._config
        if config.module_kind.drives:
            aside = side * surface_velocities(config.modes[:-1])
            speed = np.hypot(*aside.T)
            return np.flatnonzero((aside[:, 1] > 1e-6) & (speed > speed.max() - 1e-6)).tolist()
        angles = np.array(config.chosen_orientations)
        angles = (angles + 0.5 * np.pi) % np.pi - 0.5 * np.pi
        leads = (-side * angles > 1e-6) & (np.abs(angles) < 0.5 * np.pi - 1e-6)
        apart: Numbers = axes_apart(-angles[:, np.newaxis], angles).min(axis=1)
        return [int(k) for k in np.nonzero(leads & (apart < 1e-6))[0]]


@dataclass(frozen=True, eq=False)
class Library:
    """Maneuvers that lead parcels to their own exits, and the gaps between these parcels."""

    lead: Lead
    maneuvers: Maneuvers
    signature: Numbers  # (kinds, features) features that identify parcel, speed and exit
    correct: Booleans  # (kinds,) whether some maneuver was correct in every try
    runs: tuple[tuple[LoneRuns, ...], ...]  # runs of the maneuvers, by surface and variant of entry
    # (maneuvers, maneuvers) [s] gap between entries of a parcel (row) and its follower (column)
    gaps: Numbers
    margin: float  # [m] and [-] clearance of these gaps, see `make_library`
    slack: float

    @cached_property
    def options(self) -> Integers:
        """(kinds, maximum number) indices of each kind's maneuvers, padded with -1."""
        each = [np.nonzero(self.maneuvers.kind == kind)[0] for kind in range(len(self.signature))]
        found = np.full((len(each), max(map(len, each))), -1)
        for kind, own in enumerate(each):
            found[kind, : len(own)] = own
        return found

    @cached_property
    def delay(self) -> Numbers:
        """(maneuvers,) [s] expected delay of later parcels by each maneuver. The least delay is 0.

        All kinds are equally likely. The delay is the bias of an average-cost Markov decision
        process, computed by relative value iteration. In this process, a parcel's entry depends
        only on the maneuver of the parcel ahead.
        """
        return find_delay(self.gaps, self.options)

    def with_clearance(self, margin: float, slack: float) -> "Library":
        """Return the maneuvers with new gaps between them. For the arguments see `make_library`."""
        gaps = np.zeros((len(self.maneuvers.kind), len(self.maneuvers.kind)))
        for same in self.runs:  # on the same surface, for all variants of both entries
            _raise_gaps(self.lead, self.maneuvers, same, margin, slack, gaps)
        return replace(self, gaps=gaps, margin=margin, slack=slack)

    def with_one_speed(self, margin: float, slack: float) -> "Library":
        """Return the same maneuvers with gaps for the clearance `margin` [m] and `slack` [-].

        The gaps assume that each parcel has the smallest speed of its kind, and enters at the
        beginning of a control period. `make_library` explains `margin` and `slack`.
        """
        usual = replace(self, runs=tuple(same[:1] for same in self.runs))
        return usual.with_clearance(margin, slack)


def find_delay(gaps: Numbers, options: Integers) -> Numbers:
    """Compute how long [s] each maneuver (maneuvers,) delays later parcels; see `Library.delay`."""
    bias = np.zeros(len(gaps))
    for _ in range(ROUNDS):
        behind = [(gaps + bias)[:, own[own >= 0]].min(axis=1) for own in options]
        found = np.mean(behind, axis=0)
        bias = found - found.min()
    return bias


def make_library(
    config: EnvConfig,
    groups: ColumnGroups | None = None,
    place_count: int = PLACES,
    margin: float = MARGIN,
    slack: float = 1.0,
) -> Library:
    """Test maneuvers on parcels that are alone on the line, and keep the correct maneuvers.

    A maneuver is correct if parcels leave by their own exit in all tests. A kind without a correct
    maneuver keeps the maneuvers that pass the largest number of tests. Tests have sensor errors and
    randomisation.

    Args:
        config: configuration of the environment, with a gate.
        groups: columns that turn together. If None, every module turns by itself.
        place_count: number of positions per parcel and exit at which the parcel may turn off.
            With groups of several columns, the groups determine the positions.
        margin: [m] minimum clearance between two parcels.
        slack: [-] minimum time without a parcel on a module before the module turns to the next
            orientation. The time is `slack` times the sum of a control period and the time that a
            module needs to turn or to change its speed.
    """
    if not config.stream_task.gate:
        raise ValueError("gate must be True for a schedule, got False")
    checks.integer("place_count", place_count, least=1)
    checks.not_negative("margin", margin)
    checks.not_negative("slack", slack)
    lead = Lead(config, groups)
    tried = lead.candidates(config, place_count)
    varies = config.randomisation.varies or config.actuators.stuck_share > 0.0
    exact = not varies and isinstance(config.sensors, Exact)
    tries = 1 if exact else TRIES
    runs = [
        [_try(config, lead, tried, seed, variant) for variant in (SLOW, FAST)]
        for seed in range(tries)
    ]
    beyond = [_try(config, lead, tried, 0, variant) for variant in (EARLY, LATE)]
    share = np.mean([run.correct for same in (*runs, beyond) for run in same], axis=0)
    count = len(lead.kinds)
    best = np.zeros(count)
    np.maximum.at(best, tried.kind, share)
    # If no maneuver is always correct, take the maneuver that is correct most often.
    kept = share >= best[tried.kind]
    own = tuple(tuple(run.pick(kept) for run in same) for same in runs)
    signature = np.empty((count, runs[0][0].signature.shape[1]))
    signature[tried.kind] = np.mean([run.signature for run in runs[0]], axis=0)
    maneuvers = tried.pick(kept)
    found = Library(
        lead, maneuvers, signature, best == 1.0, own, np.empty(0), margin=margin, slack=slack
    )
    return found.with_clearance(margin, slack)


def _try(config: EnvConfig, lead: Lead, tried: Maneuvers, seed: int, variant: int) -> LoneRuns:
    """Run each maneuver in `tried` with one parcel alone on a surface; `seed` draws this surface.

    With the `variant` SLOW, parcels enter at the smallest speed of their kind. With FAST, parcels
    enter at the largest speed of their kind, and half a control period later than with SLOW. EARLY
    is like SLOW, but parcels are slower by the share `RESERVE`, and axes turn a control period too
    early. LATE is like FAST, but parcels are faster by the share `RESERVE`, and axes turn a control
    period too late.
    """
    count = len(tried.kind)
    booked = np.arange(count)[:, np.newaxis]
    stands: Integers | None = None

    def act(tables: Singles) -> Integers:
        nonlocal stands
        here = np.where(COLUMN.present.of(tables[:, :1]) > 0.5, booked, -1)
        action, stands = lead.choose(tables, tried, here, stands)
        return action

    _, off = list_speeds(config)
    factor = 1.0 + (0.0, 0.0, -RESERVE, RESERVE)[variant]
    off = off if variant in (FAST, LATE) else -off
    kinds = [(parcel, factor * (speed + off), name) for parcel, speed, name in lead.kinds]
    asked: list[Asked] = [kinds[kind] for kind in tried.kind.tolist()]
    if variant in (EARLY, LATE):
        period = config.control_period if variant == LATE else -config.control_period
        speed = np.array([each for _, each, _ in asked])
        tried = tried._replace(place=tried.place + period * speed)
    opens = np.full(count, 1 + (variant % 2) * config.timing.steps // 2)
    return run_alone(act, config, asked, opens, [seed] * count)


def _raise_gaps(
    lead: Lead, maneuvers: Maneuvers, runs: Sequence[LoneRuns], margin: float, slack: float,
    gaps: Numbers,
) -> None:  # fmt: skip
    """Raise gaps (maneuvers, maneuvers) [s] until parcels keep their distance from each other.

    If columns turn in groups, a gap also gives each group time to turn between two parcels. `runs`
    are runs of the maneuvers on one surface. For `margin` and `slack` see `make_library`.
    """
    followed = [_choices(lead, maneuvers, run) for run in runs]
    state = np.stack([np.full(len(gaps), lead.roll), maneuvers.choice], axis=1)
    needs = [_occupied(lead, maneuvers, run) for run in runs] if lead.groups is not None else []
    late = slack * lead.ahead
    for i, ahead in enumerate(followed):
        for j, behind in enumerate(followed):
            if lead.groups is not None:
                exclusive = lead.groups.exclusive
                _raise_for_groups(needs[i][1], needs[j][0], state, late, exclusive, gaps)
            find_gaps(ahead, behind, margin, 0.0 if needs else late, gaps)


def find_rears(run: LoneRuns) -> Numbers:
    """Return the x [m] of the parcels' rearmost corners, shape (maneuvers, moments)."""
    outline, theta = run.outline[:, np.newaxis], run.pose[..., np.newaxis, 2]
    along = np.cos(theta) * outline[..., 0] - np.sin(theta) * outline[..., 1]
    found: Numbers = run.pose[..., 0] + along.min(axis=2)
    return found


def _choices(lead: Lead, maneuvers: Maneuvers, run: LoneRuns) -> TimedRuns:
    """Return the runs `run` with the choice for the modules under the parcel at each moment."""
    outline, pose = run.outline, run.pose
    turns = find_rears(run) > (maneuvers.place + lead.origin[maneuvers.kind])[:, np.newaxis]
    choice = np.where(turns, maneuvers.choice[:, np.newaxis], lead.roll)
    reach = np.hypot(outline[..., 0], outline[..., 1]).max(axis=1)
    return TimedRuns(pose, run.moments, outline, reach, choice)


def _occupied(lead: Lead, maneuvers: Maneuvers, run: LoneRuns) -> tuple[Numbers, Numbers]:
    """Compute when each maneuver begins and ceases to need each group of modules.

    The two results are arrays (maneuvers, groups, 2) [s]. The last index is 0 for the need of axes
    at 90 deg, and 1 for the need of axes at the maneuver's angle. If a group is not needed, the
    need begins at infinity and ends at minus infinity.
    """
    pose, moments, outline = run.pose, run.moments, run.outline
    shape = len(moments), len(lead.first_x), 2
    begins, ends = np.full(shape, np.inf), np.full(shape, -np.inf)
    for i, count in enumerate(moments):
        x, _, theta = pose[i, :count].T
        turned = np.outer(np.cos(theta), outline[i, :, 0])
        turned -= np.outer(np.sin(theta), outline[i, :, 1])
        rear, front = x + turned.min(axis=1), x + turned.max(axis=1)
        over = (front[:, np.newaxis] >= lead.first_x) & (rear[:, np.newaxis] <= lead.last_x)
        turns = rear > maneuvers.place[i] + lead.origin[maneuvers.kind[i]]
        first, last = maneuvers.groups[i]
        own = np.zeros(shape[1], dtype=np.bool_)
        if first != NO_GROUP:
            own[first : last + 1] = True
        angled = turns[:, np.newaxis] & own
        for state, needs in enumerate((over & ~angled, over & angled)):
            some = needs.any(axis=0)
            begins[i, some, state] = DT * needs[:, some].argmax(axis=0)
            ends[i, some, state] = DT * (count - needs[::-1][:, some].argmax(axis=0))
    return begins, ends


@compiled
def _raise_for_groups(
    ends: Numbers, begins: Numbers, state: Integers, late: float, exclusive: bool, gaps: Numbers
) -> None:
    """Raise the gaps until every group of columns has time to turn between two parcels.

    If `exclusive` is false, two parcels that need the same orientation may share a group.

    Args:
        ends: (maneuvers, groups, 2) [s] times at which the parcel ahead ceases to need a group; see
            `_occupied`.
        begins: (maneuvers, groups, 2) [s] times at which the parcel behind begins to need a group.
        state: (maneuvers, 2) orientations that a parcel needs before and after turning off.
        late: [s] time that a group needs to turn.
    """
    for i in range(gaps.shape[0]):
        for j in range(gaps.shape[0]):
            for group in range(begins.shape[1]):
                for one in range(2):
                    for other in range(2):
                        if exclusive or state[i, one] != state[j, other]:
                            wait = ends[i, group, one] + late - begins[j, group, other]
                            gaps[i, j] = max(gaps[i, j], wait)
