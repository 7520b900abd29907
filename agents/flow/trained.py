"""What the policies of a flow's run come to: their capacities, beside the reservation's."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import yaml
from rich.console import Console

from agents import library
from agents.controller import Controller
from agents.evaluation.contenders import policies_of
from agents.evaluation.table import markdown, print_table
from agents.evaluation.work import compute_kept
from agents.flow.cases import CONDITIONS, Case, cases
from agents.flow.contenders import RESERVATION, FlowContender, contenders
from agents.flow.results import Results, results_of
from agents.flow.study import SEARCHED, FlowCell, flow_cell, flow_jobs
from agents.flow.tables import capacities, eased
from agents.learning.card import FILE, command_of
from agents.learning.config import TrainConfig
from agents.learning.legs import Learned
from surface_gym.flow.settings import FlowSettings

TABLE = "table.md"


def compare_parcels(run: Path, workers: int, console: Console) -> Results:
    """Measure the policies of a run, into the run's folder.

    Raises:
        ValueError: the folder holds no policy, or a damaged one.
    """
    reservation = next(each for each in contenders() if each.name == RESERVATION)
    who = [reservation, *_of_seeds(policies_of(run))]
    jobs = {key: job for key, job in flow_jobs(who).items() if key[-1] == SEARCHED}
    found = compute_kept(jobs, flow_cell, workers, None, lambda *_: None)
    results = results_of(who, [found[key] for key in sorted(found)])
    tables = [kind(results, name) for name in CONDITIONS for kind in (capacities, eased)]
    (run / TABLE).write_text("\n".join(map(markdown, tables)))
    for table in tables:
        print_table(table, console)
    console.print(f"everything is in {run}")
    return results


def _of_seeds(folders: dict[int, Path]) -> list[FlowContender]:
    period = library.read(next(iter(folders.values()))).card.control_period
    return [
        FlowContender(
            f"seed {seed}", "parcels", True, partial(_read, folder), control_period=period
        )
        for seed, folder in folders.items()
    ]


def _read(folder: Path, settings: FlowSettings) -> Controller:
    del settings
    return library.read(folder)


def write_flow_card(
    config: TrainConfig, learned: Sequence[Learned], results: Results, folder: Path
) -> None:
    """Write card.yaml into a run's folder: the command, and what came of each seed."""
    card = {
        "command": command_of(config),
        "seeds": list(range(config.seed, config.seed + config.seeds)),
        "steps": [each.steps for each in learned],
        "seconds": [round(each.seconds) for each in learned],  # of each seed, on one core
        "results": {condition: _results(results, condition) for condition in CONDITIONS},
    }
    (folder / FILE).write_text(yaml.safe_dump(card, sort_keys=False))


def _results(results: Results, condition: str) -> dict[str, Any]:
    return {case.label: _figures(results, case) for case in cases(condition)}


def _figures(results: Results, case: Case) -> dict[str, Any]:
    found: list[FlowCell] = []
    for name in results.names:
        cell = results.cell(name, case)
        if name != RESERVATION and cell is not None:
            found.append(cell)
    return {
        "capacity_of_each_seed": [
            0 if cell.capacity is None else round(cell.capacity.rate) for cell in found
        ],
        "reservation": round(results.rate(RESERVATION, case)),
        "right_at_80_percent": [
            None if cell.eased is None else round(cell.eased.share_right, 5) for cell in found
        ],
    }
