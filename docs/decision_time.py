"""Time of one decision, for one parcel at a time: `python docs/decision_time.py`.

It is measured as in a control loop: one observation in, one action out, in one environment. Time on
the clock includes whatever else the machine does; the processor's time does not.
"""

import argparse
import statistics
from collections.abc import Sequence
from time import perf_counter, thread_time
from typing import Any

import gymnasium as gym
import numpy as np

from surface_gym import agents

ASIDE = 50  # decisions that are not counted: the first ones load and warm up


def decision_times(policy: Any, decisions: int) -> tuple[list[float], list[float]]:
    """Measure the time [s] of each decision, on the clock and of the processor, along episodes of
    the policy's environment.

    Args:
        policy: from `agents.load`.
        decisions: number to count.
    """
    env = gym.make(policy.env_id, **policy.env_kwargs)
    observation, _ = env.reset(seed=0)
    state, done = None, True
    on_clock, worked = [], []
    for _ in range(ASIDE + decisions):
        begun, since = thread_time(), perf_counter()
        action, state = policy.predict(observation, state, np.array([done]))
        on_clock.append(perf_counter() - since)
        worked.append(thread_time() - begun)
        observation, _, terminated, truncated, _ = env.step(action)
        done = terminated or truncated
        if done:
            observation, _ = env.reset()
    env.close()
    return on_clock[ASIDE:], worked[ASIDE:]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure agents that come with the package, and print a Markdown table."""
    parser = argparse.ArgumentParser(prog="python docs/decision_time.py", description=__doc__)
    parser.add_argument(
        "--agents",
        nargs="+",
        choices=agents.names(),
        default=agents.names(),
        metavar="NAME",
        help="agents to measure; by default all that come with the package",
    )
    parser.add_argument("--decisions", type=int, default=2000, help="to count, of each")
    given = parser.parse_args(arguments)
    print("| agent | clock, median [ms] | clock, 99 % [ms] | processor, 99 % [ms] |")
    print("|---|---:|---:|---:|")
    for name in given.agents:
        on_clock, worked = decision_times(agents.load(name), given.decisions)
        late, most = (statistics.quantiles(times, n=100)[-1] for times in (on_clock, worked))
        figures = " | ".join(
            f"{1e3 * time:.2f}" for time in (statistics.median(on_clock), late, most)
        )
        print(f"| `{name}` | {figures} |", flush=True)


if __name__ == "__main__":
    main()
