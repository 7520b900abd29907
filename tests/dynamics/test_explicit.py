"""The explicit step against a plain transcription of Eq. (2)-(4) and Figure 5."""

import math
from collections.abc import Callable

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.dynamics.references import scipy_normal_forces

K = 5000.0  # [s/m] of Eq. (2)
G = 9.81  # [m/s^2]
DT = 0.005  # [s]

Motion = tuple[np.ndarray, np.ndarray]  # pose, velocity


def under_the_base(surface: sg.Surface, parcel: sg.Parcel, pose: np.ndarray) -> np.ndarray:
    """(rows, columns) Section 3.2: F_lambda <= 0, an element on the perimeter included."""
    x, y = np.meshgrid(surface.x - pose[0], surface.y - pose[1])
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    functions = parcel.base.functions(cosine * x + sine * y, cosine * y - sine * x)
    return functions.max(axis=0) <= 1e-9


def contact_forces(
    surface: sg.Surface, rotor: np.ndarray, axis: np.ndarray, slide: np.ndarray, normal: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Eq. (2) and (3): (contacts, 2) forces along the axes, and the other forces.

    cos(alpha) and sin(alpha), of the angle from the motion to the axis, are taken from the vectors:
    of angles, the sign would be that of their round-off where a rotor lies along or across it.
    """
    beta = np.arctan2(slide[:, 1], slide[:, 0])
    ax, ay = np.round([np.cos(axis), np.sin(axis)], 15)
    smooth = normal * np.tanh(K * np.hypot(slide[:, 0], slide[:, 1]))
    f_par = surface.mu_max * smooth * np.sign(ax * slide[:, 0] + ay * slide[:, 1])
    f_perp = surface.mu_min * smooth * np.sign(ay * slide[:, 0] - ax * slide[:, 1])
    along = -f_par[:, None] * np.column_stack([np.cos(axis), np.sin(axis)])
    across = f_perp[:, None] * np.column_stack([-np.sin(axis), np.cos(axis)])
    support = -surface.mu_support * smooth[:, None] * np.column_stack([np.cos(beta), np.sin(beta)])
    kind = rotor[:, None]
    return np.where(kind, along, 0.0), np.where(kind, across, support)


def transcribed_step(
    surface: sg.Surface,
    parcel: sg.Parcel,
    pose: np.ndarray,
    velocity: np.ndarray,
    acceleration: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
    """One turn of Figure 5a's loop: pose, velocity and acceleration; None where it stops."""
    if velocity[0] <= 0.0 and surface.tilt == 0.0:
        return None
    under = under_the_base(surface, parcel, pose)
    x, y = np.meshgrid(surface.x, surface.y)
    arms = np.column_stack([x[under] - pose[0], y[under] - pose[1]])
    gravity_x, gravity_z = G * math.sin(surface.tilt), G * math.cos(surface.tilt)
    load = parcel.com_height * np.array([gravity_x - acceleration[0], -acceleration[1]]) / gravity_z
    normal, _ = scipy_normal_forces(arms, gravity_z, load, np.ones(len(arms)))

    velocity = velocity.copy()
    standing = velocity[0] <= 0.0
    if standing:
        velocity[0] = 1e-4
    slide = velocity[:2] + velocity[2] * np.column_stack([-arms[:, 1], arms[:, 0]])
    along, other = contact_forces(surface, surface.rotor[under], surface.axis[under], slide, normal)
    total = (along + other)[:, 0].sum() + gravity_x
    if standing and total <= 0.0:  # Figure 5b: friction along the axes only holds what gravity asks
        pull = along[:, 0].sum()
        along = along * (-(other[:, 0].sum() + gravity_x) / pull) if pull else 0.0 * along
        velocity[0] = 0.0
    force = along + other
    gyration = parcel.moment_of_inertia / parcel.mass
    spin = (arms[:, 0] * force[:, 1] - arms[:, 1] * force[:, 0]).sum() / gyration
    new = np.array([force[:, 0].sum() + gravity_x, force[:, 1].sum(), spin])
    if standing and total <= 0.0:
        new[0] = 0.0
    velocity = velocity + DT * new
    return pose + DT * velocity, velocity, new


@pytest.mark.parametrize(
    ("size", "degrees", "speed"),
    [
        ("S", 0.0, (1.5, 0.0, 0.0)),
        ("B", 0.0, (1.5, 0.0, 0.0)),
        ("S", 5.0, (0.0, 0.0, 0.0)),
        ("S", 10.0, (0.0, 0.0, 0.0)),
        ("S", 12.0, (0.5, 0.2, -1.0)),
        ("S", 1.0, (0.3, 0.0, 0.0)),
    ],
)
def test_each_step_is_the_papers(
    size: str, degrees: float, speed: tuple[float, float, float]
) -> None:
    surface = sg.layouts.sorting(size, tilt=math.radians(degrees))
    parcel = sg.layouts.box(size)
    run = sg.simulate(
        surface, parcel, sg.layouts.start(size), speed, duration=1.0, dt=DT, method="explicit"
    )
    assert len(run.time) == 201
    acceleration = np.zeros(3)
    for k in range(200):
        step = transcribed_step(surface, parcel, run.pose[k], run.velocity[k], acceleration)
        assert step is not None
        pose, velocity, acceleration = step
        np.testing.assert_allclose(run.velocity[k + 1], velocity, rtol=0.0, atol=1e-5)
        np.testing.assert_allclose(run.pose[k + 1], pose, rtol=0.0, atol=1e-7)


def test_the_loop_ends_where_the_paper_stops_the_parcel() -> None:
    surface, parcel = sg.layouts.stopping(), sg.layouts.box("S")
    run = sg.simulate(
        surface, parcel, sg.layouts.start("S"), (0.8, 0.0, 0.0), 2.0, DT, method="explicit"
    )
    assert run.end == "stopped"
    assert run.time[-1] < 2.0
    assert (run.velocity[:-1, 0] > 0.0).all()
    assert run.velocity[-1, 0] <= 0.0
    assert transcribed_step(surface, parcel, run.pose[-1], run.velocity[-1], np.zeros(3)) is None


def test_a_parcel_at_rest_on_a_flat_surface_stops_at_once() -> None:
    run = sg.simulate(
        sg.layouts.sorting(), sg.layouts.box("S"), sg.layouts.start("S"), method="explicit"
    )
    assert run.end == "stopped"
    np.testing.assert_array_equal(run.pose, [sg.layouts.start("S")])


def test_rotors_along_the_slope_hold_a_parcel_by_the_reverse_motion_rule() -> None:
    surface = sg.layouts.slowing(angle=0.0, task_columns=30, tilt=math.radians(5.0))
    run = sg.simulate(surface, sg.layouts.box("S"), (1.0, 1.0, 0.0), method="explicit")
    assert run.end == "duration"
    # Nearly: it chatters by tenths of a millimetre, where on rolling rotors it goes 0.38 m.
    np.testing.assert_allclose(run.pose[:, 0], 1.0, atol=1e-3)


@pytest.mark.parametrize("degrees", [0.05, 0.1, 0.3, 0.45, 0.56, 0.7, 1.0, 3.0])
@pytest.mark.parametrize("size", ["S", "B"])
@pytest.mark.parametrize("layout", [sg.layouts.sorting, sg.layouts.stopping])
def test_a_parcel_at_rest_on_a_slope_never_gets_faster_than_gravity_makes_it(
    layout: Callable[..., sg.Surface], size: str, degrees: float
) -> None:
    """But for what friction does in one step, by which this method chatters."""
    surface = layout(size, tilt=math.radians(degrees))
    run = sg.simulate(surface, sg.layouts.box(size), sg.layouts.start(size), method="explicit")
    fastest = 9.81 * math.sin(math.radians(degrees)) * run.time + 0.5 * 9.81 * DT
    assert (np.hypot(*run.velocity[:, :2].T) <= fastest).all()
    assert np.isfinite(run.pose).all()
