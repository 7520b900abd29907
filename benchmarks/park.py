"""Compare controllers of Park on the same starts, with exact sensors and in the lab.

python -m benchmarks.park
python -m benchmarks.park --ppo runs/NAME
python -m benchmarks.park --presets lab --planned 0    # without the planner with the true state

The planner knows the true state and parameters, so starts from which it fails count as infeasible.
The planner on beliefs gets only observations.
"""

import argparse
from typing import Any

import numpy as np

from surface_gym.agents import library
from surface_gym.agents.evaluation.method import BELIEF, all_methods
from surface_gym.agents.evaluation.results import half_interval, wilson
from surface_gym.agents.evaluation.scenario import SEED
from surface_gym.agents.planning.planner import Oracle
from surface_gym.agents.rollout import run_episodes, run_sequentially
from surface_gym.agents.rules.base import RULES
from surface_gym.config import EnvConfig

Result = tuple[float, ...]  # success, distance [m], angle error [rad]


def play(controller: Any, config: EnvConfig, starts: int, run: Any = run_episodes) -> list[Result]:
    """Run an episode from each start; `run` is `run_episodes` or `run_sequentially`."""
    found = run(controller, config, [{}] * starts, SEED)
    distance, angle = (found.metrics[name] for name in config.task.metrics)
    return list(zip(found.success, distance, angle, strict=True))


def search(preset: str, starts: int) -> list[Result]:
    """Return the results of the planner with the true state, from each start."""
    oracle = Oracle(EnvConfig("park", preset=preset, actions="halves"))
    found = [oracle.find({}, SEED + k) for k in range(starts)]
    return [(each.success, *each.metrics) for each in found]


def show(name: str, preset: str, results: list[Result]) -> None:
    """Print a row of the table."""
    success, distance, angle = np.array(results).T
    middle, most = 1e3 * np.quantile(distance, (0.5, 0.9))
    turned = np.degrees(np.median(np.abs(angle)))
    row = f"{success.mean():.3f} of {len(results)} | {middle:.1f} | {most:.1f} | {turned:.2f}"
    print(f"| {name}, {preset} | {row} |", flush=True)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--ppo", help="folder of a run of `python train.py --task park`")
    parser.add_argument("--starts", type=int, default=128)
    parser.add_argument("--planned", type=int, default=40, help="starts of the planner")
    parser.add_argument("--presets", nargs="+", default=("exact", "lab"))
    asked = parser.parse_args()
    print("| controller | success | distance, median [mm] | 90 % [mm] | angle, median [deg] |")
    print("|---|---:|---:|---:|---:|")
    rules = [RULES.find(f"park: {name}") for name in ("fixed layout", "parking rule")]
    belief = next(each for each in all_methods("park") if each.name == BELIEF)
    for preset in asked.presets:
        found = {}
        for rule in rules:
            config = EnvConfig("park", preset=preset, actions=rule.actions, observe=rule.observe)
            found[rule.name] = play(rule.make(config), config, asked.starts)
            show(rule.name, preset, found[rule.name])
        if asked.ppo is not None:
            policy = library.read(asked.ppo)
            config = EnvConfig("park", **(policy.env_kwargs | {"preset": preset}))
            found["PPO"] = play(policy, config, asked.starts)
            show("PPO", preset, found["PPO"])
        config = EnvConfig("park", preset=preset, **belief.arguments)
        results = play(belief.controller(config, 0), config, asked.starts, run_sequentially)
        show(BELIEF, preset, results)
        low, high = wilson(float(np.mean([each[0] for each in results])), len(results))
        more = np.array([each[0] for each in results], dtype=float)
        more -= [each[0] for each in found[rules[-1].name]]
        print(
            f"{BELIEF}: {low:.3f} to {high:.3f}; more than {rules[-1].name} on the same starts: "
            f"{more.mean():+.3f} +-{half_interval(more):.3f}",
            flush=True,
        )
        found[BELIEF] = results
        if not asked.planned:
            continue
        planned = search(preset, asked.planned)
        show("planner", preset, planned)
        reached = [k for k, each in enumerate(planned) if each[0]]
        for name, results in found.items():
            share = np.mean([results[k][0] for k in reached])
            print(
                f"| {name}, of {len(reached)} starts that the planner reaches | {share:.3f} | | | |"
            )


if __name__ == "__main__":
    main()
