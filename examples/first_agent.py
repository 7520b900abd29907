"""Train PPO of Stable-Baselines3 on an environment, and count successful episodes.

python examples/first_agent.py --actions halves --steps 20000
python examples/first_agent.py --actions modules --policy GridPolicy --steps 20000
python examples/first_agent.py --env SmartSurface/Stop-v0 --num-envs 64 --steps 300000
"""

import argparse
from typing import Any

import gymnasium as gym
import torch
from stable_baselines3 import PPO

import surface_gym  # registers the environments
from surface_gym.agents import GridPolicy
from surface_gym.agents.vec_env import SurfaceVecEnv

EPISODES = 200
POLICIES = {"MlpPolicy": "MlpPolicy", "GridPolicy": GridPolicy}


def main() -> None:
    """Train, then evaluate on new starts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--env", default="SmartSurface/Sort-v0")
    parser.add_argument("--actions", default="halves")
    parser.add_argument("--policy", choices=POLICIES, default="MlpPolicy")
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--num-envs", type=int, default=1, help="above 1: compiled environments")
    parser.add_argument("--save", help="file for the model, e.g. runs/ppo-0.zip")
    options = parser.parse_args()
    torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
    env = gym.make(options.env, actions=options.actions)
    envs: Any = env
    rollout = {}
    if options.num_envs > 1:
        mode = gym.vector.AutoresetMode.SAME_STEP
        envs = SurfaceVecEnv(
            gym.make_vec(
                options.env, options.num_envs, actions=options.actions, autoreset_mode=mode
            )
        )
        rollout = {"n_steps": 4096 // options.num_envs, "batch_size": 1024}
    model = PPO(POLICIES[options.policy], envs, seed=options.seed, device="cpu", **rollout)
    model.learn(options.steps)
    if options.save is not None:
        model.save(options.save)
    successes = 0
    for episode in range(EPISODES):
        observation, info = env.reset(seed=1000 + episode)
        done = False
        while not done:
            action, _ = model.predict(observation, deterministic=True)
            observation, _, terminated, truncated, info = env.step(action)
            done = terminated or truncated
        successes += info["is_success"]
    print(f"surface_gym {surface_gym.__version__}: success in {successes} of {EPISODES} episodes")


if __name__ == "__main__":
    main()
