"""Who is compared on flows: layouts, zones, rules, and agents that learned."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from surface_gym.flow.settings import FlowSettings

from .. import library
from ..controller import Controller
from .cases import CONDITIONS, EXITS, Case
from .event import EventRule
from .fixed import FixedLayout
from .reservation import Reservation
from .sorting import SortEach
from .whole_zone import ArrangedZone, WholeZone, best_zone

FIXED = "fixed layout"
ARRANGED = "zone arranged when free"
TURNED = "zone turned as a whole"
EVENT = "event rule"
EACH = "sort-ppo for each"
RESERVATION = "reservation"
LEARNED = "flow-ppo"
SECONDS = 30.0  # [s] of an episode


@dataclass(frozen=True)
class FlowContender:
    """A controller of flows."""

    name: str
    actions: str  # kind of action
    gate: bool  # whether it says who may enter
    # of the settings it acts in; None where it cannot sort what they ask for
    make: Callable[[FlowSettings], Controller | None]
    conditions: tuple[str, ...] = ("exact", "camera")
    control_period: float = 0.04  # [s]

    def settings(self, case: Case, rate: float) -> FlowSettings:
        """Those of the environment it acts in, parcels coming at a rate [parcels/h]."""
        condition = CONDITIONS[case.condition]
        return FlowSettings(
            case.stream(rate),
            exits=EXITS,
            actions=self.actions,
            sensors=condition.sensors,
            control_period=self.control_period,
            duration=SECONDS,
            actuators=condition.actuators,
            randomisation=condition.randomisation,
            gate=self.gate,
        )


def contenders() -> list[FlowContender]:
    """All of them, what the study's arrangement allows first."""
    found = [
        FlowContender(FIXED, "modules", False, FixedLayout, ("exact",)),
        FlowContender(ARRANGED, "modules", True, partial(_zone, ArrangedZone)),
        FlowContender(TURNED, "modules", True, partial(_zone, WholeZone)),
        FlowContender(EVENT, "parcels", False, EventRule),
        FlowContender(EACH, "parcels", False, SortEach, ("exact",)),
        FlowContender(RESERVATION, "parcels", True, Reservation),
    ]
    if LEARNED in library.names():
        period = library.load(LEARNED).card.control_period
        found.append(FlowContender(LEARNED, "parcels", True, _learned, control_period=period))
    return found


def _zone(kind: type[WholeZone], settings: FlowSettings) -> WholeZone | None:
    columns = best_zone(kind, settings)
    return None if columns is None else kind(settings, columns)


def _learned(settings: FlowSettings) -> Controller:
    del settings
    return library.load(LEARNED)
