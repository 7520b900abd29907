"""Axes that follow the parcel beside fixed layouts."""

import csv
import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import layouts
from surface_gym.design import control
from surface_gym.design.case import NOTHING, Case, Slow, Sort, Stop, Turn
from surface_gym.design.cli import main
from surface_gym.design.columns import least_columns
from surface_gym.design.control import ControlGain, Gain, control_gain
from surface_gym.design.runs import make_runs

BOX = layouts.box("S")


CASE = Case(BOX, Sort(), speed=1.2, draws=4)


@pytest.fixture(scope="module")
def gain():
    return control_gain(CASE)


def test_the_fixed_layout_does_in_the_environment_what_it_does_in_a_design(gain):
    """The environment runs on the design's own surface, and gets the same least speed."""
    assert (gain.columns, gain.rows) == (least_columns(CASE).columns, 2)
    fixed = next(each for each in gain.gains if each.controller == "fixed layout")
    assert fixed.arranged_once
    line = CASE.line(gain.columns)
    axes = CASE.purpose.layouts(line, gain.columns)[0].axis[None]
    runs = make_runs(fixed.least_speed - np.array([0.0, 0.04]))
    assert CASE.purpose.succeeds(CASE.run(line, axes, runs)).tolist() == [True, False]


def test_control_sorts_slower_parcels_than_axes_arranged_once_at_the_same_angles(gain):
    """Axes that may stand at any angle do as well arranged once."""
    least = {each.controller: each.least_speed for each in gain.gains}
    ruled = min(each.least_speed for each in gain.gains if not each.arranged_once)
    assert ruled < 0.6 * least["best fixed layout"]
    assert least["fixed layout, any angle"] == pytest.approx(ruled, abs=0.03)
    assert gain.left_out  # trained for the environment's own line


@pytest.mark.parametrize(
    ("purpose", "speed", "task"),
    [(Slow(), 1.5, "slow"), (Stop(), 1.0, "stop"), (Turn(math.radians(20.0)), 1.5, "orient")],
)
def test_every_purpose_has_its_task(purpose, speed, task, monkeypatch):
    for step in ("SPEED_STEP", "WIDE_STEP"):  # one speed alone is tried
        monkeypatch.setattr(control, step, 2.0)
    parcel = sg.Parcel(sg.Rectangle(0.28, 0.24), mass=12.0)
    gain = control_gain(Case(parcel, purpose, speed=speed, unknown=NOTHING, draws=1), columns=16)
    assert gain.task == task
    best = max(each.success for each in gain.gains if not each.arranged_once)
    assert best >= max(each.success for each in gain.gains if each.arranged_once)
    assert best == 1.0


def test_a_tilt_is_refused_and_no_columns_where_no_fixed_layout_does_it():
    with pytest.raises(ValueError, match=r"tilt must be 0 for controllers on a line, got 0\.1"):
        control_gain(Case(BOX, tilt=0.1))
    with pytest.raises(ValueError, match=r"columns must be given .* at 0.4 m/s, got None"):
        control_gain(Case(BOX, speed=0.4, unknown=NOTHING))


FOUND = ControlGain(
    case=Case(BOX), task="sort", asked="off the line to y < 0", columns=6, rows=2,
    gains=(
        Gain("fixed layout", True, 100, 0.5, math.nan, math.nan),
        Gain("event rule", False, 100, 0.9, 0.46, math.nan),
    ),
    left_out=("PPO per module",),
)  # fmt: skip


def test_an_answer_has_the_best_of_either_kind_and_a_row_and_a_bar_of_each():
    sentence = FOUND.sentence
    assert "90% of the draws and from 0.46 m/s on by axes that follow it" in sentence
    assert "50% of the draws and at no speed by axes arranged once" in sentence
    assert sentence.endswith("PPO per module")
    (table,) = FOUND.tables()
    kinds = {"fixed layout": "arranged once", "event rule": "follow"}
    assert dict(row[:2] for row in table.rows) == kinds
    left, right = FOUND.draw().axes
    assert [each.get_text() for each in left.get_yticklabels()] == ["event rule", "fixed layout"]
    assert [each.get_text() for each in right.texts] == ["at no speed"]


def test_the_command_answers_it_and_refuses_some_flags(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(control, "WIDE_STEP", 2.0)
    main(["control", "--parcel", "S", "--speed", "1.2", "--draws", "3", "--out", str(tmp_path)])
    assert "by axes that follow it" in capsys.readouterr().out
    with (tmp_path / "control.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["axes"] for row in rows} == {"arranged once", "follow"}
    assert (tmp_path / "control.png").stat().st_size > 10_000
    for flags, error in (
        (("--rows", "3"), "rows must be those under the parcel for control, got 3"),
        (("--cluster", "auto"), "cluster must not be given for control"),
    ):
        with pytest.raises(SystemExit):
            main(["control", "--parcel", "S", *flags, "--out", str(tmp_path)])
        assert error in capsys.readouterr().err
