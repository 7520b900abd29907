"""The vector environments: many environments in one batch, on the CPU or on a GPU."""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.config import EnvConfig, with_arguments
from surface_gym.env import BaseVectorEnv, make_batch, make_outcomes, warn_of_no_render_mode
from surface_gym.parallel import check_count
from surface_gym.physics.types import Booleans, Integers
from surface_gym.registration import DEFAULT_TASK
from surface_gym.state import OUT_OF_TIME, RUNNING
from surface_gym.tasks.base import Task

DEVICES = ("cpu", "cuda")

Observations = NDArray[np.float32]


class SmartSurfaceVectorEnv(BaseVectorEnv):
    """Many environments of `SmartSurfaceEnv`, stepped together by compiled code.

    `gym.make_vec` returns this class. After `reset(seed=s)`, environment i equals the single
    environment after `reset(seed=s + i)`, to the bit. The class takes the arguments of
    `SmartSurfaceEnv` and the arguments below.

    Args:
        num_envs: number of environments.
        max_episode_steps: control periods after which an episode is truncated. None and -1 mean
            no limit.
        threads: number of threads, which does not affect results.
        autoreset_mode: as in Gymnasium: NEXT_STEP, SAME_STEP or DISABLED.

    `reset(options=...)` takes one dict for all environments, or a sequence with a dict or None for
    each environment.
    """

    @with_arguments
    def __init__(
        self,
        num_envs: int = 1,
        task: str | Task = DEFAULT_TASK,
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
        self._all = np.ones(self.num_envs, dtype=np.bool_)
        self._renderer: Any = None

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | Sequence[dict[str, Any] | None] | None = None,
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin an episode in all environments, or where `options["reset_mask"]` is true."""
        batch = self.batch
        given = self._check_reset(seed, options, batch.options)
        if given.options:  # an invalid option of one environment changes no environment
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
        """Step each environment by one control period. `autoreset_mode` says when resets occur."""
        if not self._started:
            raise gym.error.ResetNeeded("Call reset before step.")
        batch = self.batch
        ended = batch.outcome != RUNNING
        if self.autoreset_mode == AutoresetMode.DISABLED and ended.any():
            raise gym.error.ResetNeeded(
                f"Environments {np.nonzero(ended)[0].tolist()} have ended: reset them with "
                "reset_mask."
            )
        anew = np.nonzero(ended)[0]  # NEXT_STEP: this step resets them
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
            for i in chosen.tolist():
                final[i] = batch.observation[i].copy()
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
        """Return a picture (height, width, 3) of each environment; None without a render mode."""
        if self._check_renders():
            return tuple(self._renderer.draw(i) for i in range(self.num_envs))
        return None

    def montage(self) -> NDArray[np.uint8] | None:
        """Return a picture (height, width, 3) of all environments, or None without rendering."""
        return self._renderer.draw_all() if self._check_renders() else None

    def _check_renders(self) -> bool:
        """Return whether there is a render mode. If no reset was called before, raise an error."""
        if self.render_mode is None:
            warn_of_no_render_mode(self.spec, "make_vec")
            return False
        if not self._started:
            raise gym.error.ResetNeeded("Call reset before render.")
        return True

    def _infos(self, mask: Booleans) -> dict[str, Any]:
        """Collect infos as arrays. For each info "name", add "_name", a copy of `mask`.

        The array `mask` (num_envs,) is true for the environments that have these infos.
        """
        batch = self.batch
        infos = batch.infos()
        infos["outcome"] = self._outcomes[batch.outcome]
        infos.update(zip(batch.term_names, batch.terms.T.copy(), strict=True))
        return infos | {f"_{name}": mask.copy() for name in infos}

    def _record(self, chosen: Integers, begins: bool) -> None:
        """Record environments for pictures. `begins` says whether their episodes begin."""
        if self.render_mode is None:
            return
        if self._renderer is None:
            from surface_gym.scenes import Renderer

            self._renderer = Renderer(self.batch)
        for i in chosen.tolist():
            self._renderer.record(i, begins)


def make_vector_env(num_envs: int = 1, device: str = "cpu", **arguments: Any) -> Any:
    """Make the vector environment of `gym.make_vec`, on the CPU or on a GPU.

    Args:
        device: "cpu" or "cuda".
        arguments: arguments of `SmartSurfaceVectorEnv`.

    Raises:
        ValueError: an argument has a value that is not allowed or not supported on this device.
        DeviceMissing: there is no GPU, or a library for GPUs is missing.
    """
    if checks.one_of("device", device, DEVICES) == "cpu":
        return SmartSurfaceVectorEnv(num_envs, **arguments)
    from surface_gym.cuda import check_device

    check_device()
    return make_device_env(num_envs, device, **arguments)


def make_device_env(num_envs: int, device: str, **arguments: Any) -> Any:
    """Make a vector environment of tensors on a torch device.

    Raises:
        ValueError: an argument has a value that is forbidden, or that the device does not support.
    """
    import torch

    from surface_gym.cuda.env import CudaVectorEnv

    for name, only in (("threads", 1), ("render_mode", None)):
        given = arguments.pop(name, only)
        if given != only:
            raise ValueError(f"{name} must be {only} where device is {device!r}, got {given!r}")
    return CudaVectorEnv(num_envs, device=torch.device(device), **arguments)
