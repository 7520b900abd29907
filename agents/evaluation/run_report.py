"""Report of a run: its policies compared with the fixed layout, or with a scheduler or rules.

Libraries of pictures are imported by the process that draws. `train.py` would otherwise wait for
them after training.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from surface_gym.executors import Processes
from surface_gym.machine.estimate import Estimate
from surface_gym.parallel import Workers, map_jobs, without_report

from ..learning.runs import ESTIMATE
from . import views
from .method import (
    AGENT,
    FIXED,
    RULE,
    Method,
    all_methods,
    is_on_streams,
    of_run,
    rules,
    shipped,
    start_benchmark,
    stream_benchmark,
)
from .results import Results, Sample, compute, show_progress
from .scenario import STARTS, make_jobs, start_scenarios
from .streams import MODULES, stream_scenarios
from .tables import show_tables, write_markdown

TABLE = "table.md"  # table of a run
COMPARED = ("exact", "camera", "lab")  # presets for a run's policies


def evaluate_run(
    run: Path, task: str | None, workers: Workers, console: Console
) -> dict[str, dict[str, Any]]:
    """Compare a run's policies with the fixed layout or, on streams, with a scheduler or rules.

    `run` is the run's folder. The argument `task` is as in the function `method.trained`.
    Write table.md to the folder. For a task of one parcel, also write pictures and a video.
    A second call writes the same bytes. Return the results for the run's card.
    """
    agent = of_run(run, task)
    streams = is_on_streams(agent.task)
    scenarios, methods = (_stream_rivals if streams else partial(_start_rivals, run))(agent)
    jobs = make_jobs(scenarios, methods)
    with show_progress(console, f"comparing on {agent.task}", len(jobs)) as advance:
        results = Results(compute(jobs, workers, advance=advance))
    tables = views.make_tables(agent.task, results)
    write_markdown(tables, run / TABLE)
    show_tables(tables, console, "")
    if not streams:
        with console.status("drawing and filming"):
            both = [methods[0], methods[-1]]
            drawn: list[Callable[[], Any]] = [partial(_draw, both, run), partial(_film, both, run)]
            # Processes that begin now would load for longer than drawing takes.
            ready = workers if isinstance(workers, Processes) else 1
            drawn_at = dict(map_jobs([partial(without_report, each) for each in drawn], ready))
            file, caption = drawn_at[1]
        console.print(f"{file.name}: {caption}")
    console.print(f"everything is in {run}")
    if not streams:
        return {preset: _start_card(results, agent, preset) for preset in COMPARED}
    card: dict[str, dict[str, Any]] = {}
    for each in scenarios:
        offer, samples = each.offer, results.at(agent.task, each.name, each.preset)
        made = _stream_card(samples) if offer.rates else _capacity_card(samples)
        card.setdefault(each.preset, {})[offer.name] = made
    return card


def _draw(methods: Sequence[Method], run: Path) -> None:
    from .report import write_trajectories

    write_trajectories(methods, run / "trajectories.png")


def _film(methods: Sequence[Method], run: Path) -> tuple[Path, str]:
    from .report import write_example

    return write_example(methods, run)


def _start_rivals(run: Path, agent: Method) -> tuple[list[Any], list[Method]]:
    """List the scenarios and the methods for a comparison with the agent of a run.

    The first method is the fixed layout, and the last method is the agent. If the agent was trained
    on an identified surface, shipped agents are compared, too.
    """
    others, estimate = [rules(agent.task)[0]], None
    if (run / ESTIMATE).is_file():
        estimate = Estimate.load(run / ESTIMATE)
        others += shipped(agent.task)
    methods = [replace(each.under(*COMPARED), estimate=estimate) for each in (*others, agent)]
    return start_scenarios(agent.task), methods


def _stream_rivals(agent: Method) -> tuple[list[Any], list[Method]]:
    """List the scenarios and the methods for comparing an agent on streams.

    If the benchmark's streams have no given arrival rates, each method's capacity is searched. Then
    the methods are the scheduler and each seed of the agent. Otherwise the methods are the rules
    and the agent.
    """
    known = all_methods(agent.task)
    rivals = [*(each for each in known if each.kind == RULE), agent]
    if not stream_benchmark(agent.task).offers[0].rates:
        rivals = [each for each in known if each.name == MODULES]
        rivals += [replace(agent, name=f"seed {seed}", seeds=(seed,)) for seed in agent.seeds]
    scenarios = stream_scenarios(agent.task)
    return [each for each in scenarios if AGENT in each.offer.kinds], rivals


def _start_card(results: Results, agent: Method, preset: str) -> dict[str, Any]:
    sample, fixed = (
        results.samples[agent.task, STARTS, preset, name] for name in (agent.name, FIXED)
    )
    columns = start_benchmark(agent.task).columns
    values = {each.name: views.column_value(each, sample, fixed) for each in columns}
    return {
        "success": round(sample.rate, 4),
        "interval": [round(each, 4) for each in sample.interval],
        "success_of_each_seed": [round(float(each.mean()), 4) for each in sample.success],
        **{name: round(value, 5) for name, value in values.items() if not math.isnan(value)},
    }


def _capacity_card(samples: dict[str, Sample]) -> dict[str, Any]:
    seeds = [sample for name, sample in samples.items() if name != MODULES]
    return {
        "capacity_of_each_seed": [round(each.throughput) for each in seeds],
        "scheduler": round(samples[MODULES].throughput),
        "share_right": [
            round(each.share_correct, 5) if each.is_sustained else None for each in seeds
        ],
    }


def _stream_card(samples: dict[str, Sample]) -> dict[str, Any]:
    (learned,) = (each for each in samples.values() if each.kind == AGENT)
    gaps = learned.mean("correct_gaps")
    return {
        "right_an_hour_of_each_seed": [round(each) for each in learned.of_seeds.mean(axis=1)],
        "share_right": round(learned.share_correct, 4),
        **({} if math.isnan(gaps) else {"share_of_right_gaps": round(gaps, 4)}),
        "jams": round(learned.jams, 2),
        "rules": {
            name: round(each.throughput) for name, each in samples.items() if each.kind == RULE
        },
    }
