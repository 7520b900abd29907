"""Compiler options of the physics, and a cache that notices edits in any function used.

The digest of a function covers its code and that of all it calls. The walk follows names as the
compiler does: from a function to the functions and constants it refers to, whichever files they
stand in. An edit anywhere among them, and nowhere else, changes the digest.
"""

import gc
import hashlib
import sys
import types
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from pickle import UnpicklingError
from typing import Any

import numpy as np
from numba import njit, typeof
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError

from surface_gym.compiler.linking import KernelCompiler, LinkedCacheImpl, LinkedFunction

if sys.platform != "win32":
    import fcntl

LENGTH = 16  # hexadecimal digits
CompilerError = NumbaError  # a function that cannot be compiled


def is_compiled(value: Any) -> bool:
    """Return whether a value is a function that the decorators below have made."""
    return isinstance(value, Dispatcher)


def compute_digest(function: Any, *others: Any) -> str:
    """Compute the digest of a function, compiled or plain, and of other values that count."""
    walk = _Walk()
    walk.take(function)
    for other in others:
        walk.take(other)
    return walk.hash.hexdigest()[:LENGTH]


class _Walk:
    """A walk over all values that a compiled function depends on, each function once."""

    def __init__(self) -> None:
        self.hash = hashlib.sha256()
        self._seen: set[int] = set()

    def take(self, value: Any) -> None:
        """Take in any value that compiled code may refer to."""
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
        for name in sorted(referenced_names(function.__code__)):
            if name in function.__globals__:
                value = function.__globals__[name]
                self._write("global", name)
                self.take(value)
                if isinstance(value, types.ModuleType):
                    modules.append(value)
        for module in modules:  # `module.name`: whatever of its names the function may mean
            for name in sorted(referenced_names(function.__code__)):
                if hasattr(module, name) and not is_library(module):
                    self._write("of module", name)
                    self.take(getattr(module, name))

    def _take_code(self, code: types.CodeType) -> None:
        self._write(code.co_code, code.co_names, code.co_varnames, code.co_freevars)
        for constant in code.co_consts:
            self.take(constant)

    def _write(self, *values: Any) -> None:
        self.hash.update(repr(values).encode())


def referenced_names(code: types.CodeType) -> set[str]:
    """Return the names that a function refers to, those of its inner functions included."""
    inner = (each for each in code.co_consts if isinstance(each, types.CodeType))
    return set(code.co_names).union(*map(referenced_names, inner))


def is_library(module: types.ModuleType) -> bool:
    """Return whether a module's names mean the same as long as Numba's version stays."""
    return module.__name__.partition(".")[0] in ("math", "numba", "numpy")


