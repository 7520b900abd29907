"""CUDA kernels compiled from the functions of the CPU's kernels."""

from functools import lru_cache
from typing import Any

import numpy as np
import torch
from numba import cuda

from surface_gym.compiler.translator import Translator
from surface_gym.config import EnvConfig
from surface_gym.core.assembly import task_functions
from surface_gym.core.kernel import EnvParams, KernelFunctions, make_kernel
from surface_gym.cuda.memory import kernel_view, required_capacity, scratch_layout, task_capacity
from surface_gym.cuda.prefetch import StartRings
from surface_gym.flow.batch import stream_functions
from surface_gym.flow.kernel import StreamFunctions, make_stream_kernel
from surface_gym.flow.state import StreamParams, StreamState
from surface_gym.parcel import Parcel
from surface_gym.physics import types
from surface_gym.physics.collision import WorldScratch, make_world_scratch, world_scratch
from surface_gym.physics.types import Booleans, Integers, Scratch
from surface_gym.state import STARTING, BodyTable, ParcelState, SurfaceState

THREADS = 64  # per block; threads use many registers, so more would not run at a time


class Launch:
    """A kernel with fixed arguments, called on torch's current stream.

    Numba analyses the types of all arguments once, at the first call, because the analysis takes
    longer than a control period. The first call takes tens of seconds, because it compiles
    the kernel.
    """

    def __init__(self, kernel: Any, arguments: tuple[Any, ...], num_envs: int) -> None:
        self._kernel = kernel
        self._blocks = -(-num_envs // THREADS)
        self._specialized: Any = None
        self.set_arguments(arguments)

    def set_arguments(self, arguments: tuple[Any, ...]) -> None:
        """Use other arguments of the same types from now on."""
        self._tensors = arguments  # keeps the memory alive for kernels
        self._arguments = tuple(map(kernel_view, arguments))

    def __call__(self) -> None:
        if self._specialized is None:
            self._specialized = self._kernel.specialize(*self._arguments)
        self._specialized[self._blocks, THREADS, _stream()](*self._arguments)


def _stream() -> Any:
    """Return torch's current CUDA stream, as a stream of Numba. 0 means the default stream."""
    if not torch.cuda.is_available():
        return 0
    stream = torch.cuda.current_stream().cuda_stream
    return cuda.external_stream(stream) if stream else 0


@lru_cache(maxsize=16)
def device_translator(capacity: int) -> Translator:
    """Return the translator of all kernels whose scratch has room for `capacity` contacts."""
    return Translator(lambda copy, _: cuda.jit(device=True)(copy), scratch_layout(capacity), types)


def step_kernel(config: EnvConfig) -> Any:
    """Build a kernel by `make_step_kernel`, for environments with one parcel each."""
    return make_step_kernel(task_functions(config), task_capacity(config))


@lru_cache(maxsize=64)
def make_step_kernel(functions: KernelFunctions, capacity: int) -> Any:
    """Build `step(params, surfaces, parcels, bodies, order, mask)`, compiled at its first call.

    Thread t steps the environment order[t] if the entry of `mask` (num_envs,) for this environment
    is true. A step is the same as in `core.kernel.make_kernel`. A thread's scratch has room for
    `capacity` contacts.
    """
    layout = scratch_layout(capacity)
    step_envs = device_translator(capacity).translate(make_kernel(functions))
    # A thread's local memory is interleaved with its neighbours'.
    table_size, marks_size, spans = layout["TABLE_SIZE"], layout["MARKS_SIZE"], layout["SPANS"]
    # The table of a sensor that is not updated every physics step is never read.
    sensor_table_size = table_size if functions.watches else 1

    def step(
        params: EnvParams,
        surfaces: SurfaceState,
        parcels: ParcelState,
        bodies: BodyTable,
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
        sensor_scratch = Scratch(
            cuda.local.array(sensor_table_size, np.float64), cuda.local.array(marks_size, np.int64)
        )
        sensor_scratch.marks[spans] = -1
        env_index = order[thread : thread + 1]
        step_envs(params, surfaces, parcels, bodies, scratch, sensor_scratch, env_index)

    return cuda.jit(step)


@cuda.jit
def place_starts(
    surfaces: SurfaceState,
    parcels: ParcelState,
    rings: StartRings,
    starts_taken: Integers,
    mask: Booleans,
) -> None:
    """Place the next start into each environment in the mask (num_envs,), like `Batch.place`.

    The start comes from `rings`. `starts_taken` (num_envs,) counts the starts that were placed.
    """
    i = cuda.grid(1)
    if i >= mask.shape[0] or not mask[i]:
        return
    k = starts_taken[i] % rings.body.shape[1]
    starts_taken[i] += 1
    parcels.body[i] = rings.body[i, k]
    for n in range(rings.state.shape[2]):
        parcels.state[i, n] = rings.state[i, k, n]
    for n in range(rings.conditions.shape[2]):
        surfaces.conditions[i, n] = rings.conditions[i, k, n]
    for n in range(rings.goal.shape[2]):
        parcels.goal[i, n] = rings.goal[i, k, n]
    for n in range(rings.path.shape[2]):
        parcels.path[i, n] = rings.path[i, k, n]
    parcels.outcome[i] = STARTING


def stream_capacity(config: EnvConfig, kinds: tuple[Parcel, ...]) -> int:
    """Return the number of contacts that suffices for the parcels `kinds` at their largest size."""
    bases = [config.randomisation.largest(parcel.base) for parcel in kinds]
    return required_capacity(bases, config.chosen_line)


def stream_step_kernel(config: EnvConfig) -> Any:
    """Build the kernel of streams by `make_stream_step_kernel`."""
    capacity = stream_capacity(config, config.stream_task.stream.kinds)
    return make_stream_step_kernel(stream_functions(config), capacity)


@lru_cache(maxsize=16)
def make_stream_step_kernel(functions: StreamFunctions, capacity: int) -> Any:
    """Build `step(params, stream_params, surfaces, parcels, bodies, streams, scratches, order,
    mask)`, compiled at its first call.

    Thread t steps surface order[t] if mask[order[t]] is true; `mask` has the shape (num_envs,). A
    step is the same as in `flow.kernel.make_stream_kernel`. A parcel's scratch has room for
    `capacity` contacts.
    """
    layout = scratch_layout(capacity)
    translator = device_translator(capacity)
    step_streams = translator.translate(make_stream_kernel(functions))
    select_scratch = translator.translate(world_scratch)
    table_size, marks_size, spans = layout["TABLE_SIZE"], layout["MARKS_SIZE"], layout["SPANS"]

    def step(
        params: EnvParams,
        stream_params: StreamParams,
        surfaces: SurfaceState,
        parcels: ParcelState,
        bodies: BodyTable,
        streams: StreamState,
        scratches: WorldScratch,
        order: Integers,
        mask: Booleans,
    ) -> None:
        thread = cuda.grid(1)
        if thread >= order.shape[0] or not mask[order[thread]]:
            return
        sensor_scratch = Scratch(
            cuda.local.array(table_size, np.float64), cuda.local.array(marks_size, np.int64)
        )
        sensor_scratch.marks[spans] = -1
        scratch = select_scratch(scratches, order[thread])
        env_index = order[thread : thread + 1]
        step_streams(
            params, stream_params, surfaces, parcels, bodies, streams, scratch, sensor_scratch,
            env_index,
        )  # fmt: skip

    return cuda.jit(step)


def make_stream_scratch(capacity: int, parcels: int) -> WorldScratch:
    """Make a surface's scratch for `parcels` parcels and up to `capacity` contacts per parcel."""
    translator = Translator(lambda copy, _: copy, scratch_layout(capacity), types)
    return translator.translate(make_world_scratch)(parcels)
