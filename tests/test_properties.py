"""What holds for `simulate` in any scene: symmetry, energy, rest, and the same bits again."""

import math
from dataclasses import replace

import numpy as np
from hypothesis import given, strategies as st

import surface_gym as sg
from tests import worlds
from tests.strategies import COLUMNS, ROWS, Scene, scenes


def mirrored(scene: Scene) -> Scene:
    """The scene seen in a mirror along x, the middle of the rows staying where it is."""
    surface, parcel = scene.surface, scene.parcel
    base = parcel.base
    if isinstance(base, sg.Polygon):
        base = sg.Polygon(base.vertices * [1.0, -1.0])
    middle = surface.y.mean()
    x, y, theta = scene.pose
    vx, vy, omega = scene.velocity
    offset_x, offset_y = parcel.com_offset
    return Scene(
        surface=replace(
            surface,
            axis=-surface.axis[::-1],
            rotor=surface.rotor[::-1],
            stiffness=None if surface.stiffness is None else surface.stiffness[::-1],
            tilt_direction=-surface.tilt_direction,
        ),
        parcel=replace(parcel, base=base, com_offset=(offset_x, -offset_y)),
        pose=(x, 2.0 * middle - y, -theta),
        velocity=(vx, -vy, -omega),
    )


def quarter_turned(scene: Scene) -> Scene:
    """The scene turned by 90 deg about the origin, its slope with it."""
    x, y, theta = scene.pose
    vx, vy, omega = scene.velocity
    return Scene(
        surface=worlds.quarter_turned(scene.surface),
        parcel=scene.parcel,
        pose=(-y, x, theta + math.pi / 2),
        velocity=(-vy, vx, omega),
    )


def same_length(first: sg.Trajectory, second: sg.Trajectory) -> None:
    assert first.end == second.end
    np.testing.assert_array_equal(first.time, second.time)


@given(scene=scenes())
def test_mirror_symmetry(scene):
    run, mirror = scene.run(), mirrored(scene).run()
    same_length(run, mirror)
    flip = np.array([1.0, -1.0, -1.0])
    expected = run.pose * flip + [0.0, 2.0 * scene.surface.y.mean(), 0.0]
    np.testing.assert_allclose(mirror.pose, expected, rtol=0.0, atol=1e-8)


@given(scene=scenes())
def test_a_scene_may_be_turned(scene):
    run, turned = scene.run(), quarter_turned(scene).run()
    same_length(run, turned)
    x, y, theta = run.pose.T
    expected = np.column_stack([-y, x, theta + math.pi / 2])
    np.testing.assert_allclose(turned.pose, expected, rtol=0.0, atol=1e-8)


@given(scene=scenes(), columns=st.integers(-50, 50), rows=st.integers(-50, 50))
def test_a_scene_may_be_moved(scene, columns, rows):
    shift = np.array([0.1 * columns, 0.1 * rows, 0.0])
    origin = (scene.surface.origin[0] + shift[0], scene.surface.origin[1] + shift[1])
    moved = replace(scene.on(origin=origin), pose=tuple(scene.pose + shift))
    run, other = scene.run(), moved.run()
    same_length(run, other)
    np.testing.assert_allclose(other.pose, run.pose + shift, rtol=0.0, atol=1e-8)


@given(scene=scenes(), turns=st.integers(-3, 3))
def test_neither_whole_turns_nor_the_sense_of_an_axis_matter(scene, turns):
    shift = np.array([0.0, 0.0, 2.0 * math.pi * turns])
    other = replace(scene, pose=tuple(scene.pose + shift)).on(axis=scene.surface.axis + math.pi)
    run, turned = scene.run(), other.run()
    same_length(run, turned)
    np.testing.assert_allclose(turned.pose, run.pose + shift, rtol=0.0, atol=1e-8)


@given(scene=scenes(), mass=st.floats(1e-3, 1e6))
def test_mass_cancels_out(scene, mass):
    other = replace(scene, parcel=replace(scene.parcel, mass=mass))
    assert scene.run().pose.tobytes() == other.run().pose.tobytes()


