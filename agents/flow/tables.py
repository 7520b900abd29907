"""The comparison on flows as tables, and as rows of numbers."""

import math
from collections.abc import Callable, Sequence
from typing import Any

from ..evaluation.table import NOTHING, Table
from .capacity import REPLICATIONS, Measured
from .cases import CONDITIONS, CURVE, EXACT, LEAST_RIGHT, Case, cases
from .contenders import ARRANGED, EVENT, FIXED, TURNED
from .results import BOUND, CEILING, REFERENCES, Results
from .study import SEARCHED

# Short names of what capacities are held against, for headings.
OVER = {ARRANGED: "arranged", TURNED: "turned", EVENT: "event", BOUND: "packed", CEILING: "ceiling"}
CANNOT = "cannot"  # sort all kinds, even one at a time
NONE = "0"

Text = Callable[[str, Case], str]


def flow_tables(results: Results) -> list[Table]:
    """All of them, the one that tells most first."""
    return [
        headline(results),
        *(capacities(results, condition) for condition in CONDITIONS),
        *(eased(results, condition) for condition in CONDITIONS),
        *(touches(results, condition) for condition in CONDITIONS),
        *(ratios(results, over) for over in REFERENCES),
    ]


def headline(results: Results) -> Table:
    """Everything of one stream, exact."""
    case = CURVE
    header = (
        "controller", "parcels/h", "95 %", "touches/1000",
        *(f"/{OVER[over]}" for over in REFERENCES),
    )  # fmt: skip
    rows = []
    for name in (*results.names, BOUND, CEILING):
        cell = results.cell(name, case)
        capacity = None if cell is None else cell.capacity
        rows.append(
            (
                name,
                _rate(results, name, case),
                NOTHING if capacity is None else f"±{capacity.margin:.0f}",
                NOTHING if capacity is None else f"{capacity.touches_per_1000:.0f}",
                *(_ratio(results, name, over, case) for over in REFERENCES),
            )
        )
    told = (
        f"{case.label}, 6 m of line, to leave left, right or straight on at equal odds. "
        f"{_held(EXACT.name)} "
        "Behind the strokes: over the capacities of the two zones and the event rule, over single "
        "parcels' ways packed as close as they go, and over parcels end to end, 5 cm apart."
    )
    return Table("flow", told, header, tuple(rows))


def capacities(results: Results, condition: str) -> Table:
    """Right deliveries an hour at the capacity, all streams."""

    def text(name: str, case: Case) -> str:
        cell = results.cell(name, case)
        if cell is None or cell.capacity is None:
            return _rate(results, name, case)
        return f"{cell.capacity.rate:.0f} ±{cell.capacity.margin:.0f}"

    names = [*_tried(results, condition), BOUND, CEILING]
    label = CONDITIONS[condition].label
    told = f"{_held(condition)} {CONDITIONS[condition].meaning}"
    return _grid(f"flow: capacity, {label}", told, names, condition, text)


def touches(results: Results, condition: str) -> Table:
    """What the capacity costs."""

    def text(name: str, case: Case) -> str:
        cell = results.cell(name, case)
        if cell is None or cell.capacity is None:
            return _rate(results, name, case)
        return f"{cell.capacity.touches_per_1000:.0f}"

    label = CONDITIONS[condition].label
    told = "times that two begin to touch, per 1000 deliveries, at the capacity"
    names = _tried(results, condition)
    return _grid(f"flow: touches at the capacity, {label}", told, names, condition, text)


def ratios(results: Results, over: str) -> Table:
    """Capacities over another's, exact."""
    names = [name for name in results.names if name not in (over, FIXED)]
    told = f"capacity over that of: {over}; exact sensors"
    return _grid(
        f"flow: over {over}", told, names, EXACT.name,
        lambda name, case: _ratio(results, name, over, case),
    )  # fmt: skip


def eased(results: Results, condition: str) -> Table:
    """How it goes at 80 % of the capacity."""

    def text(name: str, case: Case) -> str:
        cell = results.cell(name, case)
        if cell is None or cell.eased is None:
            return CANNOT
        return ", ".join(_goes(cell.eased))

    told = (
        "share of deliveries that are right, touches per 1000, and seconds waited at the entry, "
        "offered 80 % of the capacity; who has none is offered a sixteenth of the ceiling"
    )
    label = CONDITIONS[condition].label
    names = _tried(results, condition)
    return _grid(f"flow: at 80 % of the capacity, {label}", told, names, condition, text)


def _grid(title: str, told: str, names: Sequence[str], condition: str, text: Text) -> Table:
    """A row a contender, a column a stream."""
    streams = cases(condition)
    header = ("controller", *(case.label for case in streams))
    rows = [(name, *(text(name, case) for case in streams)) for name in names]
    return Table(title, told, header, tuple(rows))


def _held(condition: str) -> str:
    return (
        "Right deliveries an hour at the highest steady rate at which "
        f"{100.0 * LEAST_RIGHT[condition]:g} % of deliveries are right and nothing jams, "
        f"with Student's 95 % interval over {REPLICATIONS} replications."
    )


def _tried(results: Results, condition: str) -> list[str]:
    case = Case(CURVE.mix, CURVE.speed, condition)
    return [name for name in results.names if results.cell(name, case) is not None]


def _rate(results: Results, name: str, case: Case) -> str:
    rate = results.rate(name, case)
    if math.isnan(rate):
        return NOTHING
    if rate > 0.0:
        return f"{rate:.0f}"
    cell = results.cell(name, case)
    return NONE if cell is not None and cell.can else CANNOT


def _ratio(results: Results, name: str, over: str, case: Case) -> str:
    ratio = results.ratio(name, over, case)
    return f"{ratio:.2f}" if math.isfinite(ratio) else NOTHING


def _goes(measured: Measured) -> tuple[str, str, str]:
    return (
        f"{measured.share_right:.4f}",
        f"{measured.touches_per_1000:.1f}",
        f"{measured.waited:.2f}",
    )


def flow_numbers(results: Results) -> list[dict[str, Any]]:
    """Every number, a row each."""
    rows = []
    for cell in results.cells:
        case = Case(cell.mix, cell.speed, cell.condition)
        values: dict[str, float] = {}
        if cell.load == SEARCHED:
            values["capacity"] = results.rate(cell.contender, case)
            if cell.capacity is not None:
                values["capacity_margin"] = cell.capacity.margin
                values["capacity_offered"] = cell.capacity.offered
            values |= {
                f"capacity over {over}": results.ratio(cell.contender, over, case)
                for over in REFERENCES
            }
            values["bound"], values["ceiling"] = (
                results.rate(name, case) for name in (BOUND, CEILING)
            )
        if cell.eased is not None:
            values |= {
                "offered": cell.eased.offered,
                "rate": cell.eased.rate,
                "rate_margin": cell.eased.margin,
                "share_right": cell.eased.share_right,
                "touches_per_1000": cell.eased.touches_per_1000,
                "waiting": cell.eased.waited,
                "jams": float(cell.eased.jams),
            }
        rows += [
            {
                "controller": cell.contender,
                "condition": cell.condition,
                "parcels": cell.mix,
                "speed": cell.speed,
                "load": "80 % of the capacity" if cell.load == SEARCHED else cell.load,
                "figure": name,
                "value": value if math.isfinite(value) else None,
            }
            for name, value in values.items()
        ]
    return rows
