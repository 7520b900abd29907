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

# Features of a row of Flow's table. The first are those of Sort, so that a policy that sorts one
# parcel can sort each of a stream.
NEIGHBOUR_FEATURES = (
    GAP, SPEED, replace(ASIDE, meaning="its y over the own, towards the asked side"),
    Feature("side", -1.0, 1.0, "it is to leave by: 1 as this one, -1 the other, 0 straight on"),
    replace(SIZE, meaning="of it, as of this one"),
)  # fmt: skip
FEATURES: tuple[Feature, ...] = (
    *SIDE_FEATURES,
    TIME,
    Feature("past the exit's start", -20.0, 20.0, "of its rear; straight on: zone's", "m", 0.5),
    Feature("side", -1.0, 1.0, "of its exit: 1 for y > 0, -1 for y < 0, 0 for straight on"),
    PRESENT,
    WIDTH,
    Feature("to the exit's end", -20.0, 20.0, "from its centre; straight on: 20", "m", 0.5),
    WAITS,
    *both_ways(NEIGHBOUR_FEATURES),
)
COLUMN, NEIGHBOUR = columns(FEATURES), columns(NEIGHBOUR_FEATURES)
AHEAD, BEHIND = COLUMN.gap_ahead.place, COLUMN.gap_behind.place  # where neighbours' numbers begin

# Flow's reward, term by term; each parcel earns the first.
PARCEL_TERMS: tuple[str, ...] = ("right", "wrong", "touch", "reach", "time")
TERMS: tuple[str, ...] = (*PARCEL_TERMS, *SURFACE_TERMS)
RIGHT_REWARD = 1.0  # once, as a parcel leaves by its exit
WRONG_REWARD = -1.0  # once, as it leaves by another, or between exits
TOUCH_REWARD = -0.5  # for each parcel that begins to touch another
REACH_REWARD = 1.0  # per metre of reach gained
ON_THE_WAY = 0.2  # [-] what a metre towards the exit's start, or the line's end, counts of it
REACH_ENOUGH = 0.6  # [m] reach beyond this earns nothing more
TIME_REWARD = -0.2  # per second of each parcel on the line
REACH = fs.OWN_MEMORY  # place in a parcel's memory: [m] its reach at the last decision


@inlined
def _mirror(state: EnvState) -> float:
    """-1 where a parcel's row is mirrored, else 1."""
    return -1.0 if state.goal[fs.SIDE] < 0.0 else 1.0


@inlined
def _exit_start(state: EnvState) -> float:
    """[m] x that a parcel's rear must be past before it may be turned off: its exit's first, or the
    zone's where that comes later or it goes straight on.
    """
    start = zone_start(state)
    return start if state.goal[fs.SIDE] == 0.0 else max(start, state.goal[fs.FIRST])


