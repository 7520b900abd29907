"""Zones whose columns turn together, for one parcel at a time: what the study allows, and more."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from surface_gym import checks
from surface_gym.flow.features import PRESENT, WAITS
from surface_gym.flow.settings import FlowSettings

from ..rules.axes import axes_of
from .booking import Book, Booking
from .packing import Numbers, gaps_between, packed_rate
from .parcel_rule import PAST_START, SIDE, Booleans, Rows, fresh_lanes
from .passing import passing
from .ways import Asked, Ways, asked_of, ways_of

LENGTH, HALF, FIFTH = 6, 0.175, 0.05  # of a parcel in its row: (half of it - 0.175 m) / 0.05 m
MARGIN = 0.02  # [m] kept clear between two parcels before and after the zone
LONGER = 2  # columns by which a zone may be longer than the shortest that does
FAR = 100.0  # [m] farther than any two parcels on a line are apart
UNIT = 0.5  # [m] in which a row tells how far the rear is past the exit's start


class ZoneMemory(NamedTuple):
    """What a zone's controller remembers, lane by lane."""

    book: Book | None  # None where parcels come one by one
    side: Numbers  # (lanes,) that the zone leads to: 1 left, -1 right, 0 straight on


class WholeZone:
    """Columns behind the lead-in turn together, under the one parcel that is over them: at 90 deg
    until it is wholly past the zone's start, then at 45 deg to its side. The next enters the zone
    once it is free. All other columns stay at 90 deg.

    Args:
        settings: of the environment, with "modules" for actions and a gate.
        columns: of the zone.
        alone: whether parcels come one by one, so that none needs to be held at the gate.

    Raises:
        ValueError: another kind of action, no gate, more columns than obey, too few for every
            parcel to leave by its exit, or an exit that starts after the zone.
    """

    def __init__(self, settings: FlowSettings, columns: int, alone: bool = False) -> None:
        checks.one_of("actions", settings.actions, ("modules",))
        if not settings.gate:
            raise ValueError(
                "gate must be True for a zone that one parcel has at a time, got False"
            )
        _, self._rows, _, self._obeying = settings.zone
        if not 1 <= columns <= self._obeying:
            raise ValueError(f"columns must be between 1 and {self._obeying}, got {columns!r}")
        span = zone_span(settings, columns)
        for each in settings.exits:
            if each.side != 0 and each.first > span[0]:
                raise ValueError(
                    f"exits must start at {span[0]:g} m, where the zone does, or before, "
                    f"got {each.name!r} from {each.first:g} m"
                )
        self._axes = axes_of(settings)
        self._columns = columns
        self._length = span[1] - span[0]
        self._booking: Booking | None = None
        if not alone:
            plan = _plan(self._lone, settings, asked_of(settings), span)
            if plan is None:
                raise ValueError(
                    f"columns must be enough for every parcel to leave by its exit, got {columns!r}"
                )
            self._booking = Booking(settings, *plan)

    def _lone(self, settings: FlowSettings) -> "WholeZone":
        return type(self)(settings, self._columns, alone=True)

    def predict(
        self,
        observation: Rows,
        state: ZoneMemory | None = None,
        episode_start: Booleans | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, ZoneMemory]:
        """Action for an observation (rows, features), or actions for (lanes, rows, features).

        See `agents.controller.Controller`.
        """
        del deterministic
        tables = observation.reshape(-1, *observation.shape[-2:])
        lanes = len(tables)
        fresh = fresh_lanes(lanes, state, episode_start)
        before = np.zeros(lanes) if state is None else np.where(fresh, 0.0, state.side)
        side = self._side(tables, before)
        choice = self._axes.towards(side)
        grid = np.full((lanes, self._rows, self._obeying), self._axes.roll)
        grid[:, :, : self._columns] = choice[:, np.newaxis, np.newaxis]
        opens, book = np.ones(lanes, dtype=np.int64), None
        if self._booking is not None:
            opens, book = self._booking.open(tables, None if state is None else state.book, fresh)
        actions = np.concatenate([grid.reshape(lanes, -1), opens[:, np.newaxis]], axis=1)
        return (actions[0] if observation.ndim == 2 else actions), ZoneMemory(book, side)

    def _side(self, tables: Rows, before: Numbers) -> Numbers:
        """(lanes,) that the zone is to lead to, by what it led to before: the side of the parcel
        that is wholly in it; 0 where there is none.
        """
        del before
        rear = _rear(tables)
        over = _on_the_line(tables) & (rear > 0.0) & (rear < self._length)
        return _side_of(tables, over, -rear, np.zeros(len(tables)))


