"""Report of a comparison: a folder with tables, plots, videos and a page."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from gymnasium.utils.seeding import np_random
from rich.console import Console

from surface_gym.config import PRESETS

from .. import library
from . import pictures, views
from .method import (
    Method,
    all_methods,
    find_benchmark,
    is_on_streams,
    of_runs,
    rivals,
    start_benchmark,
    stream_benchmark,
)
from .pictures import Player, write_comparison
from .results import Results
from .scenario import (
    SEED,
    WHOLE,
    Extent,
    Scenario,
    ScenarioJob,
    StartScenario,
    changed_scenarios,
    make_jobs,
    start_scenarios,
)
from .streams import ON_FILM, StreamScenario, stream_scenarios, unseen_jobs
from .tables import Pictures, Section, show_tables, write_markdown, write_page

NEAR = 0.95  # [-] of the modules' capacity, at which the video shows all rungs
FILMED = ("exact", "lab")  # presets of films on streams
SWEEP_TITLE = "# Robustness\n\nSuccess where one thing at a time differs from training.\n\n"

Advance = Callable[[str], None]  # called with the current part


@dataclass(frozen=True)
class Selection:
    """Tasks, streams and policies of a comparison, and limits on the comparison's size."""

    tasks: tuple[str, ...]
    groups: tuple[str, ...] = ()  # groups of offered streams; empty: the first of each task
    runs: Path | None = None  # folder of runs with additional policies
    extent: Extent = WHOLE

    def methods(self, task: str) -> list[Method]:
        """List the methods of a task."""
        known = all_methods(task)
        names = {each.name for each in known}
        found = [] if self.runs is None else of_runs(task, self.runs)
        return [*known, *(each for each in found if each.name not in names)]

    def jobs(self) -> list[ScenarioJob]:
        """List the jobs of the comparison, streams first."""
        jobs = []
        for task in sorted(self.tasks, key=lambda each: not is_on_streams(each)):
            scenarios: Sequence[Scenario] = (
                stream_scenarios(task, self.extent, self.groups)
                if is_on_streams(task)
                else start_scenarios(task, self.extent)
            )
            jobs += make_jobs(scenarios, self.methods(task))
        return jobs

    def sweep_jobs(self) -> list[ScenarioJob]:
        """List the jobs of the robustness study.

        If a task has one parcel, each job changes one quantity, e.g. the size of parcels. If a task
        has streams, each job has a stream that no agent was trained on.
        """
        jobs = []
        for task in self.tasks:
            if is_on_streams(task):
                jobs += unseen_jobs(task, self.extent)
            else:
                jobs += make_jobs(changed_scenarios(task, self.extent), self.methods(task))
        return jobs


def write_report(
    selection: Selection, table: pd.DataFrame, folder: Path, console: Console, advance: Advance,
    note: str = "",
) -> None:  # fmt: skip
    """Write a comparison to a folder, and print its tables.

    Args:
        table: rows of the results.
        advance: called with a text that names the part of the report that is drawn next.
        note: remark at the head of the page and of the tables.
    """
    results, head = Results(table), f"{note}\n\n" if note else ""
    sections: list[Section] = []
    single = [task for task in selection.tasks if not is_on_streams(task)]
    tasks = sorted(selection.tasks, key=single.__contains__)
    for task in tasks:
        advance(f"drawing {task}")
        made, methods = views.make_tables(task, results), selection.methods(task)
        if task in single:
            drawn = _draw_starts(methods, folder)
        else:
            drawn = _draw_streams(task, methods, results, folder, selection.extent)
        write_markdown(made, folder / f"{library.task_label(task)}.md", head)
        sections += [
            Section(each, [] if k else drawn, () if k else find_benchmark(task).columns)
            for k, each in enumerate(made)
        ]
    show_tables([each.table for each in sections], console, note)
    write_page(sections, folder / "report.html", note)


def write_sweep(
    selection: Selection, table: pd.DataFrame, folder: Path, console: Console, note: str = ""
) -> None:
    """Write the robustness study's tables and figure to a folder, and print the tables.

    `table` has the rows of the results, and `note` is a remark for readers.
    """
    results, head = Results(table), f"{note}\n\n" if note else ""
    single = [task for task in selection.tasks if not is_on_streams(task)]
    tables = [each for task in single for each in views.sweep_tables(task, results)]
    others = (task for task in selection.tasks if task not in single)
    unseen = [each for task in others for each in views.unseen_tables(task, results)]
    if tables:
        write_markdown(tables, folder / "robustness.md", SWEEP_TITLE + head)
        pictures.draw_sweep(single, results, folder / "robustness.png")
    if unseen:
        write_markdown(unseen, folder / "generalisation.md", head)
    show_tables([*unseen, *tables], console, note)


