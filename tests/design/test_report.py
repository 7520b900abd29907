"""Answers as sentences, tables and figures: short on screen, in full as CSV."""

import csv
import math
from collections.abc import Callable
from dataclasses import replace

import pytest

import surface_gym as sg
from surface_gym import layouts
from surface_gym.design import Case, SlowPurpose, SortPurpose, StopPurpose, TurnPurpose
from surface_gym.design.case import NOTHING, Answer, ReportTable
from surface_gym.design.cli import DPI, format_cell, write_csv
from surface_gym.design.columns import ColumnsReport, columns_report, least_columns
from surface_gym.design.fixed_layout import Effort, best_layout
from surface_gym.design.limits import friction_range, least_speed, least_tilt

BOX = layouts.box("S")
CASE = Case(BOX, SortPurpose(), speed=1.2, draws=5)
LOST = Case(BOX, SortPurpose(), speed=0.3, draws=5)
SPEEDS = (0.3, 1.2)
EFFORT = Effort(members=5, generations=1, epochs=1, rounds=0)
CASES = {
    "sort": (CASE, 4),
    "sort, nothing unknown": (replace(CASE, unknown=NOTHING), 4),
    "sort, never": (Case(BOX, SortPurpose(), speed=0.2, draws=5), 2),
    "turn": (Case(BOX, TurnPurpose(), speed=1.5, draws=5), 6),
}


def columns_of(case: Case, speeds: tuple[float, ...] = SPEEDS) -> ColumnsReport:
    by_rows = tuple(least_columns(case, rows) for rows in (1, 2))
    by_speed = tuple(least_columns(replace(case, speed=speed)) for speed in speeds)
    return ColumnsReport(case, by_rows, speeds, by_speed)


