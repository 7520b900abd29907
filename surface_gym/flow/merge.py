"""The task of merging lines of parcels into one on a slope."""

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


THREE = side_by_side(3)


def lines(rate: float = 6000.0) -> Stream:
    """Make boxes of mixed sizes that come in a row on each line, at a mean rate [parcels/h] of all.

    They come at random, in the middle of their line, nearly straight, at 0.8 m/s.
    """
    return Stream(Poisson(rate), bulk_parcels(), speeds=0.8, turned=NEARLY_STRAIGHT)


@dataclass(frozen=True)
class Merge(TakeAwayTask):
    """Merge two or three lines of parcels into one, a gap apart, each line in its turn.

    Lines end side by side at the upper edge of a slope, and parcels come in a row on each. They are
    to leave by one mouth in the middle of the lower end, each at least `gap` behind the one before.
    No motor drives them: the slope pulls, and the modules brake, hold, turn and lead them aside. A
    parcel that finds no room waits on its line, and so do those behind it, while the other lines go
    on.

    What `Singulate` says of the surface, the end, actions, reward, episode and infos holds here; so
    does its table, which has one feature more.

    ### Lines

    `inlets` says where the lines end: `side_by_side(3)`, the default, are three side by side at the
    upper edge, 0.46 m from middle to middle; an `Inlet` may lie on any edge. `stream` says when
    parcels come, which, and by its `origins` how many on each line: by default 6000 an hour, at
    equal odds.

    ### Observation

    | feature | meaning |
    | --- | --- |
    | 0 to 28 | what Singulate shows |
    | 29 | the line it came by / 8 |

    ### Info

    Beside what Singulate's has, as an episode ends: `episode_unfairness`, the largest mean wait at
    the entry of a line less the smallest [s].

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Merge-v0", actions="parcels", duration=4.0)
        >>> observation, info = env.reset(seed=0)
        >>> truncated = False
        >>> while not truncated:  # every parcel rolls on
        ...     observation, reward, terminated, truncated, info = env.step([3] * 64)
        >>> info["entered"], info["right"], info["wrong"]
        (9, 2, 4)

    ### Version history

    - `v0`: first version.
    """

    stream: Stream = lines()
    inlets: Any = THREE
    exits: Any = "mouth"

    features = MERGE_FEATURES

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.inlets) < 2:
            raise ValueError(f"inlets must be at least two to merge, got {len(self.inlets)}")

    def training_tasks(self) -> tuple["Merge", ...]:
        """Return the task with more parcels than it can take."""
        return (replace(self, stream=lines(10_000.0)),)

    def benchmark(self) -> Any:
        return merging_benchmark(self, side_by_side(2))

    @staticmethod
    @inlined
    def observe(state: EnvState, waits: bool) -> None:
        """Show a parcel as it is sensed, and its line."""
        _observe(state, waits)
        show(state.observation, LINE, state.goal[fs.INLET])
