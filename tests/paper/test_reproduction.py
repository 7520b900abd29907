"""Our numbers against the paper's tables, how little these tell of its step, and the command."""

import json

import numpy as np
import pytest

from surface_gym.paper import command, reproduction as ours
from surface_gym.paper.reproduction import LAST_DIGITS, POSITION_TOLERANCE
from surface_gym.paper.runs import (
    COARSE,
    SIZES,
    ComputedValue,
    PaperTable,
    SlowingLayout,
    TableCell,
    load_targets,
)


def make_cell(paper, *ours, **options):
    """A cell of the S-box, with one value of ours per integration."""
    return TableCell(
        "r", "c", "S", paper, tuple(ComputedValue(value, 0.0) for value in ours), **options
    )


@pytest.mark.parametrize(
    "compared",
    [
        make_cell(0.23, 0.2265, 0.184, decimals=2),  # as the paper prints them
        make_cell(-0.515, -0.525, -0.526, decimals=3, tolerance=0.01),
        make_cell(None, None, 7),  # a failure agrees with a failure alone
        make_cell(SlowingLayout(2, 45), SlowingLayout(2, 45), SlowingLayout(2, 0)),
    ],
)
def test_the_first_value_agrees_and_the_second_does_not(compared):
    assert [compared.agrees(k) for k in range(2)] == [True, False]


def test_a_table_counts_its_cells_and_gives_the_range_of_the_runs_that_tip():
    found = [("S", 0.3, 3), ("S", 0.1, 4), ("S", None, 4), ("B", 0.0, 4)]
    pairs = [
        (size, (ComputedValue(3, share), ComputedValue(value, 0.5))) for size, share, value in found
    ]
    cells = tuple(TableCell("r", "c", size, 3, ours) for size, ours in pairs)
    table = PaperTable("key", "title", "rule", cells)
    assert (table.agreeing(0), table.agreeing(1)) == (4, 1)
    assert table.tipping(0) == {"S": (0.1, 0.3), "B": (0.0, 0.0)}


def test_the_paper_s_tables_are_whole_and_entries_stand_where_it_prints_them():
    targets = load_targets()
    assert len(targets.sorting_runs) == 5
    for size in SIZES:
        assert len(targets.sorting_columns[size]) == len(targets.sorting_speeds) == 20
        assert len(targets.slowing_layouts[size]) == len(targets.slowing_speeds) == 19

    assert targets.sorting_columns["B"][targets.sorting_speeds.index(1.0)] is None
    assert targets.sorting_columns["S"][targets.sorting_speeds.index(2.7)] == 8
    assert targets.slowing_layouts["B"][targets.slowing_speeds.index(2.6)] == SlowingLayout(5, 0)
    assert targets.slowing_ratios["S"] == [0.23, 0.53]
    assert [run.side for run in targets.sorting_runs] == [1, -1, -1, -1, -1]


@pytest.mark.parametrize(
    ("table", "cells", "at_5_ms", "converged"),
    [
        ("table2", 15, 12, 8),  # within 10 mm and 3.5 deg
        ("passing", 3, 2, 3), ("table3", 40, 39, 38), ("slowest_sorted", 2, 0, 1),
        ("table4", 38, 37, 34), ("slowing_ratios", 4, 0, 0), ("stopping", 38, 31, 31),
    ],
)  # fmt: skip
def test_as_many_cells_agree_as_the_pages_say(reproduction, table, cells, at_5_ms, converged):
    compared = reproduction.table(table)
    assert len(compared.cells) == cells
    assert compared.agreeing(0) == at_5_ms
    assert compared.agreeing(1) == converged


def test_what_differs_is_reported(reproduction):
    """In Table 2 by how much, at 5 ms: a little more than what counts as agreement."""
    cells = [cell for cell in reproduction.table("table2").cells if not cell.agrees(0)]
    off = {(cell.row, cell.column): cell.ours[0].value - cell.paper for cell in cells}
    assert off == {
        ("7b, 1.5 m/s", "y [m]"): pytest.approx(0.0114, abs=1e-4),
        ("7c, 10°", "x [m]"): pytest.approx(0.0117, abs=1e-4),
        ("7c, 10°", "theta [°]"): pytest.approx(-3.77, abs=0.01),
    }

    cells = [cell for cell in reproduction.table("table3").cells if not cell.agrees(1)]
    differing = [(cell.column, cell.row, cell.paper, cell.ours[1].value) for cell in cells]
    assert differing == [("S-box", "1.5", 4, 5), ("B-box", "1.0", None, 7)]


def values_of(reproduction, table, step):
    return {(c.column, c.row): c.ours[step].value for c in reproduction.table(table).cells}


def test_boxes_too_slow_stay_in_the_line_and_one_more_column_stops_most(reproduction):
    columns = values_of(reproduction, "table3", 1)
    assert columns["B-box", "0.8"] is columns["B-box", "0.9"] is None
    left = values_of(reproduction, "stopping", 0)
    assert len(left) == 38
    assert all(speed == 0.0 for (_, row), speed in left.items() if float(row) <= 2.2)


def test_the_step_is_fine_enough_and_7a_and_7b_mirror_each_other(reproduction):
    for spread in reproduction.near_the_limit:
        assert spread.position < 0.5  # mm
        assert spread.angle < 0.2  # deg
    ends = [cell.ours[1].value for cell in reproduction.table("table2").cells]
    up, down = np.reshape(ends, (-1, 3))[:2]
    assert (abs(up - down * (1.0, -1.0, -1.0)) < (2e-4, 2e-4, 0.05)).all()


