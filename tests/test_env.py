"""The single environment: Gymnasium's contract, physics, starts, seeds and bad input."""

import copy
import math
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as check_by_gymnasium
from stable_baselines3.common.env_checker import check_env as check_by_stable_baselines3

import surface_gym as sg
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.state import RUNNING, SUCCESS
from tests import environments as te


class TestCheckers:
    @te.every_cell
    def test_they_have_nothing_to_say(self, env_id, actions, sensor):
        env = te.bare(env_id, actions=actions, sensors=sensor())
        check_by_gymnasium(env, skip_render_check=True)
        check_by_stable_baselines3(env)

    @te.every_id
    @pytest.mark.usefixtures("screen")
    def test_nor_when_it_draws(self, env_id):
        check_by_gymnasium(te.bare(env_id, render_mode="rgb_array"))

    def test_they_are_heard_here(self):
        """A warning of theirs does fail a test: they warn of a wrapped environment."""
        with pytest.raises(UserWarning, match="is different from the unwrapped"):
            check_by_gymnasium(gym.make(te.SORT), skip_render_check=True)


class TestEpisodes:
    @te.every_cell
    def test_types_spaces_sums_and_outcomes(self, env_id, actions, sensor):
        env = te.bare(env_id, actions=actions, sensors=sensor())
        assert env.observation_space.dtype == np.float32
        for observation, reward, terminated, truncated, info in te.steps(env, seed=3, episodes=3):
            assert observation in env.observation_space
            assert observation.dtype == np.float32
            assert type(reward) is float
            assert type(terminated) is bool
            assert truncated is False
            assert all(type(term) is float for term in te.terms(info).values())
            assert reward == pytest.approx(math.fsum(te.terms(info).values()), abs=1e-12)
            assert type(info["is_success"]) is bool
            assert terminated == (info["outcome"] != "running")
            assert info["is_success"] == (info["outcome"] == "success")

    @te.every_id
    def test_what_it_returns_is_the_users_own(self, env_id):
        env, twin = te.pair(env_id=env_id)
        observation, info = env.reset(seed=0)
        for _ in range(3):
            observation[:] = np.nan
            info["pose"][:] = np.nan
            info["velocity"][:] = np.nan
            observation, reward, _, _, info = env.step(env.action_space.sample())
            te.assert_same(observation, (same := twin.step(twin.action_space.sample()))[0])
            te.assert_same((reward, info), (same[1], same[4]))

    @pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, te.by_pickle])
    def test_an_outcome_is_a_number_and_its_name(self, copied):
        env = te.bare(actions="halves")
        ended = te.played_out(env, 10, side=1, speed=1.5)[-1][4]["outcome"]
        outcome = copied(ended)
        for same in ("success", SUCCESS, ended, env.outcomes[SUCCESS]):
            assert outcome == same
            assert same == outcome
            assert (outcome != same) is False
        for other in ("running", RUNNING, env.outcomes[RUNNING]):
            assert outcome != other
        assert str(outcome) == f"{outcome}" == "success"
        assert len({outcome, "success"}) == 1
        both = np.array([outcome, env.outcomes[RUNNING]])
        assert both.dtype == np.int64
        assert both.tolist() == [SUCCESS, RUNNING]

    def test_time_counts_the_control_periods(self):
        for number, step in enumerate(te.steps(te.bare(control_period=0.03), seed=0), start=1):
            assert step[2] or step[4]["time"] == pytest.approx(0.03 * number)

    @pytest.mark.parametrize(
        ("arguments", "wrong", "message"),
        [
            ({}, [0, 1], r"shape \(64,\), got \(2,\)"),
            ({}, np.full(64, 4), r"between 0 and 3, got array\(\[4"),
            ({"actions": "halves"}, 16, "between 0 and 15, got 16"),
            ({"actions": "halves"}, [3], r"shape \(\), got \(1,\)"),
            ({"actions": "halves"}, "up", "whole numbers, got <U2: 'up'"),
            ({"orientations": "any", "actions": "quadrants"}, [0.0, 45.0, 0.0, 0.0], r"0.0\]; deg"),
            ({"task": "flow", "actions": "parcels"}, [0], r"shape \(48,\), got \(1,\)"),
            ({"task": "flow", "actions": "parcels", "gate": True}, 0, r"shape \(49,\), got \(\)"),
            (
                {"task": "flow", "actions": "parcels", "gate": True}, [0] * 48 + [9],
                "between 0 and 8 of the gate, got 9$",
            ),
        ],
    )  # fmt: skip
    @pytest.mark.usefixtures("uncompiled")
    def test_an_action_that_is_refused_is_spoken_of_as_one(self, arguments, wrong, message):
        env = sg.SmartSurfaceEnv(**arguments)
        env.reset(seed=0)
        with pytest.raises(ValueError, match=f"action must .*{message}"):
            env.step(wrong)

    def test_steps_out_of_turn_are_refused(self):
        env = te.bare(actions="halves")
        with pytest.raises(gym.error.ResetNeeded, match="reset"):
            env.step(0)
        te.played_out(env, 0, speed=2.7)
        with pytest.raises(gym.error.ResetNeeded, match="ended"):
            env.step(0)
        env.reset()
        env.step(0)


