"""The cells of the sweep; what is computed is kept."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from surface_gym.lines import Line
from surface_gym.sharing import Workers

from ...episodes import Episodes, run_apart, run_episodes
from ...planning.knowing import play_knowing
from ..contenders import ANY_ANGLE, BEST_FIXED, PLANNER, Contender
from ..trials import SEED, make_trial
from ..work import Advance, compute_kept
from .change import Situation, situation
from .factors import FACTORS, LAB, TRAINED, Factor, Level

FILE = "robustness.jsonl"
STARTS = 240  # a cell
# What fits no other parcel or zone than it was searched for, or takes a search a start.
LEFT_OUT = (BEST_FIXED, ANY_ANGLE)
# Rules that look far ahead are tried on a quarter of the starts, the planner on a sixth.
THINKING = {"turning rule": 4, "sliding mode": 4, PLANNER: 6}
# The planner knows all of a start, and so shows what can be reached; it is tried on these factors,
# at the levels that are told.
PLANNED = (TRAINED, "square", LAB)
FOLLOWED = 32  # lanes that it follows at a time at most

SweptKey = tuple[Any, ...]


@dataclass(frozen=True)
class SweptCell:
    """A contender's seed on a task at the levels of a factor."""

    task: str
    contender: str
    factor: str
    seed: int
    starts: int  # at each level
    levels: list[Level]
    success: list[str]  # (levels,) a letter a start: 1 for success, else 0
    error: list[float]  # (levels,) median size of the task's first figure; 0 where it has none

    @property
    def key(self) -> SweptKey:
        """What it is the cell of."""
        return key_of(self.task, self.contender, self.factor, self.seed, self.starts, self.levels)

    def plain(self) -> dict[str, Any]:
        """As JSON takes it."""
        return asdict(self)


def key_of(
    task: str, who: str, factor: str, seed: int, starts: int, levels: Sequence[Level]
) -> SweptKey:
    """What a cell is of: another number of starts, or other levels, make another cell."""
    return (task, who, factor, seed, starts, tuple(levels))


def swept(contenders: Sequence[Contender]) -> list[Contender]:
    """Those that run on any parcel and any zone."""
    return [contender for contender in contenders if contender.name not in LEFT_OUT]


def levels_for(contender: Contender, factor: Factor) -> tuple[Level, ...]:
    """The levels of a factor that a contender is tried at; none where the factor is not of its
    task or not for it.
    """
    if factor.of_lines and not isinstance(make_trial(contender.task).task.plant, Line):
        return ()
    if contender.name != PLANNER:
        return factor.swept
    return factor.told if factor.name in PLANNED else ()


def starts_for(contender: Contender, starts: int) -> int:
    """How many of the starts a contender is tried on."""
    return max(1, starts // THINKING.get(contender.name, 1))


def compute_swept(
    contender: Contender, seed: int, name: str, levels: tuple[Level, ...], starts: int
) -> SweptCell:
    """Try a contender's seed at the levels of a factor."""
    trial = make_trial(contender.task)
    success, errors = [], []
    for level in levels:
        settings = situation(contender, trial, FACTORS[name].change(level))
        episodes = _episodes(contender, seed, settings, starts)
        success.append("".join("1" if each else "0" for each in episodes.success))
        figure = next(iter(episodes.figures.values()), np.zeros(1))
        errors.append(float(np.median(np.abs(figure))))
    return SweptCell(
        contender.task, contender.name, name, seed, starts, list(levels), success, errors
    )


def _episodes(contender: Contender, seed: int, settings: Situation, starts: int) -> Episodes:
    drawn: list[dict[str, Any]] = [{}] * starts
    if contender.name == PLANNER:
        return play_knowing(settings.true, drawn, SEED, FOLLOWED)
    run = run_episodes if contender.starts is None else run_apart
    return run(contender.make(settings.told, seed), settings.true, drawn, SEED)


def sweep_jobs(
    contenders: Sequence[Contender], starts: int
) -> dict[SweptKey, Callable[[], SweptCell]]:
    """Every cell to compute, by its key; the slowest first, to fill the cores."""
    orders = [
        (who, seed, factor.name, levels_for(who, factor), starts_for(who, starts))
        for who in sorted(contenders, key=lambda each: -THINKING.get(each.name, 1))
        for seed in who.seeds
        for factor in FACTORS.values()
    ]
    return {
        key_of(who.task, who.name, factor, seed, count, levels): partial(
            compute_swept, who, seed, factor, levels, count
        )
        for who, seed, factor, levels, count in orders
        if levels
    }


def compute_sweep(
    contenders: Sequence[Contender],
    workers: Workers,
    folder: Path | None = None,
    starts: int = STARTS,
    advance: Advance = lambda *_: None,
) -> list[SweptCell]:
    """Compute all cells, in an order that does not depend on the processes.

    Args:
        contenders: to try; who runs on any parcel.
        workers: processes to share the work among, or a cluster.
        folder: cells are kept in its robustness.jsonl, and those found there are not computed
            again.
        starts: at each level.
        advance: called with cells done, cells in all and the name of the latest.
    """
    file = None if folder is None else folder / FILE
    found = compute_kept(sweep_jobs(contenders, starts), SweptCell, workers, file, advance)
    who = {(each.task, each.name): place for place, each in enumerate(contenders)}
    factors = {name: place for place, name in enumerate(FACTORS)}
    return sorted(
        found.values(),
        key=lambda cell: (who[cell.task, cell.contender], factors[cell.factor], cell.seed),
    )
