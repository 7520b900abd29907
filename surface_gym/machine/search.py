"""The search of a surface's parameters: least squares of predictions and pictures.

Each piece of a run has six more unknowns: pose and velocity of the parcel at its first picture.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import optimize

from surface_gym import checks
from surface_gym.machine import prediction as pr
from surface_gym.machine.estimate import PARAMETERS
from surface_gym.machine.log import MIN_FRAMES, LoggedRun, MachineLog
from surface_gym.physics.types import Array, Integers

OnProgress = Callable[[str], None]  # called with a note on each stage


ENTRIES = list(range(pr.ENTRY, pr.VALUES))  # columns of the entry
ENTRY_APART = np.array([5e-4, 5e-4, 2e-3, 2e-3, 2e-3, 1e-2])  # of the entry's six numbers
ENTRY_STEP = np.array([2e-3, 2e-3, 1e-2, 0.1, 0.1, 0.5])  # by which a guess of them may be off
COARSE = 4e-3  # [s] maximum step of the first searches
WITHIN = 3.0  # [-] standard deviations beyond which the first search trusts a picture less
# [s] Runs are searched in pieces of at most this length, with an entry each: motion is chaotic over
# longer times, so that whole runs have false minima and claim more than they know.
PIECE = 0.8
SETTLE = 3  # steps of the entries alone, before a search
MAX_TRIES = 4  # of a step, each shorter
FIRST_DAMPING = 1.0
FEW_RUNS = 12  # runs of the first search
TURN_FACTORS = (0.5, 1.0, 2.0)  # [-] of the assumed quarter turn, from which searches start
ENOUGH = 1e-4  # [-] relative change of the squares at which a search ends
START = 0.2  # [s] of pictures for the first guess of an entry


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """What a search needs: runs, the columns to find, and the noise."""

    runs: pr.PackedRuns
    memory: pr.Memory
    run: Integers  # (pieces,) the run of each piece
    measured: Array  # (frames, 3)
    base: Array  # (runs, VALUES) values that are held
    columns: Integers  # (free,) columns to find
    apart: Array  # (free,)
    step: Array  # (free,) largest plausible step of a search
    low: Array  # (free,)
    high: Array  # (free,)
    noise: Array  # (3,) [m, m, rad]

    @property
    def count(self) -> int:
        return len(self.base)

    def values(self, x: Array, entries: Array) -> Array:
        """Return values (runs, VALUES) from free parameters (free,) and entries (runs, 6)."""
        values = self.base.copy()
        values[:, self.columns] = x
        values[:, pr.ENTRY :] = entries
        return values

    def predict(self, values: Array, repeats: int, dt: float) -> Array:
        """Return poses (repeats, frames, 3) by values (repeats * runs, VALUES)."""
        which = np.tile(np.arange(self.count), repeats)
        lengths = np.diff(self.runs.first_frame)[which]
        poses = np.empty((int(lengths.sum()), 3))
        first = np.cumsum([0, *lengths])
        pr.predict_runs(self.runs, which, values, first, self.memory, poses, dt)
        return poses.reshape(repeats, -1, 3)

    def residuals(self, x: Array, entries: Array, dt: float) -> Array:
        predicted = self.predict(self.values(x, entries), 1, dt)[0]
        return ((predicted - self.measured) / self.noise).ravel()

    def derivatives(self, x: Array, entries: Array, dt: float) -> tuple[Array, Array]:
        """Return derivatives of the residuals by free parameters and by each run's own entry.

        Returns:
            (residuals, free) and (residuals, 6).
        """
        rates = self._rates(x, entries, self.columns.tolist(), self.apart, dt)
        return rates, self._rates(x, entries, ENTRIES, ENTRY_APART, dt)

    def _rates(
        self, x: Array, entries: Array, columns: list[int], apart: Array, dt: float,
        residuals: Array | None = None,
    ) -> Array:  # fmt: skip
        """Return central differences (residuals, columns).

        With `residuals`, at `x`, they are forward differences, which take half the time.
        """
        values, count = self.values(x, entries), len(columns)
        signs = (1.0, -1.0) if residuals is None else (1.0,)
        changed = np.repeat(values[np.newaxis], len(signs) * count, axis=0)
        for k, sign in enumerate(signs):
            for j, column in enumerate(columns):
                changed[k * count + j, :, column] += sign * apart[j]
        changed[..., pr.QUARTER_TURN] = np.maximum(changed[..., pr.QUARTER_TURN], 1e-4)
        poses = self.predict(changed.reshape(-1, pr.VALUES), len(changed), dt)
        if residuals is None:
            moved = 0.5 * (poses[:count] - poses[count:]) / self.noise
        else:
            moved = (poses - self.measured) / self.noise - residuals.reshape(-1, 3)
        flat: Array = (moved / apart[:, np.newaxis, np.newaxis]).reshape(count, -1).T
        return flat

    def costs(self, residuals: Array, within: float) -> Array:
        """Return the squares of each run (runs,), less for residuals beyond `within`."""
        squares = residuals**2
        if within < math.inf:
            squares = 2.0 * within**2 * (np.sqrt(1.0 + squares / within**2) - 1.0)
        sums: Array = np.add.reduceat(squares, 3 * self.runs.first_frame[:-1])
        return sums

    def settle(
        self, x: Array, entries: Array, residuals: Array, dt: float, within: float, times: int,
        own: Array | None = None,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Improve each run's entry alone; return entries (runs, 6) and residuals.

        Args:
            own: derivatives (residuals, 6) by the entries nearby; None: computed here.
        """
        damping = np.ones(self.count)
        for _ in range(times):
            weight = _weights(residuals, within)
            rates = own
            if rates is None:
                rates = self._rates(x, entries, ENTRIES, ENTRY_APART, dt, residuals)
            rates = rates * weight[:, np.newaxis]
            steps = np.empty_like(entries)
            for r in range(self.count):
                rows = self.rows(r)
                normal = rates[rows].T @ rates[rows] + np.diag(damping[r] / ENTRY_STEP**2)
                steps[r] = np.linalg.solve(normal, -rates[rows].T @ (residuals * weight)[rows])
            found = self.residuals(x, entries + steps, dt)
            better = self.costs(found, within) < self.costs(residuals, within)
            damping *= np.where(better, 0.1, 10.0)
            entries = np.where(better[:, np.newaxis], entries + steps, entries)
            used = np.repeat(better, 3 * np.diff(self.runs.first_frame))
            residuals = np.where(used, found, residuals)
        return entries, residuals

    def rows(self, r: int) -> slice:
        """Return the residuals of a run."""
        return slice(3 * int(self.runs.first_frame[r]), 3 * int(self.runs.first_frame[r + 1]))

    def solve(
        self, x: Array, residuals: Array, shared: Array, own: Array, damping: float
    ) -> tuple[Array, Array]:
        """Return a step (free,) within the bounds, and steps of the entries (runs, 6).

        A QR decomposition of each run eliminates its entry. What is left of all runs is a least
        squares problem of the free parameters alone.
        """
        free = len(x)
        left: list[Array] = []
        parts: list[Array] = []
        damped = np.column_stack(
            [math.sqrt(damping) * np.diag(1.0 / ENTRY_STEP), np.zeros((6, free + 1))]
        )
        for r in range(self.count):
            rows = self.rows(r)
            block = np.column_stack([own[rows], shared[rows], residuals[rows]])
            upper: Array = np.linalg.qr(np.vstack([block, damped])).R
            parts.append(upper[:6])
            left.append(upper[6:, 6:])
        stacked = np.vstack(left)
        scale = np.diag(math.sqrt(damping) / self.step)
        found = optimize.lsq_linear(
            np.vstack([stacked[:, :free], scale]),
            -np.concatenate([stacked[:, free], np.zeros(free)]),
            (self.low - x - 1e-12, self.high - x + 1e-12),
        )
        step: Array = found.x
        steps = [
            np.linalg.solve(part[:, :6], -part[:, -1] - part[:, 6:-1] @ step) for part in parts
        ]
        return step, np.array(steps)


