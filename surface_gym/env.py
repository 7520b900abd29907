"""The single environment."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym.conditions import Condition
from surface_gym.core.batch import Batch
from surface_gym.faces.single import RENDER_FPS, BatchEnv
from surface_gym.lines import BaseLine
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Exact, Sensor
from surface_gym.settings import Settings
from surface_gym.state import SUCCESS
from surface_gym.tasks import Task

__all__ = ["RENDER_FPS", "SmartSurfaceEnv"]


class SmartSurfaceEnv(BatchEnv):
    """A smart surface under a parcel: actions turn the rotors' axes, sensors tell of the parcel.

    A surface is a grid of modules with idle rotors. Along its axis a rotor drags (mu 0.5), across
    it rolls almost free (mu 0.01). Nothing drives the parcel but its own speed or gravity on a
    tilted surface, so that it can be steered only as long as it moves. SI units and radians; x runs
    along the line, y across it, theta anti-clockwise.

    ## Actions

    Every control period an action chooses orientations for the modules that obey: the rotors of the
    zone that are not stuck. Choices count the `orientations`, by default 0, 45, -45 and 90 deg. At
    a start all axes are at 90 deg, rolling along x as a conveyor would; those outside the zone stay.

    | `actions` | space | sets |
    | --- | --- | --- |
    | "modules" (default) | MultiDiscrete, zone rows x columns | every module's axis, row by row from y < 0 |
    | "halves" | Discrete, choices squared | modules ahead of the parcel's centre (a // choices) and behind it (a % choices) |
    | "quadrants" | MultiDiscrete, 4 | ahead left, ahead right, behind left, behind right; left is y > 0 |
    | "window" | MultiDiscrete, 25 | the 5 x 5 modules around the parcel's centre, row by row from y < 0 |

    "modules" has a number for each place of the widest line (4 rows); on a
    narrower line the numbers of places without a rotor do nothing. Ahead, behind, left, right and
    around refer to the sensed pose.

    With `orientations="any"` each of these is an angle instead, in a Box from -pi/2 to pi/2.

    ## Observation

    The task's features, float32, built from what the sensors say: see the task's page. With
    "window" 25 more follow, 1 for a module that obeys and is sensed to lie under the parcel. With
    `observe_axes` two more for each module of the zone, or of the window: cosine and sine of twice
    its axis angle, which is the same for an axis turned by 180 deg. Axes that take time to turn are
    hidden otherwise. `observe` adds groups of features: "parcel" its length, width and shape, "rotors"
    how many rotors are under each of its quadrants and how they stand, "load" what a `AdaptiveCamera`
    has learned of friction and load.

    ## Info

    `is_success`, `outcome` (why the episode ended, or "running"), `time` [s], the true `pose`
    (x, y, theta) and `velocity` (vx, vy, omega) of the base's centroid, `reward_terms` (named terms
    whose sum is the reward), and the task's own figures. On request, by `info=("axes",
    "normal_forces")`, the axis angles [rad] of all elements, (rows, columns), and what each bears
    of the parcel [N] at present.

    ## End

    Success and failure terminate an episode; running out of time truncates it.

    ## Arguments

    | argument | default | meaning |
    | --- | --- | --- |
    | `task` | set by the id | a task's name, or a task with parameters of its own |
    | `actions` | "modules" | kind of action |
    | `sensors` | `Exact()` | `Exact()`, `Camera(...)`, `AdaptiveCamera(...)` or `Presence(...)` of `surface_gym.sensors` |
    | `control_period` | 0.04 | [s] between decisions; cut into equal physics steps of at most 5 ms |
    | `zone` | None | first and last column that obey; None: those after the lead-in |
    | `orientations` | None | [rad] axis angles on offer, at least two; None: the plant's, 0, pi/4, -pi/4, pi/2; or "any" |
    | `actuators` | `Actuators()` | `axis_speed` [rad/s], `stuck` modules, `stuck_share` |
    | `randomisation` | `Randomisation()` | spreads of friction, mass, size, load and start |
    | `plant` | None | a `Line`, `Field` or `Pattern` of `surface_gym.lines`; None: the task's own |
    | `observe_axes` | False | whether the observation shows the modules' axes |
    | `info` | () | what `info` carries on request |
    | `observe` | () | groups of features that the observation shows besides: "parcel", "rotors", "load" |
    | `condition` | None | a name of `surface_gym.conditions`, as "lab", that sets sensors, actuators and randomisation, and the parcels of a task that draws the study's boxes |
    | `render_mode` | None | "rgb_array", without a display, or "human" |

    `reset(options=...)` fixes a start: `speed`, `parcel` ("S", "B" or a `Parcel`) and the task's own
    goal. An unknown option or a bad value is a ValueError that names it; the episode can go on.

    `gym.make_vec` gives the native vector env, whose lane i seeded s + i equals this env seeded
    s + i to the bit.

    >>> import gymnasium as gym, surface_gym
    >>> env = gym.make("SmartSurface/Sort-v0", actions="halves")
    >>> observation, info = env.reset(seed=0, options={"speed": 1.5, "parcel": "S", "side": 1})
    >>> all_at_minus_45 = 2 * 4 + 2
    >>> terminated = False
    >>> while not terminated:
    ...     observation, reward, terminated, truncated, info = env.step(all_at_minus_45)
    >>> info["outcome"], round(info["time"], 3)
    ('success', 0.51)

    ## Version history

    - v0: first version.
    """

    def __init__(
        self,
        task: str | Task = "sort",
        actions: str = "modules",
        sensors: Sensor = Exact(),
        control_period: float = 0.04,
        zone: tuple[int, int] | None = None,
        orientations: tuple[float, ...] | str | None = None,
        actuators: Actuators = Actuators(),
        randomisation: Randomisation = Randomisation(),
        plant: BaseLine | None = None,
        observe_axes: bool = False,
        info: tuple[str, ...] = (),
        observe: tuple[str, ...] = (),
        condition: str | Condition | None = None,
        render_mode: str | None = None,
    ) -> None:
        self.settings = Settings(
            task,
            actions,
            sensors,
            control_period,
            zone,
            orientations,
            actuators,
            randomisation,
            plant,
            observe_axes,
            info,
            observe,
            condition,
        )
        self._batch = Batch(self.settings, 1)
        super().__init__(self._batch, self.settings.action_kind, render_mode)
        self.observation_space = self.settings.observation_space()
        self.action_space = self.settings.action_space()
        self._task = self._batch.task
        self._outcomes = self._batch.outcomes
        self._trail: list[NDArray[np.float64]] = []
        self._painter: Any = None

    def _record(self, begins: bool) -> None:
        if begins:
            self._trail.clear()
        self._trail.append(self._batch.parcels.truth[0, :2].copy())

    def _picture(self) -> NDArray[np.uint8]:
        from surface_gym.picture import scene_of
        from surface_gym.rendering import Painter

        if self._painter is None:
            self._painter = Painter()
        picture: NDArray[np.uint8] = self._painter.draw(
            scene_of(self._batch, 0, np.array(self._trail))
        )
        return picture

    def _info(self) -> dict[str, Any]:
        lanes = self._batch.parcels
        outcome = int(lanes.outcome[0])
        info = {
            "is_success": outcome == SUCCESS,
            "outcome": self._outcomes[outcome],
            "time": float(lanes.clock[0]),
            "pose": lanes.truth[0, :3].copy(),
            "velocity": lanes.truth[0, 3:].copy(),
            **dict(zip(self._task.metrics, lanes.metrics[0].tolist(), strict=True)),
            "reward_terms": dict(zip(self._task.terms, lanes.terms[0].tolist(), strict=True)),
        }
        for name, values in self._batch.on_request().items():
            info[name] = values[0]
        return info
