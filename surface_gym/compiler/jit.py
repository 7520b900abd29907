"""Compiler options of the physics, and a cache that detects edits in any called function.

The digest of a function covers its code and the code of all functions it calls. `_Walk` finds them
as the compiler does: it follows names from a function to functions and constants, in any file. An
edit of one of them changes the digest. An edit of a docstring or of another function does not.
"""

import hashlib
import inspect
import platform
import sys
import time
import types
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numpy as np
from numba import typeof
from numba.core.caching import FunctionCache, IndexDataCacheFile, NullCache
from numba.core.dispatcher import Dispatcher
from numba.core.errors import NumbaError

from surface_gym.compiler import linking, lowering
from surface_gym.compiler.linking import (
    KernelFunction,
    LinkedCacheImpl,
    LinkedFunction,
    collecting_nothing,
)

if sys.platform != "win32":
    import fcntl

LENGTH = 16  # hexadecimal digits
CompilerError = NumbaError  # raised for a function that cannot be compiled


def is_compiled(value: Any) -> bool:
    """Return whether a value is a function made by the decorators below."""
    return isinstance(value, Dispatcher)


def compute_digest(function: Any, *others: Any) -> str:
    """Compute one digest of a function (compiled or plain) and of all values in `others`."""
    walk = _Walk()
    walk.take(function)
    for other in others:
        walk.take(other)
    return walk.hash.hexdigest()[:LENGTH]


class _Walk:
    """A hash of all values on which compiled functions depend; each function is added once."""

    def __init__(self) -> None:
        self.hash = hashlib.sha256()
        self._seen: set[int] = set()

    def take(self, value: Any) -> None:
        """Add a value to the hash. The value may have any type to which compiled code can refer."""
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
            names = getattr(value, "_fields", ())  # names of the values
            self._write(type(value).__qualname__, len(value), *names)
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
        self._take_code(function.__code__, function.__doc__)
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
        for module in modules:  # `module.name`: any name the function may refer to
            for name in sorted(referenced_names(function.__code__)):
                if hasattr(module, name) and not is_library(module):
                    self._write("of module", name)
                    self.take(getattr(module, name))

    def _take_code(self, code: types.CodeType, docstring: str | None = None) -> None:
        self._write(code.co_code, code.co_names, code.co_varnames, code.co_freevars)
        for constant in code.co_consts:
            if docstring is None or constant is not docstring:
                self.take(constant)

    def _write(self, *values: Any) -> None:
        self.hash.update(repr(values).encode())


def referenced_names(code: types.CodeType) -> set[str]:
    """Return the names in a function's bytecode `code` and in the function's inner functions."""
    inner = (each for each in code.co_consts if isinstance(each, types.CodeType))
    return set(code.co_names).union(*map(referenced_names, inner))


def is_library(module: types.ModuleType) -> bool:
    """Return whether `module` belongs to `math`, NumPy or Numba. Library code needs no digest."""
    return module.__name__.partition(".")[0] in ("math", "numba", "numpy")


KEPT = 16  # number of latest versions of a kernel in the cache
# The same of a linked function, which has a version for each constant index that it is called with.
KEPT_LINKED = 128
# Errors from reading a truncated file, or a file written before a class was moved.
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
    """Hold a lock file, so that only one process at a time continues."""
    try:
        file = path.open("w")
    except OSError:  # the folder is not writable, so nothing is shared
        yield
        return
    with file:
        if sys.platform != "win32":
            fcntl.flock(file, fcntl.LOCK_EX)
        yield
        path.unlink(missing_ok=True)


class Baseline(NamedTuple):
    """Processor instructions that precompiled kernels may use."""

    name: str  # of LLVM's processor
    features: tuple[str, ...]  # that LLVM must find on this machine


BASELINES = {
    "x86_64": Baseline("x86-64-v3", ("avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe")),
    "arm64": Baseline("generic", ("neon",)),
}
BASELINES |= {"AMD64": BASELINES["x86_64"], "aarch64": BASELINES["arm64"]}
LINKED = "linked-"  # begins the names of files without machine code
PRECOMPILED = Path(__file__).parent / "precompiled"  # machine code of a wheel, for the baseline


@lru_cache
def find_baseline() -> Baseline | None:
    """Return the processor instructions of precompiled code, or None if this machine lacks some."""
    baseline = BASELINES.get(platform.machine())
    features = llvm.get_host_cpu_features()
    return baseline if baseline and all(map(features.get, baseline.features)) else None


def _target(processor: str) -> str:
    """Join operating system, machine type and LLVM's `processor`, e.g. "linux x86_64 x86-64-v3"."""
    return f"{sys.platform} {platform.machine()} {processor}"