@inlined
def _reach(state: EnvState) -> float:
    """[m] how far a parcel has come towards its exit: along the line, and from the exit's start on
    in lateral reach to the asked side; straight on, how near the middle it has stayed.
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
    """Sort a stream of parcels: each is to leave the line by its own exit.

    What the surface is for: material flow. Parcels come in one after the other, mixed in size and
    destination, several are on the line at once, and each is to leave it by its exit: a chute on
    one side, or straight on. The modules drive none of them: they brake along their axis and roll
    across it, so that a parcel's own speed has to carry it out. Parcels that touch push each other.

    ### Stream and entry

    `stream` says when parcels come, which, how fast and where to: see `surface_gym.flow.stream`. A
    parcel comes onto the line with its rear at the edge, x = 0, on the line's middle, when its time
    has come and there is room: its base and `entry_gap` ahead of it are clear, and fewer than
    `max_parcels` are on the line. Until then it waits, and so do those after it; waiting is
    counted.

    ### Exits

    A parcel is delivered when no rotor bears it any more: straight on where its rear is past the
    last column of rotors, else to the side its centre is on, by the chute whose span of x holds its
    centre. It leaves by its own exit, by another, or between exits. `exits="chutes"`, the default,
    are two chutes a side and straight on; "sides" one chute a side, as long as the line, and
    straight on; `surface_gym.flow.exits.Exits` has others.

    ### Actions

    Choices count the `orientations`, by default 0, 45, -45 and 90 deg; with "any" they are angles.
    The lead-in, by default 5 columns, stays at 90 deg.

    | `actions` | space | sets |
    | --- | --- | --- |
    | "modules" (default) | MultiDiscrete, zone rows x columns | every module's axis, row by row from y < 0 |
    | "parcels" | MultiDiscrete, 2 a row of the table | for each parcel two choices: the modules ahead of its centre, and those behind |

    With "parcels" a module obeys the parcel that it bears, or else the one that will bear on it
    first, if within `ahead` seconds: by the parcels' boxes as they are sensed and move on; of two
    that it bears at once, the one with the nearer centre. A module that no parcel claims stays as
    it is.

    With `gate` an action has one number more, the last: 0 keeps the gate shut for the control
    period, k opens it for one parcel from the k-th physics step on.

    ### Observation

    A table, float32, (max_parcels, features): a row a parcel. A parcel keeps its row as long as it
    is on the line; a free one is all 0. The row of a parcel that is to leave to y < 0 is mirrored,
    so that a policy learned for one side serves both; choices are not mirrored.

    | feature | meaning |
    | --- | --- |
    | 0 to 14 | what Sort shows of a parcel, its zone beginning where the exit's span does |
    | 15 | 1 for a parcel, 0 for a free row |
    | 16 | half its width |
    | 17 | how far it is to the exit's end |
    | 18 | 1 for a parcel that waits at the gate |
    | 19 to 23 | the next parcel ahead: gap, speed, lateral offset, side of its exit, size |
    | 24 to 28 | the next one behind |

    With `gate` there are `queue` rows more, by default one. They show parcels that wait, whose time
    has come, as they will enter: row `max_parcels` the one that enters next, then those behind it
    in order; the others are all 0.

    ### Reward

    | term | scale | meaning |
    | --- | --- | --- |
    | `right` | 1 | as a parcel leaves by its exit |
    | `wrong` | -1 | as it leaves otherwise |
    | `touch` | -0.5 | for each of two parcels that begin to touch |
    | `reach` | 1 a metre | how far towards the asked exit: 0.2 of the way along the line up to the exit's start, from there on the gain of lateral reach, as in Sort. Straight on: 0.2 of the way, less the distance from the middle |
    | `time` | -0.2 a second | of each parcel on the line |
    | `waiting` | -0.1 a second | of each parcel that waits to enter |
    | `jam` | -10 | once |

    ### End

    An episode is `duration` seconds of the line, then it is truncated. Parcels that touch do not
    end it; a jam does, as `terminated`: parcels on the line, and none has moved for `patience`.

    ### Info

    `outcome`, `time` [s], `parcels` (max_parcels,) the numbers of the parcels in each row in the
    order they came, -1 for a free one; `entered`, `right`, `wrong`, `touches`, `turns` so far and
    how many are `waiting`; the terms of the reward, each as `reward_` and its name. As an episode
    ends its figures come, 0 before: the fields of `surface_gym.flow.state.FlowStatistics`, each as
    `episode_` and its name: parcels an hour, share missorted, touches and jams per 1000 parcels,
    gaps, times on the surface and at the entry, turns of a module an hour.

    `reset(options={"stream": ...})` gives an episode a stream of its own, and
    `surface_gym.flow.parallel_env.FlowParallelEnv` makes each parcel an agent. Sensors and
    randomisation are those of each parcel, but friction and stiffness, which are the surface's.

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Flow-v0", actions="parcels", duration=4.0)
        >>> observation, info = env.reset(seed=0)
        >>> truncated = False
        >>> while not truncated:  # every parcel straight on
        ...     observation, reward, terminated, truncated, info = env.step([3] * 48)
        >>> info["entered"], info["episode_touches_per_1000"]
        (2, 0.0)

    ### Version history

    - `v0`: first version.
    """

    features = FEATURES
    terms = TERMS
    memories = 2

    def benchmark(self) -> Any:
        return sorting_benchmark(self)

    @staticmethod
    @inlined
    def begin(state: EnvState) -> None:
        """Remember the reach of a parcel that enters, which earns nothing."""
        state.memory[REACH] = _reach(state)

    @staticmethod
    @inlined
    def reward(state: EnvState, outcome: int) -> None:
        """Pay for delivery, reach and haste, and charge for touches."""
        reach = _reach(state)
        terms = state.terms
        terms[0] = RIGHT_REWARD if outcome == fs.DEPARTED_CORRECT else 0.0
        terms[1] = WRONG_REWARD if outcome == fs.DEPARTED_WRONG else 0.0
        terms[2] = TOUCH_REWARD * state.memory[fs.TOUCHED]
        terms[3] = REACH_REWARD * (reach - state.memory[REACH])
        terms[4] = TIME_REWARD * state.period
        state.memory[REACH] = reach

    @staticmethod
    @inlined
    def observe(state: EnvState, waits: bool) -> None:
        """Show a parcel as it is sensed, mirrored so that its side is y > 0."""
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
        """Show the next parcel ahead or behind, seen from this one."""
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
        """Show that there is no parcel that way."""
        see = state.observation[AHEAD if ahead else BEHIND :]
        show(see, NEIGHBOUR.gap, FAR)
        for k in range(1, len(NEIGHBOUR)):
            see[k] = 0.0
