"""Tables: the same numbers on screen, as Markdown, CSV and JSON, and a page that stands alone."""

import csv
import json
import re
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from agents.evaluation.by_speed import speed_table
from agents.evaluation.columns import columns_of
from agents.evaluation.decisions import decision_table, write_decisions
from agents.evaluation.page import write_page
from agents.evaluation.summary import summarise
from agents.evaluation.table import make_table, markdown, write_tables
from agents.evaluation.trials import make_trial
from tests.agents.evaluation.cells import slow_cell, sort_cell

SLOW = summarise(
    [
        slow_cell("fixed layout", [0.1, 0.004, 0.02, 0.2]),
        slow_cell("fixed layout", [0.1, 0.1, 0.02, 0.2], condition="camera"),
        slow_cell("a <rule>", [0.001, 0.004, 0.002, 0.02]),
        slow_cell("a <rule>", [0.001, 0.04, 0.002, 0.02], condition="camera"),
        slow_cell("planner", [0.0, 0.001]),
    ]
)


def test_a_row_a_contender() -> None:
    table = make_table(make_trial("slow"), SLOW)
    assert table.header[:4] == ("controller", "seeds", "success (95 % interval)", "camera")
    fixed, rule, planner = table.rows
    assert fixed[0] == "fixed layout"
    assert fixed[2].startswith("0.250 (")
    assert rule[3] == "0.500"
    assert rule[4] == "0.0030"  # the median's
    assert planner[0] == "planner (2 starts)"
    assert planner[3] == "-"


def test_files_agree(tmp_path: Path) -> None:
    trial = make_trial("slow")
    table = make_table(trial, SLOW)
    write_tables([trial], [table], SLOW, tmp_path)
    numbers = json.loads((tmp_path / "comparison.json").read_text())
    with (tmp_path / "comparison.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["figure"] for line in lines] == [number["figure"] for number in numbers]
    for line, number in zip(lines, numbers, strict=True):
        assert line["value"] == ("" if number["value"] is None else str(number["value"]))
    (rate,) = [
        number["value"]
        for number in numbers
        if (number["controller"], number["condition"], number["figure"])
        == ("a <rule>", "exact", "success")
    ]
    assert f"| a <rule> | 1 | {rate:.3f} (" in (tmp_path / "comparison.md").read_text()
    assert markdown(table) in (tmp_path / "comparison.md").read_text()


def test_what_a_decision_takes_stands_apart(tmp_path: Path) -> None:
    trial = make_trial("slow")
    assert not any("decision" in name for name in make_table(trial, SLOW).header)
    table = decision_table([trial], SLOW)
    assert table.header == ("controller", "slow")
    times = {row[0]: row[1] for row in table.rows}
    assert times["a <rule>"] == f"{1e6 * SLOW['slow', 'a <rule>', 'exact'].decision_time:.1f}"
    write_decisions(table, tmp_path)
    assert (tmp_path / "decisions.md").read_text() == markdown(table)


def test_by_speed() -> None:
    summaries = summarise(
        [sort_cell("fixed layout", {"S": 0.72, "B": 1.0}), sort_cell("b", {"S": 0.36, "B": 0.52})]
    )
    table = speed_table({who: summary for (_, who, _), summary in summaries.items()})
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["0.5"] == ("fails", "2.000", "fails", "fails")
    assert rows["2.7"][0] == f"{1 / 2.7:.3f}"
    assert rows["minimum [m/s]"] == ("0.72", "0.36", "1.00", "0.52")


def test_the_page_needs_nothing_else(tmp_path: Path) -> None:
    picture = tmp_path / "a.png"
    Figure().savefig(picture)
    film = tmp_path / "a.mp4"
    film.write_bytes(b"film")
    table = make_table(make_trial("slow"), SLOW)
    told = [(picture, "a > b"), (film, "both")]
    columns = {"slow": columns_of("slow")}
    write_page([table], {"slow": told}, columns, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    sources = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert all(source.startswith(("data:", "#")) for source in sources)
    assert len(sources) == 3
    assert "http" not in re.sub(r"data:[^\"]*", "", text)
    assert "a &lt;rule&gt;" in text
    assert "<rule>" not in text
    assert "a &gt; b" in text
    assert np.char.count(text, "<td>") == sum(len(row) for row in table.rows)
