"""How an axis obeys: it turns at a finite rate through the angles between, or is stuck."""

import math
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.core.batch import Batch
from surface_gym.layouts import LINE_Y
from surface_gym.randomisation import Actuators
from surface_gym.state import RUNNING
from surface_gym.tasks.start import Start
from tests.environments import MINUS_45, PLUS_45, ROLL, assert_same, bare, put, steps

ZERO = 0  # the choice of the axis along x
FLAT_BOX = sg.Parcel(sg.Rectangle(0.25, 0.25), com_height=0.0)  # nothing shifts its load


class Bench:
    """One environment whose axes can be looked at."""

    def __init__(self, **settings: Any) -> None:
        self.settings = EnvConfig(actions="quadrants", **settings)
        self.batch = Batch(self.settings, 1)
        self.batch.reset_cache.seed(0, np.random.default_rng(0))
        self.place()

    def place(self, speed: float = 0.0, parcel: sg.Parcel = FLAT_BOX, x: float = 0.6) -> None:
        put(self.batch, Start(parcel, (x, LINE_Y, 0.0), (speed, 0.0, 0.0), (1.0,)))

    def step(self, choice: int) -> None:
        self.batch.parcels.outcome[0] = RUNNING  # whatever becomes of the parcel
        self.batch.step(np.full((1, self.settings.action_kind.size), choice))

    @property
    def angle(self) -> np.ndarray:
        """(rows, columns) [rad] of each axis, in [0, pi)."""
        return self.batch.axes(0) % np.pi

    @property
    def obeying(self) -> np.ndarray:
        return self.batch.view(0).obeys


class TestAxisSpeed:
    def test_infinite_turns_at_once(self):
        bench = Bench()
        for choice, degrees in ((MINUS_45, 135.0), (PLUS_45, 45.0), (ZERO, 0.0), (ROLL, 90.0)):
            bench.step(choice)
            np.testing.assert_allclose(np.degrees(bench.angle[bench.obeying]), degrees)
            np.testing.assert_allclose(bench.angle[~bench.obeying], np.pi / 2)

    @pytest.mark.parametrize(
        ("choice", "sense", "turn"), [(PLUS_45, -1, 45.0), (MINUS_45, +1, 45.0), (ZERO, 0, 90.0)]
    )
    @pytest.mark.parametrize("speed", [60.0, 100.0, 450.0])  # [deg/s]
    def test_finite_takes_the_time_it_takes(self, speed, choice, sense, turn):
        """From the conveyor's 90 deg by the shorter way; either way to 0 deg is as short."""
        bench = Bench(actuators=Actuators(axis_speed=math.radians(speed)), control_period=0.02)
        for period in range(1, math.ceil(turn / (speed * 0.02)) + 3):
            bench.step(choice)
            turned = np.degrees(bench.angle[bench.obeying] - np.pi / 2)
            assert np.ptp(turned) == 0.0
            due = min(turn, speed * 0.02 * period)
            turned = sense * turned if sense else np.abs(turned)
            np.testing.assert_allclose(turned, due, rtol=0, atol=1e-9)
            np.testing.assert_array_equal(bench.angle[~bench.obeying], np.pi / 2)

    def test_a_new_command_on_the_way_turns_it_from_where_it_is(self):
        bench = Bench(actuators=Actuators(axis_speed=math.radians(500.0)))
        bench.step(PLUS_45)  # 40 ms: 20 deg down
        np.testing.assert_allclose(np.degrees(bench.angle[bench.obeying]), 70.0)
        bench.step(MINUS_45)  # 65 deg up to 135 deg
        np.testing.assert_allclose(np.degrees(bench.angle[bench.obeying]), 90.0)
        for _ in range(3):
            bench.step(MINUS_45)
        np.testing.assert_allclose(np.degrees(bench.angle[bench.obeying]), 135.0)

    def test_a_start_finds_the_conveyor_again(self):
        bench = Bench(actuators=Actuators(axis_speed=3.0))
        for _ in range(5):
            bench.step(ZERO)
        bench.place()
        np.testing.assert_array_equal(bench.angle, np.pi / 2)
        bench.step(ROLL)
        np.testing.assert_array_equal(bench.angle, np.pi / 2)

    def test_a_turning_axis_acts_by_the_angle_it_has(self):
        """Beside `simulate` one step at a time, on surfaces turned a step's angle further each."""
        speed = math.radians(200.0)
        bench = Bench(actuators=Actuators(axis_speed=speed))
        bench.place(speed=1.0)
        parcels = bench.batch.parcels
        pose, velocity = parcels.truth[0, :3].copy(), parcels.truth[0, 3:].copy()
        for number in range(1, 41):
            turned = min(math.pi / 4, number * speed * 0.005)
            axis = np.where(bench.obeying, math.pi / 2 + turned, math.pi / 2)
            surface = sg.Surface(axis, bench.batch.view(0).rotor.copy())
            run = sg.simulate(surface, FLAT_BOX, pose, velocity, duration=0.005)
            pose, velocity = run.pose[-1], run.velocity[-1]
            if number % 8 == 0:
                bench.step(MINUS_45)
                np.testing.assert_allclose(parcels.truth[0, :3], pose, rtol=0, atol=1e-10)
        assert pose[1] > LINE_Y + 0.01  # it did act


