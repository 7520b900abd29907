"""The threads that move a batch's lanes, each with scratch of its own."""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from surface_gym.physics.types import Integers, Scratch, make_scratch

FEWEST = 4  # lanes that a thread is worth its while for
LOOK = 20_000  # steps of a parcel that a thread takes in a row: Ctrl-C waits for no more
PARTS = 16  # of a thread's share of the lanes; the last two are taken by whoever is done early


class Workers:
    """One thread or more; results do not depend on their number.

    Args:
        threads: their number.
        steps: of parcels, that a lane takes in a call.
        make: makes the physics' scratch of one.
    """

    def __init__(self, threads: int, steps: int, make: Callable[[], Any] = make_scratch) -> None:
        self._most = max(1, LOOK // steps)  # lanes in a row
        self._pool: ThreadPoolExecutor | None = None
        self._process = os.getpid()
        # Of the physics, and of the sensor.
        self._scratches = [(make(), make_scratch()) for _ in range(threads)]

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_pool": None}

    @property
    def scratches(self) -> tuple[Any, Scratch]:
        """Those of the first thread."""
        return self._scratches[0]

    def run(
        self, threads: int, move: Callable[..., int], arrays: tuple[Any, ...], chosen: Integers
    ) -> int:
        """Call `move(*arrays, scratch, sensor's scratch, chosen)` over the chosen lanes.

        Returns:
            The sum of what it returns.
        """
        if threads == 1:
            return self._in_pieces(move, (*arrays, *self._scratches[0]), chosen)
        if self._pool is None or self._process != os.getpid():  # a fork has none of the threads
            self._pool = ThreadPoolExecutor(len(self._scratches) - 1)
            self._process = os.getpid()
        # A thread has the same lanes each time, which its core has in its memory still.
        cuts = [k * len(chosen) // (PARTS * threads) for k in range(PARTS * threads + 1)]
        firsts = range(0, PARTS * threads, PARTS)
        left = iter(
            [
                chosen[cuts[k] : cuts[k + 1]]
                for first in firsts
                for k in (first + PARTS - 2, first + PARTS - 1)
            ]
        )

        def work(thread: int) -> int:
            scratches = self._scratches[thread]
            own = chosen[cuts[PARTS * thread] : cuts[PARTS * thread + PARTS - 2]]
            given = (*arrays, *scratches)
            done = self._in_pieces(move, given, own)
            return done + sum(self._in_pieces(move, given, part) for part in left)

        others = [self._pool.submit(work, thread) for thread in range(1, threads)]
        return work(0) + sum(other.result() for other in others)

    def _in_pieces(self, move: Callable[..., int], given: tuple[Any, ...], chosen: Integers) -> int:
        """Call `move(*given, chosen)`, some lanes at a time, between which Python sees Ctrl-C."""
        if len(chosen) <= self._most:
            return move(*given, chosen)
        firsts = range(0, len(chosen), self._most)
        return sum(move(*given, chosen[first : first + self._most]) for first in firsts)
