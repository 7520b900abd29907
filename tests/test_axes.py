"""Axes of modules: any angle, seen, on request; their speed, and stuck ones."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.core.batch import Batch
from surface_gym.layouts import LINE_Y
from surface_gym.randomisation import Actuators
from surface_gym.sensors import Exact
from surface_gym.state import RUNNING
from surface_gym.tasks.start import Start
from tests.environments import (
    CELLS,
    MINUS_45,
    PLUS_45,
    ROLL,
    SORT,
    assert_same,
    bare,
    every_id,
    put,
    same_choice,
    steps,
)

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

    @pytest.mark.usefixtures("uncompiled")
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
    @pytest.mark.usefixtures("uncompiled")
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
        # With loads, as in tests of actuators, which need the same kernel.
        asked = ("axes", "normal_forces", "load")
        envs = gym.make_vec(SORT, num_envs=3, info=asked)
        _, info = envs.reset(seed=0)
        assert info["axes"].shape == info["normal_forces"].shape == (3, 20, 30)
        for i in range(3):
            single = bare(info=asked).reset(seed=i)[1]
            assert_same(info["axes"][i], single["axes"])
            assert_same(info["normal_forces"][i], single["normal_forces"])

    @pytest.mark.parametrize("wrong", ["axes", ("torque",), 3, None])
    def test_others_are_named(self, wrong):
        with pytest.raises(ValueError, match="info must be"):
            bare(info=wrong)


ZERO = 0  # the choice of the axis along x
FLAT_BOX = sg.Parcel(sg.Rectangle(0.25, 0.25), com_height=0.0)  # nothing shifts its load


class Bench:
    """One environment whose axes can be looked at."""

    def __init__(self, actions: str = "quadrants", **settings: Any) -> None:
        self.settings = EnvConfig(actions=actions, **settings)
        self.batch = Batch(self.settings, 1)
        self.batch.reset_cache.seed(0, np.random.default_rng(0))
        self.place()

    def place(self, speed: float = 0.0, parcel: sg.Parcel = FLAT_BOX, x: float = 0.6) -> None:
        put(self.batch, Start(parcel, (x, LINE_Y, 0.0), (speed, 0.0, 0.0), (1.0,)))

    def step(self, choice: int) -> None:
        self.batch.parcels.outcome[0] = RUNNING  # whatever becomes of the parcel
        self.batch.step(np.full((1, self.settings.action_kind.size), choice))

    @property
    def angle(self) -> np.ndarray:
        """(rows, columns) [rad] of each axis, in [0, pi)."""
        return self.batch.axes(0) % np.pi

    @property
    def obeying(self) -> np.ndarray:
        return self.batch.view(0).obeys


class TestAxisSpeed:
    def test_infinite_turns_at_once(self):
        bench = Bench()
        for choice, degrees in ((MINUS_45, 135.0), (PLUS_45, 45.0), (ZERO, 0.0), (ROLL, 90.0)):
            bench.step(choice)
            np.testing.assert_allclose(np.degrees(bench.angle[bench.obeying]), degrees)
            np.testing.assert_allclose(bench.angle[~bench.obeying], np.pi / 2)

    @pytest.mark.parametrize(
        ("choice", "sense", "turn"), [(PLUS_45, -1, 45.0), (MINUS_45, +1, 45.0), (ZERO, 0, 90.0)]
    )
    @pytest.mark.parametrize("speed", [60.0, 100.0, 450.0])  # [deg/s]
    def test_finite_takes_the_time_it_takes(self, speed, choice, sense, turn):
        """From the conveyor's 90 deg by the shorter way; either way to 0 deg is as short."""
        bench = Bench(actuators=Actuators(axis_speed=math.radians(speed)), control_period=0.02)
        for period in range(1, math.ceil(turn / (speed * 0.02)) + 3):
            bench.step(choice)
            turned = np.degrees(bench.angle[bench.obeying] - np.pi / 2)
            assert np.ptp(turned) == 0.0
            due = min(turn, speed * 0.02 * period)
            turned = sense * turned if sense else np.abs(turned)
            np.testing.assert_allclose(turned, due, rtol=0, atol=1e-9)
            np.testing.assert_array_equal(bench.angle[~bench.obeying], np.pi / 2)

    def test_a_new_command_on_the_way_turns_it_from_where_it_is(self):
        bench = Bench(actuators=Actuators(axis_speed=math.radians(500.0)))
        bench.step(PLUS_45)  # 40 ms: 20 deg down
        np.testing.assert_allclose(np.degrees(bench.angle[bench.obeying]), 70.0)
        bench.step(MINUS_45)  # 65 deg up to 135 deg
        np.testing.assert_allclose(np.degrees(bench.angle[bench.obeying]), 90.0)
        for _ in range(3):
            bench.step(MINUS_45)
        np.testing.assert_allclose(np.degrees(bench.angle[bench.obeying]), 135.0)

    def test_a_start_finds_the_conveyor_again(self):
        bench = Bench(actuators=Actuators(axis_speed=3.0))
        for _ in range(5):
            bench.step(ZERO)
        bench.place()
        np.testing.assert_array_equal(bench.angle, np.pi / 2)
        bench.step(ROLL)
        np.testing.assert_array_equal(bench.angle, np.pi / 2)

    def test_a_turning_axis_acts_by_the_angle_it_has(self):
        """Beside `simulate` one step at a time, on surfaces turned a step's angle further each."""
        speed = math.radians(200.0)
        bench = Bench(actuators=Actuators(axis_speed=speed))
        bench.place(speed=1.0)
        parcels = bench.batch.parcels
        pose, velocity = parcels.truth[0, :3].copy(), parcels.truth[0, 3:].copy()
        for number in range(1, 41):
            turned = min(math.pi / 4, number * speed * 0.005)
            axis = np.where(bench.obeying, math.pi / 2 + turned, math.pi / 2)
            surface = sg.Surface(axis, bench.batch.view(0).rotor.copy())
            run = sg.simulate(surface, FLAT_BOX, pose, velocity, duration=0.005)
            pose, velocity = run.pose[-1], run.velocity[-1]
            if number % 8 == 0:
                bench.step(MINUS_45)
                np.testing.assert_allclose(parcels.truth[0, :3], pose, rtol=0, atol=1e-10)
        assert pose[1] > LINE_Y + 0.01  # it did act


