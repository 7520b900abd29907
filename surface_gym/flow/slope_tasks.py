"""The tasks on a slope: singulate a bulk of parcels, merge lines, and bring parcels into an order."""

import math
from dataclasses import dataclass, replace
from typing import Any

from surface_gym import checks
from surface_gym.compiler.jit import inlined
from surface_gym.flow import state as fs
from surface_gym.flow.arrivals import Poisson
from surface_gym.flow.benchmarks import (
    merging_benchmark,
    sequencing_benchmark,
    singulation_benchmark,
)
from surface_gym.flow.exits import MOST_INLETS, side_by_side
from surface_gym.flow.state import SurfaceView
from surface_gym.flow.stream import Stream
from surface_gym.flow.take_away import (
    FEATURES,
    NEARLY_STRAIGHT,
    NEXT,
    Stops,
    TakeAwayTask,
    bulk,
    bulk_parcels,
    slope_line,
)
from surface_gym.physics.types import Array
from surface_gym.state import EnvState
from surface_gym.tasks.features import Feature, columns, show, show_within

MOUTH_ALIGNMENT = math.radians(10.0)  # [rad] required alignment in a mouth, for the comparison
MERGE_FEATURES = (
    *FEATURES,
    Feature("line", 0.0, MOST_INLETS / 8.0, "index of the parcel's line, from 0", "", 8.0),
)
LINE = columns(MERGE_FEATURES).line
SEQUENCE_FEATURES = (
    *FEATURES,
    Feature("place", -100.0, 100.0, "number of parcels that must depart earlier", "", 8.0),
)
PLACE = columns(SEQUENCE_FEATURES).place
MOST_WINDOW = 64
_observe, _deliver = TakeAwayTask.observe, TakeAwayTask.deliver


@dataclass(frozen=True)
class Singulate(TakeAwayTask):
    """Turn a bulk of parcels into a row of single parcels with gaps.

    Parcels arrive on a slope side by side, touching, and at any angle. They must depart at the
    lower end one at a time, each at least `gap` behind the previous one. No motor drives the
    parcels. The slope pulls, and the modules under a parcel brake, hold, turn or shift the parcel.
    Only the slope restores lost speed. Parcels push each other and may jam.

    **The surface.** The surface has 5 m x 1.4 m of rotor modules on a slope of 8 deg towards +x. The
    argument `tilt` changes the slope, and `line` changes the size. For example,
    `line=slope_line(4.0, 1.0)` of `surface_gym.flow.take_away` has 4 m x 1 m.

    **Bulk.** `stream` sets the arrivals: see `surface_gym.flow.stream`. In the default stream, random boxes of 0.2
    to 0.45 m x 0.2 to 0.4 m arrive at 9000 parcels per hour and 0.8 m/s, anywhere across the surface and at any
    angle. A parcel enters, with its rear at the upper edge, as soon as its base has a clearance of `entry_gap` to
    all other parcels. Until then, this parcel and all later parcels wait. At most one parcel enters
    per physics step.

    ### The end

    A parcel departs when its centre passes the last rotors. The take-away conveyor then moves the
    parcel at the speed `take_away`. A departure is correct if all of these conditions hold:

    - the parcel's whole base departed by a mouth: `exits="end"` (default) is a mouth as wide as the
      surface, "mouth" is a mouth of 0.6 m in the middle, "mouths" are two mouths side by side;
    - on the take-away, the base is at least `gap` behind the base of the previous parcel;
    - the sides of the base deviate from the line's direction by at most `alignment`. The default
      allows any angle: a rectangle always has a side within 45 deg of the line;
    - the take-away runs. With `demand=Stops()`, the take-away stops at times, with a notice of
      1 s, and parcels must wait.

    **Actions.** A module obeys the choice for the parcel on it: see [Flow](../environments/flow.md#actions).
    At 0 deg, modules brake the parcel. At 90 deg, they let the parcel roll. At -45 deg, they move
    the parcel to y > 0, and at 45 deg, to y < 0. Modules at 45 deg ahead of the parcel's centre and
    modules at -45 deg behind the centre turn the parcel clockwise. Unlike in Flow, nothing is
    mirrored in y.

    ### Reward

    | term | scale | meaning |
    | --- | --- | --- |
    | `correct` | 1 | per correct departure |
    | `wrong` | -1 | per wrong departure |
    | `touch` | -0.02 | per parcel that begins to touch another |
    | `progress` | 0.05 per metre | x gained |
    | `time` | -0.02 per second | per parcel on the surface |
    | `waiting` | 0 | per waiting parcel |
    | `jam` | -10 | once, at a jam |

    **End.** An episode is truncated after `duration` seconds. A jam terminates the episode. A jam
    means that parcels are on the surface, that the take-away runs, and that no parcel has moved for
    `patience` seconds.

    **Info.** `info` is as in [Flow](../environments/flow.md#reward). The prefix `episode_` marks the fields of
    `surface_gym.flow.take_away.TakeAwayStatistics`: parcels per hour, share of correct gaps, gaps, touches, the
    largest impulse and force between parcels, times on the surface and at the entry. In
    `surface_gym.flow.parallel_env.ModuleParallelEnv`, each module is a [PettingZoo](../flow.md#use-the-environment)
    agent.

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Singulate-v0", actions="parcels", duration=4.0)
        >>> observation, info = env.reset(seed=0)
        >>> truncated = False
        >>> while not truncated:  # choice 3, 90 deg: parcels roll on
        ...     observation, reward, terminated, truncated, info = env.step([3] * 64)
        >>> info["entered"], info["correct"], info["wrong"]
        (10, 2, 4)
    """

    def training_tasks(self) -> tuple["Singulate", ...]:
        """Return the task with a narrow exit and 14000 arrivals/h, more than the exit can pass."""
        mouth = replace(self, stream=bulk(14_000.0), exits="mouth", alignment=MOUTH_ALIGNMENT)
        return (mouth,)

    def benchmark(self) -> Any:
        return singulation_benchmark(self, Stops())


