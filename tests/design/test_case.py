"""The case of a design: its purposes and its unknown quantities."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import layouts
from surface_gym.design import case
from surface_gym.design.case import NOTHING, Case, Slow, Sort, Stop, Turn, Unknown, draw
from surface_gym.design.runs import line_for, make_runs, run_all

BOX = layouts.box("S")
LINE = line_for(BOX, 8)


def test_a_group_varies_alone():
    unknown = Unknown(lateral=0.01)
    assert unknown.groups == (*case.GROUPS, case.TOGETHER)
    friction = unknown.only("friction")
    assert (friction.friction, friction.rolling) == (0.2, 0.2)
    assert friction.stiffness == friction.com_offset == friction.lateral == 0.0
    assert unknown.only(case.TOGETHER) == unknown
    assert NOTHING.groups == ()


def test_draws_follow_their_laws_however_many_there_are():
    drawn = draw(Unknown(speed=0.1, tilt=0.02, lateral=0.03), BOX, LINE, 2000, 0)
    assert np.abs(drawn.friction - 1.0).max() <= 0.2
    assert drawn.friction.std(axis=0) == pytest.approx(0.4 / np.sqrt(12.0), rel=0.05)
    spreads = [drawn.speed.std(), drawn.tilt.std(), drawn.lateral.std()]
    assert spreads == pytest.approx([0.1, 0.02, 0.03], rel=0.05)
    assert np.log(drawn.stiffness).std() == pytest.approx(0.35, rel=0.01)
    assert max(abs(each) for parcel in drawn.parcels for each in parcel.com_offset) <= 0.0125
    few, many = (draw(Unknown(), BOX, LINE, count, 3) for count in (2, 5))
    np.testing.assert_array_equal(few.friction, many.friction[:2])
    np.testing.assert_array_equal(few.stiffness, many.stiffness[:2])
    assert few.parcels == many.parcels[:2]
    drawn = draw(Unknown(speed=0.5), BOX, LINE, 50, 0)
    runs = drawn.runs(0.6, 0.0, columns=4, layout=2)
    assert runs.speed.min() >= 0.0
    np.testing.assert_allclose(runs.speed, np.maximum(0.0, 0.6 + drawn.speed))
    np.testing.assert_array_equal(runs.stiffness, np.arange(50))
    assert (runs.layout == 2).all()
    assert (runs.columns == 4).all()


def test_layouts_are_the_study_s():
    sorting = layouts.sorting("S", side=1, task_columns=3)
    found = Sort(side=1).layouts(LINE, 3)[0].axis
    np.testing.assert_array_equal(found[:, :3], sorting.axis[9:11, 3:6])
    np.testing.assert_array_equal(found[:, 3:], layouts.ROLLING)
    for k, angle in enumerate((0.0, math.pi / 4)):
        slowing = layouts.slowing("S", angle, 3)
        found = Slow().layouts(LINE, 3)[k].axis
        np.testing.assert_array_equal(found[:, :3], slowing.axis[9:11, 3:6])


@pytest.mark.parametrize("purposes", [(Sort(), Sort(1)), (Turn(0.35), Turn(-0.35))])
def test_the_other_side_is_the_mirror_image(purposes):
    one, two = (
        run_all(
            LINE, each.layouts(LINE, 4)[0].axis[None], [BOX],
            make_runs(1.5, columns=4 if each.leaves_zone else -1), dt=0.001,
        )
        for each in purposes
    )  # fmt: skip
    assert one.reason[0] == two.reason[0]
    assert one.pose[0, 0] == pytest.approx(two.pose[0, 0], abs=1e-4)
    assert one.pose[0, 1] - LINE.line_y == pytest.approx(LINE.line_y - two.pose[0, 1], abs=1e-4)
    assert one.pose[0, 2] == pytest.approx(-two.pose[0, 2], abs=1e-3)


def test_slow_down_to_a_share_or_to_just_that():
    axes = np.stack([layout.axis for layout in Slow().layouts(LINE, 1)])
    ends = run_all(LINE, axes, [BOX], make_runs(1.5, layout=[0, 1], columns=1))
    ratio = Slow().measure(ends)
    np.testing.assert_allclose(ratio, ends.velocity[:, 0] / 1.5)
    for k in (0, 1):
        for off, tolerance, does in (
            (0.01, None, True), (-0.01, None, False), (0.02, 0.01, False), (0.02, 0.03, True),
        ):  # fmt: skip
            assert Slow(ratio[k] + off, tolerance).succeeds(ends)[k] == does


def test_a_parcel_that_stops_has_no_exit_speed_and_one_that_leaves_no_place():
    axes = np.stack([np.zeros((2, 8)), np.full((2, 8), layouts.ROLLING)])
    ends = run_all(LINE, axes, [BOX], make_runs(1.0, layout=[0, 1], columns=8))
    assert np.isnan(Slow().measure(ends)).tolist() == [True, False]
    assert np.isnan(Stop().measure(ends)).tolist() == [False, True]
    assert Stop().succeeds(ends).tolist() == [True, False]
    rest = Stop().measure(ends)[0]
    assert Stop(rest + 0.02).succeeds(ends).tolist() == [True, False]
    assert not Stop(rest + 0.02, tolerance=0.01).succeeds(ends).any()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Case("S"), "parcel must be a Parcel, got 'S'"),
        (lambda: Case(BOX, "sort"), "purpose must be a Purpose, got 'sort'"),
        (lambda: Case(BOX, unknown=sg.Randomisation()), "unknown must be an Unknown"),
        (lambda: Case(BOX, speed=-1.0), "speed must be between 0 and 20, got -1.0"),
        (lambda: Case(BOX, speed=0.0), "speed must be greater than 0 on a level surface"),
        (lambda: Case(BOX, tilt=1.0), r"tilt must be from 0 to below pi/4 \(45 deg\), got 1.0"),
        (lambda: Case(BOX, draws=0), "draws must be a whole number of at least 1, got 0"),
        (lambda: Case(BOX, step=1.0), "step must be between 1e-05 and 0.02, got 1.0"),
        (lambda: Unknown(size=0.1), r"size must be 0, got 0.1: a map goes over sizes"),
        (lambda: Sort(0), "side must be one of -1, 1, got 0"),
        (lambda: Slow(1.0), "ratio must be between 0 and 1, got 1.0"),
        (lambda: Slow(tolerance=0.0), "tolerance must be greater than 0"),
        (lambda: Stop(place=math.nan), "place must be a finite number"),
        (lambda: Stop(tolerance=-1.0), "tolerance must be greater than 0"),
        (lambda: Turn(0.0), "angle must not be 0"),
        (lambda: Turn(tolerance=0.0), "tolerance must be greater than 0"),
    ],
)
def test_what_is_not_allowed_is_named(make, message):
    with pytest.raises(ValueError, match=message):
        make()
