"""Common parts of the learners in this folder: the command, and the success on fresh starts."""

import argparse
import os
import platform
import sys
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import yaml
from numpy.typing import NDArray

from surface_gym.tasks.sort import FEATURES, Sort

# From observations (num_envs, features) to actions of "halves".
Act = Callable[[NDArray[np.float32]], NDArray[Any]]

SIZE = [feature.name for feature in FEATURES].index("size")  # below 0 for the S-box
STARTS = {"as they come": Sort(), "0.3 to 2.7 m/s evenly": Sort(slow_share=0.0)}


def run(learn: Callable[..., Any], measure: Callable[[Any], Any], steps: int, *used: str) -> None:
    """Learn, measure, and print a report; `--keep FILE` also writes the report to a file.

    Args:
        learn: called with control periods and a seed; returns a policy.
        measure: called with the policy; returns figures.
        steps: control periods, the default of `--steps`.
        used: names of packages whose versions are reported.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("--steps", type=int, default=steps, help="control periods to learn from")
    parser.add_argument("--seed", type=int, default=0, help="seed of the starts and the network")
    parser.add_argument("--keep", type=Path, help="file that says how it went")
    asked = parser.parse_args()
    command, begun = " ".join(["python", *sys.argv]), time.perf_counter()
    learned = learn(asked.steps, asked.seed)
    of_run = {
        "command": command,
        "seconds": round(time.perf_counter() - begun),
        "cores": os.cpu_count(),
        "versions": {"python": platform.python_version()}
        | {name: version(name) for name in ("surface_gym", "gymnasium", "torch", *used)},
        "figures": measure(learned),
    }
    text = yaml.safe_dump(of_run, sort_keys=False)
    print(text, end="")
    if asked.keep is not None:
        asked.keep.write_text(text)


def success(act: Act, num_envs: int = 2000) -> dict[str, dict[str, float]]:
    """Return the success rate on Sort, on its usual starts and on starts with uniform speeds.

    Args:
        act: policy, from observations to actions.
        num_envs: number of starts of each kind, with one episode each.

    Returns:
        Success rate by kind of start, then by parcel: "S", "B" or "both".
    """
    shares = {}
    for name, task in STARTS.items():
        env = gym.make_vec("SmartSurface/Sort-v0", num_envs=num_envs, task=task, actions="halves")
        seen, _ = env.reset(seed=1_000_000)
        small = seen[:, SIZE] < 0.0
        won, ended = np.zeros((2, num_envs), np.bool_)
        while not ended.all():
            seen, _, terminated, truncated, info = env.step(act(seen))
            won |= ~ended & info["is_success"]
            ended |= terminated | truncated
        by_box = {"S": won[small], "B": won[~small], "both": won}.items()
        shares[name] = {box: round(float(each.mean()), 3) for box, each in by_box}
    return shares
