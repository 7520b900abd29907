"""The single environment moves a parcel as `simulate` does, to the bit."""

import math
from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from tests import environments as te


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
