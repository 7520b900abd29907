"""How many columns, how slow, flat and slippery: against the study, `simulate`, closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import layouts
from surface_gym.design import Case, SlowPurpose, SortPurpose, StopPurpose, TurnPurpose, Unknown
from surface_gym.design.case import NOMINAL, NOTHING, TOGETHER
from surface_gym.design.columns import least_columns
from surface_gym.design.limits import (
    Arrangement,
    arrange,
    friction_range,
    least_speed,
    least_tilt,
    span_around,
)
from surface_gym.paper.runs import SlowingLayout, load_targets
from surface_gym.physics.types import GRAVITY
from tests.environments import outside

TARGETS = load_targets()
FINE = 0.0005  # [s]
OWN = sg.Parcel(sg.Rectangle(0.3, 0.4), mass=12.0)
LARGE = Case(OWN, SortPurpose(), speed=1.2, unknown=NOTHING)


@pytest.mark.parametrize("size", ["S", "B"])
def test_table_3(size):
    """The S-box at 1.5 m/s takes 5 (the study 4); the B-box is sorted at 1.0 m/s (there not)."""
    case = Case(layouts.box(size), SortPurpose(), unknown=NOTHING, step=FINE)
    ours = [least_columns(replace(case, speed=v)).columns for v in TARGETS.sorting_speeds]
    same = [one == other for one, other in zip(ours, TARGETS.sorting_columns[size], strict=True)]
    assert sum(same) == 19


@pytest.mark.parametrize(("size", "agree"), [("S", 18), ("B", 17)])
def test_table_4(size, agree):
    case = Case(layouts.box(size), SlowPurpose(0.5), unknown=NOTHING, step=FINE)
    found = [least_columns(replace(case, speed=v), most=8) for v in TARGETS.slowing_speeds]
    angle = {"0 deg": 0, "+-45 deg": 45}
    same = [
        ours.columns is not None and SlowingLayout(ours.columns, angle[ours.layout]) == theirs
        for ours, theirs in zip(found, TARGETS.slowing_layouts[size], strict=True)
    ]
    assert sum(same) == agree


def test_the_columns_found_are_enough_and_one_less_is_not():
    found = least_columns(LARGE)

    def aside(columns: int) -> float:
        """[m] that the parcel gets from the line's middle within 3 s."""
        line = LARGE.line(30)
        surface = line.surface(LARGE.purpose.layouts(line, columns)[0].axis)
        run = sg.simulate(surface, OWN, line.start(OWN), (1.2, 0.0, 0.0), duration=3.0)
        return float(np.abs(run.pose[-1, 1] - line.line_y))

    clear = 0.5 * 0.4 + 0.15  # half the parcel and half the line
    assert aside(found.fewest) > clear
    assert aside(found.fewest - 1) < clear
    assert found.fewest <= found.columns
    assert found.modules == 4 * found.columns


def test_mass_alone_changes_nothing_and_worse_draws_take_more_columns():
    base = sg.Rectangle(0.3, 0.4)
    light, heavy = (least_columns(Case(sg.Parcel(base, mass=mass), speed=1.2)) for mass in (1, 50))
    assert light == heavy
    case = Case(layouts.box("S"), speed=1.45, unknown=Unknown(friction=0.6), draws=60)
    found = least_columns(case)
    friction = next(worst for worst in found.worst if worst.group == "friction")
    assert friction.columns > found.columns
    assert friction.success < 0.95


def test_too_slow_a_parcel_is_never_sorted_and_no_columns_are_refused():
    found = least_columns(Case(layouts.box("B"), speed=0.5, draws=5))
    assert found.columns is found.fewest is found.modules is None
    assert math.isnan(found.measure)
    assert all(worst.columns is None and worst.success == 0.0 for worst in found.worst)
    with pytest.raises(ValueError, match="most must be a whole number of at least 1, got 0"):
        least_columns(Case(layouts.box("S")), most=0)


