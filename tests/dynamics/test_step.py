"""One step: what it reports, and that every caller gets the same bits."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import surface_gym as sg
from surface_gym.dynamics.contacts import forget_contacts
from surface_gym.dynamics.entries import step_explicit, step_implicit
from surface_gym.dynamics.memory import make_scratch
from surface_gym.dynamics.step import BALANCED, OFF_SURFACE, STOPPED, TIPPING, UNBORNE
from surface_gym.dynamics.types import AX, OMEGA, STATE_SIZE, THETA, VX, VY, Array, X, Y
from tests.strategies import Scene, scenes

G = 9.81  # [m/s^2]


def state_of(pose: tuple[float, ...], velocity: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Array:
    """State vector of a parcel whose centre of mass is over its base frame's origin."""
    state = np.zeros(STATE_SIZE)
    state[[X, Y, THETA]] = pose
    state[[VX, VY, OMEGA]] = velocity
    return state


def supports_only(mu: float, tilt: float = 0.0) -> sg.Surface:
    return sg.Surface(
        axis=np.zeros((20, 40)), rotor=np.zeros((20, 40), dtype=bool), mu_support=mu, tilt=tilt
    )


@pytest.mark.parametrize(
    ("method", "step"), [("implicit", step_implicit), ("explicit", step_explicit)]
)
@pytest.mark.parametrize("duration", [0.5, 0.5017, 0.003])
def test_a_loop_over_steps_equals_simulate_to_the_bit(
    method: str, step: object, duration: float
) -> None:
    surface, parcel = sg.layouts.sorting(tilt=math.radians(5.0)), sg.layouts.box("S")
    pose, velocity, dt = (0.5, 1.01, 0.3), (1.2, 0.1, -0.5), 0.005
    run = sg.simulate(surface, parcel, pose, velocity, duration, dt, method=method)
    state = state_of(pose, velocity)
    scratch = make_scratch()
    for k in range(1, len(run.time)):
        left = duration - run.time[k - 1]
        step(surface.grid, parcel.body, state, scratch, dt if left > dt else left)
        assert run.pose[k].tobytes() == state[[X, Y, THETA]].tobytes()
        assert run.velocity[k].tobytes() == state[[VX, VY, OMEGA]].tobytes()


@given(scene=scenes())
def test_steps_do_not_depend_on_what_the_scratch_held(scene: Scene) -> None:
    grid, body = scene.surface.grid, scene.parcel.body
    used, fresh = make_scratch(), make_scratch()
    for field in used:
        field.fill(7)
    forget_contacts.py_func(used)
    first, second = state_of(scene.pose, scene.velocity), state_of(scene.pose, scene.velocity)
    for _ in range(20):
        one = step_implicit(grid, body, first, used, 0.005)
        other = step_implicit(grid, body, second, fresh, 0.005)
        assert one == other
        assert first.tobytes() == second.tobytes()


def test_a_step_reports_how_it_went_and_on_how_many_contacts() -> None:
    surface, parcel = sg.layouts.sorting(), sg.layouts.box("S")
    scratch = make_scratch()

    def report(
        step: object, pose: tuple[float, ...], velocity: tuple[float, ...]
    ) -> tuple[int, int]:
        outcome, contacts = step(
            surface.grid, parcel.body, state_of(pose, velocity), scratch, 0.005
        )
        return outcome, contacts.total

    middle, moving = (1.0, 1.0, 0.0), (1.0, 0.0, 0.0)
    for step in (step_implicit, step_explicit):
        assert report(step, middle, moving) == (BALANCED, 4)
        assert report(step, (0.01, 1.0, 0.0), moving) == (TIPPING, 2)
        assert report(step, (-0.1, 1.0, 0.0), moving) == (OFF_SURFACE, 0)
    assert report(step_implicit, middle, (0.0, 0.0, 0.0)) == (BALANCED, 4)
    assert report(step_explicit, middle, (0.0, 1.0, 0.0)) == (STOPPED, 0)
    assert report(step_explicit, middle, (-1.0, 0.0, 0.0)) == (STOPPED, 0)


