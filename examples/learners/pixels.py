"""Stable-Baselines3's PPO learns Sort from pictures alone: three grey frames, two small networks.

pip install -c constraints.txt -e ".[agents]"
python examples/learners/pixels.py --seed 0
"""

from typing import Any

import gymnasium as gym
import numpy as np
import torch
from fresh_starts import run
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecFrameStack
from torch import Tensor, nn

import surface_gym as sg
from surface_gym.agents.vec_env import SurfaceVecEnv

IMAGE = sg.Image(height=16, width=32, area=(0.0, 2.2, 0.45, 1.55))  # the line, 69 mm per pixel
EACH = [(k / 100.0, box, side) for k in range(30, 271, 2) for box in "SB" for side in (1, -1)]
STARTS = [dict(zip(("speed", "parcel", "side"), each, strict=True)) for each in EACH]
NUM_ENVS, CURVE = 512, 100_000  # control periods from point to point of the learning curve


class SmallCnn(BaseFeaturesExtractor):
    """Two convolutions, fewer than in NatureCNN, the default of CnnPolicy."""

    def __init__(self, observation_space: gym.spaces.Box, features_dim: int = 128) -> None:
        super().__init__(observation_space, features_dim)
        first = nn.Conv2d(observation_space.shape[0], 16, 5, stride=2)
        layers = nn.Sequential(first, nn.ReLU(), nn.Conv2d(16, 32, 3, stride=2), nn.ReLU())
        size = layers(torch.zeros(1, *observation_space.shape)).numel()
        self.layers = nn.Sequential(layers, nn.Flatten(), nn.Linear(size, features_dim), nn.ReLU())

    def forward(self, pictures: Tensor) -> Any:
        """Return features (batch, features_dim) of pictures (batch, frames, height, width)."""
        return self.layers(pictures)


def make(num_envs: int) -> Any:
    """Make environments that observe the last three pictures, which show the velocity."""
    mode: Any = {"observe": IMAGE, "actions": "halves", "autoreset_mode": AutoresetMode.SAME_STEP}
    envs: Any = gym.make_vec("SmartSurface/Sort-v0", num_envs, **mode)
    return VecFrameStack(SurfaceVecEnv(envs), 3)


def measure(model: PPO) -> dict[str, float]:
    """Return the success rate on the benchmark's starts."""
    envs = make(len(STARTS))
    envs.set_options(STARTS)
    seen, (won, ended) = envs.reset(), np.zeros((2, len(STARTS)), np.bool_)
    while not ended.all():
        seen, _, dones, infos = envs.step(model.predict(seen, deterministic=True)[0])
        won |= ~ended & np.array([info.get("is_success", False) for info in infos])
        ended |= dones
    return {"success": round(float(won.mean()), 3)}


def learn(steps: int, seed: int) -> PPO:
    """Train for `steps` control periods; return the model. The learning rate falls to 0."""

    def show(names: dict[str, Any], _: dict[str, Any]) -> bool:
        if (periods := names["self"].num_timesteps) % CURVE < NUM_ENVS:
            print(f"{periods} periods: {measure(names['self'])}", flush=True)
        return True

    torch.set_num_threads(1)
    network: Any = {"features_extractor_class": SmallCnn, "net_arch": [64]}
    network["share_features_extractor"] = False  # else errors of the value disturb the actions
    rollout: Any = {"n_steps": 16, "batch_size": 1024, "n_epochs": 2, "gae_lambda": 0.95}
    rollout |= {"learning_rate": lambda left: 2e-3 * left, "ent_coef": 0.005, "device": "cpu"}
    model = PPO("CnnPolicy", make(NUM_ENVS), policy_kwargs=network, seed=seed, **rollout)
    return model.learn(steps, show)


if __name__ == "__main__":
    run(learn, measure, 500_000, "stable_baselines3")
