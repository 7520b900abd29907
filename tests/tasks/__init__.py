"""What the tests of tasks share: episodes played by hand, and starts made by hand."""

import math
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

import surface_gym as sg
from surface_gym.core.batch import Batch
from surface_gym.tasks import Task
from surface_gym.tasks.start import Draw, Start
from tests.environments import Step, bare, batch_with, same_choice

BRAKE = 0  # choice of the default orientations: the axis at 0 deg
ROLLING_LOSS = 0.01 * 9.81  # [m/s^2] of a parcel that rolls, mu_min g of Table 1


@dataclass(frozen=True)
class Episode:
    """An episode that was played until it ended."""

    start: dict[str, Any]  # info of the reset
    steps: list[Step]

    @property
    def end(self) -> dict[str, Any]:
        """Info of the last step."""
        return self.steps[-1][4]

    @property
    def infos(self) -> list[dict[str, Any]]:
        """Info of every step."""
        return [step[4] for step in self.steps]

    def total(self, term: str) -> float:
        """Sum of a reward term."""
        return math.fsum(info["reward_terms"][term] for info in self.infos)


def play(
    env: gym.Env, options: dict[str, Any], action: Any = None, seed: int = 0, longest: int = 1000
) -> Episode:
    """One episode of the same action throughout; without one, of random actions."""
    env.action_space.seed(seed)
    _, info = env.reset(seed=seed, options=options)
    done = []
    for _ in range(longest):
        done.append(env.step(env.action_space.sample() if action is None else action))
        if done[-1][2] or done[-1][3]:
            break
    return Episode(info, done)


def hold(env_id: str, choice: int, options: dict[str, Any], **settings: Any) -> Episode:
    """One episode with every axis at the same choice throughout."""
    env = bare(env_id, **settings)
    return play(env, options, same_choice(env, choice))


def placed(task: Task, start: Start) -> Batch:
    """A batch of one environment on which a start was put."""
    return batch_with(start, task=task)


def features_of(batch: Batch) -> dict[str, float]:
    """What the environment observes, by name."""
    names = [feature.name for feature in batch.task.features]
    return dict(zip(names, batch.parcels.observation[0].tolist(), strict=True))


def line_features(
    x: float, y: float, theta: float, vx: float, vy: float, omega: float
) -> dict[str, float]:
    """What all tasks but Track observe of an S-box whose centre is y [m] beside the line."""
    turn = 2.0 * math.pi / 0.1
    return {
        "lateral offset": y / 0.3,
        "sine of theta": math.sin(theta),
        "cosine of theta": math.cos(theta),
        "forward speed": vx - 1.0,
        "lateral speed": vy / 0.5,
        "turning speed": omega / 3.0,
        "size": -1.0,
        "sine of phase x": math.sin(turn * (x - 0.05)),
        "cosine of phase x": math.cos(turn * (x - 0.05)),
        "sine of phase y": math.sin(turn * y),
        "cosine of phase y": math.cos(turn * y),
    }


def advanced(batch: Batch, choice: int) -> tuple[str, dict[str, float]]:
    """Outcome and reward terms after a control period with every axis alike."""
    batch.step(np.full((1, batch.surfaces.command.shape[1]), choice))
    terms = dict(zip(batch.task.terms, batch.parcels.terms[0].tolist(), strict=True))
    return batch.outcomes[batch.parcels.outcome[0]], terms


def draws(
    task: Task, count: int = 400, seed: int = 0, zone: tuple[int, int] | None = None, **options: Any
) -> list[Start]:
    """Starts of a task, one by one."""
    numbers = np.random.default_rng(seed).random((count, task.draws))
    starts = task.start(Draw(numbers, [options] * count if options else (), task.line, zone))
    return [nth(starts, k, count) for k in range(count)]


def nth(starts: Start, k: int, count: int) -> Start:
    """One of some starts."""

    def each(values: Any) -> Any:
        return tuple(np.broadcast_to(value, count)[k] for value in values)

    parcels = starts.parcel
    return Start(
        parcels if isinstance(parcels, sg.Parcel) else parcels.kinds[parcels.which[k]],
        each(starts.pose),
        each(starts.velocity),
        each(starts.goal),
        *each([starts.tilt]),
        None if starts.path is None else starts.path[k],
    )


def assert_uniform(values: Any, low: float, high: float) -> None:
    """A few hundred values lie in [low, high], reach near both ends and halve it."""
    values = np.asarray(values)
    assert low <= values.min() <= low + 0.03 * (high - low)
    assert high - 0.03 * (high - low) <= values.max() <= high
    assert abs(values.mean() - 0.5 * (low + high)) <= 0.05 * (high - low)


def assert_equal_odds_of_the_boxes(starts: list[Start]) -> None:
    """Either box comes up about as often."""
    sizes = [sg.layouts.box(size) for size in "SB"]
    assert {start.parcel for start in starts} == set(sizes)
    share = np.mean([start.parcel == sizes[0] for start in starts])
    assert 0.42 < share < 0.58
