"""The lanes on a device, as a run practises on them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium as gym
import torch
from gymnasium import spaces

from surface_gym.registration import env_id
from surface_gym.settings import Settings
from surface_gym.tasks import TASKS, Sort

from ...mirror import SIDE
from ...tasks import find_task
from ..config import PPOConfig
from ..practice import PRACTISED
from .mirror import TensorMirror
from .totals import EpisodeTotals


class Lanes(Protocol):
    """A vector env in SAME_STEP mode whose arrays are tensors on one device; the next step may
    write over them.
    """

    num_envs: int
    single_observation_space: spaces.Space[Any]
    single_action_space: spaces.Space[Any]
    settings: Settings
    device: Any  # what `torch.device` takes

    def reset(self, *, seed: int) -> tuple[torch.Tensor, dict[str, Any]]:
        """Start lane i from `seed` + i; observations (lanes, features)."""

    def step(
        self, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Move all lanes by one control period."""

    def close(self) -> None:
        """Free what the lanes hold."""


MakeLanes = Callable[[PPOConfig, int], Lanes]  # the lanes of a run, so many


def make_lanes(config: PPOConfig, lanes: int) -> Lanes:
    """So many lanes of a run on its device.

    Raises:
        ValueError: they cannot be on it; the message says why.
    """
    task = PRACTISED.get(config.task) or find_task(config.task)
    try:
        made: Any = gym.make_vec(
            env_id(config.task if config.task in TASKS else "sort"),  # the task itself is given
            num_envs=lanes,
            device=config.device,
            task=task,
            max_episode_steps=task.periods,
            actions=config.actions,
            control_period=config.control_period,
            observe=config.observe,
            autoreset_mode="SameStep",
        )
    except (ImportError, RuntimeError) as error:
        raise ValueError(f"device {config.device!r} cannot be used: {error}") from error
    return made


@dataclass(frozen=True, eq=False)
class Moved:
    """What a control period brought; tensors on the lanes' device."""

    observations: torch.Tensor  # (lanes, features) of the next start where an episode ended
    rewards: torch.Tensor  # (lanes,) float64
    terminated: torch.Tensor  # (lanes,) ended by success or failure
    ended: torch.Tensor  # (lanes,) or ran out of time
    last: torch.Tensor  # (lanes, features) seen at the period's end, of the episode that ended too


class Practice:
    """Lanes whose episodes are summed up, with actions as for y > 0 where the task is Sort.

    Args:
        lanes: on a device.
    """

    def __init__(self, lanes: Lanes) -> None:
        self.device = torch.device(lanes.device)
        self.lanes = lanes
        settings = lanes.settings
        self.totals = EpisodeTotals(settings.chosen_task.terms, lanes.num_envs, self.device)
        mirrored = isinstance(settings.task, Sort)
        self._mirror = TensorMirror(settings, self.device) if mirrored else None
        self._side = torch.ones(lanes.num_envs, device=self.device)

    def reset(self, seed: int) -> torch.Tensor:
        """Start all lanes, lane i from `seed` + i; observations (lanes, features)."""
        observations, _ = self.lanes.reset(seed=seed)
        self.totals.restart()
        return self._look(observations)

    def step(self, actions: torch.Tensor) -> Moved:
        """Move all lanes by one control period; no number leaves the device."""
        if self._mirror is not None:
            actions = self._mirror(actions, self._side)
        observations, rewards, terminated, truncated, infos = self.lanes.step(actions)
        ended = terminated | truncated
        self.totals.take(rewards, ended, infos)
        last = torch.where(ended.unsqueeze(1), infos["final_obs"], observations)
        return Moved(self._look(observations), rewards.clone(), terminated.clone(), ended, last)

    def _look(self, observations: torch.Tensor) -> torch.Tensor:
        """Observations to keep; which side each parcel is asked to go to is remembered."""
        kept = observations.clone()
        if self._mirror is not None:
            self._side = kept[:, SIDE]
        return kept
