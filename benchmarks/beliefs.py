"""Compare the planner on beliefs with each task's best rule and agent in the lab.

python -m benchmarks.beliefs --tasks stop slow --starts 40

All controllers get the same starts with the same random draws.
"""

import argparse
from typing import Any

import numpy as np

from surface_gym.agents.base import Numbers
from surface_gym.agents.datasets import find_best_rule
from surface_gym.agents.evaluation.method import BELIEF, Method, all_methods, start_benchmark
from surface_gym.agents.evaluation.results import half_interval, interval
from surface_gym.agents.evaluation.scenario import LAB, SEED, choose_starts
from surface_gym.agents.rollout import run_episodes, run_sequentially
from surface_gym.config import PRESETS

AGENT = "PPO, lab"


def play(method: Method, starts: int) -> Numbers:
    """Return the success (seeds, starts) of a method in the lab."""
    benchmark, preset = start_benchmark(method.task), PRESETS[LAB]
    config = method.config(benchmark.task, preset)
    chosen = choose_starts(benchmark, starts, preset)
    run = run_episodes if method.most is None else run_sequentially
    runs = [run(method.controller(config, k), config, chosen, SEED) for k in method.seeds]
    return np.array([each.success for each in runs], dtype=np.float64)


def main() -> None:
    """Print a table with a row for each task."""
    parser = argparse.ArgumentParser()
    tasks: Any = ("sort", "slow", "stop", "track", "orient")
    parser.add_argument("--tasks", nargs="+", default=tasks)
    parser.add_argument("--starts", type=int, default=40)
    asked = parser.parse_args()
    print(f"| success in the lab | {BELIEF} | best rule | difference | {AGENT} | difference |")
    print("|---|---:|---:|---:|---:|---:|")
    for task in asked.tasks:
        methods = {each.name: each for each in all_methods(task)}
        planned = play(methods[BELIEF], asked.starts)
        low, high = interval(planned > 0.5)
        row = [f"{planned.mean():.3f} ({low:.3f} to {high:.3f})"]
        for other in (find_best_rule(task), methods[AGENT]):
            success = play(other, asked.starts).mean(axis=0)
            more = planned[0] - success
            row += [f"{success.mean():.3f}", f"{more.mean():+.3f} ±{half_interval(more):.3f}"]
        print(f"| {task.capitalize()} | {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
