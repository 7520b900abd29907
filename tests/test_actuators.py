"""Axes of real actuators: they wait under load, move in steps, and have play."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.layouts import ROLLING
from surface_gym.physics.references import scipy_normal_forces
from surface_gym.physics.types import GRAVITY
from tests import environments as te
from tests.environments import assert_same, bare, outside
from tests.flow import flows
from tests.test_axes import Bench

STEP = math.radians(1.8)  # of a stepper with 200 steps a turn
PLAY = math.radians(1.0)
REAL: dict[str, Any] = {
    "actions": "modules",
    "orientations": "any",
    "actuators": sg.Actuators(
        axis_speed=20.0, turns_loaded=False, step=math.radians(7.0), backlash=PLAY
    ),
}


class Axis:
    """An axis by itself: a list of positions, and a motor that drags it through its play."""

    def __init__(self, step: float, play: float) -> None:
        self.positions = [ROLLING + k * step for k in range(-200, 201)] if step else None
        self.play, self.motor, self.angle = play, ROLLING, ROLLING

    def turn(self, command: float) -> None:
        """Turn the motor in small parts; the axis follows when the play is used up."""
        target = command
        if self.positions is not None:
            target = min(self.positions, key=lambda each: abs(each - command))
        for motor in np.linspace(self.motor, target, 2000):
            self.angle = min(max(self.angle, motor - 0.5 * self.play), motor + 0.5 * self.play)
        self.motor = target


class TestRest:
    """Where axes come to rest, whatever their speed."""

    @pytest.mark.parametrize(("step", "play"), [(STEP, 0.0), (0.0, 0.1), (0.07, 0.05), (0.3, 0.4)])
    @pytest.mark.parametrize("speed", [math.inf, 3.0])
    def test_it_is_that_of_a_motor_with_play(self, step, play, speed):
        actuators = sg.Actuators(axis_speed=speed, step=step, backlash=play)
        bench = Bench("modules", orientations="any", actuators=actuators)
        axis = Axis(step, play)
        moved = []
        for command in np.random.default_rng(3).uniform(0.3, 1.4, 12).tolist():
            for _ in range(1 if speed == math.inf else 14):
                bench.step(command)
            before = axis.angle
            axis.turn(command)
            moved.append(axis.angle != before)
            np.testing.assert_allclose(bench.angle[bench.obeying], axis.angle, rtol=0, atol=1e-9)
            np.testing.assert_array_equal(bench.angle[~bench.obeying], ROLLING)
        assert sum(moved) >= 5
        assert play < 0.4 or not all(moved)  # the largest play swallows some commands

    def test_backlash_depends_on_the_side_it_comes_from(self):
        bench = Bench(actuators=sg.Actuators(backlash=PLAY))
        for choice, degrees in ((te.PLUS_45, 45.5), (2, 134.5), (te.PLUS_45, 45.5), (0, 0.5)):
            bench.step(choice)
            np.testing.assert_allclose(np.degrees(bench.angle[bench.obeying]), degrees, atol=1e-9)

    @pytest.mark.parametrize("step", [math.radians(1.8), math.radians(45.0), math.radians(0.9)])
    def test_steps_that_meet_the_orientations_change_nothing(self, step):
        plain, stepped = (
            tuple(te.steps(bare(info=("axes",), actuators=each), seed=1))
            for each in (sg.Actuators(axis_speed=15.0), sg.Actuators(axis_speed=15.0, step=step))
        )
        for one, other in zip(plain, stepped, strict=True):
            np.testing.assert_allclose(one[4]["pose"], other[4]["pose"], rtol=0, atol=1e-9)


TALL = sg.Parcel(sg.Rectangle(0.45, 0.45), mass=4.0, com_height=0.24)  # braking lifts its rear


def independent_loads(parcel: sg.Parcel, info: Any, rate: Any) -> tuple[Any, Any]:
    """Forces (rows, columns) [N] by another solver of Eq. (1), and what is under the base."""
    rows, columns = np.indices(info["axes"].shape)
    x, y = 0.05 + 0.1 * columns, 0.05 + 0.1 * rows
    pose = info["pose"]
    under = outside(parcel.base, pose, x, y, parcel.base.centroid) <= 1e-9
    arms = np.stack([x[under] - pose[0], y[under] - pose[1]], axis=1)
    load = -parcel.com_height / GRAVITY * np.asarray(rate)[:2]
    loads = np.zeros(under.shape)
    loads[under] = parcel.mass * scipy_normal_forces(arms, GRAVITY, load)[0]
    return loads, under


class TestWaiting:
    @pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
    @pytest.mark.parametrize("speed", [math.inf, 25.0])
    def test_an_axis_turns_exactly_while_nothing_presses_on_it(self, speed):
        """Control periods of one physics step, so that loads are seen before each step."""
        dt = 0.005
        env = bare(
            actions="modules", orientations="any", control_period=dt, info=("axes",),
            actuators=sg.Actuators(axis_speed=speed, turns_loaded=False),
        )  # fmt: skip
        _, info = env.reset(seed=0, options={"parcel": TALL, "speed": 1.4, "side": 1})
        obeys, rng = env.batch.view(0).obeys.copy(), np.random.default_rng(5)
        rate, waited, lifted = np.zeros(3), 0, 0
        for _ in range(120):
            loads, under = independent_loads(TALL, info, rate)
            before, action = info, rng.uniform(-1.5, 1.5, env.action_space.shape)
            target = np.full(obeys.shape, ROLLING)
            target[8:12, 5:21] = action.reshape(4, 16)
            came = before["axes"]
            *_, info = env.step(action)
            apart = (target - came + math.pi / 2) % math.pi - math.pi / 2
            due = came + np.clip(apart, -speed * dt, speed * dt)
            free = obeys & (loads == 0.0)
            wanted = np.where(free, due, came)
            sure = (loads == 0.0) | (loads > 1e-6)
            difference = (info["axes"] - wanted + math.pi / 2) % math.pi - math.pi / 2
            np.testing.assert_allclose(difference[sure], 0.0, rtol=0, atol=1e-9)
            waited += int((obeys & ~free).sum())
            lifted += int((obeys & under & free).sum())
            rate = (info["velocity"] - before["velocity"]) / dt
        assert waited > 100
        assert lifted > 10  # also under the base, an element without load turns

    def test_the_command_is_kept_until_the_parcel_has_gone(self):
        bench = Bench(actuators=sg.Actuators(turns_loaded=False))
        bench.place(speed=1.0, x=0.7)
        x, _, theta = bench.batch.parcels.truth[0, :3]
        columns = 0.05 + 0.1 * np.arange(bench.angle.shape[1])
        assert theta == 0.0
        bench.step(te.PLUS_45)
        under = bench.obeying & (np.abs(columns - x) <= 0.125)
        turned = np.isclose(bench.angle, math.pi / 4)
        on_rows = (bench.angle[:, np.abs(columns - x) <= 0.125] == math.pi / 2).any()
        assert on_rows
        assert under.any()
        assert turned[bench.obeying & (columns > x + 0.2)].all()
        for _ in range(25):
            bench.step(te.PLUS_45)
        assert bench.batch.parcels.truth[0, 0] > x + 0.3
        np.testing.assert_allclose(bench.angle[under], math.pi / 4)  # it has gone

    def test_without_load_it_is_as_any_axis(self):
        waits = Bench(actuators=sg.Actuators(axis_speed=9.0, turns_loaded=False))
        turns = Bench(actuators=sg.Actuators(axis_speed=9.0))
        for bench in (waits, turns):
            bench.place(x=2.7)  # behind the zone
        for choice in (te.PLUS_45, 0, te.MINUS_45, te.MINUS_45, te.ROLL):
            waits.step(choice)
            turns.step(choice)
            np.testing.assert_array_equal(waits.angle, turns.angle)

    @pytest.mark.parametrize("actions", ["modules", "parcels"])
    def test_under_streams_too(self, actions):
        flat = sg.Parcel(sg.Rectangle(0.25, 0.25), com_height=0.0)
        stream = sg.flow.stream.Stream(
            flows.DENSE.arrivals, parcels=((flat, 1.0),), speeds=flows.DENSE.speeds
        )
        env = flows.bare(
            actions=actions, stream=stream, control_period=0.005, info=("axes",),
            actuators=sg.Actuators(turns_loaded=False),
        )  # fmt: skip
        env.action_space.seed(0)
        env.reset(seed=0)
        batch, waited, turned = env.batch, 0, 0
        x, y = (a.ravel() for a in np.meshgrid(*places(env.unwrapped.config)))
        for number in range(300):
            present = np.nonzero(batch.streams.present[0])[0]
            poses = batch.parcels.truth[present, :3].copy()
            covered = np.zeros(x.size, dtype=bool)
            for pose in poses:
                covered |= outside(flat.base, pose, x, y) <= 1e-9
            covered = covered.reshape(batch.surfaces.angle.shape[1:])
            came = batch.surfaces.angle[0].copy()
            if number % 40 == 0:
                action = env.action_space.sample()
            env.step(action)
            moved = batch.surfaces.angle[0] != came
            wanted = batch.surfaces.target[0] != came
            np.testing.assert_array_equal(moved, wanted & ~covered)
            waited += int((wanted & covered).sum())
            turned += int(moved.sum())
        assert waited > 50
        assert turned > 10


class TestLoadLimit:
    def test_the_peak_is_the_largest_force_before_a_step_on_each_rotor(self):
        env = bare(control_period=0.005, info=("normal_forces", "load"))
        rng = np.random.default_rng(1)
        for start in ({"parcel": "B", "speed": 1.5}, {"parcel": "S", "speed": 1.0}):
            _, info = env.reset(seed=0, options=start)
            assert not info["peak_load"].any()
            rotor, largest = env.batch.view(0).rotor, np.zeros((20, 30))
            for _ in range(80):
                largest = np.maximum(largest, rotor * info["normal_forces"])
                info = env.step(rng.integers(0, 4, env.action_space.shape))[4]
                np.testing.assert_allclose(info["peak_load"], largest / GRAVITY, rtol=1e-14)
            assert (largest > 0.0).sum() > 10

    @pytest.mark.parametrize("waits", [True, False])
    def test_a_heavier_load_than_the_limit_is_a_fault_and_changes_nothing_else(self, waits):
        settings = {"actions": "quadrants", "control_period": 0.04, "info": ("load",)}
        free = sg.Actuators(axis_speed=20.0, turns_loaded=not waits)
        seen = list(te.steps(bare(**settings, actuators=free), seed=4))
        peaks = [step[4]["peak_load"].max() for step in seen]
        limit = 0.5 * (peaks[0] + peaks[-1])
        limited = replace(free, load_limit=limit)
        for one, other in zip(
            seen, te.steps(bare(**settings, actuators=limited), seed=4), strict=True
        ):
            info = dict(other[4])
            assert info.pop("overloaded") == (one[4]["peak_load"].max() > limit)
            assert_same((*one[:4], one[4]), (*other[:4], info))
        assert info["peak_load"].max() > limit > peaks[0]

    def test_it_is_in_the_info_of_many_and_of_streams(self):
        limit = sg.Actuators(load_limit=3.0)
        envs = te.native(num_envs=4, actuators=limit)
        envs.reset(seed=0)
        envs.action_space.seed(0)
        found = [envs.step(envs.action_space.sample())[4] for _ in range(8)]
        assert found[-1]["overloaded"].shape == (4,)
        assert found[-1]["overloaded"].dtype == np.bool_
        assert "peak_load" not in found[-1]
        assert "overloaded" not in bare().reset(seed=0)[1]

    def test_under_streams_it_is_that_of_another_solver(self):
        env = flows.bare(actions="parcels", control_period=0.005, info=("load",))
        env.action_space.seed(0)
        env.reset(seed=0)
        batch, largest = env.batch, 0.0
        *_, normal = batch.surfaces.conditions[0]
        downhill = batch.surfaces.conditions[0, 3:5]
        x, y = np.meshgrid(*places(env.config))
        rotor = batch.bodies.rotor[0]
        for number in range(200):
            for slot in np.nonzero(batch.streams.present[0])[0].tolist():
                parcel, state = batch.parcel(0, slot), batch.parcels.state[slot].copy()
                under = outside(parcel.base, batch.parcels.truth[slot, :3], x, y) <= 1e-9
                arms = np.stack([x[under] - state[0], y[under] - state[1]], axis=1)
                load = parcel.com_height / normal * (downhill - state[6:8])
                forces = parcel.mass * scipy_normal_forces(arms, normal, load)[0] / GRAVITY
                largest = max(largest, forces[rotor[under]].max(initial=0.0))
            if number % 40 == 0:
                action = env.action_space.sample()
            info = env.step(action)[4]
            assert info["peak_load"].max() == pytest.approx(largest, rel=1e-5)
        assert largest > 1.0


def places(config: EnvConfig) -> tuple[np.ndarray, np.ndarray]:
    """x and y [m] of a line's columns and rows."""
    line, at = config.chosen_line, config.chosen_line.geometry
    return at.x0 + at.pitch_x * np.arange(line.columns), at.y0 + at.pitch_y * np.arange(line.rows)


