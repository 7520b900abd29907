"""Tables, pages that stand alone, films, and the folders that `evaluate.py` fills with them."""

import csv
import io
import json
import re
import subprocess
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from shutil import copytree
from typing import Any

import imageio.v2 as imageio
import numpy as np
import pytest
from gymnasium.utils.seeding import np_random
from matplotlib.figure import Figure
from moviepy.config import FFMPEG_BINARY
from rich.console import Console

from surface_gym.agents.evaluation import capacity, report, streams, tables
from surface_gym.agents.evaluation.benchmark import find_benchmark, summarise
from surface_gym.agents.evaluation.capacity import Case
from surface_gym.agents.evaluation.cli import TASK_NAMES, EvaluateConfig, evaluate
from surface_gym.agents.evaluation.methods import rules
from surface_gym.agents.evaluation.robustness import FILE as SWEPT
from surface_gym.agents.evaluation.tables import task_table
from surface_gym.agents.evaluation.video import Player, write_comparison
from surface_gym.agents.library import SHELF
from surface_gym.agents.rules.streams import StreamEventRule
from surface_gym.agents.scheduling import scheduler
from surface_gym.agents.scheduling.maneuvers import ColumnGroups, make_library
from surface_gym.agents.scheduling.scheduler import Scheduler
from surface_gym.config import EnvConfig
from surface_gym.env import SmartSurfaceEnv
from surface_gym.registration import FLOW_TASK, ON_SLOPES
from surface_gym.rendering import with_caption
from surface_gym.tasks import TASKS
from tests.agents.evaluation import made
from tests.flow.flows import DENSE, SHORT

SLOW = summarise(
    [
        made.slow_result("fixed layout", [0.1, 0.004, 0.02, 0.2]),
        made.slow_result("fixed layout", [0.1, 0.1, 0.02, 0.2], preset="camera"),
        made.slow_result("a <rule>", [0.001, 0.004, 0.002, 0.02]),
        made.slow_result("a <rule>", [0.001, 0.04, 0.002, 0.02], preset="camera"),
        made.slow_result("planner", [0.0, 0.001]),
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
    fixed = made.sort_result("fixed layout", {"S": 0.72, "B": 1.0})
    summaries = summarise([fixed, made.sort_result("b", {"S": 0.36, "B": 0.52})])
    table = tables.speed_table(
        made.GRID, {name: summary for (_, name, _), summary in summaries.items()}
    )
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["0.5"] == ("fails", "2.000", "fails", "fails")
    assert rows["2.7"][0] == f"{1 / 2.7:.3f}"
    assert rows["minimum [m/s]"] == ("0.72", "0.36", "1.00", "0.52")


def test_the_page_needs_nothing_else(tmp_path) -> None:
    picture, film = tmp_path / "a.png", tmp_path / "a.mp4"
    Figure().savefig(picture)
    film.write_bytes(b"film")
    table = task_table("slow", SLOW)
    section = report.Section(
        table, [(picture, "a > b"), (film, "both")], find_benchmark("slow").columns
    )
    report.write_page([section], tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text()
    sources = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert all(source.startswith(("data:", "#")) for source in sources)
    assert len(sources) == 3
    assert "http" not in re.sub(r"data:[^\"]*", "", text)
    assert "a &lt;rule&gt;" in text
    assert "<rule>" not in text
    assert "a &gt; b" in text
    assert text.count("<td>") == sum(len(row) for row in table.rows)


def keep(rows: Sequence[Any], file: Path) -> list[str]:
    lines = [json.dumps(asdict(row)) + "\n" for row in rows]
    file.write_text("".join(lines))
    return lines


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"tasks": ("juggle",)}, "tasks must be one of 'flow', .*, got 'juggle'"),
        ({"exits": ("ends",)}, "exits must be one of 'sides', 'chutes', got 'ends'"),
        ({"exits": ()}, "exits must be at least one"),
        ({"starts": 0}, "^starts must be .* at least 1, got 0"),
        ({"robustness": True, "run": Path("a")}, "^run must be None where robustness is swept"),
    ],
)
def test_streams_are_compared_first_unless_asked_otherwise(given, message) -> None:
    assert EvaluateConfig().tasks == TASK_NAMES == (FLOW_TASK, *TASKS, *ON_SLOPES)
    with pytest.raises(ValueError, match=message):
        EvaluateConfig(**given)


