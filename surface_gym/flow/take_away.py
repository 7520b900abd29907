"""Common parts of tasks on a slope with a take-away conveyor at its end.

These parts are the line, the arriving bulk of parcels, correct departures, observation, reward and
statistics. An exit at the end of the slope is called a mouth.
"""

import math
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks, state as st
from surface_gym.compiler.jit import inlined
from surface_gym.flow import base as flow, state as fs
from surface_gym.flow.arrivals import HOUR, Poisson, Trace
from surface_gym.flow.base import FAR, SURFACE_TERMS, StreamTask, both_ways
from surface_gym.flow.exits import PITCH, RUN_OUT
from surface_gym.flow.stream import Stream
from surface_gym.lines import Pattern
from surface_gym.parcel import Parcel, Rectangle
from surface_gym.physics.types import (
    GRAVITY,
    HALF_LENGTH,
    OMEGA,
    RADIUS,
    THETA,
    VX,
    VY,
    Array,
    Booleans,
    Integers,
    X,
    Y,
)
from surface_gym.state import EnvState, reach_along
from surface_gym.tasks import base
from surface_gym.tasks.base import rising
from surface_gym.tasks.features import Feature, columns, show, show_within
from surface_gym.tasks.sort import HORIZON


def slope_line(length: float = 5.0, width: float = 1.4) -> Pattern:
    """Make a surface with `length` x `width` [m] of rotors, and with supports after the rotors.

    A parcel departs when its centre passes the end of the rotors. The supports carry the part of
    the parcel that is beyond the rotors.
    """
    columns = round(checks.positive("length", length, *checks.LENGTH) / PITCH)
    rows = round(checks.positive("width", width, *checks.LENGTH) / PITCH)
    rotor = np.zeros((rows, columns + RUN_OUT), dtype=bool)
    rotor[:, :columns] = True
    return Pattern(rotor=rotor)


QUARTER, EIGHTH = 0.5 * math.pi, 0.25 * math.pi  # [rad]
BULK_SEED = 28
# [rad] range of angles of parcels in a row
NEARLY_STRAIGHT = (-math.radians(5.0), math.radians(5.0))
LENGTHS, WIDTHS, MASSES = (0.2, 0.45), (0.2, 0.4), (1.0, 15.0)  # [m], [m], [kg]


def bulk_parcels(count: int = 32, seed: int = BULK_SEED) -> tuple[Parcel, ...]:
    """Draw boxes of mixed sizes.

    The length is uniform in 0.2 to 0.45 m, the width in 0.2 to 0.4 m, the mass in 1 to 15 kg.
    """
    checks.integer("count", count, least=1)
    rng = np.random.default_rng(checks.integer("seed", seed, least=0))
    return tuple(
        Parcel(Rectangle(rng.uniform(*LENGTHS), rng.uniform(*WIDTHS)), mass=rng.uniform(*MASSES))
        for _ in range(count)
    )


def bulk(rate: float = 9000.0) -> Stream:
    """Make a bulk of boxes of mixed sizes at a mean rate [parcels/h].

    The boxes arrive at random times, anywhere across the surface, at any angle, at 0.8 m/s.
    """
    turned = (-math.pi, math.pi)
    return Stream(Poisson(rate), bulk_parcels(), speeds=0.8, aside=(-1.0, 1.0), turned=turned)


@dataclass(frozen=True)
class Stops:
    """Random stops of the take-away conveyor. Running and standing times are uniform in a range."""

    run: tuple[float, float] = (10.0, 20.0)  # [s] least and greatest
    stop: tuple[float, float] = (2.0, 5.0)  # [s] least and greatest
    notice: float = 1.0  # [s] time of notice before each stop

    def __post_init__(self) -> None:
        checks.settle(self, run=(rising, *checks.PATIENCE), stop=(rising, *checks.PATIENCE))
        checks.settle(self, notice=(checks.not_negative, self.run[0]))


