"""The single environment: what a reset may fix, and how bad input is met."""

import math
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import surface_gym as sg
from surface_gym.randomisation import Actuators, Randomisation
from tests.environments import (
    ACTIONS,
    IDS,
    MINUS_45,
    OPTIONS,
    PARCELS,
    ROLL,
    SENSORS,
    SORT,
    TRIANGLE,
    assert_same,
    bare,
    every_id,
    same_choice,
)

BAD_OPTIONS: tuple[tuple[Any, str], ...] = (
    ({"velocity": 1.0}, "options"),
    ({3: 1.0}, "options"),
    ([("speed", 1.0)], "options"),
    ("speed", "options"),
    ({"speed": "fast"}, "speed"),
    ({"speed": None}, "speed"),
    ({"speed": True}, "speed"),
    ({"speed": math.nan}, "speed"),
    ({"speed": math.inf}, "speed"),
    ({"speed": -0.1}, "speed"),
    ({"speed": 1000.0}, "speed"),
    ({"speed": [1.0, 1.0]}, "speed"),
    ({"parcel": "M"}, "parcel"),
    ({"parcel": None}, "parcel"),
    ({"parcel": 3}, "parcel"),
    ({"parcel": sg.Rectangle(0.2, 0.2)}, "parcel"),
    ({"parcel": np.zeros(3)}, "parcel"),
)
BAD_SORT_OPTIONS: tuple[tuple[Any, str], ...] = (
    ({"side": 0.5}, "side"),
    ({"side": 2}, "side"),
    ({"side": "left"}, "side"),
    ({"side": True}, "side"),
    ({"side": None}, "side"),
    ({"parcel": sg.Parcel(sg.Rectangle(2.0, 0.3))}, "parcel"),
    ({"parcel": sg.Parcel(sg.Disc(0.31))}, "parcel"),
    ({"ratio": 0.5}, "options"),
)
EVERY_BAD_OPTION = [
    *((env_id, *bad) for env_id in IDS for bad in BAD_OPTIONS),
    *((SORT, *bad) for bad in BAD_SORT_OPTIONS),
]


class TestOptions:
    def test_the_table_below_covers_every_task_and_option(self) -> None:
        for env_id in IDS:
            assert set(OPTIONS[env_id]) == set(bare(env_id).config.task.options)

    @every_id
    def test_they_fix_every_start_exactly(self, env_id: str) -> None:
        runs = []
        for seed in (0, 1):
            env = bare(env_id)
            env.action_space.seed(0)
            run = [env.reset(seed=seed, options=OPTIONS[env_id])]
            run += [env.step(env.action_space.sample()) for _ in range(5)]
            runs.append(tuple(run))
        assert_same(*runs)

    @every_id
    def test_the_last_start_is_forgotten(self, env_id: str) -> None:
        env, fresh = bare(env_id), bare(env_id)
        env.reset(seed=0, options={"parcel": TRIANGLE, "speed": 2.0})
        env.step(env.action_space.sample())
        assert_same(env.reset(seed=7), fresh.reset(seed=7))

    @every_id
    @pytest.mark.parametrize("speed", [0.35, 1, np.float32(1.5), 2.7])
    def test_speed(self, env_id: str, speed: Any) -> None:
        _, info = bare(env_id).reset(seed=0, options={"speed": speed})
        vx, vy, omega = info["velocity"]
        assert np.hypot(vx, vy) == pytest.approx(float(speed), rel=1e-15)  # along a path, if any
        assert omega == 0.0

    @pytest.mark.parametrize("side", [1, -1, np.int64(1), np.int8(-1)])
    def test_side(self, side: int) -> None:
        for seed in range(4):
            observation, _ = bare().reset(seed=seed, options={"side": side})
            assert observation[-1] == side

    @pytest.mark.parametrize("size", ["S", "B", np.str_("B")])
    def test_the_papers_boxes_enter_as_in_the_paper(self, size: str) -> None:
        env = bare()
        _, info = env.reset(seed=0, options={"parcel": size})
        np.testing.assert_allclose(info["pose"], sg.layouts.start(size), rtol=1e-15)
        named = env.reset(seed=0, options={"parcel": sg.layouts.box(size)})
        assert_same(env.reset(seed=0, options={"parcel": size}), named)

    @every_id
    @pytest.mark.parametrize("parcel", PARCELS.values(), ids=PARCELS)
    def test_a_parcel_of_ones_own(self, env_id: str, parcel: sg.Parcel) -> None:
        env = bare(env_id)
        _, info = env.reset(seed=0, options={"parcel": parcel, "speed": 1.0})
        for _ in range(10):
            observation, _, terminated, _, info = env.step(env.action_space.sample())
            assert observation in env.observation_space
            assert np.isfinite(info["pose"]).all()
            if terminated:
                break

    @pytest.mark.parametrize(("env_id", "options", "named"), EVERY_BAD_OPTION)
    def test_bad_ones_are_named(self, env_id: str, options: Any, named: str) -> None:
        env, twin = bare(env_id), bare(env_id)
        for each in (env, twin):
            each.reset(seed=0)
            each.action_space.seed(0)
        with pytest.raises(ValueError, match=named):
            env.reset(seed=1, options=options)
        # The episode goes on as if nothing had been asked, and the next starts as ever.
        for _ in range(2):
            assert_same(env.step(env.action_space.sample()), twin.step(twin.action_space.sample()))
        assert_same(env.reset(seed=2), twin.reset(seed=2))


