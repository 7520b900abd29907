"""The task of sorting a stream of parcels: its features and rewards."""

import math
from dataclasses import dataclass, replace
from typing import Any

from surface_gym.compiler.jit import inlined
from surface_gym.flow import state as fs
from surface_gym.flow.base import (
    ASIDE,
    FAR,
    GAP,
    PRESENT,
    SPEED,
    SURFACE_TERMS,
    TIME,
    WAITS,
    StreamTask,
    both_ways,
)  # fmt: skip
from surface_gym.flow.benchmarks import sorting_benchmark
from surface_gym.physics.types import HALF_LENGTH, THETA, VX, VY, X, Y
from surface_gym.state import ROWS, EnvState, reach_along, zone_start
from surface_gym.tasks.base import SIZE, WIDTH, show_on_line
from surface_gym.tasks.features import Feature, columns, show, show_within
from surface_gym.tasks.sort import SIDE_FEATURES, lateral_reach

# Features of a row of Flow's table. The first ones equal Sort's, so a policy for one parcel can
# sort each parcel of a stream.
NEIGHBOUR_FEATURES = (
    GAP, SPEED, replace(ASIDE, meaning=f"{ASIDE.meaning}, towards the asked side"),
    Feature("side", -1.0, 1.0, "side of the neighbour's exit: 1 for the parcel's own side, -1 for the other side, 0 for straight on"),
    replace(SIZE, meaning="half of the neighbour's length, observed like feature 6"),
)  # fmt: skip
FEATURES: tuple[Feature, ...] = (
    *SIDE_FEATURES,
    TIME,
    Feature(
        "past the exit's start", -20.0, 20.0,
        "x of the rear minus x of the exit's start; for straight on: minus x of the zone's start", "m", 0.5,
    ),
    Feature("side", -1.0, 1.0, "side of the parcel's exit: 1 for y > 0, -1 for y < 0, 0 for straight on"),
    PRESENT,
    WIDTH,
    Feature(
        "to the exit's end", -20.0, 20.0,
        "x of the exit's end minus x of the centre; for straight on: always observed as 20", "m", 0.5,
    ),
    WAITS,
    *both_ways(NEIGHBOUR_FEATURES),
)  # fmt: skip
COLUMN, NEIGHBOUR = columns(FEATURES), columns(NEIGHBOUR_FEATURES)
AHEAD, BEHIND = COLUMN.gap_ahead.place, COLUMN.gap_behind.place  # first columns of the neighbours

# Flow's reward by term; parcels earn the first ones.
PARCEL_TERMS: tuple[str, ...] = ("correct", "wrong", "touch", "reach", "time")
TERMS: tuple[str, ...] = (*PARCEL_TERMS, *SURFACE_TERMS)
CORRECT_REWARD = 1.0  # once, at a departure by its exit
WRONG_REWARD = -1.0  # once, at a departure by a wrong exit or between exits
TOUCH_REWARD = -0.5  # per parcel that begins to touch another
REACH_REWARD = 1.0  # per metre of reach gained
ON_THE_WAY = 0.2  # [-] share of the reward for a metre towards the exit's start or the line's end
REACH_ENOUGH = 0.6  # [m] maximum rewarded reach
TIME_REWARD = -0.2  # per second and parcel on the line
REACH = fs.OWN_MEMORY  # index in a parcel's memory: [m] reach at the last decision


@inlined
def _mirror(state: EnvState) -> float:
    """Return -1 if a parcel's features are mirrored because the exit is at y < 0, else 1."""
    return -1.0 if state.goal[fs.SIDE] < 0.0 else 1.0


@inlined
def _exit_start(state: EnvState) -> float:
    """Return the larger of two x [m]: the start of the parcel's exit, and the start of the zone.

    If the exit is straight ahead, return x [m] of the zone's start.
    """
    start = zone_start(state)
    return start if state.goal[fs.SIDE] == 0.0 else max(start, state.goal[fs.FIRST])


