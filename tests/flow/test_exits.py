"""Exits: their order, where each takes parcels, and what is refused."""

import math
from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest

from surface_gym.flow.exits import EXITS, Exit, Exits, chutes, exits_option, sides

LEFT = Exit("left", 1, 0.5, 2.0)
STRAIGHT = Exit("straight", 0)


def test_chutes_are_two_to_either_side_and_sides_as_long_as_the_line() -> None:
    exits = chutes()
    assert exits.names == ("left 1", "left 2", "right 1", "right 2", "straight")
    spans = [[1, 0.6, 2.8], [1, 3.2, 5.8], [-1, 0.6, 2.8], [-1, 3.2, 5.8]]
    np.testing.assert_allclose(exits.table, [*spans, [0, -math.inf, math.inf]])
    exits = sides(4.5)
    assert exits.names == ("left", "right", "straight")
    np.testing.assert_array_equal(exits.table[:2], [[1, 0.0, 4.5], [-1, 0.0, 4.5]])


@pytest.mark.parametrize("name", EXITS)
def test_presets_scale_with_the_line_which_must_be_long(name: str) -> None:
    short, long = EXITS[name](3.0), EXITS[name](6.0)
    assert short.names == long.names
    aside = long.table[:, 0] != 0.0
    np.testing.assert_allclose(2.0 * short.table[aside, 1:], long.table[aside, 1:])
    np.testing.assert_array_equal(short.table[~aside], long.table[~aside])  # of y
    for length in (0.0, -1.0, math.nan, None):
        with pytest.raises(ValueError, match="length must be"):
            EXITS[name](length)


def test_exits_are_counted_gone_through_hashed_and_found_by_name() -> None:
    exits = Exits([LEFT, STRAIGHT])
    assert (len(exits), list(exits)) == (2, [LEFT, STRAIGHT])
    assert exits == Exits((LEFT, STRAIGHT))
    assert len({exits, Exits((LEFT, STRAIGHT)), sides()}) == 2
    assert [chutes().place(name) for name in chutes().names] == [0, 1, 2, 3, 4]
    with pytest.raises(ValueError, match=r"exit must be one of 'left 1', .*, got 'left'"):
        chutes().place("left")
    with pytest.raises(FrozenInstanceError):
        exits.exits = ()
    with pytest.raises(ValueError, match="read-only"):
        exits.table[0, 0] = 0.0


def test_the_option_is_a_preset_or_exits_of_ones_own() -> None:
    assert exits_option("chutes", 3.0) == chutes(3.0)
    assert exits_option([LEFT], 3.0) == Exits((LEFT,))
    assert exits_option(sides(), 3.0) == sides()
    for value in ("doors", None, 3):
        with pytest.raises(
            ValueError, match="exits must be one of 'chutes', 'sides', 'end', 'mouth', 'mouths'"
        ):
            exits_option(value, 3.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": ""}, "name must be text without spaces at its ends, got ''"),
        ({"name": "le\0ft"}, "name must hold neither NUL nor half a letter"),
        ({"side": 2}, "side must be one of -1, 0, 1, got 2"),
        ({"last": math.nan}, "last must be a finite number, got nan"),
        ({"last": 0.5}, "last must be greater than first, 0.5, got 0.5 for 'left'"),
        ((), r"exits must be at least one Exit in a tuple, got \(\)"),
        ((LEFT, "straight"), "exits must be Exit objects, got 'straight'"),
        ((LEFT, Exit("left", 0)), "exits must have names of their own, got 'left' twice"),
        (
            (LEFT, STRAIGHT, Exit("wide", 1, 1.9)),
            "exits must not overlap on one side, got 'left' from 0.5 to 2 m and 'wide' "
            "from 1.9 to inf m",
        ),
    ],
)
def test_exits_that_are_bad_or_do_not_go_together_are_refused(changes: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        _ = replace(LEFT, **changes) if isinstance(changes, dict) else Exits(changes)
