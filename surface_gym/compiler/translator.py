"""Translation of the CPU kernels' functions for another compiler.

`Translator` copies a compiled function and, in turn, all functions that it calls. In the copies,
chosen constants have other values. Each copy is then wrapped for the other compiler. So no function
is written twice.
"""

from collections.abc import Callable, Mapping
from types import CellType, FunctionType, MappingProxyType, ModuleType
from typing import Any

from numba.core.dispatcher import Dispatcher

from surface_gym.compiler.jit import is_library, referenced_names

Wrap = Callable[[FunctionType, Any], Any]  # arguments: the copy of a function, and its original


class Translator:
    """The CPU's functions, each translated once for another compiler.

    Args:
        wrap: function that compiles a copy for the other compiler.
        constants: new values for some constants of `module`, keyed by the constants' names.
        module: module that defines these constants for the CPU.
    """

    def __init__(
        self,
        wrap: Wrap,
        constants: Mapping[str, int] = MappingProxyType({}),
        module: ModuleType | None = None,
    ) -> None:
        self._constants = constants
        self._module_replaced = module
        self._wrap = wrap
        self._translated: dict[int, Any] = {}
        self._modules: dict[str, ModuleType] = {}
        self._originals: list[Any] = []  # keeps the addresses in `_translated` valid

    def translate(self, function: Any) -> Any:
        """Return the translation of a function of the physics, a task or a sensor."""
        if id(function) not in self._translated:
            plain = function.py_func if isinstance(function, Dispatcher) else function
            copy = _empty_copy(plain)
            self._originals.append(function)
            self._translated[id(function)] = self._wrap(copy, function)
            self._fill(copy, plain)
        return self._translated[id(function)]

    def _fill(self, copy: FunctionType, plain: FunctionType) -> None:
        """Set in `copy` the translated values of all names that the function `plain` refers to."""
        names = referenced_names(plain.__code__)
        for name in names:
            if name in plain.__globals__:
                value = plain.__globals__[name]
                if isinstance(value, ModuleType) and not is_library(value):
                    copy.__globals__[name] = self._module(value, names)
                else:
                    copy.__globals__[name] = self._value(name, value)
        cells = zip(copy.__closure__ or (), plain.__closure__ or (), strict=True)
        for name, (cell, original) in zip(plain.__code__.co_freevars, cells, strict=True):
            cell.cell_contents = self._value(name, original.cell_contents)

    def _module(self, module: ModuleType, names: set[str]) -> ModuleType:
        """Return a stand-in for a module. The stand-in holds translated values of `names`."""
        translated = self._modules.setdefault(module.__name__, ModuleType(module.__name__))
        for name in names:
            if hasattr(module, name) and not hasattr(translated, name):
                setattr(translated, name, self._value(name, getattr(module, name)))
        return translated

    def _value(self, name: str, value: Any) -> Any:
        """Return `value` as the other compiler needs it.

        A function is translated. If `value` is the constant `name` and this constant has a new
        value, the new value is returned. Any other value is returned unchanged.
        """
        if isinstance(value, Dispatcher):
            return self.translate(value)
        if name in self._constants and value == getattr(self._module_replaced, name):
            return self._constants[name]
        return value


def _empty_copy(function: FunctionType) -> FunctionType:
    """Return a function with the same code and no globals yet."""
    known = {"__name__": function.__module__, "__builtins__": __builtins__}
    cells = tuple(CellType() for _ in function.__code__.co_freevars)
    copy = FunctionType(function.__code__, known, function.__name__, function.__defaults__, cells)
    copy.__module__, copy.__qualname__ = function.__module__, function.__qualname__
    return copy