# Features of a row of the table: of the parcel and its neighbours. Tasks may add features.
EXTENT = Feature("extent", -10.0, 100.0, "half of the neighbour's extent along y", "m", 0.1, 0.2)
NEIGHBOUR_FEATURES = (flow.GAP, flow.SPEED, flow.ASIDE, EXTENT)
FEATURES: tuple[Feature, ...] = (
    Feature("to the end", -20.0, 1000.0, "distance from the centre to the rotors' end", "m"),
    Feature("offset", -20.0, 20.0, "y of the centre minus y of the line's middle", "m", 0.5),
    *base.DIRECTION, base.FORWARD_SPEED, base.LATERAL_SPEED, base.TURNING_SPEED, base.LENGTH,
    base.WIDTH,
    *(
        Feature(
            name, -10.0, 100.0,
            f"distance from the centre to the base's farthest point towards {way}", "m", 0.1, 0.2,
        )
        for name, way in (("front", "+x"), ("rear", "-x"), ("left", "+y"), ("right", "-y"))
    ),
    Feature(
        "to the mouth", -20.0, 20.0, "motion in y after which the base fits into a mouth", "m", 0.3,
    ),
    Feature("to turn", -1.0, 1.0, "turn that aligns the base with the line", "rad", EIGHTH),
    Feature("rolling", 0.0, 20.0, "time until departure if the parcel only rolls", "s", HORIZON),
    Feature(
        "clear", -20.0, 20.0,
        "distance from the rotors' end to the last departed parcel's rear, minus `gap`", "m", 0.5,
    ),
    Feature("takes away", 0.0, 1.0, "1 if the take-away runs; 0 if it stands or soon stops"),
    flow.TIME, flow.PRESENT, flow.WAITS, *both_ways(NEIGHBOUR_FEATURES),
)  # fmt: skip
COLUMN, NEIGHBOUR = columns(FEATURES), columns(NEIGHBOUR_FEATURES)
AHEAD, BEHIND = COLUMN.gap_ahead.place, COLUMN.gap_behind.place  # first columns of the neighbours

PARCEL_TERMS: tuple[str, ...] = ("correct", "wrong", "touch", "progress", "time")
CORRECT_REWARD = 1.0  # once, at a correct departure
WRONG_REWARD = -1.0  # once, at a wrong departure
TOUCH_REWARD = -0.02  # per parcel that begins to touch another
PROGRESS_REWARD = 0.05  # per metre towards the end
TIME_REWARD = -0.02  # per second and parcel on the surface

GRIP = 0.5  # [-] friction of the take-away's belt while a parcel slides on it
ROUND_OFF = 1e-6  # [m]
AT_LEAST = 1e-3  # [m/s] minimum speed of a departing parcel, for the position at departure

# Indices in a parcel's goal, after the common ones of streams.
LOW, HIGH, LAST_REAR, RUNS, SLOPE_END, ASKED_GAP, NEXT = range(fs.GOALS, fs.GOALS + 7)
# Indices in the task's numbers.
BELT_SPEED, LEAST_GAP, MOST_TURNED, NOTICE = range(4)
# Indices in the memory of a surface: [m] motion of the belt, number of its stops and starts, and
# from DEMAND on the times [s] of its stops and starts in turn.
BELT, CHANGES, DEMAND = range(3)
# Indices in the memory of an exit: whether any parcel has taken it, and [m] the last parcel's rear
# on the belt.
ANY, REAR_END = range(2)
# Indices in the results of a parcel: [m] gap to the previous parcel on the belt, [rad] its angle.
GAP_BEFORE, MISALIGNMENT = range(2)
BEFORE = fs.OWN_MEMORY  # index in its memory: [m] x at the last decision


@inlined
def _is_disc(state: EnvState) -> bool:
    """Return whether a base is a disc, whose corners are all at (0, 0)."""
    return state.corners[0, 0] == 0.0 and state.corners[0, 1] == 0.0


@inlined
def misalignment(state: EnvState, theta: float) -> float:
    """Return the smallest angle [rad] from the line's direction to a side of a base at `theta`.

    The result is between -45 and 45 deg. For a disc, the result is 0, since a disc has no sides.
    """
    if _is_disc(state):
        return 0.0
    return theta - QUARTER * math.floor(theta / QUARTER + 0.5)


