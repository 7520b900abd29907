"""The single environment, and the parts that it and the vector environments share."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.config import EnvConfig, with_arguments
from surface_gym.core.batch import BaseBatch
from surface_gym.physics.types import Booleans, Integers
from surface_gym.registration import DEFAULT_TASK, env_id
from surface_gym.registry import import_place
from surface_gym.state import OUT_OF_TIME, RUNNING
from surface_gym.tasks.base import Task
from surface_gym.tasks.start import check_options

RENDER_FPS = 25  # pictures per second: real time at the default control period of 40 ms

Picture = NDArray[Any]


def make_batch(
    config: EnvConfig, num_envs: int, threads: int = 1, max_episode_steps: int | None = None,
    compiles: bool = True,
) -> BaseBatch:  # fmt: skip
    """Make the batch of `num_envs` environments, with one parcel or one stream per environment.

    For the other arguments see `BaseBatch`.
    """
    kind: Callable[..., BaseBatch] = import_place(config.task.batch)
    return kind(config, num_envs, threads, max_episode_steps, compiles)


class Outcome(int):
    """State of an episode: a number with a name.

    The state is printed as its name. The operator == accepts a name or a number.
    """

    name: str

    def __new__(cls, number: int, name: str) -> "Outcome":
        self = super().__new__(cls, number)
        self.name = name
        return self

    def __reduce__(self) -> tuple[Any, tuple[int, str]]:
        return Outcome, (int(self), self.name)

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Outcome):
            other = other.name
        return self.name == other if isinstance(other, str) else int(self) == other

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        return hash(self.name)

    def __str__(self) -> str:
        return self.name

    def __repr__(self) -> str:
        return repr(self.name)

    def __format__(self, form: str) -> str:
        return format(self.name, form)


def make_outcomes(names: tuple[str, ...]) -> tuple[Outcome, ...]:
    """Make the outcomes of a task, numbered in the order of their names."""
    return tuple(Outcome(number, name) for number, name in enumerate(names))


def warn_of_no_render_mode(spec: Any, make: str) -> None:
    """Warn that `render` needs a render mode, which Gymnasium's function `make` can set."""
    made = env_id(DEFAULT_TASK) if spec is None else spec.id
    gym.logger.warn(
        "You are calling render method without specifying any render mode. You can specify the "
        f'render_mode at initialization, e.g. gym.{make}("{made}", render_mode="rgb_array")'
    )


class ResetArguments(NamedTuple):
    """Checked arguments of a reset."""

    mask: Booleans  # (num_envs,) whether an environment is reset
    chosen: Integers  # (count,) indices of these environments
    seeds: list[int | None]  # of all environments
    options: list[dict[str, Any]]  # options of these environments; empty: no options