class _DigestCache(FunctionCache):
    """Numba's cache with files named by digest.

    Numba validates a cached function by its own source file only, and ignores callees in other
    files. A function has one version for each set of argument types. Numba names
    the versions' files by number, so concurrent processes may confuse two files. Here the name of a
    file has a digest of the code and of the argument types. A version that is not in the cache may
    be in the folder `PRECOMPILED`, compiled for an instruction set that most machines have.
    """

    _is_precompiled = True
    _kept = KEPT

    def __init__(self, dispatcher: Any, label: str) -> None:
        super().__init__(dispatcher.py_func)
        self._dispatcher = dispatcher
        self.label = label or f"{dispatcher.py_func.__module__}.{dispatcher.py_func.__name__}"
        self._files: dict[Any, IndexDataCacheFile] = {}

    def _index_key(self, sig: Any, codegen: Any) -> str:
        magic = codegen.magic_tuple()
        processor, baseline = magic[1], find_baseline()
        is_baseline = baseline is not None and processor == baseline.name
        return self._key(sig, _target(processor) if is_baseline else str(magic))

    def _key(self, sig: Any, target: str) -> str:
        # Include the fields of the arguments' types, which Numba ignores.
        kinds = [_fields(kind) for kind in sig]
        how = self._impl_class.__name__, _compiler()
        return compute_digest(self._dispatcher, str(sig), target, kinds, *how)

    def _open(self, sig: Any) -> None:
        """Open the cache file of the code that is compiled for arguments of the types `sig`."""
        if sig not in self._files:
            name = f"{self.label}-{self._index_key(sig, self._dispatcher.targetctx.codegen())}"
            self._files[sig] = IndexDataCacheFile(self._cache_path, name, source_stamp=None)
        self._cache_file = self._files[sig]

    def _load_overload(self, sig: Any, target_context: Any) -> Any:
        found = super()._load_overload(sig, target_context)
        if found is None:
            for key, file in self._find_precompiled(sig).items():
                return self._impl.rebuild(target_context, file.load(key))
        return found

    def _find_precompiled(self, sig: Any) -> dict[str, IndexDataCacheFile]:
        """Return {key: file} for argument types `sig` if a precompiled version exists, else {}."""
        baseline = find_baseline()
        if baseline is None or not self._is_precompiled:
            return {}
        key = self._key(sig, _target(baseline.name))
        file = IndexDataCacheFile(PRECOMPILED, f"{self.label}-{key}", source_stamp=None)
        return {key: file} if file._load_index().get(key) else {}

    @contextmanager
    def locked(self, sig: Any) -> Iterator[None]:
        """Let other processes wait while this process compiles the version for types `sig`."""
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

    def holds(self, sig: Any) -> bool:
        """Return whether the code for argument types `sig` is in the cache or precompiled."""
        self._open(sig)
        return Path(self._cache_file._index_path).exists() or self._find_precompiled(sig) != {}

    def save_overload(self, sig: Any, data: Any) -> None:
        self._open(sig)
        try:
            super().save_overload(sig, data)
            self._forget_old()
        except OSError as error:  # the disk is full, or the folder is read-only
            _warn(f"{self._cache_path} cannot be written ({error.strerror})")

    def _forget_old(self) -> None:
        """Keep the newest `_kept` versions in the cache, and remove all older versions."""
        folder = Path(self._cache_path)
        with self._guard_against_spurious_io_errors():
            found = list(folder.glob(f"{self.label}-*.nbi"))
            if len(found) <= self._kept:
                return
            found.sort(key=_find_time, reverse=True)
            for index in found[self._kept :]:
                for file in folder.glob(f"{index.stem}.*"):
                    file.unlink(missing_ok=True)


def _find_time(file: Path) -> float:
    """Return the time [s] of a file's last change, or 0 if the file was removed."""
    try:
        return file.stat().st_mtime
    except FileNotFoundError:
        return 0.0


class _LinkedCache(_DigestCache):
    """Cache of functions that only compiled code calls, stored as LLVM code for this processor."""

    _impl_class = LinkedCacheImpl
    _is_precompiled = False
    _kept = KEPT_LINKED

    def __init__(self, dispatcher: Any, label: str) -> None:
        super().__init__(dispatcher, label)
        self.label = LINKED + self.label

    def _load_overload(self, sig: Any, target_context: Any) -> Any:
        """Load the code for the argument types `sig`. The loaded code gets `sig` as its types.

        The types in the file may contain a class that another process made at run time, such as
        `Columns` of features.
        """
        found = super()._load_overload(sig, target_context)
        if found is None:
            return None
        found.fndesc.argtypes = sig
        return found._replace(signature=found.signature.replace(args=sig))


