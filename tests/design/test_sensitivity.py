"""What each thing unknown does alone: against `simulate`, run by run."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import layouts
from surface_gym.design.case import NOTHING, Case, Sort, Stop, Unknown, draw
from surface_gym.design.sweep import FIELDS, USUAL, sensitivity

CASE = Case(layouts.box("S"), Stop(), speed=1.5, draws=6)


def rest(factor: float) -> float:
    """[m] past the zone's start where `simulate` has the S-box rest, friction times a factor."""
    found = sensitivity(CASE, columns=8).arrangement
    line = CASE.line(30)
    surface = sg.Surface(
        line.axes(found.layout.axis), line.rotor, line.pitch, (0.05, 0.05), 0.5 * factor
    )
    run = sg.simulate(surface, CASE.parcel, line.start(CASE.parcel), (1.5, 0.0, 0.0), duration=2.0)
    assert np.abs(run.velocity[-1]).max() < 1e-3
    return float(run.pose[-1, 0] - line.zone_x[0])


def test_a_bar_is_what_simulate_finds_draw_by_draw():
    found = sensitivity(CASE, columns=8)
    bar = found.bars[list(FIELDS).index("friction")]
    only = Unknown(friction=0.2, rolling=0.0, com_offset=0.0, stiffness=0.0)
    drawn = draw(only, CASE.parcel, found.arrangement.line, 6, 0)
    places = [rest(float(factor)) for factor in drawn.friction[:, 0]]
    expected = np.quantile(places, (0.05, 0.95))
    assert (bar.low, bar.high) == pytest.approx(tuple(expected), abs=1e-5)
    assert found.measure == pytest.approx(rest(1.0), abs=1e-5)
    assert bar.success == 1.0


def test_every_field_has_a_bar_and_usual_spreads_are_marked():
    found = sensitivity(CASE, columns=8)
    assert [bar.field for bar in found.bars] == list(FIELDS)
    usual = {bar.field for bar in found.bars if bar.usual}
    assert usual == {"mass", "lateral", "heading", "speed", "tilt"}
    by_field = {bar.field: bar for bar in found.bars}
    assert by_field["friction"].spread == CASE.unknown.friction
    assert by_field["speed"].spread == USUAL.speed


def test_with_no_draw_that_comes_so_far_a_bar_is_empty():
    """A slow box never gets off the line."""
    found = sensitivity(Case(layouts.box("S"), Sort(), speed=0.3, draws=5), columns=5)
    assert not found.success
    assert math.isnan(found.measure)
    assert all(math.isnan(bar.low) and bar.success == 0.0 for bar in found.bars)


def test_more_friction_stops_sooner_and_threads_do_not_matter():
    one, two = (sensitivity(CASE, columns=8, workers=workers) for workers in (1, 2))
    assert one.bars == two.bars
    friction = one.bars[list(FIELDS).index("friction")]
    assert friction.low < one.measure < friction.high


def test_columns_must_be_enough_or_given():
    with pytest.raises(ValueError, match="columns must be given"):
        sensitivity(Case(layouts.box("S"), Sort(), speed=0.3, unknown=NOTHING))
