"""Rows of the table of results made by hand."""

from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np
import pandas as pd

from surface_gym.agents.evaluation import streams as ladder
from surface_gym.agents.evaluation.method import start_benchmark, stream_benchmark
from surface_gym.agents.evaluation.results import Results, make_rows
from surface_gym.agents.evaluation.scenario import (
    FACTORS,
    LAB,
    SHAPES,
    STARTS,
    Level,
    scenario_name,
)
from surface_gym.tasks.benchmark import PARCELS

COUNT = 24  # starts of the sweep
# Of what the entrance takes.
SHARES = {
    ladder.ARRANGED: 0.0, ladder.SERIES: 0.0, ladder.COLUMNS: 0.4, ladder.MODULES: 0.6,
    ladder.EVENT: 0.6,
}  # fmt: skip
HARDWARE = {  # actuators, and the columns and modules of one
    ladder.ARRANGED: (0, 0, 1), ladder.SERIES: (8, 7, 28), ladder.COLUMNS: (55, 1, 4),
    ladder.MODULES: (220, 0, 1), ladder.EVENT: (220, 0, 1),
}  # fmt: skip
CEILINGS = (13333.3, 20000.0, 26666.7, 9729.7, 14594.6, 19459.4)  # of the streams of Flow
GRID: Any = start_benchmark("sort").grid


def rows(*of_seed: Any, **columns: Any) -> pd.DataFrame:
    return make_rows(_describe_rows(*of_seed, **columns))


def _describe_rows(
    key: tuple[str, str, str, str], seed: int = 0, kind: str = "rule", **columns: Any
) -> list[dict[str, Any]]:
    """Rows of a seed of a method; a column is a number or one for each episode."""
    count = max(len(each) for each in columns.values() if isinstance(each, Sequence))
    names = dict(zip(("task", "scenario", "preset", "method"), key, strict=True))
    of_each = {
        name: each if isinstance(each, Sequence) and not isinstance(each, str) else [each] * count
        for name, each in columns.items()
    }
    return [
        {**names, "seed": seed, "kind": kind, "episode": k}
        | {name: values[k] for name, values in of_each.items()}
        for k in range(count)
    ]


def results(*tables: pd.DataFrame) -> Results:
    return Results(pd.concat(tables, ignore_index=True))


def sort_rows(
    name: str, least: dict[str, float], time: float = 1.0, seed: int = 0, preset: str = "exact"
) -> pd.DataFrame:
    """One that sorts from a speed on, by parcel, in a time over the speed."""
    sorts = np.zeros(GRID.shape, bool)
    for k, parcel in enumerate(PARCELS):
        sorts[k] = (least[parcel] - 1e-9 <= GRID.speeds)[:, np.newaxis]
    times = np.broadcast_to((time / GRID.speeds)[:, np.newaxis], GRID.shape)
    return rows(
        ("sort", STARTS, preset, name), seed, success=sorts.ravel().tolist(),
        time=times.ravel().tolist(), columns=4, decision_time=1e-5,
    )  # fmt: skip


def slow_rows(
    name: str, errors: Sequence[float], seed: int = 0, preset: str = "exact", kind: str = "rule"
) -> pd.DataFrame:
    """One that leaves at errors of the ratio."""
    success = [abs(error) <= 0.01 for error in errors]
    return rows(
        ("slow", STARTS, preset, name), seed, kind, success=success, time=1.0,
        ratio_error=list(errors), decision_time=2e-5,
    )  # fmt: skip


def sweep_rows(
    task: str, name: str, factor: str, share: float, seed: int = 0,
    levels: Sequence[Level] | None = None, starts: int = COUNT, kind: str = "rule",
) -> pd.DataFrame:  # fmt: skip
    """One whose first starts succeed, a share at the first level and less at each that follows."""
    chosen = list(FACTORS[factor].swept if levels is None else levels)
    counts = np.linspace(share * starts, 0.5 * share * starts, len(chosen)).round().astype(int)
    shapes = {"shape": [SHAPES[k % 3] for k in range(starts)]} if factor == LAB else {}
    described = [
        _describe_rows(
            (task, scenario_name(factor, level), _preset(factor, level), name), seed, kind,
            success=[k < count for k in range(starts)], **shapes,
        )
        for level, count in zip(chosen, counts.tolist(), strict=True)
    ]  # fmt: skip
    return make_rows(list(chain.from_iterable(described)))


def _preset(factor: str, level: Level) -> str:
    return FACTORS[factor].change(level).preset.name


def whole_sweep(task: str, shares: dict[str, float], seeds: int = 1) -> list[pd.DataFrame]:
    """Rows of methods by their success, all factors of the task."""
    return [
        sweep_rows(task, name, factor.name, share, seed)
        for name, share in shares.items()
        for factor in FACTORS.values()
        for seed in range(seeds)
        if not (factor.of_lines and task in ("track", "park"))
    ]


def stream_rows(
    key: tuple[str, str, str, str], correct: Sequence[float], seed: int = 0, kind: str = "rule",
    **more: Any,
) -> pd.DataFrame:  # fmt: skip
    """Replications of 36 s in which so many leave rightly, and nothing else."""
    usual = {
        "delivered": list(correct), "offered": 3000.0, "counted": 36.0, "jam": 0, "turns": 8,
        "sorted": 1, "touches_per_1000": 0.0, "waiting_mean": 0.25, "bound": 4000.0,
    }  # fmt: skip
    return rows(key, seed, kind, correct=list(correct), **(usual | more))


def capacity_rows(shares: dict[str, float] = SHARES) -> list[pd.DataFrame]:
    """One zone cannot sort, zones in series sustain nothing, the others sustain a share: ten
    replications at about a rate, a parcel more or less, with eight turns a parcel.
    """
    made = []
    offers = [each for each in stream_benchmark("flow").offers if each.group == "sides"]
    for name, share in shares.items():
        fixed = dict(zip(("actuators", "columns", "modules"), HARDWARE[name], strict=True))
        for preset in ("exact", "camera"):
            for offer, ceiling in zip(offers, CEILINGS, strict=True):
                count = round(share * ceiling * 20.0 / 3600.0)
                correct = [count + (-1) ** k if share else np.nan for k in range(10)]
                best = 1.1 * share * ceiling if name == ladder.MODULES else np.nan
                turns = [8 * each for each in correct]
                made.append(
                    stream_rows(
                        ("flow", offer.scenario, preset, name), correct, counted=20.0, turns=turns,
                        sorted=correct, touches_per_1000=[1000.0 / max(1, n) for n in correct],
                        bound=ceiling, best=best, offered=share * ceiling, **fixed,
                    )
                )  # fmt: skip
    return made
