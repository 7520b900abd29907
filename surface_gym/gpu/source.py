"""The physics' source for another compiler.

Compiled functions are walked as the digest walks them, from a function to those it refers to, and
each is made again from the same code: with other constants, and wrapped for the other compiler.
Nothing is written twice.
"""

from collections.abc import Callable, Mapping
from types import CellType, FunctionType
from typing import Any

from numba.core.dispatcher import Dispatcher

from surface_gym.dynamics import types
from surface_gym.dynamics.digest import names_of

Wrap = Callable[[Callable[..., Any]], Any]


class Source:
    """Functions made again, each once.

    Args:
        constants: of `dynamics.types`, by name, in place of those there.
        wrap: makes a function that others call one of the other compiler's.
    """

    def __init__(self, constants: Mapping[str, int], wrap: Wrap) -> None:
        self._constants = constants
        self._wrap = wrap
        self._made: dict[int, Any] = {}
        self._kept: list[Any] = []  # what `_made` knows by its address

    def remade(self, function: Any) -> Any:
        """A function of the physics, of a task or of a sensor, for the other compiler."""
        if id(function) not in self._made:
            plain = function.py_func if isinstance(function, Dispatcher) else function
            copy = _empty_copy(plain)
            self._kept.append(function)
            self._made[id(function)] = self._wrap(copy)
            self._fill(copy, plain)
        return self._made[id(function)]

    def _fill(self, copy: FunctionType, plain: FunctionType) -> None:
        """Let a copy refer to what its original refers to, made again."""
        for name in names_of(plain.__code__):
            if name in plain.__globals__:
                copy.__globals__[name] = self._value(name, plain.__globals__[name])
        cells = zip(copy.__closure__ or (), plain.__closure__ or (), strict=True)
        for name, (cell, original) in zip(plain.__code__.co_freevars, cells, strict=True):
            cell.cell_contents = self._value(name, original.cell_contents)

    def _value(self, name: str, value: Any) -> Any:
        if isinstance(value, Dispatcher):
            return self.remade(value)
        if name in self._constants and value == getattr(types, name):
            return self._constants[name]
        return value


def _empty_copy(function: FunctionType) -> FunctionType:
    """The same code, that refers to nothing yet."""
    known = {"__name__": function.__module__, "__builtins__": __builtins__}
    cells = tuple(CellType() for _ in function.__code__.co_freevars)
    copy = FunctionType(function.__code__, known, function.__name__, function.__defaults__, cells)
    copy.__module__, copy.__qualname__ = function.__module__, function.__qualname__
    return copy
