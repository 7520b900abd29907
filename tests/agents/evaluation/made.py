"""Results made by hand."""

from collections.abc import Sequence

import numpy as np

from surface_gym.agents.evaluation import streams
from surface_gym.agents.evaluation.benchmark import Result
from surface_gym.agents.evaluation.capacity import Measurement
from surface_gym.agents.evaluation.robustness import FACTORS, Factor, Level, SweepResult
from surface_gym.agents.evaluation.streams import StreamResult, cases
from surface_gym.tasks import Sort
from surface_gym.tasks.benchmark import PARCELS, SpeedGrid

STARTS = 24  # of the sweep
# Of what the entrance takes.
SHARES = {
    streams.ARRANGED: 0.0, streams.SERIES: 0.0, streams.COLUMNS: 0.4, streams.MODULES: 0.6,
    streams.EVENT: 0.6,
}  # fmt: skip
HARDWARE = {  # actuators, and the columns and modules of one
    streams.ARRANGED: (0, 0, 1), streams.SERIES: (8, 7, 28), streams.COLUMNS: (55, 1, 4),
    streams.MODULES: (220, 0, 1), streams.EVENT: (220, 0, 1),
}  # fmt: skip
RULES = [method for method in streams.stream_methods() if method.name in SHARES]


def sort_grid() -> SpeedGrid:
    grid = Sort().benchmark().grid
    assert grid is not None
    return grid


GRID = sort_grid()


def sort_result(
    name: str, least: dict[str, float], time: float = 1.0, seed: int = 0, preset: str = "exact"
) -> Result:
    """One that sorts from a speed on, by parcel, in a time over the speed."""
    sorts = np.zeros(GRID.shape, bool)
    for k, parcel in enumerate(PARCELS):
        sorts[k] = (least[parcel] - 1e-9 <= GRID.speeds)[:, np.newaxis]
    times = np.broadcast_to((time / GRID.speeds)[:, np.newaxis], GRID.shape)
    return Result(
        "sort", name, preset, seed, sorts.ravel().tolist(), times.ravel().tolist(),
        {"columns": [4] * sorts.size}, 1e-5,
    )  # fmt: skip


def slow_result(name: str, errors: Sequence[float], seed: int = 0, preset: str = "exact") -> Result:
    """One that leaves at errors of the ratio."""
    success = [abs(error) <= 0.01 for error in errors]
    return Result(
        "slow", name, preset, seed, success, [1.0] * len(success), {"ratio_error": list(errors)},
        2e-5,
    )  # fmt: skip


def sweep_result(
    task: str, name: str, factor: Factor, share: float, seed: int = 0,
    levels: Sequence[Level] | None = None, starts: int = STARTS,
) -> SweepResult:  # fmt: skip
    """One whose first starts succeed, a share at the first level and less at each that follows."""
    chosen = list(factor.swept if levels is None else levels)
    counts = np.linspace(share * starts, 0.5 * share * starts, len(chosen)).round().astype(int)
    success = ["1" * count + "0" * (starts - count) for count in counts.tolist()]
    return SweepResult(task, name, factor.name, seed, starts, chosen, success, [0.01] * len(chosen))


def sweep_results(task: str, shares: dict[str, float], seeds: int = 1) -> list[SweepResult]:
    """Results of methods by their success, all factors of the task."""
    return [
        sweep_result(task, name, factor, share, seed)
        for name, share in shares.items()
        for factor in FACTORS.values()
        for seed in range(seeds)
        if not (factor.of_lines and task == "track")
    ]


def at(rate: float, touches: float = 0.0, right: float = 1.0) -> Measurement:
    """Ten replications at about a rate, a parcel more or less; eight turns a parcel."""
    count = round(rate * 20.0 / 3600.0)
    delivered = [count + (-1) ** k for k in range(10)]
    return Measurement(
        rate, [round(right * n) for n in delivered], delivered, [touches] * 10, [0.25] * 10, 0,
        20.0, 8.0,
    )  # fmt: skip


def stream_rows() -> list[StreamResult]:
    """One zone cannot sort, zones in series sustain nothing, the others sustain a share."""
    made = []
    for name, share in SHARES.items():
        actuators, columns, modules = HARDWARE[name]
        for case in (*cases(), *cases("camera")):
            rate = share * case.ceiling
            capacity = at(rate, touches=1.0) if share else None
            made.append(
                StreamResult(
                    name, case.preset, case.mix, case.speed, case.exits, actuators, columns,
                    modules, capacity, 1.1 * rate if name == streams.MODULES else None,
                )
            )  # fmt: skip
    return made


def stream_results() -> streams.StreamResults:
    return streams.StreamResults(tuple(stream_rows()))
