"""Tables, pictures and films of material flow on a slope, and the comparison of a run."""

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import imageio.v2 as imageio
import numpy as np
from rich.console import Console

from surface_gym.parallel import Workers
from surface_gym.registration import ON_SLOPES

from ..base import Numbers
from ..library import PolicyFiles
from .benchmark import SEED, half_interval
from .material_flow import (
    COMPARED,
    IN_ORDER,
    LEARNED,
    PLANNED,
    PLANNER,
    QUIET,
    RATES,
    REPLICATIONS,
    ROLL_ON,
    SECONDS,
    FlowMethod,
    MaterialFlowResult,
    compute_scenarios,
    learned_method,
    scenarios,
)
from .tables import NOTHING, Table, bold, write_markdown, write_numbers
from .video import Player, play, write_comparison

NAME = "material-flow"
TEXTS = ("scenario", "method", "preset", "rates", "of_seeds")  # of a result that are no numbers
FILMED = {  # the scenario of each task
    "singulate": "mouth of 0.6 m, 10 deg",
    "merge": "three lines",
    "sequence": "window of 4, 3000 an hour",
}
AGENTS = tuple(name for name, _ in LEARNED.values())
NO_RULES = (ROLL_ON.name, PLANNER, *AGENTS)  # methods that a card does not compare with
LENGTH = 20.0  # [s] of a film
SHOWN_AT = 10.0  # [s] since its start, of the picture


def material_flow_tables(results: Sequence[MaterialFlowResult]) -> list[Table]:
    """Show what each method delivers under each preset, a table a task."""
    tables = []
    for task in ON_SLOPES:
        names = [each.name for each in scenarios((task,))]
        rows = [each for each in results if each.scenario in names]
        if rows:
            tables.append(_table(task, rows))
    return tables


def _table(task: str, results: Sequence[MaterialFlowResult]) -> Table:
    rows = []
    for name in dict.fromkeys(each.scenario for each in results):
        here = [each for each in results if each.scenario == name]
        for preset in COMPARED:
            group = [each for each in here if each.preset == preset]
            fair = [each for each in group if each.method != PLANNER]
            best = max(fair, key=lambda each: each.rate, default=None)
            rows += [_row(each, each is best and _is_ahead(each, fair)) for each in group]
    asked = (
        f"at the rate that is named, or the highest, in steps of {RATES[1] - RATES[0]:g} an hour, "
        f"at which {100.0 * IN_ORDER:g} % of all leave rightly and none of the streams jams"
        if task == "sequence"
        else "offered more than the surface takes"
    )
    return Table(
        f"{task} on a slope",
        f"Right parcels an hour with Student's 95 % interval, over {REPLICATIONS} streams of "
        f"{SECONDS:g} s that are the same for all, {asked}: the best in bold where the paired "
        "intervals of all others lie below. Shares of right parcels, of gaps of at least 0.3 m on "
        "the take-away at 2 m/s, of aligned parcels, and of those that left beside the mouths or "
        "over the sides; touches per 1000; the largest force between two; streams that jammed, so "
        f"that nothing moved for 4 s or nothing left in the last {QUIET:g} s. "
        "Nobody exceeds the bound: there all lie with their narrowest side along the take-away. "
        f"The planner knows the true state and all that will come, plays the first {PLANNED} "
        "streams alone, and is not compared for the bold. PPO is the mean of its seeds.",
        (
            "scenario", "preset", "method", "right an hour", "right", "gaps", "aligned",
            "beside", "touches", "squeeze [N]", "time [s]", "jams", "bound",
        ),
        tuple(rows),
    )  # fmt: skip


def _is_ahead(best: MaterialFlowResult, group: Sequence[MaterialFlowResult]) -> bool:
    """Whether a method is ahead of every other beyond the interval of their differences."""
    others = [np.array(best.rates) - each.rates for each in group if each is not best]
    return bool(others) and all(apart.mean() > half_interval(apart) for apart in others)


def _row(row: MaterialFlowResult, ahead: bool) -> tuple[str, ...]:
    rates: Numbers = np.array(row.rates)
    rate = f"{row.rate:.0f} ±{half_interval(rates):.0f}"

    def share(value: float) -> str:
        return f"{100.0 * value:.2f} %" if math.isfinite(value) else NOTHING

    return (
        row.scenario, row.preset, row.method, bold(rate) if ahead else rate, share(row.right),
        share(row.right_gaps), share(row.aligned), share(row.beside),
        f"{row.touches_per_1000:.0f}", f"{row.squeeze:.0f}", f"{row.time:.1f}", f"{row.jams:.1f}",
        f"{row.bound:.0f}",
    )  # fmt: skip


