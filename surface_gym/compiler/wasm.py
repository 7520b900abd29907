"""WebAssembly modules, compiled from the functions of the CPU's kernels.

Numba lowers a kernel and all that it calls to LLVM's code, which is optimised here for WebAssembly
alone: code that was optimised for another machine counts on its pointers' size. A module has a
function `step(words) -> int32`, which takes the address of the kernel's arguments, a word of 8
bytes each, and returns what the kernel does, or -1 where an index was out of bounds. Sine, cosine
and `hypot` are part of it; what else WebAssembly lacks of C's mathematics, such as `exp`, it
imports. The same source gives the same bytes, and a note at a module's end says of which source it
is.
"""

import inspect
import re
from functools import lru_cache
from pathlib import Path
from types import FunctionType
from typing import Any, NamedTuple

import llvmlite
import llvmlite.binding as llvm
import numba
from numba import float64, typeof
from numba.core.compiler_machinery import register_pass

from surface_gym.compiler import exact, wasm_linker
from surface_gym.compiler.jit import collecting_nothing, compute_digest, locked
from surface_gym.compiler.linking import (
    LinkedCode,
    LinkedFunction,
    LowerToLinkedCode,
    PassesCompiler,
)
from surface_gym.compiler.translator import Translator
from surface_gym.compiler.wasm_image import WORD, compute_signature, name_arguments
from surface_gym.compiler.wasm_linker import link, make_note
from surface_gym.files import replacing

TRIPLE = "wasm32-unknown-unknown"
# What browsers have had since 2021.
FEATURES = "+simd128,+bulk-memory,+sign-ext,+nontrapping-fptoint,+mutable-globals"
MATHEMATICS = {"sin": exact.sin, "cos": exact.cos, "hypot": exact.hypot}  # that modules have
OUT_OF_BOUNDS = -1  # what a module returns where an index was beyond an array's end
_KEPT = ("nogil", "error_model", "forceinline", "boundscheck", "_nrt")  # options of a function


class Module(NamedTuple):
    """A kernel as WebAssembly."""

    code: bytes
    signature: str  # of the images that it takes


class PortableCode(LinkedCode):
    """LLVM's code of a function as it was lowered, linked with all that it calls in the end."""

    def __init__(self, codegen: Any, name: str, _: bool) -> None:
        super().__init__(codegen, name, inlined=False)

    def _optimize_final_module(self) -> None:
        """Leave the code as it is."""

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerToPortableCode(LowerToLinkedCode):
    """Numba's lowering to LLVM's code."""

    _name = "lower_to_portable_code"
    code = PortableCode


class _PortableCompiler(PassesCompiler):
    """Compiler of functions for WebAssembly."""

    lowering = _LowerToPortableCode


class PortableFunction(LinkedFunction):
    """A function that becomes part of a WebAssembly module."""

    compiler = _PortableCompiler


def _wrap(copy: FunctionType, original: Any) -> PortableFunction:
    options = {
        name: original.targetoptions[name] for name in _KEPT if name in original.targetoptions
    }
    return PortableFunction(copy, no_cfunc_wrapper=True, **options)


@lru_cache(maxsize=1)
def _translator() -> Translator:
    """Return the translator of all kernels, which share most of what they call."""
    return Translator(_wrap)


def compile_module(
    kernel: Any, arguments: tuple[Any, ...], file: Path | None = None, exports: tuple[str, ...] = ()
) -> Module:
    """Compile a kernel for arguments of these types; takes ten seconds to a minute.

    Args:
        kernel: a compiled function that Python calls, and which returns an integer or nothing;
            then the module returns 0.
        arguments: arrays, numbers, and named tuples of them.
        file: of the module, which is read if it is of this source, and else written.
        exports: functions of `MATHEMATICS` that a page calls, too.
    """
    signature = compute_signature(name_arguments(kernel, arguments))
    mathematics = tuple(MATHEMATICS.values())
    note = make_note(
        "source", compute_digest(kernel, signature, _compiler(), exports, mathematics).encode()
    )
    if file is None:
        return Module(_compile(kernel, arguments, exports) + note, signature)
    file.parent.mkdir(parents=True, exist_ok=True)
    with locked(file.with_suffix(".lock")):
        if file.is_file() and (code := file.read_bytes()).endswith(note):
            return Module(code, signature)
        code = _compile(kernel, arguments, exports) + note
        with replacing(file) as part:
            part.write_bytes(code)
    return Module(code, signature)


