"""Every rule, whatever its task."""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.agents.rules import ROLLING, RULES, Rule, find_rules
from surface_gym.agents.rules.sorting import EventRule, FixedLayout
from surface_gym.config import EnvConfig
from surface_gym.core.actions import KINDS
from surface_gym.layouts import LINE_Y
from surface_gym.sensors import Camera
from surface_gym.tasks import TASKS
from tests.agents.rules.runs import mirrored_starts, run

every_rule = pytest.mark.parametrize("rule", RULES, ids=lambda rule: f"{rule.task}: {rule.name}")


def config_for(rule: Rule, **others: Any) -> EnvConfig:
    return EnvConfig(task=rule.task, actions=rule.actions, **others)


def test_no_two_rules_of_a_task_share_a_name() -> None:
    names = [(rule.task, rule.name) for rule in RULES]
    assert len(set(names)) == len(names)
    for task in TASKS:
        assert find_rules(task)[0].name == "fixed layout"


@every_rule
def test_it_acts_inside_the_action_space(rule) -> None:
    """With a camera, in a shorter zone, less often, and with other axes on offer."""
    eight = tuple(math.pi / 2 - np.arange(8) * math.pi / 8)
    others = {"sensors": Camera(), "zone": (6, 15), "control_period": 0.1, "orientations": eight}
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
    config = config_for(rule)
    num_envs = 2
    env = sg.SmartSurfaceVectorEnv(
        num_envs,
        task=rule.task,
        actions=rule.actions,
        max_episode_steps=60,
        autoreset_mode="SameStep",
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


@every_rule
def test_what_it_remembers_ends_with_the_episode(rule) -> None:
    """Where an episode begins, it decides as it does with nothing to remember."""
    controller = rule.make(config_for(rule))
    env = sg.SmartSurfaceVectorEnv(2, task=rule.task, actions=rule.actions)
    observations, _ = env.reset(seed=1)
    state = None
    for _ in range(15):
        actions, state = controller.predict(observations, state=state)
        observations, *_ = env.step(actions)
    others, _ = env.reset(seed=2)
    without, _ = controller.predict(others)
    begun = np.array([True, False])
    with_old, _ = controller.predict(others, state=state, episode_start=begun)
    np.testing.assert_array_equal(with_old[begun], without[begun])


@pytest.mark.parametrize("task", ["slow", "stop", "orient"])
def test_a_fixed_layout_stays_as_it_was_arranged(task) -> None:
    (rule,) = (rule for rule in RULES if (rule.task, rule.name) == (task, "fixed layout"))
    controller = rule.make(config_for(rule))
    env = sg.SmartSurfaceVectorEnv(4, task=task)
    observations, _ = env.reset(seed=1)
    arranged, state = controller.predict(observations)
    assert len(np.unique(arranged, axis=0)) > 1
    for _ in range(10):
        observations, *_ = env.step(arranged)
        actions, state = controller.predict(observations, state=state)
        np.testing.assert_array_equal(actions, arranged)


@pytest.mark.parametrize(
    "rule",
    [
        rule
        for rule in RULES
        if rule.task in ("sort", "orient", "track") and rule.name != "sliding mode"
    ],
    ids=lambda rule: f"{rule.task}: {rule.name}",
)
def test_mirrored_starts_end_in_mirror_images(rule) -> None:
    config = config_for(rule)
    starts, images = mirrored_starts(rule.task)
    here, there = (run(rule.make(config), config, some) for some in (starts, images))
    assert here.outcome.tolist() == there.outcome.tolist()
    image = np.stack([there.pose[:, 0], 2.0 * LINE_Y - there.pose[:, 1], -there.pose[:, 2]], -1)
    np.testing.assert_allclose(here.pose, image, rtol=0, atol=1e-3)


@every_rule
def test_it_refuses_a_configuration_it_is_not_made_for(rule) -> None:
    other = "stop" if rule.task != "stop" else "slow"
    with pytest.raises(ValueError, match="task"):
        rule.make(EnvConfig(task=other, actions=rule.actions))
    with pytest.raises(ValueError, match="orientations"):
        rule.make(config_for(rule, orientations=(0.0, math.pi / 3)))


@pytest.mark.parametrize(
    "rule",
    [rule for rule in RULES if rule.make not in (FixedLayout, EventRule, ROLLING)],
    ids=lambda rule: f"{rule.task}: {rule.name}",
)
def test_a_rule_of_single_modules_refuses_other_kinds_of_action(rule) -> None:
    with pytest.raises(ValueError, match="actions"):
        rule.make(EnvConfig(task=rule.task, actions="quadrants"))
