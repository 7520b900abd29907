"""Starts for environments on a GPU, drawn on the host ahead of need. Each environment's come in
the order of its own generator, so that they are those of the CPU's batch.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
import torch

from surface_gym.core.resets import MOST_AHEAD, ResetCache, StartRows
from surface_gym.cuda.memory import Note, sent
from surface_gym.physics.types import STATE_SIZE, Array, Integers
from surface_gym.state import PATH_POINTS
from surface_gym.tasks.base import Task

# Control periods from one look at what lanes have taken to the next. What is seen at one look is
# laid out after the next, and is on the device after the one that follows, so that nobody waits.
LOOK_EVERY = 8
AHEAD = 3 * LOOK_EVERY  # starts of each lane that lie on the device


class Starts(NamedTuple):
    """Starts on the device, those of each environment in a ring."""

    site: Any  # (lanes, AHEAD)
    state: Any  # (lanes, AHEAD, STATE_SIZE)
    conditions: Any  # (lanes, AHEAD, 5)
    goal: Any  # (lanes, AHEAD, goals or 1)
    path: Any  # (lanes, AHEAD, PATH_POINTS or 1) [m]


class Laid(NamedTuple):
    """Starts laid out on the host, and the rings they belong to."""

    lanes: Integers  # (starts,)
    slots: Integers  # (starts,) places in the rings
    rows: StartRows
    path: Array  # (starts, PATH_POINTS or 0) [m]


class Prefetch:
    """A thread that keeps the rings full. A start costs the host a microsecond, and Track's 0.3
    ms.

    Args:
        task: whose starts they are.
        lay_out: makes rows and paths of numbers (starts, draws) and the options of each.
        lanes: their number.
        device: where the rings lie.
    """

    def __init__(
        self,
        task: Task,
        lay_out: Callable[[Array, Sequence[dict[str, Any]]], tuple[StartRows, Array]],
        lanes: int,
        device: torch.device,
    ) -> None:
        self._reserve = ResetCache(lanes, task.draws, shared=False, most_kept=MOST_AHEAD * lanes)
        self._lay_out = lay_out
        self._numbers = np.zeros((lanes, AHEAD, task.draws))  # that the rings' starts came of
        self._laid = np.zeros(lanes, dtype=np.int64)  # starts of each lane, so far
        self._pool = ThreadPoolExecutor(1, "starts")
        self._pending: Future[Laid] | None = None
        self._noted: Note | None = None  # what lanes had taken at the last look
        self._steps = 0
        path = PATH_POINTS if task.has_path else 0
        self.starts = Starts(
            torch.zeros((lanes, AHEAD), dtype=torch.int64, device=device),
            *(
                torch.zeros((lanes, AHEAD, size), dtype=torch.float64, device=device)
                for size in (STATE_SIZE, 5, max(1, task.goals), max(1, path))
            ),
        )
        # (lanes,) starts that each lane has taken from its ring
        self.taken = torch.zeros(lanes, dtype=torch.int64, device=device)

    def is_seeded(self, lane: int) -> bool:
        """Return whether an environment has a generator."""
        return self._reserve.generators[lane] is not None

    def renew(
        self,
        generators: Mapping[int, np.random.Generator],
        chosen: Integers,
        options: Sequence[dict[str, Any]],
    ) -> None:
        """Fill the rings for environments that are about to begin.

        Args:
            generators: that some lanes, by their number, draw their starts from anew.
            chosen: (count,) lanes about to begin, all of which have a generator.
            options: of each of these; none at all: none has any.
        """
        self._receive()  # of the generators that lanes had
        self._noted = None
        taken = Note(self.taken).read()
        for lane, generator in generators.items():
            self._reserve.seed(lane, generator)
            taken[lane] = self._laid[lane] = 0
        self.taken.copy_(torch.from_numpy(taken))
        self._send(self._prepare(taken + AHEAD))
        self._steps = 0
        if options:
            slots = taken[chosen] % AHEAD
            rows, path = self._lay_out(self._numbers[chosen, slots], options)
            self._send(Laid(chosen, slots, rows, path))

    def follow(self) -> None:
        """Check the rings; called after every control period, in which each environment takes
        one start at most.
        """
        self._steps += 1
        if self._steps % LOOK_EVERY > 0:
            return
        self._receive()
        if self._noted is not None:
            self._pending = self._pool.submit(self._prepare, self._noted.read() + AHEAD)
        self._noted = Note(self.taken)

    def close(self) -> None:
        """End the thread."""
        self._pool.shutdown()

    def _prepare(self, wanted: Integers) -> Laid:
        """Lay out starts until every environment has had as many as wanted (num_envs,)."""
        lanes, slots, numbers = [], [], []
        while (short := np.nonzero(self._laid < wanted)[0]).size:
            slot = self._laid[short] % AHEAD
            self._numbers[short, slot] = drawn = self._reserve.take(short)
            self._laid[short] += 1
            lanes.append(short)
            slots.append(slot)
            numbers.append(drawn)
        if not lanes:
            nothing = np.zeros(0, dtype=np.int64)
            return Laid(
                nothing, nothing, StartRows(nothing, *([np.zeros((0, 0))] * 3)), np.zeros((0, 0))
            )
        rows, path = self._lay_out(np.concatenate(numbers), ())
        return Laid(np.concatenate(lanes), np.concatenate(slots), rows, path)

    def _receive(self) -> None:
        """Send what the thread has laid out."""
        if self._pending is not None:
            self._send(self._pending.result())
            self._pending = None

    def _send(self, laid: Laid) -> None:
        if len(laid.lanes) == 0:
            return
        device = self.taken.device
        lanes, slots = sent(laid.lanes, device), sent(laid.slots, device)
        rows = laid.rows
        values = (rows.site, rows.state, rows.conditions, rows.goal, laid.path)
        for ring, value in zip(self.starts, values, strict=True):
            if value.size:
                ring[lanes, slots] = sent(value, device)
