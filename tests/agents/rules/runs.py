"""Runs of rules, one environment each, over starts, and on streams."""

from dataclasses import dataclass
from typing import Any

import numpy as np

import surface_gym as sg
from surface_gym.agents.base import Controller
from surface_gym.agents.rules import RULES, Rule
from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import RIGHT, TOUCHES, WRONG
from surface_gym.flow.stream import Stream
from surface_gym.layouts import LINE_Y
from surface_gym.state import RUNNING
from surface_gym.tasks.paths import Sine
from tests.flow.flows import SHORT

LIMIT = 300  # control periods, as many as the longest task has


@dataclass(frozen=True, eq=False)
class Runs:
    """First episodes of some environments."""

    success: np.ndarray  # (num_envs,)
    outcome: np.ndarray  # (num_envs,)
    time: np.ndarray  # (num_envs,) [s]
    pose: np.ndarray  # (num_envs, 3) at the end
    velocity: np.ndarray  # (num_envs, 3) at the end
    metrics: dict[str, np.ndarray]  # the task's own, (num_envs,) each


def rule(task: str, name: str) -> Rule:
    """Find the rule of a task by name."""
    (found,) = (rule for rule in RULES if (rule.task, rule.name) == (task, name))
    return found


def run(controller: Controller, config: EnvConfig, starts: list[dict[str, Any]]) -> Runs:
    """Run one environment per start, each to the end of its episode."""
    num_envs = len(starts)
    env = sg.SmartSurfaceVectorEnv(
        num_envs,
        task=config.task,
        actions=config.actions,
        orientations=config.orientations,
        sensors=config.sensors,
        max_episode_steps=LIMIT,
        autoreset_mode="SameStep",
    )
    observation, info = env.reset(seed=0, options=starts)
    names = ("is_success", "outcome", "time", "pose", "velocity", *config.task.metrics)
    ends = {name: info[name].copy() for name in names}
    running, state, begun = np.ones(num_envs, dtype=bool), None, np.ones(num_envs, dtype=bool)
    while running.any():
        action, state = controller.predict(observation, state=state, episode_start=begun)
        observation, _, terminated, truncated, info = env.step(action)
        begun = terminated | truncated
        for name in names:
            ended = running & begun
            if ended.any():
                ends[name][ended] = info["final_info"][name][ended]
        running &= ~begun
    metrics = {name: ends[name] for name in config.task.metrics}
    return Runs(*(ends[name] for name in names[:5]), metrics)


def run_rule(task: str, name: str, starts: list[dict[str, Any]]) -> Runs:
    """Run a rule, found by task and name, over some starts."""
    chosen = rule(task, name)
    config = EnvConfig(task=task, actions=chosen.actions)
    return run(chosen.make(config), config, starts)


def assert_mirrored(
    controller: Controller,
    config: EnvConfig,
    starts: tuple[list[dict[str, Any]], list[dict[str, Any]]],
    most: float,
) -> None:
    """Starts and their mirror images end as mirror images do, to `most` [m]."""
    here, there = (run(controller, config, some) for some in starts)
    assert here.outcome.tolist() == there.outcome.tolist()
    image = np.stack([there.pose[:, 0], 2.0 * LINE_Y - there.pose[:, 1], -there.pose[:, 2]], -1)
    np.testing.assert_allclose(here.pose, image, rtol=0, atol=most)


def mirrored_starts(task: str) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Starts and their mirror images in the line's middle, for the tasks that have such."""
    shared = [
        {"speed": speed, "parcel": parcel}
        for speed in {"track": (0.7, 0.9)}.get(task, (1.4, 1.7))
        for parcel in "SB"
    ]
    goals: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
        "sort": ({"side": 1}, {"side": -1}),
        "orient": ({"angle": 0.4}, {"angle": -0.4}),
        "track": (
            {"path": Sine(0.12, 2.4, middle=1.03), "tilt": 0.23},
            {"path": Sine(-0.12, 2.4, middle=0.97), "tilt": 0.23},
        ),
    }
    first, second = goals[task]
    return [{**start, **first} for start in shared], [{**start, **second} for start in shared]


EVERYBODY = Stream(Steady(2000.0), parcels=("S", "B"), speeds=1.5)


def line(stream: Stream = EVERYBODY, **config: Any) -> EnvConfig:
    """Of a short line with a chute on either side."""
    given = {"exits": "sides", "actions": "parcels", "duration": 6.0, "line": SHORT}
    return EnvConfig("flow", stream=stream, **{**given, **config})


def gated(stream: Stream = EVERYBODY, **config: Any) -> EnvConfig:
    """The same with a gate."""
    return line(stream, **{"gate": True, **config})


def zoned(stream: Stream = EVERYBODY, **config: Any) -> EnvConfig:
    """The same with a gate and actions for modules."""
    return gated(stream, **{"actions": "modules", **config})


def counts(controller: Any, config: EnvConfig, num_envs: int = 4) -> dict[str, int]:
    """Count the parcels of some episodes that left right and wrong, and touches of two."""
    batch = StreamBatch(config, num_envs)
    for i in range(num_envs):
        batch.seed(i, np.random.default_rng((1, i)))
    batch.reset(np.arange(num_envs))
    state = None
    while (batch.outcome == RUNNING).any():
        action, state = controller.predict(batch.observation, state)
        batch.step(config.action_kind.commands(action, num_envs))
    tally = batch.streams.tally.sum(axis=0)
    return {"right": int(tally[RIGHT]), "wrong": int(tally[WRONG]), "touches": int(tally[TOUCHES])}
