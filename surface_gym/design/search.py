"""The search for a layout: differential evolution, then a descent column by column.

Which axes are best is a question of whole numbers, dozens of them, whose answer jumps where a
parcel just gets off the line: there are no derivatives to follow and no model to fit. SciPy's
differential evolution needs none, takes whole numbers, hands over a population at a time, which is
what `run_all` shares among threads, begins with the study's layouts, is the same for the same seed,
and comes with SciPy, on which this package depends anyway; CMA-ES and Optuna would be new
dependencies, the one for continuous axes, the other one trial at a time. Where few members differ
any more, all axes of one column in turn find what is left.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import differential_evolution

from surface_gym import checks
from surface_gym.design.progress import read_progress, write_progress
from surface_gym.design.space import Space

Numbers = NDArray[np.float64]
Score = Callable[[Numbers], Numbers]  # costs (layouts,) of axes (layouts, rows, columns) [rad]

RECOMBINATION = 0.3  # [-] of a layout's modules that a trial changes: more would undo the rest
CHANGES = (0.1, 0.3, 0.6)  # [-] of the modules by which first members differ from the study's


@dataclass(frozen=True)
class Effort:
    """How long a search goes on.

    Raises:
        ValueError: a number that is too small.
    """

    members: int = 40  # of the population
    generations: int = 10  # of an epoch, after which what is found is kept
    epochs: int = 12
    rounds: int = 3  # over all columns, of the descent; fewer if one changes nothing

    def __post_init__(self) -> None:
        checks.integer("members", self.members, least=5)
        checks.integer("generations", self.generations, least=1)
        checks.integer("epochs", self.epochs, least=0)
        checks.integer("rounds", self.rounds, least=0)


@dataclass(frozen=True, eq=False)
class Progress:
    """How far a search has come: all that it needs to go on."""

    population: Numbers  # (members, modules), the best first
    cost: Numbers  # (members,) [-]; infinite: not known yet
    epoch: int  # of the evolution, done
    column: int  # of the descent, done, counted on from round to round
    unchanged: int  # columns in turn that changed nothing
    evaluations: int  # layouts compared


def search(
    space: Space,
    score: Score,
    known: Numbers,
    effort: Effort,
    seed: int,
    checkpoint: Path | str | None = None,
    told: str = "",
    advance: Callable[[int, int], None] = lambda *_: None,
) -> tuple[Numbers, int]:
    """The layout of least cost that is found.

    What is found does not depend on whether the search was broken off and resumed.

    Args:
        space: of the layouts.
        score: their costs; called with whole populations.
        known: (layouts, rows, columns) [rad] to begin with: the answer is no worse.
        effort: how long to search.
        seed: of all that is left to chance.
        checkpoint: file that keeps what is found; a search whose file exists goes on from there.
        told: what the search is of, in words that differ where it differs.
        advance: called with how much of the effort is done and how much there is, in steps.

    Returns:
        Axes (rows, columns) [rad], and how many layouts were compared.

    Raises:
        ValueError: the checkpoint is none, or of another search.
    """
    told = f"{told}; {space}; {effort}; seed {seed}"
    file = None if checkpoint is None else Path(checkpoint)
    if file is not None and file.exists():
        progress = Progress(**read_progress(file, told))
    else:
        progress = _begin(space, known, effort, seed)
    steps = effort.epochs + effort.rounds * space.columns
    remembered: dict[bytes, float] = {}

    def cost(members: Numbers) -> Numbers:
        return _costs(space, score, members, remembered)

    while True:
        advance(min(steps, progress.epoch + progress.column), steps)
        if progress.epoch < effort.epochs:
            progress = _evolve(space, cost, progress, effort, seed)
        elif progress.column < effort.rounds * space.columns > 0 and (
            progress.unchanged < space.columns
        ):
            progress = _descend(space, cost, progress)
        else:
            break
        if file is not None:
            write_progress(file, told, vars(progress))
    advance(steps, steps)
    return space.axes(progress.population[:1])[0], progress.evaluations


def _begin(space: Space, known: Numbers, effort: Effort, seed: int) -> Progress:
    """The study's layouts, and others that differ from them in more and more modules."""
    rng = np.random.default_rng((seed, effort.epochs))
    members = space.members(known)[: effort.members]
    more = effort.members - len(members)
    changed = members[np.arange(more) % len(members)]
    share = np.array(CHANGES)[np.arange(more) % len(CHANGES), np.newaxis]
    changed = np.where(rng.random(changed.shape) < share, space.drawn(rng, more), changed)
    population = np.concatenate([members, changed])
    return Progress(population, np.full(len(population), math.inf), 0, 0, 0, 0)


def _evolve(space: Space, cost: Score, progress: Progress, effort: Effort, seed: int) -> Progress:
    """An epoch of differential evolution, by numbers drawn for it alone."""
    result = differential_evolution(
        lambda members: cost(members.T),
        [space.bounds] * space.modules,
        init=progress.population,
        integrality=np.full(space.modules, space.orientations is not None),
        maxiter=effort.generations,
        recombination=RECOMBINATION,
        tol=0.0,
        polish=False,
        vectorized=True,
        updating="deferred",
        seed=np.random.default_rng((seed, progress.epoch)),
    )
    population = np.array(result.population)
    if space.orientations is not None:
        population = np.rint(population)
    energies = np.array(result.population_energies)
    order = np.argsort(energies, kind="stable")
    asked = (result.nit + 1) * len(population)
    return replace(
        progress,
        population=population[order],
        cost=energies[order],
        epoch=progress.epoch + 1,
        evaluations=progress.evaluations + asked,
    )


def _descend(space: Space, cost: Score, progress: Progress) -> Progress:
    """The best arrangement of the next column, the others as they are."""
    best = progress.population[0]
    around = np.concatenate(
        [best[np.newaxis], space.neighbours(best, progress.column % space.columns)]
    )
    costs = cost(around)
    first = int(costs.argmin())
    population, least = progress.population.copy(), progress.cost.copy()
    population[0], least[0] = around[first], costs[first]
    return replace(
        progress,
        population=population,
        cost=least,
        column=progress.column + 1,
        unchanged=progress.unchanged + 1 if first == 0 else 0,
        evaluations=progress.evaluations + len(around),
    )


def _costs(space: Space, score: Score, members: Numbers, remembered: dict[bytes, float]) -> Numbers:
    """(members,) costs; those met before are remembered."""
    members = np.ascontiguousarray(members)
    names = [member.tobytes() for member in members]
    fresh = {name: k for k, name in enumerate(names) if name not in remembered}
    if fresh:
        found = score(space.axes(members[list(fresh.values())]))
        remembered.update(zip(fresh, found.tolist(), strict=True))
    return np.array([remembered[name] for name in names])