@given(scene=scenes(), exponent=st.integers(-20, 20))
def test_only_ratios_of_stiffness_count(scene, exponent):
    stiffness = np.ones((ROWS, COLUMNS))
    if scene.surface.stiffness is not None:
        stiffness = scene.surface.stiffness
    run, other = scene.run(), scene.on(stiffness=stiffness * 2.0**exponent).run()
    same_length(run, other)
    np.testing.assert_allclose(other.pose, run.pose, rtol=0.0, atol=1e-8)


@given(scene=scenes(flat=True))
def test_energy_never_grows_on_a_flat_surface(scene):
    parcel = replace(scene.parcel, com_offset=(0.0, 0.0))
    if isinstance(parcel.base, sg.Polygon):  # its frame's origin at the centre of mass
        parcel = replace(parcel, base=sg.Polygon(parcel.base.vertices - parcel.base.centroid))
    run = replace(scene, parcel=parcel).run()
    gyration = parcel.moment_of_inertia / parcel.mass
    energy = run.velocity**2 @ [0.5, 0.5, 0.5 * gyration]
    assert (np.diff(energy) <= 1e-9 * energy[0]).all()


@given(scene=scenes())
def test_no_step_takes_more_energy_than_a_fall_without_friction_gives(scene):
    run = scene.run()
    run_of = run.run
    velocity = run_of.states[:, 3:6]
    pull = np.array([scene.surface.grid.gravity_x, scene.surface.grid.gravity_y, 0.0])
    fall = velocity[:-1] + np.diff(run.time)[:, np.newaxis] * pull
    weights = [0.5, 0.5, 0.5 * scene.parcel.body.gyration]
    after, most = velocity[1:] ** 2 @ weights, fall**2 @ weights
    assert (after <= most + 1e-9 * (most + 1e-6)).all()


@given(scene=scenes(flat=True))
def test_rest_on_a_flat_surface_stays_rest(scene):
    run = replace(scene, velocity=(0.0, 0.0, 0.0)).run()
    np.testing.assert_array_equal(run.velocity, 0.0)
    np.testing.assert_allclose(run.pose - scene.pose, 0.0, atol=1e-15)


@given(scene=scenes(), exponent=st.integers(-300, -13))
def test_motion_stays_finite_at_the_smallest_speeds(scene, exponent):
    run = replace(scene, velocity=tuple(10.0**exponent * np.array(scene.velocity))).run(0.05)
    assert np.isfinite(run.pose).all()
    assert np.isfinite(run.velocity).all()


@given(scene=scenes())
def test_no_step_of_a_usual_length_is_refused(scene):
    scene.run(duration=0.5, dt=0.01)


@given(scene=scenes())
def test_friction_forces_are_within_coulombs_bound(scene):
    """Conserved vertical load bounds the acceleration of the centre of mass."""
    parcel = replace(scene.parcel, base=sg.Disc(0.25), com_offset=(0.0, 0.0))
    run = replace(scene, parcel=parcel).run()
    grid = scene.surface.grid
    acceleration = np.diff(run.velocity[:, :2], axis=0) / np.diff(run.time)[:, np.newaxis]
    friction = np.hypot(*(acceleration - [grid.gravity_x, grid.gravity_y]).T)
    most = math.hypot(scene.surface.mu_max, scene.surface.mu_min) * grid.gravity_normal
    assert (friction <= most * (1.0 + 1e-6)).all()


@given(scene=scenes())
def test_surfaces_of_any_size_give_the_same_bits(scene):
    around = ((0, 40), (0, 60))
    axis, rotor = np.pad(scene.surface.axis, around), np.pad(scene.surface.rotor, around)
    scene = scene.on(stiffness=None)
    small, large = scene.run(0.2), scene.on(axis=axis, rotor=rotor).run(0.2)
    clear = np.abs(small.pose[:, :2] - [1.0, 0.8]).max() < 0.2  # from the small one's edge
    assert not clear or small.pose.tobytes() == large.pose.tobytes()
