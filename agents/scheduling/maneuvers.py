"""Maneuvers that lead a parcel to its exit, and how close one can follow another.

A maneuver is a place along the line and an angle: the parcel rolls until its rear is past the
place, and from there on the axes under it stand at the angle. A parcel that turns off loses speed
along the line; one behind it that turns off upstream never meets it. So a line carries the more,
the more places there are to choose from, and the gentler the angle.

Which columns have an actuator of their own limits the choice: two parcels that need the axes of one
group to stand otherwise must not be over it at once.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from surface_gym import checks
from surface_gym.compiler.jit import compiled
from surface_gym.config import EnvConfig
from surface_gym.flow.task import COLUMN
from surface_gym.sensors import Exact

from ..base import Axes, Booleans, Integers, Numbers, Singles, axes_apart, find_axes
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

MARGIN = 0.02  # [m] kept clear between two parcels
PLACES = 9  # to turn off, evenly along an exit
UPSTREAM = 2.0  # [m] before an exit begins, at most, that a parcel turns off towards it
SLOW, FAST, EARLY, LATE = range(4)
RESERVE = 0.05  # [-] by which a parcel's speed may differ, and a maneuver still leads it right
TRIES = 4  # of each maneuver, where sensors err or anything is drawn; else one
BEFORE = 0.5  # [m] by which a zone that is arranged beforehand is turned before a parcel is over it
NO_GROUP = -1
ROUNDS = 50  # of value iteration


@dataclass(frozen=True)
class ColumnGroups:
    """Columns that obey, in groups one after the other; one actuator turns each group."""

    columns: int = 1  # of a group
    count: int | None = None  # of groups, from the first column that obeys on; None: as many as fit
    # whether a parcel enters a group only once the one before has left it, wherever both go; else
    # those that need its axes at the same angle may follow each other over it
    exclusive: bool = False

    def __post_init__(self) -> None:
        checks.integer("columns", self.columns, least=1)
        if self.count is not None:
            checks.integer("count", self.count, least=1)
        checks.one_of("exclusive", self.exclusive, (False, True))

    def spans(self, obeying: int) -> Integers:
        """Compute (groups, 2) the first column of each group and the one after its last."""
        most = obeying // self.columns
        if most == 0 or (self.count or 0) > most:
            raise ValueError(
                f"columns must fit on the {obeying} that obey, got {self.count or 1} groups of "
                f"{self.columns}"
            )
        first = self.columns * np.arange(self.count or most)
        return np.stack([first, first + self.columns], axis=1)


class Maneuvers(NamedTuple):
    """Maneuvers, an array entry for each."""

    kind: Integers  # (maneuvers,) index of the parcel, speed and exit that it is for
    place: Numbers  # (maneuvers,) [m] of the rear past the exit's start; infinite: it goes straight
    choice: Integers  # (maneuvers,) orientation from there on
    groups: Integers  # (maneuvers, 2) first and last group that it turns; NO_GROUP: it turns none

    def pick(self, chosen: Integers | Booleans) -> "Maneuvers":
        """Return some of them."""
        return Maneuvers(
            self.kind[chosen], self.place[chosen], self.choice[chosen], self.groups[chosen]
        )


class Lead:
    """Leads parcels by their maneuvers: chooses what every module that obeys does.

    Args:
        config: of the environment; actions "parcels" without groups, "modules" with them.
    """

    def __init__(self, config: EnvConfig, groups: ColumnGroups | None = None) -> None:
        checks.one_of("actions", config.actions, ("parcels",) if groups is None else ("modules",))
        if config.action_kind.continuous:
            raise ValueError(f"orientations must be some on offer, got {config.orientations!r}")
        self.axes: Axes = find_axes(config)
        self.groups = groups
        self.kinds = list_asked(config)
        line = config.chosen_line
        _, self._rows, first, self._columns = config.site.zone
        self.zone_x = line.column_edge(first)
        self._pitch = line.pitch_x
        exits = config.exits
        starts = [self.zone_x if each.side == 0 else max(self.zone_x, each.first) for each in exits]
        # [m] x from which a row counts how far a parcel's rear is
        self.origin = np.array([starts[exits.place(name)] for _, _, name in self.kinds])
        turn = 0.5 * math.pi / config.actuators.axis_speed  # [s] of an axis by 90 deg
        self.ahead = config.control_period + turn  # [s] that a group is turned before it is used
        self._angles = np.array(config.chosen_orientations)
        if groups is not None:
            # Behind the last rotors lie supports, which have no actuators.
            rotors = np.nonzero(config.site.rotor)[1]
            self.spans = groups.spans(len(np.unique(rotors[rotors >= first])))
            # [m] x of the centres of each group's first and last columns
            self.first_x = line.column_edge(first + 0.5) + self._pitch * self.spans[:, 0]
            self.last_x = line.column_edge(first - 0.5) + self._pitch * self.spans[:, 1]

    def choose(
        self, tables: Singles, maneuvers: Maneuvers, booked: Integers, before: Integers | None
    ) -> tuple[Integers, Integers]:
        """Choose actions (num_envs, size) without the gate, and what groups stand at
        (num_envs, groups).

        Args:
            tables: (num_envs, rows, features).
            booked: (num_envs, parcels) index of each parcel's maneuver; negative: there is none.
            before: (num_envs, groups) what groups stood at; None: all at 90 deg.
        """
        num_envs, parcels = booked.shape
        way = self.describe(maneuvers)
        shape = (num_envs, len(way.spans))
        stands = np.full(shape, self.axes.roll) if before is None else before.copy()
        size = 2 * parcels if self.groups is None else self._rows * self._columns
        actions = np.empty((num_envs, size), dtype=np.int64)
        lead(np.ascontiguousarray(tables), way, booked, stands, actions)
        return actions, stands

    def describe(self, maneuvers: Maneuvers) -> Way:
        """Describe for compiled functions how parcels are led by maneuvers."""
        none = self.groups is None
        kind, place, choice, turned = map(np.ascontiguousarray, maneuvers)
        return Way(
            roll=self.axes.roll, kind=kind, place=place, choice=choice, turned=turned,
            origin=self.origin,
            first=np.zeros(0) if none else self.first_x, last=np.zeros(0) if none else self.last_x,
            spans=np.zeros((0, 2), dtype=np.int64) if none else self.spans, ahead=self.ahead,
            rows=self._rows, columns=self._columns,
        )  # fmt: skip

    def candidates(self, config: EnvConfig, place_count: int) -> Maneuvers:
        """List the maneuvers of every parcel, speed and exit."""
        found: list[tuple[int, float, int, int, int]] = []
        for kind, (parcel, _, name) in enumerate(self.kinds):
            leaves = config.exits.exits[config.exits.place(name)]
            length = float(np.ptp(parcel.base.outline[:, 0]))
            if leaves.side == 0:
                found.append((kind, np.inf, self.axes.roll, NO_GROUP, NO_GROUP))
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
        """List x [m] of the rear from which on a parcel is turned, and by which groups."""
        if self.groups is None or self.groups.columns == 1:
            last = NO_GROUP if self.groups is None else len(self.spans) - 1
            return [(x, (min(0, last), last)) for x in np.linspace(low, high, place_count).tolist()]
        # A zone is turned under the parcel, once it is wholly in, or arranged for it beforehand.
        edge = self.first_x - 0.5 * self._pitch
        # It leaves by that one, or goes on under those after it.
        count = len(edge)
        return [
            (x, (group, last))
            for group, start in enumerate(edge.tolist())
            for x in (start, start - length - BEFORE)
            for last in sorted({group, min(group + 1, count - 1), count - 1})
        ]

    def _choices_towards(self, side: int) -> list[int]:
        """List the orientations that lead to a side, whose mirror images are on offer, too."""
        angles = (self._angles + 0.5 * np.pi) % np.pi - 0.5 * np.pi
        leads = (-side * angles > 1e-6) & (np.abs(angles) < 0.5 * np.pi - 1e-6)
        apart: Numbers = axes_apart(-angles[:, np.newaxis], angles).min(axis=1)
        return [int(k) for k in np.nonzero(leads & (apart < 1e-6))[0]]


@dataclass(frozen=True, eq=False)
class Library:
    """Maneuvers that lead right, and the gaps between parcels that take them."""

    lead: Lead
    maneuvers: Maneuvers
    signature: Numbers  # (kinds, features) by which each parcel, speed and exit is known
    right: Booleans  # (kinds,) whether some maneuver led it right in every try
    runs: tuple[tuple[LoneRuns, ...], ...]  # of the maneuvers, by surface and how they enter
    gaps: Numbers  # (maneuvers, maneuvers) [s] between entries, of each (column) behind each (row)
    margin: float  # [m] and [-] the clearance of these gaps, as `make_library` has it
    slack: float

    @cached_property
    def options(self) -> Integers:
        """(kinds, most) index of each kind's maneuvers, filled up with -1."""
        each = [np.nonzero(self.maneuvers.kind == kind)[0] for kind in range(len(self.signature))]
        found = np.full((len(each), max(map(len, each))), -1)
        for kind, own in enumerate(each):
            found[kind, : len(own)] = own
        return found

    @cached_property
    def delay(self) -> Numbers:
        """(maneuvers,) [s] by which all that come later are expected to enter later behind each,
        over the mean, if the kinds that come are as likely as each other.

        It is the bias of an average-cost Markov decision process, by relative value iteration, in
        which a parcel's entry depends on the maneuver of the one ahead alone.
        """
        return find_delay(self.gaps, self.options)

    def with_clearance(self, margin: float, slack: float) -> "Library":
        """Return the same maneuvers at another clearance; see `make_library`."""
        gaps = np.zeros((len(self.maneuvers.kind), len(self.maneuvers.kind)))
        for same in self.runs:  # on the same surface, however each of two enters
            _raise_gaps(self.lead, self.maneuvers, same, margin, slack, gaps)
        return replace(self, gaps=gaps, margin=margin, slack=slack)

    def with_one_speed(self, margin: float, slack: float) -> "Library":
        """Return the same maneuvers at another clearance, with gaps as if every parcel had the
        least speed of its kind, and all entered at the same moment of a control period.
        """
        usual = replace(self, runs=tuple(same[:1] for same in self.runs))
        return usual.with_clearance(margin, slack)


