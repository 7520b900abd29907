"""The line for a parcel, and the runs over it, against `simulate`."""

import math
from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import layouts
from surface_gym.design.runs import REST_SPEED, DesignLine, line_for, make_runs, run_all

BOX = layouts.box("S")
LINE = line_for(BOX, 8)
EIGHTH = math.pi / 4


@pytest.mark.parametrize(("size", "rows", "lead_in"), [("S", 2, 3), ("B", 4, 5)])
def test_the_study_s_boxes_get_the_study_s_lines(size, rows, lead_in):
    line = line_for(layouts.box(size), 30)
    assert (line.rows, line.lead_in, line.columns) == (rows, lead_in, 30)
    assert layouts.LINE_ROWS[size] == rows
    assert layouts.LEAD_IN[size] == lead_in


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


@pytest.mark.parametrize(("width", "rows"), [(0.05, 2), (0.25, 2), (0.4, 4), (0.45, 4), (0.6, 6)])
def test_rows_are_an_even_number_under_the_parcel(width, rows):
    assert line_for(sg.Parcel(sg.Rectangle(0.3, width)), 8).rows == rows


def test_what_is_not_allowed_is_named():
    given = {"rows": 2, "columns": 8, "lead_in": 3, "run_out": 10, "beside": 5}
    for wrong, message in (
        ({"rows": 0}, "rows must be a whole number of at least 1, got 0"),
        ({"columns": 1.5}, "columns must be a whole number of at least 1, got 1.5"),
        ({"pitch": -0.1}, "pitch must be greater than 0"),
        ({"mu_min": -1.0}, "mu_min must be at least 0"),
    ):
        with pytest.raises(ValueError, match=message):
            DesignLine(**given | wrong)
    with pytest.raises(ValueError, match=r"zone_axis must have the shape \(2, 8\)"):
        LINE.surface(np.full((8, 2), EIGHTH))
    large = sg.Parcel(sg.Rectangle(9.0, 9.0))
    line = line_for(large, 2)
    with pytest.raises(ValueError, match="base must cover at most"):
        run_all(line, np.zeros((1, line.rows, 2)), [large], make_runs(1.0))


def test_a_run_is_simulate_s_to_the_bit():
    """Where it ends is a state that `simulate` records, on the same surface."""
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
        assert ends.describe(0) != "out of time"
        np.testing.assert_array_equal(ends.pose[0], trajectory.pose[steps])
        np.testing.assert_array_equal(ends.velocity[0], trajectory.velocity[steps])


def test_runs_do_not_depend_on_threads_or_other_bodies():
    zones = np.stack([np.full((2, 8), EIGHTH), np.full((2, 8), 0.0)])
    speeds = np.linspace(0.3, 2.7, 150)
    runs = make_runs(speeds, layout=np.arange(150) % 2, columns=8)
    one, two = (run_all(LINE, zones, [BOX], runs, workers=workers) for workers in (1, 2))
    alone = [
        run_all(LINE, zones, [BOX], make_runs(v, layout=k % 2, columns=8))
        for k, v in enumerate(speeds[:5].tolist())
    ]
    for name in ("reason", "touched", "time", "pose", "velocity", "tipping", "steps"):
        each, few = getattr(one, name), [getattr(run, name) for run in alone]
        np.testing.assert_array_equal(each, getattr(two, name))
        np.testing.assert_array_equal(each[:5], np.concatenate(few))


def test_how_runs_end():
    rolls, sorts, brakes = 2.0 * EIGHTH, EIGHTH, 0.0
    zones = np.stack([np.full((2, 8), axis) for axis in (rolls, sorts, brakes)])
    ends = run_all(LINE, zones, [BOX], make_runs(1.5, layout=[0, 1, 2, 0], columns=[8, -1, 8, -1]))
    reasons = [ends.describe(run) for run in range(4)]
    assert reasons == ["past the zone", "out of the line", "at rest", "off the surface"]
    assert ends.touched[0] == 10  # the zone, and two columns in front of it as its rear leaves
    rear = ends.pose[0, 0] - 0.125  # has just left the centre of the zone's last column
    assert rear == pytest.approx(LINE.zone_x[1] - 0.05, abs=0.01)
    assert ends.pose[1, 1] < LINE.line_y
    assert np.abs(ends.velocity[2]).max() < REST_SPEED


def test_a_parcel_held_on_a_slope_is_at_rest_and_one_that_slides_is_not():
    runs = make_runs(0.0, tilt=np.radians([0.4, 1.0]), columns=4)
    ends = run_all(line_for(BOX, 4), np.zeros((1, 2, 4)), [BOX], runs)
    assert ends.describe(0) == "at rest"  # tan(0.4 deg) is below mu_min: not even the lead-in rolls
    assert ends.pose[0, 0] == pytest.approx(0.125)
    assert ends.pose[1, 0] > 0.2


@pytest.mark.parametrize("workers", [1, 2])
def test_progress_is_reported(workers):
    calls = []
    run_all(
        LINE, np.full((1, 2, 8), EIGHTH), [BOX], make_runs(np.full(100, 1.0)), workers=workers,
        on_progress=lambda *each: calls.append(each),
    )  # fmt: skip
    assert calls[-1] == (100, 100)
    assert sorted(calls) == calls