@pytest.mark.parametrize(
    ("purpose", "speed", "low", "high"),
    [
        (StopPurpose(), 1.5, 0.0, math.inf),
        (TurnPurpose(tolerance=0.2), 1.5, 0.3, 0.8),
        (StopPurpose(place=0.2, tolerance=0.05), 1.2, 0.15, 0.25),
    ],
)
def test_other_purposes(purpose, speed, low, high):
    found = least_columns(Case(layouts.box("S"), purpose, speed, unknown=Unknown(), draws=10))
    assert found.columns
    assert low < found.measure < high


CASE = Case(layouts.box("S"), SortPurpose(), speed=1.2, unknown=NOTHING)


def is_sorted(arrangement: Arrangement, speed: float, mu_factor: float = 1.0) -> bool:
    """Whether no rotor bears the parcel any more, by `simulate`, which knows no design."""
    line, parcel = arrangement.line, arrangement.case.parcel
    line = replace(line, mu_max=line.mu_max * mu_factor)
    surface = line.surface(arrangement.layout.axis)
    run = sg.simulate(surface, parcel, line.start(parcel), (speed, 0.0, 0.0), duration=4.0)
    at_x, at_y = np.meshgrid(surface.x, surface.y)
    rotors = at_x[surface.rotor], at_y[surface.rotor]
    return any(outside(parcel.base, pose, *rotors).min() > 0.0 for pose in run.pose)


@pytest.mark.filterwarnings("ignore::surface_gym.TippingWarning")
def test_simulate_agrees_on_both_sides_of_the_limits_of_speed_and_friction():
    speeds, factors = least_speed(LARGE), friction_range(LARGE).along
    found, step = speeds.spans[0], 0.01
    tried = (found.least - step, found.least, found.most, found.most + step)
    sorts = [is_sorted(speeds.arrangement, speed) for speed in tried]
    assert sorts == [False, True, True, False]
    found, step = factors.spans[0], 2.0 ** (1.0 / 48.0)
    tried = (found.least / step, found.least, found.most, found.most * step)
    sorts = [is_sorted(factors.arrangement, 1.2, factor) for factor in tried]
    assert sorts == [False, True, True, False]


def stops_at_the_latest(tilt: float, speed: float, mu: float) -> float:
    """[m] that the S-box slides at most on axes at 0 deg before it rests, if nothing brakes it
    before it is wholly on them.
    """
    free = speed**2 + 2.0 * GRAVITY * math.sin(tilt) * 0.6
    braking = GRAVITY * (mu * math.cos(tilt) - math.sin(tilt))
    return free / (2.0 * braking) if braking > 0.0 else math.inf


def test_a_parcel_stops_on_slopes_up_to_the_angle_of_friction():
    """tan(tilt) = mu_max, less what a zone of 3 m takes off it."""
    case = Case(layouts.box("S"), StopPurpose(), speed=0.2, unknown=NOTHING)
    found = least_tilt(case, columns=30, highest=math.radians(30.0)).spans[0]
    assert found.least == 0.0
    assert found.most < math.atan(0.5)
    sure = [tilt for tilt in found.values if stops_at_the_latest(tilt, 0.2, 0.5) < 2.6]
    assert found.most >= sure[-1] > math.radians(20.0)


def test_friction_that_holds_a_parcel_on_a_slope_may_be_off_by_its_reserve():
    tilt = math.radians(15.0)
    case = Case(layouts.box("S"), StopPurpose(), speed=0.2, tilt=tilt, unknown=NOTHING)
    limits = friction_range(case, columns=30)
    found = limits.along.spans[0]
    assert found.least > math.tan(tilt) / 0.5
    sure = [factor for factor in found.values if stops_at_the_latest(tilt, 0.2, 0.5 * factor) < 2.6]
    assert found.least <= sure[0]
    assert found.most == 16.0  # all that was tried
    across = limits.across.spans[0]  # friction across only helps to stop
    assert across.least <= 1.0
    assert across.most == 16.0


