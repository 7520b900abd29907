"""Tasks, rewards, sensors and plugins of your own: they run, and an error names what is wrong."""

import time
from importlib import metadata
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import surface_gym as sg
from surface_gym import registry
from surface_gym.config import EnvConfig
from surface_gym.registration import TASKS, env_id
from surface_gym.registry import Registry
from surface_gym.tasks import Sort
from tests import environments as te, own
from tests.environments import assert_same, by_pickle, played_out, run_python, steps, terms
from tests.test_vector_env import run_beside

ROOT = Path(__file__).parent.parent


class TestTask:
    def test_it_is_an_environment(self):
        env = sg.SmartSurfaceEnv(own.Cross(far=0.5), actions="quadrants")
        check_env(env, skip_render_check=True)
        played = played_out(env, [3, 3, 3, 3], speed=1.5, parcel="S")
        info, total = played[-1][4], sum(step[1] for step in played)
        assert (info["outcome"], info["is_success"]) == ("success", True)
        assert info["left"] < 0.0
        assert total == pytest.approx(info["pose"][0] - 0.3 + 1.0)

    def test_it_may_have_a_name(self):
        sg.register(own.Cross, "Tests/Cross-v0")
        try:
            env = gym.make("Tests/Cross-v0", task=own.Cross(far=2.0), actions="quadrants")
            assert env.spec is not None
            assert env.spec.max_episode_steps == own.Cross.periods
            assert env.reset(seed=0)[0][0] == pytest.approx(2.0)
        finally:
            del gym.registry["Tests/Cross-v0"]

    @pytest.mark.parametrize(
        "settings",
        [
            {"task": own.Cross(), "actions": "window", "sensors": own.Guess()},
            {"task": own.Assorted(far=0.1), "actions": "quadrants"},  # each with another parcel
        ],
        ids=["sensor", "parcels"],
    )
    def test_each_environment_is_a_single_env(self, settings):
        mode = AutoresetMode.NEXT_STEP
        one = te.native(max_episode_steps=te.LIMIT, threads=3, **settings)
        assert run_beside(one, te.singles(te.SORT, mode, **settings), mode, 40) >= te.NUM_ENVS

    def test_it_goes_on_after_a_pickle(self):
        env = sg.SmartSurfaceEnv(own.Cross(), actions="window", sensors=own.Guess())
        env.reset(seed=0)
        twin, action = by_pickle(env), env.action_space.sample()
        assert_same(env.step(action), twin.step(action))
        assert env.batch.parcels.sensor_state[0, 6] == env.config.timing.steps

    def test_drawing_it_needs_no_goal(self):
        env = sg.SmartSurfaceEnv(own.Cross(), actions="quadrants", render_mode="rgb_array")
        env.reset(seed=0)
        assert env.render().ndim == 3


class Doubled(Sort):
    terms = ("time",)

    @staticmethod
    @own.kernel_function
    def reward(state: own.EnvState, outcome: int) -> None:
        state.terms[0] = 2.0 * state.period


def test_a_reward_of_ones_own_changes_nothing_else():
    env, sort = (sg.SmartSurfaceEnv(task, actions="halves") for task in (Doubled(), "sort"))
    for one, other in zip(steps(env, seed=1), steps(sort, seed=1), strict=True):
        assert_same(one[0], other[0])
        assert one[2:4] == other[2:4]
        assert_same(one[4]["pose"], other[4]["pose"])
        assert terms(one[4]) == {"time": one[1]}
        assert one[1] == pytest.approx(0.08) or one[2]