def test_slower_boxes_sort_at_a_lower_rate_and_slowing_takes_the_paper_s_columns(reproduction):
    for size in ("S", "B"):
        rates = [c.ours[1].rate for c in reproduction.sorted_by_tilt if c.size == size]
        assert rates == sorted(rates)
    chosen = values_of(reproduction, "table4", 0)
    assert chosen["S-box", "0.9"] == SlowingLayout(1, 45)  # at 0 deg, one column stops the box
    assert chosen["S-box", "2.0"] == SlowingLayout(3, 0)


@pytest.mark.parametrize(
    ("row", "along_x"), [("columns: 2 at 0°", 1.0), ("columns: 2 at ±45°", 0.5**0.5)]
)
def test_a_slowing_column_takes_the_energy_its_friction_does(reproduction, row, along_x):
    """A column bears pitch / b of the weight while the base passes over it, a way of b."""
    ratio = values_of(reproduction, "slowing_ratios", 1)["B-box", row]
    columns, mu_max, gravity, pitch = 2, 0.5, 9.81, 0.1
    work = columns * mu_max * along_x * gravity * pitch  # J/kg, rolling left out
    lost = 0.5 * 1.5**2 * (1.0 - ratio**2)
    assert lost == pytest.approx(work, rel=0.1)


def test_no_step_stands_out(reproduction):
    at_5_ms = next(each for each in reproduction.by_step if each.integration == COARSE)
    for key, agreeing in at_5_ms.agreeing.items():
        assert agreeing == reproduction.table(key).agreeing(0)
    counts = ((each.integration.dt, each.agreeing) for each in reproduction.by_step)
    total = {round(1e3 * dt, 1): sum(agreeing.values()) for dt, agreeing in counts}
    assert sum(len(reproduction.table(k).cells) for k in ("table2", "table3", "table4")) == 93
    assert total[4.0] == total[5.0] == total[6.0] == max(total.values()) == 88
    assert total[3.0] == total[7.0] == 86
    assert min(total.values()) >= 82


def test_a_turn_of_all_axes_by_round_off_moves_the_ends_as_much_as_is_tolerated(reproduction):
    assert reproduction.last_digits.position > 1000.0 * POSITION_TOLERANCE
    assert reproduction.last_digits.position < reproduction.about_coarse.position + 5.0


@pytest.mark.parametrize("turn", [LAST_DIGITS[0], LAST_DIGITS[-1]])
def test_turned_by_round_off_either_way_all_of_table_2_agrees(turn):
    for run in load_targets().sorting_runs:
        x, y, theta = ours.run_turned(run, turn, COARSE)
        # In whole millimetres, as the table has them.
        assert abs(round(x, 3) - run.x) <= POSITION_TOLERANCE + 1e-9
        assert abs(round(y, 3) - run.y) <= POSITION_TOLERANCE + 1e-9
        assert abs(theta - run.theta) <= ours.ANGLE_TOLERANCE


FIGURES = ("figure7", "figure8", "figure10", "alignment")


def test_the_report_the_data_and_the_figures_hold_everything(
    reproduction, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(ours, "reproduce", lambda _: reproduction)
    file, folder = tmp_path / "report.json", tmp_path / "new" / "figures"
    command.main(["--json", str(file), "--figures", str(folder)])
    out = capsys.readouterr().out
    printed, paths = out[: out.index(str(folder))], out[out.index(str(folder)) :]
    for table in reproduction.tables:
        assert table.title in printed
    assert "39 of 40 at 5 ms, 38 of 40 converged" in printed
    assert "37 of 38 at 5 ms, 34 of 38 converged" in printed
    assert "The paper prints no step" in printed
    assert printed.count("steps in which Eq. (1) has no solution:") == len(reproduction.tables)
    assert "The most that one step brings is 88, at 4 and 5 and 6 ms" in printed
    assert "S-box by tilt: 11 of 11, 11 of 11" in printed
    assert "…" not in printed  # nothing is cut off
    assert all(len(line) <= 80 for line in printed.splitlines())
    for name in FIGURES:
        assert (folder / f"{name}.png").read_bytes().startswith(b"\x89PNG")
        assert (folder / f"{name}.pdf").read_bytes().startswith(b"%PDF")
        assert str(folder / f"{name}.png") in paths
    written = json.loads(file.read_text("utf-8"))
    assert list(written["tables"]) == [table.key for table in reproduction.tables]
    for table in reproduction.tables:
        own = written["tables"][table.key]
        assert own["agreeing"] == [table.agreeing(k) for k in range(3)]
        for cell, row in zip(table.cells, own["cells"], strict=True):
            values = [list(f.value) if isinstance(f.value, tuple) else f.value for f in cell.ours]
            assert [each["value"] for each in row["ours"]] == values
            assert [each["tipping"] for each in row["ours"]] == [f.tipping for f in cell.ours]
            assert row["agrees"] == [cell.agrees(k) for k in range(3)]
    rates = [case["ours"][1]["rate"] for case in written["sorting_rates"]["by_speed"]]
    assert rates == [case.ours[1].rate for case in reproduction.sorted_by_speed]
    for name, own in (
        ("agreeing_by_step", reproduction.by_step), ("self_stopping", reproduction.self_stopping),
        ("alignment", reproduction.alignment),
    ):  # fmt: skip
        assert len(written[name]) == len(own)


@pytest.mark.parametrize(
    ("option", "path"), [("--json", "file/below"), ("--figures", "file/below"), ("--json", ".")]
)
def test_a_path_that_cannot_be_written_ends_it_before_the_work(option, path, tmp_path, monkeypatch):
    monkeypatch.setattr(ours, "reproduce", lambda _: pytest.fail("worked before it checked"))
    (tmp_path / "file").touch()
    with pytest.raises(SystemExit, match=f"^error: cannot write {tmp_path}"):
        command.main([option, str(tmp_path / path)])