def _draw_starts(methods: Sequence[Method], folder: Path) -> Pictures:
    task, both, drawn = methods[0].task, rivals(methods), []
    if start_benchmark(task).grid is not None:
        file = folder / f"{library.task_label(task)}-trajectories.png"
        write_trajectories(both, file)
        drawn.append((file, "Trajectories by entry speed; dotted where it is not sorted."))
    return [*drawn, write_example(both, folder)]


def write_trajectories(methods: Sequence[Method], file: Path) -> None:
    """Draw the methods' trajectories at several entry speeds, if the task has a grid of starts."""
    grid = start_benchmark(methods[0].task).grid
    if grid is not None:
        exact = StartScenario(methods[0].task, "exact", WHOLE)
        episodes = {each.name: exact.run(each, each.seeds[0])[0] for each in methods}
        pictures.draw_trajectories(grid, episodes, file)


def start_player(method: Method, rng: np.random.Generator) -> Player:
    """Return the `Player` of a method's first seed, on the example start of the method's task."""
    compared = start_benchmark(method.task)
    config = method.config(compared.task, PRESETS["exact"])
    controller = method.controller(config, method.seeds[0])
    return Player(method.name, controller, config, rng, compared.example)


def write_example(methods: Sequence[Method], folder: Path) -> tuple[Path, str]:
    """Film a task's methods side by side on the task's example start; return file and caption."""
    task = methods[0].task
    players = [start_player(method, np_random(SEED)[0]) for method in methods]
    file = folder / f"{library.task_label(task)}.mp4"
    outcomes = ", ".join(
        f"{player.name} {'succeeds' if success else 'fails'}"
        for player, success in zip(players, write_comparison(players, file), strict=True)
    )
    return file, f"{start_benchmark(task).example_description}: {outcomes}"


def filmed_scenario(
    task: str, preset: str = "exact", group: str | None = None, extent: Extent = WHOLE
) -> StreamScenario:
    """Return the example stream of a task under a preset.

    If `group` does not contain the example, return the first stream of the group.
    """
    benchmark = stream_benchmark(task)
    offers = [each for each in benchmark.offers if group in (None, each.group)]
    named = [each for each in offers if each.name == benchmark.filmed]
    return StreamScenario(task, preset, extent, (named or offers)[0].scenario)


def stream_player(method: Method, scenario: StreamScenario, rate: float | None = None) -> Player:
    """Return the `Player` of a method's first seed, on the first replication of a stream.

    `rate` [parcels/h] is the rate of arrivals. If `rate` is None, the method
    `StreamScenario.config` chooses the rate.
    """
    config = scenario.config(method, rate)
    controller = method.controller(config, method.seeds[0])
    if controller is None:
        raise ValueError(f"method must be able to sort {scenario.name}, got {method.name!r}")
    return Player(method.name, controller, config, np.random.default_rng((SEED, 0)))


def _draw_streams(
    task: str, methods: Sequence[Method], results: Results, folder: Path, extent: Extent
) -> Pictures:
    found = views.list_capacities(task, results)
    label, drawn = library.task_label(task), []
    if found:
        first, file = found[0], folder / f"{label}-capacity.png"
        pictures.draw_capacities(first, file)
        exits = f"exits “{first.group}”"
        drawn.append((file, f"Capacity by stream, {exits}, exact sensors, 95 % intervals."))
        scenario = filmed_scenario(task, group=first.group, extent=extent)
        name = scenario.offer.name
        shown = [
            each for each in methods if each.name in ON_FILM and first.throughput(each.name, name)
        ]
        shown = shown[-(extent.rungs or len(shown)) :]
        if not shown:
            return drawn
        rate = NEAR * first.throughput(shown[-1].name, name)
        said = f"{name}, {exits}, {rate:.0f} parcels an hour offered"
        return [*drawn, _film(shown, scenario, rate, folder / f"{label}.mp4", said)]
    for preset in FILMED:
        scenario = filmed_scenario(task, preset, extent=extent)
        if preset in (extent.presets or scenario.benchmark.presets):
            said = f"{scenario.offer.name}, {preset}"
            file = folder / f"{label}-{preset}.mp4"
            drawn.append(_film(rivals(methods), scenario, None, file, said))
    return drawn


def _film(
    methods: Sequence[Method], scenario: StreamScenario, rate: float | None, file: Path, said: str
) -> tuple[Path, str]:
    """Record methods side by side on one stream; return file and caption.

    `rate` is as for `stream_player`. The caption names the methods, and ends with the text `said`.
    """
    players = [stream_player(each, scenario, rate) for each in methods]
    write_comparison(players, file, scenario.extent.film)
    return file, f"{' and '.join(each.name for each in methods)}: {said}."
