"""Train PPO of Stable-Baselines3 with one choice per module, on the native vector environment.

python examples/module_agent.py --env SmartSurface/Sort-v0 --steps 500000
"""

import argparse
import time

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO

from surface_gym.agents import GridPolicy  # also registers the environments
from surface_gym.agents.vec_env import SurfaceVecEnv

EPISODES = 200
NUM_ENVS = 64


def make_envs(env: str, num_envs: int) -> SurfaceVecEnv:
    """Make environments that Stable-Baselines3 takes."""
    mode = gym.vector.AutoresetMode.SAME_STEP
    return SurfaceVecEnv(gym.make_vec(env, num_envs=num_envs, autoreset_mode=mode))


def count_successes(model: PPO, env: str) -> int:
    """Count the successes of new episodes."""
    envs = make_envs(env, EPISODES)
    envs.seed(1000)
    observations = envs.reset()
    succeeded, ended = np.zeros(EPISODES, dtype=bool), np.zeros(EPISODES, dtype=bool)
    while not ended.all():
        actions, _ = model.predict(observations, deterministic=True)
        observations, _, dones, infos = envs.step(actions)
        for k in np.nonzero(dones & ~ended)[0]:
            succeeded[k] = infos[k]["is_success"]
        ended |= dones
    return int(succeeded.sum())


def main() -> None:
    """Train, then evaluate on new starts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--env", default="SmartSurface/Sort-v0")
    parser.add_argument("--steps", type=int, default=500_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    torch.set_num_threads(1)  # the network is small: more threads only wait for each other
    model = PPO(
        GridPolicy, make_envs(options.env, NUM_ENVS), seed=options.seed, device="cpu", n_steps=64,
        batch_size=1024, n_epochs=5, learning_rate=lambda left: 1e-3 * left, ent_coef=0.02,
    )  # fmt: skip
    began = time.perf_counter()
    model.learn(options.steps)
    seconds = time.perf_counter() - began
    successes = count_successes(model, options.env)
    print(f"{seconds:.0f} s of training: success in {successes} of {EPISODES} episodes")


if __name__ == "__main__":
    main()
