"""What was found as tables: on screen short, in CSV as it is."""

import csv
import math
from pathlib import Path

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import layouts
from surface_gym.design.best_layout import best_layout
from surface_gym.design.case import NOTHING, Case
from surface_gym.design.columns import columns_by_rows, columns_by_speed
from surface_gym.design.limits import friction_range, least_speed, least_tilt
from surface_gym.design.purposes import Purpose, Slow, Sort, Stop, Turn
from surface_gym.design.search import Effort
from surface_gym.design.sensitivity import sensitivity
from surface_gym.design.size_map import success_map
from surface_gym.design.tables import (
    Table,
    columns_tables,
    friction_tables,
    limits_tables,
    map_tables,
    sensitivity_tables,
    text_of,
    write_csv,
)
from surface_gym.design.tables_of_layout import layout_tables
from surface_gym.design.telling import (
    base_told,
    columns_told,
    friction_told,
    layout_told,
    limits_told,
    map_told,
    purpose_met,
    purpose_told,
    sensitivity_told,
    sentence,
)

BOX = layouts.box("S")
CASE = Case(BOX, Sort(), speed=1.2, draws=5)
LOST = Case(BOX, Sort(), speed=0.3, draws=5)
TRIANGLE = sg.Polygon(np.array([(0.0, 0.0), (0.3, 0.0), (0.0, 0.3)]))


def written(table: Table, folder: Path) -> list[list[str]]:
    with write_csv(table, folder).open(newline="") as file:
        return list(csv.reader(file))


@pytest.mark.parametrize(
    ("cell", "text"),
    [
        (None, "-"), (math.nan, "-"), (True, "yes"), (False, "no"), (3, "3"), (0.12345, "0.123"),
        ("+45 deg", "+45 deg"),
    ],
)  # fmt: skip
def test_a_cell_on_screen(cell: object, text: str) -> None:
    assert text_of(cell) == text  # type: ignore[arg-type]


def test_csv_keeps_numbers_as_they_are_and_leaves_nothing_empty(tmp_path: Path) -> None:
    table = Table("some", "Some", ("a", "b", "c"), ((0.1 + 0.2, None, math.nan), (1, True, "x")))
    assert written(table, tmp_path) == [
        ["a", "b", "c"], ["0.30000000000000004", "", ""], ["1", "True", "x"],
    ]  # fmt: skip
    assert [path.name for path in tmp_path.iterdir()] == ["some.csv"]


def test_columns_are_told_by_group_by_rows_and_by_speed() -> None:
    speeds = [0.3, 1.2]
    own, rows, by_speed = columns_tables(
        CASE.purpose,
        columns_by_rows(CASE),
        list(zip(speeds, columns_by_speed(CASE, speeds), strict=True)),
    )
    assert [row[0] for row in own.rows] == [
        "nothing", "friction", "load", "unevenness", "all together",
    ]  # fmt: skip
    assert [row[0] for row in rows.rows] == [1, 2]
    assert rows.rows[1][1:4] == (4, 8, "+45 deg")
    assert by_speed.rows[0][:3] == (0.3, 2, None)  # so slow, no number is enough
    assert not by_speed.shown
    assert all(
        len(row) == len(table.header) for table in (own, rows, by_speed) for row in table.rows
    )


def test_limits_are_told_with_their_curves() -> None:
    found = least_speed(CASE, columns=4, highest=1.5)
    table, curve = limits_tables("speed", found)
    assert table.rows[0] == ("nothing", found.spans[0].least, found.spans[0].most, 1.0)
    assert len(curve.rows) == sum(len(span.values) for span in found.spans)
    assert {row[0] for row in curve.rows} == {row[0] for row in table.rows}


def test_a_tilt_is_told_in_degrees() -> None:
    found = least_tilt(Case(BOX, Sort(), 0.0, math.radians(10.0), NOTHING), columns=4)
    table, curve = limits_tables("tilt", found)
    assert table.header[1] == "least [deg]"
    assert table.rows[0][1] == pytest.approx(3.6)
    assert curve.rows[-1][1] == pytest.approx(15.0)
    assert "3.6 deg or more for" in limits_told(found)


def test_friction_is_told_for_both_coefficients() -> None:
    found = friction_range(CASE, columns=4)
    table, curve = friction_tables(found)
    assert [row[0] for row in table.rows] == ["factor on mu_max"] * 4 + ["factor on mu_min"] * 4
    assert {row[0] for row in curve.rows} == {"factor on mu_max", "factor on mu_min"}
    told = friction_told(found)
    assert "mu_max may be 0.3" in told
    assert "times 0.5 and mu_min may be" in told
    assert "for 95% of the draws of what else is unknown, mu_max" in told


