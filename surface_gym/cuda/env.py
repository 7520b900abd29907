"""The vector environment on a CUDA device."""

import math
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode

from surface_gym.config import EnvConfig
from surface_gym.cuda.batch import BaseCudaBatch, CudaBatch, CudaStreamBatch
from surface_gym.cuda.memory import DelayedCopy
from surface_gym.env import BaseVectorEnv
from surface_gym.state import NO_FAULT, OUT_OF_TIME, RUNNING


def make_device_batch(config: EnvConfig, num_envs: int, device: torch.device) -> BaseCudaBatch:
    """Make a batch on the device. Each environment has one parcel or one stream."""
    check_config(config)
    kind = CudaStreamBatch if config.task.is_stream else CudaBatch
    return kind(config, num_envs, device)


def check_config(config: EnvConfig) -> None:
    """Raise a ValueError for configurations that a GPU does not support.

    A GPU supports no sensor noise, no argument `info` and no load limit. Environments with one
    parcel also support no randomisation and no randomly stuck modules.
    """
    if config.draws > 0:
        raise ValueError(
            f"sensors must be one without noise, such as Exact(), where device is 'cuda', "
            f"got {config.sensors!r}"
        )
    stream = config.task.is_stream
    varies, share = config.randomisation, config.actuators.stuck_share
    for name, refused, allowed, value in (
        ("info", bool(config.info), "()", config.info),
        ("randomisation", varies.varies and not stream, "Randomisation(), without variation",
         varies),
        ("load_limit", config.actuators.load_limit != math.inf, "inf",
         config.actuators.load_limit),
        ("stuck_share", share > 0.0 and not stream, "0; stuck names modules that are", share),
    ):  # fmt: skip
        if refused:
            raise ValueError(f"{name} must be {allowed}, where device is 'cuda', got {value!r}")