ANSWERS: dict[str, Callable[[Case, int], Answer]] = {
    "columns": lambda case, _: columns_of(case),
    "speed": lambda case, columns: least_speed(case, columns, highest=2.0),
    "friction": friction_range,
    "layout": lambda case, columns: best_layout(case, SPEEDS, columns, effort=EFFORT),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("name", ANSWERS)
def test_an_answer_is_a_sentence_tables_and_a_figure_with_its_question(name, case, tmp_path):
    answer = ANSWERS[name](*CASES[case])
    assert answer.name == name
    assert answer.sentence
    tables = answer.tables()
    assert any(table.shown for table in tables)
    assert all(len(row) == len(table.header) for table in tables for row in table.rows)
    figure = answer.draw()
    figure.savefig(tmp_path / "figure.png", dpi=DPI)
    assert (tmp_path / "figure.png").stat().st_size < 200_000
    assert "?" in figure.get_suptitle()
    assert any(axes.get_xlabel() for axes in figure.axes)
    assert figure.axes[0].get_ylabel()


def test_cells_on_screen_and_in_a_file(tmp_path):
    cells = {
        "-": (None, math.nan), "yes": (True,), "no": (False,), "3": (3,), "0.123": (0.12345,),
        "+45 deg": ("+45 deg",),
    }  # fmt: skip
    for text, same in cells.items():
        assert [format_cell(cell) for cell in same] == [text] * len(same)
    table = ReportTable(
        "some", "Some", ("a", "b", "c"), ((0.1 + 0.2, None, math.nan), (1, True, "x"))
    )
    with write_csv(table, tmp_path).open(newline="") as file:
        rows = list(csv.reader(file))
    assert rows == [["a", "b", "c"], ["0.30000000000000004", "", ""], ["1", "True", "x"]]
    assert [path.name for path in tmp_path.iterdir()] == ["some.csv"]


@pytest.mark.parametrize(
    ("purpose", "done", "how"),
    [
        (SortPurpose(), "sorted", ""),
        (SlowPurpose(0.7), "slowed", " to 0.7 or less of its speed"),
        (SlowPurpose(0.7, 0.1), "slowed", " to 0.7 +- 0.1 of its speed"),
        (StopPurpose(), "stopped", ""),
        (StopPurpose(0.3), "stopped", " within 0.05 m of 0.3 m into the zone"),
        (TurnPurpose(), "turned", " by 30 +- 5 deg"),
    ],
)
def test_a_purpose_in_words(purpose, done, how):
    act = {"slowed": "slow", "stopped": "stop"}.get(done, done.removesuffix("ed"))
    assert (purpose.action, purpose.passive) == (f"{act} it{how}", f"be {done}{how}")


def test_a_base_in_words():
    triangle = sg.Polygon([(0.0, 0.0), (0.3, 0.0), (0.0, 0.3)])
    for base, text in (
        (sg.Rectangle(0.3, 0.4), "0.3 x 0.4 m parcel"),
        (sg.Disc(0.2), "round parcel of 0.2 m radius"),
        (triangle, "parcel of 3 corners"),
    ):
        assert Case(sg.Parcel(base)).parcel_text == text


def test_columns_by_group_by_rows_and_by_speed():
    report = columns_of(CASE)
    own, rows, by_speed = report.tables()
    groups = ["nothing", "friction", "load", "unevenness", "all together"]
    assert [row[0] for row in own.rows] == groups
    assert [row[0] for row in rows.rows] == [1, 2]
    assert rows.rows[1][1:4] == (4, 8, "+45 deg")
    assert by_speed.rows[0][:3] == (0.3, 2, None)  # at this speed no number is enough
    assert not by_speed.shown
    assert report.sentence.endswith("; 4 suffice for 95% of the draws")
    assert columns_of(replace(CASE, unknown=NOTHING), ()).sentence == (
        "A 0.25 x 0.25 m parcel at 1.2 m/s: 4 columns of 2 rows (8 modules at +45 deg) suffice to "
        "sort it"
    )
    assert ": no number of columns up to 30 suffices" in columns_of(LOST, ()).sentence
    turn = Case(BOX, TurnPurpose(), speed=1.5, draws=20)
    assert "no number suffices for 95% of the draws" in columns_of(turn, ()).sentence
    large = Case(layouts.box("B"), SortPurpose(), speed=1.5, unknown=NOTHING)
    several, chosen = (columns_report(large, rows) for rows in (None, 3))
    assert [each.rows for each in several.by_rows] == [1, 2, 3, 4]
    assert [each.rows for each in chosen.by_rows] == [3]
    assert several.by_speed[14] == several.own  # at 1.5 m/s


def test_limits_and_their_curves_a_tilt_in_degrees_and_both_coefficients_of_friction():
    found = least_speed(CASE, columns=4, highest=1.5)
    table, curve = found.tables()
    assert table.rows[0] == ("nothing", found.spans[0].least, found.spans[0].most, 1.0)
    assert len(curve.rows) == sum(len(span.values) for span in found.spans)
    assert {row[0] for row in curve.rows} == {row[0] for row in table.rows}
    found = least_tilt(Case(BOX, SortPurpose(), 0.0, math.radians(10.0), NOTHING), columns=4)
    table, curve = found.tables()
    assert table.header[1] == "least [deg]"
    assert table.rows[0][1] == pytest.approx(3.6)
    assert curve.rows[-1][1] == pytest.approx(15.0)
    assert "3.6 deg or more for" in found.sentence
    found = friction_range(CASE, columns=4)
    table, curve = found.tables()
    assert [row[0] for row in table.rows] == ["factor on mu_max"] * 4 + ["factor on mu_min"] * 4
    assert {row[0] for row in curve.rows} == {"factor on mu_max", "factor on mu_min"}
    assert "mu_max / 0.5 may be 0.3" in found.sentence
    assert " and mu_min / 0.01 may be" in found.sentence
    assert "for 95% of the draws of other unknown quantities, mu_max / 0.5" in found.sentence


@pytest.mark.parametrize(
    ("case", "columns", "highest", "text"),
    [
        (LOST, 4, 1.0, "nothing near 0.3"),
        (Case(BOX, StopPurpose(), speed=0.3, unknown=NOTHING), 8, 0.5, "m/s or more for"),
        (Case(BOX, SortPurpose(), 1.0, 0.25, NOTHING), 20, 1.5, "anything tried"),
        (Case(BOX, SortPurpose(), 1.0, 0.25, NOTHING), 3, 3.0, "m/s or less for"),
    ],
)
def test_spans_in_words(case, columns, highest, text):
    assert text in least_speed(case, columns, highest=highest).sentence


def test_a_layout_beside_the_study_s():
    found = best_layout(CASE, SPEEDS, 6, effort=EFFORT)
    both, speeds, axes = found.tables()
    assert [row[0] for row in both.rows] == ["best fixed layout", "+45 deg"]
    assert len(speeds.rows) == 4
    assert len(axes.rows) == 2
    assert len(axes.rows[0]) == 7
    assert axes.rows[0][0] == 2  # the row at the greatest y first, as in a drawing
    assert "at 50.0% of 2 speeds from 0.3 to 1.2 m/s" in found.sentence
    assert "without a failure at none" in best_layout(CASE, [0.2, 0.3], 6, effort=EFFORT).sentence
