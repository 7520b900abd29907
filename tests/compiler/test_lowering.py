"""Compiled functions pass tuples and keep variables as Python does, by less code than Numba's."""

import re
from typing import Any, NamedTuple

import numpy as np
import pytest
from numba import typeof

from surface_gym.compiler.jit import compile_for, compiled, inlined, kernel_function, linked


class Table(NamedTuple):
    """Two arrays and a pair of numbers."""

    heights: np.ndarray
    counts: np.ndarray
    limits: tuple[float, float]


class Room(NamedTuple):
    """A tuple within a tuple, beside a number."""

    table: Table
    scale: float


def make_room() -> Room:
    heights = np.arange(6.0).reshape(2, 3)
    return Room(Table(heights, np.array([4, 5], dtype=np.int64), (1.0, 7.0)), 3.0)


@pytest.mark.parametrize("decorate", [inlined, linked, kernel_function])
def test_tuples_go_in_and_come_back(decorate: Any) -> None:
    @decorate
    def raise_table(room, row):
        table = room.table
        for k in range(table.heights.shape[1]):
            table.heights[row, k] += room.scale
        return Room(Table(table.heights[row:], table.counts, (table.limits[1], 0.5)), 2.0), row + 1

    def kernel(room):
        raised, following = raise_table(room, 1)
        limits = raised.table.limits
        return raised.table.heights[0, 2] * raised.scale + limits[0] + limits[1] + following

    room = make_room()
    assert compile_for(compiled(kernel), room)(room) == 2.0 * (5.0 + 3.0) + 7.0 + 0.5 + 2.0
    assert room.table.heights.tolist() == [[0.0, 1.0, 2.0], [6.0, 7.0, 8.0]]


@pytest.mark.parametrize("decorate", [inlined, linked])
def test_a_pair_of_equal_and_one_of_different_kinds_are_both_taken(decorate: Any) -> None:
    @decorate
    def add(pair):
        return pair[0] + 10.0 * pair[1]

    def kernel(x, n):
        return add((x, x)) + add((x, n)) + add((n, x))

    assert compile_for(compiled(kernel), 0.5, 3)(0.5, 3) == 5.5 + 30.5 + 8.0


def test_variables_of_branches_and_loops_hold_their_last_value() -> None:
    def walk(values, first):
        last = first  # before the loop, and in it
        seen = 0
        for value in values:
            if value < 0.0:
                change = -value
                seen += 1
            else:
                change = 2.0 * value
            before = last
            last = before + change
            if last > 100.0:
                break
        else:
            last += 0.25
        while seen > 2:
            last, seen = last * 0.5, seen - 1
        return last, seen, first

    kernel = compiled(walk)
    for values in ([], [1.0, -2.0], [-1.0, -1.0, -1.0, -1.0, 3.0], [60.0, 1.0]):
        given = np.array(values), 1.5
        assert compile_for(kernel, *given)(*given) == walk(*given)


@pytest.mark.parametrize("decorate", [inlined, linked])
def test_an_error_passes_through_callers_of_tuples(decorate: Any) -> None:
    @kernel_function
    def read(room, k):
        return room.table.counts[k]

    @decorate
    def read_next(room, k):
        return Room(room.table, read(room, k + 1))

    def kernel(room, k):
        return read_next(room, k).scale

    room = make_room()
    entry = compile_for(compiled(kernel), room, 0)
    assert entry(room, 0) == 5.0
    with pytest.raises(IndexError):
        entry(room, 1)


def test_a_tuple_is_one_argument_and_a_used_field_one_instruction() -> None:
    def scale_of(room):
        room.table.counts[0] += 1
        if room.scale > 1.0:
            return room.scale
        return room.table.limits[0]

    room = make_room()
    ours = linked(scale_of)
    assert ours.compile((typeof(room),))
    code = str(next(iter(ours.overloads.values())).library._own_module())
    [head] = re.findall(r"define .*scale_of.*", code)
    assert head.count("%arg.") == 1  # Numba passes 19
    assert "insertvalue" not in code
