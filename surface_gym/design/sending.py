"""Runs shared among threads of this process, or sent to the nodes of a cluster."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from queue import SimpleQueue

import numpy as np
from numpy.typing import NDArray

from surface_gym.design.passage import STEPS, Deck, Passages, send
from surface_gym.physics.types import Bodies, Scratch, make_scratch
from surface_gym.sharing import Cluster, Workers, quiet, share

CHUNK = 32  # runs that a thread takes at a time
MOST_STEPS = 128_000  # that they may take: Ctrl-C waits for no more
BUNDLE = 5000  # runs that a node takes at a time, at most: some tenths of a second
LEAST = 500  # below which runs are not sent apart

Advance = Callable[[int, int], None]  # runs done, and how many there are


def send_all(
    deck: Deck, bodies: Bodies, passages: Passages, dt: float, workers: Workers, advance: Advance
) -> None:
    """Carry runs out, into their passages."""
    if isinstance(workers, Cluster):
        _to_nodes(deck, bodies, passages, dt, workers, advance)
    elif workers == 1 or len(passages.state) <= CHUNK:
        _here(deck, bodies, passages, dt, advance)
    else:
        _to_threads(deck, bodies, passages, dt, workers, advance)


def _chunk(passages: Passages) -> int:
    """Runs that a thread takes at a time: fewer where they may take many steps."""
    return max(1, min(CHUNK, MOST_STEPS // int(passages.number[:, STEPS].max(initial=1))))


def _here(deck: Deck, bodies: Bodies, passages: Passages, dt: float, advance: Advance) -> None:
    scratch, count, chunk = make_scratch(), len(passages.state), _chunk(passages)
    for first in range(0, count, chunk):
        last = min(first + chunk, count)
        send(deck, bodies, passages, scratch, dt, first, last)
        advance(last, count)


def _to_threads(
    deck: Deck, bodies: Bodies, passages: Passages, dt: float, threads: int, advance: Advance
) -> None:
    spare: SimpleQueue[Scratch] = SimpleQueue()
    for _ in range(threads):
        spare.put(make_scratch())
    count, chunk = len(passages.state), _chunk(passages)

    def work(first: int) -> int:
        scratch = spare.get()
        last = min(first + chunk, count)
        send(deck, bodies, passages, scratch, dt, first, last)
        spare.put(scratch)
        return last - first

    pool = ThreadPoolExecutor(threads)
    try:
        done = 0
        for finished in pool.map(work, range(0, count, chunk)):
            done += finished
            advance(done, count)
    finally:
        pool.shutdown(cancel_futures=True)


def _to_nodes(
    deck: Deck, bodies: Bodies, passages: Passages, dt: float, cluster: Cluster, advance: Advance
) -> None:
    count = len(passages.state)
    bundles = max(-(-count // BUNDLE), min(2, count // LEAST), 1)
    # Runs that lie far apart: neighbours are alike, and bundles are to take equally long.
    parts = [slice(first, None, bundles) for first in range(bundles)]
    jobs = [
        partial(quiet, partial(_ends, deck, bodies, _part(passages, part), dt)) for part in parts
    ]
    done = 0
    for place, (state, end) in share(jobs, cluster):
        passages.state[parts[place]] = state
        passages.end[parts[place]] = end
        done += len(end)
        advance(done, count)


def _part(passages: Passages, part: slice) -> Passages:
    return Passages(
        number=passages.number[part],
        condition=passages.condition[part],
        state=passages.state[part],
        end=passages.end[part],
    )


def _ends(
    deck: Deck, bodies: Bodies, passages: Passages, dt: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """States and ends of some runs, on a node."""
    send(deck, bodies, passages, make_scratch(), dt, 0, len(passages.state))
    return passages.state, passages.end
