"""Kinds of action: what an action says, part by part."""

import numpy as np
import pytest

from surface_gym.actions import ActionKind
from tests.environments import ACTIONS

ROWS, COLUMNS = 4, 3


def kind_of(name: str, choices: int = 4) -> ActionKind:
    return ActionKind(name, choices, ROWS, COLUMNS)


@pytest.mark.parametrize("name", ACTIONS)
@pytest.mark.parametrize("choices", [2, 4, 8])
class TestEveryKind:
    def test_commands_and_actions_say_the_same(self, name: str, choices: int) -> None:
        kind = kind_of(name, choices)
        space = kind.space()
        space.seed(0)
        actions = np.array([space.sample() for _ in range(50)])
        commands = kind.commands(actions, 50)
        assert commands.shape == (50, kind.size)
        assert commands.min() == 0
        assert commands.max() == choices - 1
        np.testing.assert_array_equal(kind.encode(commands), actions)

    def test_flipping_twice_is_nothing(self, name: str, choices: int) -> None:
        kind = kind_of(name, choices)
        commands = np.random.default_rng(0).integers(0, choices, (20, kind.size))
        flipped = kind.flip(commands)
        assert flipped.shape == commands.shape
        np.testing.assert_array_equal(kind.flip(flipped), commands)
        np.testing.assert_array_equal(np.sort(flipped), np.sort(commands))

    def test_flipping_leaves_the_callers_commands_alone(self, name: str, choices: int) -> None:
        kind = kind_of(name, choices)
        commands = np.arange(2 * kind.size).reshape(2, -1)
        kind.flip(commands)
        np.testing.assert_array_equal(commands, np.arange(2 * kind.size).reshape(2, -1))


def test_an_action_of_halves_is_front_and_rear() -> None:
    kind = kind_of("halves")
    assert kind.commands([0, 1, 4, 14, 15], 5).tolist() == [[0, 0], [0, 1], [1, 0], [3, 2], [3, 3]]


def test_flips_row_by_row() -> None:
    modules = np.arange(ROWS * COLUMNS)[np.newaxis]
    rows = kind_of("modules").flip(modules).reshape(ROWS, COLUMNS)
    np.testing.assert_array_equal(rows, modules.reshape(ROWS, COLUMNS)[::-1])
    window = np.arange(25)[np.newaxis]
    np.testing.assert_array_equal(
        kind_of("window").flip(window).reshape(5, 5), window.reshape(5, 5)[::-1]
    )


def test_flips_left_and_right_of_halves_and_quadrants() -> None:
    assert kind_of("halves").flip(np.array([[1, 2]])).tolist() == [[1, 2]]
    front_left, front_right, rear_left, rear_right = 0, 1, 2, 3
    given = np.array([[front_left, front_right, rear_left, rear_right]])
    wanted = [[front_right, front_left, rear_right, rear_left]]
    assert kind_of("quadrants").flip(given).tolist() == wanted


@pytest.mark.parametrize("name", ["fingers", "", None, 3, "Modules"])
def test_an_unknown_kind_is_named(name: object) -> None:
    with pytest.raises(ValueError, match="actions must be one of 'modules', 'halves'"):
        kind_of(name)
