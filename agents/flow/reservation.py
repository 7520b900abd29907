"""Reservation: a parcel books its way ahead in time, and waits at the gate until it has it."""

from collections.abc import Callable
from typing import Any

from surface_gym.flow.settings import FlowSettings

from .booking import Booking
from .event import EventRule
from .packing import gaps_between
from .parcel_rule import Booleans, Halves, ParcelRule, Rows
from .ways import asked_of, ways_of

MARGIN = 0.02  # [m] kept clear between two parcels


class Reservation(ParcelRule):
    """Lets each parcel in once its whole way is clear of those before it; on the line a rule leads
    it as if it were alone.

    Args:
        settings: of the environment, with "parcels" for actions and a gate.
        lead: the rule, of settings.
        margin: [m] that ways are kept apart.

    Raises:
        ValueError: there is no gate.
    """

    def __init__(
        self,
        settings: FlowSettings,
        lead: Callable[[FlowSettings], ParcelRule] = EventRule,
        margin: float = MARGIN,
    ) -> None:
        super().__init__(settings)
        if not settings.gate:
            raise ValueError("gate must be True for a reservation, got False")
        ways = ways_of(lead, settings, asked_of(settings))
        self._lead = lead(settings)
        self._booking = Booking(settings, ways, gaps_between(list(ways.ways), margin))

    def _halves(self, rows: Rows) -> Halves:
        return self._lead._halves(rows)

    def _open(self, tables: Rows, memory: Any, fresh: Booleans) -> tuple[Halves, Any]:
        return self._booking.open(tables, memory, fresh)
