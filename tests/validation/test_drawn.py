"""What is drawn by chance: parcels that push each other, and Eq. (1) on uneven supports."""

import math
from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.physics.references import scipy_normal_forces
from surface_gym.validation import drawn
from surface_gym.validation.drawn import (
    CASES,
    UNEVEN,
    SurfaceDraw,
    draw_surfaces,
    ends,
    uneven_normal_forces,
)
from surface_gym.validation.simulation import simulate_together

SURFACE = sg.Surface(np.zeros((12, 14)), np.zeros((12, 14), dtype=bool))
POSES = [(0.3, 0.6, 0.0), (0.6, 0.6, 0.0)]
EVERYWHERE = np.ones((12, 14), dtype=bool)
needs_mujoco = pytest.mark.usefixtures("mujoco")
PARCEL = sg.Parcel(sg.Rectangle(0.25, 0.25), mass=2.0, com_height=0.05)


@needs_mujoco
@pytest.mark.parametrize(
    ("scene", "bounds"),
    [
        *((drawn.Meeting(seed), [(1.0, 0.5), (2.0, 1.0)]) for seed in (3, 6, 8, 19)),
        (drawn.Crowd(1), [(1.5, 0.5)] * 2),
    ],
    ids=str,
)
def test_parcels_that_push_each_other_end_as_in_mujoco(scene, bounds):
    """Within bounds [mm, deg] for each step of the model."""
    mujoco = ends(scene.mujoco())
    for dt, bound in zip(drawn.STEPS, bounds, strict=True):
        differences = drawn.UNIT * (ends(scene.analytic(dt)[-1].trajectories) - mujoco)
        assert (drawn.distances(differences) < bound).all()


def test_a_drawn_crowd_is_held_then_runs_into_itself():
    crowd = drawn.Crowd(3)
    parcels, poses = crowd.pile
    first, second, third = crowd.analytic(5e-3)
    assert 6 <= len(parcels) <= 12
    assert len(first.touches.time) > 40  # it lies in touch
    moved = [ends(run.trajectories) - poses for run in (first, second, third)]
    assert np.abs(moved[0]).max() < 0.01
    assert 0.03 < moved[1][:, 0].max() < 0.06
    assert len(third.touches.time) > 40
    np.testing.assert_array_equal(drawn.Crowd(3).pile[1], poses)


@needs_mujoco
def test_axes_turn_in_mujoco_when_they_are_to():
    """0.1 s along the slope hold the parcel; then it rolls down for 0.2 s."""
    surface = sg.Surface(np.zeros((10, 10)), np.ones((10, 10), dtype=bool), tilt=math.radians(6.0))
    parcel = sg.Parcel(sg.Rectangle(0.3, 0.25), com_height=0.05)
    (run,) = simulate_together(
        surface, [parcel], [(0.4, 0.5, 0.0)], np.zeros((1, 3)), 0.3, np.ones((10, 10), bool),
        drawn.CROWD_RECIPE, drawn.CROWD_SIDES, [(0.1, np.full((10, 10), math.pi / 2))],
    )  # fmt: skip
    pull = 9.81 * (math.sin(surface.tilt) - surface.mu_min * math.cos(surface.tilt))
    moved = run.pose[:, 0] - 0.4
    assert moved[run.time <= 0.1].max() < 1e-4
    assert moved[-1] == pytest.approx(0.5 * pull * 0.2**2, rel=0.02)


def test_the_parcels_of_a_meeting_touch_on_the_surface():
    seen = set()
    for seed in range(8):
        meeting = drawn.Meeting(seed)
        _, parcels, poses, velocities = meeting.drawn
        (encounter,) = meeting.analytic(2e-3)
        seen |= {type(parcel.base) for parcel in parcels}
        assert len(encounter.touches.time) > 0
        assert {trajectory.end for trajectory in encounter.trajectories} == {"duration"}
        assert poses.shape == velocities.shape == (2, 3)
        assert 0.5 <= velocities[0, 0] <= 2.0
    assert seen == {sg.Rectangle, sg.Disc, sg.Polygon}


