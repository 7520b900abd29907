"""Identification: the surface's parameters from logs of a machine, by least squares.

The parameters minimise squared differences between poses in pictures and poses in simulations.
Intervals are by a sandwich estimator over runs, so they hold even if errors within a run depend on
each other. A parameter that the logs do not determine has an infinite interval.
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy import stats

from surface_gym import checks
from surface_gym.machine.estimate import PARAMETERS, Estimate
from surface_gym.machine.log import LoggedRun, MachineLog, read_log
from surface_gym.machine.search import LeastSquares, OnProgress, search_pieces
from surface_gym.physics.types import Array

SHIFTS = ("latency", "dead_time")  # equal changes of both change nothing but the time
CLEAR = 0.25  # [-] share of the searched range: a direction with a larger error is unknown
UNEXPLAINED = 2.0  # by which intervals are wider then: what the model lacks shifts all values
ALIKE = 0.99  # [-] correlation from which two parameters are inseparable
MISFIT = 1e-3  # [-] probability of chi^2 below which the model does not explain the logs
MAX_RUNS = 200  # maximum runs of a search, evenly chosen among all
LEAST_NOISE = (1e-5, 1e-5)  # [m, rad]


def identify(
    logs: Sequence[str | Path | MachineLog],
    *,
    free: Sequence[str],
    known: Mapping[str, float] | None = None,
    noise: tuple[float, float] | None = None,
    dt: float = 1e-3,
    on_progress: OnProgress | None = None,
) -> Estimate:
    """Identify parameters of a surface from logs.

    Args:
        logs: files of `surface-gym runtime --log`, or results of `read_log`, all of one surface.
        free: names of the parameters to find, from `PARAMETERS`.
        known: values of other parameters by name. The defaults of friction and `quarter_turn` are
            from the logs' surface. The default tilt is from the parcels' messages. Other defaults
            are 0.
        noise: standard deviations [m, rad] of the poses in pictures, or None to estimate them.
        dt: [s] maximum time step of the predictions.
        on_progress: None, or a function that is called with a text at each stage.

    Raises:
        ValueError: an argument is invalid, logs are of different surfaces, or there are too few
            runs.
    """
    names = checks.some_of("free", tuple(free), tuple(PARAMETERS))
    if not names:
        raise ValueError(f"free must name at least one of {', '.join(PARAMETERS)}, got none")
    known = {} if known is None else dict(known)
    checks.some_of("known", tuple(known), tuple(PARAMETERS))
    if both := set(names) & set(known):
        raise ValueError(f"known must not be among free, got {', '.join(sorted(both))}")
    dt = checks.positive("dt", dt, *checks.STEP)
    note: OnProgress = on_progress or (lambda _: None)
    read = [log if isinstance(log, MachineLog) else read_log(Path(log)) for log in logs]
    runs, unused = _collect(read, names)
    shifted = _is_shifted(names, known, runs)
    held = tuple(each for each in names if each != SHIFTS[1] or SHIFTS[0] not in names)
    given = measure_noise(runs) if noise is None else noise
    position, angle = (checks.positive("noise", each) for each in given)
    given = (position, angle)
    search, x, entries = search_pieces(read[0], runs, held, known, given, dt, note)
    note("intervals")
    found = _judge(search, x, entries, dt, held)
    if shifted:
        found = _without(found, SHIFTS, names)
    return replace(found, unused=unused, delay=float(np.median([log.delay for log in read])))


def measure_noise(runs: Sequence[LoggedRun]) -> tuple[float, float]:
    """Estimate the noise [m, rad] of pictures' poses from third differences of successive poses."""
    ends = [np.diff(run.poses, 3, axis=0)[_is_even(run.taken)] for run in runs]
    third = np.abs(np.concatenate(ends))
    if len(third) < 30:
        raise ValueError("noise must be given for logs with so few pictures in a row, got None")
    # The median of a normal distribution's absolute value, and the norm of 1, -3, 3, -1.
    position, angle = np.median(third[:, :2]), np.median(third[:, 2])
    per_noise = float(stats.norm.ppf(0.75)) * math.sqrt(20.0)
    return (
        max(LEAST_NOISE[0], float(position) / per_noise),
        max(LEAST_NOISE[1], float(angle) / per_noise),
    )


def _is_even(taken: Array) -> Array:
    """Return whether three successive intervals between pictures are equal, shape (frames - 3,)."""
    gaps = np.lib.stride_tricks.sliding_window_view(np.diff(taken), 3)
    even: Array = np.ptp(gaps, axis=1) < 0.1 * gaps.min(axis=1)
    return even


def _collect(
    logs: Sequence[MachineLog], names: tuple[str, ...]
) -> tuple[tuple[LoggedRun, ...], dict[str, int]]:
    """Return the usable runs of all logs, and the number of unused runs for each reason."""
    if not logs:
        raise ValueError("logs must hold at least one log, got none")
    if any(vars(log.surface) != vars(logs[0].surface) for log in logs):
        raise ValueError("logs must be of one surface, got several")
    unused: Counter[str] = Counter()
    for log in logs:
        unused.update(log.unused)
    runs = tuple(run for log in logs for run in log.runs)
    timed = tuple(run for run in runs if run.acknowledged)
    if timed and len(timed) < len(runs):
        reason = "parcel has commands without acknowledgement, unlike others"
        unused[reason] = len(runs) - len(timed)
        runs = timed
    least = len(names) + 1
    if len(runs) < least:
        raise ValueError(
            f"logs must have at least {least} usable runs for {len(names)} parameters, "
            f"got {len(runs)}"
        )
    if len(runs) > MAX_RUNS:
        unused[f"{MAX_RUNS} parcels suffice"] = len(runs) - MAX_RUNS
        runs = tuple(runs[k] for k in np.linspace(0, len(runs) - 1, MAX_RUNS).astype(int))
    if "tilt" in names and np.ptp([run.tilt for run in runs]) > 0.0:
        raise ValueError("tilt must be the same in all runs to be free, got several")
    return runs, dict(unused)