def find_delay(gaps: Numbers, options: Integers) -> Numbers:
    """Find (maneuvers,) the bias of each [s]; see `Library.delay`."""
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
    """Try maneuvers on parcels that each have the line to themselves, and keep those that lead
    right, as sensors see it and with all that varies.

    Args:
        config: of the environment, with a gate.
        place_count: of places to turn off, for each parcel and exit.
        margin: [m] kept clear between two parcels.
        slack: [-] share of a control period, and of an axis's turn by 90 deg, for which no parcel
            is over a module that the one before it held otherwise.
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
    share = np.mean([run.right for same in (*runs, beyond) for run in same], axis=0)
    count = len(lead.kinds)
    best = np.zeros(count)
    np.maximum.at(best, tried.kind, share)
    # A parcel that nothing leads right for certain takes what leads it right most often.
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
    """Run every maneuver once, on the same surface.

    Args:
        variant: SLOW: the parcels are as slow as those of their kind may be; FAST: as fast, and
            enter in the other half of a control period. EARLY and LATE: slower and faster than
            that, and they turn off so much too early or too late.
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
    lead: Lead,
    maneuvers: Maneuvers,
    runs: Sequence[LoneRuns],
    margin: float,
    slack: float,
    gaps: Numbers,
) -> None:
    """Raise gaps to what runs ask for: parcels stay clear, and find their groups free."""
    followed = [_choices(lead, maneuvers, run) for run in runs]
    state = np.stack([np.full(len(gaps), lead.axes.roll), maneuvers.choice], axis=1)
    needs = [_occupied(lead, maneuvers, run) for run in runs] if lead.groups is not None else []
    late = slack * lead.ahead
    for i, ahead in enumerate(followed):
        for j, behind in enumerate(followed):
            if lead.groups is not None:
                exclusive = lead.groups.exclusive
                _raise_for_groups(needs[i][1], needs[j][0], state, late, exclusive, gaps)
            find_gaps(ahead, behind, margin, 0.0 if needs else late, gaps)


