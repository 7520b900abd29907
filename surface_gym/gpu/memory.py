"""A batch's memory on a device, as torch tensors that kernels see without a copy.

What a lane has one row of lies with the lanes side by side, so that neighbouring threads read
neighbouring numbers; all but the grid of axes, of which each lane reads another part.
"""

from typing import Any

import numpy as np
import torch
from numba import cuda
from numpy.typing import NDArray

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
            spread(values, lanes, device, apart=name in GRIDS)
            for name, values in zip(Surfaces._fields, surfaces, strict=True)
        ),
        Lanes._make(spread(values, lanes, device) for values in parcels),
    )


def spread(
    values: NDArray[Any], lanes: int, device: torch.device, apart: bool = False
) -> torch.Tensor:
    """A tensor (lanes, ...) of what is given of `PATTERN` lanes, all alike; what all lanes share
    has its one row.

    Args:
        values: (PATTERN or 1, ...)
        lanes: their number.
        device: where it lies.
        apart: whether a lane's numbers lie together, in place of the lanes side by side.
    """
    row = torch.from_numpy(values[:1].copy())[0]
    if len(values) == 1:
        return row.to(device)[None]
    if apart:
        return row.to(device).expand(lanes, *row.shape).contiguous()
    side_by_side = row.to(device)[..., None].expand(*row.shape, lanes).contiguous()
    return side_by_side.movedim(-1, 0)


def to_device(values: Any, device: torch.device) -> Any:
    """A tuple of arrays and numbers, tuples of them included, with the arrays as tensors."""
    if isinstance(values, np.ndarray):
        return torch.from_numpy(values.copy()).to(device)
    if isinstance(values, tuple):
        return type(values)._make(to_device(value, device) for value in values)  # type: ignore[attr-defined]
    return values


def seen(values: Any) -> Any:
    """Tensors, or a tuple of them and of numbers, as a kernel takes them: the same memory."""
    if isinstance(values, torch.Tensor):
        return cuda.as_cuda_array(values) if values.is_cuda else values.numpy()
    if isinstance(values, tuple):
        return type(values)._make(map(seen, values))  # type: ignore[attr-defined]
    return values
