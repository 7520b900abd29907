"""Numba's compiler for functions that only compiled code calls.

Numba makes machine code of every function together with all that it calls, and again within each
of its callers; and it optimises all of that twice, since it looks for reference counts between the
two. Here a function is optimised once and stays LLVM's code, which its callers link. Machine code
is made of the kernel at the end of the chain alone. That takes two thirds of the time.

A function that is inlined is linked into its callers' code before that is optimised. One that is
not is optimised apart from those it calls, and linked with them into the kernel.
"""

from typing import Any

import llvmlite.binding as llvm
import numba._dynfunc as _dynfunc
from numba.core.caching import CompileResultCacheImpl
from numba.core.codegen import CPUCodeLibrary, JITCodeLibrary
from numba.core.compiler import Compiler, CompileResult
from numba.core.compiler_machinery import register_pass
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import NativeLowering


def _optimize(library: CPUCodeLibrary) -> None:
    passes, builder = library._codegen._module_pass_manager()
    passes.run(library._final_module, builder)


class _Kernel(JITCodeLibrary):
    """Machine code of a function that Python calls."""

    def _optimize_final_module(self) -> None:
        _optimize(self)


class LinkedCode(CPUCodeLibrary):
    """LLVM's code of a function that only compiled code calls.

    Args:
        codegen: Numba's code generator.
        name: of the function.
        inlined: whether its callers contain it. Otherwise they call it by its name.
    """

    def __init__(self, codegen: Any, name: str, inlined: bool) -> None:
        super().__init__(codegen, name)
        self._inlined = inlined
        # Functions called by their names, here or by what is called; each before its callers.
        self._called: dict[LinkedCode, None] = {}
        self._with_called: Any = None

    def finalize(self) -> None:
        """Link the code of inlined functions, note the others, and optimise."""
        for library in dict.fromkeys(self._linking_libraries):
            self._reload_init.update(library._reload_init)
            if isinstance(library, LinkedCode):
                self._called.update(library._called)
                if not library._inlined:
                    self._called[library] = None
                    continue
                self._final_module.link_in(library._own_module(), preserve=True)
            else:  # a function of Numba's own
                self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._optimize_final_module()
        self._finalize_final_module()

    def _optimize_final_module(self) -> None:
        _optimize(self)

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout
        passes, builder = self._codegen._function_pass_manager()
        for function in module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def _own_module(self) -> Any:
        return super()._get_module_for_linking()

    def _get_module_for_linking(self) -> Any:
        """Link the functions that are called by their names, which a kernel needs."""
        if self._with_called is None:
            self._with_called = self._own_module().clone()
            for library in reversed(self._called):  # LLVM drops what nothing has called so far
                self._with_called.link_in(library._own_module(), preserve=True)
        return self._with_called

    def serialize_using_object_code(self) -> tuple[str, bytes]:
        """Return the name and the code, which the cache keeps."""
        return self.name, self._get_module_for_linking().as_bitcode()

    @classmethod
    def load(cls, codegen: Any, name: str, bitcode: bytes) -> "LinkedCode":
        """Make the code of a function, with those that it calls by name, from the cache."""
        library = cls(codegen, name, inlined=False)
        library._final_module = llvm.parse_bitcode(bitcode)
        library._finalize_final_module()
        return library

    def make_entry(self, described: Any, environment: Any) -> Any:
        """Make what stands for the function in Numba's tables; it has no address."""
        module, name = described.lookup_module(), described.qualname
        return _dynfunc.make_function(module, name, "", 0, environment, (self,))


@register_pass(mutates_CFG=True, analysis_only=False)
class _LowerToKernel(NativeLowering):
    """Numba's lowering to machine code."""

    _name = "lower_to_kernel"

    def run_pass(self, state: Any) -> bool:
        state.library = _Kernel(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return bool(super().run_pass(state))


@register_pass(mutates_CFG=True, analysis_only=False)
class LowerToLinkedCode(NativeLowering):
    """Numba's lowering to LLVM's code."""

    _name = "lower_to_linked_code"
    code: type[LinkedCode] = LinkedCode

    def run_pass(self, state: Any) -> bool:
        name, inlined = state.func_id.func_qualname, bool(state.flags.forceinline)
        library = self.code(state.targetctx.codegen(), name, inlined)
        state.library = library
        state.flags.no_compile = True
        super().run_pass(state)
        library.finalize()
        lowered = state["cr"]
        entry = library.make_entry(lowered.fndesc, lowered.env)
        state.targetctx.insert_user_function(entry, lowered.fndesc, [library])
        state.reload_init.extend(library._reload_init)
        state["cr"] = lowered._replace(cfunc=entry)
        return True


class PassesCompiler(Compiler):
    """Numba's compiler with a lowering of ours."""

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


class KernelCompiler(PassesCompiler):
    """Compiler of functions that Python calls."""

    lowering = _LowerToKernel


class _LinkedCompiler(PassesCompiler):
    """Compiler of functions that only compiled code calls."""

    lowering = LowerToLinkedCode


class LinkedCacheImpl(CompileResultCacheImpl):
    """Form in which the cache keeps LLVM's code."""

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        """Make what the compiler returned from what `CompileResult._reduce` kept of it."""
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


class LinkedFunction(CPUDispatcher):
    """A function that compiled code calls. From Python it is called as the Python that it is."""

    compiler: type[PassesCompiler] = _LinkedCompiler

    def __init__(self, function: Any, **options: Any) -> None:
        options = {"nopython": True, "boundscheck": None, "no_cpython_wrapper": True, **options}
        super().__init__(function, targetoptions=options, pipeline_class=self.compiler)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        return self.py_func(*arguments, **named)
