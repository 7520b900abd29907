"""Pages that stand alone, films, and the folders that `evaluate.py` fills with them."""

import io
import re
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from shutil import copytree
from typing import Any

import imageio.v2 as imageio
import numpy as np
import pandas as pd
import pytest
from gymnasium.utils.seeding import np_random
from matplotlib.figure import Figure
from moviepy.config import FFMPEG_BINARY
from rich.console import Console

from surface_gym.agents.evaluation import cli, report, run_report, streams as ladder, views
from surface_gym.agents.evaluation.cli import EvaluateConfig, evaluate
from surface_gym.agents.evaluation.method import all_methods, of_run, rules, start_benchmark
from surface_gym.agents.evaluation.pictures import Player, write_comparison
from surface_gym.agents.evaluation.report import filmed_scenario, stream_player
from surface_gym.agents.evaluation.results import FILE, write_results
from surface_gym.agents.evaluation.scenario import Extent
from surface_gym.agents.evaluation.tables import Section, write_page
from surface_gym.agents.library import SHELF
from surface_gym.agents.rules.sorting import StreamEventRule
from surface_gym.agents.scheduling.maneuvers import ColumnGroups, make_library
from surface_gym.agents.scheduling.scheduler import Scheduler
from surface_gym.config import PRESETS, EnvConfig
from surface_gym.env import SmartSurfaceEnv
from surface_gym.registration import SHIPPED
from surface_gym.rendering import with_caption
from tests.agents.evaluation import made
from tests.agents.evaluation.test_views import SLOW
from tests.flow.flows import DENSE, SHORT
from tests.machine.recorded import ESTIMATE

RULES = [each for each in all_methods("flow") if each.name in made.SHARES]
ROOT = Path(__file__).parents[3]


def test_the_page_needs_nothing_else(tmp_path) -> None:
    picture, film = tmp_path / "a.png", tmp_path / "a.mp4"
    Figure().savefig(picture)
    film.write_bytes(b"film")
    (table,) = views.task_tables("slow", SLOW)
    section = Section(table, [(picture, "a > b"), (film, "both")], start_benchmark("slow").columns)
    write_page([section], tmp_path / "report.html", "Quick: few <starts>.")
    text = (tmp_path / "report.html").read_text()
    sources = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert all(source.startswith(("data:", "#")) for source in sources)
    assert len(sources) == 3
    assert "http" not in re.sub(r"data:[^\"]*", "", text)
    assert "Quick: few &lt;starts&gt;." in text
    assert "a &lt;rule&gt;" in text
    assert "<rule>" not in text
    assert "a &gt; b" in text
    assert text.count("<td>") == sum(len(row) for row in table.rows)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"tasks": ("juggle",)}, "tasks must be one of 'sort', .*, got 'juggle'"),
        ({"exits": ("ends",)}, "exits must be one of 'sides', 'chutes', got 'ends'"),
        ({"exits": ()}, "exits must be at least one"),
        ({"starts": 0}, "^starts must be .* at least 1, got 0"),
        ({"robustness": True, "run": Path("a")}, "^run must be None where robustness is swept"),
        ({"run": Path("a"), "out": Path("b")}, "^out must not be given beside run, got a and b"),
    ],
)
def test_every_task_is_compared_unless_asked_otherwise(given, message) -> None:
    assert EvaluateConfig().tasks == tuple(SHIPPED)
    assert EvaluateConfig(quick=True).folder == Path("runs/evaluation-quick")
    assert EvaluateConfig(quick=True, out=Path("a")).folder == Path("a")
    with pytest.raises(ValueError, match=message):
        EvaluateConfig(**given)


def quick_scheduler(config: EnvConfig, groups: ColumnGroups | None) -> Scheduler:
    """One that was never tried, with few maneuvers."""
    return Scheduler(config, make_library(config, groups, place_count=2))