class TensorActions:
    """Conversion of actions of all environments to commands, like `ActionKind.commands`.

    To check values, the host would have to wait for the device. So a value out of range is only
    recorded in `wrong`, and the error is raised later. In place of the value, a module gets the
    first choice, or 0 rad if actions are angles.
    """

    def __init__(self, space: spaces.Space[Any], num_envs: int, device: torch.device) -> None:
        self._shape = (num_envs, *(space.shape or ()))
        # () whether a value was out of range
        self.wrong = torch.zeros((), dtype=torch.bool, device=device)
        self._continuous = isinstance(space, spaces.Box)
        self._paired = isinstance(space, spaces.Discrete)  # one number encodes two choices
        if isinstance(space, spaces.Box):
            self._max_angle = float(space.high.max())
            self.allowed = "-pi/2 and pi/2"
            return
        assert isinstance(space, spaces.Discrete | spaces.MultiDiscrete)
        counts = np.asarray(space.n if isinstance(space, spaces.Discrete) else space.nvec)
        self._counts = torch.from_numpy(counts.astype(np.int64)).to(device)
        self._per_side = math.isqrt(int(counts.max()))
        self.allowed = f"0 and {int(counts.max()) - 1}"

    def commands(self, actions: Any) -> torch.Tensor:
        """Return the commands (num_envs, size): choices, or angles [rad]."""
        device = self.wrong.device
        if not isinstance(actions, torch.Tensor):
            raise ValueError(f"action must be a torch tensor on {device}, got {type(actions)}")
        if actions.device.type != device.type:
            raise ValueError(f"action must be a tensor on {device}, got one on {actions.device}")
        if tuple(actions.shape) != self._shape:
            raise ValueError(
                f"action must have the shape {self._shape[1:]} for each environment, "
                f"got {tuple(actions.shape)} for all"
            )
        return self._angles(actions) if self._continuous else self._choices(actions)

    def _angles(self, actions: torch.Tensor) -> torch.Tensor:
        if not actions.is_floating_point():
            raise ValueError(f"action must be angles, got {actions.dtype}")
        valid = actions.abs() <= self._max_angle
        self.wrong |= ~valid.all()
        return torch.where(valid, actions, 0.0).to(torch.float64)

    def _choices(self, actions: torch.Tensor) -> torch.Tensor:
        if actions.is_floating_point() or actions.is_complex() or actions.dtype == torch.bool:
            raise ValueError(f"action must be whole numbers, got {actions.dtype}")
        valid = (actions >= 0) & (actions < self._counts)
        self.wrong |= ~valid.all()
        choices = torch.where(valid, actions, 0).to(torch.int64)
        if not self._paired:
            return choices
        return torch.stack([choices // self._per_side, choices % self._per_side], dim=1)


# control periods between checks for errors; a check raises errors of the previous one
CHECK_EVERY = 32


class CudaVectorEnv(BaseVectorEnv):
    """`SmartSurfaceVectorEnv` on a GPU; `gym.make_vec(..., device="cuda")` makes it. Experimental.

    Physics, sensors and tasks are compiled from the CPU's source. An environment with the same seed
    begins as on the CPU. Later states agree with the CPU except for the last digits, since a GPU
    uses fused multiply-add, and its sines differ.

    Actions, observations, rewards and infos are torch tensors on the device. They do not pass
    through the host, and `step` does not wait for the device. Returned tensors are copies.
    Differences from `SmartSurfaceVectorEnv`:

    - infos are tensors (num_envs, ...); "outcome" is only a number, an index into `outcomes`;
    - in SAME_STEP mode "final_obs" and "final_info" exist at every step, and are valid for the
      environments in "_final_obs";
    - if an action is wrong, or a custom task computes a number that is not finite, the error is
      raised at most 64 control periods late; if a custom task uses an index beyond an array, there
      is no error, so test the task on the CPU first;
    - pictures, noise, randomisation, load limits and requested infos are not supported; a parcel
      must be one of the task's parcels;
    - for tasks on streams, the host draws the episodes, so `step` waits for the device; streams may
      be randomised, and report no metrics at the end.

    Args:
        num_envs: number of environments; a data-centre GPU is fully used from about 30 000.
        max_episode_steps: control periods after which an episode is truncated; None for no limit.
        autoreset_mode: NEXT_STEP, SAME_STEP or DISABLED, as in Gymnasium. With DISABLED, the host
            waits for the device in every step.
        config: the other arguments of `SmartSurfaceEnv`.
    """

    def __init__(
        self, num_envs: int, device: torch.device, max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP, **config: Any,
    ) -> None:  # fmt: skip
        super().__init__(num_envs, autoreset_mode, max_episode_steps, None)
        self.config = EnvConfig(**config)
        if self.config.image is not None:
            raise ValueError(f"observe must be of features on a GPU, got {self.config.image!r}")
        self.device = device
        self.batch = make_device_batch(self.config, self.num_envs, device)
        self.outcomes = self.batch.outcomes  # names by the numbers of infos["outcome"]
        self._set_spaces(self.config.observation_space(), self.config.action_space())
        self._actions = TensorActions(self.single_action_space, self.num_envs, device)
        self._all = torch.ones(self.num_envs, dtype=torch.bool, device=device)
        self._steps_remaining = torch.zeros(self.num_envs, dtype=torch.int64, device=device)
        self._steps = 0
        self._last_errors: DelayedCopy | None = None  # at the last check

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | Sequence[dict[str, Any] | None] | None = None,
    ) -> tuple[torch.Tensor, dict[str, Any]]:
        """Begin an episode in all environments, or only where `options["reset_mask"]` is true."""
        batch = self.batch
        if isinstance(options, dict) and torch.is_tensor(options.get("reset_mask")):
            options = {**options, "reset_mask": options["reset_mask"].cpu().numpy()}
        given = self._check_reset(seed, options, batch.options)
        if given.options:  # an invalid option of one environment changes no environment
            batch.check(given.options)
        self._raise_errors()
        generators = {
            i: np_random(given.seeds[i])[0]
            for i in given.chosen.tolist()
            if given.seeds[i] is not None or not batch.is_seeded(i)
        }
        batch.place_drawn(generators, given.chosen, given.options)
        begun = torch.from_numpy(given.mask).to(self.device)
        batch.step(begun)
        self._steps_remaining.masked_fill_(begun, self._limit)
        self._started = True
        return self._observation(), self._infos(begun)

    def step(
        self, actions: Any
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Step all environments by a control period. `autoreset_mode` says when episodes begin."""
        if not self._started:
            raise gym.error.ResetNeeded("Call reset before step.")
        batch = self.batch
        outcome = batch.outcome
        ended = outcome != RUNNING
        if self.autoreset_mode == AutoresetMode.DISABLED and ended.any():
            which = torch.nonzero(ended).flatten().tolist()
            raise gym.error.ResetNeeded(
                f"Environments {which} have ended: reset them with reset_mask."
            )
        batch.command.copy_(self._actions.commands(actions))
        if self.autoreset_mode == AutoresetMode.NEXT_STEP:  # this step is their reset
            batch.place_next(ended)
        batch.step(self._all)
        self._steps_remaining -= 1
        self._steps_remaining.masked_fill_(ended, self._limit)
        late = self._steps_remaining <= 0
        batch.truncate(late)
        truncated = (outcome == OUT_OF_TIME) | late
        terminated = outcome > OUT_OF_TIME
        rewards = batch.reward.clone()
        infos: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP:
            infos = self._reset_ended(truncated | terminated)
        infos.update(self._infos(self._all))
        batch.prepare_starts()
        self._steps += 1
        if self._steps % CHECK_EVERY == 0:
            self._check_errors()
        return self._observation(), rewards, terminated, truncated, infos

    def close_extras(self, **kwargs: Any) -> None:
        """Raise errors not yet raised, and end the thread that draws starts."""
        del kwargs
        self.batch.close()
        self._raise_errors()

    def _reset_ended(self, ended: torch.Tensor) -> dict[str, Any]:
        """Reset the ended environments, and return the infos of their ended episodes."""
        final = {
            "final_obs": self._observation(),
            "_final_obs": ended,
            "final_info": self._infos(ended),
            "_final_info": ended,
        }
        self.batch.place_next(ended)
        self.batch.step(ended)
        self._steps_remaining.masked_fill_(ended, self._limit)
        return final

    def _observation(self) -> torch.Tensor:
        return self.batch.observation.clone(memory_format=torch.contiguous_format)

    def _infos(self, mask: torch.Tensor) -> dict[str, Any]:
        """Return the batch's infos as tensors. Gymnasium's mask of every info is `mask`."""
        infos = self.batch.infos()
        return {**infos, **{f"_{name}": mask for name in infos}}

    def _errors(self) -> DelayedCopy:
        """Return two flags: whether an action was out of range, and whether a function failed."""
        faulty = (self.batch.first_fault != NO_FAULT).any()
        return DelayedCopy(torch.stack([self._actions.wrong, faulty]))

    def _check_errors(self) -> None:
        """Start a check for errors, and raise the errors found by the previous check."""
        last, self._last_errors = self._last_errors, self._errors()
        if last is not None:
            self._raise(*last.read().tolist())

    def _raise_errors(self) -> None:
        self._last_errors = None
        self._raise(*self._errors().read().tolist())

    def _raise(self, action: bool, function: bool) -> None:
        """Raise an error if a flag is set, and clear both flags on the device.

        The flag `action` means a wrong action. The flag `function` means a wrong result of the task
        or sensor.
        """
        if not (action or function):
            return
        self._last_errors = None
        self._actions.wrong.zero_()
        fault = self.batch.first_fault
        faulty = torch.nonzero(fault).flatten().tolist()
        fault.zero_()
        if action:
            raise ValueError(
                f"action must be between {self._actions.allowed}, got another in the last "
                f"{2 * CHECK_EVERY} control periods"
            )
        raise ValueError(
            f"{self.batch.author} gave an outcome that it does not have, or a reward or feature "
            f"that is not finite, in environment {faulty[0]} in the last {2 * CHECK_EVERY} control "
            f"periods; the same environment on the CPU says which"
        )
