"""How far lanes on a GPU end from the same lanes on the CPU."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

LANES = 10_000
CLOSE = 1e-8  # [m]


@dataclass(frozen=True)
class Agreement:
    """Two batches that were given the same seeds and actions, over an episode of each lane."""

    lanes: int
    apart: int  # lanes that end further apart than CLOSE
    other_outcomes: int  # lanes with another outcome
    other_lengths: int  # lanes whose episodes have another number of control periods
    median: float  # [m] distance between the ends
    largest: float  # [m] the same, of lanes with equal outcomes


@dataclass(frozen=True, eq=False)
class Ends:
    """How the first episode of each lane ended."""

    place: NDArray[np.float64]  # (lanes, 2) [m]
    outcome: NDArray[np.str_]  # (lanes,)
    periods: NDArray[np.int64]  # (lanes,)


def ends_of(env: Any, actions: NDArray[np.int64], seed: int) -> Ends:
    """Run the first episode of each lane.

    Args:
        env: of the CPU or of a device, with autoreset in the next step.
        actions: (control periods, lanes), of "halves"; no episode is longer.
        seed: of the first lane.

    Raises:
        ValueError: an episode has not ended.
    """
    lanes = env.num_envs
    place, periods = np.zeros((lanes, 2)), np.zeros(lanes, dtype=np.int64)
    outcome = np.full(lanes, "", dtype="U40")
    env.reset(seed=seed)
    for count, row in enumerate(actions, 1):
        given = torch.from_numpy(row).to(env.device) if hasattr(env, "device") else row
        _, _, terminated, truncated, infos = env.step(given)
        now = (_on_host(terminated) | _on_host(truncated)) & (periods == 0)
        place[now] = _on_host(infos["pose"])[now, :2]
        outcome[now] = _names(env, infos["outcome"])[now]
        periods[now] = count
        if periods.all():
            return Ends(place, outcome, periods)
    raise ValueError(
        f"actions must be of as many control periods as an episode may have, got {len(actions)}: "
        f"{int((periods == 0).sum())} lanes have not ended"
    )


def compare(one: Ends, other: Ends) -> Agreement:
    """How far two runs of the same lanes are apart."""
    distance = np.hypot(*(one.place - other.place).T)
    alike = one.outcome == other.outcome
    return Agreement(
        len(distance),
        int((distance > CLOSE).sum()),
        int((~alike).sum()),
        int((one.periods != other.periods).sum()),
        float(np.median(distance)),
        float(distance[alike].max(initial=0.0)),
    )


def agreement_of(device_env: Any, host_env: Any, periods: int, seed: int = 0) -> Agreement:
    """Give both the same seeds and random actions of "halves".

    Args:
        device_env: of tensors.
        host_env: of the CPU, with as many lanes.
        periods: an episode's limit.
        seed: of the first lane and of the actions.
    """
    choices = int(host_env.single_action_space.n)
    rng = np.random.default_rng(seed)
    actions = rng.integers(0, choices, (periods, host_env.num_envs))
    return compare(ends_of(device_env, actions, seed), ends_of(host_env, actions, seed))


def _on_host(values: Any) -> NDArray[Any]:
    numbers: NDArray[Any] = values.cpu().numpy() if torch.is_tensor(values) else values
    return numbers


def _names(env: Any, outcomes: Any) -> NDArray[Any]:
    """Outcomes by name: a device has numbers."""
    found = _on_host(outcomes)
    return np.array(env.outcomes)[found] if np.issubdtype(found.dtype, np.integer) else found
