"""The arguments of an environment, checked once for both classes."""

import numpy as np
import pytest
from gymnasium import spaces

from surface_gym.config import EnvConfig
from surface_gym.lines import ORIENTATIONS
from surface_gym.randomisation import Actuators
from surface_gym.tasks import TASKS
from tests.environments import ACTIONS


@pytest.mark.parametrize("name", TASKS)
def test_a_task_goes_by_its_name_or_by_itself(name):
    assert EnvConfig(task=name) == EnvConfig(task=TASKS[name]())
    assert EnvConfig(task=name).task == TASKS[name]()


@pytest.mark.parametrize(
    ("period", "dt", "steps"),
    [
        (0.04, 0.005, 8), (0.005, 0.005, 1), (0.001, 0.001, 1), (0.012, 0.004, 3),
        (0.0051, 0.00255, 2), (1.0, 0.005, 200), (0.035, 0.005, 7),
    ],
)  # fmt: skip
def test_a_control_period_is_cut_into_equal_steps_of_at_most_5_ms(period, dt, steps):
    timing = EnvConfig(control_period=period).timing
    assert timing.steps == steps
    assert timing.dt == pytest.approx(dt, rel=1e-12)
    assert timing.dt * timing.steps == pytest.approx(period, rel=1e-15)


@pytest.mark.parametrize("actions", ACTIONS)
@pytest.mark.parametrize("name", TASKS)
def test_there_is_a_bound_for_each_feature(name, actions):
    features = EnvConfig(task=name, actions=actions).features
    space = EnvConfig(task=name, actions=actions).observation_space()
    np.testing.assert_array_equal(space.low, np.float32([feature.low for feature in features]))
    np.testing.assert_array_equal(space.high, np.float32([feature.high for feature in features]))
    assert space.dtype == np.float32
    assert (space.low < space.high).all()
    assert np.isfinite([space.low, space.high]).all()
    assert len({feature.name for feature in features} - {""}) == space.shape[0]


@pytest.mark.parametrize("name", TASKS)
def test_only_a_window_adds_its_occupancy(name):
    sizes = {kind: EnvConfig(task=name, actions=kind).observation_space().shape for kind in ACTIONS}
    (plain,) = sizes["modules"]
    assert sizes == {**dict.fromkeys(ACTIONS, (plain,)), "window": (plain + 25,)}


@pytest.mark.parametrize(
    ("actions", "space"),
    [
        ("modules", spaces.MultiDiscrete([4] * 4 * 16)),
        ("halves", spaces.Discrete(16)),
        ("quadrants", spaces.MultiDiscrete([4] * 4)),
        ("window", spaces.MultiDiscrete([4] * 25)),
    ],
)
def test_the_action_spaces_of_sort(actions, space):
    assert EnvConfig(actions=actions).action_space() == space


def test_two_or_more_orientations_may_be_offered_and_the_papers_are():
    np.testing.assert_allclose(np.degrees(ORIENTATIONS), [0, 45, -45, 90])
    for choices in (2, 8):
        angles = np.linspace(0.0, 3.0, choices)
        halves = EnvConfig(orientations=tuple(angles), actions="halves").action_space()
        assert halves == spaces.Discrete(choices**2)
        modules = EnvConfig(orientations=angles).action_space()
        assert modules == spaces.MultiDiscrete([choices] * 64)


def test_a_zone_sets_the_columns_of_modules():
    assert EnvConfig(zone=(5, 5)).action_space() == spaces.MultiDiscrete([4] * 4)
    assert EnvConfig(zone=[0, 29]).action_space() == spaces.MultiDiscrete([4] * 4 * 30)
    assert EnvConfig(zone=[3, 9]) == EnvConfig(zone=(3, 9))
    assert EnvConfig(actuators=Actuators(axis_speed=1.0)) != EnvConfig()
