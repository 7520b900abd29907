"""Train an entry of the benchmark: PPO of Stable-Baselines3, 1 M control periods, exact sensors.

python examples/entries/sb3_ppo.py  # all tasks of one parcel, seeds 0 to 4
surface-gym benchmark --policy "runs/ppo-1m-{task}-{seed}.zip" --actions halves --seeds 0 1 2 3 4
"""

import argparse
from dataclasses import asdict
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import gymnasium as gym
import torch
from stable_baselines3 import PPO

from surface_gym.agents.benchmark.cli import SINGLES
from surface_gym.agents.learning.config import defaults
from surface_gym.agents.vec_env import SurfaceVecEnv
from surface_gym.parallel import map_jobs, usable_cores
from surface_gym.registration import env_id

BUDGET = 1_000_000  # control periods
GIVEN = ("n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "ent_coef")
FOLDER = Path("runs")


def train(task: str, seed: int, _: Any = None) -> float:
    """Train with the hyper-parameters that `train.py` has for the task; return the duration [s]."""
    torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
    chosen = asdict(defaults(task, "ppo"))
    num_envs, rate = chosen["num_envs"], chosen["learning_rate"]
    mode = gym.vector.AutoresetMode.SAME_STEP
    envs: Any = gym.make_vec(env_id(task), num_envs, actions="halves", autoreset_mode=mode)
    model = PPO(
        "MlpPolicy", SurfaceVecEnv(envs), learning_rate=lambda left: rate * left, seed=seed,
        policy_kwargs={"net_arch": list(chosen["hidden"])}, device="cpu",
        **{name: chosen[name] for name in GIVEN},
    )  # fmt: skip
    began, rollout = perf_counter(), num_envs * chosen["n_steps"]
    model.learn(BUDGET // rollout * rollout)
    model.save(FOLDER / f"ppo-1m-{task}-{seed}.zip")
    return perf_counter() - began


def main() -> None:
    """Train on each task with all seeds."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", nargs="+", choices=SINGLES, default=SINGLES)
    parser.add_argument("--seeds", nargs="+", type=int, default=range(5))
    parser.add_argument("--workers", type=int, default=usable_cores())
    asked = parser.parse_args()
    runs = [(task, seed) for task in asked.tasks for seed in asked.seeds]
    jobs = [partial(train, *run) for run in runs]
    for place, seconds in map_jobs(jobs, asked.workers):
        task, seed = runs[place]
        print(f"{task}, seed {seed}: {seconds:.0f} s", flush=True)


if __name__ == "__main__":
    main()
