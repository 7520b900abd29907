"""CUDA kernels built from the functions of the CPU's kernels.

Compiled functions are walked as the digest walks them, from a function to those it refers to, and
each is made again from the same code: with other constants, and wrapped for the other compiler.
Nothing is written twice.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache
from types import CellType, FunctionType
from typing import Any

import numpy as np
import torch
from numba import cuda
from numba.core.dispatcher import Dispatcher

from surface_gym.config import EnvConfig
from surface_gym.core.assembly import task_functions
from surface_gym.core.kernel import EnvParams, KernelFunctions, make_kernel
from surface_gym.cuda.memory import capacity_for, capacity_of, layout, seen
from surface_gym.cuda.prefetch import Starts
from surface_gym.flow.batch import stream_functions
from surface_gym.flow.kernel import StreamFunctions, make_stream_kernel
from surface_gym.flow.state import StreamParams, StreamState
from surface_gym.parcel import Parcel
from surface_gym.physics import types
from surface_gym.physics.collision import WorldScratch, make_world_scratch, world_scratch
from surface_gym.physics.jit import referenced_names
from surface_gym.physics.types import Booleans, Integers, Scratch
from surface_gym.state import STARTING, BodyTable, ParcelState, SurfaceState

Wrap = Callable[[Callable[..., Any]], Any]


class Source:
    """CPU functions made again for the device, each once.

    Args:
        constants: of `dynamics.types`, by name, in place of those there.
        wrap: makes a function that others call one of the other compiler's.
    """

    def __init__(self, constants: Mapping[str, int], wrap: Wrap) -> None:
        self._constants = constants
        self._wrap = wrap
        self._made: dict[int, Any] = {}
        self._kept: list[Any] = []  # what `_made` knows by its address

    def remade(self, function: Any) -> Any:
        """Return a function of the physics, a task or a sensor, made again for the other
        compiler.
        """
        if id(function) not in self._made:
            plain = function.py_func if isinstance(function, Dispatcher) else function
            copy = _empty_copy(plain)
            self._kept.append(function)
            self._made[id(function)] = self._wrap(copy)
            self._fill(copy, plain)
        return self._made[id(function)]

    def _fill(self, copy: FunctionType, plain: FunctionType) -> None:
        """Let a copy refer to what its original refers to, made again."""
        for name in referenced_names(plain.__code__):
            if name in plain.__globals__:
                copy.__globals__[name] = self._value(name, plain.__globals__[name])
        cells = zip(copy.__closure__ or (), plain.__closure__ or (), strict=True)
        for name, (cell, original) in zip(plain.__code__.co_freevars, cells, strict=True):
            cell.cell_contents = self._value(name, original.cell_contents)

    def _value(self, name: str, value: Any) -> Any:
        if isinstance(value, Dispatcher):
            return self.remade(value)
        if name in self._constants and value == getattr(types, name):
            return self._constants[name]
        return value


def _empty_copy(function: FunctionType) -> FunctionType:
    """Return a function with the same code that refers to nothing yet."""
    known = {"__name__": function.__module__, "__builtins__": __builtins__}
    cells = tuple(CellType() for _ in function.__code__.co_freevars)
    copy = FunctionType(function.__code__, known, function.__name__, function.__defaults__, cells)
    copy.__module__, copy.__qualname__ = function.__module__, function.__qualname__
    return copy


THREADS = 64  # of a block; a lane takes so many registers that more would not run at a time


class Launch:
    """A kernel that is called with the same arguments each time, on torch's current stream.

    Finding out what dozens of arrays are takes longer than a control period of many lanes: it is
    done once. The kernel is compiled at the first call, which takes tens of seconds.

    Args:
        kernel: as `cuda.jit` makes it, a thread a lane.
        arguments: tensors, numbers, and tuples of them.
        lanes: their number.
    """

    def __init__(self, kernel: Any, arguments: tuple[Any, ...], lanes: int) -> None:
        self._kernel = kernel
        self._blocks = -(-lanes // THREADS)
        self._special: Any = None
        self.call_with(arguments)

    def call_with(self, arguments: tuple[Any, ...]) -> None:
        """Call the kernel with other arguments of the same types from now on."""
        self._held = arguments  # the tensors, as long as kernels read their memory
        self._arguments = tuple(map(seen, arguments))

    def __call__(self) -> None:
        if self._special is None:
            self._special = self._kernel.specialize(*self._arguments)
        self._special[self._blocks, THREADS, _stream()](*self._arguments)


def _stream() -> Any:
    """Return torch's stream for Numba; 0 is the default stream of both."""
    if not torch.cuda.is_available():
        return 0
    stream = torch.cuda.current_stream().cuda_stream
    return cuda.external_stream(stream) if stream else 0


