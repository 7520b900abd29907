"""What lanes on a device give and take, made of the CPU's."""

from typing import Any

import gymnasium as gym
import torch

from agents.learning.config import PPOConfig
from agents.tasks import find_task
from surface_gym import SmartSurfaceVectorEnv


class LanesOnCpu:
    """The CPU's vector env in SAME_STEP mode, with `final_obs` and `final_info` at every step.

    What one step gives, the next spoils: a device's memory may be used again.
    """

    def __init__(self, env: SmartSurfaceVectorEnv) -> None:
        self._env = env
        self.num_envs = env.num_envs
        self.single_observation_space = env.single_observation_space
        self.single_action_space = env.single_action_space
        self.settings = env.settings
        self.device = "cpu"
        self._given: list[torch.Tensor] = []

    def reset(self, *, seed: int) -> tuple[torch.Tensor, dict[str, Any]]:
        observations, infos = self._env.reset(seed=seed)
        seen = torch.from_numpy(observations)
        self._given = [seen]
        return seen, self._tensors(infos)

    def step(
        self, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
        observations, rewards, terminated, truncated, infos = self._env.step(actions.numpy())
        for before in self._given:
            before.fill_(torch.nan)
        seen, over = torch.from_numpy(observations), torch.from_numpy(terminated | truncated)
        # Of lanes that go on, their rows say nothing: learning must not look there.
        final_obs = torch.full_like(seen, torch.nan)
        for lane in torch.nonzero(over).flatten().tolist():
            final_obs[lane] = torch.from_numpy(infos["final_obs"][lane])
        told = self._tensors(infos)
        final = self._tensors(infos["final_info"]) if over.any() else told
        told |= {"final_obs": final_obs, "_final_obs": over, "final_info": final}
        told["_final_info"] = over
        paid, ends = torch.from_numpy(rewards), torch.from_numpy(terminated)
        self._given = [seen, paid, final_obs]
        return seen, paid, ends, torch.from_numpy(truncated), told

    def close(self) -> None:
        self._env.close()

    def _tensors(self, infos: dict[str, Any]) -> dict[str, Any]:
        terms = self.settings.chosen_task.terms
        return {
            "is_success": torch.from_numpy(infos["is_success"]),
            "time": torch.from_numpy(infos["time"]),
            "reward_terms": {name: torch.from_numpy(infos["reward_terms"][name]) for name in terms},
        }


def lanes_on_cpu(config: PPOConfig, lanes: int) -> LanesOnCpu:
    """The lanes of a run."""
    task = find_task(config.task)
    env = SmartSurfaceVectorEnv(
        num_envs=lanes,
        task=task,
        actions=config.actions,
        control_period=config.control_period,
        observe=config.observe,
        max_episode_steps=task.periods,
        autoreset_mode=gym.vector.AutoresetMode.SAME_STEP,
    )
    return LanesOnCpu(env)
