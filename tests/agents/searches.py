"""A small search, and a trial of it that only computes."""

import time
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from optuna.distributions import FloatDistribution, IntDistribution
from optuna.trial import FrozenTrial, TrialState
from rich.console import Console
from sqlalchemy import Engine, event

from surface_gym.agents import tuning
from surface_gym.agents.tuning import SearchConfig, TrialResult, make_choices
from surface_gym.executors import Report
from surface_gym.parallel import Workers


@event.listens_for(Engine, "connect")
def _write_soon(connection: Any, _: Any) -> None:
    """Wait for no disk: a process that is killed loses nothing."""
    connection.execute("PRAGMA synchronous = OFF")


QUIET = Console(quiet=True)
SMALL = SearchConfig(
    task="slow", trials=14, steps=40_000, evaluations=3, seed=2, startup_trials=4,
    space={
        "learning_rate": FloatDistribution(1e-4, 1e-2, log=True), "n_epochs": IntDistribution(1, 9),
        "hidden": make_choices([[8], [8, 8]]),
    },
)  # fmt: skip


def cheap_trial(
    sweep: SearchConfig, params: dict[str, Any], past: tuple[FrozenTrial, ...], report: Report,
    seconds: float = 0.0,
) -> TrialResult:  # fmt: skip
    """The nearer to 1e-2 the learning rate is, the better; the rest matters little."""
    value = params["learning_rate"] * 100.0 + 0.001 * params["n_epochs"]
    prune = tuning.Pruning(sweep, past, report)
    for number in range(1, sweep.evaluations + 1):
        time.sleep(seconds)
        if prune(number, value * number / sweep.evaluations):
            return TrialResult(TrialState.PRUNED)
    return TrialResult(TrialState.COMPLETE, value)


def searched(
    sweep: SearchConfig, folder: Path, run: Any = cheap_trial, workers: Workers = 1
) -> list[FrozenTrial]:
    """All trials of a search that is carried out in a folder, the interrupted ones included."""
    with tuning.open_study(sweep, folder) as kept:
        with suppress(KeyboardInterrupt):
            tuning.optimize(sweep, kept, workers, QUIET, run)
        return list(kept.get_trials())


def slow_search(folder: Path) -> None:
    """A search to be killed."""
    searched(SMALL, folder, partial(cheap_trial, seconds=0.2), 2)
