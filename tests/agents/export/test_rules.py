"""What the page gets of rules of one parcel."""

import json

import pytest

from surface_gym.agents.export.rules import describe_rules
from surface_gym.agents.export.web import find_layouts
from surface_gym.agents.rules import RULES
from surface_gym.config import EnvConfig
from surface_gym.tasks import TASKS
from surface_gym.web.build import PAGE


@pytest.mark.parametrize("task", TASKS)
def test_every_rule_of_a_task_acts_in_the_page_unless_it_searches(task):
    there = set(describe_rules(task)) | set(find_layouts(task, seeds=1))
    rules = {rule.name for rule in RULES if rule.task == task and not rule.searches}
    # All modules at 90 deg, which is a layout of Track, are there of every task.
    assert rules - there == ({"fixed layout"} if task == "track" else set())


@pytest.mark.parametrize("task", TASKS)
def test_a_card_is_written_in_json_and_of_a_kind_that_the_page_knows(task):
    kinds = (PAGE / "rules.js").read_text().partition("const KINDS = {")[2].partition("}")[0]
    for card in json.loads(json.dumps(describe_rules(task))).values():
        assert f"  {card['kind']}: " in kinds
        assert card["features"] == [each.name for each in EnvConfig(task).features]
