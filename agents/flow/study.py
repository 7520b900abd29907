"""The comparison on flows, cell by cell: capacities, and rates against the load."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from surface_gym.sharing import Workers

from ..evaluation.work import Advance, compute_kept
from .capacity import EASED, LEAST, Measured, find_capacity, measure
from .cases import CONDITIONS, CURVE, LOADS, Case, cases
from .contenders import FlowContender

FILE = "flow.jsonl"
SEARCHED = 0.0  # instead of a load: the capacity is searched for

FlowKey = tuple[str, str, str, str, float, float]


@dataclass(frozen=True)
class FlowCell:
    """A contender on one stream under one condition."""

    contender: str
    condition: str
    mix: str
    speed: float  # [m/s]
    load: float  # [-] offered, of the ceiling; or SEARCHED
    can: bool  # whether it can sort such parcels at all, one at a time
    capacity: Measured | None  # at the greatest rate that is held; None where none is
    # at 80 % of the capacity; with no capacity at the least rate tried; with a load at that
    eased: Measured | None

    @property
    def key(self) -> FlowKey:
        """What it is the cell of."""
        return ("flow", self.contender, self.condition, self.mix, self.speed, self.load)

    def plain(self) -> dict[str, Any]:
        """As JSON takes it."""
        return asdict(self)


def flow_cell(**plain: Any) -> FlowCell:
    """A cell from what its `plain` gave."""
    for name in ("capacity", "eased"):
        if plain[name] is not None:
            plain[name] = Measured(**plain[name])
    return FlowCell(**plain)


def compute_flow(contender: FlowContender, case: Case, load: float) -> FlowCell:
    """Play a cell."""
    controller = contender.make(contender.settings(case, case.ceiling))
    capacity = eased = None
    if controller is not None and load == SEARCHED:
        capacity = find_capacity(contender, controller, case)
        rate = EASED * capacity.rate if capacity is not None else LEAST * case.ceiling
        eased = measure(contender, controller, case, rate)
    elif controller is not None:
        eased = measure(contender, controller, case, load * case.ceiling)
    return FlowCell(
        contender.name, case.condition, case.mix, case.speed, load, controller is not None,
        capacity, eased,
    )  # fmt: skip


def flow_jobs(
    contenders: Sequence[FlowContender], loads: Sequence[float] | None = None
) -> dict[FlowKey, Callable[[], FlowCell]]:
    """Every cell to compute, by its key; the slowest first, to fill the cores."""
    searched = [
        (contender, case, SEARCHED)
        for contender in contenders
        for condition in contender.conditions
        for case in cases(condition)
    ]
    loaded = [
        (contender, CURVE, load)
        for contender in contenders
        for load in (LOADS if loads is None else loads)
    ]
    # A search goes on for long where there is no gate.
    orders = sorted(searched, key=lambda order: (order[0].gate, -order[1].speed)) + loaded
    return {
        ("flow", who.name, case.condition, case.mix, case.speed, load): partial(
            compute_flow, who, case, load
        )
        for who, case, load in orders
    }


def compute_flows(
    contenders: Sequence[FlowContender],
    workers: Workers,
    folder: Path | None = None,
    advance: Advance = lambda *_: None,
    loads: Sequence[float] | None = None,
) -> list[FlowCell]:
    """Compute all cells, in an order that does not depend on the processes.

    Args:
        contenders: to compare.
        workers: processes to share the work among, or a cluster.
        folder: cells are kept in its flow.jsonl, and those found there are not computed again.
        advance: called with cells done, cells in all and the name of the latest.
        loads: [-] of the ceiling, to hold rates against; None: LOADS.
    """
    file = None if folder is None else folder / FILE
    found = compute_kept(flow_jobs(contenders, loads), flow_cell, workers, file, advance)
    names, conditions = [contender.name for contender in contenders], list(CONDITIONS)
    return sorted(
        found.values(),
        key=lambda cell: (
            names.index(cell.contender), conditions.index(cell.condition), *cell.key[3:],
        ),
    )  # fmt: skip