@pytest.mark.parametrize("step", [step_implicit, step_explicit])
def test_a_base_between_the_elements_is_told_from_one_off_the_surface(step: object) -> None:
    surface, coin = sg.layouts.sorting(), sg.Parcel(sg.Disc(0.04))
    state, scratch = state_of((1.0, 1.0, 0.0), (0.5, 0.0, 0.0)), make_scratch()
    assert step(surface.grid, coin.body, state, scratch, 0.005) == (UNBORNE, (0, 0))


@pytest.mark.parametrize("step", [step_implicit, step_explicit])
def test_a_single_element_bears_a_coin(step: object) -> None:
    surface, coin = sg.layouts.sorting(), sg.Parcel(sg.Disc(0.04))
    state, scratch = state_of((1.05, 1.05, 0.0), (0.5, 0.0, 0.0)), make_scratch()
    assert step(surface.grid, coin.body, state, scratch, 0.005) == (TIPPING, (1, 0))


@pytest.mark.parametrize(("x", "y"), [(0.0, 2.0), (6.0, 2.0), (3.0, 0.0), (3.0, 4.0)])
def test_the_edge_itself_is_of_the_surface(x: float, y: float) -> None:
    """In quarters of a metre, which floats hold exactly: no round-off decides."""
    surface = sg.Surface(
        axis=np.zeros((16, 24)),
        rotor=np.ones((16, 24), dtype=bool),
        pitch=0.25,
        origin=(0.125, 0.125),
    )
    parcel, scratch = sg.Parcel(sg.Rectangle(0.6, 0.6)), make_scratch()
    beyond = (3.0 + 1.0001 * (x - 3.0), 2.0 + 1.0001 * (y - 2.0))
    for place, expected in (((x, y), TIPPING), (beyond, OFF_SURFACE)):
        state = state_of((*place, 0.0), (0.1, 0.0, 0.0))
        assert step_explicit(surface.grid, parcel.body, state, scratch, 0.005)[0] == expected


@pytest.mark.parametrize("step", [step_implicit, step_explicit])
def test_a_step_off_the_surface_leaves_the_state_as_it_was(step: object) -> None:
    surface, parcel = sg.layouts.sorting(tilt=0.1), sg.layouts.box("S")
    state = state_of((9.0, 1.0, 0.2), (0.5, 0.1, 0.3))
    before = state.copy()
    scratch = make_scratch()
    assert step(surface.grid, parcel.body, state, scratch, 0.005)[0] == OFF_SURFACE
    np.testing.assert_array_equal(state, before)


@pytest.mark.parametrize("dt", [1e-5, 1e-3, 5e-3, 0.05])
@pytest.mark.parametrize("degrees", [-10.0, 0.0, 10.0])
def test_sliding_over_supports_is_uniformly_accelerated(dt: float, degrees: float) -> None:
    mu, speed, steps = 0.1, 1.0, 4
    surface = supports_only(mu, math.radians(degrees))
    parcel = sg.Parcel(sg.Rectangle(0.4, 0.4))
    scratch = make_scratch()
    state = state_of((1.5, 1.0, 0.0), (speed, 0.0, 0.0))
    acceleration = G * (math.sin(surface.tilt) - mu * math.cos(surface.tilt))
    for _ in range(steps):
        step_implicit(surface.grid, parcel.body, state, scratch, dt)
    time = steps * dt
    expected = (1.5 + speed * time + 0.5 * acceleration * time**2, 1.0, 0.0)
    np.testing.assert_allclose(state[[X, Y, THETA]], expected, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(
        state[[VX, VY, OMEGA]], [speed + acceleration * time, 0, 0], atol=1e-9
    )
    assert state[AX] == pytest.approx(acceleration, abs=1e-3)


@given(mu=st.floats(0.15, 0.5), speed=st.floats(0.2, 1.5), direction=st.floats(-math.pi, math.pi))
def test_a_parcel_on_supports_stops_after_v_squared_over_two_mu_g(
    mu: float, speed: float, direction: float
) -> None:
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
