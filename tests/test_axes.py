"""Axes at any angle, axes that are seen, and what `info` carries on request."""

import math

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import surface_gym as sg
from surface_gym.randomisation import Actuators
from surface_gym.sensors import Exact
from tests.environments import CELLS, SORT, assert_same, bare, every_id, same_choice, steps

ANGLES = np.array([0.0, math.pi / 4, -math.pi / 4, math.pi / 2])  # of the default choices
FLAT = sg.Parcel(sg.Rectangle(0.35, 0.25), mass=4.0, com_height=0.0, com_offset=(0.03, -0.02))
TURNING = {"actions": "quadrants", "actuators": Actuators(axis_speed=5.0)}
# Every id and every kind of action.
CASES = {
    f"{env_id}-{actions}": (env_id, {"actions": actions})
    for env_id, actions, sensor in CELLS
    if sensor is Exact
} | {"turning": (SORT, TURNING)}


class TestAnyAngle:
    @pytest.mark.parametrize(("env_id", "settings"), CASES.values(), ids=CASES)
    @pytest.mark.filterwarnings("ignore:.*symmetric and normalized")  # angles are what they are
    def test_the_angles_of_choices_move_it_as_the_choices_do(self, env_id, settings):
        any_angle, choices = bare(env_id, orientations="any", **settings), bare(env_id, **settings)
        kind = choices.config.action_kind
        assert isinstance(any_angle.action_space, gym.spaces.Box)
        assert any_angle.action_space.shape == (kind.size,)
        check_env(any_angle, skip_render_check=True)
        for env in (any_angle, choices):
            env.reset(seed=2)
        rng = np.random.default_rng(0)
        for _ in range(12):
            command = rng.integers(4, size=(1, kind.size))
            one = any_angle.step(ANGLES[command[0]])
            other = choices.step(kind.encode(command)[0])
            np.testing.assert_allclose(one[4]["pose"], other[4]["pose"], rtol=0, atol=1e-9)
            if one[2]:
                break

    @pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
    def test_an_angle_between_acts_as_a_surface_so_turned(self):
        env = bare(actions="quadrants", orientations="any", zone=(0, 29))
        _, info = env.reset(seed=0, options={"speed": 1.5, "parcel": "S", "side": 1})
        layout = sg.layouts.sorting("S", 1, columns=30, task_columns=27)
        surface = sg.Surface(np.full(layout.rotor.shape, -0.6), layout.rotor)
        run = sg.simulate(surface, sg.layouts.box("S"), info["pose"], (1.5, 0.0, 0.0), duration=0.5)
        for period in range(1, 10):
            info = env.step([-0.6] * 4)[4]
            np.testing.assert_allclose(info["pose"], run.pose[8 * period], rtol=0, atol=1e-9)

    def test_others_are_refused(self):
        env = bare(actions="quadrants", orientations="any")
        env.reset(seed=0)
        for wrong in ([2.0, 0.0, 0.0, 0.0], [math.nan, 0.0, 0.0, 0.0], [0.0], "up", [True] * 4):
            with pytest.raises(ValueError, match="action must"):
                env.step(wrong)


class TestSeenAxes:
    @pytest.mark.parametrize(
        ("env_id", "settings"),
        [
            ("SmartSurface/Orient-v0", {"actions": "modules"}),
            ("SmartSurface/Slow-v0", {"actions": "window"}),
            (SORT, TURNING),
        ],
        ids=["modules", "window", "turning"],
    )
    def test_the_rest_is_as_without(self, env_id, settings):
        plain, seeing = bare(env_id, **settings), bare(env_id, observe_axes=True, **settings)
        features = plain.observation_space.shape[0]
        for one, other in zip(steps(plain, 3), steps(seeing, 3), strict=True):
            assert_same(one[0], other[0][:features])
            assert one[1:4] == other[1:4]
            assert other[0] in seeing.observation_space

    @pytest.mark.parametrize("side", [1, -1])
    def test_they_are_those_of_info_mirrored_with_the_rest(self, side):
        env = bare(observe_axes=True, info=("axes",), **TURNING)
        env.reset(seed=0, options={"parcel": "B", "side": side})
        features = len(env.config.task.features)
        for action in ([0, 1, 2, 3], [2, 2, 1, 1], [1, 0, 3, 2]):
            observation, *_, info = env.step(action)
            zone = info["axes"][8:12, 5:21]
            if side < 0:
                zone = -zone[::-1]
            shown = np.stack([np.cos(2.0 * zone), np.sin(2.0 * zone)], axis=-1)
            np.testing.assert_allclose(observation[features:], shown.ravel(), atol=1e-6)

    def test_turning_axes_are_hidden_otherwise(self):
        """Two environments that look alike, whose axes are under way to different places."""
        for seen in (False, True):
            env = bare(observe_axes=seen, **{**TURNING, "actuators": Actuators(axis_speed=0.5)})
            found = []
            for choice in (1, 2):
                env.reset(seed=0, options={"parcel": "S", "side": 1, "speed": 0.5})
                found.append(env.step([choice] * 4)[0])
            assert (found[0] == found[1]).all() != seen


class TestOnRequest:
    @every_id
    def test_nothing_is_there_unasked(self, env_id):
        assert not {"axes", "normal_forces"} & set(bare(env_id).reset(seed=0)[1])
        assert "axes" in bare(env_id, info=["axes"]).reset(seed=0)[1]

    @pytest.mark.parametrize("tilt", [0.0, 0.2])
    def test_normal_forces_bear_the_parcel_about_its_centre_of_mass(self, tilt):
        env = bare("SmartSurface/Track-v0", info=("normal_forces", "axes"))
        env.reset(seed=0, options={"parcel": FLAT, "tilt": tilt, "speed": 1.0})
        for choice in (0, 1, 2, 1):
            info = env.step(same_choice(env, choice))[4]
            loads = info["normal_forces"]
            assert loads.min() >= 0.0
            assert loads.sum() == pytest.approx(4.0 * 9.81 * math.cos(tilt))
            rows, columns = np.indices(loads.shape)
            x, y, theta = info["pose"]
            com_x = x + 0.03 * math.cos(theta) + 0.02 * math.sin(theta)
            com_y = y + 0.03 * math.sin(theta) - 0.02 * math.cos(theta)
            centre = [0.05 + 0.1 * np.average(k, weights=loads) for k in (columns, rows)]
            assert centre == pytest.approx([com_x, com_y], abs=1e-6)

    def test_a_vector_env_has_them_one_by_one(self):
        envs = gym.make_vec(SORT, num_envs=3, info=("axes", "normal_forces"))
        _, info = envs.reset(seed=0)
        assert info["axes"].shape == info["normal_forces"].shape == (3, 20, 30)
        for i in range(3):
            single = bare(info=("axes", "normal_forces")).reset(seed=i)[1]
            assert_same(info["axes"][i], single["axes"])
            assert_same(info["normal_forces"][i], single["normal_forces"])

    @pytest.mark.parametrize("wrong", ["axes", ("torque",), 3, None])
    def test_others_are_named(self, wrong):
        with pytest.raises(ValueError, match="info must be"):
            bare(info=wrong)