def find_rears(run: LoneRuns) -> Numbers:
    """Find (maneuvers, moments) x [m] of the last corner of each parcel."""
    outline, theta = run.outline[:, np.newaxis], run.pose[..., np.newaxis, 2]
    along = np.cos(theta) * outline[..., 0] - np.sin(theta) * outline[..., 1]
    found: Numbers = run.pose[..., 0] + along.min(axis=2)
    return found


def _choices(lead: Lead, maneuvers: Maneuvers, run: LoneRuns) -> TimedRuns:
    """Add to runs what the modules under each parcel stand at."""
    outline, pose = run.outline, run.pose
    turns = find_rears(run) > (maneuvers.place + lead.origin[maneuvers.kind])[:, np.newaxis]
    choice = np.where(turns, maneuvers.choice[:, np.newaxis], lead.axes.roll)
    reach = np.hypot(outline[..., 0], outline[..., 1]).max(axis=1)
    return TimedRuns(pose, run.moments, outline, reach, choice)


def _occupied(lead: Lead, maneuvers: Maneuvers, run: LoneRuns) -> tuple[Numbers, Numbers]:
    """Compute (maneuvers, groups, 2) [s] from when until when each needs each group at 90 deg, and
    at its own angle; infinite and negative where it does not.
    """
    pose, moments, outline = run.pose, run.moments, run.outline
    shape = len(moments), len(lead.first_x), 2
    begins, ends = np.full(shape, np.inf), np.full(shape, -np.inf)
    for i, count in enumerate(moments):
        x, _, theta = pose[i, :count].T
        turned = np.outer(np.cos(theta), outline[i, :, 0]) - np.outer(
            np.sin(theta), outline[i, :, 1]
        )
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
    """Raise gaps so that no parcel needs a group before the one ahead of it has left it, and it has
    been turned; where both need it at the same angle, they may follow.
    """
    for i in range(gaps.shape[0]):
        for j in range(gaps.shape[0]):
            for group in range(begins.shape[1]):
                for one in range(2):
                    for other in range(2):
                        if exclusive or state[i, one] != state[j, other]:
                            wait = ends[i, group, one] + late - begins[j, group, other]
                            gaps[i, j] = max(gaps[i, j], wait)