def test_many_are_as_one_and_continue_from_a_snapshot():
    envs = te.native(num_envs=5, **REAL)
    singles = [bare(**REAL) for _ in range(5)]
    for i, env in enumerate(singles):
        env.reset(seed=i)
    envs.reset(seed=0)
    envs.action_space.seed(0)
    actions = [envs.action_space.sample() for _ in range(12)]
    for action in actions:
        many = envs.step(action)
        for i, env in enumerate(singles):
            one = env.step(action[i])
            assert_same(many[0][i], one[0])
            assert float(many[1][i]) == float(one[1])
    batch, kept = envs.batch, envs.batch.snapshot()
    runs = []
    for _ in range(2):
        batch.restore(kept)
        for action in actions[:4]:
            batch.step(action)
        runs.append((batch.observation.copy(), batch.surfaces.angle.copy()))
    assert_same(*runs)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("turns_loaded", (1, "no", None)),
        ("step", (-0.1, 2.0, math.nan, "1")),
        ("backlash", (-0.1, 2.0, math.inf, None)),
        ("turn_energy", (-0.1, math.inf, None)),
        ("turn_life", (0.0, -1.0, math.nan)),
        ("load_limit", (0.0, -1.0, math.nan, "20")),
    ],
)
def test_bad_arguments_are_named(name, values):
    for value in values:
        with pytest.raises(ValueError, match=rf"^{name} must"):
            sg.Actuators(**{name: value})


