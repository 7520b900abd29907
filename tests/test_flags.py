"""Flags of the compiler are equal where Numba's own comparison says so."""

import itertools

from numba.core.compiler import DEFAULT_FLAGS, Flags

from tests import flags


def test_they_are_equal_and_hashed_as_numba_does() -> None:
    default, bounds, set_to_default = Flags(), Flags(), Flags()
    bounds.boundscheck = True
    set_to_default.boundscheck = Flags.options["boundscheck"].default
    some = [default, bounds, set_to_default, bounds.copy(), DEFAULT_FLAGS]
    for one, other in itertools.product(some, repeat=2):
        assert (one == other) == flags.compared(one, other)
        assert hash(one) == flags.hashed(one)
    assert default == set_to_default != bounds == some[3]
    assert default.__eq__(3) is NotImplemented
