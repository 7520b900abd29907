"""The world as it is: the same start as the environment's, and the same way from there."""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from agents.planning.known import KnownModel
from surface_gym.randomisation import Actuators
from surface_gym.settings import Settings
from surface_gym.tasks import TASKS

SEED = 31
SLOW_AXES = Actuators(axis_speed=0.5 * math.pi / 0.1, stuck=((9, 8), (10, 11)))


def begun(settings: Settings, lanes: int = 4, options: dict[str, Any] | None = None) -> KnownModel:
    model = KnownModel(settings, lanes)
    model.begin(options or {}, SEED)
    return model


@pytest.mark.parametrize("task", TASKS)
def test_in_a_lab_it_is_the_start_of_the_environment_with_all_its_noise(task: str) -> None:
    model = begun(Settings(task=task, actions="halves", condition="lab"))
    env = sg.SmartSurfaceVectorEnv(3, task=task, actions="halves", condition="lab")
    for lane in range(3):
        model.begin({}, SEED + lane)
        _, info = env.reset(seed=SEED)
        np.testing.assert_array_equal(model.parcels.truth[0, :3], info["pose"][lane])
        np.testing.assert_array_equal(model.parcels.truth[0, 3:], info["velocity"][lane])


@pytest.mark.parametrize("task", ["slow", "track"])
def test_whatever_the_sensors_say_it_moves_as_the_environment_does(task: str) -> None:
    """Where both halves are told the same, it does not matter where one is seen to begin: parcel,
    friction, stuck modules and axes are the environment's.
    """
    settings = Settings(task=task, actions="halves", condition="lab")
    model = begun(settings)
    env = sg.SmartSurfaceEnv(task=task, actions="halves", condition="lab")
    env.reset(seed=SEED)
    for angle in (0.5, 0.25, -0.25, 0.5, 0.0, -0.25):
        action = model.uniform_action(math.pi * angle)
        model.go_on(action)
        *_, info = env.step(action)
        np.testing.assert_array_equal(model.parcels.truth[0, :3], info["pose"])
        np.testing.assert_array_equal(model.parcels.truth[0, 3:], info["velocity"])


def test_what_an_option_fixes_is_fixed() -> None:
    model = begun(Settings(task="stop", actions="halves"), options={"speed": 1.25, "position": 1.5})
    np.testing.assert_allclose(model.parcels.truth[:, 3], 1.25)
    np.testing.assert_allclose(model.parcels.goal[:, 0], 1.5)


def test_lanes_that_go_on_from_others_take_their_axes_with_them() -> None:
    """Each of three ends where an environment of its own does that was told the same."""
    settings = Settings(task="orient", actions="halves", actuators=SLOW_AXES)
    ways = np.array([[15, 6, 2, 15, 9, 9], [15, 6, 13, 1, 9, 4], [15, 3, 7, 8, 4, 2]])
    model = begun(settings)
    place = np.zeros(3, dtype=np.int64)  # of the lane that goes each way
    orders = [[0, 1, 2], [2, 0, 1], [1, 2, 0], [2, 1, 0], [1, 0, 2], [0, 2, 1]]
    for period, order in enumerate(orders):
        parents, actions = np.empty((2, 3), dtype=np.int64)
        parents[order], actions[order] = place, ways[:, period]
        stand = model.advance(parents, actions)
        place = np.array(order)
    for way in range(3):
        env = sg.SmartSurfaceEnv(task="orient", actions="halves", actuators=SLOW_AXES)
        env.reset(seed=SEED)
        for action in ways[way].tolist():
            *_, info = env.step(action)
        np.testing.assert_array_equal(stand.parcels.truth[place[way], :3], info["pose"])


def test_rewound_it_goes_the_same_way_again() -> None:
    model = begun(Settings(task="slow", actions="halves", condition="lab"))
    model.go_on(6)
    ends = []
    for _ in range(2):
        model.rewind()
        first = np.zeros(1, dtype=np.int64)
        stand = model.advance(first, np.array([9]))
        stand = model.advance(first, np.array([2]))
        ends.append(stand.parcels.truth[0].copy())
    np.testing.assert_array_equal(*ends)


def test_another_start_forgets_what_was_stuck_before() -> None:
    settings = Settings(task="slow", actions="halves", actuators=Actuators(stuck_share=0.2))
    used, fresh = KnownModel(settings, 3), KnownModel(settings, 3)
    for seed in (1, 2):
        used.begin({}, seed)
        for action in (0, 5):
            used.go_on(action)
    fresh.begin({}, 7)
    used.begin({}, 7)
    for action in (0, 5, 10, 0, 3, 12, 0, 0, 15, 6):
        stands = [model.go_on(action) for model in (used, fresh)]
    np.testing.assert_array_equal(stands[0].lanes.truth, stands[1].lanes.truth)
