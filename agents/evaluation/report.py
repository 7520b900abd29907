"""The folder of a comparison: tables, plots, videos, and one web page that holds them all; and the
comparison of a training run's policies, for its folder and its card.
"""

import base64
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from html import escape
from itertools import islice
from pathlib import Path
from string import Template
from typing import Any

import imageio.v2 as imageio
import numpy as np
from gymnasium.utils.seeding import np_random
from rich.console import Console

from surface_gym.config import PRESETS, EnvConfig
from surface_gym.parallel import Workers
from surface_gym.player import frame_page
from surface_gym.registration import FLOW_TASK, ON_SLOPES, env_id
from surface_gym.tasks.benchmark import Column

from .. import library
from ..base import Controller
from ..yaml_file import read_yaml
from . import benchmark, plots, streams, tables as texts
from .benchmark import (
    SEED,
    Result,
    Summaries,
    compute_results,
    find_benchmark,
    show_progress,
    summarise,
)
from .capacity import STREAM_PRESETS, Case, StreamMethod
from .material_flow_report import compare_run
from .methods import FIXED, PLANNER, Method, of_run, policy_folders, rivals, rules
from .streams import ARRANGED, COLUMNS, FILMED, MODULES, SERIES, StreamResult, StreamResults
from .video import Player, play, write_comparison

NEAR = 0.95  # [-] of the modules' capacity, at which the video shows all rungs
LENGTH = 20.0  # [s] of the video
SHOWN_AT = 12.0  # [s] since the start of a stream, of the picture
TABLE = "table.md"  # of a run
COMPARED = ("exact", "camera", "lab")  # presets under which a run's policies are compared

Pictures = list[tuple[Path, str]]  # files, and what each shows


@dataclass(frozen=True)
class Section:
    """A part of the page: a table, pictures and videos, and columns whose meaning is explained."""

    table: texts.Table
    pictures: Pictures
    columns: tuple[Column, ...] = ()


def write_report(
    methods: Sequence[Method],
    results: Sequence[Result],
    folder: Path,
    console: Console,
    advance: Callable[[str], None] = lambda _: None,
    first: Sequence[Section] = (),
) -> None:
    """Write everything of a comparison into a folder, and show its tables."""
    summaries = summarise(results)
    tasks = list(dict.fromkeys(method.task for method in methods))
    sections = []
    for task in tasks:
        advance(f"drawing {task}")
        table = texts.task_table(task, summaries)
        pictures = _draw_task([m for m in methods if m.task == task], summaries, folder)
        sections.append(Section(table, pictures, find_benchmark(task).columns))
        sections += [Section(table, []) for table in speed_tables(task, summaries)]
    if tasks:
        texts.write_markdown([each.table for each in sections], folder / "comparison.md")
        texts.write_numbers(
            [row for task in tasks for row in texts.task_numbers(task, summaries)],
            folder / "comparison.csv",
            folder / "comparison.json",
        )
        decisions = texts.decision_table(tasks, summaries)
        texts.write_markdown([decisions], folder / texts.DECISIONS)
        sections.append(Section(decisions, []))
    for section in sections:
        section.table.show(console)
    write_page([*first, *sections], folder / "report.html")


def speed_tables(task: str, summaries: Summaries) -> list[texts.Table]:
    """Make the table by entry speed of a task whose starts are a grid of speeds; else none."""
    grid = find_benchmark(task).grid
    if grid is None:
        return []
    exact = {
        method: summary
        for (of_task, method, preset), summary in summaries.items()
        if (of_task, preset) == (task, "exact") and method != PLANNER
    }
    return [texts.speed_table(grid, exact)]


