"""Rules of Sort."""

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.agents.rules.sorting import BestSorting, GradedLayout
from surface_gym.config import EnvConfig
from surface_gym.design.sorting_layouts import OFFERS, SortingLayout, sorting_layouts
from surface_gym.lines import Line
from tests.agents.rules.runs import run, run_rule


def starts(parcel: str, *speeds: float, sides: tuple[int, ...] = (1, -1)) -> list[dict]:
    return [
        {"parcel": parcel, "speed": float(speed), "side": side}
        for speed in speeds
        for side in sides
    ]


def from_least_speed(layout: SortingLayout, step: int = 10) -> np.ndarray:
    """Speeds [m/s] from the least at which a layout sorts to the greatest."""
    return np.arange(round(100 * layout.least_speed), 271, step) / 100


SLOW = [*starts("S", 0.36, 0.4, 0.7), *starts("B", 0.52, 0.9)]
FAST = [*starts("S", 1.5), *starts("B", 1.5), *starts("S", 1.5, sides=(0,))]


@pytest.mark.parametrize(
    "name",
    ["fixed layout", "best fixed layout", "event rule", "threshold logic", "PID per module"],
)
def test_they_sort_slow_parcels_as_fast_ones_and_leave_alone_what_goes_straight(name) -> None:
    runs = run_rule("sort", name, [*FAST, *SLOW])
    assert runs.success[: len(FAST)].all()
    np.testing.assert_allclose(runs.pose[len(FAST) - 1, 1:], [1.0, 0.0], atol=1e-6)
    slow = runs.success[len(FAST) :]
    if name == "fixed layout":
        assert not slow.any()
    elif name != "best fixed layout":  # which has least speeds of its own
        assert slow.all()


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
def test_the_best_fixed_layout_sorts_at_its_least_speed(box) -> None:
    layout = shipped(box, "four")
    speeds = from_least_speed(layout)
    runs = run_rule("sort", "best fixed layout", starts(box, layout.least_speed - 0.02, *speeds))
    assert not runs.success[:2].any()
    assert runs.success[2:].all()


@pytest.mark.parametrize("box", ["S", "B"])
def test_with_more_orientations_it_sorts_slower_boxes(box) -> None:
    config = EnvConfig("sort", actions="modules", orientations=OFFERS["eight"])
    some = starts(box, *from_least_speed(shipped(box, "eight"), 20))
    assert run(BestSorting(config), config, some).success.all()
    assert shipped(box, "eight").least_speed < shipped(box, "four").least_speed


@pytest.mark.parametrize("box", ["S", "B"])
def test_the_best_fixed_layout_is_mirrored_for_the_other_side(box) -> None:
    to_right, to_left = arranged(box, -1), arranged(box, 1)
    np.testing.assert_allclose(np.sin(to_left + to_right[::-1]), 0.0, atol=1e-12)
    np.testing.assert_allclose(arranged(box, 0), np.pi / 2)


def test_on_a_zone_of_another_size_it_is_cut_or_goes_on() -> None:
    whole = arranged("B", -1)
    np.testing.assert_array_equal(arranged("B", -1, zone=(6, 15)), whole[:, :10])
    longer = arranged("B", -1, line=Line(columns=40, zone_columns=20, zone_rows=8))
    np.testing.assert_array_equal(longer[2:6, :16], whole)
    np.testing.assert_array_equal(longer[:, 16:], np.repeat(longer[:, 15:16], 4, axis=1))
    np.testing.assert_array_equal(longer[:2], np.repeat(longer[2:3], 2, axis=0))
    # In the middle of a wider zone lies the small box's.
    small = shipped("S", "four").axis
    np.testing.assert_allclose(np.sin(arranged("S", -1)[1:3] - small), 0.0, atol=1e-12)


@pytest.mark.parametrize("box", ["S", "B"])
def test_at_any_angle_a_fixed_layout_sorts_as_slowly_as_rules_do(box) -> None:
    config = EnvConfig("sort", actions="modules", orientations="any")
    some = starts(box, *from_least_speed(shipped(box, "any"))) + starts(box, 1.5, sides=(0,))
    assert run(GradedLayout(config), config, some).success.all()
    assert shipped(box, "any").least_speed <= shipped(box, "four").least_speed / 1.8


@pytest.mark.parametrize(
    ("task", "actions", "orientations", "named"),
    [
        ("sort", "modules", None, "orientations must be one of 'any', got None"),
        ("sort", "halves", "any", "actions must be one of 'modules', got 'halves'"),
        ("slow", "modules", "any", "task must be one of 'sort', got 'slow'"),
    ],
)
def test_a_layout_at_any_angle_is_for_axes_at_any_angle(task, actions, orientations, named) -> None:
    with pytest.raises(ValueError, match=named):
        GradedLayout(EnvConfig(task, actions=actions, orientations=orientations))


def test_one_observation_gives_one_action() -> None:
    config = EnvConfig("sort", actions="modules", orientations="any")
    env = sg.SmartSurfaceEnv(task="sort", actions="modules", orientations="any")
    observation, _ = env.reset(seed=0)
    one, state = GradedLayout(config).predict(observation)
    many, _ = GradedLayout(config).predict(observation[np.newaxis])
    assert state is None
    assert env.action_space.contains(one.astype(np.float32))
    np.testing.assert_array_equal(many, one[np.newaxis])
