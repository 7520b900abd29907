"""Rules of Sort."""

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.agents.rules.sorting import BestSorting, GradedLayout
from surface_gym.config import EnvConfig
from surface_gym.design.sorting_layouts import OFFERS, SortingLayout, sorting_layouts
from surface_gym.lines import Line
from tests.agents.rules.runs import run, run_rule

AFTER_THE_EVENT = ["event rule", "threshold logic", "PID per module"]


def starts(parcel: str, speed: float) -> list[dict]:
    return [{"parcel": parcel, "speed": speed, "side": side} for side in (1, -1)]


@pytest.mark.parametrize("name", AFTER_THE_EVENT)
@pytest.mark.parametrize(
    ("parcel", "speed"), [("S", 0.36), ("S", 0.4), ("S", 0.7), ("B", 0.52), ("B", 0.9)]
)
def test_they_sort_where_the_fixed_layout_stalls(name, parcel, speed) -> None:
    assert not run_rule("sort", "fixed layout", starts(parcel, speed)).success.any()
    assert run_rule("sort", name, starts(parcel, speed)).success.all()


@pytest.mark.parametrize("name", ["fixed layout", "best fixed layout", *AFTER_THE_EVENT])
@pytest.mark.parametrize("parcel", ["S", "B"])
def test_all_sort_a_fast_parcel(name, parcel) -> None:
    assert run_rule("sort", name, starts(parcel, 1.5)).success.all()


@pytest.mark.parametrize("name", ["fixed layout", "best fixed layout", *AFTER_THE_EVENT])
def test_straight_through_is_left_alone(name) -> None:
    runs = run_rule("sort", name, [{"parcel": "S", "speed": 1.5, "side": 0}])
    assert runs.outcome.tolist() == ["success"]
    np.testing.assert_allclose(runs.pose[:, 1:], [[1.0, 0.0]], atol=1e-6)


def arranged(parcel: str, side: int, **others) -> np.ndarray:
    """Axes (rows, columns) [rad] that the best fixed layout sets for a start."""
    config = EnvConfig(task="sort", actions="modules", **others)
    env = sg.SmartSurfaceEnv(task="sort", actions="modules", **others)
    observation, _ = env.reset(seed=0, options={"speed": 1.5, "parcel": parcel, "side": side})
    action, _ = BestSorting(config).predict(observation)
    return np.array(config.chosen_orientations)[np.reshape(action, config.action_kind.shape)]


def shipped(box: str, offer: str) -> SortingLayout:
    (found,) = (each for each in sorting_layouts() if (each.box, each.offer) == (box, offer))
    return found


@pytest.mark.parametrize("box", ["S", "B"])
@pytest.mark.parametrize("side", [1, -1])
def test_the_best_fixed_layout_sorts_at_its_least_speed(box, side) -> None:
    least = shipped(box, "four").least_speed
    speeds = np.arange(round(100 * least), 271, 10) / 100
    some = [{"parcel": box, "speed": float(speed), "side": side} for speed in speeds]
    assert run_rule("sort", "best fixed layout", some).success.all()
    slower = [{"parcel": box, "speed": least - 0.02, "side": side}]
    assert not run_rule("sort", "best fixed layout", slower).success.any()


@pytest.mark.parametrize("box", ["S", "B"])
def test_with_more_orientations_it_sorts_slower_boxes(box) -> None:
    eight = OFFERS["eight"]
    assert eight is not None
    least = shipped(box, "eight").least_speed
    speeds = np.arange(round(100 * least), 271, 20) / 100
    some = [
        {"speed": float(speed), "side": side, "parcel": box} for speed in speeds for side in (1, -1)
    ]
    config = EnvConfig("sort", actions="modules", orientations=eight)
    assert run(BestSorting(config), config, some).success.all()
    assert least < shipped(box, "four").least_speed


@pytest.mark.parametrize("box", ["S", "B"])
def test_the_best_fixed_layout_is_mirrored_for_the_other_side(box) -> None:
    to_right, to_left = arranged(box, -1), arranged(box, 1)
    np.testing.assert_allclose(np.sin(to_left + to_right[::-1]), 0.0, atol=1e-12)
    through = arranged(box, 0)
    np.testing.assert_allclose(through, np.pi / 2)


def test_on_a_zone_of_another_size_it_is_cut_or_goes_on() -> None:
    whole = arranged("B", -1)
    shorter = arranged("B", -1, zone=(6, 15))
    np.testing.assert_array_equal(shorter, whole[:, :10])
    longer = arranged("B", -1, line=Line(columns=40, zone_columns=20, zone_rows=8))
    np.testing.assert_array_equal(longer[2:6, :16], whole)
    np.testing.assert_array_equal(longer[:, 16:], np.repeat(longer[:, 15:16], 4, axis=1))
    np.testing.assert_array_equal(longer[:2], np.repeat(longer[2:3], 2, axis=0))


def test_in_the_middle_of_a_wider_zone_lies_the_small_box_s_layout() -> None:
    layout = shipped("S", "four").axis
    np.testing.assert_allclose(np.sin(arranged("S", -1)[1:3] - layout), 0.0, atol=1e-12)


@pytest.mark.parametrize("box", ["S", "B"])
def test_at_any_angle_a_fixed_layout_sorts_as_slowly_as_rules_do(box) -> None:
    least = shipped(box, "any").least_speed
    speeds = np.arange(round(100 * least), 271, 10) / 100
    config = EnvConfig("sort", actions="modules", orientations="any")
    starts_of_both = [start for speed in speeds for start in starts(box, float(speed))]
    assert run(GradedLayout(config), config, starts_of_both).success.all()
    assert least <= shipped(box, "four").least_speed / 1.8
    through = run(GradedLayout(config), config, [{"parcel": box, "speed": 1.5, "side": 0}])
    assert through.success.all()


def test_a_layout_at_any_angle_is_for_axes_at_any_angle() -> None:
    with pytest.raises(ValueError, match="orientations must be one of 'any', got None"):
        GradedLayout(EnvConfig("sort", actions="modules"))
    with pytest.raises(ValueError, match="actions must be one of 'modules', got 'halves'"):
        GradedLayout(EnvConfig("sort", actions="halves", orientations="any"))
    with pytest.raises(ValueError, match="task must be one of 'sort', got 'slow'"):
        GradedLayout(EnvConfig("slow", actions="modules", orientations="any"))


def test_one_observation_gives_one_action() -> None:
    config = EnvConfig("sort", actions="modules", orientations="any")
    env = sg.SmartSurfaceEnv(task="sort", actions="modules", orientations="any")
    observation, _ = env.reset(seed=0)
    one, state = GradedLayout(config).predict(observation)
    many, _ = GradedLayout(config).predict(observation[np.newaxis])
    assert state is None
    assert env.action_space.contains(one.astype(np.float32))
    np.testing.assert_array_equal(many, one[np.newaxis])