class ArrangedZone(WholeZone):
    """Columns behind the lead-in are arranged together, for the next parcel while the zone is free
    of all: at 45 deg to its side, or at 90 deg if it goes straight on. So they stay until it is
    out, as the study's do. Arguments and errors are those of `WholeZone`.
    """

    def _side(self, tables: Rows, before: Numbers) -> Numbers:
        rear = _rear(tables)
        front = rear + 2.0 * (HALF + FIFTH * tables[..., LENGTH])
        here = _on_the_line(tables)
        occupied = (here & (front > 0.0) & (rear < self._length)).any(axis=1)
        waits = tables[..., WAITS] > 0.5
        coming = (here | waits) & (front <= 0.0)
        # The one at the gate comes after all on the line, wherever it is shown.
        nearest = np.where(waits, front - FAR, front)
        return np.where(occupied, before, _side_of(tables, coming, nearest, before))


def zone_span(settings: FlowSettings, columns: int) -> tuple[float, float]:
    """[m] of x over which the first columns that obey lie."""
    _, _, first, _ = settings.zone
    plant = settings.chosen_plant
    return plant.column_edge(first), plant.column_edge(first + columns)


def best_zone(kind: type[WholeZone], settings: FlowSettings) -> int | None:
    """The columns of a zone that lets most parcels in, of the shortest by which every parcel of a
    stream leaves by its exit and the two next; None where no zone sorts them all.

    The parcels are tried alone on the line, whenever they come and whatever varies.

    Args:
        kind: of zone.
        settings: of the environment, with "modules" for actions and a gate.
    """
    _, _, _, obeying = settings.zone
    asked = asked_of(settings)
    rates: dict[int, float] = {}
    for columns in range(1, obeying + 1):
        if rates and columns > min(rates) + LONGER:
            break

        def lone(alone: FlowSettings, columns: int = columns) -> WholeZone:
            return kind(alone, columns, alone=True)

        plan = _plan(lone, settings, asked, zone_span(settings, columns))
        if plan is not None:
            rates[columns] = packed_rate(plan[1], np.ones(len(asked)))
    return max(rates, key=lambda columns: rates[columns]) if rates else None


def _plan(
    lone: Callable[[FlowSettings], WholeZone],
    settings: FlowSettings,
    asked: list[Asked],
    span: tuple[float, float],
) -> tuple[Ways, Numbers] | None:
    """The ways of parcels, and the gaps (ways, ways) [s] by which each finds the zone free and
    comes near nobody; None where one leaves by another exit than its own.
    """
    passed = passing(lone, settings, asked, span)
    if not passed.right.all():
        return None
    ways = ways_of(lone, settings, asked)
    clear = gaps_between(list(ways.ways), MARGIN)
    return ways, np.maximum(clear, passed.gaps(settings.control_period))


def _rear(tables: Rows) -> Numbers:
    """(lanes, rows) [m] how far each parcel's rear is past the zone's start."""
    return UNIT * tables[..., PAST_START].astype(np.float64)


def _on_the_line(tables: Rows) -> Booleans:
    """(lanes, rows) whether there is a parcel that has entered."""
    return (tables[..., PRESENT] > 0.5) & (tables[..., WAITS] < 0.5)


def _side_of(tables: Rows, among: Booleans, rank: Numbers, otherwise: Numbers) -> Numbers:
    """(lanes,) side of the exit of who ranks highest among some (lanes, rows); else another."""
    chosen = np.arange(len(tables)), np.where(among, rank, -np.inf).argmax(axis=1)
    side: Numbers = np.where(among.any(axis=1), tables[..., SIDE][chosen], otherwise)
    return side
