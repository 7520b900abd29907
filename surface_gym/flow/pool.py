"""The bodies of a batch of flows: each parcel once, as long as an episode has use for it."""

from collections.abc import Callable, Iterable

import numpy as np

from surface_gym.core.resets import FEWEST_EDGES, Placement, with_body
from surface_gym.parcel import Parcel
from surface_gym.state import BodyTable

_FIRST_ROOM = 16


class BodyPool:
    """Rows of `BodyTable` whose surface is the same for all.

    Args:
        place: the placement of a parcel.
        any_parcel: one of those to come, for what all have in common.
    """

    def __init__(self, place: Callable[[Parcel], Placement], any_parcel: Parcel) -> None:
        self._place = place
        common = place(any_parcel)
        self.bodies = BodyTable(
            rotor=common.rotor[np.newaxis].copy(),
            obeys=common.obeys[np.newaxis].copy(),
            body=np.zeros((_FIRST_ROOM, common.body.size)),
            edges=np.zeros((_FIRST_ROOM, FEWEST_EDGES, 3)),
            corners=np.zeros((_FIRST_ROOM, FEWEST_EDGES, 2)),
            zone=common.zone[np.newaxis].copy(),
        )
        self._row_of: dict[Parcel, int] = {}
        self._parcel_of: dict[int, Parcel] = {}
        self._users: dict[int, int] = {}
        self._free = list(range(_FIRST_ROOM))[::-1]

    def take(self, parcel: Parcel) -> int:
        """The row of a parcel's body, for one more user.

        Raises:
            ValueError: the parcel does not fit the plant.
        """
        row = self._row_of.get(parcel)
        if row is None:
            placement = self._place(parcel)
            if not self._free:
                self._double()
            row = self._free.pop()
            self.bodies = with_body(self.bodies, row, placement)
            self._row_of[parcel] = row
            self._parcel_of[row] = parcel
            self._users[row] = 0
        self._users[row] += 1
        return row

    def give_back(self, rows: Iterable[int]) -> None:
        """One user of each of these rows, as often as it stands there, has no more use for it."""
        for row in rows:
            self._users[row] -= 1
            if self._users[row] == 0:
                del self._users[row], self._row_of[self._parcel_of.pop(row)]
                self._free.append(row)

    def parcel(self, row: int) -> Parcel:
        """The parcel of a row in use."""
        return self._parcel_of[row]

    def _double(self) -> None:
        sites, room = self.bodies, len(self.bodies.body)
        self.bodies = sites._replace(
            **{
                name: np.concatenate([getattr(sites, name), np.zeros_like(getattr(sites, name))])
                for name in ("body", "edges", "corners")
            }
        )
        self._free = list(range(room, 2 * room))[::-1]
