"""The case of a design, and its line and runs held against `simulate`."""

import math
from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import layouts
from surface_gym.design import (
    Case,
    SlowPurpose,
    SortPurpose,
    StopPurpose,
    TurnPurpose,
    Unknown,
    case,
)
from surface_gym.design.case import NOTHING
from surface_gym.design.runs import (
    AT_REST,
    OFF,
    OUT,
    OUT_OF_TIME,
    PAST,
    REST_SPEED,
    DesignLine,
    line_for,
    make_runs,
    run_all,
)

BOX = layouts.box("S")
LINE = line_for(BOX, 8)
EIGHTH = math.pi / 4
LARGE = sg.Parcel(sg.Rectangle(9.0, 9.0))
BOARD = line_for(LARGE, 2)
BOARD_AXES = np.zeros((1, BOARD.rows, 2))


def line_with(**wrong: float) -> DesignLine:
    given = {"rows": 2, "columns": 8, "lead_in": 3, "run_out": 10, "beside": 5}
    return DesignLine(**given | wrong)


def test_a_group_varies_alone():
    unknown = Unknown(lateral=0.01)
    assert unknown.groups == (*case.GROUPS, case.TOGETHER)
    friction = unknown.only("friction")
    assert (friction.friction, friction.rolling) == (0.2, 0.2)
    assert friction.stiffness == friction.com_offset == friction.lateral == 0.0
    assert unknown.only(case.TOGETHER) == unknown
    assert NOTHING.groups == ()


def test_draws_follow_their_laws_however_many_there_are():
    spread = Unknown(speed=0.1, tilt=0.02, lateral=0.03)
    drawn = Case(BOX, draws=2000).draw(LINE, spread)
    assert np.abs(drawn.friction - 1.0).max() <= 0.2
    assert drawn.friction.std(axis=0) == pytest.approx(0.4 / np.sqrt(12.0), rel=0.05)
    spreads = [drawn.speed.std(), drawn.tilt.std(), drawn.lateral.std()]
    assert spreads == pytest.approx([0.1, 0.02, 0.03], rel=0.05)
    assert np.log(drawn.stiffness).std() == pytest.approx(0.35, rel=0.01)
    assert max(abs(each) for parcel in drawn.parcels for each in parcel.com_offset) <= 0.0125
    few, many = (Case(BOX, draws=count, seed=3).draw(LINE, Unknown()) for count in (2, 5))
    np.testing.assert_array_equal(few.friction, many.friction[:2])
    np.testing.assert_array_equal(few.stiffness, many.stiffness[:2])
    assert few.parcels == many.parcels[:2]
    drawn = Case(BOX, draws=50).draw(LINE, Unknown(speed=0.5))
    runs = drawn.runs(0.6, 0.0, columns=4, layout=2)
    assert runs.speed.min() >= 0.0
    np.testing.assert_allclose(runs.speed, np.maximum(0.0, 0.6 + drawn.speed))
    np.testing.assert_array_equal(runs.stiffness, np.arange(50))
    assert (runs.layout == 2).all()
    assert (runs.columns == 4).all()


def test_layouts_are_the_study_s():
    sorting = layouts.sorting("S", side=1, task_columns=3)
    found = SortPurpose(side=1).layouts(LINE, 3)[0].axis
    np.testing.assert_array_equal(found[:, :3], sorting.axis[9:11, 3:6])
    np.testing.assert_array_equal(found[:, 3:], layouts.ROLLING)
    for k, angle in enumerate((0.0, math.pi / 4)):
        slowing = layouts.slowing("S", angle, 3)
        found = SlowPurpose().layouts(LINE, 3)[k].axis
        np.testing.assert_array_equal(found[:, :3], slowing.axis[9:11, 3:6])


@pytest.mark.parametrize(
    "purposes", [(SortPurpose(), SortPurpose(1)), (TurnPurpose(0.35), TurnPurpose(-0.35))]
)
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
    axes = np.stack([layout.axis for layout in SlowPurpose().layouts(LINE, 1)])
    ends = run_all(LINE, axes, [BOX], make_runs(1.5, layout=[0, 1], columns=1))
    ratio = SlowPurpose().measure(ends)
    np.testing.assert_allclose(ratio, ends.velocity[:, 0] / 1.5)
    for k in (0, 1):
        for off, tolerance, does in (
            (0.01, None, True), (-0.01, None, False), (0.02, 0.01, False), (0.02, 0.03, True),
        ):  # fmt: skip
            assert SlowPurpose(ratio[k] + off, tolerance).succeeds(ends)[k] == does