class BaseVectorEnv(gym.vector.VectorEnv[Any, Any, Any]):
    """Base class of vector environments on any device. It also checks the arguments of resets."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": RENDER_FPS}

    def __init__(
        self,
        num_envs: int,
        autoreset_mode: AutoresetMode | str,
        max_episode_steps: int | None,
        render_mode: str | None,
    ) -> None:
        self.num_envs = checks.integer("num_envs", num_envs, least=1)
        if max_episode_steps == -1:  # no limit, as for `gymnasium.make`
            max_episode_steps = None
        if max_episode_steps is not None:
            checks.integer("max_episode_steps", max_episode_steps, least=1)
        modes = [mode.value for mode in AutoresetMode]
        if not isinstance(autoreset_mode, AutoresetMode):
            checks.one_of("autoreset_mode", autoreset_mode, modes)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode}
        pictures = (None, *type(self).metadata["render_modes"])
        self.render_mode = checks.one_of("render_mode", render_mode, pictures)
        self._limit = np.iinfo(np.int64).max if max_episode_steps is None else max_episode_steps
        self._started = False

    def _set_spaces(self, observations: gym.Space[Any], actions: gym.Space[Any]) -> None:
        """Set the spaces from the spaces of one environment."""
        self.single_observation_space = observations
        self.single_action_space = actions
        self.observation_space = batch_space(observations, self.num_envs)
        self.action_space = batch_space(actions, self.num_envs)

    def _check_reset(
        self,
        seed: int | Sequence[int | None] | None,
        options: dict[str, Any] | Sequence[dict[str, Any] | None] | None,
        allowed: tuple[str, ...],
    ) -> ResetArguments:
        """Check the arguments of a reset; `allowed` are the names of the task's options."""
        mask = np.ones(self.num_envs, dtype=np.bool_)
        if isinstance(options, dict) and "reset_mask" in options:
            mask = self._checked_mask(options["reset_mask"])
            options = {name: value for name, value in options.items() if name != "reset_mask"}
        elif not self._started and seed is None:
            seed = int(np_random()[0].integers(2**31))
        if not self._started and not mask.all():
            raise gym.error.ResetNeeded(
                "The first reset must be of every environment, without reset_mask."
            )
        seeds = self._seed_of_each(seed)
        given = self._options_of_each(options, allowed)
        chosen = np.nonzero(mask)[0]
        some = [given[i] for i in chosen.tolist()] if any(given) else []
        return ResetArguments(mask, chosen, seeds, some)

    def _seed_of_each(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, (bool, int, np.integer)):
            return [checks.integer("seed", seed, least=0) + i for i in range(self.num_envs)]
        if not isinstance(seed, (Sequence, np.ndarray)) or len(seed) != self.num_envs:
            raise ValueError(f"seed must be one number or {self.num_envs} of them, got {seed!r}")
        return [None if each is None else checks.integer("seed", each, least=0) for each in seed]

    def _options_of_each(
        self,
        options: dict[str, Any] | Sequence[dict[str, Any] | None] | None,
        allowed: tuple[str, ...],
    ) -> list[dict[str, Any]]:
        if options is None or isinstance(options, dict):
            return [check_options(options, allowed)] * self.num_envs
        if not isinstance(options, Sequence) or len(options) != self.num_envs:
            raise ValueError(
                f"options must be a dict or {self.num_envs} of dict or None, got {options!r}"
            )
        return [check_options(choice, allowed) for choice in options]

    def _checked_mask(self, mask: Any) -> Booleans:
        if not (
            isinstance(mask, np.ndarray)
            and mask.dtype == np.bool_
            and mask.shape == (self.num_envs,)
            and mask.any()
        ):
            raise ValueError(
                f"reset_mask must be a boolean array of shape ({self.num_envs},) "
                f"with a True in it, got {mask!r}"
            )
        return mask


