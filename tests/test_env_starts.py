"""The single environment: what a reset may fix, and how bad input is met."""

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import surface_gym as sg
from surface_gym.randomisation import Actuators, Randomisation
from tests import environments as te

# By the name that the error says.
BAD_OPTIONS: dict[str, tuple[Any, ...]] = {
    "options": ({"velocity": 1.0}, {3: 1.0}, [("speed", 1.0)], "speed"),
    "speed": tuple(
        {"speed": value}
        for value in ("fast", None, True, math.nan, math.inf, -0.1, 5.1, [1.0, 1.0])
    ),
    "parcel": tuple(
        {"parcel": value} for value in ("M", None, 3, sg.Rectangle(0.2, 0.2), np.zeros(3))
    ),
}
BAD_SORT_OPTIONS: dict[str, tuple[Any, ...]] = {
    "side": tuple({"side": value} for value in (0.5, 0.0, 1.0, 2, "left", True, None)),
    "parcel": tuple(
        {"parcel": sg.Parcel(base)} for base in (sg.Rectangle(2.0, 0.3), sg.Disc(0.31))
    ),
    "options": ({"ratio": 0.5},),
}
EVERY_BAD_OPTION = [
    *((env_id, name, bad) for env_id in te.IDS for name, bad in BAD_OPTIONS.items()),
    *((te.SORT, name, bad) for name, bad in BAD_SORT_OPTIONS.items()),
]


class TestOptions:
    @te.every_id
    def test_they_fix_every_start_exactly(self, env_id):
        assert set(te.OPTIONS[env_id]) == set(te.bare(env_id).config.task.options)
        runs = []
        for seed in (0, 1):
            env = te.bare(env_id)
            env.action_space.seed(0)
            run = [env.reset(seed=seed, options=te.OPTIONS[env_id])]
            run += [env.step(env.action_space.sample()) for _ in range(5)]
            runs.append(tuple(run))
        te.assert_same(*runs)

    @te.every_id
    def test_the_last_start_is_forgotten(self, env_id):
        env, fresh = te.bare(env_id), te.bare(env_id)
        env.reset(seed=0, options={"parcel": te.TRIANGLE, "speed": 2.0})
        env.step(env.action_space.sample())
        te.assert_same(env.reset(seed=7), fresh.reset(seed=7))

    @te.every_id
    def test_speed(self, env_id):
        env = te.bare(env_id)
        for speed in (0.35, 1, np.float32(1.5), 2.7):
            vx, vy, omega = env.reset(seed=0, options={"speed": speed})[1]["velocity"]
            assert np.hypot(vx, vy) == pytest.approx(float(speed), rel=1e-15)  # along a path, too
            assert omega == 0.0

    def test_side(self):
        env = te.bare()
        for side in (1, -1, np.int64(1), np.int8(-1)):
            for seed in range(4):
                assert env.reset(seed=seed, options={"side": side})[0][-1] == side

    @pytest.mark.parametrize("size", ["S", "B", np.str_("B")])
    def test_the_papers_boxes_enter_as_in_the_paper(self, size):
        env = te.bare()
        _, info = env.reset(seed=0, options={"parcel": size})
        np.testing.assert_allclose(info["pose"], sg.layouts.start(size), rtol=1e-15)
        named = env.reset(seed=0, options={"parcel": sg.layouts.box(size)})
        te.assert_same(env.reset(seed=0, options={"parcel": size}), named)

    @te.every_id
    @pytest.mark.parametrize("parcel", te.PARCELS.values(), ids=te.PARCELS)
    def test_a_parcel_of_ones_own(self, env_id, parcel):
        env = te.bare(env_id)
        env.reset(seed=0, options={"parcel": parcel, "speed": 1.0})
        for _ in range(10):
            observation, _, terminated, _, info = env.step(env.action_space.sample())
            assert observation in env.observation_space
            assert np.isfinite(info["pose"]).all()
            if terminated:
                break

    @pytest.mark.parametrize(("env_id", "named", "bad"), EVERY_BAD_OPTION)
    def test_bad_ones_are_named(self, env_id, named, bad):
        env, twin = te.pair(env_id=env_id)
        for options in bad:
            with pytest.raises(ValueError, match=named):
                env.reset(seed=1, options=options)
            for _ in range(2):
                action = env.action_space.sample()
                te.assert_same(env.step(action), twin.step(action))
            te.assert_same(env.reset(seed=2), twin.reset(seed=2))