def _is_shifted(
    names: tuple[str, ...], known: Mapping[str, float], runs: Sequence[LoggedRun]
) -> bool:
    """Return whether the runs determine only the sum of the latency and the dead time.

    `names` are the parameters to find. `known` has the values of other parameters.
    """
    asked = [name for name in SHIFTS if name in names]
    timed = all(run.acknowledged for run in runs)
    unsure = any(name not in known for name in SHIFTS if name not in names)
    return len(asked) == len(SHIFTS) or (len(asked) == 1 and unsure and not timed)


def _without(found: Estimate, lost: tuple[str, ...], names: tuple[str, ...]) -> Estimate:
    """Return `found` with the inseparable parameters `lost` added. `names` are all parameters."""
    everywhere = (-math.inf, math.inf)
    return replace(
        found,
        values={name: found.values.get(name, 0.0) for name in names},
        intervals={name: everywhere if name in lost else found.intervals[name] for name in names},
        inseparable=(lost, *found.inseparable),
    )


def _judge(
    search: LeastSquares, x: Array, entries: Array, dt: float, names: tuple[str, ...]
) -> Estimate:
    """Return the estimate of the parameters `names`, with intervals by a sandwich estimator.

    A search (`search.py`) has found the parameters `x` (free,), and the pose and velocity `entries`
    (pieces, 6) at the start of each piece of a run. `dt` [s] is the longest time step.
    """
    residuals = search.link(search.misses(x, entries, dt))
    shared, own = search.derivatives(x, entries, dt)
    count, free = int(search.group.max()) + 1, len(names)
    left, scores, squares = search.link(shared), np.zeros((count, free)), np.zeros((count, 2))
    is_picture = np.repeat(search.same < 0, 3)
    for r, (_, rows, block) in zip(search.group, search.groups(own), strict=True):
        basis, _ = np.linalg.qr(block)
        left[rows] -= basis @ (basis.T @ left[rows])
        scores[r] += left[rows].T @ residuals[rows]
        # Links have no noise: entries explain as much of the pictures' noise as their part tells.
        degrees = is_picture[rows].sum() - np.sum(basis[is_picture[rows]] ** 2)
        squares[r] += residuals[rows] @ residuals[rows], degrees
    unknown, inverse = _invert(left.T @ left, search.high - search.low)
    spread = inverse @ scores.T @ scores @ inverse * count / max(1, count - free)
    variance = np.maximum(np.diag(spread), np.diag(inverse))
    sizes = np.sqrt(np.maximum(np.diag(inverse), 1e-300))
    correlation = inverse / np.outer(sizes, sizes)
    alike = np.triu(np.abs(correlation) > ALIKE, 1) & ~np.logical_or.outer(unknown, unknown)
    inseparable = [(names[i], names[j]) for i, j in np.argwhere(alike).tolist()]
    lost = {name for pair in inseparable for name in pair}
    chi2, degrees = squares.sum(axis=0) - (0.0, free)
    is_explained = bool(stats.chi2.sf(chi2, degrees) > MISFIT)
    wide = (1.0 if is_explained else UNEXPLAINED) * np.sqrt(variance)
    wide *= float(stats.t.ppf(0.975, max(1, count - free)))
    wide[[each or name in lost for each, name in zip(unknown, names, strict=True)]] = math.inf
    return Estimate(
        values=dict(zip(names, np.clip(x, search.low, search.high).tolist(), strict=True)),
        intervals={name: _interval(name, x[k], wide[k]) for k, name in enumerate(names)},
        correlations=tuple(map(tuple, correlation.tolist())),
        correlated=names,
        inseparable=tuple(inseparable),
        unknown=tuple(name for each, name in zip(unknown, names, strict=True) if each),
        misfit=float(chi2 / degrees),
        is_explained=is_explained,
        misfits=tuple((squares[:, 0] / np.maximum(squares[:, 1], 1.0)).tolist()),
        frames=int(np.sum(search.same < 0)),
        noise=(float(search.noise[0]), float(search.noise[2])),
    )


def _interval(name: str, value: float, wide: float) -> tuple[float, float]:
    """Return the interval `value` +- `wide`, clipped to the parameter's bounds.

    If `wide` is infinite, the interval is infinite and is not clipped.
    """
    if not math.isfinite(wide):
        return (-math.inf, math.inf)
    each = PARAMETERS[name]
    return max(each.low, float(value - wide)), min(each.high, float(value + wide))


def _invert(information: Array, span: Array) -> tuple[Array, Array]:
    """Invert the information matrix in the directions that the logs determine.

    Args:
        information: (free, free) inverse of the parameters' covariance.
        span: (free,) searched range of each parameter.

    Returns:
        Booleans (free,) that are true for undetermined parameters, and the parameters'
        covariance (free, free).
    """
    scaled = information * np.outer(span, span)
    size, direction = np.linalg.eigh(scaled)
    clear = size > CLEAR**-2
    unknown = (np.abs(direction[:, ~clear]) > 0.05).any(axis=1)
    kept = direction[:, clear] / np.sqrt(size[clear])
    return unknown, kept @ kept.T * np.outer(span, span)