@needs_mujoco
@pytest.mark.parametrize("base", [sg.Rectangle(0.25, 0.25), sg.Disc(0.125)], ids=["box", "disc"])
def test_what_has_hit_in_mujoco_stays_together(base):
    parcel = sg.Parcel(base, mass=2.0, com_height=0.05)
    velocities = [(1.0, 0.0, 0.0), (0.0, 0.0, 0.0)]
    runs = simulate_together(SURFACE, [parcel] * 2, POSES, velocities, 0.2, EVERYWHERE)
    pushed = [run.velocity[-1, 0] for run in runs]
    np.testing.assert_allclose(pushed, 0.49, atol=0.01)
    assert runs[1].pose[-1, 0] - runs[0].pose[-1, 0] == pytest.approx(0.25, abs=5e-4)
    assert not any(run.tipping.any() for run in runs)


@needs_mujoco
def test_a_run_that_diverges_is_named_and_what_is_not_allowed_refused(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes a log where it is
    motion = [(1e11, 0.0, 0.0), (0.0, 0.0, 0.0)]  # beyond what MuJoCo takes for a number
    with pytest.raises(RuntimeError, match=r"diverged at a step of 1e-05 s .* a smaller step"):
        simulate_together(SURFACE, [PARCEL] * 2, POSES, motion, 0.001, EVERYWHERE)
    poses, still = [(0.3, 0.6, 0.0)], [(0.0, 0.0, 0.0)]
    for count, velocities, duration, message in (
        (2, still, 0.1, r"poses must have the shape \(2, 3\), got \(1, 3\)"),
        (1, [0.0], 0.1, r"velocities must have the shape \(1, 3\), got \(1,\)"),
        (1, still, 0, "duration must be greater than 0, got 0"),
    ):
        with pytest.raises(ValueError, match=message):
            simulate_together(SURFACE, [PARCEL] * count, poses, velocities, duration, EVERYWHERE)


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


@pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
def test_level_supports_end_where_simulate_does():
    stiffness = np.exp(0.5 * np.random.default_rng(2).standard_normal((20, 40)))
    surface = replace(sg.layouts.sorting(tilt=0.15), stiffness=stiffness)
    parcel = sg.Parcel(sg.Rectangle(0.25, 0.25), com_offset=(0.02, 0.01))
    start, velocity = (0.125, 1.0, 0.2), (0.5, 0.0, 0.3)
    level = drawn.end_pose(surface, parcel, start, velocity, 0.5, np.zeros((20, 40)), 1.0, 2e-3)
    expected = sg.simulate(surface, parcel, start, velocity, 0.5, 2e-3).pose[-1]
    np.testing.assert_allclose(level, expected, atol=1e-5)


def test_draws_repeat_with_their_seed_and_spreads_are_from_the_even_surface():
    first, again = draw_surfaces(draws=3, seed=7), draw_surfaces(draws=3, seed=7)
    assert first == again
    np.testing.assert_array_equal(first[2].heights, again[2].heights)
    assert (first[1].heights != first[2].heights).all()
    uneven = {draw.unevenness: draw for draw in first}
    assert uneven[UNEVEN[2]].heights.std() == pytest.approx(20e-6, rel=0.1)
    assert np.log(uneven[UNEVEN[5]].surface.stiffness).std() == pytest.approx(1.2, rel=0.1)
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


@needs_mujoco
@pytest.mark.parametrize("uneven", [UNEVEN[1], UNEVEN[5]], ids=lambda uneven: uneven.name)
def test_mujoco_follows_the_model(uneven):
    even = drawn.run_draw(SurfaceDraw(CASES[0], drawn.EVEN, seed=0))
    poses = [drawn.run_draw(SurfaceDraw(CASES[0], uneven, seed)) for seed in (0, 1)]
    mujoco, analytic = np.moveaxis(np.array(poses) - even, 1, 0)
    moved = np.hypot(*mujoco.T[:2])
    assert (moved > 5e-3).all()  # [m]
    assert (np.hypot(*(mujoco - analytic).T[:2]) < 0.25 * moved).all()
