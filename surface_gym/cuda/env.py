"""The vector environment on a CUDA device."""

import math
from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode

from surface_gym.config import EnvConfig
from surface_gym.cuda.batch import CudaEnvs
from surface_gym.cuda.memory import Note
from surface_gym.flow.task import StreamTask
from surface_gym.state import NO_FAULT, OUT_OF_TIME, RUNNING
from surface_gym.vector_env import BaseVectorEnv

EXTRA = 'pip install "surface_gym[gpu]"'


class DeviceMissing(RuntimeError):
    """Error: there is no GPU to run on, or a library to use it is missing."""


def check_device() -> None:
    """Raise DeviceMissing where there is no GPU, or a library to use it is not installed."""
    for module in ("torch", "numba_cuda"):
        if find_spec(module) is None:
            raise DeviceMissing(f"device='cuda' needs {module}, which is not installed: {EXTRA}")
    import torch
    from numba import cuda

    if not torch.cuda.is_available():
        why = "was built without CUDA" if torch.version.cuda is None else "finds none"
        raise DeviceMissing(f"device='cuda' needs an NVIDIA GPU; torch {torch.__version__} {why}")
    if not cuda.is_available():
        raise DeviceMissing("device='cuda' needs an NVIDIA GPU that Numba can use; it finds none")


def check_settings(settings: EnvConfig) -> None:
    """Raise a ValueError for what a GPU does not support yet: noise and all else drawn after a
    start, and infos on request.
    """
    check_sensor(settings)
    varies, share = settings.randomisation, settings.actuators.stuck_share
    for name, refused, allowed, value in (
        ("randomisation", varies.varies, "Randomisation(), without variation", varies),
        ("stuck_share", share > 0.0, "0; stuck names modules that are", share),
        ("info", bool(settings.info), "()", settings.info),
    ):
        if refused:
            raise ValueError(f"{name} must be {allowed}, where device is 'cuda', got {value!r}")


def check_sensor(settings: EnvConfig) -> None:
    """Raise a ValueError for a sensor with noise."""
    if settings.draws > 0:
        raise ValueError(
            f"sensors must be one without noise, such as Exact(), where device is 'cuda', "
            f"got {settings.sensors!r}"
        )


