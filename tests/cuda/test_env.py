""""""

import math

import numpy as np
import pytest
import torch

from surface_gym.config import EnvConfig
from surface_gym.cuda.env import TensorActions

LANES = 5
CPU = torch.device("cpu")
EVERY_KIND = [
    (kind, orientations)
    for kind in ("modules", "halves", "quadrants", "window")
    for orientations in (None, "any")
]


def kind_of(actions, orientations=None):
    return EnvConfig(actions=actions, orientations=orientations).action_kind


@pytest.mark.parametrize(("actions", "orientations"), EVERY_KIND)
def test_commands_are_those_of_the_cpu(actions, orientations):
    kind = kind_of(actions, orientations)
    space = kind.space()
    space.seed(0)
    given = np.array([space.sample() for _ in range(LANES)])
    tensor = TensorActions(space, LANES, CPU)
    commands = tensor.commands(torch.from_numpy(given))
    np.testing.assert_array_equal(commands, kind.commands(given, LANES))
    assert commands.dtype == (torch.float64 if orientations == "any" else torch.int64)
    assert not tensor.wrong


@pytest.mark.parametrize("bad", [-1, 16, 2**40])
def test_a_choice_that_is_none_is_noted_and_never_reaches_the_lane(bad):
    tensor = TensorActions(kind_of("halves").space(), LANES, CPU)
    actions = torch.full((LANES,), 5)
    actions[3] = bad
    commands = tensor.commands(actions)
    assert tensor.wrong
    assert commands.tolist() == [[1, 1]] * 3 + [[0, 0], [1, 1]]
    assert tensor.allowed == "0 and 15"


@pytest.mark.parametrize("bad", [math.nan, math.inf, 1.6, -1.6])
def test_an_angle_that_is_none_is_noted_and_never_reaches_the_lane(bad):
    tensor = TensorActions(kind_of("halves", "any").space(), LANES, CPU)
    commands = tensor.commands(torch.full((LANES, 2), bad))
    assert tensor.wrong
    assert (commands == 0.0).all()


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        (np.zeros(LANES, dtype=np.int64), "action must be a torch tensor on cpu, got"),
        (torch.zeros(LANES, dtype=torch.int64, device="meta"), "on cpu, got one on meta"),
        (torch.zeros(LANES + 1, dtype=torch.int64), r"shape \(\) a lane, got \(6,\)"),
        (torch.zeros(LANES), "whole numbers, got torch.float32"),
        (torch.zeros(LANES, dtype=torch.bool), "whole numbers, got torch.bool"),
    ],
)
def test_what_is_no_action_is_an_error_at_once(actions, message):
    with pytest.raises(ValueError, match=message):
        TensorActions(kind_of("halves").space(), LANES, CPU).commands(actions)


def test_whole_numbers_are_no_angles():
    with pytest.raises(ValueError, match=r"action must be angles, got torch\.int64"):
        TensorActions(kind_of("halves", "any").space(), LANES, CPU).commands(
            torch.zeros((LANES, 2), dtype=torch.int64)
        )
