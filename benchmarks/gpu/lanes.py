"""Our vector environments with random actions, on a GPU and on the CPU, resets included."""

import time
from typing import Any

import gymnasium as gym
import numpy as np
import torch

from surface_gym.flow.arrivals import Poisson
from surface_gym.flow.stream import Stream
from surface_gym.registration import FLOW
from surface_gym.tasks.sort import Sort

ID = "SmartSurface/Sort-v0"
PLACES = 16  # for parcels on a line
PARCELS_AN_HOUR = 9000.0
DRAWN = 20  # actions of every lane that the CPU is given in turn


def make_env(task: Sort, lanes: int, **arguments: Any) -> Any:
    """Sort with "halves"; a lane that ends begins again in the same step."""
    return gym.make_vec(
        ID, num_envs=lanes, task=task, actions="halves", autoreset_mode="SameStep", **arguments
    )


def make_flow(lanes: int, **arguments: Any) -> Any:
    """Lines with room for 16 parcels each, and more of them than can enter."""
    return gym.make_vec(
        FLOW,
        num_envs=lanes,
        stream=Stream(Poisson(PARCELS_AN_HOUR)),
        places=PLACES,
        actions="parcels",
        **arguments,
    )


def wait_for(device: torch.device) -> None:
    """Wait until a device has done all that it was given."""
    if device.type == "cuda":
        torch.cuda.synchronize(device)


class DeviceLanes:
    """A vector environment of tensors; actions are drawn on its device, and timed as well.

    Args:
        name: of the contender.
        env: with autoreset in the same step; it is reset twice, so that the time which only the
            first reset takes, to compile, can be told from what every reset does.
    """

    def __init__(self, name: str, env: Any) -> None:
        self.name = name
        self.lanes: int = env.num_envs
        self.env = env
        space = env.single_action_space
        self._choices = int(np.max(space.n if hasattr(space, "n") else space.nvec))
        self._shape = (self.lanes, *space.shape)
        self._generator = torch.Generator(env.device).manual_seed(0)
        self.first = self._reset()
        self.reset = self._reset()  # [s] of all lanes, seeded anew

    def step(self, steps: int) -> None:
        env = self.env
        for _ in range(steps):
            env.step(
                torch.randint(
                    self._choices, self._shape, device=env.device, generator=self._generator
                )
            )
        wait_for(env.device)

    def begun(self) -> int:
        return int(self.env.batch.supply.taken.sum())

    def _reset(self) -> float:
        begin = time.perf_counter()
        self.env.reset(seed=0)
        wait_for(self.env.device)
        return time.perf_counter() - begin


class DeviceFlows(DeviceLanes):
    """The same of lines with a stream of parcels each, whose episodes last a minute."""

    def begun(self) -> int:
        return 0


class HostLanes:
    """The CPU's vector environment; its actions are drawn beforehand.

    Args:
        name: of the contender.
        env: with autoreset in the same step.
    """

    def __init__(self, name: str, env: Any) -> None:
        self.name = name
        self.lanes: int = env.num_envs
        self._env = env
        env.action_space.seed(0)
        self._actions = [env.action_space.sample() for _ in range(DRAWN)]
        self._steps = 0
        self._begun = 0
        begin = time.perf_counter()
        env.reset(seed=0)
        self.first = time.perf_counter() - begin

    def step(self, steps: int) -> None:
        for _ in range(steps):
            _, _, terminated, truncated, _ = self._env.step(self._actions[self._steps % DRAWN])
            self._begun += int(np.count_nonzero(terminated | truncated))
            self._steps += 1

    def begun(self) -> int:
        return self._begun
