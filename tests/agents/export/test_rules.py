"""What the page gets of rules of one parcel."""

import json
from pathlib import Path

import pytest

from surface_gym.agents.export import rules
from surface_gym.agents.rules import find_rules
from surface_gym.tasks import TASKS


@pytest.mark.parametrize("task", TASKS)
def test_every_rule_of_a_task_acts_in_the_page_unless_it_searches(task, tmp_path, monkeypatch):
    monkeypatch.setattr(rules, "write_machine", lambda code, *_: {"code": code})
    there = {**rules.write_rules(task, tmp_path), **rules.find_layouts(task, seeds=1)}
    wanted = {rule.name for rule in find_rules(task) if not rule.searches}
    # All modules at 90 deg, which is a layout of Track, are there of every task.
    assert wanted - set(there) == ({"fixed layout"} if task == "track" else set())


def test_a_card_says_which_numbers_are_others_with_a_camera(tmp_path: Path):
    rule = {each.name: each for each in find_rules("slow")}["braking rule"]
    card = json.loads(json.dumps(rules.write_rule(rule, tmp_path)))
    assert card == {
        "kind": "rule", "code": "agent-slow-braking-rule", "machine": "agent-slow-braking-rule",
        "camera": {"model.noise": 0.01},
    }  # fmt: skip
    layout = json.loads((tmp_path / f"{card['machine']}.json").read_text())
    assert layout["bytes"] == (tmp_path / f"{card['machine']}.bin").stat().st_size
    assert (tmp_path / f"{card['code']}.wasm").stat().st_size < 40_000
