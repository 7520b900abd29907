"""MuJoCo against the analytic model, and against itself."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import validation
from surface_gym.validation.comparison import IMPLICIT, MUJOCO, compute_errors
from surface_gym.validation.simulation import static_sag

pytestmark = pytest.mark.usefixtures("mujoco")

START = (0.125, 1.0, 0.0)
BOX = sg.Parcel(sg.Rectangle(0.25, 0.25), mass=5.48)


@pytest.mark.parametrize("name", ["tilted", "pushed"])
def test_a_run_agrees_with_the_implicit_method(name, request):
    error = compute_errors([request.getfixturevalue(name)], IMPLICIT)
    assert (np.abs(error.absolute) < [5.0, 4.0, 2.5]).all()  # [mm, mm, deg]
    bound = [0.75, 1.5, 2.0] if name == "tilted" else [1.0, 2.5, 6.0]
    assert (np.abs(error.percent) < bound).all()


def test_the_trajectory_is_that_of_simulate(pushed):
    ours, theirs = pushed.by[MUJOCO], pushed.by[IMPLICIT]
    np.testing.assert_array_equal(ours.pose[0], theirs.pose[0])
    np.testing.assert_array_equal(ours.velocity[0], theirs.velocity[0])
    assert ours.time[-1] == pytest.approx(theirs.time[-1])
    assert (ours.end, ours.tipping.any()) == (theirs.end, False)
    speed = np.gradient(ours.pose, ours.time, axis=0)
    np.testing.assert_allclose(ours.velocity[5:-5], speed[5:-5], atol=0.02)


def test_a_mirrored_layout_mirrors_the_path():
    zones = (sg.layouts.sorting(side=side) for side in (-1, 1))
    runs = (validation.simulate(zone, BOX, START, (1.2, 0.0, 0.0), 0.4) for zone in zones)
    down, up = (run.pose[-1] - START for run in runs)
    np.testing.assert_allclose(up, down * [1.0, -1.0, -1.0], atol=1e-6)
    assert down[1] < -0.05


@pytest.mark.parametrize(
    ("one", "other", "tolerance"),
    [
        (sg.Rectangle(0.25, 0.2), sg.Polygon(sg.Rectangle(0.25, 0.2).outline), 1e-6),
        (sg.Disc(0.14), sg.Polygon(sg.Disc(0.14).outline), 2e-3),
    ],
    ids=["box", "disc"],
)
def test_a_mesh_moves_as_the_shape_it_stands_for(one, other, tolerance):
    parcels, velocity = [sg.Parcel(base, inertia=0.1) for base in (one, other)], (1.0, 0.0, 0.0)
    layout = sg.layouts.sorting()
    runs = [validation.simulate(layout, each, START, velocity, 0.3) for each in parcels]
    np.testing.assert_allclose(runs[0].pose[-1], runs[1].pose[-1], atol=tolerance)


@pytest.mark.parametrize("tilt_direction", [0.0, 1.0])
def test_any_layout_and_parcel_agree_with_simulate(tilt_direction):
    rng = np.random.default_rng(3)
    axis, rotor = rng.uniform(-math.pi, math.pi, (20, 40)), rng.random((20, 40)) < 0.7
    surface = sg.Surface(axis, rotor, tilt=math.radians(6.0), tilt_direction=tilt_direction)
    parcel = sg.Parcel(sg.Disc(0.22), mass=3.0, com_offset=(0.03, 0.01), com_height=0.05)
    start, velocity = (0.6, 1.0, 7.0), (1.0, 0.2, 2.0)
    light = validation.Recipe().lighter_rotors(1000.0)
    ours = validation.simulate(surface, parcel, start, velocity, 0.4, light)
    theirs = sg.simulate(surface, parcel, start, velocity, 0.4, 1e-3)
    moved = theirs.pose[-1] - theirs.pose[0]
    assert not theirs.tipping.any()
    np.testing.assert_allclose(ours.pose[-1] - ours.pose[0], moved, rtol=0.01)


def test_the_run_ends_where_the_surface_does_or_at_its_duration():
    surface = sg.layouts.sorting(columns=34)
    run = validation.simulate(surface, BOX, (3.2, 1.0, 0.0), (1.5, 0.0, 0.0), 0.5)
    assert run.end == "left the surface"
    assert run.tipping[-1]
    assert run.pose[-1, 0] == pytest.approx(3.4, abs=1e-3)
    run = validation.simulate(surface, BOX, START, duration=0.00125)  # the last step is shorter
    assert len(run.time) == 14
    assert run.time[-1] == pytest.approx(0.00125)


@pytest.mark.parametrize(
    ("tops", "stiffness", "sag"),
    [
        ([0.0, 0.0, 0.0, 0.0], [1.0, 1.0, 1.0, 1.0], 1.0),  # four springs that carry 4
        ([0.0, 0.0, 0.0, 0.0], [1.0, 2.0, 1.0, 4.0], 0.5),
        ([1.0, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 1.0], 0.0),
        ([0.0, 2.0, 0.0, 0.0], [1.0, 1.0, 1.0, 1.0], 0.5),  # 2.5 + 3 x 0.5 = 4
        ([0.0, 0.0, 5.0, 0.0], [1.0, 1.0, 1.0, 1.0], -1.0),  # the highest carries all
    ],
)
def test_the_base_sinks_until_the_springs_carry_it(tops, stiffness, sag):
    assert static_sag(np.array(tops), np.array(stiffness), 4.0) == pytest.approx(sag)


def test_what_is_not_allowed_is_refused():
    for change, message in (
        ({"pose": (9.0, 1.0, 0.0)}, "pose must be on the surface"),
        ({"pose": (-0.1, 1.0, 0.0)}, "pose must be on the surface"),
        ({"pose": (1.0, 1.0)}, "pose must have the shape"),
        ({"velocity": (math.inf, 0.0, 0.0)}, "velocity must be finite"),
        ({"duration": 0.0}, "duration must be greater than 0"),
        ({"recipe": validation.Recipe(step=1e-3)}, "recipe.step must be at most 5.5e-04 s"),
    ):
        with pytest.raises(ValueError, match=message):
            validation.simulate(sg.layouts.sorting(), BOX, **({"pose": START} | change))


def test_driven_modules_agree_with_surface_velocities():
    """Belts of random speed and direction, some of them idle, beside MuJoCo's static geoms whose
    surfaces move.
    """
    rng = np.random.default_rng(1)
    light, shape, away = validation.Recipe().lighter_rotors(1000.0), (20, 40), []
    for _ in range(6):
        rotor = rng.random(shape) < 0.9
        speed, way = rng.uniform(0.2, 1.2, 10), rng.uniform(-0.8, 0.8, 10)
        belts = np.repeat(speed[:, np.newaxis] * np.column_stack([np.cos(way), np.sin(way)]), 4, 0)
        velocity = np.tile(belts, (shape[0], 1, 1))
        velocity[~rotor | (rng.random(shape) < 0.3)] = math.nan
        axis = rng.choice(np.radians([0.0, 45.0, -45.0, 90.0]), shape)
        surface = sg.Surface(axis, rotor, surface_velocity=velocity)
        parcel = sg.Parcel(sg.Rectangle(*rng.uniform(0.25, 0.4, 2)), com_height=0.05)
        start = (0.6, 1.0, rng.uniform(-3.0, 3.0)), (rng.uniform(0.0, 1.5), 0.0, 0.5), 0.5
        ours, theirs = (
            run.pose[-1]
            for run in (
                validation.simulate(surface, parcel, *start, light),
                sg.simulate(surface, parcel, *start, 1e-3),
            )
        )
        away.append([1e3 * math.dist(ours[:2], theirs[:2]), math.degrees(abs(ours[2] - theirs[2]))])
    assert (np.median(away, axis=0) < 1.0).all()  # [mm, deg]
    assert (np.max(away, axis=0) < [4.0, 1.5]).all()
