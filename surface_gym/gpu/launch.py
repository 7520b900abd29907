"""A kernel and what it is called with, time and again."""

from typing import Any

import torch
from numba import cuda

from surface_gym.gpu.memory import seen

THREADS = 64  # of a block; a lane takes so many registers that more would not run at a time


class Launch:
    """Calls a kernel with the same arguments each time, on torch's stream of the moment.

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
        """Call it with others of the same types from now on."""
        self._held = arguments  # the tensors, as long as kernels read their memory
        self._arguments = tuple(map(seen, arguments))

    def __call__(self) -> None:
        if self._special is None:
            self._special = self._kernel.specialize(*self._arguments)
        self._special[self._blocks, THREADS, _stream()](*self._arguments)


def _stream() -> Any:
    """Torch's, for Numba; 0 is the default stream of both."""
    if not torch.cuda.is_available():
        return 0
    stream = torch.cuda.current_stream().cuda_stream
    return cuda.external_stream(stream) if stream else 0