def column_of(name: str) -> int:
    """Return the column of a parameter in the predictions' values."""
    column: int = getattr(pr, name.upper())
    return column


def make_search(
    log: MachineLog,
    runs: Sequence[LoggedRun],
    names: tuple[str, ...],
    known: Mapping[str, float],
    noise: tuple[float, float],
) -> LeastSquares:
    """Make the search of some parameters; `known` holds values of others by name."""
    surface = log.surface
    base = np.zeros((len(runs), pr.VALUES))
    base[:, : pr.MU_SUPPORT + 1] = surface.friction
    base[:, pr.TILT] = [run.tilt for run in runs]
    base[:, pr.QUARTER_TURN] = surface.quarter_turn
    for name, value in known.items():
        base[:, column_of(name)] = checks.number(name, value)
    base[:, pr.QUARTER_TURN] = np.maximum(base[:, pr.QUARTER_TURN], 1e-4)
    chosen = [PARAMETERS[name] for name in names]
    return LeastSquares(
        runs=pr.pack_runs(surface, runs),
        memory=pr.make_memory(surface),
        run=np.unique([id(run.sent) for run in runs], return_inverse=True)[1],
        measured=np.concatenate([run.poses for run in runs]),
        base=base,
        columns=np.array([column_of(name) for name in names]),
        apart=np.array([each.apart for each in chosen]),
        step=np.array([each.step for each in chosen]),
        low=np.array([each.low for each in chosen]),
        high=np.array([each.high for each in chosen]),
        noise=np.array([noise[0], noise[0], noise[1]]),
    )


