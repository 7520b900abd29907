"""Every rule, whatever its task."""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.actions import KINDS
from surface_gym.agents.rules import ROLLING, Rule, find_rules
from surface_gym.agents.rules.sorting import EventRule, FixedLayout
from surface_gym.config import EnvConfig
from surface_gym.sensors import Exact
from surface_gym.tasks import TASKS
from tests.agents.rules.runs import SENSORS, assert_mirrored, mirrored_starts


def id_of(rule: Rule) -> str:
    return f"{rule.task}: {rule.name}"


EVERY = [rule for task in TASKS for rule in find_rules(task)]
every_rule = pytest.mark.parametrize("rule", EVERY, ids=id_of)


def config_for(rule: Rule, **others: Any) -> EnvConfig:
    return EnvConfig(task=rule.task, actions=rule.actions, **others)


def test_no_two_rules_of_a_task_share_a_name() -> None:
    names = [(rule.task, rule.name) for rule in EVERY]
    assert len(set(names)) == len(names)
    for task in TASKS:
        assert find_rules(task)[0].name == "fixed layout"


@every_rule
@pytest.mark.parametrize("sensor", [Exact, None], ids=["exact", "another"])
def test_it_acts_inside_the_action_space(rule, sensor) -> None:
    sensors = (sensor or SENSORS[rule.task, rule.actions])()
    eight = tuple(math.pi / 2 - np.arange(8) * math.pi / 8)
    others = {"sensors": sensors, "zone": (6, 15), "control_period": 0.1, "orientations": eight}
    controller, state = rule.make(config_for(rule, **others)), None
    env = sg.SmartSurfaceVectorEnv(2, task=rule.task, actions=rule.actions, **others)
    observations, _ = env.reset(seed=4)
    begun = np.ones(2, dtype=bool)
    for _ in range(30):
        actions, state = controller.predict(observations, state=state, episode_start=begun)
        assert env.action_space.contains(actions)
        observations, _, terminated, truncated, _ = env.step(actions)
        begun = terminated | truncated


@pytest.mark.parametrize("actions", KINDS)
@pytest.mark.parametrize(
    ("task", "make"), [("sort", FixedLayout), ("sort", EventRule), ("track", ROLLING)]
)
def test_what_sets_all_modules_alike_does_so_with_any_kind(task, make, actions) -> None:
    config = EnvConfig(task=task, actions=actions)
    env = sg.SmartSurfaceEnv(task=task, actions=actions)
    observation, _ = env.reset(seed=0)
    for _ in range(20):
        action, state = make(config).predict(observation)
        assert state is None
        assert env.action_space.contains(action)
        (command,) = config.action_kind.commands([action], 1)
        assert len(set(command.tolist())) == 1
        observation, _, terminated, _, _ = env.step(action)
        if terminated:
            break


@every_rule
def test_an_environment_alone_is_as_among_many(rule) -> None:
    config, num_envs = config_for(rule), 2
    env = sg.SmartSurfaceVectorEnv(
        num_envs, rule.task, actions=rule.actions, max_episode_steps=60, autoreset_mode="SameStep"
    )
    many, alone = rule.make(config), rule.make(config)
    observations, _ = env.reset(seed=20)
    state, states, begun = None, [None] * num_envs, np.ones(num_envs, dtype=bool)
    for _ in range(80):
        actions, state = many.predict(observations, state=state, episode_start=begun)
        for i in range(num_envs):
            # An empty state begins an episode.
            before = None if begun[i] else states[i]
            action, states[i] = alone.predict(observations[i], state=before)
            np.testing.assert_array_equal(action, actions[i])
        assert env.action_space.contains(actions)
        observations, _, terminated, truncated, _ = env.step(actions)
        begun = terminated | truncated


@pytest.mark.parametrize("task", ["slow", "stop", "orient"])
def test_a_fixed_layout_stays_as_it_was_arranged(task) -> None:
    (rule,) = (rule for rule in EVERY if (rule.task, rule.name) == (task, "fixed layout"))
    controller = rule.make(config_for(rule))
    env = sg.SmartSurfaceVectorEnv(4, task=task)
    observations, _ = env.reset(seed=1)
    arranged, state = controller.predict(observations)
    assert len(np.unique(arranged, axis=0)) > 1
    for _ in range(10):
        observations, *_ = env.step(arranged)
        actions, state = controller.predict(observations, state=state)
        np.testing.assert_array_equal(actions, arranged)


MIRRORED = [
    rule for rule in EVERY
    if rule.task in ("sort", "orient", "track") and rule.name != "sliding mode"
]  # fmt: skip


@pytest.mark.parametrize("rule", MIRRORED, ids=id_of)
def test_mirrored_starts_end_in_mirror_images(rule) -> None:
    config = config_for(rule)
    assert_mirrored(rule.make(config), config, mirrored_starts(rule.task), 1e-3)


@every_rule
def test_it_refuses_a_configuration_it_is_not_made_for(rule) -> None:
    other = "stop" if rule.task != "stop" else "slow"
    with pytest.raises(ValueError, match="task"):
        rule.make(EnvConfig(task=other, actions=rule.actions))
    with pytest.raises(ValueError, match="orientations"):
        rule.make(config_for(rule, orientations=(0.0, math.pi / 3)))
    if rule.make not in (FixedLayout, EventRule, ROLLING):
        others = "halves" if rule.actions == "quadrants" else "quadrants"
        with pytest.raises(ValueError, match="actions"):
            rule.make(EnvConfig(task=rule.task, actions=others))
