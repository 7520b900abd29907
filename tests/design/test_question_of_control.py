import csv
import math
from pathlib import Path

import pytest

from surface_gym import layouts
from surface_gym.design.case import Case
from surface_gym.design.command import main
from surface_gym.design.control import ControlGain, Gain
from surface_gym.design.question_of_control import control_table, control_told, draw_control

FOUND = ControlGain(
    task="sort",
    asked="off the line to y < 0",
    columns=6,
    rows=2,
    gains=(
        Gain("fixed layout", True, 100, 0.5, math.nan, math.nan),
        Gain("event rule", False, 100, 0.9, 0.46, math.nan),
    ),
    left_out=("PPO per module",),
)


def test_the_answer_says_the_best_of_either_kind() -> None:
    told = control_told(Case(layouts.box("S")), FOUND)
    assert "90% of the draws and from 0.46 m/s on by axes that follow it" in told
    assert "50% of the draws and at no speed by axes arranged once" in told
    assert told.endswith("PPO per module")


def test_a_row_and_a_bar_a_controller() -> None:
    table = control_table(FOUND)
    assert [row[:2] for row in table.rows] == [
        ("fixed layout", "arranged once"),
        ("event rule", "follow"),
    ]
    left, right = draw_control(Case(layouts.box("S")), FOUND).axes
    assert [each.get_text() for each in left.get_yticklabels()] == ["event rule", "fixed layout"]
    assert [each.get_text() for each in right.texts] == ["at no speed"]


def test_the_command_answers_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    main(["control", "--parcel", "S", "--speed", "1.2", "--draws", "3", "--out", str(tmp_path)])
    assert "by axes that follow it" in capsys.readouterr().out
    with (tmp_path / "control.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["axes"] for row in rows} == {"arranged once", "follow"}
    assert (tmp_path / "control.png").stat().st_size > 10_000


def test_rows_are_those_under_the_parcel(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["control", "--parcel", "S", "--rows", "3", "--out", str(tmp_path)])
    assert "rows must be those under the parcel for control, got 3" in capsys.readouterr().err


def test_controllers_are_not_tried_on_a_cluster(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main(["control", "--parcel", "S", "--cluster", "auto", "--out", str(tmp_path)])
    assert "cluster must not be given for control" in capsys.readouterr().err
