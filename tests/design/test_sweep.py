"""What each thing unknown does alone and a map of success, against `simulate` run by run."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import layouts
from surface_gym.design.case import NOTHING, Case, Sort, Stop, Unknown, draw
from surface_gym.design.runs import line_for
from surface_gym.design.sweep import FIELDS, USUAL, SuccessMap, sensitivity, success_map

SPEEDS = (0.5, 1.0, 1.5)
SIZES = (0.7, 1.0, 1.3)
CASE = Case(layouts.box("S"), Sort(), speed=1.2, draws=10)
STOPPED = Case(layouts.box("S"), Stop(), speed=1.5, draws=6)


def mapped(case: Case = CASE, checkpoint: Path | None = None, **more: object) -> SuccessMap:
    return success_map(case, 5, SPEEDS, SIZES, checkpoint=checkpoint, **more)


@pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("speed", SPEEDS)
def test_a_parcel_of_another_size_on_the_same_zone_ends_where_simulate_has_it(size, speed):
    """A disc, whose sorting is seen from its middle alone."""
    disc = sg.Parcel(sg.Disc(0.15))
    found = success_map(Case(disc, Sort(), speed=1.2, unknown=NOTHING), 5, [speed], [size])

    scaled = sg.Parcel(sg.Disc(0.15 * size))
    line = found.arrangement.line
    own = line_for(scaled, line.columns, line.rows)
    line = replace(line, lead_in=own.lead_in, beside=own.beside + 3)
    surface = line.surface(found.arrangement.layout.axis)
    run = sg.simulate(surface, scaled, line.start(scaled), (speed, 0.0, 0.0), duration=4.0)
    outermost = line.line_y - 0.5 * (line.rows - 1) * line.pitch_y
    off = run.pose[:, 1] + 0.15 * size < outermost
    assert found.nominal[0, 0] == off.any()


def test_cells_do_not_depend_on_the_others_nor_on_threads_and_nothing_unknown_is_sure():
    """Elements are drawn for the largest size, so one more small size changes nothing."""
    every = mapped(workers=2)
    one = success_map(CASE, 5, SPEEDS[1:], SIZES[1:])
    np.testing.assert_array_equal(every.share[1:, 1:], one.share)
    assert every.share.shape == (3, 3)
    found = mapped(replace(CASE, unknown=NOTHING))
    np.testing.assert_array_equal(found.share, found.nominal)


def test_without_sizes_and_speeds_there_are_forty_of_each():
    quick = Case(layouts.box("S"), Stop(), speed=0.5, unknown=NOTHING)
    found = success_map(quick)
    assert found.share.shape == (40, 40)
    assert (found.sizes[0], found.sizes[-1]) == (0.5, 1.5)
    assert (found.speeds[0], found.speeds[-1]) == (0.1, 3.0)


def test_a_map_that_was_stopped_goes_on(tmp_path):
    file = tmp_path / "map.npz"
    rows, again = [], []

    def stop(done: int, total: int) -> None:
        rows.append(done)
        if done > total // 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mapped(checkpoint=file, on_progress=stop)
    assert [each.name for each in tmp_path.iterdir()] == ["map.npz"]

    resumed = mapped(checkpoint=file, on_progress=lambda done, _: again.append(done))
    assert again[0] > rows[0]  # what is done is not done again
    unbroken = mapped()
    np.testing.assert_array_equal(resumed.share, unbroken.share)
    np.testing.assert_array_equal(resumed.nominal, unbroken.nominal)


def test_a_map_of_another_case_or_none_is_refused_by_name(tmp_path):
    file = tmp_path / "map.npz"
    mapped(checkpoint=file)
    for other, named in (
        ({"speed": 1.3}, "another speed: 1.2, not 1.3"),
        ({"parcel": sg.Parcel(sg.Disc(0.125))}, "another parcel"),
        ({"unknown": Unknown(lateral=0.01)}, "another unknown"),
        ({"seed": 1}, "another seed: 0, not 1"),
    ):
        with pytest.raises(ValueError, match=f"checkpoint must be of this map, got .*{named}"):
            mapped(replace(CASE, **other), checkpoint=file)
    with pytest.raises(ValueError, match=r"another sizes: \[0.7, 1.0, 1.3\], not \[1.0\]"):
        success_map(CASE, 5, SPEEDS, [1.0], checkpoint=file)
    files = tmp_path / "broken.npz", tmp_path / "other.npz"
    files[0].write_bytes(b"PK nothing of the kind")
    np.savez(files[1], found=np.zeros(3))
    for file in files:
        with pytest.raises(ValueError, match="checkpoint must be one of a map, got"):
            mapped(checkpoint=file)


def test_errors_name_what_came():
    for speeds, sizes, error in (
        ([-1.0], [1.0], r"speeds must be between 0 and 20, got -1\.0"),
        ([1.0], [0.0], r"sizes must be greater than 0, got 0\.0"),
        ([], [1.0], "speeds must be at least one, got none"),
        ([1.0, 0.5], [1.0], r"speeds must rise, got 1 to 0\.5"),
        ([1.0], [0.8, 0.8], r"sizes must rise, got 0\.8 to 0\.8"),
        ([1.0], [1.0, 40.0], "base must cover at most 4096 elements"),
    ):
        with pytest.raises(ValueError, match=error):
            success_map(CASE, 5, speeds, sizes)


def rest(factor: float) -> float:
    """[m] past the zone's start where `simulate` has the S-box rest, friction times a factor."""
    found = sensitivity(STOPPED, columns=8).arrangement
    line, parcel = STOPPED.line(30), STOPPED.parcel
    axes = line.axes(found.layout.axis)
    surface = sg.Surface(axes, line.rotor, line.pitch, (0.05, 0.05), 0.5 * factor)
    run = sg.simulate(surface, parcel, line.start(parcel), (1.5, 0.0, 0.0), duration=2.0)
    assert np.abs(run.velocity[-1]).max() < 1e-3
    return float(run.pose[-1, 0] - line.zone_x[0])


@pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
def test_a_bar_is_what_simulate_finds_draw_by_draw():
    found = sensitivity(STOPPED, columns=8)
    bar = found.bars[list(FIELDS).index("friction")]
    only = Unknown(friction=0.2, rolling=0.0, com_offset=0.0, stiffness=0.0)
    drawn = draw(only, STOPPED.parcel, found.arrangement.line, 6, 0)
    places = [rest(float(factor)) for factor in drawn.friction[:, 0]]
    expected = np.quantile(places, (0.05, 0.95))
    assert (bar.low, bar.high) == pytest.approx(tuple(expected), abs=1e-5)
    assert found.measure == pytest.approx(rest(1.0), abs=1e-5)
    assert bar.success == 1.0


def test_every_field_has_a_bar_and_threads_do_not_matter():
    found = sensitivity(STOPPED, columns=8)
    assert [bar.field for bar in found.bars] == list(FIELDS)
    usual = {bar.field for bar in found.bars if bar.usual}
    assert usual == {"mass", "lateral", "heading", "speed", "tilt"}
    by_field = {bar.field: bar for bar in found.bars}
    assert by_field["friction"].spread == STOPPED.unknown.friction
    assert by_field["speed"].spread == USUAL.speed
    assert by_field["friction"].low < found.measure < by_field["friction"].high
    assert sensitivity(STOPPED, columns=8, workers=2).bars == found.bars


def test_with_no_draw_that_comes_so_far_a_bar_is_empty_and_columns_must_be_given():
    """A slow box never gets off the line."""
    found = sensitivity(Case(layouts.box("S"), Sort(), speed=0.3, draws=5), columns=5)
    assert not found.success
    assert math.isnan(found.measure)
    assert all(math.isnan(bar.low) and bar.success == 0.0 for bar in found.bars)
    with pytest.raises(ValueError, match="columns must be given"):
        sensitivity(Case(layouts.box("S"), Sort(), speed=0.3, unknown=NOTHING))