@pytest.mark.parametrize("limit", [{"turns_loaded": False}, {"step": 0.1}, {"backlash": 0.1}])
def test_driven_modules_have_no_limits_of_axes(limit):
    with pytest.raises(ValueError, match=r"actuators must have turns_loaded=True.*got .*'steered'"):
        EnvConfig(modules="steered", actuators=sg.Actuators(**limit))


class TestWear:
    DATA = sg.Actuators(turn_energy=0.4, turn_life=1e5)

    @pytest.mark.parametrize("speed", [math.inf, 12.0])
    def test_turns_are_the_changes_of_commands(self, speed):
        """Beside a count in Python; a turn that is not over goes on without a new command."""
        env = bare(
            actions="modules", info=("turns", "axes"),
            actuators=replace(self.DATA, axis_speed=speed),
        )  # fmt: skip
        _, info = env.reset(seed=0, options={"parcel": "B", "speed": 1.5})
        assert not info["axis_turns"].any()
        rng, counts = np.random.default_rng(2), np.zeros(64)
        angle, target = np.full(64, ROLLING), np.full(64, ROLLING)
        orientations = np.array(env.config.chosen_orientations)
        for number in range(20):
            if number % 3 != 2:
                action = rng.integers(0, 4, 64)
            wanted = orientations[action]
            apart = np.abs((wanted - angle + math.pi / 2) % math.pi - math.pi / 2)
            counts += (apart > 1e-9) & (wanted != target)
            *_, over, _, info = env.step(action)
            angle, target = info["axes"][8:12, 5:21].ravel(), wanted
            np.testing.assert_array_equal(info["axis_turns"][8:12, 5:21].ravel(), counts)
            assert info["axis_turns"].sum() == counts.sum()
            assert info["axis_energy"] == pytest.approx(0.4 * counts.sum())
            assert info["axis_wear"] == pytest.approx(1e-5 * counts.max())
            if over:
                break
        assert counts.max() > 4
        assert not env.reset(seed=1)[1]["axis_turns"].any()

    def test_a_command_that_never_turns_an_axis_does_not_wear_it(self):
        actuators = replace(self.DATA, turns_loaded=False)
        env = bare(actions="quadrants", info=("turns", "axes"), actuators=actuators)
        _, info = env.reset(seed=0, options={"parcel": "B", "speed": 1.5})
        counts, wanted = np.zeros((20, 30)), 0
        for number in range(8):
            came = info["axes"]
            info = env.step(te.same_choice(env, 1 + number % 2))[4]
            counts += np.abs(info["axes"] - came) > 1e-9
            wanted += 64
            np.testing.assert_array_equal(info["axis_turns"], counts)
        assert 64 < counts.sum() < wanted

    def test_a_stream_counts_the_turns_that_it_tells(self):
        env = flows.bare(actions="parcels", info=("turns",), actuators=self.DATA)
        env.action_space.seed(0)
        env.reset(seed=0)
        for _ in range(40):
            info = env.step(env.action_space.sample())[4]
            assert info["axis_turns"].sum() == info["turns"]
        assert info["turns"] > 50

    def test_they_come_with_a_snapshot_and_one_by_one(self):
        settings: dict[str, Any] = {
            "actions": "quadrants", "info": ("turns",),
            "actuators": replace(self.DATA, axis_speed=9.0),
        }  # fmt: skip
        envs, single = te.native(num_envs=3, **settings), bare(**settings)
        envs.reset(seed=0)
        single.reset(seed=1)
        envs.action_space.seed(0)
        for _ in range(6):
            action = envs.action_space.sample()
            many, one = envs.step(action)[4], single.step(action[1])[4]
            assert_same(many["axis_turns"][1], one["axis_turns"])
            assert float(many["axis_energy"][1]) == one["axis_energy"]
        kept = envs.batch.snapshot()
        before = envs.batch.infos()["axis_turns"].copy()
        envs.batch.step(action[::-1].copy())
        envs.batch.restore(kept)
        assert_same(envs.batch.infos()["axis_turns"], before)
