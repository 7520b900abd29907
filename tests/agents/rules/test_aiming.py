"""The rule for driven modules: every task, and what it refuses."""

import numpy as np
import pytest

from surface_gym.agents.rollout import run_episodes
from surface_gym.agents.rules.steering import AIMS, AimRule, towards
from surface_gym.config import EnvConfig
from surface_gym.modules import Belt, OmniModule, SteeredRoller

CREEPING = (0.0, 0.01, 0.03, 0.1, 0.3, 1.0)
SORTING = SteeredRoller(speeds=(1.0, 2.0))


def test_it_sorts_every_parcel_also_from_rest():
    config = EnvConfig("sort", actions="halves", modules=SORTING)
    starts = [{"speed": speed, "side": side} for speed in (0.0, 0.4, 2.5) for side in (1, -1)]
    assert run_episodes(AimRule(config), config, starts, 0).success.all()


# Each of these compiles a kernel.
@pytest.mark.parametrize(
    ("task", "modules", "least"),
    [
        ("stop", Belt(speeds=CREEPING), 1.0),
        ("slow", Belt(speeds=tuple(np.arange(0.0, 2.7, 0.02)), idle_outside=True), 0.7),
        ("orient", OmniModule(speeds=(0.0, 0.5, 1.0)), 0.9),
        ("track", OmniModule(speeds=(0.2, 0.4, 0.6, 0.8, 1.0, 1.2)), 1.0),
    ],
)
def test_it_serves_every_task(task, modules, least):
    assert AIMS[task].kinds
    config = EnvConfig(task, actions="halves", modules=modules)
    episodes = run_episodes(AimRule(config), config, [{}] * 24, 5)
    assert episodes.success.mean() >= least


def test_the_wanted_speed_near_a_place_can_be_braked():
    distance = np.array([-1.0, -0.001, 0.0, 0.001, 1.0])
    speed = towards(distance)
    np.testing.assert_allclose(speed, -speed[::-1])
    assert (speed**2 / (2.0 * 0.5 * 9.81) <= np.abs(distance) + 1e-12).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"task": "sort"}, "modules must be"),
        ({"task": "sort", "modules": "omni", "actions": "modules"}, "actions must be"),
        ({"task": "flow", "modules": "omni", "actions": "parcels"}, "task must be"),
    ],
)
def test_it_refuses_what_it_does_not_serve(arguments, message):
    with pytest.raises(ValueError, match=message):
        AimRule(EnvConfig(**{"actions": "halves", **arguments}))
