"""Numba's compiler for functions called by compiled code only.

Numba generates machine code for every function with all its callees, and again within each caller.
It also optimises twice, with a pass for reference counts in between. Here a function is optimised
once and kept as LLVM code, which its callers link. Only the kernel at the end of the chain becomes
machine code. Compilation takes two thirds of the time.

An inlined function is linked into its callers' code before that code is optimised. Other functions
are optimised separately, and linked into the kernel together with their callees. Both kinds are
cached, so that a new process does not lower them again for another kernel.
"""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import llvmlite.binding as llvm
import numba._dynfunc as _dynfunc
from numba.core.caching import CompileResultCacheImpl, NullCache
from numba.core.codegen import CPUCodeLibrary, JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult
from numba.core.compiler_machinery import register_pass
from numba.core.registry import CPUDispatcher
from numba.core.sigutils import normalize_signature
from numba.core.typed_passes import NativeLowering

from surface_gym.compiler.lowering import FlatArguments, QuickFlags, ValueLower, WholeArguments


def _optimize(library: CPUCodeLibrary) -> None:
    passes, builder = library._codegen._module_pass_manager()
    passes.run(library._final_module, builder)


class _Kernel(JITCodeLibrary):
    """Machine code of a function called by Python."""

    convention = FlatArguments

    def _optimize_final_module(self) -> None:
        _optimize(self)