class TestStuck:
    STUCK = ((9, 5), (10, 8))

    @pytest.mark.parametrize("axis_speed", [math.inf, 20.0])
    def test_given_modules_never_turn(self, axis_speed):
        bench = Bench(actuators=Actuators(axis_speed=axis_speed, stuck=self.STUCK))
        free = Bench(actuators=Actuators(axis_speed=axis_speed))
        for choice in (PLUS_45, ZERO, MINUS_45, PLUS_45):
            bench.step(choice)
            free.step(choice)
            stuck = np.zeros_like(bench.obeying)
            for row, column in self.STUCK:
                assert bench.angle[row, column] == np.pi / 2
                stuck[row, column] = True
            np.testing.assert_array_equal(bench.obeying, free.obeying & ~stuck)
            np.testing.assert_array_equal(bench.angle[~stuck], free.angle[~stuck])

    @pytest.mark.parametrize("stuck", [((0, 0),), ((9, 0), (10, 29)), ((9, 5), (9, 5))])
    def test_a_support_or_the_conveyor_may_be_stuck_too(self, stuck):
        twin = Actuators(stuck=((9, 5),)) if (9, 5) in stuck else Actuators()
        runs = [
            tuple(steps(bare(actuators=each), seed=0)) for each in (Actuators(stuck=stuck), twin)
        ]
        assert_same(*runs)

    @pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
    def test_a_share_is_drawn_at_each_start(self, share):
        bench = Bench(actuators=Actuators(stuck_share=share))
        zone = Bench().obeying
        drawn = []
        for _ in range(500):
            bench.place()
            assert not bench.obeying[~zone].any()
            drawn.append(~bench.obeying[zone])
        stuck = np.array(drawn)  # (starts, modules)
        spread = math.sqrt(share * (1.0 - share))
        assert stuck.mean() == pytest.approx(share, abs=4.0 * spread / math.sqrt(stuck.size))
        np.testing.assert_allclose(stuck.mean(axis=0), share, atol=5.0 * spread / math.sqrt(500))
        # Module by module on its own: the count in a start is binomial.
        assert stuck.sum(axis=1).var() == pytest.approx(zone.sum() * spread**2, rel=0.3)

    def test_a_share_adds_to_those_given(self):
        bench = Bench(actuators=Actuators(stuck=self.STUCK, stuck_share=0.3))
        assert not any(bench.obeying[module] for module in self.STUCK)
        assert 0 < bench.obeying.sum() < Bench().obeying.sum() - 2


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("axis_speed", (0.0, -1.0, -math.inf, math.nan, "fast", None)),
        ("stuck", (((1, 2, 3),), ((1,),), (3, 5), 3, None, "all")),
        ("stuck", (((-1, 2),), ((1.0, 2),), ((True, 2),))),
    ],
)
def test_bad_arguments_are_named(name, values):
    for value in values:
        with pytest.raises(ValueError, match=f"^{name} must"):
            Actuators(**{name: value})


def test_a_stuck_module_must_lie_on_the_surface():
    EnvConfig(actuators=Actuators(stuck=((19, 29),)))
    for module in ((20, 0), (0, 30)):
        with pytest.raises(ValueError, match=r"stuck must lie in 20 rows and 30 columns"):
            EnvConfig(actuators=Actuators(stuck=(module,)))