def _draw_task(methods: Sequence[Method], summaries: Summaries, folder: Path) -> Pictures:
    task = methods[0].task
    compared, label = find_benchmark(task), library.task_label(task)
    success = folder / f"{label}-success.png"
    plots.draw_success(task, summaries, success)
    pictures = [(success, "Success by preset, with 95 % intervals.")]
    both = rivals(methods)
    if compared.grid is not None:
        times, paths = folder / f"{label}-times.png", folder / f"{label}-trajectories.png"
        plots.draw_times(task, compared.grid, summaries, times)
        pictures.append(
            (times, "Time to sort by entry speed; no line where a parcel is not sorted.")
        )
        write_trajectories(both, paths)
        pictures.append((paths, "Trajectories by entry speed; dotted where it is not sorted."))
    elif compared.error is not None:
        errors = folder / f"{label}-errors.png"
        plots.draw_errors(task, compared.error, summaries, errors)
        pictures.append((errors, "Share of starts by the size of the error, exact sensors."))
    return [*pictures, write_example(both, folder)]


def write_trajectories(methods: Iterable[Method], file: Path) -> bool:
    """Draw where parcels go by entry speed, of a task whose starts are a grid; say whether."""
    several = list(methods)
    grid = find_benchmark(several[0].task).grid
    if grid is not None:
        episodes = {each.name: benchmark.play(each, each.seeds[0], "exact")[1] for each in several}
        plots.draw_trajectories(grid, episodes, file)
    return grid is not None


def write_example(methods: Sequence[Method], folder: Path) -> tuple[Path, str]:
    """Film methods of a task side by side, the first seed of each; return file and caption."""
    task = methods[0].task
    compared = find_benchmark(task)
    players = []
    for method in methods:
        config = method.config(compared.task, PRESETS["exact"])
        controller = method.make(config, method.seeds[0])
        rng = np_random(SEED)[0]
        players.append(Player(method.name, controller, config, rng, compared.example))
    file = folder / f"{library.task_label(task)}.mp4"
    outcomes = ", ".join(
        f"{player.name} {'succeeds' if success else 'fails'}"
        for player, success in zip(players, write_comparison(players, file), strict=True)
    )
    return file, f"{compared.example_description}: {outcomes}"


def write_stream_report(
    methods: Sequence[StreamMethod], rows: Sequence[StreamResult], folder: Path, console: Console
) -> list[Section]:
    """Write flow.md, flow.csv, plots, a picture and a video, and show tables; return sections."""
    results = StreamResults(tuple(rows))
    tables = streams.stream_tables(results)
    for table in tables:
        table.show(console)
    texts.write_markdown(tables, folder / "flow.md")
    texts.write_numbers(streams.stream_numbers(results), folder / "flow.csv")
    pictures = _draw_streams(methods, results, folder)
    return [Section(tables[0], pictures), *(Section(table, []) for table in tables[1:])]


def _draw_streams(
    methods: Sequence[StreamMethod], results: StreamResults, folder: Path
) -> Pictures:
    exits = results.exits[0]
    case = replace(FILMED, exits=exits)
    capacities = folder / "flow-capacity.png"
    plots.draw_capacities(results, capacities, exits)
    rate = NEAR * results.rate(MODULES, case)
    named = {
        method.name: method for method in methods if results.capacity(method.name, case) is not None
    }
    picture, video = folder / "flow.png", folder / "flow.mp4"
    imageio.imwrite(picture, stream_picture(named[MODULES], rate, case))
    shown = [named[name] for name in (ARRANGED, SERIES, COLUMNS, MODULES) if name in named]
    write_comparison([stream_player(each, case, rate) for each in shown], video, LENGTH)
    stream = f"{case.label}, exits “{exits}”, {rate:.0f} parcels an hour offered"
    return [
        (capacities, f"Capacity by stream, exits “{exits}”, exact sensors, 95 % intervals."),
        (picture, f"Each module by itself: {stream}."),
        (video, f"The same stream under {', '.join(each.name for each in shown)}: {stream}."),
    ]


def stream_player(method: StreamMethod, case: Case, rate: float) -> Player:
    """Put a method on the first replication of a stream, at a rate [parcels/h]."""
    config = method.config(case, rate)
    controller = method.make(config)
    if controller is None:
        raise ValueError(f"method must be able to sort {case.label}, got {method.name!r}")
    return Player(method.name, controller, config, np.random.default_rng((SEED, 0)))


