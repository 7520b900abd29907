"""The planner: the start that it decodes, the plans that it finds, and that it follows them."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.agents.planning.models import NominalModel
from surface_gym.agents.planning.planner import Planner, keep_best
from surface_gym.agents.rollout import Episodes
from surface_gym.config import EnvConfig
from surface_gym.tasks import Sort, Task
from surface_gym.tasks.paths import Sine
from surface_gym.tasks.planning import time_cost
from surface_gym.tasks.track import PLAN_CROSS_ERROR, PLAN_CROSS_SPEED, PLAN_SPEED_ERROR
from tests.agents.rules.runs import run, run_rule
from tests.environments import PITCH

WAVE = {"path": Sine(0.15, 2.2, start=0.5, end=2.0), "tilt": 0.22, "speed": 0.8}
STARTS: dict[str, dict[str, Any]] = {
    "sort": {"speed": 1.2, "side": -1}, "slow": {"speed": 1.5, "ratio": 0.45},
    "stop": {"speed": 1.1, "position": 1.4}, "orient": {"speed": 1.5, "angle": -0.6}, "track": WAVE,
}  # fmt: skip
SMALL = 8  # a budget that finds something soon


def planned(task: str, starts: list[dict[str, Any]], budget: int = SMALL) -> Episodes:
    env_config = EnvConfig(task=task, actions="halves")
    return run(Planner(env_config, budget), env_config, starts)


def begun(task: str, parcel: str) -> tuple[sg.SmartSurfaceEnv, np.ndarray, dict[str, Any]]:
    """An env some random periods after a start, where the parcel moves askew."""
    env = sg.SmartSurfaceEnv(task=task, actions="halves")
    observation, info = env.reset(seed=0, options={**STARTS[task], "parcel": parcel})
    for action in np.random.default_rng(3).integers(16, size=8):
        observation, _, ended, _, info = env.step(int(action))
        assert not ended
    return env, observation, info


@pytest.mark.parametrize("parcel", ["S", "B"])
@pytest.mark.parametrize("task", STARTS)
def test_what_is_seen_is_where_the_parcel_is(task, parcel) -> None:
    env, observation, info = begun(task, parcel)
    start = env.config.decode_start(observation)
    np.testing.assert_allclose(start.velocity, info["velocity"], atol=1e-6)
    np.testing.assert_allclose(start.pose[2], info["pose"][2], atol=1e-6)
    apart = np.array(start.pose[:2]) - info["pose"][:2]
    if task != "track":
        np.testing.assert_allclose(apart, 0.0, atol=1e-6)
        assert start.parcel is sg.layouts.box(parcel)
        goals = [STARTS[task][name] for name in STARTS[task] if name != "speed"]
        np.testing.assert_allclose(start.goal[0], goals[0], atol=1e-6)
        return
    np.testing.assert_allclose(apart / PITCH, np.round(apart / PITCH), atol=1e-5)
    assert start.tilt == pytest.approx(WAVE["tilt"], abs=1e-6)
    # The path as rebuilt runs as far from the parcel as the true one, here and 0.3 m ahead.
    speed, first_x, step = start.goal
    assert speed == pytest.approx(WAVE["speed"], abs=1e-6)
    assert start.path is not None
    for ahead, exact in ((0.0, 1e-4), (0.3, 5e-3)):
        x = first_x + step * np.arange(len(start.path))
        rebuilt = np.interp(start.pose[0] + ahead, x, start.path) - start.pose[1]
        true = WAVE["path"].y(info["pose"][0] + ahead) - info["pose"][1]
        assert rebuilt == pytest.approx(true, abs=exact)


def test_even_the_least_budget_sorts_what_the_best_event_does() -> None:
    least = (("S", 0.36, 1), ("S", 0.36, -1), ("B", 0.52, 1), ("B", 0.52, -1), ("S", 1.5, 0))
    starts = [{"parcel": parcel, "speed": speed, "side": side} for parcel, speed, side in least]
    assert planned("sort", starts, budget=1).success.all()


def test_it_sorts_no_later_than_the_event_rule_and_the_fixed_layout() -> None:
    starts = [
        {"parcel": parcel, "speed": speed, "side": 1}
        for parcel, speed in (("S", 0.9), ("S", 2.7), ("B", 1.5))
    ]
    others = run_rule("sort", "event rule", starts), run_rule("sort", "fixed layout", starts)
    found = planned("sort", starts)
    for each in (found, *others):
        assert each.success.all()
        assert (found.time <= each.time + 1e-9).all()


@pytest.mark.parametrize(
    ("task", "figure", "most"),
    [
        ("slow", "ratio_error", 0.005), ("stop", "stop_error", 0.0005),
        ("orient", "angle_error", math.radians(1.0)), ("track", "rms_error", 0.004),
    ],
)  # fmt: skip
def test_it_is_exact(task, figure, most) -> None:
    runs = planned(task, [{**STARTS[task], "parcel": parcel} for parcel in "SB"], budget=24)
    assert runs.success.all()
    assert (np.abs(runs.metrics[figure]) <= most).all()


def test_it_parks() -> None:
    start = {"speed": 1.4, "ahead": 0.7, "aside": -0.1, "angle": 0.3}
    assert planned(
        "park", [{**start, "parcel": parcel} for parcel in "SB"], budget=24
    ).success.all()


def test_on_a_path_nodes_cost_their_errors_so_far() -> None:
    config = EnvConfig(task="track", actions="halves")
    env = sg.SmartSurfaceEnv(task="track", actions="halves")
    start = {"parcel": "S", "path": [(0.5, 1.0), (4.0, 1.0)], "tilt": 0.1, "speed": 0.8}
    observation, _ = env.reset(seed=0, options=start)
    model = NominalModel(config, 3)
    model.begin_at(config.decode_start(observation))
    for actions in ([15, 5, 10], [6, 9, 0], [10, 1, 5]):
        nodes = model.advance(np.arange(3), np.array(actions))
    figures = dict(zip(config.task.metrics, nodes.parcels.metrics.T, strict=True))
    terms = (
        figures["rms_error"] / PLAN_CROSS_ERROR,
        figures["speed_error"] / PLAN_SPEED_ERROR,
        nodes.parcels.truth[:, 4] / PLAN_CROSS_SPEED,
    )
    assert min(np.abs(term).max() for term in terms) > 0.1
    expected = sum(term**2 for term in terms)
    np.testing.assert_allclose(config.task.cost().running(nodes), expected, rtol=1e-3)


def test_of_nodes_that_are_alike_one_is_kept() -> None:
    config = EnvConfig(task="stop", actions="halves")
    env = sg.SmartSurfaceEnv(task="stop", actions="halves")
    observation, _ = env.reset(seed=0, options={**STARTS["stop"], "parcel": "S"})
    model = NominalModel(config, 8)
    model.begin_at(config.decode_start(observation))
    nodes = model.advance(np.zeros(8, dtype=np.int64), np.full(8, 15))
    nodes.parcels.state[1:7, :6] += np.diag([0.01, 0.01, 0.05, 0.025, 0.025, 0.25])
    cost, runs = config.task.cost(), np.ones(8, dtype=bool)
    assert sorted(keep_best(cost, nodes, runs, 8)) == [0, 1, 2, 3, 4, 5, 6]
    assert len(keep_best(cost, nodes, runs, 3)) == 3


class Late(Sort):
    def cost(self) -> Any:
        return replace(super().cost(), final=lambda nodes: -time_cost(nodes), enough=-np.inf)


class Bare(Task):
    features = Sort.features
    terms = ("nothing",)
    outcomes = ("nothing",)
    goals = 1


def test_a_task_of_the_users_has_a_planner_by_its_hooks() -> None:
    start = [{"speed": 1.2, "side": 1, "parcel": "S"}]
    configs = [EnvConfig(task=task, actions="halves") for task in (Sort(), Late())]
    soon, late = (run(Planner(config, SMALL), config, start) for config in configs)
    assert soon.success.all()
    assert late.time[0] > soon.time[0]
    with pytest.raises(ValueError, match=r"Bare\.cost must be a method, as Task says"):
        Bare().cost()
    with pytest.raises(ValueError, match=r"Bare\.decode_start must be a method, as Task says"):
        replace(configs[0], task=Bare()).decode_start(np.zeros(len(configs[0].features)))


def test_each_environment_is_planned_by_itself() -> None:
    starts = [
        {"parcel": "S", "speed": 1.4, "angle": 0.3}, {"parcel": "B", "speed": 1.6, "angle": -0.5},
    ]  # fmt: skip
    together = planned("orient", starts)
    for i, start in enumerate(starts):
        np.testing.assert_array_equal(planned("orient", [start]).path(0), together.path(i))


def follow(planner: Planner, periods: int) -> tuple[Any, np.ndarray]:
    """The planner's state after some periods of Stop, and all observations (periods + 1, ...)."""
    env = sg.SmartSurfaceEnv(task="stop", actions="halves")
    observation, _ = env.reset(seed=0, options={**STARTS["stop"], "parcel": "S"})
    state, seen = None, [observation]
    for _ in range(periods):
        action, state = planner.predict(observation, state)
        observation, *_ = env.step(action)
        seen.append(observation)
    return state, np.array(seen)


