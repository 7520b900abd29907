"""Registries: names, places, plugins of other packages, and tasks of users."""

from importlib import metadata
from typing import Any

import gymnasium as gym
import pytest

import surface_gym as sg
from surface_gym import registry
from surface_gym.config import EnvConfig
from surface_gym.registration import TASKS, env_id
from surface_gym.registry import Registry
from surface_gym.tasks import Sort
from tests import own


@pytest.fixture
def plugins(monkeypatch):
    """Return a list of entry points that are found; none at first."""
    found: list[metadata.EntryPoint] = []
    monkeypatch.setattr(registry, "entry_points", lambda group: [*found] if group else [])
    registry.load_plugins.cache_clear()
    yield found
    registry.load_plugins.cache_clear()


def plugin(value: str) -> metadata.EntryPoint:
    return metadata.EntryPoint("mine", value, registry.GROUP)


@pytest.mark.usefixtures("plugins")
class TestNames:
    def test_values_come_in_the_order_of_registration(self):
        numbers: Registry[int] = Registry("number")
        assert numbers.register("two", 2) == numbers.register("one", 1) + 1
        assert (list(numbers), len(numbers), numbers["one"]) == (["two", "one"], 2, 1)
        assert numbers.find("two") == 2
        with pytest.raises(ValueError, match=r"^number must be one of 'two', 'one', got 'three'"):
            numbers.find("three")

    def test_a_name_is_one_values(self):
        numbers: Registry[Any] = Registry("number", imports={"pi": "math:pi"})
        numbers.register("one", 1)
        for name, what in (("one", "1"), ("pi", "3.14")):
            with pytest.raises(ValueError, match=f"of its own, got '{name}', which is {what}"):
                numbers.register(name, 2)
        assert numbers.register("one", 2, replace=True) == numbers["one"] == 2
        with pytest.raises(ValueError, match="of its own, got 'pi'"):
            numbers.register("pi", 3, replace=True)

    def test_a_place_is_imported_when_it_is_asked_for(self):
        places: Registry[Any] = Registry("place", imports={"bad": "no.such.module:it"})
        assert list(places) == ["bad"]
        assert "bad" in places
        with pytest.raises(ModuleNotFoundError, match="no"):
            places.find("bad")


class TestPlugins:
    def test_a_module_of_another_package_registers_what_it_has(
        self, plugins, tmp_path, monkeypatch
    ):
        (tmp_path / "plugin_of_tests.py").write_text(
            "from surface_gym.registration import register\n"
            "from tests.own import Cross\n"
            "register(Cross, 'Tests/Cross-v0')\n"
        )
        monkeypatch.syspath_prepend(tmp_path)
        plugins.append(plugin("plugin_of_tests"))
        monkeypatch.setattr(TASKS, "_complete", False)
        monkeypatch.setattr(TASKS, "_values", {**TASKS._values})
        monkeypatch.setitem(gym.registry, "Tests/Cross-v0", None)
        monkeypatch.delitem(gym.registry, "Tests/Cross-v0")
        assert EnvConfig("cross", far=1.5).task == own.Cross(far=1.5)
        assert gym.spec("Tests/Cross-v0").max_episode_steps == own.Cross.periods
        with pytest.raises(ValueError, match=r"'sequence'.* 'cross'.* got 'across'"):
            EnvConfig("across")

    def test_one_that_fails_is_left_out_with_a_warning(self, plugins):
        plugins.append(plugin("no_such_module_of_tests"))
        numbers: Registry[int] = Registry("number")
        with pytest.warns(RuntimeWarning, match="no_such_module_of_tests was left out: ModuleNot"):
            assert list(numbers) == []


class TestTasks:
    def test_a_users_task_goes_by_the_name_of_its_class(self, monkeypatch):
        monkeypatch.setattr(TASKS, "_values", {**TASKS._values})
        sg.register(own.Cross, "Tests/Named-v0")
        try:
            assert TASKS["cross"] is own.Cross
            assert env_id("cross") == "Tests/Named-v0"
            sg.register(type("Cross", (own.Cross,), {}), "Tests/Named-v0")  # its file, loaded again
            assert TASKS["cross"] is not own.Cross
            with pytest.raises(ValueError, match="task must have a name of its own, got 'cross'"):
                sg.register(own.Cross, "Tests/Other-v0")
        finally:
            del gym.registry["Tests/Named-v0"]

    def test_the_packages_tasks_stay(self):
        with pytest.raises(ValueError, match="task must have a name of its own, got 'sort'"):
            sg.register(type("Sort", (Sort,), {}), "Tests/Sort-v0")

    def test_a_subclass_goes_by_the_name_of_its_task(self):
        assert EnvConfig(own.Cross()).task_name == "cross"
        assert EnvConfig(type("Mine", (Sort,), {})()).task_name == "sort"
