"""A reproduction as JSON."""

import json
from dataclasses import asdict
from typing import Any

from surface_gym.paper.comparison import Table
from surface_gym.paper.integration import CONVERGED, PAPER_STEP
from surface_gym.paper.reproduction import Reproduction
from surface_gym.paper.targets import load_targets


def to_json(reproduction: Reproduction) -> str:
    """Every number, unrounded."""
    targets = load_targets()
    report = {
        "source": targets.source,
        "paper_step": asdict(PAPER_STEP),
        "converged": asdict(CONVERGED),
        "tables": {table.key: _table(table) for table in reproduction.tables},
        "sorting_rates": {
            "unit": "pcs/h",
            "medium": targets.medium_rates,
            "by_speed": [asdict(case) for case in reproduction.sorted_by_speed],
            "by_tilt": [asdict(case) for case in reproduction.sorted_by_tilt],
        },
        "near_the_limit": [asdict(spread) for spread in reproduction.near_the_limit],
        "about_paper_step": asdict(reproduction.about_paper_step),
    }
    return json.dumps(report, indent=2) + "\n"


def _table(table: Table) -> dict[str, Any]:
    return {
        "title": table.title,
        "rule": table.rule,
        "agree": {
            "cells": len(table.cells),
            "paper_step": table.paper_step_agreeing,
            "converged": table.converged_agreeing,
        },
        "cells": [
            {
                **asdict(cell),
                "paper_step_agrees": cell.paper_step_agrees,
                "converged_agrees": cell.converged_agrees,
            }
            for cell in table.cells
        ],
    }
