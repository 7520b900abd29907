"""The one compiler setting of the physics, and a cache that notices edits in any of its files."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit
from numba.core.caching import FunctionCache

_PACKAGE = Path(__file__).resolve().parent.parent


def _source_digest() -> str:
    """Digest of every source file whose functions may be inlined into another's machine code."""
    digest = hashlib.sha256()
    for folder in ("dynamics", "lanes", "sensors", "tasks", "batch"):
        for path in sorted((_PACKAGE / folder).glob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


_SOURCE_DIGEST = _source_digest()


class _WholePackageCache(FunctionCache):
    """Numba's cache, with what it leaves out.

    It stamps a function with its own file only, where callees in other files count too; and it
    stumbles over a cache from before a class was moved, which holds nothing of use.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            return super().load_overload(sig, target_context)
        except (ImportError, AttributeError):
            self.flush()
            return None

    def _index_key(self, sig: Any, codegen: Any) -> tuple[Any, ...]:
        return (*super()._index_key(sig, codegen), _SOURCE_DIGEST)


# No fast-math flag is set: strict IEEE arithmetic makes a result independent of the caller a
# function is inlined into, which is what keeps `simulate`, the single and the vector env equal
# to the bit. Nothing here allocates, so Numba's reference counts (_nrt) are left out as well:
# they would cost more than the arithmetic.
_OPTIONS: Any = {"nogil": True, "error_model": "numpy", "_nrt": False}


def compiled(function: Callable[..., Any]) -> Any:
    """Compile a function that callers outside the physics enter; its machine code is cached."""
    dispatcher = njit(cache=True, **_OPTIONS)(function)
    dispatcher._cache = _WholePackageCache(function)
    return dispatcher


def compiled_for_threads(function: Callable[..., Any]) -> Any:
    """Compile a function whose `prange` loop runs on Numba's threads; cached like `compiled`."""
    dispatcher = njit(cache=True, parallel=True, **_OPTIONS)(function)
    dispatcher._cache = _WholePackageCache(function)
    return dispatcher


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a function into each of its compiled callers, arrays and all kept in registers.

    It needs no cache of its own, since its machine code is part of theirs. Called instead, it would
    cost more to hand its tuples of arrays over than most such functions take. Python enters them by
    `dynamics.entries`.
    """
    return njit(forceinline=True, **_OPTIONS)(function)
