"""The single environment of a flow."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym.faces.single import BatchEnv
from surface_gym.flow.batch import FlowBatch
from surface_gym.flow.exits import Exits
from surface_gym.flow.infos import episodes_of, infos_of
from surface_gym.flow.rewards import TERMS
from surface_gym.flow.settings import LEVELLING, FlowSettings
from surface_gym.flow.stream import Stream
from surface_gym.lines import BaseLine
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Exact, Sensor
from surface_gym.state import RUNNING


class FlowEnv(BatchEnv):
    """A stream of parcels along a line of modules, each to leave by its own exit.

    What the surface is for: material flow. Parcels come in one after the other, mixed in size and
    destination, several are on the line at once, and each is to leave it by its exit: a chute on
    one side, or straight on. The modules drive nobody: they brake along their axis and roll across
    it, so that a parcel's own speed has to carry it out. Parcels that touch push each other.

    ## Stream and entry

    `stream` says when parcels come, which, how fast and where to: see `surface_gym.flow.stream`. A
    parcel comes onto the line with its rear at the edge, x = 0, on the line's middle, when its time
    has come and there is room: its base and `entry_gap` ahead of it are clear, and one of the
    `places` is free. Until then it waits, and so do those after it; waiting is counted.

    ## Exits

    A parcel is delivered when no rotor bears it any more: straight on where its rear is past the
    last column of rotors, else to the side its centre is on, by the chute whose span of x holds its
    centre. It leaves by its own exit, by another, or between exits. `exits="chutes"`, the default,
    are two chutes a side and straight on; "sides" one chute a side, as long as the line, and
    straight on; `surface_gym.flow.exits.Exits` has others.

    ## Actions

    Choices count the `orientations`, by default 0, 45, -45 and 90 deg; with "any" they are angles.
    The lead-in, by default 5 columns, stays at 90 deg.

    | `actions` | space | sets |
    | --- | --- | --- |
    | "modules" (default) | MultiDiscrete, zone rows x columns | every module's axis, row by row from y < 0 |
    | "parcels" | MultiDiscrete, 2 a place | for each place two choices: the modules ahead of its parcel's centre, and those behind |

    With "parcels" a module obeys the parcel that it bears, or else the one that will bear on it
    first, if within `ahead` seconds: by the parcels' boxes as they are sensed and move on; of two
    that it bears at once, the one with the nearer centre. A module that no parcel claims stays as
    it is.

    With `gate` an action has one number more, the last: 0 keeps the gate shut for the control
    period, k opens it for one parcel from the k-th physics step on.

    ## Observation

    A table, float32, (places, features): a row a place. A parcel keeps its place as long as it is
    on the line; a free one is all 0. The row of a parcel that is to leave to y < 0 is mirrored,
    so that what is learned for one side serves both; choices are not mirrored.

    | feature | meaning |
    | --- | --- |
    | 0 to 14 | what Sort shows of a parcel, its zone beginning where the exit's span does |
    | 15 | 1 for a parcel, 0 for a free place |
    | 16 | half its width |
    | 17 | how far it is to the exit's end |
    | 18 | 1 for the parcel that waits at the gate |
    | 19 to 23 | the next parcel ahead: gap, speed, lateral offset, side of its exit, size |
    | 24 to 28 | the next one behind |

    With `gate` one row more, the last, shows the parcel that is to enter next, as it will enter.

    `surface_gym.flow.features.FEATURES` names all, with bounds and units.

    ## Reward

    | term | scale | meaning |
    | --- | --- | --- |
    | `right` | 1 | as a parcel leaves by its exit |
    | `wrong` | -1 | as it leaves otherwise |
    | `touch` | -0.5 | for each of two parcels that begin to touch |
    | `reach` | 1 a metre | how far towards the asked exit: 0.2 of the way along the line up to the exit's start, from there on the gain of lateral reach, as in Sort. Straight on: 0.2 of the way, less the distance from the middle |
    | `time` | -0.2 a second | of each parcel on the line |
    | `waiting` | -0.1 a second | of each parcel that waits to enter |
    | `jam` | -10 | once |

    ## End

    An episode is `duration` seconds of the plant, then it is truncated. Parcels that touch do not
    end it; a jam does, as `terminated`: parcels on the line, and none has moved for `patience`.

    ## Info

    `outcome`, `time` [s], `parcels` (places,) the numbers of the parcels in each place in the order
    they came, -1 for a free one; `entered`, `right`, `wrong`, `touches`, `turns` so far and how many
    are `waiting`; `reward_terms`. As an episode ends `episode_figures` come with it, the fields of
    `surface_gym.flow.statistics.FlowStatistics`: parcels an hour, share missorted, touches and jams
    per 1000 parcels, gaps, times on the surface and at the entry, turns of a module an hour.

    ## Arguments

    | argument | default | meaning |
    | --- | --- | --- |
    | `stream` | `Stream()` | when parcels come, which, how fast, where to |
    | `exits` | "chutes" | a preset, or `Exits` |
    | `actions` | "modules" | or "parcels" |
    | `sensors` | `Exact()` | of each parcel: `Exact()`, `Camera(...)` or `Presence(...)` |
    | `control_period` | 0.04 | [s] between decisions |
    | `duration` | 60 | [s] of an episode |
    | `places` | 24 | for parcels on the line at once |
    | `plant` | None | None: `flow_line()`, 6 m with 4 rows of rotors |
    | `tilt` | 0.01 | [rad] downhill towards +x; the default makes up for what rolling costs: a parcel of 1 m/s would not reach the end of 6 m of a level line |
    | `orientations` | None | [rad] on offer; None: the plant's; or "any" |
    | `actuators` | `Actuators()` | `axis_speed`, `stuck`, `stuck_share` |
    | `randomisation` | `Randomisation()` | spreads: friction and stiffness of the surface, the rest of each parcel |
    | `restitution` | 0 | [-] of sides that touch |
    | `side_friction` | 0.3 | [-] between them |
    | `gate` | False | whether an action says when the next parcel may enter |
    | `entry_gap` | 0.02 | [m] clear ahead of one that enters |
    | `ahead` | 0.1 | [s] within which a module may obey one that it does not bear yet |
    | `patience` | 2 | [s] without motion that make a jam |
    | `render_mode` | None | "rgb_array", without a display, or "human" |

    `reset(options={"stream": ...})` gives an episode a stream of its own. `gym.make_vec` gives the
    native vector env, whose lane i seeded s + i equals this env seeded s + i to the bit;
    `surface_gym.flow.parallel_env.FlowParallelEnv` is the same with a parcel an agent.

    >>> import gymnasium as gym, surface_gym
    >>> env = gym.make("SmartSurface/Flow-v0", actions="parcels", duration=4.0)
    >>> observation, info = env.reset(seed=0)
    >>> truncated = False
    >>> while not truncated:  # everybody straight on
    ...     observation, reward, terminated, truncated, info = env.step([3] * 48)
    >>> info["entered"], info["episode_figures"]["touches_per_1000"]
    (2, 0.0)

    ## Version history

    - v0: first version.
    """

    def __init__(
        self,
        stream: Stream = Stream(),
        exits: str | Exits = "chutes",
        actions: str = "modules",
        sensors: Sensor = Exact(),
        control_period: float = 0.04,
        duration: float = 60.0,
        places: int = 24,
        plant: BaseLine | None = None,
        tilt: float = LEVELLING,
        orientations: tuple[float, ...] | str | None = None,
        actuators: Actuators = Actuators(),
        randomisation: Randomisation = Randomisation(),
        restitution: float = 0.0,
        side_friction: float = 0.3,
        gate: bool = False,
        entry_gap: float = 0.02,
        ahead: float = 0.1,
        patience: float = 2.0,
        render_mode: str | None = None,
    ) -> None:
        self.settings = FlowSettings(
            stream,
            exits,
            actions,
            sensors,
            control_period,
            duration,
            places,
            plant,
            tilt,
            orientations,
            actuators,
            randomisation,
            restitution,
            side_friction,
            gate,
            entry_gap,
            ahead,
            patience,
        )
        self._batch = FlowBatch(self.settings, 1)
        super().__init__(self._batch, self.settings.flow_actions, render_mode)
        self.observation_space = self.settings.observation_space()
        self.action_space = self.settings.action_space()
        self._album: Any = None

    def _info(self) -> dict[str, Any]:
        flows = self._batch.streams
        info = {
            name: values[0].copy() if values.ndim > 1 else values[0].item()
            for name, values in infos_of(self._batch).items()
        }
        info["outcome"] = self._batch.outcomes[info["outcome"]]
        info["reward_terms"] = dict(zip(TERMS, flows.terms[0].tolist(), strict=True))
        if flows.outcome[0] != RUNNING:
            info["episode_figures"] = {
                name: values[0].item()
                for name, values in episodes_of(self._batch, np.ones(1, dtype=np.bool_)).items()
            }
        return info

    def _record(self, begins: bool) -> None:
        from surface_gym.scenes import Renderer

        if self._album is None:
            self._album = Renderer(self._batch, 0)
        self._album.record(begins)

    def _picture(self) -> NDArray[np.uint8]:
        picture: NDArray[np.uint8] = self._album.draw()
        return picture
