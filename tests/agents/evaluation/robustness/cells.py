"""Cells of the sweep made by hand."""

from collections.abc import Sequence

import numpy as np

from agents.evaluation.robustness.factors import FACTORS, Factor, Level
from agents.evaluation.robustness.sweep import SweptCell

STARTS = 24


def swept_cell(
    task: str,
    who: str,
    factor: Factor,
    share: float,
    seed: int = 0,
    levels: Sequence[Level] | None = None,
    starts: int = STARTS,
) -> SweptCell:
    """One whose first starts succeed, a share at the first level and less at each that follows."""
    chosen = list(factor.swept if levels is None else levels)
    counts = np.linspace(share * starts, 0.5 * share * starts, len(chosen)).round().astype(int)
    success = ["1" * count + "0" * (starts - count) for count in counts.tolist()]
    return SweptCell(task, who, factor.name, seed, starts, chosen, success, [0.01] * len(chosen))


def swept_cells(task: str, shares: dict[str, float], seeds: int = 1) -> list[SweptCell]:
    """Of contenders by how well they do, all factors of the task."""
    return [
        swept_cell(task, who, factor, share, seed)
        for who, share in shares.items()
        for factor in FACTORS.values()
        for seed in range(seeds)
        if not (factor.of_lines and task == "track")
    ]
