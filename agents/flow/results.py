"""What the cells of the comparison on flows come to, beside what nobody can exceed."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .capacity import Measured
from .cases import CURVE, LOADS, Case, cases
from .contenders import ARRANGED, EVENT, TURNED, FlowContender
from .event import EventRule
from .packing import gaps_between, packed_rate
from .reservation import MARGIN
from .study import SEARCHED, FlowCell
from .ways import asked_of, ways_of

BOUND = "single ways packed"
CEILING = "ceiling"
REFERENCES = (ARRANGED, TURNED, EVENT, BOUND, CEILING)  # that capacities are held against


@dataclass(frozen=True)
class Results:
    """All cells, and the bound of every stream."""

    cells: tuple[FlowCell, ...]
    bounds: dict[tuple[str, float], float]  # [parcels/h] by mix and speed

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of who was compared, in their order."""
        return tuple(dict.fromkeys(cell.contender for cell in self.cells))

    @cached_property
    def _found(self) -> dict[tuple[str, Case, float], FlowCell]:
        return {
            (cell.contender, Case(cell.mix, cell.speed, cell.condition), cell.load): cell
            for cell in self.cells
        }

    def cell(self, name: str, case: Case, load: float = SEARCHED) -> FlowCell | None:
        """That of a contender; None where it was not tried."""
        return self._found.get((name, case, load))

    def rate(self, name: str, case: Case) -> float:
        """[parcels/h] capacity of a contender, or what the bound and the ceiling allow; 0 where
        there is none, nan where it was not tried.
        """
        if name == BOUND:
            return self.bounds[case.mix, case.speed]
        if name == CEILING:
            return case.ceiling
        cell = self.cell(name, case)
        if cell is None:
            return float("nan")
        return 0.0 if cell.capacity is None else cell.capacity.rate

    def ratio(self, name: str, over: str, case: Case) -> float:
        """[-] of the rates of two; infinite over one that has none, nan where neither has any."""
        rate, reference = self.rate(name, case), self.rate(over, case)
        if reference > 0.0:
            return rate / reference
        return float("inf") if rate > 0.0 else float("nan")

    def curve(self, name: str) -> list[Measured | None]:
        """What came of each load."""
        cells = [self.cell(name, CURVE, load) for load in LOADS]
        return [None if cell is None else cell.eased for cell in cells]


def results_of(contenders: Sequence[FlowContender], cells: Sequence[FlowCell]) -> Results:
    """Put cells together, and reckon the bounds.

    Args:
        contenders: who was compared; the bounds are for an environment with actions for parcels.
        cells: of all of them.
    """
    among = next(each for each in contenders if each.actions == "parcels")
    return Results(
        tuple(cells), {(case.mix, case.speed): bound_of(among, case) for case in cases()}
    )


def bound_of(contender: FlowContender, case: Case) -> float:
    """[parcels/h] of ways that an event rule leads single parcels on, packed as close as they go
    with 2 cm between them.
    """
    settings = contender.settings(case, case.ceiling)
    asked = asked_of(settings)
    gaps = gaps_between(list(ways_of(EventRule, settings, asked).ways), MARGIN)
    return packed_rate(gaps, np.ones(len(asked)))
