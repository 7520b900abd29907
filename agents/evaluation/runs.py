"""The comparison of a training run's policies, into the run's folder and for its card."""

import math
from functools import partial
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console

from surface_gym.config import EnvConfig
from surface_gym.parallel import Workers
from surface_gym.registration import FLOW

from .. import library
from ..base import Controller
from ..library import CARD, PolicyFiles, read_files
from .benchmark import Summaries, compute_results, find_benchmark, summarise
from .capacity import STREAM_PRESETS, Case, StreamMethod
from .methods import FIXED, Method, of_run, policy_folders, rules
from .report import speed_tables, write_example, write_trajectories
from .streams import (
    RESERVATION,
    StreamResults,
    capacity_table,
    cases,
    compute_streams,
    eased_table,
    stream_methods,
)
from .tables import task_table, write_markdown

TABLE = "table.md"
COMPARED = ("exact", "camera", "lab")  # presets under which a run's policies are compared


def evaluate_run(
    run: Path, task: str | None, workers: Workers, console: Console
) -> dict[str, dict[str, Any]]:
    """Compare the policies of a run with the fixed layout, of streams with the reservation.

    table.md, the trajectories of Sort and a video go into the run's folder, the same byte for byte
    each time.

    Returns:
        The results that stand on an agent's card, by preset.
    """
    if is_of_streams(run):
        results = _stream_run(run, workers, console)
    else:
        results = _parcel_run(of_run(run, task), run, workers, console)
    console.print(f"everything is in {run}")
    return results


def _parcel_run(
    agent: Method, folder: Path, workers: Workers, console: Console
) -> dict[str, dict[str, Any]]:
    both = [each.under(*COMPARED) for each in (rules(agent.task)[0], agent)]
    summaries = summarise(compute_results(both, workers))
    tables = [task_table(agent.task, summaries), *speed_tables(agent.task, summaries)]
    write_trajectories(both, folder / "trajectories.png")
    for table in tables:
        table.show(console)
    write_markdown(tables, folder / TABLE)
    file, caption = write_example(both, folder)
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


def is_of_streams(run: Path) -> bool:
    """Check whether the first policy of a run is for streams; a damaged one is not."""
    folder = next(iter(policy_folders(run).values()))
    try:
        return bool(yaml.safe_load((folder / CARD).read_text())["env_id"] == FLOW)
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError):
        return False


def compare_streams(run: Path, workers: Workers, console: Console) -> StreamResults:
    """Measure the policies of a run on streams, into the run's folder."""
    reservation = next(each for each in stream_methods() if each.name == RESERVATION)
    methods = [reservation, *_of_seeds(policy_folders(run))]
    results = StreamResults.of(methods, compute_streams(methods, workers, loads=()))
    tables = [
        make(results, preset) for preset in STREAM_PRESETS for make in (capacity_table, eased_table)
    ]
    write_markdown(tables, run / TABLE)
    for table in tables:
        table.show(console)
    return results


def _of_seeds(folders: dict[int, Path]) -> list[StreamMethod]:
    files = {seed: read_files(folder) for seed, folder in folders.items()}
    period = library.from_files(next(iter(files.values()))).card.control_period
    return [
        StreamMethod(f"seed {seed}", "parcels", True, partial(_read, each), control_period=period)
        for seed, each in files.items()
    ]


def _read(files: PolicyFiles, config: EnvConfig) -> Controller:
    del config
    return library.from_files(files)


def _stream_run(run: Path, workers: Workers, console: Console) -> dict[str, dict[str, Any]]:
    results = compare_streams(run, workers, console)
    return {
        preset: {case.label: _stream_card(results, case) for case in cases(preset)}
        for preset in STREAM_PRESETS
    }


def _stream_card(results: StreamResults, case: Case) -> dict[str, Any]:
    names = [name for name in results.names if name != RESERVATION]
    found = [row for name in names if (row := results.find(name, case)) is not None]
    return {
        "capacity_of_each_seed": [
            0 if row.capacity is None else round(row.capacity.rate) for row in found
        ],
        "reservation": round(results.rate(RESERVATION, case)),
        "right_at_80_percent": [
            None if row.eased is None else round(row.eased.share_right, 5) for row in found
        ],
    }