class TestSeeds:
    @te.every_id
    def test_starts_differ_from_seed_to_seed_and_from_reset_to_reset(self, env_id):
        env = te.bare(env_id)
        starts = [env.reset(seed=seed)[0] for seed in range(5)]
        starts += [env.reset()[0] for _ in range(5)]
        assert len(np.unique(starts, axis=0)) == 10

    def test_all_randomness_is_np_random(self):
        env = te.bare(actions="quadrants", sensors=te.SENSORS[-1](), **te.EVERYTHING_VARIES)
        first = list(te.steps(env, seed=1))
        env.reset(seed=1)
        env.np_random = np.random.Generator(np.random.PCG64(np.random.SeedSequence(1)))
        env.action_space.seed(1)
        env.reset()
        second = [env.step(env.action_space.sample()) for _ in first]
        te.assert_same(tuple(first), tuple(second))


class TestTwins:
    @pytest.mark.parametrize("twin_of", te.TWINS)
    @pytest.mark.parametrize("make", [gym.make, te.native])
    @te.every_varying
    def test_go_on_alike(self, env_id, sensor, make, twin_of):
        settings = {"actions": "quadrants", "sensors": sensor(), **te.EVERYTHING_VARIES}
        env = make(env_id, max_episode_steps=8, **settings)
        env.action_space.seed(0)
        env.reset(seed=0)
        for _ in range(4):
            env.step(env.action_space.sample())
        twin = twin_of(env)
        for _ in range(40):
            first = env.step(env.action_space.sample())
            te.assert_same(first, twin.step(twin.action_space.sample()))
            if make is gym.make and (first[2] or first[3]):
                te.assert_same(env.reset(), twin.reset())

    @pytest.mark.parametrize("twin_of", te.TWINS)
    @pytest.mark.parametrize("make", [te.bare, te.native])
    def test_go_their_own_ways(self, make, twin_of):
        env, reference = (make(actions="halves") for _ in range(2))
        for each in (env, reference):
            each.reset(seed=0, options={"parcel": te.TRIANGLE})
        twin, action = twin_of(env), env.action_space.sample()
        for _ in range(5):
            twin.step((action + 5) % 16)
        for _ in range(5):
            te.assert_same(env.step(action), reference.step(action))


class TestMemory:
    @te.every_sensor
    def test_does_not_grow(self, sensor):
        env = te.bare(sensors=sensor(), **te.PARCELS_VARY)
        env.action_space.seed(0)
        action = env.action_space.sample()

        def step() -> None:
            if env.step(action)[2]:
                env.reset()

        env.reset(seed=0)
        assert te.growth(step, 2_000, 3_000) < 20  # [bytes]: less than any object kept


class TestDrawing:
    def test_it_changes_nothing(self):
        drawn, plain = te.bare(render_mode="rgb_array"), te.bare()
        for first, second in zip(te.steps(drawn, seed=2), te.steps(plain, seed=2), strict=True):
            drawn.render()
            te.assert_same(first, second)

    @pytest.mark.parametrize("make", [te.bare, te.native])
    def test_there_is_none_without_a_mode_or_before_the_first_reset(self, make):
        env = make()
        env.reset(seed=0)
        with pytest.warns(UserWarning, match="without specifying any render mode"):
            assert env.render() is None
        env.close()
        env.close()  # twice is fine
        with pytest.raises(gym.error.ResetNeeded):
            make(render_mode="rgb_array").render()