def search_pieces(
    log: MachineLog, runs: Sequence[LoggedRun], names: tuple[str, ...], known: Mapping[str, float],
    noise: tuple[float, float], dt: float, on_progress: OnProgress,
) -> tuple[LeastSquares, Array, Array]:  # fmt: skip
    """Find the least squares: first of short pieces in longer steps, then of pieces."""
    pieces = [
        piece
        for run in runs
        for piece in _cut(run, math.ceil(float(run.taken[-1] - run.taken[0]) / PIECE))
    ]
    halves = [_cut(piece, 2) for piece in pieces]
    short = [half for each in halves for half in each]
    few = {id(run.sent) for run in _choose(runs)}
    on_progress("a first search")
    part = [half for half in short if id(half.sent) in few]
    search = make_search(log, part, names, known, noise)
    coarse = max(dt, COARSE)
    starts = [_fit(search, x, _entries(part), coarse, WITHIN, 4) for x in _starts(search)]
    x, entries, _ = min(starts, key=lambda found: found[2])
    x, entries, _ = _fit(search, x, entries, coarse, WITHIN, 6)
    on_progress(f"search in short pieces, steps of {1e3 * coarse:g} ms")
    search = make_search(log, short, names, known, noise)
    x, entries, _ = _fit(search, x, _entries(short), coarse, WITHIN, 3)
    on_progress(f"search in pieces of {PIECE:g} s, steps of {1e3 * dt:g} ms")
    search = make_search(log, pieces, names, known, noise)
    firsts = np.cumsum([0, *map(len, halves)])[:-1]
    x, entries, _ = _fit(search, x, entries[firsts], dt, math.inf, 6)
    return search, x, entries


def _choose(runs: Sequence[LoggedRun]) -> list[LoggedRun]:
    """Return a few runs, enough for a first search."""
    order = np.random.default_rng(0).permutation(len(runs))
    return [runs[k] for k in sorted(order[:FEW_RUNS].tolist())]


def _cut(run: LoggedRun, count: int) -> tuple[LoggedRun, ...]:
    """Cut a run into pieces of equal length, fewer if they had too few pictures."""
    count = max(1, min(count, len(run.taken) // MIN_FRAMES))
    return tuple(
        replace(run, taken=run.taken[part], poses=run.poses[part])
        for part in np.array_split(np.arange(len(run.taken)), count)
    )


def _starts(search: LeastSquares) -> list[Array]:
    """Return first guesses (free,): what is assumed, and slower and faster axes."""
    assumed = np.clip(search.base[0, search.columns], search.low, search.high)
    if pr.QUARTER_TURN not in search.columns:
        return [assumed]
    factors = np.where(
        search.columns == pr.QUARTER_TURN, np.array(TURN_FACTORS)[:, np.newaxis], 1.0
    )
    return list(np.clip(assumed * factors, search.low, search.high))


def _entries(runs: Sequence[LoggedRun]) -> Array:
    """Return guesses (runs, 6) by a parabola through each run's first pictures."""
    entries = []
    for run in runs:
        time = run.taken - run.taken[0]
        count = max(MIN_FRAMES, int((time <= START).sum()))
        fit = np.polyfit(time[:count], run.poses[:count], 2)
        entries.append([*fit[2], *fit[1]])
    return np.array(entries)


def _fit(
    search: LeastSquares, x: Array, entries: Array, dt: float, within: float, most: int
) -> tuple[Array, Array, float]:
    """Find the least squares by the method of Levenberg and Marquardt, and return the squares too.

    Args:
        x: (free,) first guess of the parameters.
        entries: (runs, 6) first guess of the entries.
        dt: [s] maximum step.
        within: [-] pictures beyond count less, by the loss "soft L1"; infinite: all count alike.
        most: maximum number of steps.
    """
    damping = FIRST_DAMPING
    residuals = search.residuals(x, entries, dt)
    entries, residuals = search.settle(x, entries, residuals, dt, within, SETTLE)
    cost = float(search.costs(residuals, within).sum())
    for _ in range(most):
        weight = _weights(residuals, within)
        shared, own = search.derivatives(x, entries, dt)
        weighed = shared * weight[:, np.newaxis], own * weight[:, np.newaxis]
        before = cost
        for _ in range(MAX_TRIES):
            step, steps = search.solve(x, residuals * weight, *weighed, damping)
            moved, found = entries + steps, search.residuals(x + step, entries + steps, dt)
            if search.costs(found, within).sum() >= cost:
                moved, found = search.settle(x + step, moved, found, dt, within, 2, own)
            if (new := float(search.costs(found, within).sum())) < cost:
                x, entries, residuals, cost = x + step, moved, found, new
                damping /= 10.0
                break
            damping *= 10.0
        if before - cost < ENOUGH * before:
            break
    return x, entries, cost


def _weights(residuals: Array, within: float) -> Array:
    """Return the weights of residuals by the loss "soft L1"."""
    weights: Array = (1.0 + (residuals / within) ** 2) ** -0.25
    return weights
