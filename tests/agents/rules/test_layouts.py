"""Rules of Sort, and the best layouts that could be arranged beforehand, searched for a start."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from surface_gym.agents.evaluation.method import (
    BEST_FIXED,
    FIXED,
    all_methods,
    find_benchmark,
    rules,
)
from surface_gym.agents.evaluation.scenario import QUICK, start_scenarios
from surface_gym.agents.planning.layouts import ShownPath
from surface_gym.agents.rules.layouts import BestSlowing, BestStopping, BestTracking, BestTurning
from surface_gym.agents.rules.sorting import BestSorting, BoxLayouts, GradedLayout
from surface_gym.config import PRESETS, EnvConfig
from surface_gym.design.fixed_layout import OFFERS, SortingLayout, sorting_layouts
from surface_gym.layouts import LINE_Y, box
from surface_gym.lines import Line
from surface_gym.tasks import Track
from surface_gym.tasks.paths import LaneChange, Sine
from tests.agents.rules.runs import assert_mirrored, begun, ends, mirrored_starts, run, run_rule


def sides_of(parcel: str, *speeds: float, sides: tuple[int, ...] = (1, -1)) -> list[dict]:
    return [
        {"parcel": parcel, "speed": float(speed), "side": side}
        for speed in speeds
        for side in sides
    ]


def from_least_speed(layout: SortingLayout, step: int = 10) -> np.ndarray:
    """Speeds [m/s] from the least at which a layout sorts to the greatest."""
    return np.arange(round(100 * layout.least_speed), 271, step) / 100


SLOW = [*sides_of("S", 0.36, 0.4, 0.7), *sides_of("B", 0.52, 0.9)]
FAST = [*sides_of("S", 1.5), *sides_of("B", 1.5), *sides_of("S", 1.5, sides=(0,))]


@pytest.mark.parametrize(
    "name", ["fixed layout", "best fixed layout", "event rule", "threshold logic", "PID per module"]
)
def test_they_sort_slow_parcels_as_fast_ones_and_leave_alone_what_goes_straight(name) -> None:
    runs = run_rule("sort", name, [*FAST, *SLOW])
    assert runs.success[: len(FAST)].all()
    np.testing.assert_allclose(ends(runs)[len(FAST) - 1, 1:], [1.0, 0.0], atol=1e-6)
    slow = runs.success[len(FAST) :]
    if name == "fixed layout":
        assert not slow.any()
    elif name != "best fixed layout":  # which has least speeds of its own
        assert slow.all()


def sorting_axes(parcel: str, side: int, **others) -> np.ndarray:
    """Axes (rows, columns) [rad] that the best fixed layout sets for a start."""
    start = {"speed": 1.5, "parcel": parcel, "side": side}
    env, seen = begun("sort", [start], actions="modules", **others)
    action, _ = BestSorting(env.config).predict(seen[0])
    kind = env.config.action_kind
    return np.array(env.config.chosen_orientations)[np.reshape(action, kind.shape)]


def shipped(box: str, offer: str) -> SortingLayout:
    (found,) = (each for each in sorting_layouts() if (each.box, each.offer) == (box, offer))
    return found


@pytest.mark.parametrize("box", ["S", "B"])
def test_the_best_fixed_layout_sorts_at_its_least_speed(box) -> None:
    layout = shipped(box, "four")
    speeds = from_least_speed(layout)
    runs = run_rule("sort", "best fixed layout", sides_of(box, layout.least_speed - 0.02, *speeds))
    assert not runs.success[:2].any()
    assert runs.success[2:].all()


@pytest.mark.parametrize("box", ["S", "B"])
def test_with_more_orientations_it_sorts_slower_boxes(box) -> None:
    every = np.sort(np.degrees(OFFERS["eight"]) % 180.0)
    np.testing.assert_allclose(every, [0, 22.5, 45, 67.5, 90, 112.5, 135, 157.5], atol=1e-9)
    config = EnvConfig("sort", actions="modules", orientations=OFFERS["eight"])
    some = sides_of(box, *from_least_speed(shipped(box, "eight"), 20))
    assert run(BestSorting(config), config, some).success.all()
    assert shipped(box, "eight").least_speed < shipped(box, "four").least_speed


@pytest.mark.parametrize("box", ["S", "B"])
def test_the_best_fixed_layout_is_mirrored_for_the_other_side(box) -> None:
    to_right, to_left = sorting_axes(box, -1), sorting_axes(box, 1)
    np.testing.assert_allclose(np.sin(to_left + to_right[::-1]), 0.0, atol=1e-12)
    np.testing.assert_allclose(sorting_axes(box, 0), np.pi / 2)


def test_on_a_zone_of_another_size_it_is_cut_or_goes_on() -> None:
    whole = sorting_axes("B", -1)
    np.testing.assert_array_equal(sorting_axes("B", -1, zone=(6, 15)), whole[:, :10])
    longer = sorting_axes("B", -1, line=Line(columns=40, zone_columns=20, zone_rows=8))
    np.testing.assert_array_equal(longer[2:6, :16], whole)
    np.testing.assert_array_equal(longer[:, 16:], np.repeat(longer[:, 15:16], 4, axis=1))
    np.testing.assert_array_equal(longer[:2], np.repeat(longer[2:3], 2, axis=0))
    own = BoxLayouts([replace(shipped("S", "four"), axis=np.array([[0.1, 0.2, 0.3]]))], (1, 5))
    fitted = own.arrange(np.array([0.2]), np.array([-1.0]))
    np.testing.assert_array_equal(fitted, [[0.1, 0.2, 0.3, 0.3, 0.3]])
    # In the middle of a wider zone lies the small box's.
    small = shipped("S", "four").axis
    np.testing.assert_allclose(np.sin(sorting_axes("S", -1)[1:3] - small), 0.0, atol=1e-12)


@pytest.mark.parametrize("box", ["S", "B"])
def test_at_any_angle_a_fixed_layout_sorts_as_slowly_as_rules_do(box) -> None:
    config = EnvConfig("sort", actions="modules", orientations="any")
    some = sides_of(box, *from_least_speed(shipped(box, "any"))) + sides_of(box, 1.5, sides=(0,))
    assert run(GradedLayout(config), config, some).success.all()
    assert shipped(box, "any").least_speed <= shipped(box, "four").least_speed / 1.8


def test_one_observation_gives_one_action() -> None:
    env, seen = begun("sort", [{}], actions="modules", orientations="any")
    one, state = GradedLayout(env.config).predict(seen[0])
    assert state is None
    assert env.single_action_space.contains(one.astype(np.float32))
    np.testing.assert_array_equal(GradedLayout(env.config).predict(seen)[0], one[np.newaxis])


STARTS: dict[str, list[dict[str, Any]]] = {
    "slow": [
        {"parcel": "S", "speed": 1.9, "ratio": 0.45},
        {"parcel": "B", "speed": 2.4, "ratio": 0.3},
        {"parcel": "B", "speed": 1.0, "ratio": 0.5},  # no layout takes so little
    ],
    "stop": [
        {"parcel": "S", "speed": 0.8, "position": 1.37},
        {"parcel": "B", "speed": 1.9, "position": 1.54},
    ],
    "orient": [
        {"parcel": "S", "speed": 1.5, "angle": -0.4},
        {"parcel": "S", "speed": 1.7, "angle": 0.7},
        {"parcel": "B", "speed": 1.35, "angle": 0.26},  # it stalls
    ],
}
FIGURES = {"slow": "ratio_error", "stop": "stop_error", "orient": "angle_error"}
WAVE = Sine(0.12, 2.4)
SINE: dict[str, Any] = {"path": WAVE, "speed": 0.8, "tilt": 0.22, "parcel": "S"}
SHOWN = EnvConfig(task=ShownPath(), actions="modules")
BY_HALVES = {"actions": "halves", "orientations": "any"}


@pytest.mark.parametrize("task", STARTS)
def test_none_of_the_studys_kind_does_better(task) -> None:
    best, fixed = (run_rule(task, name, STARTS[task]) for name in (BEST_FIXED, FIXED))
    assert (best.success >= fixed.success).all()
    assert best.success.sum() >= 2
    assert not fixed.success.all()
    errors, studys = (np.abs(each.metrics[FIGURES[task]]) for each in (best, fixed))
    ended = best.success | (np.array(best.outcome) == np.array(fixed.outcome))
    assert (errors <= studys + 1e-6)[ended].all()


@pytest.mark.parametrize(
    ("task", "make"), [("slow", BestSlowing), ("stop", BestStopping), ("orient", BestTurning)]
)
def test_the_same_start_has_the_same_layout_whatever_was_before(task, make) -> None:
    env, seen = begun(task, STARTS[task][:2])
    rule = make(env.config)
    together, _ = rule.predict(seen)
    for k in (1, 0):
        np.testing.assert_array_equal(rule.predict(seen[k : k + 1])[0][0], together[k])
        np.testing.assert_array_equal(make(env.config).predict(seen[k])[0], together[k])


def test_it_leads_along_a_path_that_rolling_strays_from() -> None:
    starts = [SINE, {**SINE, "parcel": "B", "path": LaneChange(0.3, 2.0)}]
    found, rolling = run(BestTracking(SHOWN), SHOWN, starts), run_rule("track", FIXED, starts)
    assert found.success.all()
    assert not rolling.success.all()
    for figure in ("rms_error", "speed_error"):
        assert (found.metrics[figure] < 0.5 * rolling.metrics[figure]).all()


def test_on_mirrored_paths_it_ends_in_mirror_images() -> None:
    starts, images = mirrored_starts("track")
    assert_mirrored(BestTracking(SHOWN), SHOWN, (starts[:1], images[:1]), 5e-3)


def test_a_shown_path_is_the_path_and_the_rest_is_tracks() -> None:
    """In the benchmark its task is the same with the path shown."""
    seen, plain = (begun(task, [SINE], actions="modules")[1] for task in (ShownPath(), "track"))
    np.testing.assert_array_equal(seen[:, : plain.shape[1]], plain)
    start = SHOWN.decode_start(seen[0])
    assert start.parcel == box("S")
    speed, first, step = start.goal
    assert speed == pytest.approx(0.8)
    assert start.path is not None
    x = first + step * np.arange(len(start.path))
    np.testing.assert_allclose([x[0], x[-1]], [WAVE.start, WAVE.end], atol=1e-5)
    np.testing.assert_allclose(start.path, WAVE.y(x), atol=1e-5)
    np.testing.assert_allclose(start.pose, [WAVE.start, LINE_Y, 0.0], atol=1e-6)
    assert np.hypot(*start.velocity[:2]) == pytest.approx(0.8, abs=1e-5)
    assert start.tilt == pytest.approx(0.22, abs=1e-6)
    task = find_benchmark("track").task
    method = next(each for each in rules("track") if each.observed_task is not None)
    config = method.config(task, PRESETS["camera"])
    assert isinstance(config.task, ShownPath)
    assert isinstance(task, Track)
    assert (config.task.tilts, config.task.kinds) == (task.tilts, task.kinds)


@pytest.mark.parametrize(
    ("make", "given", "named"),
    [
        (BestTracking, {"task": "stop"}, "task must be one of 'track'"),
        (BestTracking, {"task": "track"}, "task must be a ShownPath"),
        (BestTracking, {"actions": "window"}, "actions must be one of 'modules'"),
        (BestTracking, {"zone": (3, 40)}, "zone must be None"),
        (BestTracking, {"orientations": (0.0, 1.0)}, "orientations must hold"),
        (GradedLayout, {"task": "sort"}, "orientations must be one of 'any', got None"),
        (GradedLayout, {"task": "sort", **BY_HALVES}, "actions must be one of 'modules', got 'ha"),
        (GradedLayout, {"task": "slow"}, "task must be one of 'sort', got 'slow'"),
    ],
    ids=str,
)
def test_they_refuse_what_they_are_not_made_for(make, given, named) -> None:
    with pytest.raises(ValueError, match=named):
        make(EnvConfig(**{"task": ShownPath(), **given}))


def test_a_search_goes_on_where_every_copy_has_ended():
    """On the first path of `evaluate.py --quick`, all copies of the search end on the way."""
    (exact,) = (each for each in start_scenarios("track", QUICK) if each.preset == "exact")
    (best,) = (each for each in all_methods("track") if each.name == BEST_FIXED)
    assert len(exact.play(best, best.seeds[0])) == exact.episodes(best)
