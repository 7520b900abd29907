"""The search for a layout: differential evolution, then a descent column by column.

The axes are dozens of integers. The cost jumps where a parcel only just leaves the line, so there
are no derivatives. SciPy's differential evolution accepts integers and initial layouts. `run_all`
evaluates each population in parallel. When few members still differ, the descent tries all axes of
one column after another.
"""

import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from surface_gym import checks
from surface_gym.design import case, runs
from surface_gym.physics.types import Array

Score = Callable[[Array], Array]  # costs (layouts,) of axes (layouts, rows, columns) [rad]

RECOMBINATION = 0.3  # [-] share of a layout's modules that a trial changes
CHANGES = (0.1, 0.3, 0.6)  # [-] share of modules changed in copies of the initial layouts

QUARTER = math.pi / 2.0
DECIMALS = 2  # decimals of degrees if any angle is allowed
ALL_AT_ONCE = 256  # maximum arrangements of a column tried together; above, module by module
SHIFTS = np.radians(
    [-22.5, -5.0, -1.0, 1.0, 5.0, 22.5]
)  # [rad] changes tried if any angle is allowed


@dataclass(frozen=True)
class LayoutSpace:
    """The searched layouts, encoded as members: one number per module, row by row.

    A number is an index into the orientations, or the axis itself [rad].
    """

    rows: int
    columns: int
    orientations: tuple[float, ...] | None  # [rad] in ascending order; None: any

    @property
    def modules(self) -> int:
        return self.rows * self.columns

    @property
    def bounds(self) -> tuple[float, float]:
        """Smallest and largest number of a module."""
        return (-QUARTER, QUARTER) if self.orientations is None else (0, len(self.orientations) - 1)

    def axes(self, members: Array) -> Array:
        """Return the axes (members, rows, columns) [rad] of members (members, modules)."""
        shape = (len(members), self.rows, self.columns)
        if self.orientations is None:
            return np.radians(np.degrees(members).round(DECIMALS)).reshape(shape)
        return np.array(self.orientations)[np.rint(members).astype(int)].reshape(shape)

    def members(self, axes: Array) -> Array:
        """Return the members (layouts, modules) closest to axes (layouts, rows, columns) [rad]."""
        flat = axes.reshape(len(axes), -1)
        if self.orientations is None:
            return np.arctan(np.tan(flat))
        apart = np.abs(np.sin(flat[..., np.newaxis] - np.array(self.orientations)))
        return apart.argmin(axis=-1).astype(np.float64)

    def sample(self, rng: np.random.Generator, count: int) -> Array:
        """Draw random members (count, modules)."""
        low, high = self.bounds
        if self.orientations is None:
            return rng.uniform(low, high, (count, self.modules))
        return rng.integers(0, len(self.orientations), (count, self.modules)).astype(np.float64)

    def neighbours(self, member: Array, column: int) -> Array:
        """Return members (count, modules) that differ from a member (modules,) in one column."""
        own = np.arange(self.rows) * self.columns + column
        if self.orientations is None:
            one = SHIFTS[:, np.newaxis, np.newaxis] * np.eye(self.rows)
            every = SHIFTS[:, np.newaxis] * np.ones(self.rows)
            tried = member[own] + np.concatenate([one.reshape(-1, self.rows), every])
            tried = np.arctan(np.tan(tried))
        elif len(self.orientations) ** self.rows <= ALL_AT_ONCE:
            every_way = itertools.product(range(len(self.orientations)), repeat=self.rows)
            tried = np.array(list(every_way), dtype=np.float64)
        else:
            places = np.arange(len(self.orientations), dtype=np.float64)
            tried = np.tile(member[own], (self.rows, len(places), 1))
            tried[np.arange(self.rows), :, np.arange(self.rows)] = places
            tried = tried.reshape(-1, self.rows)
        around = np.tile(member, (len(tried), 1))
        around[:, own] = tried
        return around


@dataclass(frozen=True)
class Effort:
    """Length of a search."""

    members: int = 40  # size of the population
    generations: int = 10  # generations per epoch; the search is saved after every epoch
    epochs: int = 12
    rounds: int = 3  # rounds of the descent over all columns; it ends early without changes

    def __post_init__(self) -> None:
        for name, least in (("members", 5), ("generations", 1), ("epochs", 0), ("rounds", 0)):
            checks.integer(name, getattr(self, name), least)


@dataclass(frozen=True, eq=False)
class SearchState:
    """State of a search, sufficient to resume it."""

    population: Array  # (members, modules) best first
    cost: Array  # (members,) [-] infinite: not computed yet
    epoch: int  # finished epochs of the evolution
    column: int  # finished columns of the descent, over all rounds
    unchanged: int  # successive columns without a change
    evaluations: int  # number of evaluated layouts


