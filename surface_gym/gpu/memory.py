"""A batch's memory on a device, as torch tensors that kernels see without a copy.

What a lane has one row of lies with the lanes side by side, so that neighbouring threads read
neighbouring numbers; all but the grid of axes, of which each lane reads another part.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch
from numba import cuda

from surface_gym.batch.making import memory_of
from surface_gym.lanes.memory import Lanes, Surfaces
from surface_gym.settings import Settings

GRIDS = ("axis", "angle", "target", "stiffness")  # a lane's elements lie together
PATTERN = 2  # lanes of which memory is made: what has as many rows has one a lane


def make_memory(settings: Settings, lanes: int, device: torch.device) -> tuple[Surfaces, Lanes]:
    """Memory of a batch, as `batch.making.memory_of` has it, of tensors."""
    surfaces, parcels = memory_of(settings, PATTERN)
    return (
        Surfaces._make(
            _for_all(values, lanes, device, together if name in GRIDS else side_by_side)
            for name, values in zip(Surfaces._fields, surfaces, strict=True)
        ),
        Lanes._make(_for_all(values, lanes, device, side_by_side) for values in parcels),
    )


def _for_all(values: Any, lanes: int, device: torch.device, spread: Any) -> torch.Tensor:
    """What lanes share has its one row; else a row each."""
    one = to_device(values[:1], device)
    return one if len(values) == 1 else spread(one[0], lanes)


def side_by_side(one: torch.Tensor, lanes: int) -> torch.Tensor:
    """(lanes, ...) with the numbers of one lane, those of neighbours next to each other."""
    return one[..., None].expand(*one.shape, lanes).contiguous().movedim(-1, 0)


def together(one: torch.Tensor, lanes: int) -> torch.Tensor:
    """(lanes, ...) with the numbers of one lane, its own next to each other."""
    return one.expand(lanes, *one.shape).contiguous()


def to_device(values: Any, device: torch.device) -> Any:
    """A tuple of arrays and numbers, tuples of them included, with the arrays as tensors.

    An array that holds nothing gets a zero that nobody reads: a kernel takes no empty one.
    """
    if isinstance(values, np.ndarray):
        held = values if values.size else np.zeros(np.maximum(values.shape, 1), values.dtype)
        return torch.from_numpy(held.copy()).to(device)
    return _of_each(partial(to_device, device=device), values)


def seen(values: Any) -> Any:
    """Tensors, or a tuple of them and of numbers, as a kernel takes them: the same memory."""
    if isinstance(values, torch.Tensor):
        return cuda.as_cuda_array(values) if values.is_cuda else values.numpy()
    return _of_each(seen, values)


def _of_each(function: Callable[[Any], Any], values: Any) -> Any:
    """A tuple of what a function makes of each of its values; what is no tuple as it is."""
    kind: Any = type(values)
    return kind._make(map(function, values)) if isinstance(values, tuple) else values
