"""Stable-Baselines3's PPO learns Sort from pictures alone: three grey frames and a small network.

pip install -c constraints.txt -e ".[agents]"
python examples/learners/pixels.py --seed 0
"""

import gymnasium as gym
import numpy as np
import torch
from fresh_starts import run
from gymnasium.vector import AutoresetMode
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor
from stable_baselines3.common.vec_env import VecFrameStack
from torch import Tensor, nn

import surface_gym as sg
from surface_gym.agents.vec_env import SurfaceVecEnv

IMAGE = sg.Image(height=16, width=32, area=(0.0, 2.2, 0.45, 1.55))  # the line, 69 mm per pixel
NUM_ENVS = 512


class SmallCnn(BaseFeaturesExtractor):
    """Two layers of convolution: NatureCNN, the default of CnnPolicy, takes ten times longer."""

    def __init__(self, observation_space: gym.spaces.Box, features_dim: int = 128) -> None:
        super().__init__(observation_space, features_dim)
        convolution = nn.Sequential(
            nn.Conv2d(observation_space.shape[0], 16, 5, stride=2), nn.ReLU(),
            nn.Conv2d(16, 32, 3, stride=2), nn.ReLU(), nn.Flatten(),
        )  # fmt: skip
        size = convolution(torch.zeros(1, *observation_space.shape)).shape[1]
        self.layers = nn.Sequential(convolution, nn.Linear(size, features_dim), nn.ReLU())

    def forward(self, pictures: Tensor) -> Tensor:
        """Return features (batch, features_dim) of pictures (batch, frames, height, width)."""
        return self.layers(pictures)


def make(num_envs: int) -> VecFrameStack:
    """Environments whose observation is the last three pictures, so that they show the velocity."""
    env = gym.make_vec(
        "SmartSurface/Sort-v0", num_envs, observe=IMAGE, actions="halves",
        autoreset_mode=AutoresetMode.SAME_STEP,
    )  # fmt: skip
    return VecFrameStack(SurfaceVecEnv(env), n_stack=3)


def sorted_share(model: PPO) -> dict[str, float]:
    """The share of the benchmark's starts that are sorted: even speeds, both boxes and sides."""
    speeds = np.arange(30, 271, 2) / 100.0
    starts = [
        {"speed": float(speed), "parcel": parcel, "side": side}
        for speed in speeds for parcel in "SB" for side in (1, -1)
    ]  # fmt: skip
    envs = make(len(starts))
    envs.seed(0)
    envs.set_options(starts)
    seen, won, ended = envs.reset(), np.zeros(len(starts), bool), np.zeros(len(starts), bool)
    while not ended.all():
        seen, _, dones, infos = envs.step(model.predict(seen, deterministic=True)[0])
        for i in np.nonzero(dones & ~ended)[0]:
            won[i] = infos[i]["is_success"]
        ended |= dones
    return {"success": round(float(won.mean()), 3)}


class Curve(BaseCallback):
    """Prints the share of sorted starts every 100 000 control periods."""

    def _on_step(self) -> bool:
        if self.num_timesteps % 100_000 < NUM_ENVS:
            print(f"{self.num_timesteps} periods: {sorted_share(self.model)}", flush=True)
        return True


def learn(steps: int, seed: int) -> PPO:
    """The model that so many control periods lead to; the learning rate falls to 0 over them."""
    torch.set_num_threads(1)  # the network is small
    network = {
        "features_extractor_class": SmallCnn, "net_arch": [64], "share_features_extractor": False,
    }  # fmt: skip
    model = PPO(
        "CnnPolicy", make(NUM_ENVS), n_steps=16, batch_size=1024, n_epochs=2, gae_lambda=0.9,
        ent_coef=0.005, learning_rate=lambda left: 1e-3 * left, seed=seed, device="cpu",
        policy_kwargs=network,
    )  # fmt: skip
    return model.learn(steps, callback=Curve())


if __name__ == "__main__":
    run(learn, sorted_share, 400_000, "stable_baselines3")
