"""Search for a surface's parameters by least squares between predictions and pictures.
Runs are cut into pieces. A piece has six unknowns of its own, the entry: the parcel's pose and
velocity at the piece's first picture. Motion over a whole run is chaotic, so a run's sum of squares
has local minima. A short piece has none, but determines less. Therefore the last search links
pieces: predictions of a piece go on beyond the piece's end, and must agree with the next piece
there (multiple shooting). Linked pieces of one run are a group. A miss is a predicted minus a
measured number.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

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
PIECE = 0.8  # [s] maximum length of a piece
BEYOND = 5  # pictures that a piece is predicted beyond its end
LINK = 0.1  # [-] of the noise, by which the prediction may differ from the next piece there
SETTLE = 3  # steps of the entries alone, before a search
MAX_TRIES = 4  # of a step, each shorter
FIRST_DAMPING = 1.0
FEW_RUNS = 12  # runs of the first search
TURN_FACTORS = (0.5, 1.0, 2.0)  # [-] of the assumed quarter turn, from which searches start
ENOUGH = 1e-4  # [-] relative change of the squares at which a search ends
SHORT = 0.1  # [-] longest step of a parameter by its standard deviation, at which a search ends too
START = 0.2  # [s] of pictures for the first guess of an entry


@dataclass(frozen=True, eq=False)
class LeastSquares:
    """A least-squares problem: pieces of runs, parameters to find, and the pictures' noise."""

    runs: pr.PackedRuns
    memory: pr.Memory
    first_piece: Integers  # (groups + 1,) index of a group's first piece
    group: Integers  # (groups,) index of a group's run
    # (frames,) a frame beyond its piece's end: index of the same picture in the next piece; else -1
    same: Integers
    measured: Array  # (frames, 3) [m, m, rad] poses in the pictures
    base: Array  # (pieces, VALUES) values of all parameters that are not searched
    columns: Integers  # (free,) columns to find
    apart: Array  # (free,) as in `Parameter`
    step: Array  # (free,) largest plausible step of a search
    low: Array  # (free,) smallest value
    high: Array  # (free,) largest value
    noise: Array  # (3,) [m, m, rad]

    @property
    def count(self) -> int:
        return len(self.base)

    def values(self, x: Array, entries: Array) -> Array:
        """Combine parameters `x` (free,) and entries into rows (pieces, VALUES) for `predict`."""
        values = self.base.copy()
        values[:, self.columns] = x
        values[:, pr.ENTRY :] = entries
        return values

    def predict(self, values: Array, repeats: int, dt: float) -> Array:
        """Predict the poses (repeats, frames, 3) of all pieces, for `repeats` sets of values.

        The sets follow each other in `values` (repeats * pieces, VALUES), with a row per piece.
        """
        which = np.tile(np.arange(self.count), repeats)
        lengths = np.diff(self.runs.first_frame)[which]
        poses = np.empty((int(lengths.sum()), 3))
        first = np.cumsum([0, *lengths])
        pr.predict_runs(self.runs, which, values, first, self.memory, poses, dt)
        return poses.reshape(repeats, -1, 3)

    def misses(self, x: Array, entries: Array, dt: float) -> Array:
        """Return predicted minus measured poses (frames * 3,), in units of the noise.

        `x` (free,) are the parameters to find, `entries` (pieces, 6) the entries, and `dt` [s] is
        the maximum time step.
        """
        predicted = self.predict(self.values(x, entries), 1, dt)[0]
        return ((predicted - self.measured) / self.noise).ravel()

    def link(self, misses: Array) -> Array:
        """Return residuals (frames * 3, ...) from misses (frames * 3, ...) or their derivatives.

        Within a piece, residuals are the misses. Beyond the piece's end, residuals are differences
        from the misses of the next piece.
        """
        return _linked(misses, self.same)

    def derivatives(
        self, x: Array, entries: Array, dt: float, misses: Array | None = None
    ) -> tuple[Array, Array]:
        """Return derivatives of the misses by the parameters to find, and by the entries of pieces.

        Args:
            x, entries, dt: see the method `misses`.
            misses: (frames * 3,) misses at `x` and `entries`, for forward differences. If `misses`
                is None, use central differences. Central differences take twice the time.

        Returns:
            Derivatives by the parameters, shape (frames * 3, free), and derivatives by the entries,
            shape (frames * 3, 6). A miss depends on only one entry, the entry of the miss's piece.
        """
        rates = self._rates(x, entries, self.columns.tolist(), self.apart, dt, misses)
        return rates, self._rates(x, entries, ENTRIES, ENTRY_APART, dt, misses)

    def _rates(
        self, x: Array, entries: Array, columns: list[int], apart: Array, dt: float,
        misses: Array | None = None,
    ) -> Array:  # fmt: skip
        """Return derivatives (frames * 3, columns) of misses by columns of the array `values`.

        The method `values` returns the array. `columns` are the columns' indices. `apart`
        (columns,) are the steps of finite differences. For other arguments see `derivatives`.
        """
        values, count = self.values(x, entries), len(columns)
        signs = (1.0, -1.0) if misses is None else (1.0,)
        changed = np.repeat(values[np.newaxis], len(signs) * count, axis=0)
        for k, sign in enumerate(signs):
            for j, column in enumerate(columns):
                changed[k * count + j, :, column] += sign * apart[j]
        changed[..., pr.QUARTER_TURN] = np.maximum(changed[..., pr.QUARTER_TURN], 1e-4)
        poses = self.predict(changed.reshape(-1, pr.VALUES), len(changed), dt)
        if misses is None:
            moved = 0.5 * (poses[:count] - poses[count:]) / self.noise
        else:
            moved = (poses - self.measured) / self.noise - misses.reshape(-1, 3)
        flat: Array = (moved / apart[:, np.newaxis, np.newaxis]).reshape(count, -1).T
        return flat

    def groups(self, own: Array) -> Iterator[tuple[slice, slice, Array]]:
        """Yield for each group the slice of its pieces, the slice of its residuals, and a matrix.

        The matrix (residuals, 6 * pieces) has the derivatives of the group's residuals with respect
        to the entries of its pieces. `own` (frames * 3, 6) has the derivatives of each frame's
        misses with respect to the entry of the frame's piece.
        """
        starts = 3 * self.runs.first_frame
        for first, end in zip(self.first_piece[:-1], self.first_piece[1:], strict=True):
            begin, frame = starts[first], self.runs.first_frame[first]
            block = np.zeros((starts[end] - begin, 6 * (end - first)))
            for j, k in enumerate(range(first, end)):
                rows = slice(starts[k] - begin, starts[k + 1] - begin)
                block[rows, 6 * j : 6 * j + 6] = own[starts[k] : starts[k + 1]]
            same = self.same[frame : self.runs.first_frame[end]]
            linked = _linked(block, np.where(same < 0, -1, same - frame))
            yield slice(first, end), slice(begin, starts[end]), linked

    def costs(self, misses: Array, within: float) -> Array:
        """Return groups' sums (groups,) of squared residuals. Residuals > `within` count less."""
        squares = self.link(misses) ** 2
        if within < math.inf:
            squares = 2.0 * within**2 * (np.sqrt(1.0 + squares / within**2) - 1.0)
        firsts = self.runs.first_frame[self.first_piece[:-1]]
        sums: Array = np.add.reduceat(squares, 3 * firsts)
        return sums

    def settle(
        self, x: Array, entries: Array, misses: Array, dt: float, within: float, times: int,
        own: Array | None = None,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Improve the entries at fixed parameters. Return new entries (pieces, 6), and new misses.

        Args:
            x, entries, dt: see the method `misses`.
            misses: (frames * 3,) misses at `x` and `entries`.
            within: numbers of `link(misses)` above `within` count less.
            times: number of iterations.
            own: (frames * 3, 6) derivatives of each frame's misses by the entry of the frame's
                piece, computed before. If None, every iteration computes the derivatives.
        """
        damping = np.ones(len(self.group))
        for _ in range(times):
            residuals = self.link(misses)
            weight = _weights(residuals, within)
            rates = own
            if rates is None:
                rates = self._rates(x, entries, ENTRIES, ENTRY_APART, dt, misses)
            steps = np.empty_like(entries)
            for g, (pieces, rows, block) in enumerate(self.groups(rates)):
                weighed = block * weight[rows, np.newaxis]
                scale = np.tile(ENTRY_STEP, pieces.stop - pieces.start)
                normal = weighed.T @ weighed + np.diag(damping[g] / scale**2)
                step = np.linalg.solve(normal, -weighed.T @ (residuals * weight)[rows])
                steps[pieces] = step.reshape(-1, 6)
            found = self.misses(x, entries + steps, dt)
            better = self.costs(found, within) < self.costs(misses, within)
            damping *= np.where(better, 0.1, 10.0)
            of_piece = np.repeat(better, np.diff(self.first_piece))
            entries = np.where(of_piece[:, np.newaxis], entries + steps, entries)
            used = np.repeat(of_piece, 3 * np.diff(self.runs.first_frame))
            misses = np.where(used, found, misses)
        return entries, misses

    def solve(
        self, x: Array, residuals: Array, shared: Array, own: Array, weight: Array, damping: float
    ) -> tuple[Array, Array, float]:
        """Compute a step of the parameters and the entries. Parameters stay within their bounds.

        A QR decomposition of each group eliminates the group's entries. The remaining least squares
        problem has only the free parameters.

        Args:
            x: (free,) parameters.
            residuals: (frames * 3,) from `link`.
            shared: (frames * 3, free) derivatives of the misses by the parameters.
            own: (frames * 3, 6) derivatives of the misses by the piece's entry.
            weight: (frames * 3,) weights of the residuals.
            damping: [-] damping of Levenberg and Marquardt.

        Returns:
            The step of the parameters (free,), the step of the entries (pieces, 6), and the largest
            ratio [-] of a parameter's step to the parameter's standard deviation.
        """
        free = len(x)
        left: list[Array] = []
        parts: list[Array] = []
        rest = np.column_stack([self.link(shared), residuals]) * weight[:, np.newaxis]
        for _, rows, block in self.groups(own):
            size = block.shape[1]
            scale = np.tile(1.0 / ENTRY_STEP, size // 6)
            damped = np.column_stack(
                [math.sqrt(damping) * np.diag(scale), np.zeros((size, free + 1))]
            )
            whole = np.column_stack([block * weight[rows, np.newaxis], rest[rows]])
            upper: Array = np.linalg.qr(np.vstack([whole, damped])).R
            parts.append(upper[:size])
            left.append(upper[size:, size:])
        stacked = np.vstack(left)
        found = optimize.lsq_linear(
            np.vstack([stacked[:, :free], math.sqrt(damping) * np.diag(1.0 / self.step)]),
            -np.concatenate([stacked[:, free], np.zeros(free)]),
            (self.low - x - 1e-12, self.high - x + 1e-12),
        )
        step: Array = found.x
        # The inverse of the information, where the logs tell something.
        information = stacked[:, :free].T @ stacked[:, :free] + 1e-12 * np.diag(self.step**-2.0)
        spread = np.sqrt(np.diag(np.linalg.pinv(information)))
        length = float(np.max(np.abs(step) / np.maximum(spread, 1e-300)))
        steps = []
        for part in parts:
            size = len(part)
            right_side = -part[:, -1] - part[:, size:-1] @ step
            steps.append(np.linalg.solve(part[:, :size], right_side).reshape(-1, 6))
        return step, np.vstack(steps), length


def column_of(name: str) -> int:
    """Return the column of the parameter `name` in arrays of values (..., VALUES)."""
    column: int = getattr(pr, name.upper())
    return column


def make_search(
    log: MachineLog,
    pieces: Sequence[LoggedRun],
    names: tuple[str, ...],
    known: Mapping[str, float],
    noise: tuple[float, float],
    beyond: int = 0,
) -> LeastSquares:
    """Make the least-squares problem for the parameters `names`.

    Args:
        pieces: pieces of runs. Pieces of one run stand one after the other.
        known: values of other parameters by name.
        noise: [m, rad] standard deviations of position and angle in pictures.
        beyond: number of pictures predicted beyond a piece's end. If `beyond` is 0, pieces are not
            linked.
    """
    surface = log.surface
    base = np.zeros((len(pieces), pr.VALUES))
    base[:, : pr.MU_SUPPORT + 1] = surface.friction
    base[:, pr.TILT] = [piece.tilt for piece in pieces]
    base[:, pr.QUARTER_TURN] = surface.quarter_turn
    for name, value in known.items():
        base[:, column_of(name)] = checks.number(name, value)
    base[:, pr.QUARTER_TURN] = np.maximum(base[:, pr.QUARTER_TURN], 1e-4)
    chosen = [PARAMETERS[name] for name in names]
    run = [id(piece.sent) for piece in pieces]
    linked = [beyond > 0 and each == after for each, after in pairwise([*run, None])]
    begins = [k for k in range(len(pieces)) if k == 0 or not linked[k - 1]]
    longer, same = _lengthen(pieces, linked, beyond)
    return LeastSquares(
        runs=pr.pack_runs(surface, longer),
        memory=pr.make_memory(surface),
        first_piece=np.array([*begins, len(pieces)]),
        group=np.unique(run, return_inverse=True)[1][begins],
        same=same,
        measured=np.concatenate([piece.poses for piece in longer]),
        base=base,
        columns=np.array([column_of(name) for name in names]),
        apart=np.array([each.apart for each in chosen]),
        step=np.array([each.step for each in chosen]),
        low=np.array([each.low for each in chosen]),
        high=np.array([each.high for each in chosen]),
        noise=np.array([noise[0], noise[0], noise[1]]),
    )


def _lengthen(
    pieces: Sequence[LoggedRun], linked: Sequence[bool], beyond: int
) -> tuple[list[LoggedRun], Integers]:
    """Append to each linked piece the first `beyond` pictures of the next piece.

    `linked` (pieces,) says whether a piece is linked to the next piece. Returns the longer pieces,
    and the array `LeastSquares.same`. For an appended picture, the array has the index of the
    same picture in the next piece. For all other pictures, the array has -1.
    """
    longer, same = [], list[int]()
    for piece, after, is_linked in zip(pieces, [*pieces[1:], None], linked, strict=True):
        same += [-1] * len(piece.taken)
        if is_linked and after is not None:
            more = min(beyond, len(after.taken))
            piece = replace(
                piece,
                taken=np.append(piece.taken, after.taken[:more]),
                poses=np.vstack([piece.poses, after.poses[:more]]),
            )
            same += range(len(same) + more, len(same) + 2 * more)
        longer.append(piece)
    return longer, np.array(same)


def search_pieces(
    log: MachineLog, runs: Sequence[LoggedRun], names: tuple[str, ...], known: Mapping[str, float],
    noise: tuple[float, float], dt: float, on_progress: OnProgress,
) -> tuple[LeastSquares, Array, Array]:  # fmt: skip
    """Search for the parameters `names`, first in short pieces, then in linked pieces.

    `dt` [s] is the maximum time step of the last search; the first searches have longer steps. For
    `known` and `noise` see `make_search`. `on_progress` is called with a text at each stage.

    Returns:
        The last least-squares problem, and its solution: parameters (free,), entries (pieces, 6).
    """
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
    on_progress(f"search in linked pieces, steps of {1e3 * dt:g} ms")
    search = make_search(log, pieces, names, known, noise, BEYOND)
    firsts = np.cumsum([0, *map(len, halves)])[:-1]
    x, entries, _ = _fit(search, x, entries[firsts], dt, math.inf, 8)
    return search, x, entries


def _choose(runs: Sequence[LoggedRun]) -> list[LoggedRun]:
    """Return at most `FEW_RUNS` random runs for a first search."""
    order = np.random.default_rng(0).permutation(len(runs))
    return [runs[k] for k in sorted(order[:FEW_RUNS].tolist())]


def _cut(run: LoggedRun, count: int) -> tuple[LoggedRun, ...]:
    """Cut a run into at most `count` equal pieces of at least `MIN_FRAMES` pictures."""
    count = max(1, min(count, len(run.taken) // MIN_FRAMES))
    return tuple(
        replace(run, taken=run.taken[part], poses=run.poses[part])
        for part in np.array_split(np.arange(len(run.taken)), count)
    )


def _starts(search: LeastSquares) -> list[Array]:
    """Return first guesses (free parameters,). Guesses differ only in the speed of the axes."""
    assumed = np.clip(search.base[0, search.columns], search.low, search.high)
    if pr.QUARTER_TURN not in search.columns:
        return [assumed]
    factors = np.where(
        search.columns == pr.QUARTER_TURN, np.array(TURN_FACTORS)[:, np.newaxis], 1.0
    )
    return list(np.clip(assumed * factors, search.low, search.high))


def _entries(runs: Sequence[LoggedRun]) -> Array:
    """Guess the entries (pieces, 6) by fitting parabolas to the first pictures of each piece."""
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
    """Minimise the sum of squared residuals by the method of Levenberg and Marquardt.

    Args:
        x: (free,) first guess of the parameters.
        entries: (pieces, 6) first guess of the entries.
        dt: [s] maximum time step of predictions.
        within: [-] scale of the loss "soft L1". Residuals above the scale count less. If the
            scale is infinite, all residuals count alike.
        most: maximum number of iterations.

    Returns:
        Parameters (free,), entries (pieces, 6), and the sum of squares.
    """
    damping = FIRST_DAMPING
    misses = search.misses(x, entries, dt)
    entries, misses = search.settle(x, entries, misses, dt, within, SETTLE)
    cost, length = float(search.costs(misses, within).sum()), math.inf
    for _ in range(most):
        residuals = search.link(misses)
        weight = _weights(residuals, within)
        is_rough = within < math.inf or length == math.inf
        shared, own = search.derivatives(x, entries, dt, misses if is_rough else None)
        before = cost
        for _ in range(MAX_TRIES):
            step, steps, length = search.solve(x, residuals, shared, own, weight, damping)
            moved, found = entries + steps, search.misses(x + step, entries + steps, dt)
            if search.costs(found, within).sum() >= cost:
                moved, found = search.settle(x + step, moved, found, dt, within, 2, own)
            if (new := float(search.costs(found, within).sum())) < cost:
                x, entries, misses, cost = x + step, moved, found, new
                damping /= 10.0
                break
            damping *= 10.0
        if before - cost < ENOUGH * before or length < SHORT:
            break
    return x, entries, cost


def _linked(misses: Array, same: Integers) -> Array:
    """Return the residuals (frames * 3, ...) from the misses (frames * 3, ...).

    `same` (frames,) is -1 for frames within a piece. The residuals of these frames are the misses.
    For a frame beyond a piece's end, `same` is the index of the next piece's frame at the same
    time. The residual is then the difference of the two frames' misses, divided by `LINK`.
    """
    each = misses.reshape(len(same), 3, -1)
    linked, beyond = each.copy(), same >= 0
    linked[beyond] = (each[beyond] - each[same[beyond]]) / LINK
    return linked.reshape(misses.shape)


def _weights(residuals: Array, within: float) -> Array:
    """Return factors (frames * 3,) of residuals, for the loss "soft L1" with the scale `within`."""
    weights: Array = (1.0 + (residuals / within) ** 2) ** -0.25
    return weights
