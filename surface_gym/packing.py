"""Packing tables of numbers: rounded, and as changes, so that they compress well."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym.physics.types import Array


def pack(name: str, values: NDArray[Any], units: tuple[float, ...]) -> bytes:
    """Round a table (rows, columns), and keep what its second differences down a column are.

    They are made positive, and their bytes lie apart: the first of all numbers, then the second ...
    """
    counts = np.rint(values / np.array(units))
    if counts.size and np.abs(counts).max() >= 2**31:
        raise ValueError(f"{name} must be less than {2**31} units of {units} to be saved")
    change = np.diff(counts.astype(np.int64), n=2, axis=0, prepend=np.zeros((2, len(units))))
    change = change.astype(np.int64)
    folded = ((change << 1) ^ (change >> 63)).T.astype("<u8").reshape(-1, 1)
    planes: bytes = folded.view(np.uint8)[:, :5].T.tobytes()
    return planes


def unpack(planes: NDArray[np.uint8], units: tuple[float, ...]) -> Array:
    """Compute the table (rows, columns) whose bytes `pack` returned."""
    padded = np.zeros((planes.size // 5, 8), dtype=np.uint8)
    padded[:, :5] = planes.reshape(5, -1).T
    folded = padded.view("<u8").astype(np.int64).reshape(len(units), -1).T
    change = (folded >> 1) ^ -(folded & 1)
    return np.cumsum(np.cumsum(change, axis=0), axis=0) * np.array(units)


class Reader:
    """Bytes of a recording, taken one part after the other."""

    def __init__(self, content: bytes) -> None:
        self._left = memoryview(content)

    def take(self, size: int) -> NDArray[np.uint8]:
        if not 0 <= size <= len(self._left):
            raise ValueError(f"it must hold {size} bytes more, got {len(self._left)}")
        part, self._left = self._left[:size], self._left[size:]
        return np.frombuffer(part, dtype=np.uint8)

    def table(self, rows: int, units: tuple[float, ...]) -> Array:
        if rows == 0 or not units:
            return np.zeros((rows, len(units)))
        return unpack(self.take(5 * rows * len(units)), units)

    def check_end(self) -> None:
        if len(self._left):
            raise ValueError(f"it must end, got {len(self._left)} bytes more")
