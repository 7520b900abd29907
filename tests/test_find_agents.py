"""The package of agents by one name, in a checkout and once installed."""

import sys
from types import ModuleType

import pytest

import surface_gym as sg
from surface_gym import agents
from surface_gym.find_agents import agents_name, import_agents


def test_in_a_checkout_they_are_the_folder_beside() -> None:
    assert agents_name() == "agents"
    assert sg.agents is agents
    assert import_agents("planner").__name__ == "surface_gym.agents.planning.planner"


def test_another_name_is_none_of_the_packages() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'agent'"):
        _ = sg.agent


def test_another_package_of_that_name_is_not_taken_for_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    foreign = ModuleType("agents")
    foreign.__file__ = "/elsewhere/agents/__init__.py"
    monkeypatch.setitem(sys.modules, "agents", foreign)
    with pytest.raises(ImportError, match=r"got /elsewhere/agents/__init__\.py"):
        _ = sg.agents
