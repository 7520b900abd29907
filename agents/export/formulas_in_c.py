"""Formulas as C statements."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .arrays_in_c import double, table_of_doubles
from .formula import CONSTANT, FEATURE, OF_MODULE, OPERATIONS, Formula, in_order


@dataclass(frozen=True)
class InC:
    """Formulas in C: what goes before a loop over modules, and what into it."""

    tables: str  # of constants of each module
    once: tuple[str, ...]  # statements
    of_module: tuple[str, ...]  # statements, for the module `module`
    results: tuple[str, ...]  # what stands for each formula


def formulas_in_c(formulas: Sequence[Formula], prefix: str) -> InC:
    """Statements that reckon formulas of `observation`.

    Args:
        formulas: each of them.
        prefix: of the tables' names.
    """
    names: dict[int, str] = {}
    tables = ""
    once: list[str] = []
    of_module: list[str] = []
    for each in in_order(formulas):
        called = re.sub("[^0-9a-z]+", "_", each.name) or "number"
        if each.kind == FEATURE:
            name = f"(double)observation[{int(each.value)}]"
        elif each.kind == CONSTANT:
            name = double(each.value)
        elif each.kind == OF_MODULE:
            tables += table_of_doubles(f"{prefix}_{called}", np.array(each.values))
            name = f"{prefix}_{called}[module]"
        else:
            name = f"{called}_{len(names)}"
            told = OPERATIONS[each.kind][2].format(*(names[id(part)] for part in each.operands))
            kind = "int" if each.is_truth else "double"
            (of_module if each.is_of_module else once).append(f"const {kind} {name} = {told};")
        names[id(each)] = name
    results = tuple(names[id(each)] for each in formulas)
    return InC(tables, tuple(once), tuple(of_module), results)
