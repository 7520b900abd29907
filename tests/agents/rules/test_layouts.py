"""The best layouts that could be arranged beforehand, searched for each start."""

from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.agents.evaluation.benchmark import find_benchmark
from surface_gym.agents.evaluation.methods import BEST_FIXED, FIXED, rules
from surface_gym.agents.planning.layouts import ShownPath
from surface_gym.agents.rules.layouts import BestSlowing, BestStopping, BestTracking, BestTurning
from surface_gym.config import PRESETS, EnvConfig
from surface_gym.layouts import LINE_Y, box
from surface_gym.tasks import Track
from surface_gym.tasks.paths import LaneChange, Sine
from tests.agents.rules.runs import assert_mirrored, mirrored_starts, run, run_rule

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


def observed(config: EnvConfig, start: dict[str, Any]) -> np.ndarray:
    """What is seen at a start, (1, features)."""
    env = sg.SmartSurfaceVectorEnv(1, task=config.task, actions=config.actions)
    seen: np.ndarray = env.reset(seed=0, options=start)[0]
    return seen


@pytest.mark.parametrize("task", STARTS)
def test_none_of_the_studys_kind_does_better(task) -> None:
    best, fixed = (run_rule(task, name, STARTS[task]) for name in (BEST_FIXED, FIXED))
    assert (best.success >= fixed.success).all()
    assert best.success.sum() >= 2
    assert not fixed.success.all()
    errors, studys = (np.abs(each.metrics[FIGURES[task]]) for each in (best, fixed))
    ended = (best.outcome == fixed.outcome) | best.success
    assert (errors <= studys + 1e-6)[ended].all()


@pytest.mark.parametrize(
    ("task", "make"), [("slow", BestSlowing), ("stop", BestStopping), ("orient", BestTurning)]
)
def test_the_same_start_has_the_same_layout_whatever_was_before(task, make) -> None:
    config = EnvConfig(task=task)
    seen = [observed(config, start) for start in STARTS[task][:2]]
    rule = make(config)
    together, _ = rule.predict(np.concatenate(seen))
    for k in (1, 0):
        np.testing.assert_array_equal(rule.predict(seen[k])[0][0], together[k])
        np.testing.assert_array_equal(make(config).predict(seen[k][0])[0], together[k])


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
    seen, plain = observed(SHOWN, SINE), observed(EnvConfig(task="track", actions="modules"), SINE)
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


def test_in_the_benchmark_its_task_is_the_same_with_the_path_shown() -> None:
    task = find_benchmark("track").task
    method = next(each for each in rules("track") if each.observed_task is not None)
    config = method.config(task, PRESETS["camera"])
    assert isinstance(config.task, ShownPath)
    assert isinstance(task, Track)
    assert (config.task.tilts, config.task.kinds) == (task.tilts, task.kinds)


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"task": "stop"}, "task must be one of 'track'"),
        ({"task": "track"}, "task must be a ShownPath"),
        ({"actions": "window"}, "actions must be one of 'modules'"),
        ({"zone": (3, 40)}, "zone must be None"),
        ({"orientations": (0.0, 1.0)}, "orientations must hold"),
    ],
    ids=str,
)
def test_tracking_refuses_what_it_is_not_made_for(given, named) -> None:
    with pytest.raises(ValueError, match=named):
        BestTracking(EnvConfig(**{"task": ShownPath(), **given}))
