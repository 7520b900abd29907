"""Eq. (1) on uneven supports, against hand calculation, `simulate` and MuJoCo."""

import math
from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.physics.references import scipy_normal_forces
from surface_gym.validation import drawn
from surface_gym.validation.drawn import CASES, UNEVEN, Draw, draw_surfaces, uneven_normal_forces

SQUARE = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
EQUAL = np.ones(4)


def test_equal_heights_give_eq_1_and_three_contacts_are_determinate():
    arms = np.random.default_rng(1).uniform(-0.2, 0.2, (9, 2))
    load = arms.mean(axis=0) + np.array([0.02, -0.01])
    flat, _ = scipy_normal_forces(arms, 9.81, load)
    uneven = uneven_normal_forces(arms, np.full(9, 3.0), np.ones(9), 9.81, load)
    np.testing.assert_allclose(uneven, flat, atol=1e-6)
    arms = np.array([[1.0, 0.0], [-1.0, 1.0], [-1.0, -1.0]])
    heights, stiffness = np.array([5.0, 0.0, -5.0]), np.array([1.0, 2.0, 0.5])
    forces = uneven_normal_forces(arms, heights, stiffness, 8.0, np.zeros(2))
    np.testing.assert_allclose(forces, [4.0, 2.0, 2.0], atol=1e-4)


@pytest.mark.parametrize(
    ("height", "stiffness", "expected"),
    [
        (1.0, EQUAL, [2.25, 1.75, 2.25, 1.75]),  # it warps the load by a quarter of its own
        (20.0, EQUAL, [4.0, 0.0, 4.0, 0.0]),  # high enough, the box rocks on a diagonal
        (0.0, [3.0, 1.0, 3.0, 1.0], [3.0, 1.0, 3.0, 1.0]),
    ],
)
def test_a_raised_corner_or_a_stiff_diagonal_bears_more(height, stiffness, expected):
    heights = np.array([height, 0.0, 0.0, 0.0])
    forces = uneven_normal_forces(SQUARE, heights, np.array(stiffness), 8.0, np.zeros(2))
    np.testing.assert_allclose(forces, expected, atol=1e-4)


def test_level_supports_end_where_simulate_does():
    stiffness = np.exp(0.5 * np.random.default_rng(2).standard_normal((20, 40)))
    surface = replace(sg.layouts.sorting(tilt=0.15), stiffness=stiffness)
    parcel = sg.Parcel(sg.Rectangle(0.25, 0.25), com_offset=(0.02, 0.01))
    start, velocity = (0.125, 1.0, 0.2), (0.5, 0.0, 0.3)
    level = drawn.end_pose(surface, parcel, start, velocity, 0.5, np.zeros((20, 40)), 1.0, 2e-3)
    expected = sg.simulate(surface, parcel, start, velocity, 0.5, 2e-3).pose[-1]
    np.testing.assert_allclose(level, expected, atol=1e-5)


def test_spreads_are_from_the_even_surface():
    draws = draw_surfaces(draws=2, seed=5)

    def shifted(by) -> float:
        return 1e3 * by.unevenness.height + by.unevenness.stiffness

    results = [np.full((2, 3), shifted(draw) + draw.case.tilt) for draw in draws]
    for spread in drawn.compare_draws(draws, results):
        shift = shifted(spread)
        expected = [1e3 * shift, 1e3 * shift, math.degrees(shift)]
        np.testing.assert_allclose(spread.mujoco, [expected, expected])
        distance, angle = drawn.root_mean_square(spread.analytic)
        assert distance == pytest.approx(math.hypot(*expected[:2]))
        assert angle == pytest.approx(expected[2])


def test_draws_repeat_with_their_seed():
    first, again = draw_surfaces(draws=3, seed=7), draw_surfaces(draws=3, seed=7)
    assert first == again
    np.testing.assert_array_equal(first[2].heights, again[2].heights)
    assert (first[1].heights != first[2].heights).all()
    uneven = {draw.unevenness: draw for draw in first}
    assert uneven[UNEVEN[2]].heights.std() == pytest.approx(20e-6, rel=0.1)
    assert np.log(uneven[UNEVEN[5]].surface.stiffness).std() == pytest.approx(1.2, rel=0.1)


@pytest.mark.parametrize("uneven", [UNEVEN[1], UNEVEN[5]], ids=lambda uneven: uneven.name)
def test_mujoco_follows_the_model(uneven):
    pytest.importorskip("mujoco", reason="MuJoCo, of the extra `validation`, is not installed")
    even = drawn.run_draw(Draw(CASES[0], drawn.EVEN, seed=0))
    poses = [drawn.run_draw(Draw(CASES[0], uneven, seed)) for seed in (0, 1)]
    mujoco, analytic = np.moveaxis(np.array(poses) - even, 1, 0)
    moved = np.hypot(*mujoco.T[:2])
    assert (moved > 5e-3).all()  # [m]
    assert (np.hypot(*(mujoco - analytic).T[:2]) < 0.25 * moved).all()