def device_function(function: Any) -> Any:
    """Compile a function that kernels call."""
    return cuda.jit(device=True)(function)


@lru_cache(maxsize=16)
def device_source(capacity: int) -> Source:
    """Return the functions for a GPU whose scratch has room for some contacts; functions that
    several tasks call are compiled once.
    """
    return Source(layout(capacity), device_function)


def move_kernel(settings: EnvConfig) -> Any:
    """Return the kernel of an environment: see `make_move_kernel`."""
    return make_move_kernel(task_functions(settings), capacity_of(settings))


@lru_cache(maxsize=64)
def make_move_kernel(functions: KernelFunctions, capacity: int) -> Any:
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
        rules: EnvParams,
        surfaces: SurfaceState,
        lanes: ParcelState,
        sites: BodyTable,
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
    surfaces: SurfaceState, lanes: ParcelState, starts: Starts, taken: Integers, mask: Booleans
) -> None:
    """Put the next start on each environment in the mask (num_envs,), as `Batch.place` does.

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
    lanes.outcome[i] = STARTING


def stream_capacity(settings: EnvConfig, kinds: tuple[Parcel, ...]) -> int:
    """Return the room for the contacts and edges of some parcels at their largest size."""
    bases = [settings.randomisation.largest(parcel.base) for parcel in kinds]
    return capacity_for(bases, settings.chosen_line)


def move_flow_kernel(settings: EnvConfig) -> Any:
    """The kernel of an environment: see `make_move_flow_kernel`."""
    capacity = stream_capacity(settings, settings.stream_task.stream.kinds)
    return make_move_flow_kernel(stream_functions(settings), capacity)


@lru_cache(maxsize=16)
def make_move_flow_kernel(functions: StreamFunctions, capacity: int) -> Any:
    """Build `move(rules, flow_rules, surfaces, lanes, sites, flows, scratches, order, mask)`,
    compiled when it is first called.

    Thread t moves surface order[t], if it is in the mask (surfaces,): see
    `flow.kernel.make_stream_kernel`.

    Args:
        functions: of the environment.
        capacity: contacts that a parcel's scratch has room for.
    """
    places = layout(capacity)
    source = device_source(capacity)
    move_flows, own_scratch = (
        source.remade(make_stream_kernel(functions)),
        source.remade(world_scratch),
    )
    table_size, marks_size, spans = places["TABLE_SIZE"], places["MARKS_SIZE"], places["SPANS"]

    def move(
        rules: EnvParams,
        flow_rules: StreamParams,
        surfaces: SurfaceState,
        lanes: ParcelState,
        sites: BodyTable,
        flows: StreamState,
        scratches: WorldScratch,
        order: Integers,
        mask: Booleans,
    ) -> None:
        thread = cuda.grid(1)
        if thread >= order.shape[0] or not mask[order[thread]]:
            return
        of_sensor = Scratch(
            cuda.local.array(table_size, np.float64), cuda.local.array(marks_size, np.int64)
        )
        of_sensor.marks[spans] = -1
        scratch = own_scratch(scratches, order[thread])
        own = order[thread : thread + 1]
        move_flows(rules, flow_rules, surfaces, lanes, sites, flows, scratch, of_sensor, own)

    return cuda.jit(move)


def make_scratch(capacity: int, parcels: int) -> WorldScratch:
    """Make a surface's scratch for a number of parcels, with room for some contacts of each."""
    source = Source(layout(capacity), lambda function: function)
    scratch: WorldScratch = source.remade(make_world_scratch)(parcels)
    return scratch
