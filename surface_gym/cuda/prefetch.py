"""Starts of episodes for environments on a GPU, drawn ahead on the host.

Each environment's starts follow its own generator, so they equal the starts of a CPU batch.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any, NamedTuple

import numpy as np
import torch

from surface_gym.core.resets import MOST_AHEAD, ResetCache, StartRows
from surface_gym.cuda.memory import DelayedCopy, send
from surface_gym.physics.types import STATE_SIZE, Array, Integers
from surface_gym.state import CONDITION_COLUMNS, PATH_POINTS
from surface_gym.tasks.base import Task

# Control periods between two checks of the number of used starts. Counts copied at one check are
# read at the next check, and new starts are sent at the check after that. So neither side waits.
CHECK_EVERY = 8
STARTS_AHEAD = 3 * CHECK_EVERY  # starts of each environment on the device


class StartRings(NamedTuple):
    """Starts on the device: one ring buffer per environment."""

    body: Any  # (num_envs, STARTS_AHEAD)
    state: Any  # (num_envs, STARTS_AHEAD, STATE_SIZE)
    conditions: Any  # (num_envs, STARTS_AHEAD, CONDITION_COLUMNS)
    goal: Any  # (num_envs, STARTS_AHEAD, goals or 1)
    path: Any  # (num_envs, STARTS_AHEAD, PATH_POINTS or 1) [m]


class PreparedStarts(NamedTuple):
    """Starts on the host, with their positions in the rings."""

    env_indices: Integers  # (starts,)
    slots: Integers  # (starts,) in the ring of the environment
    rows: StartRows
    path: Array  # (starts, PATH_POINTS or 0) [m]


class Prefetch:
    """Ring buffers of starts. A host thread draws a start in 1 us (0.3 ms for the task Track)."""

    def __init__(
        self,
        task: Task,
        make_rows: Callable[[Array, Sequence[dict[str, Any]]], tuple[StartRows, Array]],
        num_envs: int,
        device: torch.device,
    ) -> None:
        self._cache = ResetCache(
            num_envs, task.draws, shared=False, most_kept=MOST_AHEAD * num_envs
        )
        self._make_rows = make_rows
        # State of the starts in the rings.
        self._numbers = np.zeros((num_envs, STARTS_AHEAD, task.draws))
        self._prepared = np.zeros(num_envs, dtype=np.int64)  # number of each environment's starts
        self._pool = ThreadPoolExecutor(1, "starts")
        self._pending: Future[PreparedStarts | None] | None = None
        self._checked: DelayedCopy | None = None  # used starts at the last check
        self._steps = 0
        path = PATH_POINTS if task.has_path else 0
        self.rings = StartRings(
            torch.zeros((num_envs, STARTS_AHEAD), dtype=torch.int64, device=device),
            *(
                torch.zeros((num_envs, STARTS_AHEAD, size), dtype=torch.float64, device=device)
                for size in (STATE_SIZE, CONDITION_COLUMNS, max(1, task.goals), max(1, path))
            ),
        )
        # (num_envs,) starts that each environment has taken from its ring
        self.starts_taken = torch.zeros(num_envs, dtype=torch.int64, device=device)

    def is_seeded(self, env_index: int) -> bool:
        return self._cache.generators[env_index] is not None

    def refill(
        self,
        generators: Mapping[int, np.random.Generator],
        chosen: Integers,
        options: Sequence[dict[str, Any]],
    ) -> None:
        """Fill the rings before a reset.

        `generators` has new generators by environment index. The starts prepared for these
        environments are discarded. `options` is empty, or has reset options for each of the
        environments `chosen` (count,). If there are options, the next start of each chosen
        environment is replaced by a start with the environment's options.
        """
        self._send_pending()  # drawn by earlier generators
        self._checked = None
        taken = DelayedCopy(self.starts_taken).read()
        for i, generator in generators.items():
            self._cache.seed(i, generator)
            taken[i] = self._prepared[i] = 0
        self.starts_taken.copy_(torch.from_numpy(taken))
        self._send(self._prepare(taken + STARTS_AHEAD))
        self._steps = 0
        if options:
            slots = taken[chosen] % STARTS_AHEAD
            rows, path = self._make_rows(self._numbers[chosen, slots], options)
            self._send(PreparedStarts(chosen, slots, rows, path))

    def update(self) -> None:
        """Refill the rings after a control period. No environment uses two starts in a period."""
        self._steps += 1
        if self._steps % CHECK_EVERY > 0:
            return
        self._send_pending()
        if self._checked is not None:
            taken = self._checked.read()
            self._pending = self._pool.submit(self._prepare, taken + STARTS_AHEAD)
        self._checked = DelayedCopy(self.starts_taken)

    def close(self) -> None:
        self._pool.shutdown()

    def _prepare(self, wanted: Integers) -> PreparedStarts | None:
        """Draw starts until environment i has had `wanted[i]` starts since seeding."""
        env_indices, slots, numbers = [], [], []
        while (short := np.nonzero(self._prepared < wanted)[0]).size:
            slot = self._prepared[short] % STARTS_AHEAD
            self._numbers[short, slot] = drawn = self._cache.take(short)
            self._prepared[short] += 1
            env_indices.append(short)
            slots.append(slot)
            numbers.append(drawn)
        if not env_indices:
            return None
        rows, path = self._make_rows(np.concatenate(numbers), ())
        return PreparedStarts(np.concatenate(env_indices), np.concatenate(slots), rows, path)

    def _send_pending(self) -> None:
        if self._pending is not None:
            self._send(self._pending.result())
            self._pending = None

    def _send(self, prepared: PreparedStarts | None) -> None:
        """Write prepared starts into the rings; None has no effect."""
        if prepared is None:
            return
        device = self.starts_taken.device
        env_indices, slots = send(prepared.env_indices, device), send(prepared.slots, device)
        for ring, values in zip(self.rings, (*prepared.rows, prepared.path), strict=True):
            if values.size:
                ring[env_indices, slots] = send(values, device)
