"""The kernels of a batch on a GPU: a thread a lane."""

from functools import lru_cache
from typing import Any

import numpy as np
from numba import cuda

from surface_gym.batch.functions import functions_of
from surface_gym.batch.kernels import Functions, Rules, make_kernel
from surface_gym.dynamics.types import Booleans, Integers, Scratch
from surface_gym.gpu.scratch import capacity_of, layout
from surface_gym.gpu.source import Source
from surface_gym.gpu.starts import Starts
from surface_gym.lanes.memory import PLACED, Lanes, Sites, Surfaces
from surface_gym.settings import Settings


def device_function(function: Any) -> Any:
    """A function that kernels call."""
    return cuda.jit(device=True)(function)


@lru_cache(maxsize=16)
def device_source(capacity: int) -> Source:
    """Functions of a GPU whose scratch has room for so many contacts; those that several tasks call
    are compiled once.
    """
    return Source(layout(capacity), device_function)


def move_kernel(settings: Settings) -> Any:
    """The kernel of an environment: see `make_move_kernel`."""
    return make_move_kernel(functions_of(settings), capacity_of(settings))


@lru_cache(maxsize=64)
def make_move_kernel(functions: Functions, capacity: int) -> Any:
    """Build `move(rules, surfaces, lanes, sites, order, mask)`, compiled when it is first called.

    Thread t moves lane order[t], if it is in the mask (lanes,): see `batch.kernels.make_kernel`.

    Args:
        functions: of the environment.
        capacity: contacts that a scratch has room for.
    """
    places = layout(capacity)
    move_lanes = device_source(capacity).remade(make_kernel(functions))
    # A thread's local memory lies interleaved with its neighbours'.
    table_size, marks_size, spans = places["TABLE_SIZE"], places["MARKS_SIZE"], places["SPANS"]
    # A sensor that does not watch never looks at its table.
    sensor_size = table_size if functions.watches else 1

    def move(
        rules: Rules,
        surfaces: Surfaces,
        lanes: Lanes,
        sites: Sites,
        order: Integers,
        mask: Booleans,
    ) -> None:
        thread = cuda.grid(1)
        if thread >= order.shape[0] or not mask[order[thread]]:
            return
        scratch = Scratch(
            cuda.local.array(table_size, np.float64), cuda.local.array(marks_size, np.int64)
        )
        scratch.marks[spans] = -1
        of_sensor = Scratch(
            cuda.local.array(sensor_size, np.float64), cuda.local.array(marks_size, np.int64)
        )
        of_sensor.marks[spans] = -1
        own = order[thread : thread + 1]
        move_lanes(rules, surfaces, lanes, sites, scratch, of_sensor, own)

    return cuda.jit(move)


@cuda.jit
def place(
    surfaces: Surfaces, lanes: Lanes, starts: Starts, taken: Integers, mask: Booleans
) -> None:
    """Put the next of its starts on each lane in the mask (lanes,), as `Batch.place` does.

    Args:
        surfaces: of the batch.
        lanes: of the batch.
        starts: laid out ahead.
        taken: (lanes,) starts that each lane has taken.
        mask: (lanes,)
    """
    i = cuda.grid(1)
    if i >= mask.shape[0] or not mask[i]:
        return
    k = taken[i] % starts.site.shape[1]
    taken[i] += 1
    lanes.site[i] = starts.site[i, k]
    for n in range(starts.state.shape[2]):
        lanes.state[i, n] = starts.state[i, k, n]
    for n in range(starts.conditions.shape[2]):
        surfaces.conditions[i, n] = starts.conditions[i, k, n]
    for n in range(starts.goal.shape[2]):
        lanes.goal[i, n] = starts.goal[i, k, n]
    for n in range(starts.path.shape[2]):
        lanes.path[i, n] = starts.path[i, k, n]
    lanes.outcome[i] = PLACED