class LinkedCode(CPUCodeLibrary):
    """LLVM code of a function called by compiled code only.

    Args:
        codegen: Numba's code generator.
        name: name of the function.
        inlined: whether its callers contain its code. Otherwise they call it by name.
    """

    convention: type[FlatArguments] = WholeArguments

    def __init__(self, codegen: Any, name: str, inlined: bool) -> None:
        super().__init__(codegen, name)
        self.symbol = ""  # its name in LLVM code
        self._inlined = inlined
        # Functions called by name, directly or by callees; each stands before its callers.
        self._called: dict[str, LinkedCode] = {}
        self._with_called: Any = None

    def finalize(self) -> None:
        """Link the code of inlined functions, note the other called functions, and optimise."""
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            if isinstance(library, LinkedCode):
                self._called.update(library._called)
                if not library._inlined:
                    self._called[library.symbol] = library
                    continue
                self._final_module.link_in(library._own_module(), preserve=True)
            else:  # a function of Numba itself
                self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._optimize_final_module()
        self._finalize_final_module()

    def _optimize_final_module(self) -> None:
        if not self._inlined:  # else its callers optimise it
            _optimize(self)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout
        # Few passes, which keep inlined code small: all others follow in its callers.
        few = {"opt": 1, "loop_vectorize": False, "slp_vectorize": False}
        passes, builder = self._codegen._function_pass_manager(**few)
        for function in module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def _own_module(self) -> Any:
        return super()._get_module_for_linking()

    def _get_module_for_linking(self) -> Any:
        """Link the functions called by name, for a kernel."""
        if self._with_called is None:
            self._with_called = self._own_module().clone()
            # In this order, since LLVM drops functions without callers so far.
            for library in reversed(self._called.values()):
                self._with_called.link_in(library._own_module(), preserve=True)
        return self._with_called

    def serialize_using_object_code(self) -> tuple[Any, ...]:
        """Return the arguments of `load`, for the cache."""
        called = [(each.symbol, each._own_module().as_bitcode()) for each in self._called.values()]
        return self.name, self.symbol, self._inlined, self._own_module().as_bitcode(), called

    @classmethod
    def load(
        cls,
        codegen: Any,
        name: str,
        symbol: str,
        inlined: bool,
        bitcode: bytes,
        called: list[tuple[str, bytes]],
    ) -> "LinkedCode":
        """Load the code of a function, and of functions it calls by name, from the cache."""
        library = cls(codegen, name, inlined)
        library.symbol = symbol
        library._final_module = llvm.parse_bitcode(bitcode)
        library._finalize_final_module()
        for each, code in called:
            library._called[each] = cls.load(codegen, each, each, False, code, [])
        return library

    def make_entry(self, described: Any, environment: Any) -> Any:
        """Make the function's entry in Numba's tables; it has no address."""
        module, name = described.lookup_module(), described.qualname
        return _dynfunc.make_function(module, name, "", 0, environment, (self,))


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerToKernel(NativeLowering):
    """Numba's lowering of a function to machine code."""

    _name = "lower_to_kernel"
    lowering_class = ValueLower

    def run_pass(self, state: Any) -> bool:
        state.library = _Kernel(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return bool(super().run_pass(state))


@register_pass(mutates_CFG=True, analysis_only=False)
class LowerToLinkedCode(NativeLowering):
    """Numba's lowering of a function to LLVM code, which is linked into its callers' code later."""

    _name = "lower_to_linked_code"
    lowering_class = ValueLower
    code: type[LinkedCode] = LinkedCode

    def run_pass(self, state: Any) -> bool:
        name, inlined = state.func_id.func_qualname, bool(state.flags.forceinline)
        library = self.code(state.targetctx.codegen(), name, inlined)
        state.library = library
        state.flags.no_compile = True
        super().run_pass(state)
        lowered = state["cr"]
        library.symbol = lowered.fndesc.llvm_func_name
        library.finalize()
        entry = library.make_entry(lowered.fndesc, lowered.env)
        state.reload_init.extend(library._reload_init)
        state["cr"] = lowered._replace(cfunc=entry)
        return True


class PassesCompiler(Compiler):
    """Numba's compiler with a custom lowering."""

    lowering: type[NativeLowering]

    def define_pipelines(self) -> list[Any]:
        managers = super().define_pipelines()
        for manager in managers:
            manager.passes = [
                (self.lowering if each is NativeLowering else each, text)
                for each, text in manager.passes
            ]
            manager.finalize()
        return list(managers)


class _KernelCompiler(PassesCompiler):
    """Compiler of functions called by Python."""

    lowering = _LowerToKernel


class _LinkedCompiler(PassesCompiler):
    """Compiler of functions called by compiled code only."""

    lowering = LowerToLinkedCode


class LinkedCacheImpl(CompileResultCacheImpl):
    """Format of LLVM code in the cache."""

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        """Rebuild the compiler's result from the data of `CompileResult._reduce`."""
        code, described, environment, signature, *_, init, environments = payload
        for function in init:
            function()
        library = LinkedCode.load(target_context.codegen(), *code)
        return CompileResult(
            target_context=target_context,
            typing_context=target_context.typing_context,
            library=library,
            environment=environment,
            entry_point=library.make_entry(described, environment),
            fndesc=described,
            type_annotation="",
            signature=signature,
            objectmode=False,
            lifted=(),
            typing_error=None,
            call_helper=None,
            metadata=None,
            reload_init=init,
            referenced_envs=environments,
        )


@contextmanager
def collecting_nothing() -> Iterator[None]:
    """Pause the garbage collector: the compiler makes millions of short-lived objects."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()


class KernelFunction(CPUDispatcher):
    """A function called by Python. One process compiles it, others load its code from the cache."""

    compiler: type[PassesCompiler] = _KernelCompiler

    def __init__(self, function: Any, **options: Any) -> None:
        options = {"nopython": True, "boundscheck": None, **options}
        super().__init__(function, targetoptions=options, pipeline_class=self.compiler)
        self._compiler._customize_flags = QuickFlags

    def compile(self, sig: Any) -> Any:
        """Compile the version for argument types `sig`, or wait for the process that does so."""
        cache = self._cache
        if sig in self.overloads or isinstance(cache, NullCache) or cache.holds(sig):
            return super().compile(sig)
        with collecting_nothing(), cache.locked(sig):
            return self.compile_locked(sig)

    def compile_locked(self, sig: Any) -> Any:
        """Compile the version for argument types `sig`. The caller holds the cache's lock."""
        return super().compile(sig)


class LinkedFunction(KernelFunction):
    """A function called by compiled code. Called from Python, it runs uncompiled."""

    compiler = _LinkedCompiler

    def __init__(self, function: Any, **options: Any) -> None:
        super().__init__(function, **{"no_cpython_wrapper": True, **options})

    def add_overload(self, result: CompileResult) -> None:
        """Add a version for types of arguments, and register how compiled code calls it."""
        super().add_overload(result)
        library, described = result.library, result.fndesc

        def call(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            return library.convention(context).call(builder, described, signature, values)

        call.libs = (library,)  # type: ignore[attr-defined]
        self.targetctx.insert_func_defn([(call, library, result.signature.args)])

    def get_overload(self, signature: Any) -> Any:
        """Return the key under which `add_overload` registered a version."""
        return self.overloads[tuple(normalize_signature(signature)[0])].library

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return self.py_func(*arguments, **named)
