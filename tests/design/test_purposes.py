import math

import numpy as np
import pytest

from surface_gym import layouts
from surface_gym.design.line import line_for
from surface_gym.design.purposes import Purpose, Slow, Sort, Stop, Turn
from surface_gym.design.runs import make_runs, run_all

BOX = layouts.box("S")
LINE = line_for(BOX, 8)


def test_layouts_are_the_study_s() -> None:
    sorting = layouts.sorting("S", side=1, task_columns=3)
    found = Sort(side=1).layouts(LINE, 3)[0].axis
    np.testing.assert_array_equal(found[:, :3], sorting.axis[9:11, 3:6])
    np.testing.assert_array_equal(found[:, 3:], layouts.ROLLING)
    for k, angle in enumerate((0.0, math.pi / 4)):
        slowing = layouts.slowing("S", angle, 3)
        found = Slow().layouts(LINE, 3)[k].axis
        np.testing.assert_array_equal(found[:, :3], slowing.axis[9:11, 3:6])


@pytest.mark.parametrize("purpose", [Sort(), Turn(math.radians(20.0))])
def test_the_other_side_is_the_mirror_image(purpose: Purpose) -> None:
    other = Sort(1) if isinstance(purpose, Sort) else Turn(math.radians(-20.0))
    ends = []
    for each in (purpose, other):
        axes = each.layouts(LINE, 4)[0].axis[np.newaxis]
        runs = make_runs(1.5, columns=4 if each.leaves_zone else -1)
        ends.append(run_all(LINE, axes, [BOX], runs, dt=0.001))
    one, two = ends
    assert one.how[0] == two.how[0]
    assert one.pose[0, 0] == pytest.approx(two.pose[0, 0], abs=1e-4)
    assert one.pose[0, 1] - LINE.line_y == pytest.approx(LINE.line_y - two.pose[0, 1], abs=1e-4)
    assert one.pose[0, 2] == pytest.approx(-two.pose[0, 2], abs=1e-3)


def test_slow_down_to_a_share_or_to_just_that() -> None:
    axes = np.stack([layout.axis for layout in Slow().layouts(LINE, 1)])
    runs = make_runs(1.5, layout=[0, 1], columns=1)
    ends = run_all(LINE, axes, [BOX], runs)
    ratio = Slow().measure(LINE, runs, ends)
    np.testing.assert_allclose(ratio, ends.velocity[:, 0] / 1.5)
    for k in (0, 1):
        assert Slow(ratio[k] + 0.01).succeeds(LINE, runs, ends)[k]
        assert not Slow(ratio[k] - 0.01).succeeds(LINE, runs, ends)[k]
        assert not Slow(ratio[k] + 0.02, tolerance=0.01).succeeds(LINE, runs, ends)[k]
        assert Slow(ratio[k] + 0.02, tolerance=0.03).succeeds(LINE, runs, ends)[k]


def test_a_parcel_that_stops_has_no_exit_speed_and_one_that_leaves_no_place() -> None:
    axes = np.stack([np.zeros((2, 8)), np.full((2, 8), layouts.ROLLING)])
    runs = make_runs(1.0, layout=[0, 1], columns=8)
    ends = run_all(LINE, axes, [BOX], runs)
    assert np.isnan(Slow().measure(LINE, runs, ends)).tolist() == [True, False]
    assert np.isnan(Stop().measure(LINE, runs, ends)).tolist() == [False, True]
    assert Stop().succeeds(LINE, runs, ends).tolist() == [True, False]
    rest = Stop().measure(LINE, runs, ends)[0]
    assert Stop(rest + 0.02).succeeds(LINE, runs, ends).tolist() == [True, False]
    assert not Stop(rest + 0.02, tolerance=0.01).succeeds(LINE, runs, ends).any()


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda: Sort(0), "side must be one of -1, 1, got 0"),
        (lambda: Slow(1.0), "ratio must be between 0 and 1, got 1.0"),
        (lambda: Slow(tolerance=0.0), "tolerance must be greater than 0"),
        (lambda: Stop(place=math.nan), "place must be a finite number"),
        (lambda: Stop(tolerance=-1.0), "tolerance must be greater than 0"),
        (lambda: Turn(0.0), "angle must not be 0"),
        (lambda: Turn(tolerance=0.0), "tolerance must be greater than 0"),
    ],
)
def test_what_is_not_allowed_is_named(make: object, told: str) -> None:
    assert callable(make)
    with pytest.raises(ValueError, match=told):
        make()
