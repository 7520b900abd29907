"""The arguments of an environment, checked once for both classes; presets and features."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

import surface_gym as sg
from surface_gym.config import LAB_PARCELS, PRESETS, EnvConfig, Preset
from surface_gym.feature_groups import GROUPS, PARCEL_FEATURES, QUADRANTS, ROTOR_FEATURES
from surface_gym.lines import ORIENTATIONS
from surface_gym.parcel import Base, Disc, Parcel, Polygon, Rectangle
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Camera, Exact
from surface_gym.tasks import TASKS, Slow
from tests.environments import ACTIONS, outside


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


LAB = PRESETS["lab"]
BOTH = ("parcel", "rotors")
SHOWN = len(PARCEL_FEATURES) + len(ROTOR_FEATURES)
BASES: tuple[Base, ...] = (
    Rectangle(0.25, 0.25),
    Rectangle(0.4, 0.22),
    Disc(0.17),
    Polygon(np.array([(-0.2, -0.1), (0.15, -0.17), (0.22, 0.05), (0.0, 0.2)])),
)


EVERY_TAKER = (EnvConfig, sg.SmartSurfaceEnv, sg.SmartSurfaceVectorEnv)


class TestNames:
    def test_each_goes_by_its_name_and_sets_sensors_actuators_and_randomisation(self):
        for name, preset in PRESETS.items():
            assert preset.name == name
            settings = EnvConfig(preset=preset)
            assert EnvConfig(preset=name) == settings
            assert settings.sensors == preset.sensors
            assert settings.actuators == preset.actuators
            assert settings.randomisation == preset.randomisation
            assert preset.label
            assert preset.meaning.endswith(".")

    def test_exact_is_the_default_and_one_may_be_made(self):
        assert EnvConfig(preset="exact") == EnvConfig() == EnvConfig(preset=None)
        mine = Preset("mine", "mine", "Mine.", actuators=Actuators(stuck_share=0.5))
        assert EnvConfig(preset=mine).actuators.stuck_share == 0.5

    @pytest.mark.parametrize("bad", ["laboratory", "", 3, Exact()])
    def test_an_unknown_one_is_named(self, bad):
        for make in EVERY_TAKER:
            with pytest.raises(ValueError, match=r"^preset must be one of 'exact', .*'lab', got"):
                make(preset=bad)

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("sensors", Camera()),
            ("actuators", Actuators(axis_speed=3.0)),
            ("randomisation", Randomisation(friction=0.1)),
        ],
    )
    def test_nothing_that_it_sets_may_stand_beside_it(self, name, value):
        expected = f"^preset must not be given beside {name}, which it sets, got 'lab' and"
        for make in EVERY_TAKER:
            with pytest.raises(ValueError, match=expected):
                make(preset="lab", **{name: value})


class TestLab:
    def test_it_is_what_its_meaning_says(self):
        assert 0.5 * math.pi / LAB.actuators.axis_speed == pytest.approx(0.05)
        assert LAB.actuators.stuck_share == 0.02
        assert LAB.randomisation.friction == LAB.randomisation.rolling == 0.15
        assert LAB.randomisation.lateral == 0.01
        assert LAB.randomisation.heading == pytest.approx(math.radians(3.0))
        assert isinstance(LAB.sensors, Camera)
        assert (LAB.sensors.frame_rate, LAB.sensors.latency) == (50.0, 0.04)
        assert LAB.sensors.position_noise == 0.002
        assert len(LAB.parcels) == LAB_PARCELS
        for parcel in LAB.parcels:
            extent = np.ptp(parcel.base.outline, axis=0)
            # A polygon inscribed in the least circles is no wider than these let it be.
            assert 0.149 < extent.min() <= extent.max() <= 0.45
            assert math.hypot(*parcel.com_offset) <= 0.03

    @pytest.mark.parametrize("task", ["sort", "slow", "stop", "track", "orient", "park"])
    def test_tasks_draw_its_parcels(self, task):
        assert EnvConfig(task=task, preset="lab").task.parcels == LAB.parcels
        assert EnvConfig(task=task, preset="camera") == EnvConfig(task=task, sensors=Camera())

    def test_a_task_of_parcels_of_its_own_keeps_them_and_its_other_parameters(self):
        mine = Slow(parcels=(Parcel(Disc(0.2)),))
        assert EnvConfig(task=mine, preset="lab").task == mine
        found = EnvConfig(task=Slow(speeds=(1.0, 1.2)), preset="lab").task
        assert found == Slow(speeds=(1.0, 1.2), parcels=LAB.parcels)


class TestObserve:
    def test_groups_stand_at_the_end_in_one_order(self):
        plain = EnvConfig().features
        assert EnvConfig(observe=("rotors", "parcel")) == EnvConfig(observe=BOTH)
        assert EnvConfig(observe=BOTH).features == (*plain, *PARCEL_FEATURES, *ROTOR_FEATURES)
        assert EnvConfig(observe=("rotors",)).features == (*plain, *ROTOR_FEATURES)
        both = EnvConfig(observe=BOTH, observe_axes=True).features[-SHOWN:]
        assert both == (*PARCEL_FEATURES, *ROTOR_FEATURES)

    @pytest.mark.parametrize("bad", [("parcels",), "parcel", 3, (1,)])
    def test_an_unknown_group_is_named(self, bad):
        for make in EVERY_TAKER:
            with pytest.raises(ValueError, match=r"^observe must be"):
                make(observe=bad)

    def test_every_group_says_what_it_shows(self):
        for group in GROUPS.values():
            for feature in group.features:
                assert feature.low < feature.high
                assert feature.meaning

    @pytest.mark.parametrize("task", ["slow", "track", "sort"])
    def test_the_parcel_and_the_rotors_under_its_base_are_shown(self, task):
        # All of the lab but its sensors, so that what is sensed is the truth.
        preset = replace(LAB, sensors=Exact(), parcels=tuple(map(Parcel, BASES)))
        env = sg.SmartSurfaceVectorEnv(
            12, task, actions="halves", observe=BOTH, preset=preset, info=("axes",)
        )
        bases = [BASES[k % 4] for k in range(12)]
        given: list[dict[str, Any]] = [{"parcel": Parcel(base)} for base in bases]
        mirrored = [1] * 12
        if task == "sort":
            mirrored[6:] = [-1] * 6
            given = [{**each, "side": side} for each, side in zip(given, mirrored, strict=True)]
        observations, info = env.reset(seed=4, options=given)
        rng = np.random.default_rng(3)
        running = np.ones(12, dtype=bool)
        for _ in range(12):
            assert observations in env.observation_space
            for k in np.nonzero(running)[0].tolist():
                axes = info["axes"][k]
                rotors = _rotors(env.config, bases[k], info["pose"][k], axes, mirrored[k])
                shown = np.concatenate([_outline(bases[k]), rotors])
                np.testing.assert_allclose(observations[k, -SHOWN:], shown, rtol=1e-5, atol=1e-5)
            observations, _, terminated, truncated, info = env.step(rng.integers(0, 16, 12))
            running &= ~(terminated | truncated)
        assert running.any()

    def test_sort_to_the_other_side_is_seen_in_a_mirror(self):
        """Left and right exchanged, and with them 45 and -45 deg; axes that take time turn by
        90 deg the same way round in the mirror, so that here they turn at once.
        """
        both = sg.SmartSurfaceVectorEnv(2, "sort", actions="halves", observe=BOTH)
        start: dict[str, Any] = {"parcel": "B", "speed": 1.5}
        seen, _ = both.reset(seed=[7, 7], options=[{**start, "side": side} for side in (1, -1)])
        image = np.array([0, 2, 1, 3])  # of 0, 45, -45 and 90 deg
        shown = []
        for step in range(14):
            np.testing.assert_allclose(seen[0, -SHOWN:], seen[1, -SHOWN:], rtol=0, atol=1e-6)
            shown.append(seen[0, -len(ROTOR_FEATURES) :])
            ahead, behind = divmod((3 * step) % 16, 4)
            action = [4 * ahead + behind, 4 * image[ahead] + image[behind]]
            seen, _, terminated, _, _ = both.step(np.array(action))
            if terminated.any():
                break
        assert len({tuple(each.round(3)) for each in shown}) > 5


def _outline(base: Base) -> np.ndarray:
    """What `observe=("parcel",)` shows of a base."""
    points = base.outline
    length, width = np.ptp(points, axis=0)
    if isinstance(base, Disc):
        area = math.pi * (0.5 * length) ** 2
    else:
        after = np.roll(points, -1, axis=0)
        area = 0.5 * float((points[:, 0] * after[:, 1] - points[:, 1] * after[:, 0]).sum())
    scaled = [(0.5 * size - 0.175) / 0.05 for size in (length, width)]
    return np.array([*scaled, area / (length * width)])


def _rotors(
    settings: EnvConfig, base: Base, pose: np.ndarray, axes: np.ndarray, mirror: int
) -> np.ndarray:
    """What `observe=("rotors",)` shows: elements under the base, by `Base.functions`."""
    line = settings.chosen_line
    column, row = np.meshgrid(np.arange(line.columns), np.arange(line.rows))
    x, y = line.origin[0] + line.pitch_x * column, line.origin[1] + line.pitch_y * row
    dx, dy = x - pose[0], y - pose[1]
    under = outside(base, pose, x, y, base.centroid) <= 0.0
    rotor = line.site(base, settings.zone).rotor
    shown: list[float] = []
    for quadrant in QUADRANTS:
        along = dx >= 0.0 if "ahead" in quadrant else dx < 0.0
        left = mirror * dy >= 0.0
        there = under & rotor & along & (left if "left" in quadrant else ~left)
        twice = 2.0 * axes[there]
        if not there.any():
            shown += [0.0, 0.0, 0.0]
            continue
        share = there.sum() / under.sum()
        shown += [share, float(np.cos(twice).mean()), mirror * float(np.sin(twice).mean())]
    return np.array(shown)
