"""Kinds of modules: their modes and mirror images, and environments with driven ones."""

import math

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode

import surface_gym as sg
from surface_gym.modules import (
    ANGLE,
    DRIVEN,
    MODULES,
    Belt,
    OmniModule,
    SteeredRoller,
    surface_velocities,
)
from surface_gym.registration import TASKS
from tests import environments as te
from tests.test_vector_env import run_beside

ORIENTATIONS = sg.lines.ORIENTATIONS
DRIVEN_KINDS = [name for name, module in MODULES.items() if module.drives]


@pytest.mark.parametrize("name", MODULES)
class TestKinds:
    def test_without_a_command_they_convey_towards_x(self, name):
        module = MODULES[name]
        modes = module.modes(ORIENTATIONS)
        conveyed = surface_velocities(modes)[-1]
        assert modes[-1, ANGLE] == pytest.approx(math.pi / 2)
        assert conveyed == pytest.approx([module.speeds[-1] if module.drives else 0.0, 0.0])
        assert (modes[:, DRIVEN] == module.drives).all()

    def test_choices_differ_and_have_images(self, name):
        module = MODULES[name]
        modes = module.modes(ORIENTATIONS)[:-1]
        assert len(np.unique(modes.round(6), axis=0)) == len(modes)
        images = module.images(ORIENTATIONS)
        np.testing.assert_array_equal(images[images], np.arange(len(modes)))
        mirrored = surface_velocities(modes) * [1.0, -1.0]
        np.testing.assert_allclose(surface_velocities(modes)[images], mirrored, atol=1e-12)

    def test_the_vector_environment_is_the_single_one(self, name):
        settings, mode = {"modules": name, "actions": "halves"}, AutoresetMode.NEXT_STEP
        one = te.native(max_episode_steps=te.LIMIT, **settings)
        run_beside(one, te.singles(te.SORT, mode, **settings), mode, 8)


@pytest.mark.parametrize("name", DRIVEN_KINDS)
@pytest.mark.parametrize("task", TASKS)
def test_gymnasiums_checker_has_nothing_to_say(task, name):
    actions = "parcels" if TASKS[task].is_stream else "halves"
    more = {"duration": 2.0} if TASKS[task].is_stream else {}
    env = sg.SmartSurfaceEnv(task, actions=actions, modules=name, **more)
    check_env(env, skip_render_check=True)
    env.reset(seed=1)
    for _ in range(25):
        *_, terminated, truncated, info = env.step(env.action_space.sample())
        assert info["outcome"] != "stalled"
        if terminated or truncated:
            break


def test_a_steered_roller_turns_and_ramps():
    roller = SteeredRoller(acceleration=5.0, speeds=(0.0, 1.0))
    actuators = sg.Actuators(axis_speed=math.radians(900.0))
    env = sg.SmartSurfaceEnv("sort", actions="halves", modules=roller, actuators=actuators)
    env.reset(seed=0, options={"speed": 1.0, "parcel": "S", "side": 1})
    to_left, choices = 3, env.config.choices
    env.step(to_left * choices + to_left)
    batch, (row, column) = env.batch, np.argwhere(env.batch.bodies.obeys[0])[0]
    axis = batch.surfaces.axis[0, row, column]
    # From 90 deg towards 180 deg at 900 deg/s for 40 ms.
    assert math.degrees(batch.surfaces.angle[0, row, column]) == pytest.approx(126.0)
    env.step((choices - 1) * choices + choices - 1)  # a stop
    assert np.hypot(*batch.surfaces.drive[0, axis, :2]) == pytest.approx(1.0 - 5.0 * 0.04)


@pytest.mark.parametrize("name", ["steered", "omni", "popup"])
def test_a_parcel_at_rest_is_sorted(name):
    env = gym.make("SmartSurface/Sort-v0", actions="halves", modules=name)
    config = env.unwrapped.config
    way = surface_velocities(config.modes[:-1])
    left = int(np.argmax(way[:, 1] - np.abs(way[:, 0])))
    for side, choice in ((1, left), (-1, int(config.images[left]))):
        env.reset(options={"speed": 0.0, "side": side, "parcel": "S"})
        ended = False
        while not ended:
            *_, terminated, truncated, info = env.step(choice * config.choices + choice)
            ended = terminated or truncated
        assert (info["outcome"], terminated) == ("success", True)


def test_a_belt_brings_a_parcel_back_to_the_asked_place():
    env = sg.SmartSurfaceEnv("stop", actions="halves", modules=Belt(speeds=(0.0, 0.05, 0.5)))
    env.reset(options={"speed": 1.0, "parcel": "S", "position": 1.0})
    ended, stop = False, env.config.choices - 1
    for _ in range(150):
        error = env.batch.parcels.metrics[0, 0]
        ahead = error < 0.0
        choice = (0 if ahead else 1) + (2 if abs(error) > 0.1 else 0)
        choice = stop if abs(error) < 0.002 else choice
        *_, ended, _, info = env.step(choice * env.config.choices + choice)
        if ended:
            break
    assert info["outcome"] == "success"


def test_observed_modules_show_their_velocities():
    module = OmniModule(acceleration=math.inf, speeds=(1.0, 2.0))
    env = sg.SmartSurfaceEnv("sort", actions="halves", modules=module, observe_axes=True)
    env.reset(seed=0, options={"side": 1, "parcel": "B"})
    left = 8 + 3  # at 2 m/s
    observation, *_ = env.step(left * env.config.choices + left)
    shown = env.config.observed(observation)
    assert (shown["vx of module 0, 5"], shown["vy of module 0, 5"]) == pytest.approx((0.0, 2.0))
    assert env.observation_space.contains(observation)


def test_energies_balance():
    env = sg.SmartSurfaceEnv("sort", actions="halves", modules=OmniModule(), info=("energy",))
    env.action_space.seed(1)
    for seed in range(5):
        env.reset(seed=seed)
        before, ended = kinetic(env), False
        while not ended:
            *_, terminated, truncated, info = env.step(env.action_space.sample())
            ended = terminated or truncated
        gained = info["drive_work"] - info["friction_heat"]
        assert kinetic(env) - before == pytest.approx(gained, abs=1e-9 * info["friction_heat"])


def kinetic(env):
    """Kinetic energy [J] of the parcel."""
    state, parcel = env.batch.parcels.state[0], env.batch.parcel(0)
    vx, vy, omega = state[3:6]
    return 0.5 * parcel.mass * (vx**2 + vy**2 + parcel.body.gyration * omega**2)


def test_bad_modules_raise():
    for arguments, message in (
        ({"modules": "wheels"}, "modules must be one of 'idle', .*'popup'.*, got 'wheels'"),
        ({"modules": 3}, "modules must be one of idle, .* or a ModuleKind"),
        ({"modules": "omni", "orientations": "any"}, "orientations must not be given beside"),
    ):
        with pytest.raises(ValueError, match=message):
            sg.SmartSurfaceEnv("sort", **arguments)
    for arguments, message in (
        ({"speeds": (1.0, 0.5)}, "speeds must be rising numbers"),
        ({"speeds": (0.0,)}, "one of them positive"),
        ({"speeds": ()}, "speeds must be rising numbers"),
        ({"headings": ()}, "headings must be at least one"),
        ({"acceleration": -1.0}, "acceleration must be"),
    ):
        with pytest.raises(ValueError, match=message):
            SteeredRoller(**arguments)