def test_draws_narrow_the_limits_and_share_the_draws_of_least_columns():
    case = Case(layouts.box("S"), SlowPurpose(0.7), speed=2.5, draws=40)
    limits = least_speed(case, columns=4)
    known, together = limits.spans[0], limits.spans[-1]
    assert [each.group for each in limits.spans] == [
        NOMINAL, "friction", "load", "unevenness", TOGETHER,
    ]  # fmt: skip
    assert known.least <= together.least
    own = together.share[np.abs(together.values - 2.5).argmin()]
    assert own == least_columns(case).worst[-1].success
    assert set(np.unique(known.share)) <= {0.0, 1.0}


def test_what_is_varied_is_left_out_of_what_is_unknown_and_progress_adds_up():
    unknown = Unknown(com_offset=0.0, lateral=0.01)
    case = Case(layouts.box("S"), SortPurpose(), speed=1.2, unknown=unknown, draws=5)
    found = friction_range(case, columns=5)
    groups = [each.group for each in found.across.spans]
    assert groups == [NOMINAL, "unevenness", "entry", TOGETHER]
    calls = []
    case = Case(layouts.box("S"), SortPurpose(), speed=1.2, draws=8)
    friction_range(case, columns=5, on_progress=lambda *done: calls.append(done))
    done, totals = zip(*calls, strict=True)
    assert list(done) == sorted(done)
    assert set(totals) == {done[-1]}


def test_a_case_that_fails_has_no_limits_and_one_at_rest_and_level_is_not_tried():
    case = Case(layouts.box("S"), SortPurpose(), speed=0.3, unknown=NOTHING)
    found = least_speed(case, columns=4, highest=1.0).spans[0]
    assert (found.least, found.most) == (None, None)
    assert found.share.max() == 1.0  # though others succeed
    case = Case(
        layouts.box("S"), SortPurpose(), speed=0.0, tilt=math.radians(10.0), unknown=NOTHING
    )
    assert least_tilt(case, columns=5).spans[0].values[0] > 0.0
    assert least_speed(case, columns=5, highest=0.5).spans[0].values[0] == 0.0


def test_a_span_ends_at_the_first_failure():
    for done, own, expected in (
        ("0110", 1, (1, 2)), ("111", 1, (0, 2)), ("101", 2, (2, 2)), ("101", 1, None),
    ):  # fmt: skip
        assert span_around(np.array([each == "1" for each in done]), own) == expected


def test_columns_are_those_that_the_draws_take_or_those_of_nothing_unknown():
    case = Case(layouts.box("B"), SlowPurpose(0.7), speed=2.0, draws=40)
    assert arrange(case).columns == least_columns(case).worst[-1].columns
    assert "95%" in arrange(case).chosen
    assert arrange(case, columns=2).chosen == "as asked"
    assert "nothing unknown" in arrange(replace(case, unknown=NOTHING)).chosen
    arrangement = arrange(Case(layouts.box("S"), SlowPurpose(0.5), speed=1.0, draws=20))
    assert arrangement.columns == 1
    assert "none do" in arrangement.chosen


def test_of_two_layouts_the_one_that_does_it_is_taken():
    """At 1.5 m/s one column at 0 deg slows the S-box too little, five at 45 deg stop it late."""
    case = Case(layouts.box("S"), StopPurpose(place=0.3, tolerance=0.1), speed=1.5, draws=20)
    assert arrange(case, columns=5).layout.name == "+-45 deg"


def test_errors_name_what_came():
    for ask, error in (
        (
            lambda: least_speed(replace(CASE, speed=0.3)),
            r"columns must be given: .* does it at 0\.3 m/s",
        ),
        (lambda: least_speed(CASE, columns=0), "columns must be a whole number of at least 1"),
        (lambda: least_speed(CASE, highest=1.0), r"highest must be between 1\.2 and 20, got 1\.0"),
        (lambda: least_tilt(CASE, highest=0.8), "highest must be from the case's tilt, 0, .* 0.8"),
        (lambda: friction_range(CASE, workers=0), "workers must be a whole number of at least 1"),
    ):
        with pytest.raises(ValueError, match=error):
            ask()
