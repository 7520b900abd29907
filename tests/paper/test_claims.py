"""Claims of the paper: boxes on axes at +-45 deg, tilts that stop a box, and creep."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.paper import runs
from surface_gym.paper.runs import INWARDS, OFFSETS, OUTWARDS, TURNS, Zone, cross, end_of_run
from surface_gym.physics.friction import ROUNDING

HELD = 600.0  # [s]
BOX = sg.layouts.box("S")


@pytest.mark.parametrize("size", ["S", "B"])
@pytest.mark.parametrize("towards", [INWARDS, OUTWARDS])
def test_a_mirrored_start_ends_mirrored(size, towards):
    zone = Zone(size, towards, columns=6, speed=2.5, tilt=5.0)
    one, other = end_of_run(cross(zone, 0.02, 7.0)), end_of_run(cross(zone, -0.02, -7.0))
    assert other[0] == pytest.approx(-one[0], abs=1e-6)
    assert other[1] == pytest.approx(-one[1], abs=1e-3)


@pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
@pytest.mark.parametrize("towards", [INWARDS, OUTWARDS])
def test_the_row_that_bears_more_wins(towards):
    """Two rows at +-d bear (1 +- 2 s / 2d) / 2 of the weight, s the load's place across.
    Each drags with (mu_max - mu_min) / sqrt(2) of its load across, so q = -a_y / g = k s / d, and
    the load lies at s = offset + height q: q = (k offset / d) / (1 - k height / d).
    """
    offset, half_distance, height = 0.005, 0.05, 0.1
    surface = Zone("S", towards, columns=30, speed=2.5, tilt=0.0).surface
    start = (1.5, sg.layouts.LINE_Y + offset, 0.0)
    k = towards * math.sqrt(0.5) * (0.5 - 0.01)
    run = sg.simulate(surface, BOX, start, (2.0, 0.0, 0.0), 0.01, dt=1e-4)
    expected = k * offset / half_distance / (1.0 - k * height / half_distance)
    measured = -np.diff(run.velocity[-20:, 1]).mean() / 1e-4 / 9.81
    assert measured == pytest.approx(expected, rel=0.05)


def by_name(reproduction, size, towards, columns):
    cases = ((case, case.zone) for case in reproduction.alignment)
    wanted = (size, towards, columns)
    return [case for case, zone in cases if (zone.size, zone.towards, zone.columns) == wanted]


def test_columns_push_a_box_as_their_axes_point(reproduction):
    for case in by_name(reproduction, "S", INWARDS, 2):
        share = [abs(end[0]) / came for end, came in zip(case.straight, OFFSETS, strict=True)]
        assert max(share[:2]) < 0.65
        assert share[2] > 1.0  # a row of supports lies under it
        assert all(abs(end[1]) > came for end, came in zip(case.centred, TURNS, strict=True))
    for columns in (2, 6):
        for case in by_name(reproduction, "S", OUTWARDS, columns):
            assert abs(case.straight[0][0]) > 1.2 * OFFSETS[0]
            assert all(abs(end[1]) < came for end, came in zip(case.centred, TURNS, strict=True))


def test_nothing_aligns_in_both_and_the_big_box_hardly_feels_a_short_zone(reproduction):
    assert {case.mixed for case in reproduction.alignment} == {12}
    assert max(case.nearer for case in reproduction.alignment) <= 2
    for towards in (INWARDS, OUTWARDS):
        for case in by_name(reproduction, "B", towards, 2):
            assert [end[0] for end in case.straight] == pytest.approx(OFFSETS, abs=1e-3)


def test_a_long_zone_lets_boxes_swing_and_spin(reproduction):
    level = [c for c in reproduction.alignment if c.zone.columns == 30 and c.zone.tilt == 0.0]
    outwards = [c for c in level if (c.zone.size, c.zone.towards) == ("S", OUTWARDS)]
    assert all(abs(end[0]) > 0.15 for end in outwards[0].straight)  # out of the line
    assert all(max(abs(end[1]) for end in case.straight) > 40.0 for case in level)


def test_short_zones_do_not_hang_on_the_step():
    zone = Zone("S", INWARDS, columns=2, speed=1.5, tilt=0.0)
    start = (0.125, sg.layouts.LINE_Y + 0.01, 0.0)
    run, fine = (
        sg.simulate(zone.surface, BOX, start, (1.5, 0.0, 0.0), 0.5, dt=dt) for dt in (1e-3, 1e-4)
    )
    assert run.pose[-1] == pytest.approx(fine.pose[-1], abs=1e-3)
    assert runs.align(zone).straight[0][0] == pytest.approx(0.0036, abs=5e-4)


def field(angle, degrees):
    """Axes at an angle everywhere; None: supports alone."""
    axis = np.zeros((30, 30)) if angle is None else np.full((30, 30), angle)
    rotor = np.full(axis.shape, angle is not None)
    return sg.Surface(axis, rotor, tilt=math.radians(degrees))


def test_the_measured_tilts_are_those_of_the_balance_and_the_study_has_half(reproduction):
    for case in reproduction.self_stopping:
        assert case.measured == pytest.approx(case.expected, abs=2.0 * runs.RESOLUTION)
    uniform_cases = [case for case in reproduction.self_stopping if case.study is not None]
    assert [case.integration.method for case in uniform_cases] == ["implicit", "explicit"]
    for case in uniform_cases:
        assert case.expected == pytest.approx(math.degrees(math.atan(math.sqrt(2.0) * 0.01)))
        assert case.measured / case.study == pytest.approx(2.0, abs=0.02)


@pytest.mark.parametrize("degrees", [0.5, 0.7, 0.9, 2.0])
def test_a_rolling_box_is_slowed_as_the_balance_says(degrees):
    """Half of gravity lies across the axes, against it the rolling friction alone."""
    tilt, side = math.radians(degrees), 0.2 * math.sqrt(0.5)
    start, velocity = (2.0, 6.0, 0.0), (side, -side, 0.0)
    run = sg.simulate(runs.wide_field((1,), tilt), BOX, start, velocity, 1.0, dt=1e-3)
    gained = math.hypot(*run.velocity[-1, :2]) - 0.2
    balance = 9.81 * (math.sqrt(0.5) * math.sin(tilt) - 0.01 * math.cos(tilt))
    assert gained == pytest.approx(balance, rel=1e-3)
    assert (gained < 0.0) == (degrees < 0.81)


@pytest.mark.parametrize(
    ("angle", "degrees", "friction", "millimetres"),
    [
        (0.0, 5.0, 0.5, 1.05), (0.0, 15.0, 0.5, 3.22), (math.pi / 2, 0.5, 0.01, 5.24),
        (None, 0.25, 0.005, 5.24),
    ],
)  # fmt: skip
def test_a_held_parcel_creeps_as_rounded_friction_says(angle, degrees, friction, millimetres):
    run = sg.simulate(field(angle, degrees), BOX, (1.5, 1.5, 0.0), duration=HELD)
    x, y, theta = run.pose[-1] - run.pose[0]
    assert x < ROUNDING * HELD
    assert x == pytest.approx(
        HELD * ROUNDING * math.tan(math.radians(degrees)) / friction, rel=1e-3
    )
    assert 1000.0 * x == pytest.approx(millimetres, abs=0.01)
    assert abs(y) < 1e-9
    assert abs(theta) < 1e-6


def test_on_axes_at_45_deg_a_parcel_creeps_both_ways_and_by_the_paper_s_own_rule_not_at_all():
    """Half of the pull lies along the axes, half across: each is rounded by itself."""
    run = sg.simulate(field(math.pi / 4, 0.75), BOX, (1.5, 1.5, 0.0), duration=HELD)
    x, y, _ = run.pose[-1] - run.pose[0]
    pull = ROUNDING * HELD * math.tan(math.radians(0.75)) / math.sqrt(2.0)
    assert (x + y) / math.sqrt(2.0) == pytest.approx(pull / 0.5, rel=1e-3)
    assert (x - y) / math.sqrt(2.0) == pytest.approx(pull / 0.01, rel=1e-3)
    assert 1000.0 * math.hypot(x, y) == pytest.approx(5.56, abs=0.01)
    run = sg.simulate(field(0.0, 5.0), BOX, (1.5, 1.5, 0.0), duration=60.0, method="explicit")
    np.testing.assert_array_equal(run.pose[-1], run.pose[0])