@inlined
def _separates(one: EnvState, other: EnvState, normals: EnvState, gap: float) -> bool:
    """Return whether two bases are `gap` [m] or more apart along the normal of at least one edge.

    The edges are the edges of the base `normals`, which is `one` or `other`.
    """
    cosine, sine = math.cos(normals.truth[THETA]), math.sin(normals.truth[THETA])
    dx, dy = other.truth[X] - one.truth[X], other.truth[Y] - one.truth[Y]
    for k in range(normals.edges.shape[0]):
        nx = cosine * normals.edges[k, 0] - sine * normals.edges[k, 1]
        ny = sine * normals.edges[k, 0] + cosine * normals.edges[k, 1]
        if nx * dx + ny * dy < 0.0:
            nx, ny = -nx, -ny
        reach = reach_along(one, one.truth[THETA], nx, ny)
        reach += reach_along(other, other.truth[THETA], -nx, -ny)
        if nx * dx + ny * dy - reach >= gap:
            return True
    return False


@inlined
def is_clear_of(one: EnvState, other: EnvState, gap: float) -> bool:
    """Return whether a straight strip of width `gap` [m] fits between two bases.

    The function tries strips parallel to each edge of the two bases. It also tries the strip
    perpendicular to the line between the two centres.
    """
    dx, dy = other.truth[X] - one.truth[X], other.truth[Y] - one.truth[Y]
    apart = math.sqrt(dx * dx + dy * dy)
    if apart == 0.0:
        return False
    nx, ny = dx / apart, dy / apart
    reach = reach_along(one, one.truth[THETA], nx, ny)
    if apart - reach - reach_along(other, other.truth[THETA], -nx, -ny) >= gap:
        return True
    return _separates(one, other, one, gap) or _separates(one, other, other, gap)


@inlined
def runs(surface: fs.SurfaceView) -> bool:
    """Return whether the take-away runs, i.e. whether stops plus starts are an even number."""
    return surface.memory[CHANGES] % 2.0 == 0.0


@inlined
def changes_within(surface: fs.SurfaceView, time: float) -> bool:
    """Return whether the take-away stops or starts within the next `time` [s]."""
    change = DEMAND + int(surface.memory[CHANGES])
    return change < surface.memory.shape[0] and surface.memory[change] <= surface.clock + time


@inlined
def rolling_time(distance: float, speed: float, acceleration: float) -> float:
    """Return the time [s] to roll a distance [m] from a speed [m/s] at an acceleration [m/s^2]."""
    start = max(0.0, speed)
    if acceleration <= 1e-6:
        return distance / max(start, 1e-3)
    return (math.sqrt(start * start + 2.0 * acceleration * distance) - start) / acceleration


@inlined
def nearest_mouth(mouths: Array, first: int, y: float) -> int:
    """Return the index of the mouth (exit at the slope's end) that is nearest to `y` [m].

    A row of `mouths` describes a mouth. Columns `first` and `first + 1` are y [m] of the sides.
    """
    nearest, least = 0, math.inf
    for k in range(mouths.shape[0]):
        away = max(mouths[k, first] - y, y - mouths[k, first + 1])
        if away < least:
            nearest, least = k, away
    return nearest


@inlined
def is_there(row: NDArray[np.float32]) -> bool:
    """Return whether a row (features,) of a table holds a parcel on the surface."""
    return row[COLUMN.present.place] > 0.5 and row[COLUMN.waits.place] < 0.5


def narrowest(parcel: Parcel) -> float:
    """Compute the smallest extent [m] of a parcel's base over all angles."""
    if not len(parcel.body.edges):
        return 2.0 * parcel.base.reach
    outline = parcel.base.outline
    normals = np.asarray(parcel.base.edges)[:, :2]
    return float(np.ptp(outline @ normals.T, axis=0).min())


@dataclass(frozen=True)
class TakeAwayStatistics:
    """Statistics of one episode. A statistic without data is NaN (not a number)."""

    delivered: int  # number of departed parcels
    parcels_per_hour: float  # [1/h] correct departures
    correct_gaps: float  # [-] share of sufficient gaps on the take-away
    gap_mean: float  # [m] mean gap between successive parcels on the take-away
    gap_5: float  # [m] 5th percentile of the gaps
    gap_spread: float  # [m] standard deviation of the gaps
    aligned: float  # [-] share of aligned parcels among departures by a mouth
    beside: float  # [-] share of departures beside the mouths or over the sides
    touches_per_1000: float  # touches begun per 1000 departed parcels
    jams_per_1000: float  # jams per 1000 departed parcels
    impulse_most: float  # [N s] largest impulse between two parcels in a physics step
    squeeze_most: float  # [N] largest force between two parcels, averaged over 0.1 s
    time_mean: float  # [s] mean time on the surface
    time_95: float  # [s] 95th percentile of the time on the surface
    waiting_mean: float  # [s] mean waiting time of entered parcels
    unfairness: float  # [s] largest minus smallest mean wait of inlets
    order_errors: float  # [-] share of departures before a parcel with a lower place
    turns_per_hour: float  # [1/h] turns per obeying module, a measure of wear