class TestPhysics:
    @pytest.mark.parametrize("side", [1, -1])
    @pytest.mark.parametrize("speed", [0.6, 0.9, 1.5, 2.7])
    @pytest.mark.parametrize("size", ["S", "B"])
    def test_of_a_fixed_layout(self, size, speed, side):
        env = te.bare()
        _, info = env.reset(seed=0, options={"speed": speed, "parcel": size, "side": side})
        layout = sg.layouts.sorting(size, side, task_columns=16, columns=30)
        box = sg.layouts.box(size)
        run = sg.simulate(layout, box, info["pose"], (speed, 0.0, 0.0), duration=4.0)
        action = te.same_choice(env, te.MINUS_45 if side > 0 else te.PLUS_45)
        terminated = False
        number = 0
        while not terminated and number < 800:
            _, _, terminated, _, info = env.step(action)
            number = number + 8 if not terminated else round(info["time"] / 0.005)
            assert info["time"] == pytest.approx(run.time[number], abs=1e-12)
            np.testing.assert_array_equal(info["pose"], run.pose[number])
            np.testing.assert_array_equal(info["velocity"], run.velocity[number])
        # It ends with the first step none of whose contacts, midway, is a rotor.
        assert bool(info["is_success"]) == (not on_rotors(layout, size, run, number - 1))
        assert all(on_rotors(layout, size, run, step) for step in range(number - 1))

    def test_on_a_surface_tilted_in_any_direction(self):
        class Tilted(sg.tasks.Sort):
            def start(self, draw):
                return super().start(draw)._replace(tilt=0.05, tilt_direction=2.0)

        env = sg.SmartSurfaceEnv(Tilted())
        _, info = env.reset(seed=0, options={"speed": 1.5, "parcel": "S", "side": 1})
        flat = sg.layouts.sorting("S", 1, task_columns=16, columns=30)
        layout = replace(flat, tilt=0.05, tilt_direction=2.0)
        box = sg.layouts.box("S")
        run = sg.simulate(layout, box, info["pose"], (1.5, 0.0, 0.0), duration=1.0)
        for period in range(1, 13):
            info = env.step(te.same_choice(env, te.MINUS_45))[4]
            np.testing.assert_array_equal(info["pose"], run.pose[8 * period])
        level = sg.simulate(flat, box, run.pose[0], (1.5, 0.0, 0.0), duration=1.0)
        assert np.abs(level.pose[96] - run.pose[96]).max() > 0.01

    @pytest.mark.parametrize("parcel", te.PARCELS.values(), ids=te.PARCELS)
    def test_of_any_parcel_and_turning(self, parcel):
        """A conveyor all the way: the frame's pose agrees, the centroid's is what `info` has."""
        env = te.bare(zone=(29, 29))
        _, info = env.reset(seed=0, options={"parcel": parcel, "speed": 1.2, "side": 1})
        rotor = env.config.task.line.site(parcel.base, None).rotor
        conveyor = sg.Surface(np.full(rotor.shape, math.pi / 2), rotor)
        start = np.array(info["pose"]) - (*parcel.base.centroid, 0.0)
        run = sg.simulate(conveyor, parcel, start, (1.2, 0.0, 0.0), duration=1.0)
        for period in range(1, 25):
            _, _, terminated, _, info = env.step(te.same_choice(env, te.ROLL))
            assert not terminated
            x, y, theta = run.pose[8 * period]
            cosine, sine = math.cos(theta), math.sin(theta)
            com_x, com_y = parcel.base.centroid
            centroid = (x + cosine * com_x - sine * com_y, y + sine * com_x + cosine * com_y)
            np.testing.assert_allclose(info["pose"], [*centroid, theta], rtol=0, atol=1e-12)

    @pytest.mark.parametrize("actions", te.ACTIONS)
    def test_kinds_that_turn_all_modules_alike_move_it_alike(self, actions):
        found, wanted = (
            te.played_out(env, te.same_choice(env, te.MINUS_45), speed=1.5, parcel="S", side=1)
            for env in (te.bare(actions=actions), te.bare())
        )
        te.assert_same(tuple(step[4] for step in found), tuple(step[4] for step in wanted))

    def test_a_control_period_is_cut_into_equal_steps_of_at_most_5_ms(self):
        """12 ms make three steps of 4 ms."""
        env = te.bare(control_period=0.012)
        env.reset(seed=0, options={"speed": 1.0, "parcel": "S", "side": 1})
        layout = sg.layouts.sorting("S", 1, task_columns=16, columns=30)
        box = sg.layouts.box("S")
        run = sg.simulate(layout, box, sg.layouts.start("S"), (1.0, 0.0, 0.0), 0.6, dt=0.012 / 3)
        for period in range(1, 50):
            info = env.step(te.same_choice(env, te.MINUS_45))[4]
            np.testing.assert_array_equal(info["pose"], run.pose[3 * period])


def on_rotors(layout: sg.Surface, size: str, run: sg.Trajectory, step: int) -> bool:
    """Whether a rotor lies under the box half a step after a step's start."""
    pose = run.pose[step] + 0.0025 * run.velocity[step]
    rows, columns = np.nonzero(layout.rotor)
    x, y = te.ORIGIN + te.PITCH * columns, te.ORIGIN + te.PITCH * rows
    return bool((te.outside(sg.layouts.box(size).base, pose, x, y) <= 0.0).any())


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