def stream_picture(method: StreamMethod, rate: float, case: Case = FILMED) -> np.ndarray:
    """Draw the stream of the video in its midst, at a rate [parcels/h]."""
    at = round(SHOWN_AT / method.control_period)
    picture, _ = next(islice(play(stream_player(method, case, rate), every=at), at, None))
    return picture


_PAGE = Template("""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>surface_gym: the comparison</title>
<style>
:root { color-scheme: light; }
body { font: 16px/1.55 system-ui, sans-serif; color: #212730; background: #fff;
  max-width: 72rem; margin: 0 auto; padding: 2rem 1.2rem 5rem; }
h1 { font-size: 1.9rem; margin: 0 0 .4rem; }
h2 { font-size: 1.35rem; margin: 3.2rem 0 .3rem; padding-top: 1.6rem;
  border-top: 1px solid #dde1e6; }
p, li { max-width: 46rem; }
.caption { color: #5c6672; }
nav a { margin-right: 1rem; color: #21618c; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .86rem; font-variant-numeric: tabular-nums;
  margin: 1rem 0; }
th, td { padding: .32rem .7rem; text-align: right; border-bottom: 1px solid #e6e9ed;
  white-space: nowrap; }
th { color: #5c6672; font-weight: 600; white-space: normal; vertical-align: bottom; }
th:first-child, td:first-child { text-align: left; }
tbody tr:hover { background: #f5f7f9; }
img, video { max-width: 100%; height: auto; margin: .6rem 0; }
figcaption { color: #5c6672; font-size: .86rem; }
figure { margin: 1.2rem 0; }
dl { font-size: .86rem; } dt { font-weight: 600; } dd { margin: 0 0 .4rem 0; color: #5c6672; }
</style>
</head>
<body>
<h1>Which controller steers the parcel best?</h1>
<p>Fixed layouts, as the study arranges them once beforehand, beside rules, a planner and agents
that turn every axis while the parcel passes. All of them meet the same starts and see only what
the sensors say.</p>
<nav>$contents</nav>
<h2>How it is measured</h2>
<p>Success is given with a 95 % interval over seeds and starts: Wilson's, at the number of
independent starts that would spread the mean as the seeds and the starts together do. All other
metrics of a table are those of exact sensors. Presets:</p>
<dl>$presets</dl>
$sections
</body>
</html>
""")


def write_page(sections: Sequence[Section], file: Path) -> None:
    """Write the page, which holds its pictures and videos and needs nothing else."""
    text = _PAGE.substitute(
        contents="".join(
            f'<a href="#{escape(each.table.title)}">{escape(each.table.heading)}</a>'
            for each in sections
            if each.pictures
        ),
        presets=_definitions({each.label: each.meaning for each in PRESETS.values()}),
        sections="\n".join(map(_section, sections)),
    )
    file.write_text(text, encoding="utf-8")


def _section(section: Section) -> str:
    table = section.table
    parts = [
        f'<h2 id="{escape(table.title)}">{escape(table.heading)}</h2>',
        f'<p class="caption">{escape(table.caption)}</p>',
        f'<div class="wide">{table.html()}</div>',
        *(_figure(file, caption) for file, caption in section.pictures),
    ]
    if section.columns:
        meanings = _definitions({column.label: column.meaning for column in section.columns})
        parts.append(
            f"<details><summary>What the columns mean</summary><dl>{meanings}</dl></details>"
        )
    return "\n".join(parts)


def _figure(file: Path, caption: str) -> str:
    data = base64.b64encode(file.read_bytes()).decode()
    if file.suffix == ".mp4":
        shown = (
            f'<video controls loop muted playsinline src="data:video/mp4;base64,{data}"></video>'
        )
        replayed = file.with_suffix(".html")
        if replayed.exists():
            shown += frame_page(caption, replayed.read_text(encoding="utf-8"))
    else:
        shown = f'<img alt="{escape(caption)}" src="data:image/png;base64,{data}">'
    return f"<figure>{shown}<figcaption>{escape(caption)}</figcaption></figure>"


def _definitions(meanings: Mapping[str, str]) -> str:
    return "".join(f"<dt>{escape(k)}</dt><dd>{escape(v)}</dd>" for k, v in meanings.items())