class TestStuck:
    STUCK = ((9, 5), (10, 8))

    @pytest.mark.parametrize("axis_speed", [math.inf, 20.0])
    def test_given_modules_never_turn(self, axis_speed):
        bench = Bench(actuators=Actuators(axis_speed=axis_speed, stuck=self.STUCK))
        free = Bench(actuators=Actuators(axis_speed=axis_speed))
        for choice in (PLUS_45, ZERO, MINUS_45, PLUS_45):
            bench.step(choice)
            free.step(choice)
            stuck = np.zeros_like(bench.obeying)
            for row, column in self.STUCK:
                assert bench.angle[row, column] == np.pi / 2
                stuck[row, column] = True
            np.testing.assert_array_equal(bench.obeying, free.obeying & ~stuck)
            np.testing.assert_array_equal(bench.angle[~stuck], free.angle[~stuck])

    @pytest.mark.parametrize("stuck", [((0, 0),), ((9, 0), (10, 29)), ((9, 5), (9, 5))])
    def test_a_support_or_the_conveyor_may_be_stuck_too(self, stuck):
        twin = Actuators(stuck=((9, 5),)) if (9, 5) in stuck else Actuators()
        runs = [
            tuple(steps(bare(actuators=each), seed=0)) for each in (Actuators(stuck=stuck), twin)
        ]
        assert_same(*runs)

    @pytest.mark.parametrize("share", [0.1, 0.5, 1.0])
    def test_a_share_is_drawn_at_each_start(self, share):
        bench = Bench(actuators=Actuators(stuck_share=share))
        zone = Bench().obeying
        drawn = []
        for _ in range(500):
            bench.place()
            assert not bench.obeying[~zone].any()
            drawn.append(~bench.obeying[zone])
        stuck = np.array(drawn)  # (starts, modules)
        spread = math.sqrt(share * (1.0 - share))
        assert stuck.mean() == pytest.approx(share, abs=4.0 * spread / math.sqrt(stuck.size))
        np.testing.assert_allclose(stuck.mean(axis=0), share, atol=5.0 * spread / math.sqrt(500))
        # Module by module on its own: the count in a start is binomial.
        assert stuck.sum(axis=1).var() == pytest.approx(zone.sum() * spread**2, rel=0.3)

    def test_a_share_adds_to_those_given(self):
        bench = Bench(actuators=Actuators(stuck=self.STUCK, stuck_share=0.3))
        assert not any(bench.obeying[module] for module in self.STUCK)
        assert 0 < bench.obeying.sum() < Bench().obeying.sum() - 2


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("axis_speed", (0.0, -1.0, -math.inf, math.nan, "fast", None)),
        ("stuck", (((1, 2, 3),), ((1,),), (3, 5), 3, None, "all")),
        ("stuck", (((-1, 2),), ((1.0, 2),), ((True, 2),))),
    ],
)
def test_bad_arguments_are_named(name, values):
    for value in values:
        with pytest.raises(ValueError, match=f"^{name} must"):
            Actuators(**{name: value})


def test_a_stuck_module_must_lie_on_the_surface():
    EnvConfig(actuators=Actuators(stuck=((19, 29),)))
    for module in ((20, 0), (0, 30)):
        with pytest.raises(ValueError, match=r"stuck must lie in 20 rows and 30 columns"):
            EnvConfig(actuators=Actuators(stuck=(module,)))
