"""Numba's flags of the compiler, compared faster: an eighth of the time of compiling a stream.

Numba finds what it has compiled by its flags, and compares all of them one by one, tens of
thousands of times for a kernel. Code is the same.
"""

from functools import cache
from typing import Any

from numba.core.targetconfig import TargetConfig

compared, hashed = TargetConfig.__eq__, TargetConfig.__hash__


@cache
def hash_of(kind: type[TargetConfig]) -> int:
    """Hash the names of all flags, which is all that Numba hashes."""
    return hashed(kind())


def are_equal(one: TargetConfig, other: Any) -> bool:
    """Compare the flags that are set; where these differ, all of them."""
    if type(one) is type(other) and one._values == other._values:
        return True
    return compared(one, other)


def compare_faster() -> None:
    """Let Numba compare flags so."""
    TargetConfig.__eq__ = are_equal
    TargetConfig.__hash__ = lambda flags: hash_of(type(flags))