def search(
    space: LayoutSpace, score: Score, known: Array, effort: Effort, seed: int,
    checkpoint: Path | str | None = None, identity: Mapping[str, str] | None = None,
    on_progress: runs.OnProgress = lambda *_: None,
) -> tuple[Array, int]:  # fmt: skip
    """Search for the axes (rows, columns) [rad] with the least cost.

    The initial layouts include `known` (layouts, rows, columns) [rad], so the result is no worse. A
    search with an existing checkpoint is resumed, without an effect on the result. `identity` has a
    text for each part of the problem, to detect checkpoints of other problems.
    """
    own = {"space": space, "effort": effort, "search_seed": seed}
    identity = {**(identity or {}), **{name: repr(value) for name, value in own.items()}}
    file = None if checkpoint is None else Path(checkpoint)
    if file is not None and file.exists():
        values = case.load_checkpoint(file, "search", identity, tuple(SearchState.__annotations__))
        given: dict[str, Any] = {k: v if v.ndim else v.item() for k, v in values.items()}
        state = SearchState(**given)
        _check_state(file, state, _begin(space, known, effort, seed))
    else:
        state = _begin(space, known, effort, seed)
    steps = effort.epochs + effort.rounds * space.columns
    remembered: dict[bytes, float] = {}

    def cost(members: Array) -> Array:
        """Return the costs (members,); computed costs are cached."""
        members = np.ascontiguousarray(members)
        names = [member.tobytes() for member in members]
        fresh = {name: k for k, name in enumerate(names) if name not in remembered}
        if fresh:
            found = score(space.axes(members[list(fresh.values())]))
            remembered.update(zip(fresh, found.tolist(), strict=True))
        return np.array([remembered[name] for name in names])

    while True:
        on_progress(min(steps, state.epoch + state.column), steps)
        if state.epoch < effort.epochs:
            state = _evolve(space, cost, state, effort, seed)
        elif state.column < effort.rounds * space.columns and state.unchanged < space.columns:
            state = _descend(space, cost, state)
        else:
            break
        if file is not None:
            case.save_checkpoint(file, identity, vars(state))
    on_progress(steps, steps)
    return space.axes(state.population[:1])[0], state.evaluations


def _check_state(file: Path, state: SearchState, fresh: SearchState) -> None:
    """Raise a ValueError unless a saved state has the types and shapes of a fresh one."""
    try:
        for name in ("epoch", "column", "unchanged", "evaluations"):
            checks.integer(name, getattr(state, name), least=0)
        for name in ("population", "cost"):
            kept, like = getattr(state, name), getattr(fresh, name)
            if np.shape(kept) != like.shape or kept.dtype != like.dtype or np.isnan(kept).any():
                raise ValueError(f"{name} must be {like.dtype} of {like.shape} without nan")
    except ValueError as error:
        raise ValueError(f"checkpoint must be one of a search, got {file}: {error}") from None


def _begin(space: LayoutSpace, known: Array, effort: Effort, seed: int) -> SearchState:
    """Return known layouts, and copies with increasing numbers of changed modules."""
    rng = np.random.default_rng((seed, effort.epochs))
    members = space.members(known)[: effort.members]
    more = effort.members - len(members)
    changed = members[np.arange(more) % len(members)]
    share = np.array(CHANGES)[np.arange(more) % len(CHANGES), np.newaxis]
    changed = np.where(rng.random(changed.shape) < share, space.sample(rng, more), changed)
    population = np.concatenate([members, changed])
    return SearchState(population, np.full(len(population), math.inf), 0, 0, 0, 0)


def _evolve(
    space: LayoutSpace, cost: Score, state: SearchState, effort: Effort, seed: int
) -> SearchState:
    """Run an epoch of differential evolution with its own random numbers."""
    from scipy.optimize import differential_evolution

    result = differential_evolution(
        lambda members: cost(members.T), [space.bounds] * space.modules, init=state.population,
        integrality=np.full(space.modules, space.orientations is not None),
        maxiter=effort.generations, recombination=RECOMBINATION, tol=0.0, polish=False,
        vectorized=True, updating="deferred", seed=np.random.default_rng((seed, state.epoch)),
    )  # fmt: skip
    population = np.array(result.population)
    if space.orientations is not None:
        population = np.rint(population)
    energies = np.array(result.population_energies)
    order = np.argsort(energies, kind="stable")
    return replace(
        state,
        population=population[order],
        cost=energies[order],
        epoch=state.epoch + 1,
        evaluations=state.evaluations + (result.nit + 1) * len(population),
    )


def _descend(space: LayoutSpace, cost: Score, state: SearchState) -> SearchState:
    """Take the best arrangement of the next column, with all other columns unchanged."""
    best = state.population[0]
    around = np.concatenate(
        [best[np.newaxis], space.neighbours(best, state.column % space.columns)]
    )
    costs = cost(around)
    first = int(costs.argmin())
    population, least = state.population.copy(), state.cost.copy()
    population[0], least[0] = around[first], costs[first]
    return replace(
        state,
        population=population,
        cost=least,
        column=state.column + 1,
        unchanged=state.unchanged + 1 if first == 0 else 0,
        evaluations=state.evaluations + len(around),
    )
