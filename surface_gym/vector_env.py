"""The native vector environment: many lanes in one batch."""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.actuators import Actuators
from surface_gym.batch.batch import Batch
from surface_gym.lanes.memory import OUT_OF_TIME, RUNNING, SUCCESS
from surface_gym.plants import Plant
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import Exact, Sensor
from surface_gym.settings import Settings
from surface_gym.tasks import Task
from surface_gym.tasks.start import check_options

Booleans = NDArray[np.bool_]
Observations = NDArray[np.float32]


class SmartSurfaceVectorEnv(gym.vector.VectorEnv[Observations, Any, Any]):
    """Lanes of `SmartSurfaceEnv`, moved together by compiled code; what `gym.make_vec` gives.

    Lane i seeded s + i equals the single env seeded s + i to the bit. Arguments are those of
    `SmartSurfaceEnv` and:

    Args:
        num_envs: number of lanes.
        max_episode_steps: control periods after which a lane is truncated; None for no limit.
        threads: that share the lanes; results do not depend on their number.
        autoreset_mode: as in Gymnasium: NEXT_STEP, SAME_STEP or DISABLED.

    `reset(options=...)` takes one dict for all lanes, or a sequence of one dict or None a lane.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 25}

    def __init__(
        self,
        num_envs: int = 1,
        task: str | Task = "sort",
        actions: str = "modules",
        sensors: Sensor = Exact(),
        control_period: float = 0.04,
        zone: tuple[int, int] | None = None,
        orientations: tuple[float, ...] | str | None = None,
        actuators: Actuators = Actuators(),
        randomisation: Randomisation = Randomisation(),
        plant: Plant | None = None,
        observe_axes: bool = False,
        info: tuple[str, ...] = (),
        render_mode: str | None = None,
        max_episode_steps: int | None = None,
        threads: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        self.num_envs = checks.integer("num_envs", num_envs, least=1)
        if max_episode_steps is not None:
            checks.integer("max_episode_steps", max_episode_steps, least=1)
        modes = [mode.value for mode in AutoresetMode]
        if not isinstance(autoreset_mode, AutoresetMode):
            checks.one_of("autoreset_mode", autoreset_mode, modes)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode}
        checks.one_of("render_mode", render_mode, (None, *type(self).metadata["render_modes"]))
        self.render_mode = render_mode
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
        )
        self.single_observation_space = self.settings.observation_space()
        self.single_action_space = self.settings.action_space()
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        threads = min(self.num_envs, checks.integer("threads", threads, least=1))
        self._batch = Batch(self.settings, self.num_envs, threads)
        self._task = self._batch.task
        self._outcomes = np.array(self._batch.outcomes, dtype=object)
        self._kind = self.settings.action_kind
        self._steps_left = np.zeros(self.num_envs, dtype=np.int64)
        self._limit = np.iinfo(np.int64).max if max_episode_steps is None else max_episode_steps
        self._all = np.ones(self.num_envs, dtype=np.bool_)
        self._trails: list[list[NDArray[np.float64]]] = [[] for _ in range(self.num_envs)]
        self._painter: Any = None
        self._started = False

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | Sequence[dict[str, Any] | None] | None = None,
    ) -> tuple[Observations, dict[str, Any]]:
        mask = np.ones(self.num_envs, dtype=np.bool_)
        if isinstance(options, dict) and "reset_mask" in options:
            mask = self._checked_mask(options["reset_mask"])
            options = {name: value for name, value in options.items() if name != "reset_mask"}
        elif not self._started and seed is None:
            seed = int(np_random()[0].integers(2**31))
        if not self._started and not mask.all():
            raise gym.error.ResetNeeded(
                "The first reset must be of every lane, without reset_mask."
            )
        seeds = self._seed_of_each(seed)
        given = self._options_of_each(options)
        chosen = np.nonzero(mask)[0]
        some = [given[lane] for lane in chosen.tolist()] if any(given) else []
        if some:  # a bad option of one lane leaves all as they were
            self._batch.check(some)
        for lane in chosen.tolist():
            if seeds[lane] is not None or self._batch.reserve.generators[lane] is None:
                self._batch.reserve.seed(lane, np_random(seeds[lane])[0])
        self._batch.start(chosen, some)
        self._count_from(chosen)
        self._started = True
        return self._batch.lanes.observation.copy(), self._infos(mask)

    def step(
        self, actions: Any
    ) -> tuple[Observations, NDArray[np.float64], Booleans, Booleans, dict[str, Any]]:
        if not self._started:
            raise gym.error.ResetNeeded("Call reset before step.")
        lanes = self._batch.lanes
        ended = lanes.outcome != RUNNING
        if self.autoreset_mode == AutoresetMode.DISABLED and ended.any():
            raise gym.error.ResetNeeded(
                f"Lanes {np.nonzero(ended)[0].tolist()} have ended: reset them with reset_mask."
            )
        anew = np.nonzero(ended)[0]  # NEXT_STEP: this step is their reset
        self._batch.advance(self._kind.commands(actions, self.num_envs), anew)
        self._steps_left -= 1
        self._follow(~ended)
        self._count_from(anew)
        truncated = self._steps_left <= 0
        lanes.outcome[truncated & (lanes.outcome == RUNNING)] = OUT_OF_TIME
        rewards = lanes.reward.copy()
        terminated = lanes.outcome > OUT_OF_TIME
        infos: dict[str, Any] = {}
        over = truncated | terminated
        if self.autoreset_mode == AutoresetMode.SAME_STEP and over.any():
            chosen = np.nonzero(over)[0]
            final = np.full(self.num_envs, None, dtype=object)
            # An array a lane: the rows, not their numbers, are the objects.
            final[chosen] = np.frompyfunc(lanes.observation[chosen].__getitem__, 1, 1)(
                np.arange(len(chosen))
            )
            infos = {
                "final_obs": final,
                "_final_obs": over.copy(),
                "final_info": self._infos(over),
                "_final_info": over.copy(),
            }
            self._batch.start(chosen)
            self._count_from(chosen)
        infos.update(self._infos(self._all))
        return lanes.observation.copy(), rewards, terminated, truncated, infos

    def _count_from(self, chosen: NDArray[np.int64]) -> None:
        """Episodes have begun on the chosen lanes (count,)."""
        self._steps_left[chosen] = self._limit
        if self.render_mode is not None:
            for lane in chosen.tolist():
                self._trails[lane] = [self._batch.lanes.truth[lane, :2].copy()]

    def _follow(self, mask: Booleans) -> None:
        """Keep the trails of the lanes in the mask, which only drawing needs."""
        if self.render_mode is not None:
            for lane in np.nonzero(mask)[0].tolist():
                self._trails[lane].append(self._batch.lanes.truth[lane, :2].copy())

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One picture (height, width, 3) of all lanes, tiled; None without a render mode."""
        if self.render_mode is None:
            return None
        from surface_gym.picture import scene_of
        from surface_gym.rendering import TilePainter

        if not self._started:
            raise gym.error.ResetNeeded("Call reset before render.")
        if self._painter is None:
            self._painter = TilePainter()
        lanes = self._batch.lanes
        scenes = [
            scene_of(
                self._batch,
                lane,
                np.array(self._trails[lane]),
                f"lane {lane}  {lanes.clock[lane]:.2f} s",
            )
            for lane in range(self.num_envs)
        ]
        return (self._painter.draw(scenes),)

    def _infos(self, mask: Booleans) -> dict[str, Any]:
        """Infos of the lanes in the mask, as Gymnasium lays them out: arrays and their masks."""
        lanes = self._batch.lanes
        terms = {name: lanes.terms[:, k].copy() for k, name in enumerate(self._task.terms)}
        infos = {
            "is_success": lanes.outcome == SUCCESS,
            "outcome": self._outcomes[lanes.outcome],
            "time": lanes.clock.copy(),
            "pose": lanes.truth[:, :3].copy(),
            "velocity": lanes.truth[:, 3:].copy(),
            **{name: lanes.figures[:, k].copy() for k, name in enumerate(self._task.figures)},
            **self._batch.on_request(),
            "reward_terms": {**terms, **{f"_{name}": mask.copy() for name in terms}},
        }
        return {**infos, **{f"_{name}": mask.copy() for name in infos}}

    def _seed_of_each(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, (int, np.integer)):
            return [int(seed) + lane for lane in range(self.num_envs)]
        if not isinstance(seed, (Sequence, np.ndarray)) or len(seed) != self.num_envs:
            raise ValueError(f"seed must be one number or {self.num_envs} of them, got {seed!r}")
        return list(seed)

    def _options_of_each(
        self, options: dict[str, Any] | Sequence[dict[str, Any] | None] | None
    ) -> list[dict[str, Any]]:
        if options is None or isinstance(options, dict):
            return [check_options(options, self._task.options)] * self.num_envs
        if not isinstance(options, Sequence) or len(options) != self.num_envs:
            raise ValueError(
                f"options must be a dict or {self.num_envs} of dict or None, got {options!r}"
            )
        return [check_options(choice, self._task.options) for choice in options]

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
