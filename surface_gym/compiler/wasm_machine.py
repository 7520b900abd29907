"""A module run by wasmtime in Python, like in a browser, for tests."""

import ctypes
from typing import Any

import llvmlite.binding as llvm
import numpy as np
import wasmtime
from numpy.typing import NDArray

from surface_gym.compiler.wasm import Module
from surface_gym.compiler.wasm_image import BASE, MemoryImage

PAGE = 64 * 1024  # [bytes] of a page of memory


class Machine:
    """An instance of a module with its memory."""

    def __init__(self, module: Module) -> None:
        self._signature = module.signature
        engine = wasmtime.Engine()
        self._store = wasmtime.Store(engine)
        code = wasmtime.Module(engine, module.code)
        given = [self._import(each.type, str(each.name)) for each in code.imports]
        exports: Any = wasmtime.Instance(self._store, code, given).exports(self._store)
        self._memory = exports["memory"]
        self._step = exports["step"]
        self._image: MemoryImage | None = None

    def _import(self, kind: Any, name: str) -> wasmtime.Func:
        """Make an import of the module from the C function that the CPU's code calls."""
        function = ctypes.CFUNCTYPE(ctypes.c_double, *[ctypes.c_double] * len(kind.params))
        return wasmtime.Func(self._store, kind, function(llvm.address_of_symbol(name)))

    def load(self, image: MemoryImage) -> None:
        """Write an image into the memory. Arrays from earlier calls of `view` become invalid."""
        if image.signature != self._signature:
            raise ValueError(
                f"image must be of the module's kernel, {self._signature}, got {image.signature}"
            )
        short = image.end - self._memory.data_len(self._store)
        if short > 0:
            self._memory.grow(self._store, -(-short // PAGE))
        self._memory.write(self._store, image.block, BASE)
        self._image = image

    def step(self) -> int:
        """Call the kernel; return its result, or -1 if an index was out of bounds."""
        return int(self._step(self._store, BASE))

    def view(self, name: str) -> NDArray[Any]:
        """Return a view of an array or a number by name, e.g. `parcels.state`."""
        if self._image is None or name not in self._image.places:
            names = ", ".join(self._image.places) if self._image else "none before an image"
            raise ValueError(f"name must be one of {names}, got {name!r}")
        field = self._image.places[name]
        start = ctypes.addressof(self._memory.data_ptr(self._store).contents) + field.address
        seen = np.ctypeslib.as_array((ctypes.c_uint8 * field.size).from_address(start))
        return seen.view(field.dtype).reshape(field.shape)