class _NoCache(NullCache):
    """Empty cache, used if no folder is writable."""

    @contextmanager
    def locked(self, _: Any) -> Iterator[None]:
        """Do not lock, since nothing is shared."""
        yield

    def holds(self, _: Any) -> bool:
        """Return False, since this cache is always empty."""
        return False

    def save_overload(self, *_: Any) -> None:
        _warn("no folder for it can be written")


@lru_cache  # once per process, although the compiler resets Python's list of shown warnings
def _warn(why: str) -> None:
    warnings.warn(
        f"compiled code is not kept: {why}; every process compiles its own. NUMBA_CACHE_DIR names "
        "a folder that can be written",
        RuntimeWarning,
        stacklevel=2,
    )


@lru_cache
def _compiler() -> str:
    """Return the source of the package's compiler, because cached code depends on the compiler."""
    return "".join(map(inspect.getsource, (linking, lowering)))


def _fields(kind: Any) -> Any:
    """Return the names of all fields in an argument's type, including nested types."""
    names = getattr(kind, "fields", ())
    return [names, [_fields(each) for each in getattr(kind, "types", ())]]


# No fast-math flag is set: with strict IEEE arithmetic, a result does not depend on the caller that
# a function is inlined into. This keeps `simulate`, the single and the vector env equal to the bit.
# Numba's reference counting (_nrt) is off, since nothing here allocates and it would cost more than
# the arithmetic.
_OPTIONS: Any = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": False}


def compiled(function: Callable[..., Any], label: str = "") -> Any:
    """Compile a function that Python calls; its machine code is cached.

    `label` is the name of the function's files in the cache. The default is the function's name.
    """
    return _cached(KernelFunction(function, **_OPTIONS), label)


def linked(function: Callable[..., Any]) -> Any:
    """Compile a function once for all of its compiled callers, and cache the compiled code."""
    # Numba gives an option that is not set the value that it has in the caller.
    return _cached(LinkedFunction(function, forceinline=False, **_OPTIONS), kind=_LinkedCache)


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function into each of its compiled callers, so that no call is needed.

    A call would have to pass tuples of arrays, which takes longer than most of these functions.
    Python calls the physics' inlined functions through `physics.references`.
    """
    return _inlined(function, forceinline=True)


def kernel_function(function: Callable[..., Any]) -> Any:
    """Compile a function of a task or sensor into the kernels that call the function.

    The function may use numbers, `math`, arrays in its arguments, constants, and other kernel
    functions. An index beyond the end of an array raises an IndexError.
    """
    return _inlined(function, forceinline=True, boundscheck=True)


def _inlined(function: Callable[..., Any], **options: bool) -> Any:
    dispatcher = LinkedFunction(function, **options, **_OPTIONS)
    # Numba numbers the functions that a process makes. Cached code of two processes may thus have
    # the same name, if functions are made by the same line.
    if "<locals>" not in function.__qualname__:
        with suppress(RuntimeError):  # the function is in no file
            dispatcher._cache = _LinkedCache(dispatcher, "")
    return dispatcher


def _cached(dispatcher: Any, label: str = "", kind: type[FunctionCache] = _DigestCache) -> Any:
    try:
        dispatcher._cache = kind(dispatcher, label)
    except RuntimeError:  # neither the package's folder nor the home folder is writable
        dispatcher._cache = _NoCache()
    return dispatcher


def compile_for(dispatcher: Any, *arguments: Any) -> Callable[..., Any]:
    """Compile a function for the types of the arguments, or load it from the cache.

    The returned function does not check the types of its arguments. Numba's own check of dozens of
    arrays takes longer than the simulation of a control period of one environment.
    """
    kinds = tuple(map(typeof, arguments))
    cache = dispatcher._cache
    with collecting_nothing(), cache.locked(kinds):
        if kinds in dispatcher.overloads or cache.holds(kinds):
            entry: Callable[..., Any] = dispatcher.compile_locked(kinds)
        else:
            name = getattr(cache, "label", "") or dispatcher.py_func.__name__
            with _announced(f"surface_gym: compiling {name}, once"):
                entry = dispatcher.compile_locked(kinds)
    return entry


@contextmanager
def _announced(what: str) -> Iterator[None]:
    """Print to stderr the text `what` before a long step, and the duration after the step."""
    began = time.perf_counter()
    print(what, end=" ... ", file=sys.stderr, flush=True)
    try:
        yield
    finally:
        print(f"{time.perf_counter() - began:.0f} s", file=sys.stderr, flush=True)
