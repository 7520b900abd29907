"""What the tests of tasks share: episodes played by hand, and starts made by hand."""

import math
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import surface_gym as sg
from surface_gym.config import REWARD
from surface_gym.tasks import Task
from surface_gym.tasks.start import Draw, Start
from tests.environments import Step, batch_with, same_choice

BRAKE = 0  # choice of the default orientations: the axis at 0 deg
ROLL_LOSS = 0.01 * 9.81  # [m/s^2] of a parcel that rolls, mu_min g of Table 1


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
        return math.fsum(info[REWARD + term] for info in self.infos)


def play(
    env: gym.Env, options: dict[str, Any], choice: Any = None, seed: int = 0, longest: int = 1000
) -> Episode:
    """One episode of random actions, with every axis at one choice, or of one action (an array)."""
    action = same_choice(env.unwrapped, choice) if isinstance(choice, int) else choice
    env.action_space.seed(seed)
    _, info = env.reset(seed=seed, options=options)
    done = []
    for _ in range(longest):
        done.append(env.step(env.action_space.sample() if choice is None else action))
        if done[-1][2] or done[-1][3]:
            break
    return Episode(info, done)


def features_of(task: Task, start: Start) -> dict[str, float]:
    """What an environment observes as a start begins, by name."""
    batch = batch_with(start, task=task)
    names = [feature.name for feature in task.features]
    return dict(zip(names, batch.parcels.observation[0].tolist(), strict=True))


def assert_observed(task: Task, start: Start, wanted: dict[str, float], side: int = 1) -> None:
    """What a task observes of an S-box on the line: what all tasks do, and what is wanted."""
    x, y, theta = start.pose * np.array([1.0, side, side]) - (0.0, side, 0.0)
    vx, vy, omega = start.velocity * np.array([1.0, side, side])
    turn = 2.0 * math.pi / 0.1
    common = {
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
    assert features_of(task, start) == pytest.approx(common | wanted, abs=1e-6)


def advanced(task: Task, start: Start, choice: int) -> tuple[str, dict[str, float]]:
    """Outcome and reward terms after a control period with every axis alike."""
    batch = batch_with(start, task=task)
    batch.step(np.full((1, batch.surfaces.command.shape[1]), choice))
    terms = dict(zip(batch.task.terms, batch.parcels.terms[0].tolist(), strict=True))
    return batch.outcomes[batch.parcels.outcome[0]], terms


def draws(
    task: Task, count: int = 400, seed: int = 0, zone: tuple[int, int] | None = None, **options: Any
) -> list[Start]:
    numbers = np.random.default_rng(seed).random((count, task.draws))
    starts = task.start(Draw(numbers, [options] * count if options else (), task.line, zone))
    return [nth(starts, k, count) for k in range(count)]


def nth(starts: Start, k: int, count: int) -> Start:
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


def assert_laws(starts: list[Start], *speeds: float) -> None:
    """Either box comes up about as often, at uniform speeds, straight along the line's middle."""
    sizes = [sg.layouts.box(size) for size in "SB"]
    assert {start.parcel for start in starts} == set(sizes)
    assert 0.42 < np.mean([start.parcel == sizes[0] for start in starts]) < 0.58
    if speeds:
        assert_uniform([math.hypot(*start.velocity[:2]) for start in starts], *speeds)
    for start in starts:
        if start.path is None:
            assert start.pose == (start.parcel.rear, 1.0, 0.0)
            assert start.velocity[1:] == (0.0, 0.0)
