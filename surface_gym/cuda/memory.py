"""State arrays and scratch on a CUDA device.

What a lane has one row of lies with the lanes side by side, so that neighbouring threads read
neighbouring numbers; all but the grid of axes, of which each lane reads another part.

`dynamics.types` gives a scratch room for as many contacts as any parcel may have. On a GPU each of
many thousands of lanes has its own, in a thread's local memory: it is cut to the parcels at hand.
"""

import math
from collections.abc import Callable, Sequence
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np
import torch
from numba import cuda
from numpy.typing import NDArray

from surface_gym.config import EnvConfig
from surface_gym.core.assembly import make_state
from surface_gym.core.resets import FEWEST_EDGES
from surface_gym.lines import BaseLine
from surface_gym.parcel import Base
from surface_gym.physics import types
from surface_gym.state import ParcelState, SurfaceState

GRIDS = ("axis", "angle", "target", "stiffness")  # a lane's elements lie together
PATTERN = 2  # lanes of which memory is made: what has as many rows has one a lane


def make_memory(
    settings: EnvConfig, lanes: int, device: torch.device
) -> tuple[SurfaceState, ParcelState]:
    """Memory of a batch, as `core.assembly.make_state` makes it, of tensors."""
    surfaces, parcels = make_state(settings, PATTERN)
    return (
        SurfaceState._make(
            _for_all(values, lanes, device, together if name in GRIDS else side_by_side)
            for name, values in zip(SurfaceState._fields, surfaces, strict=True)
        ),
        ParcelState._make(_for_all(values, lanes, device, side_by_side) for values in parcels),
    )


def _for_all(values: Any, lanes: int, device: torch.device, spread: Any) -> torch.Tensor:
    """Return the one row that environments share, else a row each."""
    one = to_device(values[:1], device)
    return one if len(values) == 1 else spread(one[0], lanes)


def side_by_side(one: torch.Tensor, lanes: int) -> torch.Tensor:
    """Return (num_envs, ...) laid out so that the same number of neighbours lies side by side."""
    return one[..., None].expand(*one.shape, lanes).contiguous().movedim(-1, 0)


def together(one: torch.Tensor, lanes: int) -> torch.Tensor:
    """Return (num_envs, ...) laid out so that the numbers of one environment lie together."""
    return one.expand(lanes, *one.shape).contiguous()


def to_device(values: Any, device: torch.device) -> Any:
    """Return a tuple of arrays and numbers, nested ones included, with the arrays as tensors.

    An array that holds nothing gets a zero that nobody reads: a kernel takes no empty one.
    """
    if isinstance(values, np.ndarray):
        held = values if values.size else np.zeros(np.maximum(values.shape, 1), values.dtype)
        return torch.from_numpy(held.copy()).to(device)
    return _of_each(partial(to_device, device=device), values)


def seen(values: Any) -> Any:
    """Return tensors, or a tuple of them and of numbers, as a kernel takes them: the same
    memory.
    """
    if isinstance(values, torch.Tensor):
        return cuda.as_cuda_array(values) if values.is_cuda else values.numpy()
    return _of_each(seen, values)


def _of_each(function: Callable[[Any], Any], values: Any) -> Any:
    """Apply a function to each value of a tuple; return anything else as it is."""
    kind: Any = type(values)
    return kind._make(map(function, values)) if isinstance(values, tuple) else values


# By name, as in `dynamics.types`.
ROWS_OF_TABLE = (
    "ARM_X", "ARM_Y", "AXIS_X", "AXIS_Y", "STIFFNESS", "MU_ALONG", "MU_ACROSS", "PRESSURE",
    "NORMAL", "MOST_ALONG", "MOST_ACROSS", "SLIP_ALONG", "SLIP_ACROSS", "FORCE_X", "FORCE_Y",
    "TORQUE", "CURVE_XX", "CURVE_XY", "CURVE_XW", "CURVE_YY", "CURVE_YW", "CURVE_WW",
    "SLIDE_ALONG", "RATE_ALONG", "SLIDE_ACROSS", "RATE_ACROSS", "KINK_1", "KINK_2", "KINK_3",
    "KINK_4", "SLOPE", "BOUND_START", "BOUND_SLOPE", "BOUND_SIDE", "KINKS",
)  # fmt: skip
ROWS_OF_MARKS = ("ROTOR", "SUPPORT", "SPAN_ROW", "SPAN_FIRST", "SPAN_LAST", "COUNTS")
KINKS_A_CONTACT = 4
OUTLINE = 1.01  # by which an outline is drawn too large, for safety