def test_a_map_is_told_by_size_and_by_cell() -> None:
    found = success_map(CASE, 4, [0.3, 1.0, 1.5], [0.8, 1.0])
    sizes, cells = map_tables(found)
    assert sizes.rows[1][:3] == (1.0, 1.0, 1.5)
    assert not sizes.written
    assert len(cells.rows) == 6
    assert cells.rows[3] == (1.0, 0.3, False, 0.0)
    assert "67% of these speeds and sizes" in map_told(found)
    assert "no speed and size here" in map_told(success_map(CASE, 4, [0.3], [1.0]))


def test_sensitivity_is_told_field_by_field() -> None:
    found = sensitivity(Case(BOX, Turn(), speed=1.5, draws=5), columns=6)
    (table,) = sensitivity_tables(found)
    assert table.title == "Angle on leaving the zone [deg]"
    assert len(table.rows) == 1 + len(found.bars)
    assert table.rows[0][1] == pytest.approx(math.degrees(found.measure))
    assert "success suffers most from" in sensitivity_told(found)
    assert "no draw comes as far" in sensitivity_told(sensitivity(LOST, columns=4))
    assert "all succeed" in sensitivity_told(sensitivity(CASE, columns=4))


def test_a_layout_is_told_beside_the_study_s() -> None:
    effort = Effort(members=5, generations=1, epochs=1, rounds=0)
    found = best_layout(CASE, [0.3, 1.2], 6, effort=effort)
    both, speeds, axes = layout_tables(found)
    assert [row[0] for row in both.rows] == ["best fixed layout", "+45 deg"]
    assert len(speeds.rows) == 4
    assert len(axes.rows) == 2
    assert len(axes.rows[0]) == 7
    assert axes.rows[0][0] == 2  # the row at the greatest y first, as one sees it
    assert "at 50.0% of 2 speeds from 0.3 to 1.2 m/s" in layout_told(found)
    lost = best_layout(CASE, [0.2, 0.3], 6, effort=effort)
    assert "without a failure at none" in layout_told(lost)


@pytest.mark.parametrize(
    ("purpose", "told", "met"),
    [
        (Sort(), "sort it", "be sorted"),
        (Slow(0.7), "slow it to 0.7 or less of its speed", "be slowed to 0.7 or less of its speed"),
        (
            Slow(0.7, 0.1), "slow it to 0.7 +- 0.1 of its speed",
            "be slowed to 0.7 +- 0.1 of its speed",
        ),
        (Stop(), "stop it", "be stopped"),
        (
            Stop(0.3), "stop it within 0.05 m of 0.3 m into the zone",
            "be stopped within 0.05 m of 0.3 m into the zone",
        ),
        (Turn(), "turn it by 30 +- 5 deg", "be turned by 30 +- 5 deg"),
    ],
)  # fmt: skip
def test_a_purpose_in_words(purpose: Purpose, told: str, met: str) -> None:
    assert purpose_told(purpose) == told
    assert purpose_met(purpose) == met


def test_a_base_in_words() -> None:
    assert base_told(sg.Rectangle(0.3, 0.4)) == "0.3 x 0.4 m parcel"
    assert base_told(sg.Disc(0.2)) == "round parcel of 0.2 m radius"
    assert base_told(TRIANGLE) == "parcel of 3 corners"


def test_the_answer_to_how_many_in_words() -> None:
    known = Case(BOX, Sort(), speed=1.2, unknown=NOTHING)
    assert columns_told(known, columns_by_rows(known)[-1]) == (
        "4 columns of 2 rows (8 modules at +45 deg) are what it takes to sort it, a 0.25 x 0.25 m "
        "parcel that comes at 1.2 m/s"
    )
    drawn = columns_by_rows(CASE)[-1]
    assert columns_told(CASE, drawn).endswith("; for 95% of the draws, 4")
    assert columns_told(LOST, columns_by_rows(LOST)[-1]).startswith("No number of columns up to 30")
    turn = Case(BOX, Turn(), speed=1.5, draws=20)
    assert "no number does it in 95% of the draws" in columns_told(turn, columns_by_rows(turn)[-1])


def test_the_answers_to_limits_in_words() -> None:
    assert "nothing near 0.3" in limits_told(least_speed(LOST, 4, highest=1.0))
    stop = Case(BOX, Stop(), speed=0.3, unknown=NOTHING)
    assert "m/s or more for" in limits_told(least_speed(stop, 8, highest=0.5))
    steep = Case(BOX, Sort(), speed=1.0, tilt=0.25, unknown=NOTHING)
    assert "anything tried" in limits_told(least_speed(steep, 20, highest=1.5))
    assert "m/s or less for" in limits_told(least_speed(steep, 3, highest=3.0))
    assert sentence("So it is") == "So it is."
    assert sentence("So it is.") == "So it is."
