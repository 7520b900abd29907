"""State arrays and scratch in a device's memory, and transfers between host and device.

Arrays with one row per environment are stored with environments adjacent, so neighbouring threads
read neighbouring numbers. Grids of axes are an exception: environments read different parts of
them, so an environment's elements are adjacent.

`physics.types` allocates scratch for the largest possible parcels. On a GPU, each of many thousands
of environments has its own scratch in its thread's local memory, with capacity for the task's
parcels only.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from numba import cuda

from surface_gym.config import EnvConfig
from surface_gym.core.assembly import make_state
from surface_gym.core.resets import FEWEST_EDGES
from surface_gym.lines import BaseLine
from surface_gym.parcel import Base
from surface_gym.physics import types
from surface_gym.state import ParcelState, SurfaceState

GRIDS = ("axis", "angle", "target", "stiffness", "load")  # an environment's elements are adjacent
PATTERN = 2  # a state of 2 environments shows which arrays have one row per environment


def make_device_state(
    config: EnvConfig, num_envs: int, device: torch.device
) -> tuple[SurfaceState, ParcelState]:
    """Make the state arrays of a batch as tensors."""
    surfaces, parcels = make_state(config, PATTERN)
    return (
        SurfaceState._make(
            _repeat(values, num_envs, device, repeat_rows if name in GRIDS else interleave)
            for name, values in zip(SurfaceState._fields, surfaces, strict=True)
        ),
        ParcelState._make(_repeat(values, num_envs, device, interleave) for values in parcels),
    )


def _repeat(values: Any, num_envs: int, device: torch.device, layout: Any) -> torch.Tensor:
    """Return the first row of `values` as a tensor for all environments.

    If `values` has only one row, the tensor has one row, and all environments share the row. If
    `values` has more rows, the function `layout` (`interleave` or `repeat_rows`) repeats the first
    row for `num_envs` environments.
    """
    row = to_device(values[:1], device)
    return row if len(values) == 1 else layout(row[0], num_envs)


def interleave(row: torch.Tensor, num_envs: int) -> torch.Tensor:
    """Repeat a row for `num_envs` environments; equal entries are adjacent in memory.

    The result is (num_envs, ...). Entry k of all environments precedes entry k + 1.
    """
    return row[..., None].expand(*row.shape, num_envs).contiguous().movedim(-1, 0)


def repeat_rows(row: torch.Tensor, num_envs: int) -> torch.Tensor:
    """Repeat a row for all environments. The result (num_envs, ...) is contiguous in memory."""
    return row.expand(num_envs, *row.shape).contiguous()


def to_device(values: Any, device: torch.device) -> Any:
    """Copy arrays, also in nested tuples, to tensors on a device; other values do not change.

    Kernels take no empty arrays. So an empty array is replaced by zeros that no kernel reads.
    """
    if isinstance(values, np.ndarray):
        filled = values if values.size else np.zeros(np.maximum(values.shape, 1), values.dtype)
        return torch.from_numpy(filled.copy()).to(device)
    return _map(partial(to_device, device=device), values)


def kernel_view(values: Any) -> Any:
    """Convert tensors, also in nested tuples, to views for kernels; other values do not change."""
    if isinstance(values, torch.Tensor):
        return cuda.as_cuda_array(values) if values.is_cuda else values.numpy()
    return _map(kernel_view, values)


def _map(function: Callable[[Any], Any], values: Any) -> Any:
    """Apply a function to each value of a tuple. If `values` is no tuple, return `values`."""
    kind: Any = type(values)
    return kind._make(map(function, values)) if isinstance(values, tuple) else values


# Named as in `physics.types`.
TABLE_ROWS = (
    "ARM_X", "ARM_Y", "AXIS_X", "AXIS_Y", "STIFFNESS", "DRIVE_ALONG", "DRIVE_ACROSS", "MU_ALONG",
    "MU_ACROSS", "PRESSURE", "NORMAL", "MOST_ALONG", "MOST_ACROSS", "SLIP_ALONG", "SLIP_ACROSS",
    "SLIP_SPEED", "SHARE", "FORCE_X", "FORCE_Y", "TORQUE", "CURVE_XX", "CURVE_XY", "CURVE_XW",
    "CURVE_YY", "CURVE_YW", "CURVE_WW", "SLIDE_ALONG", "RATE_ALONG", "SLIDE_ACROSS", "RATE_ACROSS",
    "KINK_1", "KINK_2", "KINK_3", "KINK_4", "SLOPE", "BOUND_START", "BOUND_SLOPE", "BOUND_SIDE",
    "KINKS",
)  # fmt: skip
MARK_ROWS = ("KIND", "ISOTROPIC", "SPAN_ROW", "SPAN_FIRST", "SPAN_LAST", "COUNTS")
KINKS_PER_CONTACT = 4
OUTLINE_MARGIN = 1.01  # factor by which an outline is enlarged, for safety


def scratch_layout(capacity: int) -> MappingProxyType[str, int]:
    """Return the sizes and offsets, by name, of a scratch for `capacity` contacts."""
    table = {name: getattr(types, name) // types.STRIDE * capacity for name in TABLE_ROWS}
    marks = {name: getattr(types, name) // types.STRIDE * capacity for name in MARK_ROWS}
    counts = marks["COUNTS"]
    return MappingProxyType(
        {
            "CAPACITY": capacity,
            "STRIDE": capacity,
            **table,
            "TABLE_SIZE": table["KINKS"] + KINKS_PER_CONTACT * capacity,
            **marks,
            "SPANS": counts + types.SPANS - types.COUNTS,
            "ISOTROPICS": counts + types.ISOTROPICS - types.COUNTS,
            "SUPPORTS": counts + types.SUPPORTS - types.COUNTS,
            "MARKS_SIZE": counts + types.MARKS_SIZE - types.COUNTS,
        }
    )


def task_capacity(config: EnvConfig) -> int:
    """Return how many contacts scratch arrays must hold to suffice for every parcel of the task."""
    return required_capacity([parcel.base for parcel in config.task.parcels], config.chosen_line)


def required_capacity(bases: Sequence[Base], line: BaseLine) -> int:
    """Return a capacity of a thread's scratch that is sufficient for every base on a line.

    The capacity is at least every base's number of contacts, and every base's number of edges.
    """
    pitches = (line.geometry.pitch_x, line.geometry.pitch_y)
    contacts = [max_contacts(base, pitches) for base in bases]
    return max(FEWEST_EDGES, *contacts, *(len(base.edges) for base in bases))


def max_contacts(base: Base, pitches: tuple[float, float]) -> int:
    """Return an upper limit of the number of elements under a base. `pitches` are (x, y) [m].

    A convex figure of area A and perimeter P covers at most A + P / 2 + 1 points of the unit
    lattice (Nosarzewska, Evaluation de la difference entre l'aire d'une region plane convexe et le
    nombre des points aux coordonnees entieres couverts par elle, 1948).
    """
    corners = OUTLINE_MARGIN * base.outline  # a round base's outline is a polygon within it
    following = np.roll(corners, -1, axis=0)
    area = 0.5 * np.sum(corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0])
    perimeter = np.hypot(*(following - corners).T).sum()
    return math.ceil(area / math.prod(pitches) + 0.5 * perimeter / min(pitches) + 1.0)


class DelayedCopy:
    """A tensor's copy in the host's memory. The host waits for the device only in `read`."""

    def __init__(self, values: torch.Tensor) -> None:
        self._event: Any = None
        if values.is_cuda:
            event: Any = torch.cuda.Event  # untyped in torch
            self._event = event()
        self._values = torch.empty(values.shape, dtype=values.dtype, pin_memory=values.is_cuda)
        self._values.copy_(values, non_blocking=True)
        if self._event is not None:
            self._event.record()

    def read(self) -> np.ndarray:
        if self._event is not None:
            self._event.synchronize()
        return self._values.numpy().copy()


def send(values: np.ndarray, device: torch.device) -> torch.Tensor:
    """Send an array to a device. The host does not wait for the device."""
    copy = torch.from_numpy(np.array(values))
    return (copy.pin_memory() if device.type == "cuda" else copy).to(device, non_blocking=True)
