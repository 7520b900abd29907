"""Controllers are given what they cannot take: they say so, and nothing beyond arrays is read."""

import re
import subprocess
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pytest

from surface_gym.agents import library
from surface_gym.agents.base import Controller
from surface_gym.agents.rules import find_rules
from surface_gym.agents.rules.departures import HoldAndRelease, PassAndPark, TimeSlots
from surface_gym.agents.rules.patterns import Patterns, PatternsInOrder
from surface_gym.agents.rules.slopes import SlopeRule
from surface_gym.agents.rules.sorting import GradedLayout, SortEach, StreamEventRule
from surface_gym.agents.rules.velocities import VelocityRule
from surface_gym.config import EnvConfig
from surface_gym.tasks import TASKS

ON_SLOPES = [
    ("singulate", TimeSlots), ("singulate", HoldAndRelease), ("merge", TimeSlots),
    ("merge", HoldAndRelease), ("sequence", PassAndPark), ("merge", Patterns),
    ("sequence", PatternsInOrder),
]  # fmt: skip
ANY_ROWS = ("parcels", "local")  # learning algorithms of policies for any number of parcels


def _shipped(name: str) -> tuple[Controller, EnvConfig]:
    policy: Any = library.load(name)
    return policy, EnvConfig(policy.card.task, **policy.env_kwargs)


def _ruled(make: Callable[[EnvConfig], Controller], *args: Any, **named: Any) -> Any:
    config = EnvConfig(*args, **named)
    return make(config), config


MAKERS: dict[str, Callable[[], tuple[Any, EnvConfig]]] = {
    **{name: partial(_shipped, name) for name in library.names()},
    **{
        f"{rule.task}, {rule.name}": partial(_ruled, rule.make, rule.task, actions=rule.actions)
        for task in TASKS
        for rule in find_rules(task)
    },
    "any angle": partial(_ruled, GradedLayout, "sort", actions="modules", orientations="any"),
    **{
        f"{task}, {make.__name__}": partial(_ruled, make, task, actions=make.acts_by)
        for task, make in ON_SLOPES
    },
    "driven": partial(_ruled, VelocityRule, "singulate", actions="modules", modules="belt"),
    **{
        f"flow, {make.__name__}": partial(_ruled, make, "flow", actions="parcels")
        for make in (StreamEventRule, SortEach)
    },
}  # fmt: skip


@pytest.mark.parametrize("name", MAKERS)
def test_an_observation_of_another_environment_is_refused(name: str) -> None:
    """Each crashed the interpreter, or was read beyond its end, once."""
    controller, config = MAKERS[name]()
    shape = config.observation_space().shape
    wrong: list[Any] = [
        np.zeros((*shape[:-1], shape[-1] + 1)), np.zeros((*shape[:-1], shape[-1] - 1)),
        np.zeros((0, *shape)), np.zeros((1, 1, *shape)), np.zeros(()), [],
        np.zeros((*shape[:-1], 0)), np.full(shape, "a"), np.full(shape, None), None,
        np.full(shape, 1e300), np.full(shape, np.nan), np.zeros(shape, dtype=np.complex128),
    ]  # fmt: skip
    if len(shape) == 2 and not _takes_any_rows(controller):
        wrong += [np.zeros((shape[0] + 1, shape[1])), np.zeros((shape[0] - 1, shape[1]))]
    for each in wrong:
        with pytest.raises(ValueError, match=r"^observation must "):
            controller.predict(each)


def _takes_any_rows(controller: Any) -> bool:
    card = getattr(controller, "card", None)
    return isinstance(controller, SlopeRule) or (card is not None and card.algo in ANY_ROWS)


# Flow's policy tries its maneuvers first, and what searches plays every start: both take long.
REMEMBER = [name for name in MAKERS if "best" not in name and not name.startswith("flow-")]


@pytest.mark.parametrize("name", REMEMBER)
def test_what_is_remembered_of_other_environments_is_refused(name: str) -> None:
    controller, config = MAKERS[name]()
    shape = config.observation_space().shape
    actions, state = controller.predict(np.zeros((2, *shape), dtype=np.float32))
    listed = np.zeros((2, *shape), dtype=np.int64).tolist()
    np.testing.assert_array_equal(controller.predict(listed)[0], actions)
    if state is None:
        return
    three = np.zeros((3, *shape), dtype=np.float32)
    for wrong in (state, "state", (1, 2)):
        with pytest.raises(ValueError, match=r"^state"):
            controller.predict(three, wrong, np.zeros(3, dtype=np.bool_))
    said = re.escape("episode_start must have the shape (2,), got (3,)")
    with pytest.raises(ValueError, match=said):
        controller.predict(three[:2], state, np.zeros(3, dtype=np.bool_))


@pytest.mark.parametrize(("task", "make"), ON_SLOPES)
def test_rules_on_slopes_serve_any_number_of_rows(task: str, make: Any) -> None:
    config = EnvConfig(task, actions=make.acts_by)
    rng = np.random.default_rng(0)
    space = config.row_space()
    rows = rng.uniform(space.low, space.high, (6, len(space.low))).astype(np.float32)
    rows[:, 0] = 1.0
    many = np.zeros((3 * config.rows, rows.shape[1]), dtype=np.float32)
    many[:6] = rows
    few, _ = make(config).predict(rows)
    found, state = make(config).predict(many)
    np.testing.assert_array_equal(found[: few.size], few)
    with pytest.raises(ValueError, match=r"^state\.order must be int64 of the shape \(1, 6\)"):
        make(config).predict(rows, state)


# Every compiled function of the public modules, given wrong types, shapes and lists.
EXPORTED = """
import inspect
import numpy as np
import surface_gym
from surface_gym import agents, design, extend, layouts, lines, sensors, tasks
from surface_gym.compiler.jit import is_compiled
wrong = [
    None, "a", [1, 2], np.zeros(0), np.zeros((2, 2)), np.zeros(3, dtype=np.int64), 1e300, -1,
    object(),
]
count = 0
for module in (surface_gym, agents, design, extend, layouts, lines, sensors, tasks):
    for name in getattr(module, "__all__", dir(module)):
        function = getattr(module, name)
        if not is_compiled(function):
            continue
        count += 1
        for each in wrong:
            try:
                function(*[each] * len(inspect.signature(function.py_func).parameters))
            except Exception as error:
                assert str(error), name
            else:
                raise AssertionError(f"{name} takes {each!r}")
print(count)
"""


def test_exported_compiled_functions_refuse_what_they_cannot_take() -> None:
    """In a process of their own, which a read beyond an array would end by a signal."""
    done = subprocess.run([sys.executable, "-c", EXPORTED], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert int(done.stdout) >= 9
