"""Memory images: arguments of a kernel in the memory of a WebAssembly module.

An image is a block of bytes and a layout. The block holds the arguments as words of 8 bytes,
followed by the arrays; an array's word is its address. The layout lists every array and number by
name, with type, shape and address. Scratch comes last: a kernel writes it before reading it, so it
needs memory but no bytes in the block.
"""

import hashlib
import inspect
import json
import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from surface_gym.compiler.wasm_linker import STACK

BASE = STACK  # [bytes] address of an image: past the module's constants and stack
WORD = 8  # [bytes] size of an argument
ALIGNMENT = 16  # [bytes] alignment of arrays
SCRATCH = ("scratch.", "sensor_scratch.")  # prefixes of names of scratch
KINDS = ("bool", "float32", "float64", "int32", "int64")  # types of arrays
NUMBERS = ("float64", "int64")  # types of numbers


@dataclass(frozen=True)
class MemoryField:
    """An array or a number among a kernel's arguments."""

    name: str  # e.g. `parcels.state`
    dtype: str  # one of KINDS
    shape: tuple[int, ...]  # () for a number
    address: int

    @property
    def size(self) -> int:
        """Size in bytes."""
        return np.dtype(self.dtype).itemsize * math.prod(self.shape)


@dataclass(frozen=True)
class MemoryImage:
    """A kernel's arguments as bytes."""

    fields: tuple[MemoryField, ...]
    block: bytes  # content of the memory from BASE on
    end: int  # [bytes] address past the last array or scratch
    signature: str  # digest of the arguments' names and types, required by the module

    @cached_property
    def places(self) -> dict[str, MemoryField]:
        """Fields by name."""
        return {field.name: field for field in self.fields}

    def layout(self) -> dict[str, Any]:
        """Return the layout for JavaScript; `fields` maps each name to [type, shape, address]."""
        return {
            "signature": self.signature,
            "base": BASE,
            "bytes": len(self.block),
            "end": self.end,
            "fields": {each.name: [each.dtype, each.shape, each.address] for each in self.fields},
        }

    def to_json(self) -> str:
        """Return the layout as a line of JSON."""
        return json.dumps(self.layout(), separators=(",", ":")) + "\n"


def name_arguments(kernel: Any, arguments: tuple[Any, ...]) -> dict[str, Any]:
    """Return the arrays and numbers in a kernel's arguments by name, in order.

    The name of a named tuple's field is the tuple's name, a dot and the field's name.
    """
    names = inspect.signature(kernel.py_func).parameters
    return dict(_leaves("", dict(zip(names, arguments, strict=True))))


def _leaves(prefix: str, values: dict[str, Any]) -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        if hasattr(value, "_asdict"):
            yield from _leaves(f"{prefix}{name}.", value._asdict())
        else:
            yield prefix + name, value


def compute_signature(leaves: dict[str, Any]) -> str:
    """Compute a digest of the names, types and dimensions of a kernel's arguments.

    `leaves` are the arrays and numbers by name, from `name_arguments`.
    """
    kinds = [(name, np.asarray(v).dtype.name, np.ndim(v)) for name, v in leaves.items()]
    return hashlib.sha256(repr(kinds).encode()).hexdigest()[:16]


def make_image(kernel: Any, arguments: tuple[Any, ...]) -> MemoryImage:
    """Make the memory image of a kernel's arguments.

    Args:
        kernel: compiled function that Python can call.
        arguments: C-contiguous arrays, integers, floats, and named tuples of arrays and numbers.
    """
    leaves = name_arguments(kernel, arguments)
    arrays = {name: np.asarray(value) for name, value in leaves.items()}
    end = block = BASE + WORD * sum(map(_count_words, arrays.values()))
    addresses: dict[str, int] = {}
    for name in sorted(arrays, key=is_scratch):
        if arrays[name].ndim:
            addresses[name] = end
            end += -(-arrays[name].nbytes // ALIGNMENT) * ALIGNMENT
            block = block if is_scratch(name) else end
    memory = np.zeros(block - BASE, dtype=np.uint8)
    fields: list[MemoryField] = []
    words: list[int] = []
    for name, values in arrays.items():
        _check(name, values)
        address = addresses.get(name, BASE + WORD * len(words))
        fields.append(MemoryField(name, values.dtype.name, values.shape, address))
        if values.ndim == 0:
            words.append(int(values.view(np.int64)))
            continue
        # Numba's array structure: two null owners, and numbers that follow from the shape.
        words += [0, 0, values.size, values.itemsize, address, *values.shape, *values.strides]
        if not is_scratch(name):
            first = address - BASE
            memory[first : first + values.nbytes] = values.reshape(-1).view(np.uint8)
    memory[: WORD * len(words)] = np.array(words, dtype=np.int64).view(np.uint8)
    return MemoryImage(tuple(fields), memory.tobytes(), end, compute_signature(leaves))


def is_scratch(name: str) -> bool:
    """Return whether the argument `name` is scratch, i.e. work memory of a kernel."""
    return name.startswith(SCRATCH)


def _count_words(values: np.ndarray) -> int:
    """Return the number of words that Numba uses for an array or a number."""
    return 5 + 2 * values.ndim if values.ndim else 1


def _check(name: str, values: np.ndarray) -> None:
    allowed = KINDS if values.ndim else NUMBERS
    if values.dtype.name not in allowed or not values.flags.c_contiguous:
        raise ValueError(
            f"{name} must be of {', '.join(allowed)} and C-contiguous, got {values.dtype} with "
            f"strides {values.strides}"
        )
