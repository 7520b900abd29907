"""Differences between episodes on a GPU and the same episodes on the CPU."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

NUM_ENVS = 10_000
CLOSE = 1e-8  # [m]


@dataclass(frozen=True)
class Agreement:
    """Differences between the episodes of two runs, with equal seeds and actions."""

    num_envs: int
    apart: int  # environments that end further apart than CLOSE
    other_outcomes: int  # environments with another outcome
    other_lengths: int  # environments whose episodes have another number of control periods
    median: float  # [m] distance between the ends
    largest: float  # [m] distance between the ends, among environments with equal outcomes


@dataclass(frozen=True, eq=False)
class Ends:
    """How the first episode of each environment ended."""

    position: NDArray[np.float64]  # (num_envs, 2) [m]
    outcome: NDArray[np.str_]  # (num_envs,)
    periods: NDArray[np.int64]  # (num_envs,)


def run_episodes(env: Any, actions: NDArray[np.int64], seed: int) -> Ends:
    """Run one episode of each environment.

    Args:
        env: vector environment on the CPU or on a device, with autoreset in the next step.
        actions: (control periods, num_envs) of "halves", for the longest possible episode.
        seed: seed of the first environment.

    Raises:
        ValueError: an episode has not ended.
    """
    num_envs = env.num_envs
    position, periods = np.zeros((num_envs, 2)), np.zeros(num_envs, dtype=np.int64)
    outcome = np.full(num_envs, "", dtype="U40")
    env.reset(seed=seed)
    for count, row in enumerate(actions, 1):
        given = torch.from_numpy(row).to(env.device) if hasattr(env, "device") else row
        _, _, terminated, truncated, infos = env.step(given)
        ended = (_to_host(terminated) | _to_host(truncated)) & (periods == 0)
        position[ended] = _to_host(infos["pose"])[ended, :2]
        outcome[ended] = _outcome_names(env, infos["outcome"])[ended]
        periods[ended] = count
        if periods.all():
            return Ends(position, outcome, periods)
    raise ValueError(
        f"actions must be of as many control periods as an episode may have, got {len(actions)}: "
        f"{int((periods == 0).sum())} environments have not ended"
    )


def compare(one: Ends, other: Ends) -> Agreement:
    """Count the differences between two runs of the same environments."""
    distance = np.hypot(*(one.position - other.position).T)
    same = one.outcome == other.outcome
    return Agreement(
        len(distance),
        int((distance > CLOSE).sum()),
        int((~same).sum()),
        int((one.periods != other.periods).sum()),
        float(np.median(distance)),
        float(distance[same].max(initial=0.0)),
    )


def measure_agreement(device_env: Any, host_env: Any, periods: int) -> Agreement:
    """Run two vector environments with equal seeds and random "halves", and compare their ends.

    Args:
        periods: maximum control periods of an episode.
    """
    choices = int(host_env.single_action_space.n)
    rng = np.random.default_rng(0)
    actions = rng.integers(0, choices, (periods, host_env.num_envs))
    return compare(run_episodes(device_env, actions, 0), run_episodes(host_env, actions, 0))


def _to_host(values: Any) -> NDArray[Any]:
    """Return a tensor or an array as an array."""
    numbers: NDArray[Any] = values.cpu().numpy() if torch.is_tensor(values) else values
    return numbers


def _outcome_names(env: Any, outcomes: Any) -> NDArray[Any]:
    """Return the names of outcomes (num_envs,), which are numbers on a device."""
    found = _to_host(outcomes)
    return np.array(env.outcomes)[found] if np.issubdtype(found.dtype, np.integer) else found
