"""Boxes on axes at +-45 deg in alternate rows: mirrored starts, a closed form, the verdict."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.paper.alignment import (
    INWARDS,
    OFFSETS,
    OUTWARDS,
    TURNS,
    Zone,
    align,
    crossing,
    end_of,
)


@pytest.mark.parametrize("size", ["S", "B"])
@pytest.mark.parametrize("towards", [INWARDS, OUTWARDS])
def test_a_mirrored_start_ends_mirrored(size, towards):
    zone = Zone(size, towards, columns=6, speed=2.5, tilt=5.0)

    one, other = end_of(crossing(zone, 0.02, 7.0)), end_of(crossing(zone, -0.02, -7.0))

    assert other[0] == pytest.approx(-one[0], abs=1e-6)
    assert other[1] == pytest.approx(-one[1], abs=1e-3)


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

    run = sg.simulate(surface, sg.layouts.box("S"), start, (2.0, 0.0, 0.0), 0.01, dt=1e-4)

    expected = k * offset / half_distance / (1.0 - k * height / half_distance)
    measured = -np.diff(run.velocity[-20:, 1]).mean() / 1e-4 / 9.81
    assert measured == pytest.approx(expected, rel=0.05)


def by_name(reproduction, size, towards, columns):
    return [
        case
        for case in reproduction.alignment
        if (case.zone.size, case.zone.towards, case.zone.columns) == (size, towards, columns)
    ]


def test_two_columns_that_push_inwards_centre_a_box_and_turn_it_further(reproduction):
    for case in by_name(reproduction, "S", INWARDS, 2):
        offsets = [abs(end[0]) for end in case.straight]
        assert offsets[0] < 0.65 * OFFSETS[0]
        assert offsets[1] < 0.65 * OFFSETS[1]
        assert offsets[2] > OFFSETS[2]  # a row of supports lies under it
        assert all(abs(end[1]) > came for end, came in zip(case.centred, TURNS, strict=True))


def test_columns_that_push_outwards_straighten_a_box_and_push_it_off(reproduction):
    for columns in (2, 6):
        for case in by_name(reproduction, "S", OUTWARDS, columns):
            assert abs(case.straight[0][0]) > 1.2 * OFFSETS[0]
            assert all(abs(end[1]) < came for end, came in zip(case.centred, TURNS, strict=True))


def test_nothing_aligns_in_both(reproduction):
    assert {case.mixed for case in reproduction.alignment} == {12}
    assert max(case.nearer for case in reproduction.alignment) <= 2


def test_the_big_box_hardly_feels_a_short_zone(reproduction):
    for towards in (INWARDS, OUTWARDS):
        for case in by_name(reproduction, "B", towards, 2):
            for end, came in zip(case.straight, OFFSETS, strict=True):
                assert end[0] == pytest.approx(came, abs=1e-3)


def test_a_long_zone_lets_boxes_swing_and_spin(reproduction):
    level = [c for c in reproduction.alignment if c.zone.columns == 30 and c.zone.tilt == 0.0]
    outwards = [c for c in level if (c.zone.size, c.zone.towards) == ("S", OUTWARDS)]

    assert all(abs(end[0]) > 0.15 for end in outwards[0].straight)  # out of the line
    assert all(max(abs(end[1]) for end in case.straight) > 40.0 for case in level)


def test_a_box_in_the_middle_and_straight_stays_so():
    run = crossing(Zone("S", OUTWARDS, columns=6, speed=2.5, tilt=0.0), 0.0, 0.0)

    assert abs(end_of(run)[0]) < 1e-6
    assert abs(end_of(run)[1]) < 1e-6


def test_short_zones_do_not_hang_on_the_step():
    zone = Zone("S", INWARDS, columns=2, speed=1.5, tilt=0.0)
    surface = zone.surface
    start = (0.125, sg.layouts.LINE_Y + 0.01, 0.0)
    ends = [
        sg.simulate(surface, sg.layouts.box("S"), start, (1.5, 0.0, 0.0), 0.5, dt=dt).pose[-1]
        for dt in (1e-3, 1e-4)
    ]

    assert ends[0] == pytest.approx(ends[1], abs=1e-3)
    assert align(zone).straight[0][0] == pytest.approx(0.0036, abs=5e-4)