@inlined
def _reach(state: EnvState) -> float:
    """Return a parcel's progress [m] towards its exit.

    For an exit at a side, the progress is `ON_THE_WAY` times the distance along the line. At the
    exit's start, this distance stops growing. From there on, the progress includes `lateral_reach`,
    limited to the range from 0 to `REACH_ENOUGH`. For an exit straight ahead, the progress is
    `ON_THE_WAY` times the distance along the line, minus the distance from the middle.
    """
    truth = state.truth
    side = state.goal[fs.SIDE]
    offset = truth[Y] - state.elements.line_y
    rear = truth[X] - reach_along(state, truth[THETA], -1.0, 0.0)
    if side == 0.0:
        return ON_THE_WAY * rear - abs(offset)
    start = _exit_start(state)
    way = ON_THE_WAY * min(rear, start)
    if rear < start:
        return way
    lateral = lateral_reach(side * offset, truth[VX], side * truth[VY])
    return way + max(0.0, min(REACH_ENOUGH, lateral))


@dataclass(frozen=True)
class Flow(StreamTask):
    """Sort a stream of parcels: each must leave the line by its own exit.

    Parcels of mixed size and destination arrive one after the other, and several are on the line at
    once. An exit is a chute on one side, or straight ahead. Modules brake along their axis and roll
    across it, but never push. So a parcel needs its own speed to reach its exit. Parcels that touch
    push each other.

    ### Stream and entry

    `stream` sets arrivals, parcels, speeds and destinations: see `surface_gym.flow.stream`. A due parcel enters on
    the line's middle, with its rear at x = 0, as soon as there is room. There is room if fewer than
    `max_parcels` parcels are on the line, and if the entry and the `entry_gap` ahead of the
    entering parcel are clear. Until then, this parcel and all later parcels wait.

    ### Exits

    A parcel departs when no rotor carries the parcel. If the parcel's rear is past the last column
    of rotors, the parcel departs straight ahead. Otherwise the parcel departs at a side. The
    position of the parcel's centre decides which side and which chute. A parcel departs by its own
    exit, by a wrong exit, or between exits. `exits="chutes"` (default) has two chutes per side.
    `exits="sides"` has one chute per side, as long as the line. Both layouts also have an exit
    straight ahead. `surface_gym.flow.exits.Exits` makes other layouts.

    ### Actions

    The lead-in (5 columns by default) stays at 90 deg. With `actions="parcels"`, a module obeys
    the parcel on it. If no parcel is on a module, the module obeys the first parcel that will reach
    the module within `ahead` seconds. The parcels' sensed bounding boxes and velocities decide
    which module a parcel covers or reaches. A module under two parcels
    obeys the parcel with the nearer centre. A module without a parcel keeps its axis.

    With `gate`, the controller also decides when a parcel enters. The action then has one more
    entry at the end. The entry 0 keeps the gate closed for the control period. The entry k opens
    the gate for one parcel, from the k-th physics step of the period on.

    **Observation.** A table (max_parcels, features), float32, with one row per parcel. A parcel keeps its row while
    it is on the line; free rows are 0. The row of a parcel with an exit at y < 0 is mirrored in y. Choices are not
    mirrored: 45 deg always leads to y < 0. With `gate`, the table has `queue`
    more rows (default 1). These rows show waiting parcels at their entry poses.

    ### Reward

    | term | scale | meaning |
    | --- | --- | --- |
    | `correct` | 1 | per departure by the parcel's exit |
    | `wrong` | -1 | per other departure |
    | `touch` | -0.5 | per parcel that begins to touch another |
    | `reach` | 1 per metre | increase of the reach. For an exit at a side, the reach is 0.2 of the distance along the line up to the exit's start; from there on, [Sort](../environments/sort.md#reward)'s reach is added. For an exit straight ahead, the reach is 0.2 of the distance along the line, minus the distance from the middle |
    | `time` | -0.2 per second | per parcel on the line |
    | `waiting` | -0.1 per second | per waiting parcel |
    | `jam` | -10 | once, at a jam |

    **End.** An episode is truncated after `duration` seconds. Touches do not end it. A jam ends it
    as `terminated`. A jam means that parcels are on the line, and that no parcel has moved for
    `patience` seconds.

    **Info.** `info` has `outcome` and `time` [s]. `parcels` (max_parcels,) has the arrival number of the parcel in
    each row, or -1 if the row is free. `entered`, `correct`, `wrong`, `touches` and `turns` are counts so far;
    `waiting` counts the parcels that wait now. The prefix `reward_` marks the terms of the reward.
    The prefix `episode_` marks the fields of `surface_gym.flow.state.FlowStatistics`: parcels per
    hour, share of missorted parcels, touches and jams per 1000 parcels, gaps, times on the surface
    and at the entry, and turns per module and hour. The `episode_` fields are 0 until the episode
    ends.

    `reset(options={"stream": ...})` sets the stream of an episode. In
    `surface_gym.flow.parallel_env.FlowParallelEnv`, each parcel is an agent. Sensors and randomisation apply to
    each parcel separately, but all parcels of an episode share one random friction and stiffness.

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Flow-v0", actions="parcels", duration=4.0)
        >>> observation, info = env.reset(seed=0)
        >>> truncated = False
        >>> while not truncated:  # choice 3, 90 deg: parcels roll on
        ...     observation, reward, terminated, truncated, info = env.step([3] * 48)
        >>> info["entered"], info["episode_touches_per_1000"]
        (2, 0.0)
    """

    features = FEATURES
    terms = TERMS
    memories = 2

    def benchmark(self) -> Any:
        return sorting_benchmark(self)

    @staticmethod
    @inlined
    def begin(state: EnvState) -> None:
        """Store the progress at entry, so that only later progress is rewarded."""
        state.memory[REACH] = _reach(state)

    @staticmethod
    @inlined
    def reward(state: EnvState, outcome: int) -> None:
        """Reward correct departures and progress; penalise wrong departures, touches and time."""
        reach = _reach(state)
        terms = state.terms
        terms[0] = CORRECT_REWARD if outcome == fs.DEPARTED_CORRECT else 0.0
        terms[1] = WRONG_REWARD if outcome == fs.DEPARTED_WRONG else 0.0
        terms[2] = TOUCH_REWARD * state.memory[fs.TOUCHED]
        terms[3] = REACH_REWARD * (reach - state.memory[REACH])
        terms[4] = TIME_REWARD * state.period
        state.memory[REACH] = reach

    @staticmethod
    @inlined
    def observe(state: EnvState, waits: bool) -> None:
        """Write the features of the sensed parcel, mirrored so that the parcel's exit is at y > 0.

        `waits` is whether the parcel waits to enter.
        """
        mirror, side = _mirror(state), state.goal[fs.SIDE]
        offset = show_on_line(state, COLUMN, mirror)
        x, theta, see = state.sensed[X], state.sensed[THETA], state.observation
        half_line = 0.5 * state.elements.pitch_y * (state.zone[ROWS] - 1)
        rear = x - reach_along(state, theta, -1.0, 0.0)
        clearance = offset - reach_along(state, theta, 0.0, -mirror) - half_line
        show_within(see, COLUMN.clearance, clearance)
        show(see, COLUMN.time, state.clock)
        show_within(see, COLUMN.past_the_exit_s_start, rear - _exit_start(state))
        show(see, COLUMN.side, side)
        show(see, COLUMN.present, 1.0)
        show(see, COLUMN.width, reach_along(state, 0.0, 0.0, 1.0))
        to_end = math.inf if side == 0.0 else state.goal[fs.LAST] - x
        show_within(see, COLUMN.to_the_exit_s_end, to_end)
        show(see, COLUMN.waits, 1.0 if waits else 0.0)

    @staticmethod
    @inlined
    def observe_neighbour(state: EnvState, other: EnvState, gap: float, ahead: bool) -> None:
        """Write the features of `other`, the next parcel ahead or behind. `gap` [m] is along x."""
        mirror = _mirror(state)
        see = state.observation[AHEAD if ahead else BEHIND :]
        show(see, NEIGHBOUR.gap, min(FAR, max(-FAR, gap)))
        show_within(see, NEIGHBOUR.speed, other.sensed[VX] - state.sensed[VX])
        show_within(see, NEIGHBOUR.offset, mirror * (other.sensed[Y] - state.sensed[Y]))
        show(see, NEIGHBOUR.side, mirror * other.goal[fs.SIDE])
        show(see, NEIGHBOUR.size, other.body[HALF_LENGTH])

    @staticmethod
    @inlined
    def observe_no_neighbour(state: EnvState, ahead: bool) -> None:
        """If `ahead` is true, write that no parcel is ahead, else that no parcel is behind."""
        see = state.observation[AHEAD if ahead else BEHIND :]
        show(see, NEIGHBOUR.gap, FAR)
        for k in range(1, len(NEIGHBOUR)):
            see[k] = 0.0
