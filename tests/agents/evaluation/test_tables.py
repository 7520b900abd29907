"""Tables: the same numbers on screen, as Markdown, CSV and JSON, and a page that stands alone."""

import csv
import io
import json
import re

from matplotlib.figure import Figure
from rich.console import Console

from surface_gym.agents.evaluation import tables
from surface_gym.agents.evaluation.benchmark import find_benchmark, summarise
from surface_gym.agents.evaluation.report import Section, write_page
from surface_gym.agents.evaluation.tables import task_table
from tests.agents.evaluation.made import GRID, slow_result, sort_result

SLOW = summarise(
    [
        slow_result("fixed layout", [0.1, 0.004, 0.02, 0.2]),
        slow_result("fixed layout", [0.1, 0.1, 0.02, 0.2], preset="camera"),
        slow_result("a <rule>", [0.001, 0.004, 0.002, 0.02]),
        slow_result("a <rule>", [0.001, 0.04, 0.002, 0.02], preset="camera"),
        slow_result("planner", [0.0, 0.001]),
    ]
)


def test_a_row_for_each_method() -> None:
    table = task_table("slow", SLOW)
    assert table.header[:4] == ("controller", "seeds", "success (95 % interval)", "camera")
    fixed, rule, planner = table.rows
    assert fixed[0] == "fixed layout"
    assert fixed[2].startswith("0.250 (")
    assert rule[3:5] == ("0.500", "0.0030")  # the median's
    assert (planner[0], planner[3]) == ("planner (2 starts)", "-")
    # Decision times stand apart.
    assert not any("decision" in name for name in table.header)
    times = tables.decision_table(["slow"], SLOW)
    assert times.header == ("controller", "slow")
    expected = f"{1e6 * SLOW['slow', 'a <rule>', 'exact'].decision_time:.1f}"
    assert dict(times.rows)["a <rule>"] == expected


def test_a_wide_table_is_shown_in_parts_that_repeat_the_first_column() -> None:
    header = ("name", *(f"[{k}] long heading" for k in range(9)))
    table = tables.Table("wide", "a [b]", header, (("row one", *(f"{k}.000" for k in range(9))),))
    for width, parts in ((400, 1), (60, 2)):
        screen = io.StringIO()
        table.show(Console(file=screen, width=width))
        text = screen.getvalue()
        assert text.count("row one") == parts
        assert all(f"{k}.000" in text for k in range(9))
        assert "[8]" in text
        assert "a [b]" in text
        assert max(map(len, text.splitlines())) <= width


def test_files_agree(tmp_path) -> None:
    page, *files = (tmp_path / f"a.{end}" for end in ("md", "csv", "json"))
    tables.write_markdown([task_table("slow", SLOW)], page)
    tables.write_numbers(tables.task_numbers("slow", SLOW), *files)
    numbers = json.loads(files[1].read_text())
    with files[0].open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["metric"] for line in lines] == [number["metric"] for number in numbers]
    for line, number in zip(lines, numbers, strict=True):
        assert line["value"] == ("" if number["value"] is None else str(number["value"]))
    key, wanted = ("controller", "preset", "metric"), ["a <rule>", "exact", "success"]
    (rate,) = [each["value"] for each in numbers if [each[name] for name in key] == wanted]
    assert f"| a <rule> | 1 | {rate:.3f} (" in page.read_text()


def test_by_speed() -> None:
    fixed = sort_result("fixed layout", {"S": 0.72, "B": 1.0})
    summaries = summarise([fixed, sort_result("b", {"S": 0.36, "B": 0.52})])
    table = tables.speed_table(GRID, {name: summary for (_, name, _), summary in summaries.items()})
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["0.5"] == ("fails", "2.000", "fails", "fails")
    assert rows["2.7"][0] == f"{1 / 2.7:.3f}"
    assert rows["minimum [m/s]"] == ("0.72", "0.36", "1.00", "0.52")


def test_the_page_needs_nothing_else(tmp_path) -> None:
    picture, film = tmp_path / "a.png", tmp_path / "a.mp4"
    Figure().savefig(picture)
    film.write_bytes(b"film")
    table = task_table("slow", SLOW)
    section = Section(table, [(picture, "a > b"), (film, "both")], find_benchmark("slow").columns)
    write_page([section], tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    sources = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert all(source.startswith(("data:", "#")) for source in sources)
    assert len(sources) == 3
    assert "http" not in re.sub(r"data:[^\"]*", "", text)
    assert "a &lt;rule&gt;" in text
    assert "<rule>" not in text
    assert "a &gt; b" in text
    assert text.count("<td>") == sum(len(row) for row in table.rows)
