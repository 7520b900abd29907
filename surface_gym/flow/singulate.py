"""The task of singulation on a slope: a bulk of parcels leaves one at a time."""

import math
from dataclasses import dataclass, replace
from typing import Any

from surface_gym.flow.benchmarks import singulation_benchmark
from surface_gym.flow.take_away import Stops, TakeAwayTask, bulk


@dataclass(frozen=True)
class Singulate(TakeAwayTask):
    """Turn a bulk of parcels into a row of single ones: one after the other, a gap apart.

    What stands before every sorter. Parcels come onto a slope as they were tipped out: several
    abreast, touching, turned by any angle. They are to leave by its lower end one at a time, each
    at least `gap` behind the one before. No motor drives them. The slope pulls, and the modules
    under a parcel brake it, hold it, turn it or lead it aside; what a brake takes of its speed only
    the slope gives back. Parcels that touch push each other, and may block each other for good.

    ### The surface

    5 m x 1.4 m of modules, all rotors, on a slope of 8 deg towards +x: a parcel that rolls gains
    1.27 m/s each second, one that is braked loses 3.5, and full braking holds up to 26 deg. `tilt`
    and `line` change it, as `line=slope_line(4.0, 1.0)` of `surface_gym.flow.take_away`.

    ### Bulk

    `stream` says when parcels come, which, and how: see `surface_gym.flow.stream`. By default boxes
    of 0.2 to 0.45 m x 0.2 to 0.4 m at random, 9000 an hour, at 0.8 m/s, anywhere across the surface
    and turned by any angle. A parcel enters with its rear at the upper edge when its time has come
    and its base is `entry_gap` clear of all others, at most one a physics step; until then it
    waits, and so do those after it. `Schedule` makes slugs, clumps with pauses; a `Trace` is a recorded
    stream.

    ### The end

    A parcel leaves as its centre passes the last rotors. The take-away, a conveyor of `take_away`,
    carries it on; until it has that speed it slides on its belt, with a friction of 0.5. It has
    left rightly if all of this holds:

    - it left by a mouth, with its whole base: `exits="end"`, the default, is a mouth as wide as the
      surface, "mouth" one of 0.6 m in the middle, "mouths" two of them side by side;
    - on the take-away there is `gap` between its base and that of the one before it;
    - its sides are within `alignment` of the line's, one way or the other; 45 deg, the default,
      allows any angle;
    - the take-away runs: with `demand=Stops()` it stops now and then, a second after it has said
      so, and parcels are to be held on the surface until it runs again.

    ### Actions

    Choices count the `orientations`, by default 0, 45, -45 and 90 deg; with "any" they are angles.

    | `actions` | space | sets |
    | --- | --- | --- |
    | "modules" (default) | MultiDiscrete, zone rows x columns | every module's axis, row by row from y < 0 |
    | "parcels" | MultiDiscrete, 2 a row of the table | for each parcel two choices: the modules ahead of its centre, and those behind |

    At 0 deg modules brake a parcel, at 90 deg it rolls on, at -45 deg they lead it to y > 0 and at
    45 deg to y < 0. 45 deg ahead and -45 deg behind turn it clockwise. With "parcels" a module
    obeys the parcel that it bears, or else the one that will bear on it first, if within `ahead` seconds:
    by the parcels' boxes as they are sensed and move on; of two that it bears at once, the one with
    the nearer centre. A module that no parcel claims stays as it is.

    ### Observation

    A table, float32, (max_parcels, features): a row a parcel. A parcel keeps its row as long as it
    is on the surface; a free one is all 0.

    | feature | meaning |
    | --- | --- |
    | 0 to 6 | where it is, how it is turned, how it moves |
    | 7 to 12 | its half length and width, and how far it reaches ahead, back, left and right as it is turned |
    | 13, 14 | how far it must move along y to be within the nearest mouth, and turn to be aligned |
    | 15 | how long it takes to leave if it rolls |
    | 16 | how far the last that left by that mouth is past the asked gap |
    | 17 | 1 where the take-away runs and goes on |
    | 18 to 20 | time since it entered; 1 for a parcel, 0 for a free row; 1 for one at the gate |
    | 21 to 24 | the next parcel ahead along x: gap, speed, lateral offset, extent |
    | 25 to 28 | the next one behind |

    ### Reward

    | term | scale | meaning |
    | --- | --- | --- |
    | `right` | 1 | as a parcel leaves rightly |
    | `wrong` | -1 | as it leaves otherwise |
    | `touch` | -0.02 | for each of two parcels that begin to touch |
    | `progress` | 0.05 a metre | towards the end |
    | `time` | -0.02 a second | of each parcel on the surface |
    | `waiting` | 0 | of parcels that wait to enter |
    | `jam` | -10 | once |

    ### End

    An episode is `duration` seconds, then it is truncated. A jam ends it, as `terminated`: parcels
    on the surface, the take-away runs, and none has moved for `patience`.

    ### Info

    `outcome`, `time` [s], `parcels` (max_parcels,) the numbers of the parcels in each row in the
    order they came, -1 for a free one; `entered`, `right`, `wrong`, `touches`, `turns` so far and
    how many are `waiting`; the terms of the reward, each as `reward_` and its name. As an episode
    ends its figures come, 0 before: the fields of `surface_gym.flow.take_away.TakeAwayStatistics`,
    each as `episode_` and its name: parcels an hour, share of right gaps, gaps, touches, the
    largest impulse and squeeze, times.

    `reset(options={"stream": ...})` gives an episode a stream of its own. Sensors and randomisation
    are those of each parcel, but friction and stiffness, which are the surface's. In PettingZoo
    `surface_gym.flow.parallel_env.FlowParallelEnv` makes each parcel an agent, and
    `surface_gym.flow.module_parallel_env.ModuleParallelEnv` each module.

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Singulate-v0", actions="parcels", duration=4.0)
        >>> observation, info = env.reset(seed=0)
        >>> truncated = False
        >>> while not truncated:  # every parcel rolls on
        ...     observation, reward, terminated, truncated, info = env.step([3] * 64)
        >>> info["entered"], info["right"], info["wrong"]
        (10, 2, 4)

    ### Version history

    - `v0`: first version.
    """

    def training_tasks(self) -> tuple["Singulate", ...]:
        """Return the task with more parcels than it can take, and a mouth that they leave by."""
        mouth = replace(self, stream=bulk(14_000.0), exits="mouth", alignment=MOUTH_ALIGNMENT)
        return (mouth,)

    def benchmark(self) -> Any:
        return singulation_benchmark(self, Stops())


MOUTH_ALIGNMENT = math.radians(10.0)  # [rad] that the comparison asks for through a mouth
