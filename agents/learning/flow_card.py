"""The card of an agent of a flow: the command that trains it, and what came of it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml

from ..flow.cases import CONDITIONS, Case, cases
from ..flow.contenders import RESERVATION
from ..flow.results import Results
from ..flow.study import FlowCell
from .card import FILE, command_of
from .config import TrainConfig
from .legs import Learned


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