def test_what_was_planned_happens_and_is_followed_and_all_else_is_planned_anew() -> None:
    planner = Planner(EnvConfig(task="stop", actions="halves"), SMALL)
    state, seen = follow(planner, periods=12)
    _, later = planner.predict(seen[-1], state)
    ((plan, given),), ((same_plan, given_later),) = state, later
    assert same_plan is plan
    assert (given, given_later) == (12, 13)
    np.testing.assert_allclose(seen, plan.seen[: len(seen)], atol=1e-3)
    slower = seen[-1].copy()
    slower[3] -= 0.1  # m/s
    for observation, begins in ((slower, None), (seen[-1], np.array([True]))):
        ((anew, given),) = planner.predict(observation, state, begins)[1]
        assert anew is not plan
        assert given == 1
    with pytest.raises(ValueError, match="shorter"):  # a plan for one of two environments
        planner.predict(seen[-2:], state)


@pytest.mark.parametrize("budget", [0, -3, 2.5, True])
def test_a_budget_is_at_least_one_node(budget) -> None:
    with pytest.raises(ValueError, match="budget must be a whole number of at least 1"):
        Planner(EnvConfig(task="sort", actions="halves"), budget)
    with pytest.raises(ValueError, match="actions must be one of 'halves'"):
        Planner(EnvConfig(task="sort", actions="modules"))
