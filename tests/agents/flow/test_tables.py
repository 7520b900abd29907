"""The tables, plots and files of the comparison on flows, from cells made by hand."""

import csv
import io
import math
from dataclasses import replace
from pathlib import Path

import imageio.v2 as imageio
import numpy as np
import pytest
from rich.console import Console

from agents.flow import report
from agents.flow.cases import CURVE, Case, cases
from agents.flow.contenders import ARRANGED, EVENT, FIXED, RESERVATION, TURNED
from agents.flow.report import write_flow_report
from agents.flow.results import BOUND, CEILING, bound_of, results_of
from agents.flow.showing import pictures_of, write_flow_comparison
from agents.flow.tables import capacities, eased, flow_numbers, flow_tables, headline, ratios
from tests.agents.flow.cells import RULES, SHARES, flow_cells, made_up


def test_rates_and_ratios() -> None:
    results = made_up()
    assert results.names == tuple(SHARES)
    assert results.rate(RESERVATION, CURVE) == pytest.approx(0.6 * CURVE.ceiling, rel=0.02)
    assert results.ratio(RESERVATION, EVENT, CURVE) == pytest.approx(1.5, rel=0.02)
    assert results.ratio(RESERVATION, BOUND, CURVE) == pytest.approx(0.75, rel=0.02)
    assert results.ratio(BOUND, CEILING, CURVE) == pytest.approx(0.8)
    assert results.ratio(EVENT, ARRANGED, CURVE) == math.inf
    assert math.isnan(results.ratio(FIXED, ARRANGED, CURVE))
    assert math.isnan(results.rate("nobody", CURVE))


def test_the_first_table_tells_most() -> None:
    table = headline(made_up())
    rows = {row[0]: dict(zip(table.header, row, strict=True)) for row in table.rows}
    assert list(rows) == [*SHARES, BOUND, CEILING]
    assert rows[FIXED]["parcels/h"] == "0"
    assert rows[ARRANGED]["parcels/h"] == "cannot"
    assert rows[ARRANGED]["95 %"] == "-"
    best = rows[RESERVATION]
    assert best["parcels/h"] == "8100"
    assert best["95 %"] == "±136"  # 180 parcels/h either way, ten times: 2.262 * 189.7 / sqrt(10)
    assert best["touches/1000"] == "22"
    assert best["/turned"] == "3.00"
    assert best["/arranged"] == "-"
    assert rows[CEILING]["parcels/h"] == "13500"


def test_every_stream_has_a_column() -> None:
    results = made_up()
    table = capacities(results, "camera")
    assert table.header[1:] == tuple(case.label for case in cases())
    assert [row[0] for row in table.rows] == [ARRANGED, TURNED, EVENT, RESERVATION, BOUND, CEILING]
    assert set(table.rows[0][1:]) == {"cannot"}
    assert table.rows[1][1].startswith("2340 ±") or table.rows[1][1].startswith("2400 ±")
    assert [row[0] for row in ratios(results, EVENT).rows] == [ARRANGED, TURNED, RESERVATION]
    assert eased(results, "exact").rows[1][1] == "cannot"
    assert 0.25 < float(eased(results, "exact").rows[0][1].split(",")[0]) < 0.4  # a third
    assert eased(results, "exact").rows[3][1] == "1.0000, 0.0, 0.25"


def test_every_number_is_told_and_finite_or_none() -> None:
    rows = flow_numbers(made_up())
    assert {row["figure"] for row in rows} > {"capacity", "share_right", "waiting", "bound"}
    assert all(row["value"] is None or math.isfinite(row["value"]) for row in rows)
    found = [
        row["value"] for row in rows
        if (row["controller"], row["condition"], row["parcels"], row["speed"], row["figure"])
        == (EVENT, "exact", "S", 1.0, "capacity")
    ]  # fmt: skip
    assert found == [pytest.approx(0.4 * Case("S", 1.0).ceiling, rel=0.05)]


def test_the_bound_lies_below_the_ceiling() -> None:
    rule = next(contender for contender in RULES if contender.name == EVENT)
    for case in (Case("S", 1.5), Case("S and B", 1.5)):
        assert 0.5 * case.ceiling < bound_of(rule, case) < case.ceiling


def test_the_folder_holds_everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agents.flow.showing.FILMED", 0.4)
    monkeypatch.setattr("agents.flow.showing.SHOWN_AT", 0.2)
    monkeypatch.setattr(
        report, "results_of", lambda *_: made_up(),
    )  # fmt: skip
    screen = io.StringIO()
    console = Console(file=screen, width=200)
    done = write_flow_report(RULES, flow_cells(), tmp_path, console)
    assert "reservation" in screen.getvalue()
    assert list(done.tables) == flow_tables(made_up())
    told = (tmp_path / "flow.md").read_text()
    assert all(f"## {table.task.capitalize()}" in told for table in done.tables)
    with (tmp_path / "flow.csv").open() as file:
        assert len(list(csv.DictReader(file))) == len(flow_numbers(made_up()))
    shown = {file.name for file, _ in done.pictures}
    assert shown == {"flow-capacity.png", "flow-rate.png", "flow.png", "flow.mp4"}
    for file, what in done.pictures:
        assert what.endswith((".", "offered"))
        if file.suffix == ".png":
            assert imageio.imread(file).std() > 10.0  # there is something on it
    with imageio.get_reader(tmp_path / "flow.mp4") as film:
        assert film.count_frames() == 10 + 25
        assert film.get_data(0).shape[0] > 2 * imageio.imread(tmp_path / "flow.png").shape[0]


def test_who_decides_less_often_is_filmed_no_faster(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agents.flow.showing.FILMED", 0.4)
    rule = next(contender for contender in RULES if contender.name == EVENT)
    slow = replace(rule, control_period=0.08)
    write_flow_comparison([rule, slow], CURVE, 3000.0, tmp_path / "both.mp4")
    with imageio.get_reader(tmp_path / "both.mp4") as film:
        assert film.count_frames() == 10 + 25
        last = film.get_data(9)
    half = last.shape[0] // 2
    # Both show 0.36 s, the second to a period of its own: hardly a pixel differs.
    assert np.abs(last[:half].astype(float) - last[-half:]).mean() < 8.0


def test_who_cannot_sort_cannot_be_filmed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agents.flow.contenders.best_zone", lambda *_: None)
    zone = next(contender for contender in RULES if contender.name == ARRANGED)
    with pytest.raises(ValueError, match=r"contender must be able to sort S and B, 1\.5 m/s"):
        next(pictures_of(zone, CURVE, 3000.0))


def test_results_reckon_the_bounds(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = []

    def known(contender: object, case: Case) -> float:
        seen.append((contender, case))
        return 100.0

    monkeypatch.setattr("agents.flow.results.bound_of", known)
    results = results_of(RULES, flow_cells())
    assert [case for _, case in seen] == cases()
    assert results.rate(BOUND, CURVE) == 100.0
