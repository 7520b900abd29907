"""Driven modules beside closed solutions, another solver and a finer step."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import surface_gym as sg
from surface_gym.physics.types import GRAVITY, Array

MU = 0.5
FLAT = 1e-6  # [m] height of a centre of mass that shifts no load
AT_REST = (0.0, 0.0, 0.0)
LOW = sg.Parcel(sg.Rectangle(0.25, 0.25), com_height=0.02)


def driven(velocity: Array, pitch: float = 0.1, **fields: object) -> sg.Surface:
    """Surface of driven modules with velocities (rows, columns, 2) [m/s]."""
    shape = velocity.shape[:2]
    rotor = np.ones(shape, dtype=bool)
    return sg.Surface(np.zeros(shape), rotor, pitch, surface_velocity=velocity, **fields)


def belts(*speeds: float, pitch: float = 0.1) -> sg.Surface:
    """Belts of 20 columns each, one after the other, that run towards +x."""
    velocity = np.zeros((20, 20 * len(speeds), 2))
    velocity[:, :, 0] = np.repeat(speeds, 20)
    return driven(velocity, pitch)


@pytest.mark.parametrize("speed", [0.4, 1.0, -0.7])
def test_a_parcel_dropped_on_a_belt_slips_v_squared_over_two_mu_g(speed: float) -> None:
    box = sg.Parcel(sg.Rectangle(0.35, 0.35), com_height=FLAT)
    run = sg.simulate(belts(speed), box, (1.0, 1.0, 0.0), duration=0.6, dt=1e-4)
    slip = speed**2 / (2.0 * MU * GRAVITY)
    moved = speed * 0.6 - math.copysign(slip, speed)
    assert run.pose[-1, 0] - 1.0 == pytest.approx(moved, abs=1e-4)
    np.testing.assert_allclose(run.velocity[-1], [speed, 0.0, 0.0], atol=1e-9)
    # Half of the drives' work is lost as heat.
    kinetic = 0.5 * box.mass * speed**2
    energy = run.energy
    assert energy.drives[-1] == pytest.approx(2.0 * kinetic, rel=1e-3)
    assert energy.driven[-1] == pytest.approx(kinetic, rel=2e-3)
    assert np.abs(energy.balance).max() < 1e-5 * kinetic


@pytest.mark.parametrize(("speeds", "duration"), [((0.5, 1.2), 2.3), ((1.2, 0.5), 1.6)])
def test_a_parcel_conveyed_across_two_belts(speeds: tuple[float, float], duration: float) -> None:
    """It keeps its speed until the second belt carries more than the first. From there the
    difference of their loads changes its speed.
    """
    pitch, length = 0.05, 0.42
    box = sg.Parcel(sg.Rectangle(length, 0.42), com_height=FLAT)
    surface = belts(*speeds, pitch=pitch)
    run = sg.simulate(surface, box, (0.3, 0.5, 0.0), (speeds[0], 0, 0), duration, 1e-4)
    ahead = np.arange(surface.columns) * pitch + 0.05  # [m] centres of the columns
    way = math.copysign(1.0, speeds[1] - speeds[0])

    def acceleration(_: float, state: Array) -> list[float]:
        x, v = state
        under = np.abs(ahead - x) <= 0.5 * length
        # Eq. (1): the smallest loads that carry the weight without a moment.
        balance = np.stack([np.ones(under.sum()), ahead[under] - x])
        loads = np.linalg.pinv(balance) @ [1.0, 0.0]
        share = loads @ np.repeat([-1.0, 1.0], 20)[under]  # while its speed is between theirs
        arrived = way * (v - speeds[1]) >= 0.0
        return [v, 0.0 if arrived else way * MU * GRAVITY * max(0.0, share)]

    exact = solve_ivp(acceleration, (0.0, duration), [0.3, speeds[0]], max_step=5e-4, rtol=1e-8)
    assert run.pose[-1, 0] == pytest.approx(exact.y[0, -1], abs=1e-3)
    assert run.velocity[-1, 0] == pytest.approx(speeds[1], abs=1e-6)


def test_modules_that_run_around_it_spin_a_parcel_up() -> None:
    """Four contacts whose surfaces move like a turntable: the slip keeps its direction, so the
    parcel turns faster by mu g r / k^2 until it turns with them.
    """
    rate, arm = 3.0, 0.05 * math.sqrt(2.0)
    velocity = np.zeros((2, 2, 2))
    velocity[..., 0] = [[0.05, 0.05], [-0.05, -0.05]]
    velocity[..., 1] = [[-0.05, 0.05], [-0.05, 0.05]]
    box = sg.Parcel(sg.Disc(0.09), com_height=FLAT)
    run = sg.simulate(driven(rate * velocity), box, (0.1, 0.1, 0.0), duration=0.4, dt=1e-4)
    takes = rate * box.body.gyration / (MU * GRAVITY * arm)
    turned = rate * (0.4 - 0.5 * takes)
    assert run.pose[-1, 2] == pytest.approx(turned, abs=2e-3)
    np.testing.assert_allclose(run.velocity[-1], [0.0, 0.0, rate], atol=1e-6)


def test_two_opposed_columns_spin_it_as_another_solver_says() -> None:
    velocity = np.zeros((4, 2, 2))
    velocity[:, 0, 1], velocity[:, 1, 1] = -0.6, 0.6
    box = sg.Parcel(sg.Rectangle(0.19, 0.39), com_height=FLAT)
    run = sg.simulate(driven(velocity), box, (0.1, 0.2, 0.0), duration=0.05, dt=1e-4)
    arms = np.array([[x, y] for y in (-0.15, -0.05, 0.05, 0.15) for x in (-0.05, 0.05)])
    moving = velocity.reshape(-1, 2)

    def acceleration(_: float, state: Array) -> list[float]:
        slip = np.column_stack([-state[1] * arms[:, 1], state[1] * arms[:, 0]]) - moving
        force = -MU * GRAVITY / 8.0 * slip / np.hypot(*slip.T)[:, np.newaxis]
        torque = (arms[:, 0] * force[:, 1] - arms[:, 1] * force[:, 0]).sum()
        return [state[1], torque / box.body.gyration]

    exact = solve_ivp(acceleration, (0.0, 0.05), [0.0, 0.0], rtol=1e-9)
    assert run.pose[-1, 2] == pytest.approx(exact.y[0, -1], rel=0.01)
    assert run.velocity[-1, 2] == pytest.approx(exact.y[1, -1], rel=0.01)
    np.testing.assert_allclose(run.pose[-1, :2], [0.1, 0.2], atol=1e-9)


def zones(rng: np.random.Generator) -> tuple[sg.Surface, sg.Parcel, Array, Array]:
    """Belts of random speed and direction, and a random parcel on them."""
    speed, way = rng.uniform(0.3, 1.5, 12), rng.uniform(-0.8, 0.8, 12)
    velocity = np.repeat(speed[:, np.newaxis] * np.column_stack([np.cos(way), np.sin(way)]), 5, 0)
    parcel = sg.Parcel(sg.Rectangle(*rng.uniform(0.25, 0.45, 2)), com_height=0.05)
    pose, start = [0.5, 1.0, rng.uniform(-0.3, 0.3)], [rng.uniform(0.3, 2.0), 0.0, 0.0]
    return driven(np.tile(velocity, (20, 1, 1))), parcel, np.array(pose), np.array(start)


def test_the_default_step_is_near_a_step_of_a_tenth_of_a_millisecond() -> None:
    rng = np.random.default_rng(0)
    errors = []
    for _ in range(60):
        scene = zones(rng)
        fine, *coarse = (sg.simulate(*scene, 1.0, dt).pose[-1] for dt in (1e-4, 5e-3, 1e-3))
        errors.append([1e3 * math.dist(each[:2], fine[:2]) for each in coarse])
    assert (np.median(errors, axis=0) <= [1.1, 0.25]).all()  # [mm]; idle zones: 0.7 and 0.15
    assert (np.max(errors, axis=0) <= [10.0, 2.5]).all()


def test_a_driven_module_at_rest_holds_a_parcel_on_a_slope() -> None:
    surface = driven(np.zeros((20, 20, 2)), tilt=math.radians(10.0))
    run = sg.simulate(surface, sg.layouts.box("S"), (1.0, 1.0, 0.3), duration=1.0)
    np.testing.assert_allclose(run.pose[-1], run.pose[0], atol=2e-5)


def test_the_explicit_method_approaches_the_implicit_one() -> None:
    surface = belts(1.0, 0.6)
    start = ((1.7, 1.0, 0.0), AT_REST, 0.7)
    implicit = sg.simulate(surface, LOW, *start, 1e-4)
    explicit = sg.simulate(surface, LOW, *start, 1e-5, method="explicit")
    np.testing.assert_allclose(explicit.pose[-1], implicit.pose[-1], atol=1e-3)


def test_touching_parcels_are_driven_too() -> None:
    """A parcel from a fast belt runs into one on a slow belt, and follows it."""
    surface = belts(1.0, 0.3)
    meeting = sg.simulate_together(
        surface, [LOW, LOW], [(1.2, 1.0, 0.0), (2.05, 1.0, 0.0)], [(1, 0, 0), (0.3, 0, 0)], 2.0
    )
    assert len(meeting.touches.time) > 0
    rear, front = (each.pose[-1, 0] for each in meeting.trajectories)
    assert front - rear >= 0.25 - 1e-6
    assert meeting.trajectories[0].velocity[-1, 0] == pytest.approx(0.3, abs=1e-3)


@pytest.mark.parametrize(
    ("velocity", "message"),
    [
        (np.zeros((2, 3, 2)), r"surface_velocity must have the shape \(2, 2, 2\)"),
        (np.full((2, 2, 2), 1e6), "surface_velocity must be at most"),
        ([[[0.0, math.nan]] * 2] * 2, "surface_velocity must be two numbers for a driven module"),
    ],
)
def test_bad_velocities_raise(velocity: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        sg.Surface(np.zeros((2, 2)), np.ones((2, 2), bool), surface_velocity=velocity)


def test_a_support_is_not_driven() -> None:
    with pytest.raises(ValueError, match="which is among the rotors"):
        sg.Surface(np.zeros((2, 2)), np.zeros((2, 2), bool), surface_velocity=np.zeros((2, 2, 2)))


def test_a_file_keeps_the_velocities(tmp_path) -> None:
    velocity = np.full((20, 20, 2), math.nan)
    velocity[:, 3:] = 0.7, 0.1
    run = sg.simulate(driven(velocity), LOW, (0.3, 1.0, 0.0), (1.0, 0, 0), 0.5)
    run.save(tmp_path / "run.npz")
    again = sg.Trajectory.load(tmp_path / "run.npz")
    np.testing.assert_array_equal(again.energy.drives, run.energy.drives)
    assert run.energy.along[-1] > 0.0 < run.energy.driven[-1]