def test_results_of_streams_become_a_page(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(report, "all_methods", lambda _: RULES)
    monkeypatch.setattr(ladder, "make_scheduler", quick_scheduler)
    monkeypatch.setattr(cli, "replace", lambda *_, **__: Extent(replications=10, film=0.4))
    write_results(pd.concat(made.capacity_rows()), tmp_path / FILE)
    kept = (tmp_path / FILE).read_bytes()
    screen = io.StringIO()
    config = EvaluateConfig(out=tmp_path, tasks=("flow",), workers=1, resume=True)
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
    assert (tmp_path / FILE).read_bytes() == kept
    assert "## Flow: ladder of hardware, exact, exits “sides”" in (tmp_path / "flow.md").read_text()
    assert imageio.imread(tmp_path / "flow-capacity.png").std() > 10.0  # something is on it
    with imageio.get_reader(tmp_path / "flow.mp4") as video:
        assert video.count_frames() == 10 + 25


def test_a_sweep_becomes_tables_and_is_never_lost(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(report, "all_methods", lambda _: rules("slow")[:1])
    write_results(pd.concat(made.whole_sweep("slow", {"fixed layout": 0.5})), tmp_path / FILE)
    kept = (tmp_path / FILE).read_bytes()
    screen = io.StringIO()
    given: dict[str, Any] = {
        "out": tmp_path, "tasks": ("slow",), "workers": 1, "robustness": True, "starts": made.COUNT
    }  # fmt: skip
    (tmp_path / cli.SETTINGS).write_text(f'{{"quick": false, "starts": {made.COUNT}}}')
    for wrong, message in (
        ({}, "out must be a folder without these results, got .*: add --resume"),
        ({"resume": True, "quick": True}, "out must be a folder with results of the same --quick"),
    ):
        with pytest.raises(ValueError, match=message):
            evaluate(EvaluateConfig(**given, **wrong), Console(quiet=True))
        assert (tmp_path / FILE).read_bytes() == kept
    evaluate(EvaluateConfig(**given, resume=True), Console(file=screen, width=160))
    assert "fixed layout" in screen.getvalue()
    assert (tmp_path / "robustness.png").read_bytes().startswith(b"\x89PNG")
    assert "## Slow: lab" in (tmp_path / "robustness.md").read_text()
    assert (tmp_path / FILE).read_bytes() == kept
    assert not (tmp_path / "report.html").exists()


def test_a_command_shows_at_once_that_it_works_and_ends_at_once(tmp_path) -> None:
    """Its first line comes before its libraries; Ctrl-C leaves the exit code of a shell."""
    command = [sys.executable, str(ROOT / "evaluate.py"), "--tasks", "slow", "--workers", "1"]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as running:
        assert running.stdout is not None
        assert running.stdout.readline() == "loading what compares\n"
        time.sleep(0.2)
        running.send_signal(2)
        try:
            _, errors = running.communicate(timeout=60.0)
        finally:
            running.kill()
    assert running.returncode == cli.INTERRUPTED
    assert "interrupted; --resume goes on" in errors


def test_every_seed_of_a_run_on_streams_is_measured_beside_the_rules(tmp_path, monkeypatch) -> None:
    """A card of a task whose rates are searched has each seed beside the scheduler."""
    few = Extent(replications=2, duration=6.0)
    asked = run_report.stream_scenarios
    monkeypatch.setattr(
        run_report,
        "stream_scenarios",
        lambda task: [each for each in asked(task, few) if each.preset != "camera"],
    )
    for seed in (0, 1):
        copytree(SHELF / "merge-parcels" / f"seed-{seed}", tmp_path / f"seed-{seed}")
    card = run_report.evaluate_run(tmp_path, None, 1, Console(quiet=True))
    assert list(card) == ["exact", "lab"]
    for each in (each for offers in card.values() for each in offers.values()):
        assert len(each["right_an_hour_of_each_seed"]) == 2
        assert {"time slots", "hold and release"} <= each["rules"].keys()
        assert "roll on" not in each["rules"]
    assert (tmp_path / run_report.TABLE).read_text().count("PPO per parcel") == 4
    samples = {
        name: run_report.Sample(rows)
        for (_, scenario, preset, name), rows in pd.concat(made.capacity_rows()).groupby(
            ["task", "scenario", "preset", "method"], sort=False
        )
        if (scenario, preset) == ("S, 2 m/s, sides", "exact")
    }
    made_card = run_report._capacity_card({k: samples[k] for k in (ladder.MODULES, ladder.SERIES)})
    assert made_card["capacity_of_each_seed"] == [0]
    assert made_card["share_right"] == [None]
    assert made_card["scheduler"] == pytest.approx(0.6 * made.CEILINGS[2], rel=0.01)


def test_on_an_identified_surface_a_run_meets_the_shipped_agents(tmp_path) -> None:
    copytree(SHELF / "slow-ppo-lab" / "seed-0", tmp_path / "seed-0")
    ESTIMATE.save(tmp_path / run_report.ESTIMATE)
    agent = of_run(tmp_path)
    assert agent.name == "PPO, identified"
    _, methods = run_report._start_rivals(tmp_path, agent)
    assert [each.name for each in methods] == [
        "fixed layout", "PPO", "DQN", "PPO, lab", "PPO, identified"
    ]  # fmt: skip
    task, lab = start_benchmark("slow").task, PRESETS["lab"]
    for each in methods:
        assert each.config(task, lab).chosen_line.mu_max == ESTIMATE.values["mu_max"]
    assert agent.config(task, lab).chosen_line == task.line


def test_methods_on_a_slope_are_filmed_side_by_side(tmp_path) -> None:
    scenario = filmed_scenario("merge", "lab", extent=Extent(film=0.2))
    both = report.rivals(all_methods("merge"))
    video, said = report._film(both, scenario, None, tmp_path / "lab.mp4", "three lines, lab")
    with imageio.get_reader(video) as frames:
        assert frames.count_frames() >= 5
        assert frames.get_data(0).std() > 10.0
    assert said == "time slots, 8 at once and PPO per module: three lines, lab."


GIVEN: dict[str, Any] = {
    "stream": DENSE, "exits": "sides", "actions": "parcels", "duration": 0.8, "line": SHORT,
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
    assert len(pictures) == 1 + 20 + 25  # the start, the control periods, and the last one stays
    env = SmartSurfaceEnv("flow", render_mode="rgb_array", **GIVEN)
    rule = StreamEventRule(CONFIG)
    observation, _ = env.reset(seed=3)
    for picture in pictures[:11]:
        drawn: Any = env.render()
        shown = with_caption(drawn, "event")
        assert np.abs(picture - shown).mean() < 4.0  # of 255: the codec loses a little
        observation = env.step(rule.predict(observation)[0])[0]
    assert np.abs(pictures[-1] - pictures[20]).mean() < 1.0


def test_a_slower_decider_is_filmed_no_faster(tmp_path) -> None:
    rule = next(each for each in RULES if each.name == ladder.EVENT)
    both = [rule, replace(rule, arguments=rule.arguments | {"control_period": 0.08})]
    players = [stream_player(each, filmed_scenario("flow"), 3000.0) for each in both]
    write_comparison(players, tmp_path / "both.mp4", 0.4)
    with imageio.get_reader(tmp_path / "both.mp4") as video:
        assert video.count_frames() == 10 + 25
        last = video.get_data(9)
    replayed = (tmp_path / "both.html").read_text()
    assert re.findall('data-name="(.*?)"', replayed) == [ladder.EVENT, f"{ladder.EVENT} 2"]
    half = last.shape[0] // 2
    # Both show 0.36 s, the second to a period of its own: hardly a pixel differs.
    assert np.abs(last[:half].astype(float) - last[-half:]).mean() < 8.0


def test_a_method_that_cannot_sort_cannot_be_filmed(monkeypatch) -> None:
    monkeypatch.setattr(ladder, "make_scheduler", lambda *_: None)
    modules = next(each for each in RULES if each.name == ladder.MODULES)
    with pytest.raises(ValueError, match=r"method must be able to sort S and B, 1\.5 m/s"):
        stream_player(modules, filmed_scenario("flow"), 3000.0)
