"""Stand-in for environments on a device, made of the vector env on the CPU."""

from typing import Any

import torch

from surface_gym import SmartSurfaceVectorEnv
from surface_gym.agents.learning.algorithms import PPOConfig
from surface_gym.agents.library import find_task
from surface_gym.config import REWARD


class EnvsOnCpu:
    """The CPU's vector env in SAME_STEP mode, with `final_obs` and `final_info` at every step.

    Each step spoils the results of the one before: a device may use their memory again.
    """

    device = "cpu"

    def __init__(self, env: SmartSurfaceVectorEnv) -> None:
        self._env = env
        self.num_envs, self.config = env.num_envs, env.config
        self.single_observation_space = env.single_observation_space
        self.single_action_space = env.single_action_space
        self._given: list[torch.Tensor] = []

    def reset(self, *, seed: int) -> tuple[torch.Tensor, dict[str, Any]]:
        observations, infos = self._env.reset(seed=seed)
        self._given = [torch.from_numpy(observations)]
        return self._given[0], self._tensors(infos)

    def step(
        self, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
        *arrays, infos = self._env.step(actions.numpy())
        for before in self._given:
            before.fill_(torch.nan)
        seen, values, ends, cut = map(torch.from_numpy, arrays)
        over = ends | cut
        # Rows of environments that go on are invalid: learning must not read them.
        final_obs = torch.full_like(seen, torch.nan)
        for i in torch.nonzero(over).flatten().tolist():
            final_obs[i] = torch.from_numpy(infos["final_obs"][i])
        given = self._tensors(infos)
        final = self._tensors(infos["final_info"]) if over.any() else given
        given |= {"final_obs": final_obs, "_final_obs": over, "final_info": final}
        given["_final_info"] = over
        self._given = [seen, values, final_obs]
        return seen, values, ends, cut, given

    def close(self) -> None:
        self._env.close()

    def _tensors(self, infos: dict[str, Any]) -> dict[str, Any]:
        names = ("is_success", "time", *(REWARD + term for term in self.config.task.terms))
        return {name: torch.from_numpy(infos[name]) for name in names}


def envs_on_cpu(config: PPOConfig, num_envs: int) -> EnvsOnCpu:
    task = find_task(config.task)
    env = SmartSurfaceVectorEnv(
        num_envs, task, actions=config.actions, control_period=config.control_period,
        observe=config.observe, max_episode_steps=task.periods, autoreset_mode="SameStep",
    )  # fmt: skip
    return EnvsOnCpu(env)
