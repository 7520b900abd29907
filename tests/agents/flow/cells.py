"""Cells of the comparison on flows, made by hand."""

from agents.flow.capacity import Measured
from agents.flow.cases import CURVE, LOADS, cases
from agents.flow.contenders import ARRANGED, EVENT, FIXED, RESERVATION, TURNED, contenders
from agents.flow.results import Results
from agents.flow.study import SEARCHED, FlowCell

SHARES = {FIXED: 0.0, ARRANGED: 0.0, TURNED: 0.2, EVENT: 0.4, RESERVATION: 0.6}  # of the ceiling
RULES = [contender for contender in contenders() if contender.name in SHARES]


def at(rate: float, touches: float = 0.0, right: float = 1.0) -> Measured:
    """Ten replications at about a rate, a parcel more or less."""
    count = round(rate * 20.0 / 3600.0)
    delivered = [count + (-1) ** k for k in range(10)]
    return Measured(
        rate, [round(right * n) for n in delivered], delivered, [touches] * 10, [0.25] * 10, 0, 20.0
    )  # fmt: skip


def flow_cells() -> list[FlowCell]:
    """The layout holds nothing, one zone cannot sort, the others hold shares of the ceiling."""
    made = []
    for name, share in SHARES.items():
        for case in (*cases(), *(cases("camera") if name != FIXED else ())):
            rate = share * case.ceiling
            capacity = at(rate, touches=1.0) if share else None
            least = at(0.8 * rate) if share else at(case.ceiling / 16.0, right=1 / 3)
            can = name != ARRANGED
            made.append(
                FlowCell(
                    name, case.condition, case.mix, case.speed, SEARCHED, can, capacity,
                    least if can else None,
                )
            )  # fmt: skip
        for load in LOADS:
            point = at(min(load, share) * CURVE.ceiling) if name != ARRANGED else None
            can = point is not None
            made.append(FlowCell(name, "exact", CURVE.mix, CURVE.speed, load, can, None, point))
    return made


def made_up() -> Results:
    """With bounds at 0.8 of the ceiling."""
    bounds = {(case.mix, case.speed): 0.8 * case.ceiling for case in cases()}
    return Results(tuple(flow_cells()), bounds)
