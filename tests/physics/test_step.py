"""One step: what it reports, and that every caller gets the same bits."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

import surface_gym as sg
from surface_gym.physics import types as ph
from surface_gym.physics.contacts import invalidate_contacts
from surface_gym.physics.references import (
    load_point,
    scipy_normal_forces,
    step_explicit,
    step_implicit,
)
from surface_gym.physics.step import (
    BALANCED,
    OFF_SURFACE,
    STOPPED,
    TIPPING,
    UNSUPPORTED,
    axis_directions,
    split_gravity,
    tilt_of_gravity,
)
from surface_gym.physics.types import Array
from tests.physics.contact_sets import scan
from tests.strategies import Scene, scenes

G = 9.81  # [m/s^2]
DT = 0.005  # [s]

Step = Callable[..., tuple[int, ph.Contacts]]
Triple = tuple[float, float, float]


def state_of(pose: Triple, velocity: Triple) -> Array:
    """State vector of a parcel whose centre of mass is over its base frame's origin."""
    state = np.zeros(ph.STATE_SIZE)
    state[[ph.X, ph.Y, ph.THETA]] = pose
    state[[ph.VX, ph.VY, ph.OMEGA]] = velocity
    return state


def supports_only(mu: float, tilt: float = 0.0, tilt_direction: float = 0.0) -> sg.Surface:
    return sg.Surface(
        axis=np.zeros((20, 40)), rotor=np.zeros((20, 40), dtype=bool), mu_support=mu, tilt=tilt,
        tilt_direction=tilt_direction,
    )  # fmt: skip


def test_tilts_come_back_from_their_gravity() -> None:
    tilts, directions = np.array([0.0, 0.2, -0.2, 0.2]), np.array([0.0, 0.0, 0.0, -2.5])
    gravity = np.transpose(split_gravity(tilts, directions))
    np.testing.assert_allclose(np.linalg.norm(gravity, axis=1), G)
    for tilt, direction, each in zip(tilts, directions, gravity.tolist(), strict=True):
        assert tuple(each) == split_gravity(tilt, direction)
        assert tilt_of_gravity(*each) == pytest.approx((tilt, direction))


@pytest.mark.parametrize(
    ("method", "step"), [("implicit", step_implicit), ("explicit", step_explicit)]
)
@pytest.mark.parametrize("duration", [0.5, 0.5017, 0.003])
def test_a_loop_over_steps_equals_simulate(method: str, step: Step, duration: float) -> None:
    surface, parcel = sg.layouts.sorting(tilt=math.radians(5.0)), sg.layouts.box("S")
    pose, velocity, dt = (0.5, 1.01, 0.3), (1.2, 0.1, -0.5), 0.005
    run = sg.simulate(surface, parcel, pose, velocity, duration, dt, method=method)
    state = state_of(pose, velocity)
    scratch = ph.make_scratch()
    for k in range(1, len(run.time)):
        left = duration - run.time[k - 1]
        step(surface.grid, parcel.body, state, scratch, dt if left > dt else left)
        assert run.pose[k].tobytes() == state[[ph.X, ph.Y, ph.THETA]].tobytes()
        assert run.velocity[k].tobytes() == state[[ph.VX, ph.VY, ph.OMEGA]].tobytes()


@given(scene=scenes())
def test_steps_do_not_depend_on_what_the_scratch_held(scene: Scene) -> None:
    grid, body = scene.surface.grid, scene.parcel.body
    used, fresh = ph.make_scratch(), ph.make_scratch()
    for field in used:
        field.fill(7)
    invalidate_contacts.py_func(used)
    first, second = state_of(scene.pose, scene.velocity), state_of(scene.pose, scene.velocity)
    for _ in range(20):
        one = step_implicit(grid, body, first, used, 0.005)
        other = step_implicit(grid, body, second, fresh, 0.005)
        assert one == other
        assert first.tobytes() == second.tobytes()


