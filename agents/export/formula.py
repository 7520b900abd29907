"""Formulas that are written once, then reckoned with NumPy, laid into a graph and told in C.

A formula reckons in double precision with the numbers of an observation. One that has a constant
of each module in it has a value for each module; any other has one for all.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Union

import numpy as np
from numpy.typing import NDArray

Numbers = NDArray[np.float64]
Operand = Union["Formula", float]

ARC_TANGENT = "arc tangent"
# What an operation is: a function of NumPy, an ONNX operator, and C.
OPERATIONS: dict[str, tuple[Any, str, str]] = {
    "add": (np.add, "Add", "{} + {}"),
    "subtract": (np.subtract, "Sub", "{} - {}"),
    "multiply": (np.multiply, "Mul", "{} * {}"),
    "divide": (np.divide, "Div", "{} / {}"),
    "maximum": (np.maximum, "Max", "fmax({}, {})"),
    "minimum": (np.minimum, "Min", "fmin({}, {})"),
    "absolute": (np.abs, "Abs", "fabs({})"),
    "round": (np.round, "Round", "nearbyint({})"),
    "floor": (np.floor, "Floor", "floor({})"),
    "root": (np.sqrt, "Sqrt", "sqrt({})"),
    "sine": (np.sin, "Sin", "sin({})"),
    ARC_TANGENT: (np.arctan, "Atan", "atan({})"),
    "cosine": (np.cos, "Cos", "cos({})"),
    "at most": (np.less_equal, "LessOrEqual", "{} <= {}"),
    "below": (np.less, "Less", "{} < {}"),
    "both": (np.logical_and, "And", "{} && {}"),
    "either": (np.logical_or, "Or", "{} || {}"),
    "choose": (np.where, "Where", "{} ? {} : {}"),
}
COMPARISONS = ("at most", "below")
TRUTHS = (*COMPARISONS, "both", "either")  # operations that give true or false
STEPS = {"floor": 0.0, "round": 0.5}  # operations that jump: where, past each whole number
EDGE = 1e-9  # doubles of moderate size that differ by less are the same but for round-off
FEATURE, CONSTANT, OF_MODULE = "feature", "constant", "of module"


@dataclass(frozen=True, eq=False)
class Formula:
    """A number, a feature, a constant of each module, or an operation on formulas."""

    kind: str  # FEATURE, CONSTANT, OF_MODULE or one of OPERATIONS
    operands: tuple["Formula", ...] = ()
    value: float = 0.0  # of a constant; a feature's place
    values: tuple[float, ...] = field(default=(), repr=False)  # (modules,) of each module
    is_of_module: bool = False  # whether it has a value for each module
    name: str = ""  # for those who read what is made of it

    def __add__(self, other: Operand) -> "Formula":
        return operation("add", self, other)

    def __radd__(self, other: float) -> "Formula":
        return operation("add", other, self)

    def __sub__(self, other: Operand) -> "Formula":
        return operation("subtract", self, other)

    def __mul__(self, other: Operand) -> "Formula":
        return operation("multiply", self, other)

    def __rmul__(self, other: float) -> "Formula":
        return operation("multiply", other, self)

    def __truediv__(self, other: Operand) -> "Formula":
        return operation("divide", self, other)

    def named(self, name: str) -> "Formula":
        """The same, with a name."""
        return replace(self, name=name)

    @property
    def is_truth(self) -> bool:
        """Whether it is true or false, and no number."""
        return self.kind in TRUTHS


def operation(kind: str, *operands: Operand) -> Formula:
    """One of OPERATIONS on formulas or numbers."""
    made = tuple(each if isinstance(each, Formula) else constant(each) for each in operands)
    return Formula(kind, made, is_of_module=any(each.is_of_module for each in made))


def constant(value: float) -> Formula:
    """A number."""
    return Formula(CONSTANT, value=float(value))


def feature(place: int) -> Formula:
    """The number of an observation at a place."""
    return Formula(FEATURE, value=float(place))


def of_module(name: str, values: Numbers) -> Formula:
    """A constant of each module; values (modules,)."""
    return Formula(OF_MODULE, values=tuple(values.tolist()), is_of_module=True, name=name)


def in_order(formulas: Sequence[Formula]) -> Iterator[Formula]:
    """Every formula that some are made of, and they, each once and after its operands."""
    seen: set[int] = set()

    def follow(each: Formula) -> Iterator[Formula]:
        if id(each) not in seen:
            seen.add(id(each))
            for operand in each.operands:
                yield from follow(operand)
            yield each

    for formula in formulas:
        yield from follow(formula)


def reckon(
    formulas: Sequence[Formula], observations: NDArray[np.float32]
) -> tuple[list[NDArray[Any]], NDArray[np.bool_]]:
    """Values of formulas for observations (lanes, features), and where round-off may change them.

    Returns:
        Values (lanes, modules), or (lanes, 1), of each formula.
        (lanes, modules), or (lanes, 1): whether numbers on the way are compared, or rounded, that
        are no farther than EDGE from where the outcome changes.
    """
    values: dict[int, NDArray[Any]] = {}
    doubt = np.zeros((len(observations), 1), dtype=np.bool_)
    with np.errstate(divide="ignore", invalid="ignore"):  # of what is not chosen
        for each in in_order(formulas):
            operands = [values[id(part)] for part in each.operands]
            if each.kind == FEATURE:
                place = int(each.value)
                found: Any = observations[:, place : place + 1].astype(np.float64)
            elif each.kind == CONSTANT:
                found = np.array([[each.value]])
            elif each.kind == OF_MODULE:
                found = np.array([each.values])
            else:
                found = OPERATIONS[each.kind][0](*operands)
            if each.kind in COMPARISONS and any(part.operands for part in each.operands):
                doubt = doubt | (np.abs(operands[0] - operands[1]) <= EDGE)
            elif each.kind in STEPS:
                steps = operands[0] - STEPS[each.kind]
                doubt = doubt | (np.abs(steps - np.round(steps)) <= EDGE)
            values[id(each)] = found
    return [values[id(each)] for each in formulas], doubt


def hypotenuse(one: Formula, other: Formula) -> Formula:
    """Root of the sum of squares."""
    return operation("root", one * one + other * other)


def limited(value: Formula, least: Operand, most: Operand) -> Formula:
    """No less and no more than so."""
    return operation("minimum", operation("maximum", value, least), most)


def angle_of(sine: Formula, cosine: Formula) -> Formula:
    """[rad] in [-pi, pi], as `arctan2` has it."""
    long = hypotenuse(sine, cosine)
    half_ahead = operation(ARC_TANGENT, sine / (long + cosine))
    half_behind = operation(ARC_TANGENT, (long - cosine) / sine)
    straight = operation("choose", operation("below", cosine, 0.0), math.pi, 0.0)
    level = operation("both", operation("at most", sine, 0.0), operation("at most", 0.0, sine))
    behind = operation("choose", level, straight, 2.0 * half_behind)
    rough = operation("choose", operation("below", 0.0, cosine), 2.0 * half_ahead, behind)
    # A graph's arc tangent is of single precision: what is left of the angle, by its sine.
    left = (sine * operation("cosine", rough) - cosine * operation("sine", rough)) / long
    return operation("choose", operation("below", 0.0, long), rough + left, 0.0)