def quick_scheduler(config: EnvConfig, groups: ColumnGroups | None) -> Scheduler:
    """One that was never tried, with few maneuvers."""
    return Scheduler(config, make_library(config, groups, place_count=2))


def test_results_of_streams_become_a_page(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(streams, "stream_methods", lambda: made.RULES)
    monkeypatch.setattr(streams, "make_scheduler", quick_scheduler)
    monkeypatch.setattr(report, "LENGTH", 0.4)
    monkeypatch.setattr(report, "SHOWN_AT", 0.2)
    lines = keep(made.stream_rows(), tmp_path / streams.FILE)
    screen = io.StringIO()
    config = EvaluateConfig(out=tmp_path, tasks=(FLOW_TASK,), workers=1, resume=True)
    evaluate(config, Console(file=screen, width=160))
    assert "modules over columns" in screen.getvalue()
    page = (tmp_path / "report.html").read_text()
    assert "Flow: ladder of hardware, exact, exits “sides”</a>" in page
    assert "Flow: what a rung has over another, camera, exits “sides”" in page
    assert "data:video/mp4;base64," in page
    replayed = (tmp_path / "flow.html").read_text()
    assert len(re.findall("data-name=", replayed)) == page.count("data-name=") > 1
    assert 'sandbox="allow-scripts"' in page
    assert not re.search(r'(?:src|href)="(?!data:|#)', page)
    assert not (tmp_path / "comparison.md").exists()
    kept = (tmp_path / streams.FILE).read_text().splitlines()
    assert list(map(json.loads, kept)) == list(map(json.loads, lines))
    text = (tmp_path / "flow.md").read_text()
    assert all(
        f"## {each.heading}" in text for each in streams.stream_tables(made.stream_results())
    )
    count = len(streams.stream_numbers(made.stream_results()))
    assert len((tmp_path / "flow.csv").read_text().splitlines()) == count + 1
    for name in ("flow-capacity.png", "flow.png"):
        assert imageio.imread(tmp_path / name).std() > 10.0  # there is something on it
    with imageio.get_reader(tmp_path / "flow.mp4") as video:
        assert video.count_frames() == 10 + 25
        assert video.get_data(0).shape[0] >= 2 * imageio.imread(tmp_path / "flow.png").shape[0]


def test_a_sweep_becomes_tables(tmp_path, monkeypatch) -> None:
    fixed = rules("slow")[:1]
    monkeypatch.setattr("surface_gym.agents.evaluation.methods.all_methods", lambda _: fixed)
    keep(made.sweep_results("slow", {"fixed layout": 0.5}), tmp_path / SWEPT)
    screen = io.StringIO()
    config = EvaluateConfig(
        out=tmp_path, tasks=("slow",), workers=1, resume=True, robustness=True, starts=made.STARTS
    )
    evaluate(config, Console(file=screen, width=160))
    assert "fixed layout" in screen.getvalue()
    assert (tmp_path / "robustness.csv").is_file()
    assert not (tmp_path / "comparison.md").exists()


def test_every_seed_of_a_run_is_measured_beside_the_scheduler(tmp_path, monkeypatch) -> None:
    case = Case("S", 2.0)
    monkeypatch.setattr(
        streams, "cases", lambda preset="exact", exits="sides": [Case("S", 2.0, preset, exits)]
    )
    for name, value in (("REPLICATIONS", 2), ("WARM_UP", 4.0), ("SECONDS", 12.0)):
        monkeypatch.setattr(capacity, name, value)
    monkeypatch.setattr(scheduler, "TRIED", 4)
    monkeypatch.setattr(scheduler, "TRIAL", 10.0)
    for seed in (0, 1):
        copytree(SHELF / "flow-schedule" / f"seed-{seed}", tmp_path / f"seed-{seed}")
    seen: list[streams.StreamResults] = []
    compare = report.compare_streams

    def watched(*given: Any) -> streams.StreamResults:
        seen.append(compare(*given))
        return seen[0]

    monkeypatch.setattr(report, "compare_streams", watched)
    card = report.evaluate_run(tmp_path, None, 1, Console(quiet=True))
    (found,) = seen
    assert set(found.names) == {streams.MODULES, "seed 0", "seed 1"}
    for name in found.names:
        assert found.rate(name, case) > 0.4 * case.ceiling
    assert "seed 1" in (tmp_path / report.TABLE).read_text()
    for preset in ("exact", "camera"):
        (stream,) = card[preset].values()
        assert len(stream["capacity_of_each_seed"]) == 2
        assert min(stream["share_right"]) > 0.99


@pytest.mark.parametrize("text", [None, "", "[1", "env_id: SmartSurface/Sort-v0", "- a"])
def test_other_runs_are_of_no_streams(tmp_path, text) -> None:
    if text is not None:
        (tmp_path / "policy.yaml").write_text(text)
    assert report.stream_task(tmp_path) is None


GIVEN: dict[str, Any] = {
    "stream": DENSE, "exits": "sides", "actions": "parcels", "duration": 2.0, "line": SHORT,
}  # fmt: skip
CONFIG = EnvConfig("flow", **GIVEN)


def read(file: Path) -> tuple[float, list[np.ndarray]]:
    """[1/s] pictures of a film, and the pictures."""
    asked = [FFMPEG_BINARY, "-i", str(file), "-f", "rawvideo", "-pix_fmt", "rgb24", "-"]
    found = subprocess.run(asked, capture_output=True, check=True)
    described = re.search(rb"Video: .* (\d+)x(\d+).* ([\d.]+) fps", found.stderr)
    width, height = int(described[1]), int(described[2])
    pictures = np.frombuffer(found.stdout, dtype=np.uint8).reshape(-1, height, width, 3)
    return float(described[3]), list(pictures.astype(float))


def test_it_shows_what_the_environment_draws(tmp_path) -> None:
    player = Player("event", StreamEventRule(CONFIG), CONFIG, np_random(3)[0])
    write_comparison([player], tmp_path / "flow.mp4")
    rate, pictures = read(tmp_path / "flow.mp4")
    assert rate == 25.0
    assert len(pictures) == 1 + 50 + 25  # the start, the control periods, and the last one stays
    env = SmartSurfaceEnv("flow", render_mode="rgb_array", **GIVEN)
    rule = StreamEventRule(CONFIG)
    observation, _ = env.reset(seed=3)
    for picture in pictures[:11]:
        drawn: Any = env.render()
        shown = with_caption(drawn, "event")
        assert np.abs(picture - shown).mean() < 4.0  # of 255: the codec loses a little
        observation = env.step(rule.predict(observation)[0])[0]
    assert np.abs(pictures[-1] - pictures[50]).mean() < 1.0


def test_a_slower_decider_is_filmed_no_faster(tmp_path) -> None:
    rule = next(method for method in made.RULES if method.name == streams.EVENT)
    both = [rule, replace(rule, control_period=0.08)]
    players = [report.stream_player(method, streams.FILMED, 3000.0) for method in both]
    write_comparison(players, tmp_path / "both.mp4", 0.4)
    with imageio.get_reader(tmp_path / "both.mp4") as video:
        assert video.count_frames() == 10 + 25
        last = video.get_data(9)
    replayed = (tmp_path / "both.html").read_text()
    assert re.findall('data-name="(.*?)"', replayed) == [streams.EVENT, f"{streams.EVENT} 2"]
    half = last.shape[0] // 2
    # Both show 0.36 s, the second to a period of its own: hardly a pixel differs.
    assert np.abs(last[:half].astype(float) - last[-half:]).mean() < 8.0


def test_a_method_that_cannot_sort_cannot_be_filmed(monkeypatch) -> None:
    monkeypatch.setattr(streams, "make_scheduler", lambda *_: None)
    zone = next(method for method in made.RULES if method.name == streams.MODULES)
    with pytest.raises(ValueError, match=r"method must be able to sort S, 1\.5 m/s"):
        report.stream_player(zone, Case("S", 1.5), 3000.0)