def evaluate_run(
    run: Path, task: str | None, workers: Workers, console: Console
) -> dict[str, dict[str, Any]]:
    """Compare the policies of a run with the fixed layout, of streams with the scheduler or rule.

    table.md, the trajectories of Sort and a video go into the run's folder, the same byte for byte
    each time.
    """
    of_streams = stream_task(run)
    if of_streams in ON_SLOPES:
        files = {seed: library.read_files(each) for seed, each in policy_folders(run).items()}
        results = compare_run(of_streams, files, run, workers, console)
    elif of_streams is not None:
        found = compare_streams(run, workers, console)
        results = {
            preset: {case.label: _stream_card(found, case) for case in streams.cases(preset)}
            for preset in STREAM_PRESETS
        }
    else:
        results = _parcel_run(of_run(run, task), run, workers, console)
    console.print(f"everything is in {run}")
    return results


def _parcel_run(
    agent: Method, folder: Path, workers: Workers, console: Console
) -> dict[str, dict[str, Any]]:
    both = [each.under(*COMPARED) for each in (rules(agent.task)[0], agent)]
    with show_progress(console, "comparing with the fixed layout") as advance:
        results = compute_results(both, workers, advance=advance)
        advance(len(results), len(results), "drawing and filming")
        write_trajectories(both, folder / "trajectories.png")
        file, caption = write_example(both, folder)
    summaries = summarise(results)
    tables = [texts.task_table(agent.task, summaries), *speed_tables(agent.task, summaries)]
    for table in tables:
        table.show(console)
    texts.write_markdown(tables, folder / TABLE)
    console.print(f"{file.name}: {caption}")
    return {preset: _card_results(summaries, agent, preset) for preset in COMPARED}


def _card_results(summaries: Summaries, agent: Method, preset: str) -> dict[str, Any]:
    summary = summaries[agent.task, agent.name, preset]
    fixed = summaries[agent.task, FIXED, preset]
    low, high = summary.interval
    values = {c.name: summary.value(c, fixed) for c in find_benchmark(agent.task).columns}
    return {
        "success": round(summary.rate, 4),
        "interval": [round(low, 4), round(high, 4)],
        "success_of_each_seed": [round(float(each.mean()), 4) for each in summary.success],
        **{name: round(value, 5) for name, value in values.items() if not math.isnan(value)},
    }


def stream_task(run: Path) -> str | None:
    """Find the task on streams that the first policy of a run is for; a damaged one has none."""
    folder = next(iter(policy_folders(run).values()))
    try:
        wanted = read_yaml(folder / library.CARD)["env_id"]
    except (OSError, ValueError, KeyError):
        return None
    return next((each for each in (FLOW_TASK, *ON_SLOPES) if env_id(each) == wanted), None)


def compare_streams(run: Path, workers: Workers, console: Console) -> StreamResults:
    """Measure the policies of a run on streams, into the run's folder."""
    scheduler = next(each for each in streams.stream_methods() if each.name == MODULES)
    files = {seed: library.read_files(each) for seed, each in policy_folders(run).items()}
    period = library.from_files(next(iter(files.values()))).card.control_period
    methods = [
        scheduler,
        *(
            streams.learned_method(f"seed {k}", period, partial(_read, each))
            for k, each in files.items()
        ),
    ]
    results = StreamResults(tuple(streams.compute_streams(methods, workers)))
    tables = streams.stream_tables(results)
    texts.write_markdown(tables, run / TABLE)
    for table in tables:
        table.show(console)
    return results


def _read(files: library.PolicyFiles, config: EnvConfig) -> Controller:
    return library.from_files(files, config=config)


def _stream_card(results: StreamResults, case: Case) -> dict[str, Any]:
    names = [name for name in results.names if name != MODULES]
    found = [row for name in names if (row := results.find(name, case)) is not None]
    return {
        "capacity_of_each_seed": [
            0 if row.capacity is None else round(row.capacity.rate) for row in found
        ],
        "scheduler": round(results.rate(MODULES, case)),
        "share_right": [
            None if row.capacity is None else round(row.capacity.share_right, 5) for row in found
        ],
    }
