"""Merge: merge lines of parcels into one on a slope."""

from dataclasses import dataclass, replace
from typing import Any

from surface_gym.compiler.jit import inlined
from surface_gym.flow import state as fs
from surface_gym.flow.arrivals import Poisson
from surface_gym.flow.benchmarks import merging_benchmark
from surface_gym.flow.inlets import MOST_INLETS, side_by_side
from surface_gym.flow.stream import Stream
from surface_gym.flow.take_away import FEATURES, NEARLY_STRAIGHT, TakeAwayTask, bulk_parcels
from surface_gym.state import EnvState
from surface_gym.tasks.features import Feature, columns, show

MERGE_FEATURES = (*FEATURES, Feature("line", 0.0, MOST_INLETS / 8.0, "that it came by", "", 8.0))
LINE = columns(MERGE_FEATURES).line
_observe = TakeAwayTask.observe


def lines(rate: float = 6000.0) -> Stream:
    """Make boxes of mixed sizes on each line, at a total mean rate [parcels/h].

    Boxes arrive at random times, in the middle of their line, almost straight, at 0.8 m/s.
    """
    return Stream(Poisson(rate), bulk_parcels(), speeds=0.8, turned=NEARLY_STRAIGHT)


@dataclass(frozen=True)
class Merge(TakeAwayTask):
    """Merge several lines of parcels into one line with gaps, fairly.

    Lines end side by side at the upper edge of a slope, and parcels arrive in a row on each. They
    must depart by one mouth in the middle of the lower end, each at least `gap` behind the previous
    one. No motor drives them: the slope pulls, and the modules brake, hold, turn and move them
    aside. A parcel without room waits on its line and blocks it, while the other lines continue.

    Surface, end, actions, reward, episode and infos are as in `Singulate`. The table has one more
    feature.

    ### Lines

    `inlets` sets the ends of the lines. The default, `side_by_side(3)`, is three inlets at the
    upper edge, 0.46 m from middle to middle; an `Inlet` may be on any edge. `stream` sets the
    arrivals and, by `origins`, the share of each line. The default is 6000 parcels per hour at
    equal odds.

    ### Observation

    | feature | meaning |
    | --- | --- |
    | 0 to 28 | features of Singulate |
    | 29 | line of the parcel / 8 |

    ### Info

    In addition to Singulate, at the end of an episode: `episode_unfairness`, the difference between
    the largest and the smallest mean wait at the lines' entries [s].

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Merge-v0", actions="parcels", duration=4.0)
        >>> observation, info = env.reset(seed=0)
        >>> truncated = False
        >>> while not truncated:  # every parcel rolls on
        ...     observation, reward, terminated, truncated, info = env.step([3] * 64)
        >>> info["entered"], info["correct"], info["wrong"]
        (9, 2, 4)

    ### Version history

    - `v0`: first version.
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
        """Return the task with a stream beyond its capacity: 10000 parcels per hour."""
        return (replace(self, stream=lines(10_000.0)),)

    def benchmark(self) -> Any:
        return merging_benchmark(self, side_by_side(2))

    @staticmethod
    @inlined
    def observe(state: EnvState, waits: bool) -> None:
        """Write the sensed parcel, and its line."""
        _observe(state, waits)
        show(state.observation, LINE, state.goal[fs.INLET])
