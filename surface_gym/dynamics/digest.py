"""A digest of all that goes into a compiled function: its code, and that of what it calls.

The walk follows names as the compiler does: from a function to the functions and constants it
refers to, whichever files they stand in. An edit anywhere among them, and nowhere else, changes the
digest.
"""

import hashlib
import types
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

LENGTH = 16  # hexadecimal digits


def digest_of(function: Any, *others: Any) -> str:
    """Digest of a function, compiled or plain, and of other values that count."""
    walk = _Walk()
    walk.take(function)
    for other in others:
        walk.take(other)
    return walk.hash.hexdigest()[:LENGTH]


class _Walk:
    """Takes in values, each function once."""

    def __init__(self) -> None:
        self.hash = hashlib.sha256()
        self._seen: set[int] = set()

    def take(self, value: Any) -> None:
        """Take in whatever compiled code may refer to."""
        if isinstance(value, Dispatcher):
            self._write("compiled", sorted(value.targetoptions.items(), key=str))
            value = value.py_func
        if isinstance(value, types.FunctionType):
            self._take_function(value)
        elif isinstance(value, types.CodeType):
            self._take_code(value)
        elif isinstance(value, np.ndarray):
            self._write("array", value.dtype.str, value.shape, value.tobytes())
        elif isinstance(value, (tuple, list)):
            self._write(type(value).__qualname__, len(value))
            for each in value:
                self.take(each)
        elif isinstance(value, type):
            self._write("type", value.__module__, value.__qualname__)
            self.take(getattr(value, "_fields", ()))
        elif isinstance(value, types.ModuleType):
            self._write("module", value.__name__)
        elif callable(value):
            self._write(getattr(value, "__module__", ""), getattr(value, "__qualname__", ""))
        else:
            self._write(type(value).__qualname__, value)

    def _take_function(self, function: types.FunctionType) -> None:
        if id(function) in self._seen:
            return
        self._seen.add(id(function))
        self._write("function", function.__module__, function.__qualname__)
        self.take(function.__defaults__ or ())
        self._take_code(function.__code__)
        for cell in function.__closure__ or ():
            self.take(cell.cell_contents)
        modules = []
        for name in sorted(names_of(function.__code__)):
            if name in function.__globals__:
                value = function.__globals__[name]
                self._write("global", name)
                self.take(value)
                if isinstance(value, types.ModuleType):
                    modules.append(value)
        for module in modules:  # `module.name`: whatever of its names the function may mean
            for name in sorted(names_of(function.__code__)):
                if hasattr(module, name) and not _is_library(module):
                    self._write("of module", name)
                    self.take(getattr(module, name))

    def _take_code(self, code: types.CodeType) -> None:
        self._write(code.co_code, code.co_names, code.co_varnames, code.co_freevars)
        for constant in code.co_consts:
            self.take(constant)

    def _write(self, *values: Any) -> None:
        self.hash.update(repr(values).encode())


def names_of(code: types.CodeType) -> set[str]:
    """Names that a function refers to, those of its inner functions included."""
    inner = (each for each in code.co_consts if isinstance(each, types.CodeType))
    return set(code.co_names).union(*map(names_of, inner))


def _is_library(module: types.ModuleType) -> bool:
    """Whether a module's names mean the same for as long as Numba's version stays."""
    return module.__name__.partition(".")[0] in ("math", "numba", "numpy")
