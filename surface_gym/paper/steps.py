"""How little the paper's tables tell of the step it took."""

from dataclasses import dataclass
from itertools import product

from surface_gym.paper import sorting, tables
from surface_gym.paper.comparison import Table
from surface_gym.paper.integration import Integration
from surface_gym.paper.tables import Track, untracked
from surface_gym.paper.targets import SIZES, Targets

MILLISECONDS = (0.5, 1, 2, 3, 4, 5, 6, 7, 8, 10)  # steps tried


@dataclass(frozen=True)
class Agreement:
    """How many cells of each table agree when integrated in one way."""

    integration: Integration
    agreeing: dict[str, int]  # by the key of the table


def agreements(targets: Targets, track: Track = untracked) -> tuple[Agreement, ...]:
    """Tables 2, 3 and 4 by explicit steps of 0.5 to 10 ms."""
    integrations = tuple(Integration("explicit", 1e-3 * each) for each in MILLISECONDS)
    found = []
    for integration in track(integrations, "Other steps"):
        each = by_step(targets, integration)
        found.append(Agreement(integration, {table.key: table.agreeing(0) for table in each}))
    return tuple(found)


def by_step(targets: Targets, integration: Integration) -> tuple[Table, Table, Table]:
    """Tables 2, 3 and 4 by one integration."""
    only = (integration,)
    cases = [
        sorting.sort_case(size, speed, 0.0, only)
        for size, speed in product(SIZES, targets.sorting_speeds)
    ]
    return (
        tables.table2(targets, only),
        tables.table3(targets, cases),
        tables.table4(targets, only),
    )
