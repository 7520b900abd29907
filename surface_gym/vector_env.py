"""The vector environments: many environments in one batch, on the CPU or on a GPU."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.config import EnvConfig, with_arguments
from surface_gym.env import RENDER_FPS, make_batch, make_outcomes, warn_of_no_render_mode
from surface_gym.parallel import check_count
from surface_gym.physics.types import Booleans, Integers
from surface_gym.state import OUT_OF_TIME, RUNNING
from surface_gym.tasks.base import Task
from surface_gym.tasks.start import check_options

Observations = NDArray[np.float32]


class ResetArguments(NamedTuple):
    """Arguments of a reset, checked."""

    mask: Booleans  # (num_envs,) environments that begin
    chosen: Integers  # (count,) the same by their indices
    seeds: list[int | None]  # of all environments
    options: list[dict[str, Any]]  # of those that begin; empty: none has any


class BaseVectorEnv(gym.vector.VectorEnv[Any, Any, Any]):
    """A vector environment of any device: its arguments and those of its resets, checked."""

    metadata = {"render_modes": ["rgb_array"], "render_fps": RENDER_FPS}

    def __init__(
        self,
        num_envs: int,
        autoreset_mode: AutoresetMode | str,
        max_episode_steps: int | None,
        render_mode: str | None,
    ) -> None:
        self.num_envs = checks.integer("num_envs", num_envs, least=1)
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
        """Take the spaces of one environment."""
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
        """Check the arguments of a reset, whose options are among the `allowed`."""
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
        if isinstance(seed, (int, np.integer)):
            return [int(seed) + i for i in range(self.num_envs)]
        if not isinstance(seed, (Sequence, np.ndarray)) or len(seed) != self.num_envs:
            raise ValueError(f"seed must be one number or {self.num_envs} of them, got {seed!r}")
        return list(seed)

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


class SmartSurfaceVectorEnv(BaseVectorEnv):
    """Environments of `SmartSurfaceEnv`, stepped together by compiled code; `gym.make_vec` gives
    this.

    Environment i seeded s + i equals the single environment seeded s + i to the bit. Arguments are
    those of `SmartSurfaceEnv` and:

    Args:
        num_envs: number of environments.
        max_episode_steps: control periods after which an episode is truncated; None: no limit.
        threads: that share the environments; results do not depend on their number.
        autoreset_mode: as in Gymnasium: NEXT_STEP, SAME_STEP or DISABLED.

    `reset(options=...)` takes one dict for all environments, or a sequence of one dict or None for
    each.
    """

    @with_arguments
    def __init__(
        self,
        num_envs: int = 1,
        task: str | Task = "sort",
        *,
        max_episode_steps: int | None = None,
        threads: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **config: Any,
    ) -> None:
        super().__init__(num_envs, autoreset_mode, max_episode_steps, render_mode)
        self.config = EnvConfig(task, **config)
        threads = min(self.num_envs, check_count("threads", threads))
        self.batch = make_batch(self.config, self.num_envs, threads, max_episode_steps)
        self._set_spaces(self.config.observation_space(), self.config.action_space())
        self._action_kind = self.config.action_kind
        self.outcomes = make_outcomes(self.batch.outcomes)
        self._outcomes = np.array(self.outcomes, dtype=object)
        self._masks: list[str] = []  # names of those that come with the infos
        self._all = np.ones(self.num_envs, dtype=np.bool_)
        self._renderer: Any = None

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | Sequence[dict[str, Any] | None] | None = None,
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin an episode in all environments, or in those of `options["reset_mask"]`."""
        batch = self.batch
        given = self._check_reset(seed, options, batch.options)
        if given.options:  # a bad option of one environment leaves all as they were
            batch.check(given.options)
        for i in given.chosen.tolist():
            if given.seeds[i] is not None or not batch.is_seeded(i):
                batch.seed(i, np_random(given.seeds[i])[0])
        batch.reset(given.chosen, given.options)
        self._record(given.chosen, begins=True)
        self._started = True
        return batch.observation.copy(), self._infos(given.mask)

    def step(
        self, actions: Any
    ) -> tuple[Observations, NDArray[np.float64], Booleans, Booleans, dict[str, Any]]:
        """Step every environment by one control period, or begin its next episode."""
        if not self._started:
            raise gym.error.ResetNeeded("Call reset before step.")
        batch = self.batch
        ended = batch.outcome != RUNNING
        if self.autoreset_mode == AutoresetMode.DISABLED and ended.any():
            raise gym.error.ResetNeeded(
                f"Environments {np.nonzero(ended)[0].tolist()} have ended: reset them with "
                "reset_mask."
            )
        anew = np.nonzero(ended)[0]  # NEXT_STEP: this step is their reset
        batch.step(self._action_kind.commands(actions, self.num_envs), anew)
        if self.render_mode is not None:
            self._record(np.nonzero(~ended)[0], begins=False)
            self._record(anew, begins=True)
        truncated = batch.truncated
        terminated = batch.outcome > OUT_OF_TIME
        rewards = batch.reward.copy()
        infos: dict[str, Any] = {}
        over = truncated | terminated
        if self.autoreset_mode == AutoresetMode.SAME_STEP and over.any():
            chosen = np.nonzero(over)[0]
            final = np.full(self.num_envs, None, dtype=object)
            # An array for each: the rows, not their numbers, are the objects.
            final[chosen] = np.frompyfunc(batch.observation[chosen].__getitem__, 1, 1)(
                np.arange(len(chosen))
            )
            infos = {
                "final_obs": final,
                "_final_obs": over.copy(),
                "final_info": self._infos(over),
                "_final_info": over.copy(),
            }
            batch.reset(chosen)
            self._record(chosen, begins=True)
        infos.update(self._infos(self._all))
        return batch.observation.copy(), rewards, terminated, truncated, infos

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Draw one picture (height, width, 3) of all environments; None without a render mode."""
        if self.render_mode is None:
            warn_of_no_render_mode(self.spec, "make_vec")
            return None
        if not self._started:
            raise gym.error.ResetNeeded("Call reset before render.")
        return (self._renderer.draw_all(),)

    def _infos(self, mask: Booleans) -> dict[str, Any]:
        """Collect the infos of the environments in the mask: arrays with their masks."""
        batch = self.batch
        infos = batch.infos()
        infos["outcome"] = self._outcomes[batch.outcome]
        infos.update(zip(batch.term_names, batch.terms.T.copy(), strict=True))
        if not self._masks:
            self._masks = [f"_{name}" for name in infos]
        masks = np.empty((len(infos), self.num_envs), dtype=np.bool_)
        masks[:] = mask
        infos.update(zip(self._masks, masks, strict=True))
        return infos

    def _record(self, chosen: Integers, begins: bool) -> None:
        """Keep the past that a picture shows of some environments, as episodes begin or go on."""
        if self.render_mode is None:
            return
        if self._renderer is None:
            from surface_gym.scenes import Renderer

            self._renderer = Renderer(self.batch)
        for i in chosen.tolist():
            self._renderer.record(i, begins)
