"""A map of success: its cells against `simulate`, its checkpoint."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import layouts
from surface_gym.design.case import NOMINAL, NOTHING, Case, Sort, Stop, Unknown
from surface_gym.design.limits import least_speed
from surface_gym.design.runs import line_for
from surface_gym.design.sweep import SuccessMap, success_map

SPEEDS = (0.5, 1.0, 1.5)
SIZES = (0.7, 1.0, 1.3)
CASE = Case(layouts.box("S"), Sort(), speed=1.2, draws=10)


def mapped(case: Case = CASE, checkpoint: Path | None = None, **more: object) -> SuccessMap:
    return success_map(case, 5, SPEEDS, SIZES, checkpoint=checkpoint, **more)


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


def test_the_parcel_as_it_is_does_as_by_the_limits_of_speed():
    speeds = np.arange(0.5, 2.51, 0.1).round(9)
    found = success_map(CASE, 5, speeds.tolist(), [1.0])
    limits = least_speed(CASE, 5).of(NOMINAL)
    places = [np.abs(limits.values - speed).argmin() for speed in speeds]
    np.testing.assert_array_equal(found.nominal[0], limits.share[places] == 1.0)


def test_with_nothing_unknown_share_and_success_are_the_same():
    found = mapped(replace(CASE, unknown=NOTHING))
    np.testing.assert_array_equal(found.share, found.nominal)


def test_cells_do_not_depend_on_the_others_nor_on_threads():
    """Elements are drawn for the largest size, so one more small size changes nothing."""
    every = mapped(workers=2)
    one = success_map(CASE, 5, SPEEDS[1:], SIZES[1:])
    np.testing.assert_array_equal(every.share[1:, 1:], one.share)
    assert every.share.shape == (3, 3)


def test_without_sizes_and_speeds_there_are_forty_of_each():
    quick = Case(layouts.box("S"), Stop(), speed=0.5, unknown=NOTHING)
    found = success_map(quick)
    assert found.share.shape == (40, 40)
    assert (found.sizes[0], found.sizes[-1]) == (0.5, 1.5)
    assert (found.speeds[0], found.speeds[-1]) == (0.1, 3.0)


def test_a_map_that_was_stopped_goes_on(tmp_path):
    file = tmp_path / "map.npz"
    rows: list[int] = []

    def stop(done: int, total: int) -> None:
        rows.append(done)
        if done > total // 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        mapped(checkpoint=file, on_progress=stop)
    assert [each.name for each in tmp_path.iterdir()] == ["map.npz"]

    again: list[int] = []
    resumed = mapped(checkpoint=file, on_progress=lambda done, _: again.append(done))
    assert again[0] > rows[0]  # what is done is not done again
    unbroken = mapped()
    np.testing.assert_array_equal(resumed.share, unbroken.share)
    np.testing.assert_array_equal(resumed.nominal, unbroken.nominal)


@pytest.mark.parametrize(
    ("other", "named"),
    [
        (replace(CASE, speed=1.3), "another speed: 1.2, not 1.3"),
        (replace(CASE, parcel=sg.Parcel(sg.Disc(0.125))), "another parcel"),
        (replace(CASE, unknown=Unknown(lateral=0.01)), "another unknown"),
        (replace(CASE, seed=1), "another seed: 0, not 1"),
    ],
)
def test_a_map_of_another_case_is_refused_by_name(tmp_path, other, named):
    file = tmp_path / "map.npz"
    mapped(checkpoint=file)
    with pytest.raises(ValueError, match=f"checkpoint must be of this map, got .*{named}"):
        mapped(other, checkpoint=file)
    with pytest.raises(ValueError, match=r"another sizes: \[0.7, 1.0, 1.3\], not \[1.0\]"):
        success_map(CASE, 5, SPEEDS, [1.0], checkpoint=file)


def test_what_is_no_checkpoint_is_said(tmp_path):
    file = tmp_path / "map.npz"
    file.write_bytes(b"PK nothing of the kind")
    with pytest.raises(ValueError, match="checkpoint must be one of a map, got"):
        mapped(checkpoint=file)
    np.savez(file, found=np.zeros(3))
    with pytest.raises(ValueError, match="checkpoint must be one of a map, got"):
        mapped(checkpoint=file)


def test_errors_name_what_came():
    with pytest.raises(ValueError, match=r"speeds must be between 0 and 20, got -1\.0"):
        success_map(CASE, 5, [-1.0], [1.0])
    with pytest.raises(ValueError, match=r"sizes must be greater than 0, got 0\.0"):
        success_map(CASE, 5, [1.0], [0.0])
    with pytest.raises(ValueError, match="speeds must be at least one, got none"):
        success_map(CASE, 5, [], [1.0])
    with pytest.raises(ValueError, match="base must cover at most 4096 elements"):
        success_map(CASE, 5, [1.0], [1.0, 40.0])
