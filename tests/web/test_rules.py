"""Rules of one parcel act in the page as in Python: whole runs are the same to the bit."""

from typing import Any

import gymnasium as gym
import pytest

from surface_gym.agents.export.web import write_agents
from surface_gym.agents.rules import Rule, find_rules
from surface_gym.agents.rules.base import CompiledRule
from surface_gym.config import EnvConfig
from surface_gym.registration import env_id
from surface_gym.sensors import Camera, Exact
from surface_gym.tasks import TASKS
from surface_gym.web.scene import TaskScene
from tests.web.conftest import Site, end_in_page, end_in_python, wait_for

REACTING = [
    rule for task in TASKS for rule in find_rules(task)
    if isinstance(rule.make, type) and issubclass(rule.make, CompiledRule)
]  # fmt: skip
SEEDS = (0, 3)  # of 20


@pytest.fixture(scope="module")
def with_rules(site: Site) -> Site:
    """The site with the rules of all tasks."""
    site.add("sort", *{rule.task: None for rule in REACTING})
    write_agents(site.folder)
    return site


@pytest.fixture
def acting(with_rules: Site, play: Any) -> Any:
    """Open the playground at a scene in which a rule acts."""

    def opened(scene: TaskScene) -> Any:
        with_rules.add("sort", *([f"{scene.task}-camera"] if scene.camera else []))
        page = play(address=scene.url())
        wait_for(page, f"playground.shown[0].name === '{scene.agent}'")
        return page

    return opened


def check(page: Any, rule: Rule, sensors: Any) -> None:
    env = gym.make(env_id(rule.task), actions=rule.actions, sensors=sensors)
    agent = rule.make(EnvConfig(rule.task, actions=rule.actions, sensors=sensors))
    for seed in SEEDS:
        assert end_in_page(page, rule.name, seed) == end_in_python(env, agent, seed)


@pytest.mark.parametrize("rule", REACTING, ids=lambda rule: f"{rule.task}: {rule.name}")
def test_a_rule_runs_as_in_python(acting, rule):
    check(acting(TaskScene(rule.task, agent=rule.name)), rule, Exact())


@pytest.mark.parametrize("rule", REACTING, ids=lambda rule: f"{rule.task}: {rule.name}")
def test_a_rule_sees_by_a_camera_as_in_python(acting, rule):
    page = acting(TaskScene(rule.task, agent=rule.name, camera=True))
    check(page, rule, Camera())
