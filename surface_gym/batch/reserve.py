"""Starts drawn ahead of need, many at a time, so that one costs no more than a copy."""

from collections.abc import Callable

import numpy as np

from surface_gym.batch.starts import Rows
from surface_gym.dynamics.types import Array, Integers

MOST_AHEAD = 64  # starts of a lane drawn at a time, where nothing else is drawn from its generator
MOST_KEPT = 65536  # starts of all lanes


class Reserve:
    """Numbers for the starts of every lane, each lane's in the order of its own generator; and what
    the starts come to.

    Args:
        lanes: their number.
        draws: numbers of a start.
        shared: whether the generators are shared with other draws, which come between two starts.
        most_kept: starts of all lanes.
    """

    def __init__(self, lanes: int, draws: int, shared: bool, most_kept: int = MOST_KEPT) -> None:
        ahead = 1 if shared else min(MOST_AHEAD, max(1, most_kept // lanes))
        self.generators: list[np.random.Generator | None] = [None] * lanes
        self._numbers = np.zeros((lanes, ahead, draws))
        self._used = np.full(lanes, ahead)
        self._ahead = ahead
        self._rows: Rows | None = None  # of all lanes' starts, one after another
        self._laid = np.zeros(lanes, dtype=np.bool_)  # whether a lane's are up to date

    def seed(self, lane: int, generator: np.random.Generator) -> None:
        """Draw a lane's numbers from a generator; one that it has already goes on."""
        if self.generators[lane] is not generator:
            self.generators[lane] = generator
            self._used[lane] = self._ahead

    def take(self, chosen: Integers) -> Array:
        """The next numbers (count, draws) of the chosen lanes (count,), which are seeded."""
        return self._numbers[chosen, self._next(chosen)]

    def taken(self, chosen: Integers) -> Array:
        """The numbers (count, draws) that the chosen lanes (count,) took last."""
        return self._numbers[chosen, self._used[chosen] - 1]

    def take_rows(self, chosen: Integers, lay_out: Callable[[Array], Rows]) -> Rows:
        """What the next starts of the chosen lanes (count,), which are seeded, come to.

        Args:
            chosen: lanes.
            lay_out: makes rows of numbers (starts, draws).
        """
        used = self._next(chosen)
        stale = chosen[~self._laid[chosen]]
        if len(stale) > 0:
            places = (stale[:, np.newaxis] * self._ahead + np.arange(self._ahead)).ravel()
            rows = lay_out(self._numbers[stale].reshape(len(places), -1))
            if self._rows is None:
                starts = self._laid.size * self._ahead
                self._rows = Rows._make(
                    np.zeros((starts, *values.shape[1:]), dtype=values.dtype) for values in rows
                )
            for kept, values in zip(self._rows, rows, strict=True):
                kept[places] = values
            self._laid[stale] = True
        assert self._rows is not None
        here = chosen * self._ahead + used
        return Rows._make(values[here] for values in self._rows)

    def _next(self, chosen: Integers) -> Integers:
        """The place (count,) of each lane's next start."""
        used = self._used[chosen]
        if used.max(initial=0) == self._ahead:
            for lane in chosen[used == self._ahead].tolist():
                generator = self.generators[lane]
                assert generator is not None
                self._numbers[lane] = generator.random(self._numbers.shape[1:])
                self._used[lane] = 0
                self._laid[lane] = False
            used = self._used[chosen]
        self._used[chosen] += 1
        return used