class SmartSurfaceEnv(gym.Env[Any, Any]):
    """A smart surface with a parcel or a stream of parcels; actions turn the rotors' axes.

    A surface is a grid of modules, by default with idle rotors. A rotor drags along its axis
    ([friction](../physics.md#friction) 0.5), and rolls almost freely across it (0.01). A parcel moves only by its
    own speed, or by gravity on a tilted surface, and can be steered only while it moves: a module brakes, but never
    pushes. Units are SI and radians; x runs along the line, y sideways, theta anti-clockwise. One class serves
    every task; [Flow](../environments/flow.md) says how streams differ.

    ## Actions

    Every control period, an action chooses axis angles for the modules that obey: all modules of the zone that are
    not stuck. A choice is an index into the argument `orientations`: by default 0 to 3 are 0, 45, -45 and 90 deg.
    At the start, all axes are at 90 deg, so parcels roll along x. Axes outside the zone do not turn.

    | `actions` | space | sets |
    | --- | --- | --- |
    | "modules" (default) | MultiDiscrete, zone rows x columns | the axis of each module of the zone, row by row from y < 0 |
    | "halves" | Discrete, n * n for n choices | two choices from one number a: a // n for all modules ahead of the parcel's centre, a % n for all modules behind it |
    | "quadrants" | MultiDiscrete, 4 | four choices: for all modules ahead left of the parcel's centre (left is y > 0), ahead right, behind left, behind right |
    | "window" | MultiDiscrete, 25 | the axes of the 5 x 5 modules around the parcel's centre, row by row from y < 0 |
    | "parcels" | MultiDiscrete, 2 per row of the observation | in streams only: two choices per parcel, for all modules ahead of its centre and for all behind it |

    Streams accept only "modules" and "parcels". With `orientations="any"`,
    actions are angles from -pi/2 to pi/2 (Box).

    Begin with `actions="halves"`. The default "modules" is hard to learn, because each action has
    as many entries as there are modules, and all entries share one reward. "modules" has one entry
    per module of the widest line (4 rows). On a narrower line, entries without a rotor are ignored.
    "Ahead" and "behind" refer to the sensed pose of the parcel.

    ## Driven modules

    `modules` is the kind of all modules: "idle" (default), "belt", "popup", "steered", "omni", or one of
    `surface_gym.modules`, e.g. `modules=SteeredRoller(speeds=(0.0, 1.0))`. Except for "idle", a module's surface
    moves, and grips a parcel with friction 0.5 in all directions. See [the kinds](../driven.md#kinds-of-modules). A
    choice is then a direction and a speed; speed 0 stops the surface. `env.unwrapped.config.modes` has one row per
    choice. A last row describes modules without a command, which convey towards +x. `orientations` must not be
    given. Driven modules can move a parcel at rest, so no episode ends as "stalled".

    ## Observation

    The task's features (float32) are computed from the sensors' reports; see the task's page. With
    `actions="window"`, 25 features follow: 1 for an obeying module under the sensed parcel, else 0. `observe_axes`
    adds two features per module of the zone, or of the window: cosine and sine of twice its axis angle (twice,
    because a turn by 180 deg changes nothing). For driven modules the two features are the velocity of the surface
    in x and y, divided by 2 m/s. Without `observe_axes`, the observation does not show the angles of slow axes.
    `observe` adds groups of features: "parcel" (length, width and shape), "rotors" (number and axes of the rotors
    under each quadrant of the parcel), and "load" (friction and load estimated by an `AdaptiveCamera`).
    `observe="image"`, or a `surface_gym.Image` with another size or colours, replaces all features by a picture of
    the true state from above (uint8).

    ## Info

    `outcome` is "running" or the reason of the end; `env.unwrapped.outcomes` lists all. An outcome is a number that
    prints as its name, and `info["outcome"] == "success"` works, too. `info` also has `is_success`, `time` [s], and
    the true `pose` (x, y, theta) and `velocity` (vx, vy, omega) of the base's centroid. `parcel` has the parcel's
    length, width [m], mass [kg] and height of the centre of mass [m]. The terms of the reward have the prefix
    `reward_`. A task may add metrics. The argument `info=("axes", "normal_forces")` adds two arrays (rows,
    columns): the axis angle [rad] of every element, and the normal force [N] on it. `info=("energy",)` adds three
    sums since the start [J]: `drive_work` is the work of all drives, `drawn_energy` is the work of drives that
    push, and `friction_heat` is the heat of friction. It also adds `peak_acceleration` [m/s^2], the largest since
    the start. In a stream, the sums and the largest acceleration are over all parcels.

    ## End

    Success and failure terminate an episode; the time limit truncates it, which is no failure.
    Failures of many tasks:

    - "stalled": no point of the base moves faster than 1 mm/s;
    - "off the line": no rotor is under the base any more;
    - "off the surface": the centre of mass passes the edge of the surface.

    At the time limit, `gym.make` may set both `truncated` and `terminated`; the native vector env
    sets only one of them.

    ## Arguments

    Keyword arguments of `gym.make`, `gym.make_vec` and the classes are the fields of `surface_gym.config.EnvConfig`
    and of the task, e.g. `stream` of Flow. [`preset="lab"`](../sensors.md#presets-all-of-it-by-a-name) sets
    sensors, actuators and randomisation. A preset's parcels replace only the S-box and the B-box. `render_mode` is
    None, "rgb_array" or "human".

    `reset(options=...)` sets a start: `speed`, `parcel` ("S", "B" or a `Parcel`) and the task's goal. An unknown
    option or an invalid value raises a ValueError that names it; the running episode is not changed. `gym.make_vec`
    returns the native vector env. Its environment i, with seed s, equals a single environment with seed s + i to
    the bit.

    >>> import gymnasium as gym, surface_gym
    >>> env = gym.make("SmartSurface/Sort-v0", actions="halves")
    >>> observation, info = env.reset(seed=0, options={"speed": 1.5, "parcel": "S", "side": 1})
    >>> all_at_minus_45 = 2 * 4 + 2
    >>> terminated = False
    >>> while not terminated:
    ...     observation, reward, terminated, truncated, info = env.step(all_at_minus_45)
    >>> info["outcome"], round(info["time"], 3)
    ('success', 0.51)
    """

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": RENDER_FPS}

    @with_arguments
    def __init__(
        self, task: str | Task = DEFAULT_TASK, *, render_mode: str | None = None, **config: Any
    ) -> None:
        modes = (None, *self.metadata["render_modes"])
        self.render_mode = checks.one_of("render_mode", render_mode, modes)
        self.config = EnvConfig(task, **config)
        self.batch = make_batch(self.config, 1)
        self.outcomes = make_outcomes(self.batch.outcomes)
        self.observation_space = self.config.observation_space()
        self.action_space = self.config.action_space()
        self._action_kind = self.config.action_kind
        self._only = np.zeros(1, dtype=np.int64)
        self._started = False
        self._renderer: Any = None
        self._window: Any = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode: draw the parcel's entry, its speed and its goal.

        Args:
            seed: seed of this and later episodes; None continues with the current random generator.
            options: values that replace random draws, e.g. `{"speed": 1.5, "parcel": "S"}`; see the
                task's page.

        Returns:
            The first observation, and `info`.

        Raises:
            ValueError: an unknown option, or a value that is not allowed.
        """
        batch = self.batch
        options = check_options(options, batch.options)
        if options:
            batch.check([options])
        super().reset(seed=None if seed is None else checks.integer("seed", seed, least=0))
        batch.seed(0, self.np_random)
        batch.reset(self._only, [options] if options else ())
        self._started = True
        if self.render_mode is not None:
            self._record(begins=True)
        return batch.observation[0].copy(), self._info(batch.outcome.item(0))

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Step by one control period: turn the axes, move the parcel, and observe.

        Args:
            action: element of `action_space`, applied for the whole period.

        Returns:
            The observation, the reward, whether the task has ended (terminated), whether the time
            limit is reached (truncated), and `info`.

        Raises:
            ResetNeeded: `reset` was not called, or the episode has ended.
            ValueError: the action is not in the space.
        """
        batch = self.batch
        if not self._started:
            raise gym.error.ResetNeeded("Call reset before step.")
        if batch.outcome.item(0) != RUNNING:
            raise gym.error.ResetNeeded("The episode has ended: call reset before the next step.")
        batch.step(self._action_kind.commands(action, None))
        if self.render_mode is not None:
            self._record(begins=False)
        outcome = batch.outcome.item(0)
        return (
            batch.observation[0].copy(),
            batch.reward.item(0),
            outcome > OUT_OF_TIME,
            outcome == OUT_OF_TIME,
            self._info(outcome),
        )

    def render(self) -> NDArray[np.uint8] | None:
        """Return the picture (height, width, 3) in "rgb_array" mode, else None."""
        if self.render_mode is None:
            warn_of_no_render_mode(self.spec, "make")
        if self.render_mode != "rgb_array":
            return None
        if not self._started:
            raise gym.error.ResetNeeded("Call reset before render.")
        return self._renderer.draw()

    def close(self) -> None:
        """Close the window, if any."""
        if self._window is not None:
            self._window.close()
            self._window = None

    def _info(self, outcome: int) -> dict[str, Any]:
        batch = self.batch
        info = batch.info(0)
        info["outcome"] = self.outcomes[outcome]
        info.update(zip(batch.term_names, batch.terms[0].tolist(), strict=True))
        return info

    def _record(self, begins: bool) -> None:
        """Record the state, and show it in "human" mode. `begins` says if an episode begins."""
        if self._renderer is None:
            from surface_gym.scenes import Renderer

            self._renderer = Renderer(self.batch)
        self._renderer.record(0, begins)
        if self.render_mode == "human":
            from surface_gym.rendering import Window

            if self._window is None:
                self._window = Window(frame_rate=RENDER_FPS)
            self._window.show(self._renderer.draw())