def test_a_step_reports_how_it_went_and_on_how_many_contacts() -> None:
    surface, box, coin = sg.layouts.sorting(), sg.layouts.box("S"), sg.Parcel(sg.Disc(0.04))
    scratch = ph.make_scratch()

    def report(
        step: Step, pose: Triple, velocity: Triple, parcel: sg.Parcel = box
    ) -> tuple[int, int]:
        state = state_of(pose, velocity)
        before = state.copy()
        outcome, contacts = step(surface.grid, parcel.body, state, scratch, DT)
        assert outcome != OFF_SURFACE or state.tobytes() == before.tobytes()
        return outcome, contacts.total

    middle, moving = (1.0, 1.0, 0.0), (1.0, 0.1, 0.3)
    for step in (step_implicit, step_explicit):
        assert report(step, middle, moving) == (BALANCED, 4)
        assert report(step, (0.01, 1.0, 0.0), moving) == (TIPPING, 2)
        assert report(step, (-0.1, 1.0, 0.0), moving) == (OFF_SURFACE, 0)
        # Between the elements, and on a single one.
        assert report(step, middle, moving, coin) == (UNSUPPORTED, 0)
        assert report(step, (1.05, 1.05, 0.0), moving, coin) == (TIPPING, 1)
    assert report(step_implicit, middle, (0.0, 0.0, 0.0)) == (BALANCED, 4)
    assert report(step_explicit, middle, (0.0, 1.0, 0.0)) == (STOPPED, 0)
    assert report(step_explicit, middle, (-1.0, 0.0, 0.0)) == (STOPPED, 0)


@pytest.mark.parametrize(("x", "y"), [(0.0, 2.0), (6.0, 2.0), (3.0, 0.0), (3.0, 4.0)])
def test_the_edge_itself_is_of_the_surface(x: float, y: float) -> None:
    """In quarters of a metre, which floats hold exactly: no round-off decides."""
    shape = (16, 24)
    surface = sg.Surface(
        np.zeros(shape), np.ones(shape, dtype=bool), pitch=0.25, origin=(0.125, 0.125)
    )
    parcel, scratch = sg.Parcel(sg.Rectangle(0.6, 0.6)), ph.make_scratch()
    beyond = (3.0 + 1.0001 * (x - 3.0), 2.0 + 1.0001 * (y - 2.0))
    for place, expected in (((x, y), TIPPING), (beyond, OFF_SURFACE)):
        state = state_of((*place, 0.0), (0.1, 0.0, 0.0))
        assert step_explicit(surface.grid, parcel.body, state, scratch, DT)[0] == expected


