"""The mutants of a module by cosmic-ray's operators, and a sample of them."""

import ast
import importlib
import random
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import zip_longest
from typing import Any

# Faults that people make: a wrong sign, a bound that is in or out, a condition turned round.
OPERATORS = (
    *(
        f"ReplaceBinaryOperator_{pair}"
        for pair in (
            "Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "FloorDiv_Div", "Mod_Mul", "Pow_Mul",
            "BitAnd_BitOr", "BitOr_BitAnd",
        )
    ),
    *(
        f"ReplaceComparisonOperator_{pair}"
        for pair in (
            "Lt_LtE", "Lt_GtE", "LtE_Lt", "LtE_Gt", "Gt_GtE", "Gt_LtE", "GtE_Gt", "GtE_Lt",
            "Eq_NotEq", "NotEq_Eq", "Is_IsNot", "IsNot_Is",
        )
    ),
    "ReplaceUnaryOperator_Delete_USub", "ReplaceUnaryOperator_Delete_Not",
    "ReplaceUnaryOperator_Delete_Invert", "AddNot", "ReplaceTrueWithFalse",
    "ReplaceFalseWithTrue", "ReplaceAndWithOr", "ReplaceOrWithAnd", "ReplaceBreakWithContinue",
    "ReplaceContinueWithBreak", "ExceptionReplacer", "NumberReplacer", "ZeroIterationForLoop",
)  # fmt: skip

Place = tuple[int, int]  # line, from 1, and column


@dataclass(frozen=True)
class Mutant:
    """A module with a fault."""

    operator: str  # of cosmic-ray
    occurrence: int  # of the operator in the module
    line: int  # from 1
    function: str  # that the line is in; "": none
    was: str  # the line
    becomes: str
    text: str  # the whole module


def sample_of(source: str, count: int, seed: str) -> list[Mutant]:
    """Mutants of a module's source at places drawn at random, one a place.

    What does not run, or is only read, is left as it is. A larger sample begins with a smaller one.

    Raises:
        ImportError: cosmic-ray is not installed.
    """
    try:
        plugins = importlib.import_module("cosmic_ray.plugins")
        mutating = importlib.import_module("cosmic_ray.mutating")
    except ImportError:
        raise ImportError(
            "a mutation trial needs cosmic-ray (extra 'mutation'): pip install cosmic-ray"
        ) from None
    operators = {name: plugins.get_operator(f"core/{name}")() for name in OPERATORS}
    rng = random.Random(seed)
    by_place = _by_place(source, operators)
    places = sorted(by_place)
    rng.shuffle(places)
    functions = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)]
    found = []
    for place in places[:count]:
        name, occurrence = rng.choice(by_place[place])
        text = mutating.mutate_code(source, operators[name], occurrence)
        around = [f for f in functions if f.lineno <= place[0] <= (f.end_lineno or 0)]
        function = max(around, key=lambda f: f.lineno).name if around else ""
        found.append(Mutant(name, occurrence, place[0], function, *_changed(source, text), text))
    return found


def _by_place(source: str, operators: dict[str, Any]) -> dict[Place, list[tuple[str, int]]]:
    """Which operators can change what: their names, and their how manieth chance in the module."""
    nodes = importlib.import_module("cosmic_ray.ast")
    left_out = list(_left_out(ast.parse(source)))
    found: dict[Place, list[tuple[str, int]]] = {}
    chances = dict.fromkeys(operators, 0)
    for node in nodes.ast_nodes(nodes.get_ast(source)):
        for name, operator in operators.items():
            for place, _ in operator.mutation_positions(node):
                if not any(begin <= place < end for begin, end in left_out):
                    found.setdefault(place, []).append((name, chances[name]))
                chances[name] += 1
    return found


def _changed(source: str, text: str) -> tuple[str, str]:
    """The first line that differs, as it was and as it becomes."""
    pairs = zip_longest(source.splitlines(), text.splitlines(), fillvalue="")
    was, becomes = next(pair for pair in pairs if pair[0] != pair[1])
    return was.strip(), becomes.strip()


def _left_out(tree: ast.Module) -> Iterator[tuple[Place, Place]]:
    """Where types are told, what compiles a function, the words of errors, names of types."""
    for node in ast.walk(tree):
        parts: list[Any] = []
        if isinstance(node, ast.FunctionDef):
            parts = [node.returns, *node.decorator_list]
        elif isinstance(node, ast.ClassDef):
            parts = [*node.decorator_list]
        elif isinstance(node, (ast.arg, ast.AnnAssign)):
            parts = [node.annotation]
        elif isinstance(node, ast.Raise) or (
            isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        ):
            parts = [node]
        yield from (_span(part) for part in parts if part is not None)
    for node in tree.body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.BinOp | ast.Subscript):
            value = node.value
            if isinstance(value, ast.Subscript) or isinstance(value.op, ast.BitOr):
                yield _span(node)


def _span(node: Any) -> tuple[Place, Place]:
    return (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)
