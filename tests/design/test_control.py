import math

import pytest

import surface_gym as sg
from surface_gym import layouts
from surface_gym.design.case import NOTHING, Case
from surface_gym.design.columns import least_columns
from surface_gym.design.control import control_gain
from surface_gym.design.purposes import Purpose, Slow, Sort, Stop, Turn
from surface_gym.design.runs import make_runs, run_all

BOX = layouts.box("S")


def test_the_fixed_layout_does_in_the_environment_what_it_does_in_a_design() -> None:
    """The environment runs on the design's own surface, and gets the same least speed."""
    case = Case(BOX, Sort(), speed=1.2, draws=4)
    gain = control_gain(case)
    columns = least_columns(case).columns
    assert (gain.columns, gain.rows) == (columns, 2)
    fixed = next(each for each in gain.gains if each.controller == "fixed layout")
    assert fixed.arranged_once
    line = case.line(gain.columns)
    axes = case.purpose.layouts(line, gain.columns)[0].axis[None]

    def sorts(speed: float) -> bool:
        runs = make_runs(speed)
        return bool(case.purpose.succeeds(line, runs, run_all(line, axes, [BOX], runs))[0])

    assert sorts(fixed.least_speed)
    assert not sorts(fixed.least_speed - 0.04)


def test_control_sorts_slower_parcels_than_axes_arranged_once_at_the_same_angles() -> None:
    """Axes that may stand at any angle do as well arranged once."""
    gain = control_gain(Case(BOX, Sort(), speed=1.2, draws=4))
    least = {each.controller: each.least_speed for each in gain.gains}
    ruled = min(each.least_speed for each in gain.gains if not each.arranged_once)
    assert ruled < 0.6 * least["best fixed layout"]
    assert least["fixed layout, any angle"] == pytest.approx(ruled, abs=0.03)
    assert gain.left_out  # trained for the environment's own line


@pytest.mark.parametrize(
    ("purpose", "speed", "task"),
    [(Slow(), 1.5, "slow"), (Stop(), 1.0, "stop"), (Turn(math.radians(20.0)), 1.5, "orient")],
)
def test_every_purpose_has_its_task(purpose: Purpose, speed: float, task: str) -> None:
    parcel = sg.Parcel(sg.Rectangle(0.28, 0.24), mass=12.0)
    gain = control_gain(Case(parcel, purpose, speed=speed, unknown=NOTHING, draws=1), columns=16)
    assert gain.task == task
    best = max(each.success for each in gain.gains if not each.arranged_once)
    assert best >= max(each.success for each in gain.gains if each.arranged_once)
    assert best == 1.0


def test_a_tilted_case_is_refused() -> None:
    with pytest.raises(ValueError, match=r"tilt must be 0 for controllers on a line, got 0\.1"):
        control_gain(Case(BOX, tilt=0.1))


def test_columns_must_be_given_where_no_fixed_layout_does_it() -> None:
    with pytest.raises(ValueError, match=r"columns must be given .* at 0.4 m/s, got None"):
        control_gain(Case(BOX, speed=0.4, unknown=NOTHING))