class TestFaults:
    @pytest.mark.parametrize(("task", "message"), own.FAULTY)
    @pytest.mark.parametrize("num_envs", [1, 16])
    def test_they_are_named(self, task, message, num_envs):
        with pytest.raises(ValueError, match=message):
            run(task(), num_envs)
        # It hinders no other task, and no later one.
        assert np.isfinite(sg.SmartSurfaceEnv(own.Cross(), actions="quadrants").reset()[0]).all()

    def test_a_sensor_without_an_estimate_or_that_says_what_is_no_number(self):
        with pytest.raises(ValueError, match=r"Senseless\.read must be a static method"):
            sg.SmartSurfaceEnv(own.Cross(), sensors=own.Senseless())
        env = sg.SmartSurfaceEnv(own.Cross(), actions="window", sensors=own.Nonsense())
        with pytest.raises(ValueError, match="with Nonsense, must write finite features"):
            env.reset(seed=0)

    @pytest.mark.parametrize(
        ("groups", "message"),
        [
            ({"rotors": own.TWO}, "Grouped.groups must have names of their own, got 'rotors'"),
            ({"own": (own.TWO,)}, r"Grouped.groups\['own'\] must be a Group, got"),
            ({"own": own.TWO._replace(show=len)}, "Grouped.groups must show by kernel functions"),
            (
                {"own": own.TWO._replace(features=(Sort.features[3], own.TWO.features[0]))},
                f"features must have names that differ, got {Sort.features[3].name!r} twice",
            ),
        ],
    )
    def test_groups_of_a_sensor_that_cannot_be_shown(self, groups, message):
        with pytest.raises(ValueError, match=message):
            sg.SmartSurfaceEnv("sort", sensors=own.Grouped(groups), observe=("own",))

    def test_a_sensor_that_writes_more_features_than_it_names(self):
        one = {"own": own.TWO._replace(features=own.TWO.features[:1])}
        env = sg.SmartSurfaceEnv("sort", sensors=own.Grouped(one), observe=("own",))
        with pytest.raises(ValueError, match="must keep within their arrays"):
            env.reset(seed=0)

    def test_a_class_or_another_object_is_no_task(self):
        for task in (own.Cross, object(), None):
            with pytest.raises(ValueError, match="task must be one of sort"):
                sg.SmartSurfaceEnv(task)


def run(task: own.Cross, num_envs: int) -> None:
    env = sg.SmartSurfaceVectorEnv(num_envs, task, actions="quadrants", threads=2)
    env.reset(seed=0)
    env.step(env.action_space.sample())


OWN_FILE = """
import sys, numba
from pathlib import Path
import surface_gym as sg
from surface_gym.compiler import jit

made = []
save = jit._DigestCache.save_overload
def watched(cache, sig, data):
    made.append(cache.label)
    save(cache, sig, data)
jit._DigestCache.save_overload = watched

sys.path.insert(0, str(Path(__file__).parent))
from mine import Mine
env = sg.SmartSurfaceEnv(Mine(), actions="halves")
env.reset(seed=0)
print(round(env.step(0)[1], 6), sum("Mine" in label for label in made))
"""
MINE = """
from surface_gym.extend import EnvState, kernel_function
from surface_gym.tasks import Sort
from prices import PRICE, fee

class Mine(Sort):
    terms = ("price",)

    @staticmethod
    @kernel_function
    def reward(state: EnvState, outcome: int) -> None:
        state.terms[0] = PRICE + fee()
"""
PRICES = """
from surface_gym.extend import kernel_function
PRICE = 2.0
@kernel_function
def fee() -> float:
    return 0.5
"""


def test_the_cache_holds_and_notices_an_edit_of_a_users_file(tmp_path):
    (tmp_path / "main.py").write_text(OWN_FILE)
    (tmp_path / "mine.py").write_text(MINE)

    def reward_and_compilations(prices: str) -> list[str]:
        (tmp_path / "prices.py").write_text(prices)
        return run_python("-B", str(tmp_path / "main.py"), PYTHONPATH=str(ROOT)).split()

    # Whole milliseconds, so that the cache that all tests share holds no such price yet.
    price = time.time_ns() // 10**6
    prices = PRICES.replace("2.0", f"{price}.0")
    dearer = PRICES.replace("2.0", f"{price + 1}.0").replace("0.5", "0.25")
    assert reward_and_compilations(prices) == [f"{price}.5", "1"]
    assert reward_and_compilations(dearer) == [f"{price + 1}.25", "1"]
    assert reward_and_compilations(prices) == [f"{price}.5", "0"]


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
