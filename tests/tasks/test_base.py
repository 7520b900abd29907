"""What holds for every task alike."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import surface_gym as sg
from surface_gym.registration import env_id
from surface_gym.state import COMMON_OUTCOMES
from surface_gym.tasks import TASKS
from surface_gym.tasks.base import rising
from surface_gym.tasks.paths import Sine
from surface_gym.tasks.start import Draw, check_options, parcel_option
from tests.environments import PLUS_45, ROLL, TRIANGLE, assert_same, bare, terms
from tests.tasks import BRAKE, draws, nth, play

# For each task: options that fix a start, and the goal that they make.
FIXED: dict[str, tuple[dict[str, Any], tuple[float, ...]]] = {
    "sort": ({"speed": 1.3, "parcel": "B", "side": -1}, (-1.0,)),
    "slow": ({"speed": 1.3, "parcel": "B", "ratio": 0.4}, (0.4, 1.3)),
    "stop": ({"speed": 1.3, "parcel": "B", "position": 1.2}, (1.2,)),
    "track": (
        {"speed": 1.3, "parcel": "B", "path": [(0.5, 0.9), (3.05, 0.9)], "tilt": 0.1},
        (1.3, 0.5, 0.01),
    ),
    "orient": ({"speed": 1.3, "parcel": "B", "angle": -0.4}, (-0.4,)),
    "park": (
        {"speed": 1.3, "parcel": "B", "ahead": 0.7, "aside": 0.1, "angle": -0.4},
        (1.1, 0.9, -0.4),
    ),
}
POSES = {
    "track": (0.5, 0.9, 0.0),
    "park": (0.4, 0.8, 0.0),
}  # of a B-box; on a line the rear is at 0
BAD_ARGUMENTS = {
    "sort": [("slow_share", 1.1), ("speeds", (0.0, 1.0)), ("slow_speeds", (1.0, 0.5))],
    "slow": [("speeds", (2.0, 1.0)), ("ratios", (0.5, 1.5))],
    "stop": [("speeds", (-1.0, 1.0)), ("speeds", 1.0)],
    "track": [
        ("speeds", (0.5, 6.0)), ("tilts", (0.0, 1.0)), ("kinds", ()), ("kinds", ("circle",)),
    ],
    "orient": [("angles", (-4.0, 0.0))],
    "park": [("angles", (-4.0, 0.0)), ("ahead", (0.5, 1.5)), ("aside", (0.2, -0.2))],
}  # fmt: skip

BAD_OPTIONS = {
    "slow": {"ratio": (-0.1, 1.1, math.nan, "half", None)},
    "stop": {"position": (-0.1, 3.1, math.inf, "there", None)},
    "orient": {"angle": (-3.2, 3.2, math.nan, "left", None)},
    "park": {"ahead": (-0.1, 1.5, math.nan, None), "aside": (-0.7, 0.7), "angle": (-3.2, 45)},
    "track": {
        "path": (
            "straight", None, [(0.5, 1.0)], [(2.0, 1.0), (1.0, 1.0)], [(-0.1, 1.0), (1.0, 1.0)],
            [(0.5, 1.0), (6.1, 1.0)], [(0.5, 1.0), (3.0, 2.1)], Sine(amplitude=1.2),
            [(0.5, 0.5), (0.8, 1.5)],  # too steep
        ),
        "tilt": (-0.01, 0.6),
        "speed": (0.05,),
    },
}  # fmt: skip

FRONT_HEAVY = sg.Parcel(sg.Rectangle(0.5, 0.25), com_offset=(0.1, 0.0))
AT_THE_EDGE = {"parcel": FRONT_HEAVY, "zone": (20, 26)}
# Failures before a goal is reached: options and the zone, the choice of every module, the outcome.
FAILURES: list[tuple[str, dict[str, Any], int, str]] = [
    ("orient", {"speed": 1.5, "angle": 0.1}, BRAKE, "stalled"),
    ("orient", {"speed": 1.5, "angle": 0.1}, PLUS_45, "off the line"),
    ("orient", {"speed": 1.5, "angle": 0.1, **AT_THE_EDGE}, ROLL, "off the surface"),
    ("slow", {"speed": 1.8, "ratio": 0.5}, BRAKE, "stalled"),
    ("slow", {"speed": 1.8, "ratio": 0.5}, PLUS_45, "off the line"),
    ("slow", {"speed": 2.0, "ratio": 0.5, **AT_THE_EDGE}, ROLL, "off the surface"),
    ("stop", {"speed": 1.5, "position": 1.0}, ROLL, "passed the asked x"),
    ("stop", {"speed": 2.0, "position": 2.5}, PLUS_45, "off the line"),
    ("stop", {"speed": 2.0, "position": 3.0}, ROLL, "off the surface"),
    ("sort", {"speed": 2.0, "side": 1, "zone": (20, 29)}, ROLL, "off the surface"),
]

every_task = pytest.mark.parametrize("name", TASKS)


class TestOptions:
    @every_task
    def test_fix_a_start_exactly(self, name):
        task, (options, goal) = TASKS[name](), FIXED[name]
        assert set(options) == set(task.options)
        for start in draws(task, 3, **options):
            assert start.goal == pytest.approx(goal, abs=1e-12)
            assert start.parcel is sg.layouts.box("B")
            assert start.velocity == (1.3, 0.0, 0.0)
            assert start.pose == pytest.approx(POSES.get(name, (0.225, 1.0, 0.0)), abs=1e-12)
            assert start.tilt == options.get("tilt", 0.0)
            assert len(start.goal) == task.goals

    @every_task
    def test_one_leaves_the_other_draws_as_they_are(self, name):
        task = TASKS[name]()
        for free, held in zip(draws(task, 9), draws(task, 9, parcel="B"), strict=True):
            assert (held.velocity[0], held.tilt) == (free.velocity[0], free.tilt)

    @pytest.mark.parametrize("name", BAD_OPTIONS)
    def test_bad_ones_of_a_task_are_named(self, name):
        env = bare(env_id(name))
        for option, values in BAD_OPTIONS[name].items():
            for value in values:
                with pytest.raises(ValueError, match=option):
                    env.reset(options={option: value})

    def test_helpers(self):
        assert parcel_option(TRIANGLE) is TRIANGLE
        assert parcel_option("S") is sg.layouts.box("S")
        assert check_options(None, ("speed",)) == {}
        assert rising("speeds", [1, 1], 0.0, 2.0) == (1.0, 1.0)
        with pytest.raises(ValueError, match="speeds must be two rising numbers between 0 and 2"):
            rising("speeds", (1.0, 2.1), 0.0, 2.0)


class TestArguments:
    @every_task
    def test_parcels_of_ones_own_are_drawn_and_bad_ones_named(self, name):
        task = TASKS[name](parcels=(TRIANGLE,))
        assert all(start.parcel is TRIANGLE for start in draws(task, 5))
        for argument, value in [*BAD_ARGUMENTS[name], ("parcels", ()), ("parcels", ("M",))]:
            with pytest.raises(ValueError, match=argument.removesuffix("s")):
                TASKS[name](**{argument: value})


class TestStarts:
    @every_task
    def test_a_seed_fixes_them_whatever_starts_with_them(self, name):
        task = TASKS[name]()
        assert_same(tuple(draws(task, 3, seed=5)), tuple(draws(task, 3, seed=5)))
        assert draws(task, 1, seed=5)[0].velocity != draws(task, 1, seed=6)[0].velocity
        numbers = np.random.default_rng(1).random((5, task.draws))
        together = task.start(Draw(numbers, (), task.line))
        for k in range(5):
            alone = task.start(Draw(numbers[k : k + 1], (), task.line))
            assert_same(tuple(nth(alone, 0, 1)), tuple(nth(together, k, 5)))


class TestEpisodes:
    @every_task
    def test_outcomes_ends_sums_and_bounds(self, name):
        env = bare(env_id(name))
        seen, outcomes = set(), (*COMMON_OUTCOMES, *TASKS[name].outcomes)
        for seed in range(12):
            # By turns at random, where most stall, and rolling, where most get through.
            episode = play(env, {}, ROLL if seed % 2 else None, seed=seed)
            for info in episode.infos:
                assert list(terms(info)) == list(TASKS[name].terms)
                assert all(math.isfinite(info[metric]) for metric in TASKS[name].metrics)
                assert info["outcome"] in outcomes
            outcome = episode.end["outcome"]
            forgiven = name == "slow" and outcome == "missed"  # it did leave the zone
            assert (episode.total("success") > 0.0) == (outcome == "success")
            assert (episode.total("failure") < 0.0) == (outcome != "success" and not forgiven)
            seen.add(outcome)
        assert seen <= {"success", *TASKS[name].outcomes}
        assert len(seen) >= 2

    @pytest.mark.parametrize(("name", "options", "choice", "outcome"), FAILURES)
    def test_failures_before_the_goal(self, name, options, choice, outcome):
        zone = options.get("zone")
        start = {key: value for key, value in options.items() if key != "zone"}
        episode = play(bare(env_id(name), zone=zone), {"parcel": "S", **start}, choice)
        assert episode.end["outcome"] == outcome
        assert episode.total("failure") == -1.0
        assert name == "sort" or episode.total("precision") == 0.0
        if zone is not None and name != "orient":
            # Half a step more would take the centre of mass past the edge.
            edge = 3.0 if name == "sort" else 2.9
            assert edge - 0.01 < episode.end["pose"][0] <= edge

    @every_task
    def test_time_running_out_truncates(self, name):
        env = gym.make(env_id(name), max_episode_steps=2)
        episode = play(env, FIXED[name][0], ROLL)
        assert [step[2:4] for step in episode.steps] == [(False, False), (False, True)]
        assert episode.end["outcome"] == "running"
        assert episode.total("failure") == 0.0

    @every_task
    def test_the_page_names_every_term_and_metric(self, name):
        page = TASKS[name].__doc__
        for section in ("Start", "Goal and end", "Reward"):
            assert f"### {section}\n" in page or f"**{section}.** " in page
        for term in TASKS[name].terms:
            assert f"| `{term}` |" in page
        for metric in TASKS[name].metrics:
            assert f"`{metric}` [" in page
