"""Checks of arguments: each error names the argument, what came and what is allowed."""

import math
import re

import numpy as np
import pytest

from surface_gym import checks

NOT_A_NUMBER = [None, "a", "1.0", b"1", True, np.True_, 1j, [1.0], np.array([1.0]), 10**400]
NOT_FINITE = [math.nan, math.inf, -math.inf, np.float32("nan")]


@pytest.mark.parametrize("value", [*NOT_A_NUMBER, *NOT_FINITE], ids=lambda value: repr(value)[:20])
@pytest.mark.parametrize(
    "check", [checks.number, checks.positive, checks.not_negative], ids=lambda c: c.__name__
)
def test_what_is_no_finite_number_is_refused(check: object, value: object) -> None:
    with pytest.raises(ValueError, match=r"^mass must be a finite number, got "):
        check("mass", value)


@pytest.mark.parametrize("value", [2, 2.0, np.float32(2.0), np.int64(2), np.float64(2.0)])
def test_numbers_of_any_kind_become_floats(value: object) -> None:
    for check in (checks.number, checks.positive, checks.not_negative):
        assert check("mass", value) == 2.0
        assert type(check("mass", value)) is float


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: checks.positive("dt", 0.0), "dt must be greater than 0, got 0.0"),
        (lambda: checks.positive("dt", -1), "dt must be greater than 0, got -1"),
        (lambda: checks.not_negative("mu", -1e-9), "mu must be at least 0, got -1e-09"),
        (lambda: checks.positive("dt", 5, 1.0, 4.0), "dt must be between 1 and 4, got 5"),
        (lambda: checks.positive("dt", 0.5, 1.0, 4.0), "dt must be between 1 and 4, got 0.5"),
        (lambda: checks.positive("dt", -1, 1.0, 4.0), "dt must be greater than 0, got -1"),
        (lambda: checks.not_negative("mu", 5, 4.0), "mu must be between 0 and 4, got 5"),
        (lambda: checks.integer("n", 9, 1, 8), "n must be a whole number of at most 8, got 9"),
        (
            lambda: checks.limited("a", np.array([1.0, -3.0]), 2.0),
            "a must be between -2 and 2, got -3 in it",
        ),
        (
            lambda: checks.limited("a", np.array([[1.0, 1.0], [2.0, 3.5]]), (2.0, 3.0)),
            "a must be between -3 and 3, got 3.5 in it",
        ),
        (
            lambda: checks.pose("a", (1e5, 0.0, 0.0), (3,)),
            "a must be between -10000 and 10000, got 100000 in it",
        ),
        (
            lambda: checks.velocity("a", [(0.0, 0.0, -2e3)], (None, 3)),
            "a must be between -1000 and 1000, got -2000 in it",
        ),
        (
            lambda: checks.place("a", (0.0, -2e4)),
            "a must be between -10000 and 10000, got -20000 in it",
        ),
        (
            lambda: checks.friction("mu", [[1.0, 101.0]], (1, 2)),
            "mu must be at most 100, got 101.0",
        ),
        (
            lambda: checks.rolling(np.array([[0.5, 0.4]]), 0.45),
            "mu_min must be at most mu_max, got 0.45 and 0.4",
        ),
        (
            lambda: checks.orientations("axes", np.linspace(0.0, 1.0, 1001)),
            "axes must be at most 1000, got 1001",
        ),
        (
            lambda: checks.orientations("axes", (0.0, 1.0, 0.0)),
            "axes must differ from each other, got (0.0, 1.0, 0.0)",
        ),
        (
            lambda: checks.orientations("axes", (0.0, math.pi)),
            f"axes must hold two axes that differ, got {(0.0, math.pi)!r}",
        ),
        (lambda: checks.within("a", 2, 0, 1), "a must be between 0 and 1, got 2"),
        (lambda: checks.within("a", -0.1, 0, 1), "a must be between 0 and 1, got -0.1"),
        (lambda: checks.integer("n", 0, 1), "n must be a whole number of at least 1, got 0"),
        (lambda: checks.integer("n", 1.0, 1), "n must be a whole number of at least 1, got 1.0"),
        (lambda: checks.integer("n", True, 1), "n must be a whole number of at least 1, got True"),
        (lambda: checks.integer("n", None, 1), "n must be a whole number of at least 1, got None"),
        (lambda: checks.integer("n", "3", 1), "n must be a whole number of at least 1, got '3'"),
        (lambda: checks.one_of("size", "M", "SB"), "size must be one of 'S', 'B', got 'M'"),
        (lambda: checks.one_of("side", True, (1, -1)), "side must be one of 1, -1, got True"),
        (lambda: checks.one_of("side", [1], (1, -1)), "side must be one of 1, -1, got [1]"),
    ],
)
def test_messages(call: object, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(message)}$"):
        call()


def test_what_is_allowed_passes() -> None:
    assert checks.not_negative("mu", 0) == 0.0
    assert checks.within("a", 0, 0, 1) == 0.0
    assert checks.within("a", 1, 0, 1) == 1.0
    assert checks.integer("n", np.int32(4), 4) == 4
    assert checks.one_of("size", "S", ("S", "B")) == "S"
    assert checks.one_of("size", np.str_("S"), ("S", "B")) == "S"
    assert type(checks.one_of("side", np.int64(1), (1, -1))) is int


@pytest.mark.parametrize(
    "value",
    [
        ("1", "2", "3"),
        ("a", 2, 3),
        (True, False, True),
        np.array([1 + 1j, 2, 3]),
        np.array([1 + 0j, 2, 3]),
        [[1.0], [1.0, 2.0], 3.0],
        (None, 2, 3),
        (10**400, 2, 3),
        [object(), 2, 3],
        {1, 2, 3},
    ],
)
def test_what_is_no_array_of_numbers_is_refused(value: object) -> None:
    with pytest.raises(ValueError, match=r"^pose must "):
        checks.array("pose", value, (3,))


@pytest.mark.parametrize("value", [None, 1.0, (1.0, 2.0), np.zeros((3, 1)), "abc", np.zeros(0)])
def test_arrays_of_another_shape_are_refused(value: object) -> None:
    with pytest.raises(ValueError, match=r"^pose must (have the shape|be an array of numbers)"):
        checks.array("pose", value, (3,))


@pytest.mark.parametrize("value", NOT_FINITE)
def test_arrays_with_a_number_that_is_not_finite_are_refused(value: float) -> None:
    with pytest.raises(ValueError, match=r"^pose must be finite, got -?(nan|inf) in it$"):
        checks.array("pose", (0.0, value, 1.0), (3,))


def test_an_array_is_a_read_only_copy() -> None:
    mine = np.array([1.0, 2.0, 3.0])
    theirs = checks.array("pose", mine, (None,))
    mine[0] = 9.0
    assert theirs.tolist() == [1.0, 2.0, 3.0]
    assert theirs.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        theirs[0] = 9.0
    assert checks.array("pose", np.array([1, 2], dtype=np.int8), (2,)).tolist() == [1.0, 2.0]