def lines(rate: float = 6000.0) -> Stream:
    """Make a stream of boxes of mixed sizes on all lines, at a total mean rate [parcels/h].

    Boxes arrive at random times, in the middle of their line, turned by at most 5 deg, at 0.8 m/s.
    """
    return Stream(Poisson(rate), bulk_parcels(), speeds=0.8, turned=NEARLY_STRAIGHT)


@dataclass(frozen=True)
class Merge(TakeAwayTask):
    """Merge several lines of parcels into one row with gaps, fairly.

    Lines end side by side at the upper edge of a slope, and parcels arrive in a row on each line.
    Parcels must depart by one mouth in the middle of the lower end, each at least `gap` behind the
    previous parcel. A parcel that has no room to enter waits and blocks its line, while the other
    lines continue. All else is as in [Singulate](../environments/singulate.md).

    **Lines.** `inlets` sets the ends of the lines. The default, `side_by_side(3)`, is three inlets
    at the upper edge with middles 0.46 m apart. An `Inlet` may be on any edge. `stream` sets the
    arrivals, and its field `origins` sets the share of each line. In the default stream, all lines
    have equal shares, and 6000 parcels per hour arrive on all lines together.

    **Info.** At the end of an episode, `episode_unfairness` [s] is the longest minus the shortest
    mean wait at an inlet.

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Merge-v0", actions="parcels", duration=4.0)
        >>> observation, info = env.reset(seed=0)
        >>> truncated = False
        >>> while not truncated:  # choice 3, 90 deg: parcels roll on
        ...     observation, reward, terminated, truncated, info = env.step([3] * 64)
        >>> info["entered"], info["correct"], info["wrong"]
        (9, 2, 4)
    """

    stream: Stream = lines()
    inlets: Any = side_by_side(3)
    exits: Any = "mouth"

    features = MERGE_FEATURES

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.inlets) < 2:
            raise ValueError(f"inlets must be at least two to merge, got {len(self.inlets)}")

    def training_tasks(self) -> tuple["Merge", ...]:
        """Return the task with 10000 arrivals per hour, more than can leave through the exit."""
        return (replace(self, stream=lines(10_000.0)),)

    def benchmark(self) -> Any:
        return merging_benchmark(self, side_by_side(2))

    @staticmethod
    @inlined
    def observe(state: EnvState, waits: bool) -> None:
        """Write features: the sensed parcel, whether the parcel waits, and the parcel's line."""
        _observe(state, waits)
        show(state.observation, LINE, state.goal[fs.INLET])


def shuffled(rate: float = 2000.0, window: int = 4) -> Stream:
    """Make a stream of mixed boxes, arriving singly and out of order, at a mean rate [parcels/h].

    The order of departure is random within each group of `window` successive parcels. Parcels
    arrive at least 1 s apart, in the middle of the upper edge, at 0.8 m/s. Entry angles are small.
    """
    law = Poisson(rate, least_gap=1.0)
    return Stream(law, bulk_parcels(), speeds=0.8, turned=NEARLY_STRAIGHT, window=window)


@dataclass(frozen=True)
class Sequence(TakeAwayTask):
    """Bring parcels into a required order of departure, e.g. for loading a truck.

    Parcels are numbered, and must depart by the lower end in the order of their numbers. A parcel
    must be at least `gap` behind the previous parcel. The numbers of every four successive arrivals
    are in random order. So some parcels must wait where other parcels can pass. The surface is
    3 m x 1.4 m. All other rules are as in [Singulate](../environments/singulate.md).

    **Order.** `stream` numbers the parcels: `Stream(..., window=4)` numbers every four successive
    parcels at random. A departure is correct only if all parcels with lower numbers have departed.
    In the default stream, 2000 parcels per hour arrive one by one in the middle, and the window is
    4.

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Sequence-v0", actions="parcels", duration=8.0)
        >>> observation, info = env.reset(seed=0)
        >>> truncated = False
        >>> while not truncated:  # choice 3, 90 deg: parcels roll on
        ...     observation, reward, terminated, truncated, info = env.step([3] * 64)
        >>> info["entered"], info["correct"], info["wrong"]
        (6, 4, 1)
    """

    stream: Stream = shuffled()

    # [s] time without motion that counts as a jam; it is long, since parcels must wait
    patience: float = 20.0

    in_order = True
    line = slope_line(3.0)
    features = SEQUENCE_FEATURES

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.integer("window", self.stream.window, 1, MOST_WINDOW)

    def training_tasks(self) -> tuple["Sequence", ...]:
        """Return tasks for groups of 4 and for groups of 8 shuffled parcels, at 3000 parcels/h."""
        return tuple(replace(self, stream=shuffled(3000.0, window)) for window in (4, 8))

    def benchmark(self) -> Any:
        return sequencing_benchmark(self)

    @staticmethod
    @inlined
    def deliver(surface: SurfaceView, state: EnvState, taken: int, results: Array) -> bool:
        """Return whether a departure by exit `taken` is in order and correct (see Singulate)."""
        is_next = state.goal[fs.ORDER] <= surface.next_place
        return _deliver(surface, state, taken, results) and is_next

    @staticmethod
    @inlined
    def observe(state: EnvState, waits: bool) -> None:
        """Write the sensed parcel's features, and how many parcels must depart before this parcel.

        `waits` is whether the parcel waits to enter.
        """
        _observe(state, waits)
        before = state.goal[fs.ORDER] - state.goal[NEXT]
        show_within(state.observation, PLACE, before)