@lru_cache(maxsize=1)
def _compiler() -> tuple[Any, ...]:
    """Return what a module depends on beside its kernel."""
    sources = [Path(each).read_bytes() for each in (__file__, wasm_linker.__file__)]
    return numba.__version__, llvmlite.__version__, *sources


def _compile(kernel: Any, arguments: tuple[Any, ...], exports: tuple[str, ...]) -> bytes:
    code, name = _lower(kernel, tuple(map(typeof, arguments)))
    parts = [code]
    for own, function in MATHEMATICS.items():
        called = re.compile(rf"@(llvm\.)?{own}(\.f64)?(?=\()")
        if own in exports or called.search(parts[0]):
            count = len(inspect.signature(function.py_func).parameters)
            method, inner = _lower(function, (float64,) * count)
            parts[0] = called.sub(f"@{own}", parts[0])
            parts += [_method(own, inner, count), method]  # a call is linked to what comes later
    modules = [llvm.parse_assembly(part) for part in parts]
    return link(_make_object(modules, name, exports), (*exports, "step"))


def _lower(function: Any, kinds: tuple[Any, ...]) -> tuple[str, str]:
    """Lower a function for arguments of some types; return LLVM's code and the function's name."""
    portable = _translator().translate(function)
    with collecting_nothing():
        portable.compile(kinds)
    compiled = portable.overloads[kinds]
    return str(compiled.library._get_module_for_linking()), compiled.fndesc.llvm_func_name


@lru_cache(maxsize=1)
def _machine() -> Any:
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple(TRIPLE)
    return target.create_target_machine(opt=3, features=FEATURES, reloc="static")


def _make_object(modules: list[Any], name: str, exports: tuple[str, ...]) -> bytes:
    """Optimise LLVM's code of a kernel, the first of some modules, with an entry of our own."""
    machine, module = _machine(), modules[0]
    kernel = module.get_function(name)
    kernel.add_function_attribute("alwaysinline")  # browsers allow no function so many arguments
    entry = llvm.parse_assembly(_entry(name, [str(each.type) for each in kernel.arguments]))
    for each in (*modules, entry):
        each.data_layout, each.triple = str(machine.target_data), TRIPLE
    for each in (*modules[1:], entry):
        module.link_in(each)
    for each in (*module.functions, *module.global_variables):
        if not each.is_declaration and each.name not in (*exports, "step"):
            each.linkage = "internal"
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_vectorization = options.slp_vectorization = True
    passes = llvm.create_pass_builder(machine, options)
    passes.getModulePassManager().run(module, passes)
    return bytes(machine.emit_object(module))


def _method(own: str, inner: str, count: int) -> str:
    """Write a function of mathematics as C has it, by the lowered function of so many numbers."""
    given = ", ".join(f"double %x{k}" for k in range(count))
    return f"""
declare i32 @"{inner}"(ptr, ptr, {", ".join(["double"] * count)})
define double @{own}({given}) noinline {{
  %result = alloca double
  %error = alloca ptr
  %status = call i32 @"{inner}"(ptr %result, ptr %error, {given})
  %value = load double, ptr %result
  ret double %value
}}
"""


def _entry(name: str, kinds: list[str]) -> str:
    """Write the module's function, which reads the kernel's arguments of these types of LLVM's."""
    words = "\n".join(
        f"  %p{k} = getelementptr i8, ptr %words, i32 {WORD * k}\n"
        f"  %v{k} = load {kind}, ptr %p{k}, align {WORD}"
        for k, kind in enumerate(kinds[2:])
    )
    given = ", ".join(f"{kind} %v{k}" for k, kind in enumerate(kinds[2:]))
    return f"""
declare i32 @"{name}"({", ".join(kinds)})
define i32 @step(ptr %words) {{
  %result = alloca i64
  store i64 0, ptr %result
  %error = alloca ptr
{words}
  %status = call i32 @"{name}"(ptr %result, ptr %error, {given})
  %count = load i64, ptr %result
  %short = trunc i64 %count to i32
  %fine = icmp eq i32 %status, 0
  %returned = select i1 %fine, i32 %short, i32 {OUT_OF_BOUNDS}
  ret i32 %returned
}}
"""