class TensorActions:
    """Turns actions of all environments into commands, as `ActionKind.commands` does.

    To look at numbers, the host would have to wait for the device. So a number out of range is
    noted, not raised at once: the lane gets the first choice, or 0 rad, and `wrong` tells.

    Args:
        space: of one lane's action, as an action kind gives it.
        lanes: their number.
        device: where the actions are.
    """

    def __init__(self, space: spaces.Space[Any], lanes: int, device: torch.device) -> None:
        self._shape = (lanes, *(space.shape or ()))
        # () whether a number was out of range
        self.wrong = torch.zeros((), dtype=torch.bool, device=device)
        self._angles = isinstance(space, spaces.Box)
        self._pairs = isinstance(space, spaces.Discrete)  # a number says two choices
        if isinstance(space, spaces.Box):
            self._right_angle = float(space.high.max())
            self.allowed = "-pi/2 and pi/2"
            return
        assert isinstance(space, spaces.Discrete | spaces.MultiDiscrete)
        most = np.asarray(space.n if isinstance(space, spaces.Discrete) else space.nvec)
        self._choices = torch.from_numpy(most.astype(np.int64)).to(device)
        self._side = math.isqrt(int(most.max()))
        self.allowed = f"0 and {int(most.max()) - 1}"

    def commands(self, actions: Any) -> torch.Tensor:
        """Return actions as commands (num_envs, size): choices, or angles [rad].

        Raises:
            ValueError: no tensor, on another device, of a wrong shape or kind of number.
        """
        device = self.wrong.device
        if not isinstance(actions, torch.Tensor):
            raise ValueError(f"action must be a torch tensor on {device}, got {type(actions)}")
        if actions.device.type != device.type:
            raise ValueError(f"action must be a tensor on {device}, got one on {actions.device}")
        if tuple(actions.shape) != self._shape:
            raise ValueError(
                f"action must have the shape {self._shape[1:]} a lane, "
                f"got {tuple(actions.shape)} of all"
            )
        return self._turned(actions) if self._angles else self._chosen(actions)

    def _turned(self, actions: torch.Tensor) -> torch.Tensor:
        if not actions.is_floating_point():
            raise ValueError(f"action must be angles, got {actions.dtype}")
        right = actions.abs() <= self._right_angle
        self.wrong |= ~right.all()
        return torch.where(right, actions, 0.0).to(torch.float64)

    def _chosen(self, actions: torch.Tensor) -> torch.Tensor:
        if actions.is_floating_point() or actions.is_complex() or actions.dtype == torch.bool:
            raise ValueError(f"action must be whole numbers, got {actions.dtype}")
        right = (actions >= 0) & (actions < self._choices)
        self.wrong |= ~right.all()
        chosen = torch.where(right, actions, 0).to(torch.int64)
        if not self._pairs:
            return chosen
        return torch.stack([chosen // self._side, chosen % self._side], dim=1)


LOOK_EVERY = 32  # control periods from one look for errors to the next, which tells what was seen


class CudaVectorEnv(BaseVectorEnv):
    """`SmartSurfaceVectorEnv` on a GPU; `gym.make_vec(..., device="cuda")` gives it. Experimental.

    The source of physics, sensors and tasks is the CPU's, compiled for the GPU, and lane i seeded
    s + i begins as the CPU's. What follows agrees with the CPU but for the last digits: a GPU
    rounds a product and a sum once, and has sines of its own.

    Actions, observations, rewards and all else are torch tensors on the device; none goes through
    the host, and `step` does not wait for the device. What it returns is the caller's to keep.
    Differences to `SmartSurfaceVectorEnv`:

    - infos name tensors (lanes, ...); "outcome" is a number, the place in `outcomes`;
    - in SAME_STEP mode "final_obs" and "final_info" are there at every step, and hold for the
      lanes in "_final_obs";
    - an action out of range, or a number of a task's own that is not finite, is an error within
      64 control periods; an index of a task's own beyond an array is not seen: try a task on the
      CPU first;
    - there are no pictures, noise, randomisation or infos on request; parcels are the task's;
    - a flow's episodes are drawn as lanes begin, so that its `step` waits for the device to say
      which do; they may vary, and tell no "episode_figures".

    Args:
        num_envs: number of lanes; 30 000 and more fill a data-centre card.
        device: where it runs.
        max_episode_steps: control periods after which a lane is truncated; None for no limit.
        autoreset_mode: as in Gymnasium: NEXT_STEP, SAME_STEP or DISABLED, which makes the host
            wait for the device in every step.
        config: the other arguments, those of `SmartSurfaceEnv`.

    Raises:
        ValueError: an argument is not allowed.
    """

    def __init__(
        self,
        num_envs: int,
        device: torch.device,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        **config: Any,
    ) -> None:
        super().__init__(num_envs, autoreset_mode, max_episode_steps, None)
        self.config = EnvConfig(**config)
        self.device = device
        self.batch = _make_batch(self.config, self.num_envs, device)
        self.outcomes = self.batch.outcomes  # how an episode may stand
        self._set_spaces(self.config.observation_space(), self.config.action_space())
        self._actions = TensorActions(self.single_action_space, self.num_envs, device)
        self._all = torch.ones(self.num_envs, dtype=torch.bool, device=device)
        self._steps_left = torch.zeros(self.num_envs, dtype=torch.int64, device=device)
        self._steps = 0
        self._seen: Note | None = None  # whether anything was wrong at the last look

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | Sequence[dict[str, Any] | None] | None = None,
    ) -> tuple[torch.Tensor, dict[str, Any]]:
        batch = self.batch
        if isinstance(options, dict) and torch.is_tensor(options.get("reset_mask")):
            options = {**options, "reset_mask": options["reset_mask"].cpu().numpy()}
        asked = self._check_reset(seed, options, batch.options)
        if asked.options:  # a bad option of one lane leaves all as they were
            batch.check(asked.options)
        self._check()
        generators = {
            lane: np_random(asked.seeds[lane])[0]
            for lane in asked.chosen.tolist()
            if asked.seeds[lane] is not None or not batch.is_seeded(lane)
        }
        batch.reset(generators, asked.chosen, asked.options)
        begun = torch.from_numpy(asked.mask).to(self.device)
        batch.move(begun)
        self._steps_left.masked_fill_(begun, self._limit)
        self._started = True
        return self._observation(), self._infos(begun)

    def step(
        self, actions: Any
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
        if not self._started:
            raise gym.error.ResetNeeded("Call reset before step.")
        batch = self.batch
        outcome = batch.outcome
        ended = outcome != RUNNING
        if self.autoreset_mode == AutoresetMode.DISABLED and ended.any():
            which = torch.nonzero(ended).flatten().tolist()
            raise gym.error.ResetNeeded(f"Lanes {which} have ended: reset them with reset_mask.")
        batch.command.copy_(self._actions.commands(actions))
        if self.autoreset_mode == AutoresetMode.NEXT_STEP:  # this step is their reset
            batch.place(ended)
        batch.move(self._all)
        self._steps_left -= 1
        self._steps_left.masked_fill_(ended, self._limit)
        late = self._steps_left <= 0
        batch.truncate(late)
        truncated = (outcome == OUT_OF_TIME) | late
        terminated = outcome > OUT_OF_TIME
        rewards = batch.reward.clone()
        infos: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP:
            infos = self._begin_again(truncated | terminated)
        infos.update(self._infos(self._all))
        batch.follow()
        self._steps += 1
        if self._steps % LOOK_EVERY == 0:
            self._look()
        return self._observation(), rewards, terminated, truncated, infos

    def close_extras(self, **kwargs: Any) -> None:
        """Raise errors not yet raised, and end the thread that draws starts."""
        del kwargs
        self.batch.close()
        self._check()

    def _begin_again(self, over: torch.Tensor) -> dict[str, Any]:
        """Reset the environments whose episodes have ended, and return the infos of the ended
        ones.
        """
        ended = {
            "final_obs": self._observation(),
            "_final_obs": over,
            "final_info": self._infos(over),
            "_final_info": over,
        }
        self.batch.place(over)
        self.batch.move(over)
        self._steps_left.masked_fill_(over, self._limit)
        return ended

    def _observation(self) -> torch.Tensor:
        return self.batch.observation.clone(memory_format=torch.contiguous_format)

    def _infos(self, mask: torch.Tensor) -> dict[str, Any]:
        """Infos of the lanes in the mask: tensors and, as Gymnasium has it, whose they are."""
        told, terms = self.batch.told()
        infos = {**told, "reward_terms": {**terms, **{f"_{name}": mask for name in terms}}}
        return {**infos, **{f"_{name}": mask for name in infos}}

    def _wrong(self) -> torch.Tensor:
        """(2,) whether an action was out of range, and whether a function of a task went wrong."""
        return torch.stack([self._actions.wrong, (self.batch.first_fault != NO_FAULT).any()])

    def _look(self) -> None:
        """Raise errors that the last check has found, and check again."""
        seen, self._seen = self._seen, Note(self._wrong())
        if seen is not None:
            self._raise(*seen.read().tolist())

    def _check(self) -> None:
        """Raise errors found by now."""
        self._seen = None
        self._raise(*Note(self._wrong()).read().tolist())

    def _raise(self, action: bool, function: bool) -> None:
        if not (action or function):
            return
        self._seen = None
        self._actions.wrong.zero_()
        fault = self.batch.first_fault
        lanes = torch.nonzero(fault).flatten().tolist()
        fault.zero_()
        if action:
            raise ValueError(
                f"action must be between {self._actions.allowed}, got another in the last "
                f"{2 * LOOK_EVERY} control periods"
            )
        raise ValueError(
            f"{self.batch.author} gave an outcome that it does not have, or a "
            f"reward or feature that is not finite, on lane {lanes[0]} in the last "
            f"{2 * LOOK_EVERY} control periods; the same lane on the CPU says which"
        )


def _make_batch(config: EnvConfig, num_envs: int, device: torch.device) -> CudaEnvs:
    """Make the batch of a device that a task needs: of one parcel each, or of a stream.

    Raises:
        ValueError: an argument is not allowed on a device.
    """
    if isinstance(config.task, StreamTask):
        from surface_gym.cuda.batch import CudaStreamBatch

        check_sensor(config)
        return CudaStreamBatch(config, num_envs, device)
    from surface_gym.cuda.batch import CudaBatch

    check_settings(config)
    return CudaBatch(config, num_envs, device)
