"""Crowds that are held and let go, in MuJoCo and in the model."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.validation import crowds
from surface_gym.validation.drawn import UNIT, ends
from surface_gym.validation.simulation import simulate_together


def test_a_drawn_crowd_is_held_then_runs_into_itself():
    crowd = crowds.Crowd(3)
    first, second, third = crowd.pile.analytic(5e-3)
    assert 6 <= len(crowd.pile.parcels) <= 12
    assert len(first.touches.time) > 40  # it lies in touch
    moved = [ends(run.trajectories) - crowd.pile.poses for run in (first, second, third)]
    assert np.abs(moved[0]).max() < 0.01
    assert 0.03 < moved[1][:, 0].max() < 0.06
    assert len(third.touches.time) > 40
    np.testing.assert_array_equal(crowds.Crowd(3).pile.poses, crowd.pile.poses)


@pytest.mark.usefixtures("mujoco")
def test_a_crowd_ends_as_in_mujoco():
    crowd = crowds.Crowd(1)
    mujoco = ends(crowd.pile.mujoco())
    for dt in (1e-3, 5e-3):
        apart = UNIT * (ends(crowd.pile.analytic(dt)[-1].trajectories) - mujoco)
        assert np.hypot(apart[:, 0], apart[:, 1]).max() < 1.5  # [mm]
        assert np.abs(apart[:, 2]).max() < 0.5  # [deg]


@pytest.mark.usefixtures("mujoco")
def test_axes_turn_in_mujoco_when_they_are_to():
    """0.1 s along the slope hold the parcel; then it rolls down for 0.2 s."""
    surface = sg.Surface(np.zeros((10, 10)), np.ones((10, 10), dtype=bool), tilt=math.radians(6.0))
    parcel = sg.Parcel(sg.Rectangle(0.3, 0.25), com_height=0.05)
    (run,) = simulate_together(
        surface, [parcel], [(0.4, 0.5, 0.0)], np.zeros((1, 3)), 0.3, np.ones((10, 10), bool),
        crowds.RECIPE, crowds.SIDES, [(0.1, np.full((10, 10), math.pi / 2))],
    )  # fmt: skip
    pull = 9.81 * (math.sin(surface.tilt) - surface.mu_min * math.cos(surface.tilt))
    moved = run.pose[:, 0] - 0.4
    assert moved[run.time <= 0.1].max() < 1e-4
    assert moved[-1] == pytest.approx(0.5 * pull * 0.2**2, rel=0.02)
