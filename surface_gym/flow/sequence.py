"""Sequence: bring parcels into a required order on a slope."""

from dataclasses import dataclass, replace
from typing import Any

from surface_gym import checks
from surface_gym.compiler.jit import inlined
from surface_gym.flow import state as fs
from surface_gym.flow.arrivals import Poisson
from surface_gym.flow.benchmarks import sequencing_benchmark
from surface_gym.flow.state import SurfaceView
from surface_gym.flow.stream import Stream
from surface_gym.flow.take_away import (
    FEATURES,
    NEARLY_STRAIGHT,
    NEXT,
    TakeAwayTask,
    bulk_parcels,
    slope_line,
)
from surface_gym.physics.types import Array
from surface_gym.state import EnvState
from surface_gym.tasks.features import Feature, columns, show_within

SEQUENCE_FEATURES = (
    *FEATURES,
    Feature("place", -100.0, 100.0, "parcels still to leave before it", "", 8.0),
)
PLACE = columns(SEQUENCE_FEATURES).place
MOST_WINDOW = 64
_observe, _deliver = TakeAwayTask.observe, TakeAwayTask.deliver


def shuffled(rate: float = 2000.0, window: int = 4) -> Stream:
    """Make boxes of mixed sizes that arrive one by one, out of order, at a mean rate [parcels/h].

    Successive groups of `window` parcels have a random order. Parcels arrive at least 1 s apart, in
    the middle of the upper edge, almost straight, at 0.8 m/s.
    """
    law = Poisson(rate, least_gap=1.0)
    return Stream(law, bulk_parcels(), speeds=0.8, turned=NEARLY_STRAIGHT, window=window)


@dataclass(frozen=True)
class Sequence(TakeAwayTask):
    """Bring parcels into a required order of departure, e.g. for a truck's load or a kit.

    Each parcel has a place in an order, but arrives out of order within a window of parcels.
    Parcels must depart by the lower end in order, each at least `gap` behind the previous one. No
    motor drives them: the slope pulls, and the modules brake, hold, turn and move them aside.
    Parcels must wait for their turn where others can pass them.

    All else is as in `Singulate`, but the surface is shorter, 3 m x 1.4 m, and the table has one
    more feature.

    ### Order

    `stream` numbers the parcels: `Stream(..., window=4)` numbers every four successive parcels at
    random. A departure is correct only if all parcels with lower numbers have departed. The default
    stream has 2000 parcels per hour, which arrive one by one in the middle, and a window of 4.

    ### Observation

    | feature | meaning |
    | --- | --- |
    | 0 to 28 | features of Singulate |
    | 29 | number of remaining parcels that must depart before it / 8 |

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Sequence-v0", actions="parcels", duration=8.0)
        >>> observation, info = env.reset(seed=0)
        >>> truncated = False
        >>> while not truncated:  # every parcel rolls on
        ...     observation, reward, terminated, truncated, info = env.step([3] * 64)
        >>> info["entered"], info["correct"], info["wrong"]
        (6, 4, 1)

    ### Version history

    - `v0`: first version.
    """

    stream: Stream = shuffled()

    patience: float = 20.0  # [s] time without motion that counts as a jam; parcels may wait

    in_order = True
    line = slope_line(3.0)
    features = SEQUENCE_FEATURES

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.integer("window", self.stream.window, 1, MOST_WINDOW)

    def training_tasks(self) -> tuple["Sequence", ...]:
        """Return the task with a narrow and with a wide window."""
        return tuple(replace(self, stream=shuffled(3000.0, window)) for window in (4, 8))

    def benchmark(self) -> Any:
        return sequencing_benchmark(self)

    @staticmethod
    @inlined
    def deliver(surface: SurfaceView, state: EnvState, taken: int, results: Array) -> bool:
        """Return whether a parcel departed correctly, as in Singulate and in its turn."""
        is_next = state.goal[fs.ORDER] <= surface.next_place
        return _deliver(surface, state, taken, results) and is_next

    @staticmethod
    @inlined
    def observe(state: EnvState, waits: bool) -> None:
        """Write the sensed parcel, and its place in the order."""
        _observe(state, waits)
        before = state.goal[fs.ORDER] - state.goal[NEXT]
        show_within(state.observation, PLACE, before)