class TestBadActions:
    BAD = {
        "halves": [
            -1, 16, 2**40, 3.0, math.nan, True, None, "roll", [3], [3, 3], {}, np.array(3.0),
        ],
        "others": [
            3, [], [[3]], "roll", None, {}, math.nan,
        ],
    }  # fmt: skip

    @staticmethod
    def refused(env: sg.SmartSurfaceEnv, twin: sg.SmartSurfaceEnv, action: Any) -> None:
        """It is named, and leaves the environment as its twin, which has not seen it."""
        with pytest.raises(ValueError, match="action"):
            env.step(action)
        good = same_choice(env, MINUS_45)
        after, wanted = env.step(good), twin.step(good)
        assert_same(after, wanted)
        if after[2]:
            assert_same(env.reset(), twin.reset())

    def pair(self, env_id: str, actions: str) -> list[sg.SmartSurfaceEnv]:
        envs = [bare(env_id, actions=actions) for _ in range(2)]
        for env in envs:
            env.reset(seed=0)
            env.step(same_choice(env, ROLL))
        return envs

    @pytest.mark.parametrize("action", BAD["halves"], ids=repr)
    def test_of_halves(self, action: Any) -> None:
        self.refused(*self.pair(SORT, "halves"), action)

    @pytest.mark.parametrize("actions", [kind for kind in ACTIONS if kind != "halves"])
    @every_id
    def test_of_every_other_kind(self, env_id: str, actions: str) -> None:
        env, twin = self.pair(env_id, actions)
        good = same_choice(env, ROLL)
        ragged = [[3], *[3] * (len(good) - 1)]
        for action in (*self.BAD["others"], ragged, good[:-1], [*good, 3], good[np.newaxis]):
            self.refused(env, twin, action)
        for value in (-1, 4, 2**40):
            for place in (0, -1):
                changed = good.copy()
                changed[place] = value
                self.refused(env, twin, changed)
        for kind in (float, bool, object, str):
            self.refused(env, twin, good.astype(kind))
        self.refused(env, twin, np.full(len(good), np.nan))

    @pytest.mark.parametrize("kind", [np.int8, np.uint8, np.int32, np.uint64, list])
    def test_any_whole_numbers_will_do(self, kind: Any) -> None:
        env, twin = self.pair(SORT, "quadrants")
        action = np.array([0, 1, 2, 3])
        other = action.tolist() if kind is list else action.astype(kind)
        assert_same(env.step(other), twin.step(action))


class TestBadArguments:
    BAD: tuple[tuple[dict[str, Any], str], ...] = (
        ({"task": "fly"}, "task"),
        ({"task": 3}, "task"),
        ({"actions": "fingers"}, "actions"),
        ({"actions": None}, "actions"),
        ({"actions": ["modules"]}, "actions"),
        ({"sensors": "exact"}, "sensors"),
        ({"sensors": None}, "sensors"),
        ({"sensors": SENSORS[0]}, "sensors"),
        ({"control_period": 0.0}, "control_period"),
        ({"control_period": -0.04}, "control_period"),
        ({"control_period": math.inf}, "control_period"),
        ({"control_period": math.nan}, "control_period"),
        ({"control_period": "fast"}, "control_period"),
        ({"zone": (0, 100_000)}, "zone"),
        ({"zone": (-1, 5)}, "zone"),
        ({"zone": (6, 5)}, "zone"),
        ({"zone": (3,)}, "zone"),
        ({"zone": (3, 4, 5)}, "zone"),
        ({"zone": (3.0, 5.0)}, "zone"),
        ({"zone": 5}, "zone"),
        ({"zone": "all"}, "zone"),
        ({"orientations": ()}, "orientations"),
        ({"orientations": (0.0,)}, "orientations"),
        ({"orientations": (0.0, math.nan)}, "orientations"),
        ({"orientations": (0.0, "up")}, "orientations"),
        ({"orientations": ((0.0, 1.0), (1.0,))}, "orientations"),
        ({"orientations": 1.0}, "orientations"),
        ({"orientations": "some"}, "orientations"),
        ({"orientations": ("any",)}, "orientations"),
        ({"actuators": Actuators(stuck=((20, 3),))}, "stuck"),
        ({"actuators": Actuators(stuck=((3, 1000),))}, "stuck"),
        ({"actuators": 0.5}, "actuators"),
        ({"actuators": Actuators}, "actuators"),
        ({"randomisation": 0.2}, "randomisation"),
        ({"randomisation": Randomisation(size=0.4)}, "size"),
        ({"randomisation": {"friction": 0.2}}, "randomisation"),
        ({"render_mode": "ansi"}, "render_mode"),
        ({"render_mode": True}, "render_mode"),
    )

    @pytest.mark.parametrize(("argument", "named"), BAD)
    @pytest.mark.parametrize("env_type", [sg.SmartSurfaceEnv, sg.SmartSurfaceVectorEnv])
    def test_they_are_named(self, env_type: Callable[..., Any], argument: Any, named: str) -> None:
        with pytest.raises(ValueError, match=named):
            env_type(**argument)

    def test_an_unknown_argument_is_a_type_error(self) -> None:
        with pytest.raises(TypeError, match="friction"):
            gym.make(SORT, friction=0.2)
