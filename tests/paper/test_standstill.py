"""Which tilts stop a box, and how far a held one creeps, against the balance of forces."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.paper.standstill import RESOLUTION, creep_speed, uniform
from surface_gym.physics.friction import ROUNDING

HELD = 600.0  # [s]


def field(angle, degrees):
    """Axes at an angle everywhere; None: supports alone."""
    axis = np.zeros((30, 30)) if angle is None else np.full((30, 30), angle)
    rotor = np.full(axis.shape, angle is not None)
    return sg.Surface(axis, rotor, tilt=math.radians(degrees))


def test_the_measured_tilts_are_those_of_the_balance(reproduction):
    for case in reproduction.self_stopping:
        assert case.measured == pytest.approx(case.expected, abs=2.0 * RESOLUTION)


def test_the_study_puts_the_tilt_of_uniform_axes_at_half(reproduction):
    uniform_cases = [case for case in reproduction.self_stopping if case.study is not None]

    assert [case.integration.method for case in uniform_cases] == ["implicit", "explicit"]
    for case in uniform_cases:
        assert case.expected == pytest.approx(math.degrees(math.atan(math.sqrt(2.0) * 0.01)))
        assert case.measured / case.study == pytest.approx(2.0, abs=0.02)


@pytest.mark.parametrize("degrees", [0.5, 0.7, 0.9, 2.0])
def test_a_rolling_box_is_slowed_as_the_balance_says(degrees):
    """Half of gravity lies across the axes, against it the rolling friction alone."""
    tilt = math.radians(degrees)
    across = (math.sqrt(0.5), -math.sqrt(0.5))
    start = (2.0, 6.0, 0.0)
    velocity = (0.2 * across[0], 0.2 * across[1], 0.0)

    run = sg.simulate(uniform(tilt), sg.layouts.box("S"), start, velocity, 1.0, dt=1e-3)

    gained = math.hypot(*run.velocity[-1, :2]) - 0.2
    balance = 9.81 * (math.sqrt(0.5) * math.sin(tilt) - 0.01 * math.cos(tilt))
    assert gained == pytest.approx(balance, rel=1e-3)
    assert (gained < 0.0) == (degrees < 0.81)


@pytest.mark.parametrize(
    ("angle", "degrees", "friction", "millimetres"),
    [
        (0.0, 5.0, 0.5, 1.05),
        (0.0, 15.0, 0.5, 3.22),
        (math.pi / 2, 0.5, 0.01, 5.24),
        (None, 0.25, 0.005, 5.24),
    ],
)
def test_a_held_parcel_creeps_as_rounded_friction_says(angle, degrees, friction, millimetres):
    surface = field(angle, degrees)

    run = sg.simulate(surface, sg.layouts.box("S"), (1.5, 1.5, 0.0), duration=HELD)

    x, y, theta = run.pose[-1] - run.pose[0]
    assert x < ROUNDING * HELD
    assert x == pytest.approx(HELD * creep_speed(math.radians(degrees), friction), rel=1e-3)
    assert 1000.0 * x == pytest.approx(millimetres, abs=0.01)
    assert abs(y) < 1e-9
    assert abs(theta) < 1e-6


def test_a_held_parcel_on_axes_at_45_deg_creeps_along_and_across_them():
    """Half of the pull lies along the axes, half across: each is rounded by itself."""
    surface = field(math.pi / 4, 0.75)

    run = sg.simulate(surface, sg.layouts.box("S"), (1.5, 1.5, 0.0), duration=HELD)

    x, y, _ = run.pose[-1] - run.pose[0]
    pull = ROUNDING * HELD * math.tan(math.radians(0.75)) / math.sqrt(2.0)
    assert (x + y) / math.sqrt(2.0) == pytest.approx(pull / 0.5, rel=1e-3)
    assert (x - y) / math.sqrt(2.0) == pytest.approx(pull / 0.01, rel=1e-3)
    assert 1000.0 * math.hypot(x, y) == pytest.approx(5.56, abs=0.01)


def test_the_paper_s_own_rule_holds_without_creep():
    run = sg.simulate(
        field(0.0, 5.0), sg.layouts.box("S"), (1.5, 1.5, 0.0), duration=60.0, method="explicit"
    )

    np.testing.assert_array_equal(run.pose[-1], run.pose[0])