KEPT = 16  # versions of a function in the cache: the latest
# What reading a file can raise that was cut short, or written before a class was moved.
STALE = (
    AttributeError,
    EOFError,
    ImportError,
    IndexError,
    KeyError,
    OSError,
    UnpicklingError,
    ValueError,
)


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Let one process at a time go on, by a file, which is there until then."""
    try:
        file = path.open("w")
    except OSError:  # nothing can be written, and nothing is shared
        yield
        return
    with file:
        if sys.platform != "win32":
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
        path.unlink(missing_ok=True)


class _DigestCache(FunctionCache):
    """Numba's cache with files named by digest.

    Numba stamps a function with its own file only, where callees in other files count too, and
    numbers the files of a function's versions, which processes that begin at once may mix up. Here
    a file's name says what is in it.
    """

    def __init__(self, dispatcher: Any, label: str) -> None:
        super().__init__(dispatcher.py_func)
        self._dispatcher = dispatcher
        self._label = label or f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__name__}"
        self._files: dict[Any, IndexDataCacheFile] = {}

    def _index_key(self, sig: Any, codegen: Any) -> str:
        # The types of the arguments count by their fields, which Numba leaves out.
        kinds = [_fields(kind) for kind in sig]
        form = self._impl_class.__qualname__
        return compute_digest(self._dispatcher, str(sig), str(codegen.magic_tuple()), kinds, form)

    def _open(self, sig: Any) -> None:
        """Open the cache file of a version."""
        if sig not in self._files:
            name = f"{self._label}-{self._index_key(sig, self._dispatcher.targetctx.codegen())}"
            self._files[sig] = IndexDataCacheFile(self._cache_path, name, source_stamp=None)
        self._cache_file = self._files[sig]

    @contextmanager
    def locked(self, sig: Any) -> Iterator[None]:
        """Let one process at a time compile a version; those that wait find it in the cache."""
        self._open(sig)
        with locked(Path(self._cache_file._index_path).with_suffix(".lock")):
            yield

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        self._open(sig)
        try:
            return super().load_overload(sig, target_context)
        except STALE:
            with suppress(OSError):
                Path(self._cache_file._index_path).unlink(missing_ok=True)
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        self._open(sig)
        try:
            super().save_overload(sig, data)
            self._forget_old()
        except OSError as error:  # the disk is full, or the folder was made read-only
            _warn(f"{self._cache_path} cannot be written ({error.strerror})")

    def _forget_old(self) -> None:
        """Remove versions that edits have left behind."""
        folder = Path(self._cache_path)
        with self._guard_against_spurious_io_errors():
            found = list(folder.glob(f"{self._label}-*.nbi"))
            found.sort(key=lambda index: index.stat().st_mtime, reverse=True)
            for index in found[KEPT:]:
                for file in folder.glob(f"{index.stem}.*"):
                    file.unlink(missing_ok=True)


class _LinkedCache(_DigestCache):
    """Cache of functions that only compiled code calls."""

    _impl_class = LinkedCacheImpl


class _NoCache(NullCache):
    """Cache for where no folder can be written: it keeps nothing."""

    @contextmanager
    def locked(self, _: Any) -> Iterator[None]:
        """Lock nothing, as nothing is shared."""
        yield

    def save_overload(self, *_: Any) -> None:
        _warn("no folder for it can be written")


@lru_cache  # once a process, though the compiler resets what Python remembers of warnings
def _warn(why: str) -> None:
    warnings.warn(
        f"compiled code is not kept: {why}; every process compiles its own. NUMBA_CACHE_DIR names "
        "a folder that can be written",
        RuntimeWarning,
        stacklevel=2,
    )


def _fields(kind: Any) -> Any:
    """Return the names of all fields in an argument's type, nested ones too."""
    names = getattr(kind, "fields", ())
    return [names, [_fields(each) for each in getattr(kind, "types", ())]]


# No fast-math flag is set: strict IEEE arithmetic makes a result independent of the caller a
# function is inlined into, which is what keeps `simulate`, the single and the vector env equal
# to the bit. Nothing here allocates, so Numba's reference counts (_nrt) are left out as well:
# they would cost more than the arithmetic.
_OPTIONS: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": False}


def compiled(function: Callable[..., Any], label: str = "") -> Any:
    """Compile a function that callers outside the physics enter; its machine code is cached.

    Args:
        function: to compile.
        label: of its files in the cache; by default its name.
    """
    return _cached(njit(pipeline_class=KernelCompiler, **_OPTIONS)(function), label)


def linked(function: Callable[..., Any]) -> Any:
    """Compile a function once for all of its compiled callers; its code is cached."""
    return _cached(LinkedFunction(function, **_OPTIONS), kind=_LinkedCache)


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function into each of its compiled callers, arrays and all kept in registers.

    It needs no cache of its own, since its code is part of theirs. Called instead, it would cost
    more to pass its tuples of arrays than most such functions take. Python calls its compiled code
    through `physics.references`.
    """
    return LinkedFunction(function, forceinline=True, **_OPTIONS)


def kernel_function(function: Callable[..., Any]) -> Any:
    """Compile a function of a task or a sensor into the kernel that uses it.

    What such a function may use are numbers, `math`, the arrays of its arguments, constants, and
    other functions compiled so. Reading or writing beyond the end of an array is an IndexError.
    """
    return LinkedFunction(function, forceinline=True, boundscheck=True, **_OPTIONS)


def _cached(dispatcher: Any, label: str = "", kind: type[FunctionCache] = _DigestCache) -> Any:
    try:
        dispatcher._cache = kind(dispatcher, label)
    except RuntimeError:  # neither beside the package nor in the home folder
        dispatcher._cache = _NoCache()
    return dispatcher


def compile_for(dispatcher: Any, *arguments: Any) -> Callable[..., Any]:
    """Compile a function for arguments of these types, or load it from the cache.

    Called so it takes the arguments as they are: finding out what kinds dozens of arrays are, as
    the dispatcher does, takes longer than a control period of one environment.
    """
    kinds = tuple(map(typeof, arguments))
    with collecting_nothing(), dispatcher._cache.locked(kinds):
        entry: Callable[..., Any] = dispatcher.compile(kinds)
    return entry


@contextmanager
def collecting_nothing() -> Iterator[None]:
    """Stop the garbage collector: the compiler makes millions of objects, and leaves none."""
    collects = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collects:
            gc.enable()