def layout(capacity: int) -> MappingProxyType[str, int]:
    """Return the constants of `physics.types` for scratch with room for some contacts, by name."""
    places = {name: getattr(types, name) // types.STRIDE * capacity for name in ROWS_OF_TABLE}
    marks = {name: getattr(types, name) // types.STRIDE * capacity for name in ROWS_OF_MARKS}
    counts = marks["COUNTS"]
    return MappingProxyType(
        {
            "CAPACITY": capacity,
            "STRIDE": capacity,
            **places,
            "TABLE_SIZE": places["KINKS"] + KINKS_A_CONTACT * capacity,
            **marks,
            "SPANS": counts + types.SPANS - types.COUNTS,
            "SUPPORTS": counts + types.SUPPORTS - types.COUNTS,
            "MARKS_SIZE": counts + types.MARKS_SIZE - types.COUNTS,
        }
    )


def capacity_of(settings: EnvConfig) -> int:
    """Room for the contacts and the edges of every parcel that an environment's task draws."""
    parcels = settings.task.parcels
    return capacity_for([parcel.base for parcel in parcels], settings.chosen_line)


def capacity_for(bases: Sequence[Base], plant: BaseLine) -> int:
    """Return the room for the contacts and edges of any of some bases on a line."""
    pitches = (plant.geometry.pitch_x, plant.geometry.pitch_y)
    contacts = [most_contacts(base, pitches) for base in bases]
    return max(FEWEST_EDGES, *contacts, *(len(base.edges) for base in bases))


def most_contacts(base: Base, pitches: tuple[float, float]) -> int:
    """Return the most elements that a base covers, however it lies.

    A convex figure of area A and perimeter P covers at most A + P / 2 + 1 points of the unit
    lattice (Nosarzewska, Evaluation de la difference entre l'aire d'une region plane convexe et le
    nombre des points aux coordonnees entieres couverts par elle, 1948).

    Args:
        base: of a parcel.
        pitches: [m] between elements, in x and in y.
    """
    corners = OUTLINE * base.outline  # a round base's outline is a polygon within it
    following = np.roll(corners, -1, axis=0)
    area = 0.5 * np.sum(corners[:, 0] * following[:, 1] - corners[:, 1] * following[:, 0])
    perimeter = np.hypot(*(following - corners).T).sum()
    return math.ceil(area / math.prod(pitches) + 0.5 * perimeter / min(pitches) + 1.0)


class Note:
    """A copy of a tensor's value, to be read later: only then does the host wait for it."""

    def __init__(self, values: torch.Tensor) -> None:
        self._event: Any = None
        if values.is_cuda:
            self._event = torch.cuda.Event()  # type: ignore[no-untyped-call]
        self._values = torch.empty(values.shape, dtype=values.dtype, pin_memory=values.is_cuda)
        self._values.copy_(values, non_blocking=True)
        if self._event is not None:
            self._event.record()

    def read(self) -> NDArray[Any]:
        """Return the values as a new array."""
        if self._event is not None:
            self._event.synchronize()
        values: NDArray[Any] = self._values.numpy().copy()
        return values


def sent(values: NDArray[Any], device: torch.device) -> torch.Tensor:
    """Send an array to a device without waiting for it."""
    copy = torch.from_numpy(np.array(values))
    return (copy.pin_memory() if device.type == "cuda" else copy).to(device, non_blocking=True)