def _is_early(order: Integers, departed: Array) -> Booleans:
    """Return a mask (parcels,) of parcels that departed before a parcel with a lower `order`."""
    by_time = np.argsort(departed, kind="stable")
    after = np.minimum.accumulate(order[by_time][::-1])[::-1]
    early = np.zeros(len(order), dtype=np.bool_)
    early[by_time[:-1]] = order[by_time[:-1]] > after[1:]
    return early


@dataclass(frozen=True)
class TakeAwayTask(StreamTask):
    """Base class of tasks on a slope with a take-away conveyor at its end.

    A parcel departs when its centre passes the end of the rotors. On the take-away, the parcel
    slides with a friction coefficient of 0.5 until it has the take-away's speed. Then the gap is
    measured from the parcel's base to the previous parcel's base.
    """

    stream: Stream = bulk()
    exits: Any = "end"  # "end", "mouth", "mouths", or your own `Exits` at the end
    tilt: float = math.radians(8.0)  # [rad] tilt of the slope, downhill towards +x
    max_parcels: int = 32  # maximum parcels on the surface
    entry_gap: float = 0.0  # [m] clearance of an entering parcel to all others, in any direction
    patience: float = 4.0  # [s] time without motion that counts as a jam, while the take-away runs
    take_away: float = 2.0  # [m/s] speed of the conveyor after the surface
    gap: float = 0.3  # [m] minimum gap between parcels on the take-away
    alignment: float = EIGHTH  # [rad] allowed misalignment; 45 deg allows any angle
    demand: Stops | None = None  # stops of the take-away; None: it never stops

    takes_away = True
    line = slope_line()
    features = FEATURES
    terms = (*PARCEL_TERMS, *SURFACE_TERMS)
    waiting_reward: ClassVar[float] = 0.0
    # time has a high weight in learning, since a queue waits at the edge
    learning_weights = MappingProxyType({"wrong": 2.0, "touch": 5.0, "time": 5.0})
    goals = fs.GOALS + 7
    memories = 2
    exit_memories = 2
    results = ("gap", "misalignment")
    statistics = TakeAwayStatistics

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.settle(
            self,
            take_away=(checks.positive, 0.0, checks.SPEED),
            gap=(checks.not_negative, checks.LENGTH[1]),
            alignment=(checks.angle, 0.0, EIGHTH),
            demand=(checks.instance, Stops, "Stops, or None"),
        )

    def check(self, config: Any) -> None:
        for each in config.exits:
            if each.side:
                raise ValueError(f"exits must all lie straight on, got {each.name!r} to a side")
        super().check(config)

    def numbers(self) -> tuple[float, ...]:
        notice = 0.0 if self.demand is None else self.demand.notice
        return self.take_away, self.gap, self.alignment, notice

    @property
    def surface_memories(self) -> int:
        if self.demand is None:
            return DEMAND
        period = self.demand.run[0] + self.demand.stop[0]
        return DEMAND + 2 * math.ceil(self.duration / period) + 2

    def draw_memory(self, rng: np.random.Generator) -> NDArray[np.float64]:
        memory = np.zeros(self.surface_memories)
        if self.demand is not None:
            count = (len(memory) - DEMAND) // 2
            times = [rng.uniform(*bounds, count) for bounds in (self.demand.run, self.demand.stop)]
            memory[DEMAND:] = np.cumsum(np.transpose(times).ravel())
        return memory

    def is_running(self, memory: Array) -> bool:
        return bool(memory[CHANGES] % 2.0 == 0.0)

    def rate_bound(self, config: Any) -> float:
        """Return the rate [parcels/h] of parcels packed on the take-away at the minimum gap.

        The smallest extent of each parcel lies along the take-away. If all parcels depart
        correctly, no controller exceeds this rate. If large parcels do not depart correctly, the
        rate of correct departures could be higher.
        """
        arrivals = self.stream.arrivals
        if isinstance(arrivals, Trace):
            mean = float(np.mean([narrowest(each.parcel) for each in arrivals.arrivals]))
        else:
            odds = np.array([each for _, each in self.stream.parcels])
            extent = np.array([narrowest(parcel) for parcel, _ in self.stream.parcels])
            mean = float((odds * extent).sum() / odds.sum())
        return HOUR * len(config.exits) * self.take_away / (mean + self.gap)

    def compute_statistics(
        self, streams: fs.StreamState, surface: int, jammed: bool, obeying: int
    ) -> TakeAwayStatistics:
        common = fs.compute_statistics(streams, surface, jammed, obeying)
        count, delivered = int(streams.arrivals[surface]), common.delivered
        time, entered, departed = (
            values[surface, :count] for values in (streams.time, streams.entered, streams.departed)
        )
        gap, misaligned = streams.results[surface, :count].T
        gone, through = ~np.isnan(departed), streams.taken[surface, :count] >= 0
        gaps = gap[through & np.isfinite(gap)]
        inlet, inside = streams.inlet[surface, :count], ~np.isnan(entered)
        waits = [
            float((entered - time)[inside & (inlet == k)].mean()) for k in np.unique(inlet[inside])
        ]
        per_parcel = 1000.0 / delivered if delivered else np.nan
        return TakeAwayStatistics(
            delivered=delivered,
            parcels_per_hour=common.parcels_per_hour,
            correct_gaps=fs.mean(gaps >= self.gap - ROUND_OFF),
            gap_mean=fs.mean(gaps),
            gap_5=fs.percentile(gaps, 5.0),
            gap_spread=float(gaps.std()) if gaps.size else np.nan,
            aligned=fs.mean(np.abs(misaligned[through]) <= self.alignment + ROUND_OFF),
            beside=float((gone & ~through).sum()) / delivered if delivered else np.nan,
            touches_per_1000=float(streams.tally[surface, fs.TOUCHES]) * per_parcel,
            jams_per_1000=common.jams_per_1000,
            impulse_most=float(streams.impulse[surface]),
            squeeze_most=float(streams.squeeze[surface]),
            time_mean=common.time_mean,
            time_95=common.time_95,
            waiting_mean=common.waiting_mean,
            unfairness=max(waits, default=np.nan) - min(waits, default=np.nan),
            order_errors=fs.mean(_is_early(streams.order[surface, :count][gone], departed[gone])),
            turns_per_hour=common.turns_per_hour,
        )

    @staticmethod
    @inlined
    def begin(state: EnvState) -> None:
        """Store the x [m] at which the parcel enters."""
        state.memory[BEFORE] = state.truth[X]

    @staticmethod
    @inlined
    def base_distance(state: EnvState, x: float, y: float) -> float:
        """Return the distance [m] of (x, y) [m] from the sensed base. Inside the base, return 0."""
        sensed = state.sensed
        cosine, sine = math.cos(sensed[THETA]), math.sin(sensed[THETA])
        dx, dy = x - sensed[X], y - sensed[Y]
        if _is_disc(state):
            return max(0.0, math.sqrt(dx * dx + dy * dy) - state.body[RADIUS])
        own_x, own_y = cosine * dx + sine * dy, cosine * dy - sine * dx
        most = 0.0
        for k in range(state.edges.shape[0]):
            edge = state.edges[k]
            most = max(most, edge[0] * own_x + edge[1] * own_y - edge[2])
        return most

    @staticmethod
    @inlined
    def has_room(surface: fs.SurfaceView, state: EnvState, other: EnvState) -> bool:
        """Return whether the bases of two parcels are at least `entry_gap` apart.

        The parcel in `state` is about to enter. The parcel in `other` is on the surface.
        """
        return is_clear_of(state, other, surface.params.entry_gap)

    @staticmethod
    @inlined
    def has_departed(surface: fs.SurfaceView, state: EnvState) -> bool:
        """Return whether the parcel's centre is past the rotors, or no rotor carries the parcel."""
        if not state.on_rotors:
            return True
        if state.com[X] <= surface.params.rotors_end - state.body[RADIUS]:
            return False
        st.read_truth(state)
        return state.truth[X] > surface.params.rotors_end

    @staticmethod
    @inlined
    def exit_taken(surface: fs.SurfaceView, state: EnvState) -> int:
        """Return the index of the exit that a parcel took, or BETWEEN if it missed all exits."""
        offset = state.truth[Y] - state.elements.line_y
        if state.truth[X] > surface.params.rotors_end:
            for k in range(surface.params.exits.shape[0]):
                if surface.params.exits[k, 1] <= offset < surface.params.exits[k, 2]:
                    return k
        return fs.BETWEEN

    @staticmethod
    @inlined
    def advance(surface: fs.SurfaceView, dt: float) -> None:
        """Move the take-away by a step of `dt` [s]. Stop or start the take-away at random times."""
        memory = surface.memory
        if runs(surface):
            memory[BELT] += surface.params.numbers[BELT_SPEED] * dt
        if changes_within(surface, 0.0):
            memory[CHANGES] += 1.0

    @staticmethod
    @inlined
    def may_jam(surface: fs.SurfaceView) -> bool:
        """Return whether the take-away runs. While the take-away stands, there is no jam."""
        return runs(surface)

    @staticmethod
    @inlined
    def deliver(surface: fs.SurfaceView, state: EnvState, taken: int, results: Array) -> bool:
        """Return whether a departure by exit `taken` is correct; write gap and angle to `results`.

        A departure is correct if the whole base is within the exit's span, the sides are aligned,
        the gap is sufficient, and the take-away runs.
        """
        params, truth = surface.params, state.truth
        theta, speed = truth[THETA], max(truth[VX], AT_LEAST)
        results[MISALIGNMENT] = misalignment(state, theta)
        if taken == fs.BETWEEN:
            return False
        take_away, passed = params.numbers[BELT_SPEED], surface.exits[taken]
        beyond = speed - take_away
        slip = beyond * abs(beyond) / (2.0 * GRIP * GRAVITY)
        # Distance moved by the take-away when the centre passed the end.
        at_end = surface.memory[BELT] - take_away * (truth[X] - params.rotors_end) / speed
        front = slip + reach_along(state, theta, 1.0, 0.0)
        gap = math.nan if passed[ANY] == 0.0 else at_end + passed[REAR_END] - front
        passed[ANY] = 1.0
        passed[REAR_END] = slip - reach_along(state, theta, -1.0, 0.0) - at_end
        results[GAP_BEFORE] = gap
        offset = truth[Y] - state.elements.line_y
        inside = (
            offset + reach_along(state, theta, 0.0, 1.0) <= params.exits[taken, 2]
            and offset - reach_along(state, theta, 0.0, -1.0) >= params.exits[taken, 1]
        )
        aligned = abs(results[MISALIGNMENT]) <= params.numbers[MOST_TURNED] + ROUND_OFF
        clear = not gap < params.numbers[LEAST_GAP] - ROUND_OFF
        return runs(surface) and inside and aligned and clear

    @staticmethod
    @inlined
    def inform(surface: fs.SurfaceView, state: EnvState) -> None:
        """Write the exit nearest to the parcel and the take-away's state to the array `state.goal`.

        Also write the present position of the last parcel that departed by this exit.
        """
        params, memory, goal = surface.params, surface.memory, state.goal
        offset = state.sensed[Y] - state.elements.line_y
        nearest = nearest_mouth(params.exits, 1, offset)
        passed = surface.exits[nearest]
        stops = changes_within(surface, params.numbers[NOTICE])
        goal[LOW] = params.exits[nearest, 1]
        goal[HIGH] = params.exits[nearest, 2]
        goal[LAST_REAR] = memory[BELT] + passed[REAR_END] if passed[ANY] else math.inf
        goal[RUNS] = 1.0 if runs(surface) and not stops else 0.0
        goal[SLOPE_END] = params.rotors_end
        goal[ASKED_GAP] = params.numbers[LEAST_GAP]
        goal[NEXT] = surface.next_place

    @staticmethod
    @inlined
    def reward(state: EnvState, outcome: int) -> None:
        """Reward correct departures and progress; penalise wrong departures, touches and time."""
        terms = state.terms
        terms[0] = CORRECT_REWARD if outcome == fs.DEPARTED_CORRECT else 0.0
        terms[1] = WRONG_REWARD if outcome == fs.DEPARTED_WRONG else 0.0
        terms[2] = TOUCH_REWARD * state.memory[fs.TOUCHED]
        terms[3] = PROGRESS_REWARD * (state.truth[X] - state.memory[BEFORE])
        terms[4] = TIME_REWARD * state.period
        state.memory[BEFORE] = state.truth[X]

    @staticmethod
    @inlined
    def observe(state: EnvState, waits: bool) -> None:
        """Write the features of a sensed parcel. If `waits` is true, the parcel waits to enter."""
        sensed, goal = state.sensed, state.goal
        theta, offset = sensed[THETA], sensed[Y] - state.elements.line_y
        distance = goal[SLOPE_END] - sensed[X]
        left, right = reach_along(state, theta, 0.0, 1.0), reach_along(state, theta, 0.0, -1.0)
        # Required motion so that no side is beyond the mouth, or both equally.
        below, above = goal[LOW] - (offset - right), goal[HIGH] - (offset + left)
        to_mouth = max(0.0, below) + min(0.0, above)
        if below > above:  # the parcel is wider than the mouth
            to_mouth = 0.5 * (below + above)
        acceleration = state.surface[st.GRAVITY_X] - 0.01 * state.surface[st.GRAVITY_NORMAL]
        see = state.observation
        show_within(see, COLUMN.to_the_end, distance)
        show_within(see, COLUMN.offset, offset)
        show(see, COLUMN.sine_of_theta, math.sin(theta))
        show(see, COLUMN.cosine_of_theta, math.cos(theta))
        show_within(see, COLUMN.forward_speed, sensed[VX])
        show_within(see, COLUMN.lateral_speed, sensed[VY])
        show_within(see, COLUMN.turning_speed, sensed[OMEGA])
        show(see, COLUMN.length, state.body[HALF_LENGTH])
        show(see, COLUMN.width, reach_along(state, 0.0, 0.0, 1.0))
        show(see, COLUMN.front, reach_along(state, theta, 1.0, 0.0))
        show(see, COLUMN.rear, reach_along(state, theta, -1.0, 0.0))
        show(see, COLUMN.left, left)
        show(see, COLUMN.right, right)
        show_within(see, COLUMN.to_the_mouth, to_mouth)
        show_within(see, COLUMN.to_turn, -misalignment(state, theta))
        rolling = rolling_time(max(0.0, distance), sensed[VX], acceleration)
        show_within(see, COLUMN.rolling, rolling)
        show_within(see, COLUMN.clear, goal[LAST_REAR] - goal[ASKED_GAP])
        show(see, COLUMN.takes_away, goal[RUNS])
        show_within(see, COLUMN.time, state.clock)
        show(see, COLUMN.present, 1.0)
        show(see, COLUMN.waits, 1.0 if waits else 0.0)

    @staticmethod
    @inlined
    def observe_neighbour(state: EnvState, other: EnvState, gap: float, ahead: bool) -> None:
        """Write the features of `other`, the neighbour ahead or behind. `gap` [m] is along x."""
        see = state.observation[AHEAD if ahead else BEHIND :]
        theta = other.sensed[THETA]
        across = reach_along(other, theta, 0.0, 1.0) + reach_along(other, theta, 0.0, -1.0)
        show(see, NEIGHBOUR.gap, min(FAR, max(-FAR, gap)))
        show_within(see, NEIGHBOUR.speed, other.sensed[VX] - state.sensed[VX])
        show_within(see, NEIGHBOUR.offset, other.sensed[Y] - state.sensed[Y])
        show(see, NEIGHBOUR.extent, 0.5 * across)

    @staticmethod
    @inlined
    def observe_no_neighbour(state: EnvState, ahead: bool) -> None:
        """If `ahead`, write that no parcel is ahead. If not, write that no parcel is behind."""
        see = state.observation[AHEAD if ahead else BEHIND :]
        show(see, NEIGHBOUR.gap, FAR)
        for k in range(1, len(NEIGHBOUR)):
            see[k] = 0.0