class TestBadActions:
    OF_HALVES = (
        -1, 16, 2**40, 3.0, math.nan, True, None, "roll", [3], [3, 3], {}, np.array(3.0),
    )  # fmt: skip
    OF_OTHERS = (3, [], [[3]], "roll", None, {}, math.nan)

    @staticmethod
    def refused(env: sg.SmartSurfaceEnv, twin: sg.SmartSurfaceEnv, action: Any) -> None:
        """It is named, and leaves the environment as its twin, which has not seen it."""
        with pytest.raises(ValueError, match="action"):
            env.step(action)
        good = te.same_choice(env, te.MINUS_45)
        after = env.step(good)
        te.assert_same(after, twin.step(good))
        if after[2]:
            te.assert_same(env.reset(), twin.reset())

    @te.every_cell
    def test_they_are_named(self, env_id, actions, sensor):
        env, twin = te.pair(env_id=env_id, actions=actions, sensors=sensor())
        if actions == "halves":
            for action in self.OF_HALVES:
                self.refused(env, twin, action)
            return
        good = te.same_choice(env, te.ROLL)
        ragged = [[3], *[3] * (len(good) - 1)]
        for action in (*self.OF_OTHERS, ragged, good[:-1], [*good, 3], good[np.newaxis]):
            self.refused(env, twin, action)
        for value in (-1, 4, 2**40):
            for place in (0, -1):
                changed = good.copy()
                changed[place] = value
                self.refused(env, twin, changed)
        for kind in (float, bool, object, str):
            self.refused(env, twin, good.astype(kind))
        self.refused(env, twin, np.full(len(good), np.nan))

    def test_any_whole_numbers_will_do(self):
        env, twin = te.pair(**te.cell(te.SORT, "quadrants"))
        action = np.array([0, 1, 2, 3])
        wanted = action.tolist()
        for kind in (np.int8, np.uint8, np.int32, np.uint64):
            te.assert_same(env.step(action.astype(kind)), twin.step(wanted))


# By the name of the argument.
BAD_ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "task": ("fly", 3),
    "actions": ("fingers", None, ["modules"]),
    "sensors": ("exact", None, te.SENSORS[0]),
    "control_period": (0.0, -0.04, math.inf, math.nan, "fast"),
    "zone": ((0, 100_000), (-1, 5), (6, 5), (3,), (3, 4, 5), (3.0, 5.0), 5, "all"),
    "orientations": (
        (), (0.0,), (0.0, math.nan), (0.0, "up"), ((0.0, 1.0), (1.0,)), 1.0, "some", ("any",),
    ),
    "actuators": (
        Actuators(stuck=((20, 3),)), Actuators(stuck=((3, 1000),)), 0.5, Actuators,
    ),
    "randomisation": (0.2, Randomisation(size=0.4), {"friction": 0.2}),
    "render_mode": ("ansi", True),
}  # fmt: skip


@pytest.mark.parametrize("argument", BAD_ARGUMENTS)
@pytest.mark.parametrize("env_type", [sg.SmartSurfaceEnv, sg.SmartSurfaceVectorEnv])
def test_bad_arguments_are_named(env_type, argument):
    named = {"actuators": "stuck|actuators", "randomisation": "size|randomisation"}
    for value in BAD_ARGUMENTS[argument]:
        with pytest.raises(ValueError, match=f"^({named.get(argument, argument)}) must"):
            env_type(**{argument: value})


def test_an_unknown_argument_is_a_type_error():
    with pytest.raises(TypeError, match="unexpected keyword argument 'friction'"):
        gym.make(te.SORT, friction=0.2)
