"""HER on Park, with Stable-Baselines3's DQN: learn from goals that were reached by chance.

python examples/learners/her_park.py

It prints the success rate on the starts that `python evaluate.py --task park` gives to the other
methods, with exact sensors and in the lab.
"""

from typing import Any

import fresh_starts
import gymnasium as gym
import torch
from gymnasium.spaces.utils import flatdim
from stable_baselines3 import DQN, HerReplayBuffer
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

import surface_gym  # noqa: F401  registers the environments
from surface_gym.agents.evaluation.scenario import SEED
from surface_gym.goal_env import GoalEnv

PARK = "SmartSurface/Park-v0"
SCALE = (0.5, 0.2, 0.3, 0.5)  # [m, m, rad, m/s] of the numbers that a network sees
NEAR = (0.05, 0.05, 0.1, 0.1)
NEAREST = (0.01, 0.01, 0.03, 0.03)
STARTS = 200


class Remaining(BaseFeaturesExtractor):
    """Shows a network the difference between desired and achieved goal on three scales."""

    def __init__(self, space: gym.spaces.Dict) -> None:
        features, goals = (flatdim(space[name]) for name in ("observation", "desired_goal"))
        super().__init__(space, features + 3 * goals)

    def forward(self, seen: dict[str, torch.Tensor]) -> torch.Tensor:
        """Return features (num_envs, features) of observations with goals."""
        to_go = (seen["desired_goal"] - seen["achieved_goal"]).double()
        scaled = [to_go / to_go.new_tensor(each) for each in (SCALE, NEAR, NEAREST)]
        shown = [scaled[0], scaled[1].tanh(), scaled[2].tanh()]
        return torch.cat([seen["observation"], *(each.float() for each in shown)], dim=-1)


def make(**arguments: Any) -> gym.Env[Any, Any]:
    """Make Park as a goal environment."""
    return Monitor(GoalEnv(gym.make(PARK, actions="halves", **arguments)))


def learn(steps: int, seed: int) -> DQN:
    """Train for `steps` control periods with the sparse reward alone."""
    model = DQN(
        "MultiInputPolicy", make(), replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs={"n_sampled_goal": 4, "goal_selection_strategy": "final"},
        policy_kwargs={"features_extractor_class": Remaining, "net_arch": [128, 128]},
        learning_rate=1e-3, buffer_size=300_000, learning_starts=5_000, batch_size=512,
        train_freq=8, gradient_steps=2, gamma=0.98, tau=0.01, target_update_interval=1,
        exploration_fraction=0.4, exploration_final_eps=0.03, seed=seed,
    )  # fmt: skip
    return model.learn(steps)


def measure(model: DQN) -> dict[str, float]:
    """Return the success rate under two presets."""
    rates = {}
    for preset in ("exact", "lab"):
        env, successes = make(preset=preset), 0
        for k in range(STARTS):
            (seen, info), over = env.reset(seed=SEED + k), False
            while not over:
                action, _ = model.predict(seen, deterministic=True)
                seen, _, terminated, truncated, info = env.step(int(action))
                over = terminated or truncated
            successes += info["is_success"]
        rates[preset] = successes / STARTS
    return rates


if __name__ == "__main__":
    fresh_starts.run(learn, measure, 60_000, "stable_baselines3")