def material_flow_numbers(results: Sequence[MaterialFlowResult]) -> list[dict[str, Any]]:
    """List every number, a row for each."""
    rows = []
    for row in results:
        values = {name: value for name, value in vars(row).items() if name not in TEXTS}
        seeds = {f"rate of seed {k}": rate for k, rate in enumerate(row.of_seeds)}
        values = {"rate": row.rate, "margin": half_interval(np.array(row.rates)), **seeds, **values}
        rows += [
            {
                "scenario": row.scenario, "method": row.method, "preset": row.preset,
                "metric": name, "value": value,
            }
            for name, value in values.items()
        ]  # fmt: skip
    return rows


def write_material_flow(
    results: Sequence[MaterialFlowResult], folder: Path, console: Console
) -> list[Table]:
    """Write material-flow.md, .csv and .json into a folder, and show and return the tables."""
    tables = _show(results, folder / f"{NAME}.md", console)
    numbers = material_flow_numbers(results)
    write_numbers(numbers, folder / f"{NAME}.csv", folder / f"{NAME}.json")
    return tables


def _show(results: Sequence[MaterialFlowResult], file: Path, console: Console) -> list[Table]:
    """Show the tables of results, write them into a file, and return them."""
    tables = material_flow_tables(results)
    for table in tables:
        table.show(console)
    write_markdown(tables, file)
    return tables


def film(task: str, preset: str, folder: Path) -> list[tuple[Path, str]]:
    """Film a rule and an agent of a task side by side under a preset, and draw the agent; return
    files and captions.
    """
    scenario = next(each for each in scenarios((task,)) if each.name == FILMED[task])
    shown = [
        [each for each in scenario.methods if each.name not in (PLANNER, *AGENTS)][-1],
        [each for each in scenario.methods if each.name in AGENTS][-1],
    ]
    period = scenario.config(preset, scenario.rates[0]).control_period

    def player(method: FlowMethod) -> Player:
        config = scenario.config(preset, scenario.rates[0], method)
        controller = method.make(config, method.seeds[0])
        return Player(method.name, controller, config, np.random.default_rng((SEED, 0)))

    picture, video = folder / f"{task}-{preset}.png", folder / f"{task}-{preset}.mp4"
    write_comparison([player(each) for each in shown], video, LENGTH)
    at = round(SHOWN_AT / period)
    image, _ = next(islice(play(player(shown[-1]), every=at), at, None))
    imageio.imwrite(picture, image)
    names = " and ".join(each.name for each in shown)
    where = f"{scenario.name}, {preset}"
    return [(picture, f"{shown[-1].name}: {where}."), (video, f"{names}: {where}.")]


def compare_run(
    task: str, files: dict[int, PolicyFiles], folder: Path, workers: Workers, console: Console
) -> dict[str, dict[str, Any]]:
    """Compare the policies of a run, by seed, with the rules of their task; write table.md, and
    return the results of its card.
    """
    learned = learned_method(files)
    compared = [
        replace(
            each, methods=(*(rule for rule in each.methods if rule.name not in NO_RULES), learned)
        )
        for each in scenarios((task,), learned=False)
        if len(each.rates) == 1
    ]
    results = compute_scenarios(compared, workers)
    _show(results, folder / "table.md", console)
    return make_card(results)


def make_card(results: Sequence[MaterialFlowResult]) -> dict[str, dict[str, Any]]:
    """Make the results of a card, by preset and scenario: rates of each seed, and of each rule."""
    card: dict[str, dict[str, Any]] = {preset: {} for preset in COMPARED}
    for learned in results:
        if learned.method not in AGENTS:
            continue
        rules = {
            each.method: round(each.rate)
            for each in results
            if (each.preset, each.scenario) == (learned.preset, learned.scenario)
            and each.method not in NO_RULES
        }
        card[learned.preset][learned.scenario] = {
            "right_an_hour_of_each_seed": [round(rate) for rate in learned.of_seeds],
            "share_right": round(learned.right, 4),
            "share_of_right_gaps": round(learned.right_gaps, 4),
            "jams": round(learned.jams, 2),
            "rules": rules,
        }
    return card
