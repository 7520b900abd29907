"""Numba's lowering to LLVM code, with less code for tuples of arrays.

The state of a batch is a few named tuples with hundreds of numbers, most of them pointers and
sizes of arrays. Numba passes each number as an argument of its own, and takes the tuple apart in
the caller and together again in the callee. It also writes a variable that several blocks use to
the stack. Three quarters of all instructions did only this. Here a tuple or an array is one
argument, and a variable with one assignment stays a value. The machine code does the same
arithmetic.
"""

from collections import Counter
from collections.abc import Iterator
from functools import cached_property
from typing import Any

from llvmlite.ir import IRBuilder
from numba.core import cgutils
from numba.core.analysis import compute_cfg_from_blocks, compute_use_defs
from numba.core.callconv import CPUCallConv
from numba.core.compiler import Flags
from numba.core.datamodel.packer import ArgPacker
from numba.core.imputils import fix_returning_optional
from numba.core.ir import Assign
from numba.core.lowering import Lower
from numba.core.types import Array
from numba.core.types.containers import BaseTuple


class _Arguments:
    """Arguments of a function as LLVM values: whole tuples and arrays, and Numba's form of others.

    It has the methods of Numba's `ArgPacker`.
    """

    def __init__(self, models: Any, kinds: tuple[Any, ...]) -> None:
        self._models = [models.lookup(kind) for kind in kinds]
        self._packers = [
            None if isinstance(kind, (BaseTuple, Array)) else ArgPacker(models, [kind])
            for kind in kinds
        ]

    @cached_property
    def argument_types(self) -> tuple[Any, ...]:
        return tuple(
            kind
            for model, packer in self._each()
            for kind in (packer.argument_types if packer else [model.get_value_type()])
        )

    def as_arguments(self, builder: Any, values: Any) -> tuple[Any, ...]:
        given: list[Any] = []
        for (model, packer), value in zip(self._each(), values, strict=True):
            if packer:
                given += packer.as_arguments(builder, [value])
            elif value.type == model.get_value_type():
                given.append(value)
            else:  # tuples of equal numbers have two forms
                given.append(model.from_argument(builder, model.as_argument(builder, value)))
        return tuple(given)

    def from_arguments(self, builder: Any, given: Any) -> list[Any]:
        return [
            packer.from_arguments(builder, own)[0] if packer else own[0]
            for packer, own in self._split(given)
        ]

    def assign_names(self, given: Any, names: list[str]) -> None:
        for (packer, own), name in zip(self._split(given), names, strict=True):
            if packer:
                packer.assign_names(own, [name])
            else:
                own[0].name = name

    def _each(self) -> Iterator[tuple[Any, Any]]:
        return zip(self._models, self._packers, strict=True)

    def _split(self, given: Any) -> Iterator[tuple[Any, list[Any]]]:
        """Iterate over the packer and the LLVM values of each argument."""
        first = 0
        for packer in self._packers:
            count = len(packer.argument_types) if packer else 1
            yield packer, list(given[first : first + count])
            first += count


class FlatArguments(CPUCallConv):
    """Numba's calling convention: each number of a tuple is an argument."""

    def declare_function(self, module: Any, described: Any) -> Any:
        """Declare a function in an LLVM module, like Numba's method of its context."""
        kind = self.get_function_type(described.restype, described.argtypes)
        function = cgutils.get_or_insert_function(module, kind, described.mangled_name)
        self.decorate_function(function, described.args, described.argtypes)
        if described.inline:
            function.attributes.add("alwaysinline")
        return function

    def call(self, builder: Any, described: Any, signature: Any, values: Any) -> Any:
        """Call a function and pass its error on; return its result."""
        function = self.declare_function(builder.module, described)
        kinds = described.argtypes
        status, result = self.call_function(builder, function, described.restype, kinds, values)
        with cgutils.if_unlikely(builder, status.is_error):
            self.return_status_propagate(builder, status)
        return fix_returning_optional(self.context, builder, signature, status, result)


class WholeArguments(FlatArguments):
    """Calling convention of functions that only compiled code calls: a tuple is one argument."""

    def _get_arg_packer(self, kinds: tuple[Any, ...]) -> _Arguments:
        return _Arguments(self.context.data_model_manager, kinds)


class ValueLower(Lower):
    """Numba's lowering, in which variables with one assignment are values, not stack slots.

    The library that takes the code tells the calling convention.
    """

    @property
    def call_conv(self) -> FlatArguments:
        return self.library.convention(self.context)

    def setup_function(self, described: Any) -> None:
        """Declare the function in its calling convention, and begin its code."""
        self.function = self.call_conv.declare_function(self.module, described)
        self.entry_block = self.function.append_basic_block("entry")
        self.builder = IRBuilder(self.entry_block)
        self.call_helper = self.call_conv.init_call_helper(self.builder)

    def _find_singly_assigned_variable(self) -> None:
        """Find the variables that stay values: their only assignment precedes every use.

        Numba's own method finds those that a single block assigns and uses.
        """
        blocks = self.func_ir.blocks
        dominators = compute_cfg_from_blocks(blocks).dominators()
        assigned = Counter(
            each.target.name for block in blocks.values() for each in block.find_insts(Assign)
        )
        uses = compute_use_defs(blocks)
        users: dict[str, list[int]] = {}  # blocks that use a variable of another block
        for place, names in uses.usemap.items():
            for name in names:
                users.setdefault(name, []).append(place)
        self._singly_assigned_vars = {
            name
            for place, names in uses.defmap.items()
            for name in names
            if assigned[name] == 1
            and all(user > place and place in dominators[user] for user in users.get(name, ()))
        }
        self._blk_local_varmap: dict[str, Any] = {}  # their LLVM values

    def delvar(self, name: str) -> None:
        """Delete a variable; a value needs no care, since nothing here counts references."""
        if name not in self._singly_assigned_vars:
            super().delvar(name)


_OPTIONS_HASH = hash(Flags())


class QuickFlags(Flags):
    """Numba's options of a function, which Numba compares at every call that it resolves."""

    __slots__ = ()

    def __hash__(self) -> int:
        return _OPTIONS_HASH  # Numba, too, hashes only the names of the options

    def __eq__(self, other: object) -> bool:
        same = isinstance(other, QuickFlags) and self._values == other._values
        return same or bool(super().__eq__(other))
