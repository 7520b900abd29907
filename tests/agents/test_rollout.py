"""Episodes: those of a single environment stepped by hand, to the bit."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from surface_gym.agents.rollout import run_episodes, run_sequentially
from surface_gym.agents.rules import find_rules
from surface_gym.config import EnvConfig
from surface_gym.registration import env_id
from surface_gym.tasks import TASKS
from tests.agents.rules.runs import SENSORS

ONE_A_TASK = {rule.task: rule for task in TASKS for rule in find_rules(task)}


@pytest.mark.parametrize("rule", ONE_A_TASK.values(), ids=ONE_A_TASK)
def test_they_are_a_single_environments(rule) -> None:
    sensors = SENSORS[rule.task, rule.actions]()
    config = EnvConfig(task=rule.task, actions=rule.actions, sensors=sensors)
    starts = [{"parcel": "S"}, {}, {"parcel": "B"}]
    found = run_episodes(rule.make(config), config, starts, seed=30)
    for k, start in enumerate(starts):
        env, controller = gym.make(env_id(rule.task), **config.arguments()), rule.make(config)
        observation, info = env.reset(seed=30 + k, options=start)
        poses, over, state = [info["pose"]], False, None
        while not over:
            begun = np.array([len(poses) == 1])
            action, state = controller.predict(observation[np.newaxis], state, begun)
            observation, _, terminated, truncated, info = env.step(action[0])
            poses.append(info["pose"])
            over = terminated or truncated
        np.testing.assert_array_equal(found.path(k), poses)
        np.testing.assert_array_equal(found.velocity[k], info["velocity"])
        assert (found.success[k], found.time[k]) == (info["is_success"], info["time"])
        assert found.outcome[k] in (info["outcome"], "out of time")
        for name, values in found.metrics.items():
            assert values[k] == info[name]


def test_one_after_the_other_they_are_the_same() -> None:
    config = EnvConfig(task="slow", actions="modules")
    rule = ONE_A_TASK["slow"]
    starts = [{"parcel": "S"}, {"parcel": "B"}, {}]
    together = run_episodes(rule.make(config), config, starts, seed=3)
    apart = run_sequentially(rule.make(config), config, starts, seed=3)
    np.testing.assert_array_equal(together.pose, apart.pose)
    np.testing.assert_array_equal(together.success, apart.success)
    np.testing.assert_array_equal(together.metrics["ratio_error"], apart.metrics["ratio_error"])
    assert together.outcome == apart.outcome


@pytest.mark.parametrize("run", [run_episodes, run_sequentially])
def test_a_decisions_time_is_the_usual_one(run, monkeypatch) -> None:
    config = EnvConfig(task="slow", actions="modules")
    rule = ONE_A_TASK["slow"].make(config)
    clock = [0.0]

    class SlowAtFirst:
        def predict(self, *arguments: Any, **options: Any) -> tuple[Any, Any]:
            clock[0] += 0.5 if clock[0] else 30.0
            return rule.predict(*arguments, **options)

    monkeypatch.setattr("surface_gym.agents.rollout.time.perf_counter", lambda: clock[0])
    found = run(SlowAtFirst(), config, [{"parcel": "S"}] * 3, seed=3)
    num_envs = 3 if run is run_episodes else 1
    assert found.decision_time == 0.5 / num_envs