@pytest.mark.parametrize("dt", [1e-5, 1e-3, 5e-3, 0.05])
@pytest.mark.parametrize("degrees", [-10.0, 0.0, 10.0])
def test_sliding_over_supports_is_uniformly_accelerated(dt: float, degrees: float) -> None:
    mu, speed, steps = 0.1, 1.0, 4
    surface = supports_only(mu, math.radians(degrees))
    parcel = sg.Parcel(sg.Rectangle(0.4, 0.4))
    scratch = ph.make_scratch()
    state = state_of((1.5, 1.0, 0.0), (speed, 0.0, 0.0))
    acceleration = G * (math.sin(surface.tilt) - mu * math.cos(surface.tilt))
    for _ in range(steps):
        step_implicit(surface.grid, parcel.body, state, scratch, dt)
    time = steps * dt
    expected = (1.5 + speed * time + 0.5 * acceleration * time**2, 1.0, 0.0)
    np.testing.assert_allclose(state[[ph.X, ph.Y, ph.THETA]], expected, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(
        state[[ph.VX, ph.VY, ph.OMEGA]], [speed + acceleration * time, 0, 0], atol=1e-9
    )
    assert state[ph.AX] == pytest.approx(acceleration, abs=1e-3)


@pytest.mark.parametrize("step", [step_implicit, step_explicit])
@pytest.mark.parametrize("direction", [0.0, 0.7, math.pi / 2, -math.pi / 2, -0.5])
def test_a_slope_in_any_direction_speeds_up_what_slides_down(step: Step, direction: float) -> None:
    mu, speed, dt, steps = 0.1, 1.0, 1e-3, 100
    surface = supports_only(mu, math.radians(10.0), direction)
    way = np.array([math.cos(direction), math.sin(direction)])
    state = state_of((1.5, 1.0, 0.0), (*(speed * way), 0.0))
    state[ph.VX] = max(state[ph.VX], 1e-3)  # the explicit step wants motion towards +x
    parcel, scratch = sg.Parcel(sg.Rectangle(0.4, 0.4)), ph.make_scratch()
    for _ in range(steps):
        step(surface.grid, parcel.body, state, scratch, dt)
    acceleration = G * (math.sin(surface.tilt) - mu * math.cos(surface.tilt))
    after = speed + steps * dt * acceleration
    np.testing.assert_allclose(state[[ph.VX, ph.VY]], after * way, rtol=0.0, atol=1e-3)
    assert state[ph.OMEGA] == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("direction", [0.0, 0.7, math.pi / 2, 2.5, -math.pi / 2])
def test_the_slope_throws_the_load_to_the_downhill_side(direction: float) -> None:
    surface = supports_only(0.1, math.radians(10.0), direction)
    parcel, scratch = sg.Parcel(sg.Rectangle(0.4, 0.4), com_height=0.1), ph.make_scratch()
    state = state_of((1.5, 1.0, 0.0), (0.0, 0.0, 0.0))
    load = load_point(surface.grid, parcel.body, state)
    shift = 0.1 * math.tan(surface.tilt) * np.array([math.cos(direction), math.sin(direction)])
    np.testing.assert_allclose(load, shift, rtol=1e-12, atol=1e-17)
    # The normal forces balance there.
    report, contacts = step_implicit(surface.grid, parcel.body, state, scratch, DT)
    assert (report, contacts.total) == (BALANCED, 16)
    normal, x, y = (
        ph.table_row(scratch, row, contacts.total) for row in (ph.NORMAL, ph.ARM_X, ph.ARM_Y)
    )
    np.testing.assert_allclose([normal @ x, normal @ y], shift * normal.sum(), atol=1e-12)
    downhill = x * math.cos(direction) + y * math.sin(direction)
    assert normal[downhill > 0.01].min() > normal[downhill < -0.01].max()
    # What speeds up freely down the slope leaves the load in the middle.
    state[[ph.AX, ph.AY]] = surface.grid.gravity_x, surface.grid.gravity_y
    assert load_point(surface.grid, parcel.body, state) == (0.0, 0.0)


@given(mu=st.floats(0.15, 0.5), speed=st.floats(0.2, 1.5), direction=st.floats(-math.pi, math.pi))
def test_it_stops_after_v_squared_over_two_mu_g(mu: float, speed: float, direction: float) -> None:
    parcel = sg.Parcel(sg.Rectangle(0.3, 0.3), com_height=0.0)
    way = np.array([math.cos(direction), math.sin(direction)])
    distance = speed**2 / (2.0 * mu * G)
    start = np.array([2.0, 1.0]) - 0.5 * distance * way
    duration = speed / (mu * G) + 0.05
    run = sg.simulate(
        supports_only(mu), parcel, (*start, 0.0), (*(speed * way), 0.0), duration, dt=1e-3
    )
    assert run.end == "duration"
    np.testing.assert_allclose(run.pose[-1, :2] - start, distance * way, atol=1e-4)
    np.testing.assert_allclose(run.velocity[-1], 0.0, atol=1e-6)


K = 5000.0  # [s/m] of Eq. (2)


def contact_forces(
    surface: sg.Surface, rotor: Array, axis: Array, slide: Array, normal: Array
) -> tuple[Array, Array]:
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
    surface: sg.Surface, parcel: sg.Parcel, pose: Array, velocity: Array, acceleration: Array
) -> tuple[Array, Array, Array] | None:
    """One turn of Figure 5a's loop: pose, velocity and acceleration; None where it stops."""
    if velocity[0] <= 0.0 and surface.tilt == 0.0:
        return None
    under = scan(surface, parcel, pose) <= 1e-9  # an element on the perimeter included
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


@pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
@pytest.mark.parametrize(
    ("size", "degrees", "speed"),
    [
        ("S", 0.0, (1.5, 0.0, 0.0)), ("B", 0.0, (1.5, 0.0, 0.0)), ("S", 5.0, (0.0, 0.0, 0.0)),
        ("S", 10.0, (0.0, 0.0, 0.0)), ("S", 12.0, (0.5, 0.2, -1.0)), ("S", 1.0, (0.3, 0.0, 0.0)),
    ],
)  # fmt: skip
def test_each_step_is_the_papers(size: str, degrees: float, speed: Triple) -> None:
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


@pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
def test_the_loop_ends_where_the_paper_stops_the_parcel() -> None:
    surface, parcel, start = sg.layouts.stopping(), sg.layouts.box("S"), sg.layouts.start("S")
    run = sg.simulate(surface, parcel, start, (0.8, 0.0, 0.0), 2.0, DT, method="explicit")
    assert run.end == "stopped"
    assert run.time[-1] < 2.0
    assert (run.velocity[:-1, 0] > 0.0).all()
    assert run.velocity[-1, 0] <= 0.0
    assert transcribed_step(surface, parcel, run.pose[-1], run.velocity[-1], np.zeros(3)) is None
    # At rest on the level, at once.
    run = sg.simulate(sg.layouts.sorting(), parcel, start, method="explicit")
    assert run.end == "stopped"
    np.testing.assert_array_equal(run.pose, [start])


@pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
@pytest.mark.parametrize("degrees", [*np.arange(0.05, 0.6, 0.05), 0.56, 0.7, 1.0, 3.0])
@pytest.mark.parametrize("size", ["S", "B"])
@pytest.mark.parametrize("layout", [sg.layouts.sorting, sg.layouts.stopping])
def test_from_rest_it_never_gets_faster_than_gravity(
    layout: Any, size: str, degrees: float
) -> None:
    """But for what friction does in one step, by which this method chatters."""
    surface = layout(size, tilt=math.radians(degrees))
    run = sg.simulate(
        surface, sg.layouts.box(size), sg.layouts.start(size), duration=2.0, method="explicit"
    )
    fastest = G * math.sin(math.radians(degrees)) * run.time + 0.5 * G * DT
    assert (np.hypot(*run.velocity[:, :2].T) <= fastest).all()
    assert np.isfinite(run.pose).all()
    if layout is sg.layouts.sorting and degrees < 0.6:
        # By the 6e-17 that the cosine of 90 deg was, it was divided and thrown off.
        assert run.end == "duration"
        assert np.abs(run.pose[:, :2] - run.pose[0, :2]).max() < 0.05


ROOT = math.sqrt(0.5)


@pytest.mark.parametrize(
    ("degrees", "cosine", "sine"),
    [
        (0.0, 1.0, 0.0), (45.0, ROOT, ROOT), (90.0, 0.0, 1.0), (135.0, -ROOT, ROOT),
        (180.0, -1.0, 0.0), (225.0, -ROOT, -ROOT), (270.0, 0.0, -1.0), (315.0, ROOT, -ROOT),
    ],
)  # fmt: skip
def test_multiples_of_45_deg_are_exact(degrees: float, cosine: float, sine: float) -> None:
    angles = np.radians(degrees) + 2.0 * math.pi * np.arange(-2.0, 3.0)
    np.testing.assert_array_equal(axis_directions(angles), [[cosine, sine]] * 5)


def test_every_other_angle_has_its_cosine_and_sine() -> None:
    angles = np.concatenate([np.linspace(-10.0, 10.0, 4001), [1e-300, 1e-9, math.pi / 4 + 1e-12]])
    expected = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    np.testing.assert_allclose(axis_directions(angles), expected, rtol=0.0, atol=3e-15)
    assert axis_directions(np.array([math.pi / 4 + 1e-12]))[0, 0] != ROOT
    of_surface = sg.layouts.sorting().grid.direction
    assert set(map(tuple, of_surface.tolist())) == {(0.0, 1.0), (ROOT, ROOT)}
