"""A reproduction as JSON."""

import json
from dataclasses import asdict
from typing import Any

from surface_gym.paper.comparison import Table
from surface_gym.paper.framing import NAMES
from surface_gym.paper.integration import INTEGRATIONS
from surface_gym.paper.reproduction import Reproduction
from surface_gym.paper.targets import load_targets


def to_json(reproduction: Reproduction) -> str:
    """Every number, unrounded; `ours` are in the order of `integrations`."""
    targets = load_targets()
    report = {
        "source": targets.source,
        "integrations": [
            {"name": name, **asdict(integration)}
            for name, integration in zip(NAMES, INTEGRATIONS, strict=True)
        ],
        "step": "The paper prints none; that it took about 5 ms is inferred.",
        "tipping": "Share of the steps up to a value in which Eq. (1) has no solution. Taken "
        "instead: the forces that bear the weight and come nearest to the moments.",
        "tables": {table.key: _table(table) for table in reproduction.tables},
        "sorting_rates": {
            "unit": "pcs/h",
            "medium": targets.medium_rates,
            "by_speed": [asdict(case) for case in reproduction.sorted_by_speed],
            "by_tilt": [asdict(case) for case in reproduction.sorted_by_tilt],
        },
        "near_the_limit": [asdict(spread) for spread in reproduction.near_the_limit],
        "about_coarse_step": asdict(reproduction.about_coarse),
        "last_digits_of_axes": asdict(reproduction.last_digits),
        "agreeing_by_step": [asdict(each) for each in reproduction.by_step],
        "self_stopping": [asdict(each) for each in reproduction.self_stopping],
        "alignment": [asdict(each) for each in reproduction.alignment],
    }
    return json.dumps(report, indent=2) + "\n"


def _table(table: Table) -> dict[str, Any]:
    count = len(INTEGRATIONS)
    return {
        "title": table.title,
        "rule": table.rule,
        "cells": [
            {**asdict(cell), "agrees": [cell.agrees(k) for k in range(count)]}
            for cell in table.cells
        ],
        "agreeing": [table.agreeing(k) for k in range(count)],
        "of": len(table.cells),
        "tipping": [table.tipping(k) for k in range(count)],
    }
