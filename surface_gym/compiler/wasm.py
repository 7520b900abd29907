"""WebAssembly modules, compiled from the functions of the CPU's kernels.

Numba lowers a kernel and its callees to LLVM code. The code is optimised here for WebAssembly only,
since code optimised for another machine depends on its pointer size. A module has a function
`step(words) -> int32`. It takes the address of the kernel's arguments, in words of 8 bytes. It
returns the kernel's result, or -1 if an index was out of bounds. Sine, cosine and `hypot` are part
of the module; other C mathematics, e.g. `exp`, is imported. The same source gives the same bytes,
and a note at the end of a module identifies its source.
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

from surface_gym.compiler import exact, lowering, wasm_linker
from surface_gym.compiler.jit import compute_digest, locked
from surface_gym.compiler.linking import (
    LinkedCode,
    LinkedFunction,
    LowerToLinkedCode,
    PassesCompiler,
    collecting_nothing,
)
from surface_gym.compiler.lowering import FlatArguments
from surface_gym.compiler.translator import Translator
from surface_gym.compiler.wasm_image import WORD, compute_signature, name_arguments
from surface_gym.compiler.wasm_linker import link, make_note
from surface_gym.files import replacing

TRIPLE = "wasm32-unknown-unknown"
# Features of browsers since 2021.
FEATURES = "+simd128,+bulk-memory,+sign-ext,+nontrapping-fptoint,+mutable-globals"
MATHEMATICS = {"sin": exact.sin, "cos": exact.cos, "hypot": exact.hypot}  # functions inside modules
OUT_OF_BOUNDS = -1  # result of a module after an index out of bounds
# compiler options of a function that stay
_KEPT = ("nogil", "error_model", "forceinline", "boundscheck", "_nrt")


class Module(NamedTuple):
    """A kernel as WebAssembly."""

    code: bytes
    signature: str  # signature of its images


class PortableCode(LinkedCode):
    """Unoptimised LLVM code of a function, linked with its callees at the end."""

    def __init__(self, codegen: Any, name: str, _: bool) -> None:
        super().__init__(codegen, name, inlined=False)

    def _optimize_final_module(self) -> None:
        """Do not optimise the code."""

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout


class _PortableKernelCode(PortableCode):
    """Unoptimised LLVM code of a kernel, whose arguments a page writes one by one."""

    convention = FlatArguments


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerToPortableCode(LowerToLinkedCode):
    """Numba's lowering of a function to unoptimised LLVM code."""

    _name = "lower_to_portable_code"
    code = PortableCode


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerToPortableKernel(_LowerToPortableCode):
    """Numba's lowering of a kernel to unoptimised LLVM code."""

    _name = "lower_to_portable_kernel"
    code = _PortableKernelCode


class _PortableCompiler(PassesCompiler):
    """Compiler of functions for WebAssembly."""

    lowering = _LowerToPortableCode


class _PortableKernelCompiler(PassesCompiler):
    """Compiler of kernels for WebAssembly."""

    lowering = _LowerToPortableKernel


class PortableFunction(LinkedFunction):
    """A function that becomes part of a WebAssembly module."""

    compiler: type[PassesCompiler] = _PortableCompiler


class PortableKernel(PortableFunction):
    """A kernel of a WebAssembly module."""

    compiler = _PortableKernelCompiler


def _wrap(copy: FunctionType, original: Any) -> PortableFunction:
    options = {
        name: original.targetoptions[name] for name in _KEPT if name in original.targetoptions
    }
    kind = PortableFunction if isinstance(original, LinkedFunction) else PortableKernel
    return kind(copy, no_cfunc_wrapper=True, **options)


@lru_cache(maxsize=1)
def _translator() -> Translator:
    """Return the shared translator of all kernels."""
    return Translator(_wrap)


def compile_module(
    kernel: Any, arguments: tuple[Any, ...], file: Path | None = None, exports: tuple[str, ...] = ()
) -> Module:
    """Compile a kernel for the types of arguments; takes ten seconds to a minute.

    Args:
        kernel: a compiled function that Python can call. The function returns an integer, or None;
            for None, the module returns 0.
        arguments: arrays, numbers, and named tuples of arrays and numbers.
        file: the module's file. A file from the same source is read; any other file is replaced.
        exports: functions of `MATHEMATICS` that pages call.
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
    """Return the dependencies of a module besides its kernel."""
    files = (__file__, wasm_linker.__file__, lowering.__file__)
    sources = [Path(each).read_bytes() for each in files]
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
            parts += [_method(own, inner, count), method]  # calls are linked to later definitions
    modules = [llvm.parse_assembly(part) for part in parts]
    return link(_make_object(modules, name, exports), (*exports, "step"))


def _lower(function: Any, kinds: tuple[Any, ...]) -> tuple[str, str]:
    """Lower a function for types of arguments; return LLVM code and the function's name."""
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
    """Compile LLVM modules and an entry point to an object file. The first module is a kernel."""
    machine, module = _machine(), modules[0]
    kernel = module.get_function(name)
    kernel.add_function_attribute("alwaysinline")  # browsers limit the number of arguments
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
    """Write a C mathematics function that calls a lowered function of `count` numbers."""
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
    """Write the module's entry function, which reads the kernel's arguments by LLVM type."""
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