def test_a_parcel_that_stops_has_no_exit_speed_and_one_that_leaves_no_place():
    axes = np.stack([np.zeros((2, 8)), np.full((2, 8), layouts.ROLLING)])
    ends = run_all(LINE, axes, [BOX], make_runs(1.0, layout=[0, 1], columns=8))
    assert np.isnan(SlowPurpose().measure(ends)).tolist() == [True, False]
    assert np.isnan(StopPurpose().measure(ends)).tolist() == [False, True]
    assert StopPurpose().succeeds(ends).tolist() == [True, False]
    rest = StopPurpose().measure(ends)[0]
    assert StopPurpose(rest + 0.02).succeeds(ends).tolist() == [True, False]
    assert not StopPurpose(rest + 0.02, tolerance=0.01).succeeds(ends).any()


def test_what_is_not_allowed_is_named():
    for make, message in (
        (lambda: line_with(rows=0), "rows must be a whole number of at least 1, got 0"),
        (lambda: line_with(pitch=-0.1), "pitch must be greater than 0"),
        (lambda: line_with(mu_min=-1.0), "mu_min must be at least 0"),
        (lambda: LINE.surface(np.zeros((8, 2))), r"zone_axis must have the shape \(2, 8\)"),
        (lambda: run_all(BOARD, BOARD_AXES, [LARGE], make_runs(1.0)), "base must cover at most"),
        (lambda: Case("S"), "parcel must be a Parcel, got 'S'"),
        (lambda: Case(BOX, unknown=sg.Randomisation()), "unknown must be an Unknown"),
        (lambda: Case(BOX, speed=-1.0), "speed must be between 0 and 20, got -1.0"),
        (lambda: Case(BOX, speed=0.0), "speed must be greater than 0 on a level surface"),
        (lambda: Case(BOX, tilt=1.0), r"tilt must be from 0 to below pi/4 \(45 deg\), got 1.0"),
        (lambda: Case(BOX, draws=0), "draws must be a whole number of at least 1, got 0"),
        (lambda: Case(BOX, step=1.0), "step must be between 1e-05 and 0.02, got 1.0"),
        (lambda: Unknown(size=0.1), r"size must be 0, got 0.1: the parcel is given"),
        (lambda: SortPurpose(0), "side must be one of -1, 1, got 0"),
        (lambda: SlowPurpose(1.0), "ratio must be between 0 and 1, got 1.0"),
        (lambda: SlowPurpose(tolerance=0.0), "tolerance must be greater than 0"),
        (lambda: StopPurpose(place=math.nan), "place must be a finite number"),
        (lambda: TurnPurpose(0.0), "angle must not be 0"),
    ):
        with pytest.raises(ValueError, match=message):
            make()


@pytest.mark.parametrize(("size", "rows", "lead_in"), [("S", 2, 3), ("B", 4, 5)])
def test_the_study_s_boxes_get_the_study_s_lines(size, rows, lead_in):
    line = line_for(layouts.box(size), 30)
    assert (line.rows, line.lead_in, line.columns) == (rows, lead_in, 30)
    assert (layouts.LINE_ROWS[size], layouts.LEAD_IN[size]) == (rows, lead_in)


def test_a_parcel_starts_wholly_on_the_lead_in():
    parcel = sg.Parcel(sg.Polygon([(0.0, 0.0), (0.4, 0.0), (0.1, 0.3)]))
    line = line_for(parcel, 8, pitch=(0.08, 0.12))
    x, y, theta = line.start(parcel)
    outline = np.add(parcel.base.outline, (x, y))
    assert theta == 0.0
    assert outline[:, 0].min() == pytest.approx(0.0)
    assert outline[:, 0].max() <= line.zone_x[0] + 1e-12
    assert y + parcel.base.centroid[1] == pytest.approx(line.line_y)
    assert line.zone_x[1] - line.zone_x[0] == pytest.approx(8 * 0.08)


def test_supports_bear_a_parcel_beside_the_line_and_all_axes_but_the_zone_s_roll():
    line = line_for(layouts.box("B"), 8)
    aside = line.line_y - 0.5 * line.rows * line.pitch_y  # [m] of supports on one side
    assert aside > 2.0 * layouts.box("B").base.reach
    line = line_for(layouts.box("S"), 4)
    zone = np.radians([[0.0, 45.0, -45.0, 90.0], [10.0, 20.0, 30.0, 40.0]])
    surface = line.surface(zone, tilt=0.1)
    np.testing.assert_array_equal(surface.axis[line.zone], zone)
    rest = np.ones(line.shape, bool)
    rest[line.zone] = False
    assert (surface.axis[rest] == layouts.ROLLING).all()
    assert surface.rotor.sum() == 2 * line.shape[1]
    assert surface.tilt == 0.1
    for width, rows in ((0.05, 2), (0.25, 2), (0.4, 4), (0.45, 4), (0.6, 6)):  # even numbers
        assert line_for(sg.Parcel(sg.Rectangle(0.3, width)), 8).rows == rows


@pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
def test_a_run_is_simulate_s_to_the_bit():
    rng = np.random.default_rng(0)
    for k in range(12):
        base = [sg.Rectangle(0.3, 0.4), sg.Disc(0.17), sg.Rectangle(0.25, 0.25)][k % 3]
        parcel = sg.Parcel(base, com_offset=tuple(rng.uniform(-0.03, 0.03, 2)))
        line = line_for(parcel, 10)
        zone = rng.choice([0.0, EIGHTH, -EIGHTH, 2.0 * EIGHTH], (line.rows, 10))
        speed, tilt = rng.uniform(0.5, 2.5), rng.uniform(0.0, 0.1)
        stiffness = np.exp(0.3 * rng.standard_normal(line.shape))
        friction = rng.uniform(0.8, 1.2, 3)
        runs = make_runs(speed, tilt, friction=friction[None], lateral=0.01, heading=0.05)
        ends = run_all(line, zone[None], [parcel], runs, stiffness[None])
        mu_max, mu_min, mu_support = friction * (0.5, 0.01, 0.005)
        same = replace(
            line.surface(zone, tilt),
            mu_max=mu_max, mu_min=mu_min, mu_support=mu_support, stiffness=stiffness,
        )  # fmt: skip
        pose = np.add(line.start(parcel), (0.0, 0.01, 0.05))
        steps = int(ends.steps[0])
        trajectory = sg.simulate(same, parcel, pose, (speed, 0.0, 0.0), duration=steps * 0.005)
        assert ends.reason[0] != OUT_OF_TIME
        np.testing.assert_array_equal(ends.pose[0], trajectory.pose[steps])
        np.testing.assert_array_equal(ends.velocity[0], trajectory.velocity[steps])


def test_runs_do_not_depend_on_threads_or_other_bodies():
    zones = np.stack([np.full((2, 8), EIGHTH), np.full((2, 8), 0.0)])
    speeds = np.linspace(0.3, 2.7, 150)
    runs = make_runs(speeds, layout=np.arange(150) % 2, columns=8)
    one, two = (run_all(LINE, zones, [BOX], runs, workers=workers) for workers in (1, 2))
    calls = []
    run_all(LINE, zones, [BOX], runs, workers=2, on_progress=lambda *at: calls.append(at))
    assert calls[-1] == (150, 150)
    assert sorted(calls) == calls
    each_alone = [make_runs(speeds[k], layout=k % 2, columns=8) for k in range(5)]
    alone = [run_all(LINE, zones, [BOX], each) for each in each_alone]
    for name in ("reason", "touched", "time", "pose", "velocity", "tipping", "steps"):
        each, few = getattr(one, name), [getattr(run, name) for run in alone]
        np.testing.assert_array_equal(each, getattr(two, name))
        np.testing.assert_array_equal(each[:5], np.concatenate(few))


def test_how_runs_end():
    rolls, sorts, brakes = 2.0 * EIGHTH, EIGHTH, 0.0
    zones = np.stack([np.full((2, 8), axis) for axis in (rolls, sorts, brakes)])
    ends = run_all(LINE, zones, [BOX], make_runs(1.5, layout=[0, 1, 2, 0], columns=[8, -1, 8, -1]))
    assert ends.reason.tolist() == [PAST, OUT, AT_REST, OFF]
    assert ends.touched[0] == 10  # the zone, and two columns in front of it as its rear leaves
    rear = ends.pose[0, 0] - 0.125  # has just left the centre of the zone's last column
    assert rear == pytest.approx(LINE.zone_x[1] - 0.05, abs=0.01)
    assert ends.pose[1, 1] < LINE.line_y
    assert np.abs(ends.velocity[2]).max() < REST_SPEED


def test_a_parcel_held_on_a_slope_is_at_rest_and_one_that_slides_is_not():
    runs = make_runs(0.0, tilt=np.radians([0.4, 1.0]), columns=4)
    ends = run_all(line_for(BOX, 4), np.zeros((1, 2, 4)), [BOX], runs)
    assert ends.reason[0] == AT_REST  # tan(0.4 deg) is below mu_min: not even the lead-in rolls
    assert ends.pose[0, 0] == pytest.approx(0.125)
    assert ends.pose[1, 0] > 0.2
