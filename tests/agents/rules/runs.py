"""Runs of rules, one environment each, over starts, and on streams."""

from dataclasses import replace
from typing import Any

import numpy as np

import surface_gym as sg
from surface_gym.agents.base import Controller
from surface_gym.agents.rollout import Episodes, run_episodes
from surface_gym.agents.rules import RULES, Rule
from surface_gym.agents.scheduling.scheduler import begin_streams
from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.state import CORRECT, TOUCHES, WRONG
from surface_gym.flow.stream import Stream
from surface_gym.layouts import LINE_Y
from surface_gym.state import RUNNING
from surface_gym.tasks.paths import Sine
from tests.environments import CELLS
from tests.flow.flows import SHORT

# A kind of sensor for each task and kind of action, of which others compile the code too.
SENSORS = {(name.split("/")[1][:-3].lower(), actions): kind for name, actions, kind in CELLS}


def rule(task: str, name: str) -> Rule:
    return RULES.find(f"{task}: {name}")


def run(controller: Controller, config: EnvConfig, starts: list[dict[str, Any]]) -> Episodes:
    """Run one environment per start, each to the end of its episode, however slow."""
    patient = replace(config, task=replace(config.task, time_limit=300))
    return run_episodes(controller, patient, starts, seed=0)


def ends(episodes: Episodes) -> np.ndarray:
    """(starts, 3) poses at the ends."""
    return np.array([episodes.path(k)[-1] for k in range(len(episodes.success))])


def begun(
    task: Any, starts: list[dict[str, Any]], seed: int = 0, **settings: Any
) -> tuple[sg.SmartSurfaceVectorEnv, np.ndarray]:
    """Environments, one per start, and what they show there."""
    env = sg.SmartSurfaceVectorEnv(len(starts), task, autoreset_mode="SameStep", **settings)
    return env, env.reset(seed=seed, options=starts)[0]


class Scripted:
    """A controller that gives each environment a list of actions, one after the other."""

    def __init__(self, actions: Any) -> None:
        self._actions = actions

    def predict(self, _: Any, state: int | None = None, *__: Any, **___: Any) -> tuple[Any, int]:
        period = state or 0
        chosen = [actions[min(period, len(actions) - 1)] for actions in self._actions]
        return np.array(chosen), period + 1


def run_rule(task: str, name: str, starts: list[dict[str, Any]]) -> Episodes:
    chosen = rule(task, name)
    config = EnvConfig(task=task, actions=chosen.actions)
    return run(chosen.make(config), config, starts)


def assert_mirrored(
    controller: Controller, config: EnvConfig,
    starts: tuple[list[dict[str, Any]], list[dict[str, Any]]], most: float,
) -> None:  # fmt: skip
    """Starts and their mirror images end as mirror images do, to `most` [m]."""
    here, there = (run(controller, config, some) for some in starts)
    assert here.outcome == there.outcome
    image = ends(there) * [1.0, -1.0, -1.0] + [0.0, 2.0 * LINE_Y, 0.0]
    np.testing.assert_allclose(ends(here), image, rtol=0, atol=most)


def mirrored_starts(task: str) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Starts and their mirror images in the line's middle, for the tasks that have such."""
    waves = (Sine(0.12, 2.4, middle=1.03), Sine(-0.12, 2.4, middle=0.97))
    goals: dict[str, tuple[dict[str, Any], ...]] = {
        "sort": ({"side": 1}, {"side": -1}),
        "orient": ({"angle": 0.4}, {"angle": -0.4}),
        "track": ({"path": waves[0], "tilt": 0.23}, {"path": waves[1], "tilt": 0.23}),
    }
    speeds = (0.7, 0.9) if task == "track" else (1.4, 1.7)
    starts, images = (
        [{"speed": speed, "parcel": parcel, **goal} for speed in speeds for parcel in "SB"]
        for goal in goals[task]
    )
    return starts, images


EVERYBODY = Stream(Steady(2000.0), parcels=("S", "B"), speeds=1.5)


def line(stream: Stream = EVERYBODY, **config: Any) -> EnvConfig:
    """Of a short line with a chute on either side."""
    given = {"exits": "sides", "actions": "parcels", "duration": 6.0, "line": SHORT}
    return EnvConfig("flow", stream=stream, **{**given, **config})


def gated(stream: Stream = EVERYBODY, **config: Any) -> EnvConfig:
    return line(stream, **{"gate": True, **config})


def zoned(stream: Stream = EVERYBODY, **config: Any) -> EnvConfig:
    return gated(stream, **{"actions": "modules", **config})


def counts(controller: Any, config: EnvConfig, num_envs: int = 4) -> dict[str, int]:
    """Count the parcels of some episodes that left right and wrong, and touches of two."""
    batch, state = begin_streams(config, num_envs, 1), None
    while (batch.outcome == RUNNING).any():
        action, state = controller.predict(batch.observation, state)
        batch.step(config.action_kind.commands(action, num_envs))
    tally = batch.streams.tally.sum(axis=0)
    return {
        "right": int(tally[CORRECT]),
        "wrong": int(tally[WRONG]),
        "touches": int(tally[TOUCHES]),
    }
