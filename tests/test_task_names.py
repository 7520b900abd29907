"""Nobody outside a task knows it by name: a task of yours is treated as the package's are."""

import ast
from collections import defaultdict
from collections.abc import Iterator

from surface_gym.registration import SHIPPED
from tests.test_layers import FILES, imported

PLACES = [shipped.place.partition(":") for shipped in SHIPPED.values()]
MODULES = {module for module, _, _ in PLACES}
CLASSES = {name for _, _, name in PLACES}

TEXTS = {*SHIPPED} - {"stop"}  # which also is what a take-away and a controller do

# Files that name tasks: the tasks' own, and the table of all.
OWN = {*MODULES, "surface_gym.registration", "surface_gym.tasks"}
# Rules say which task they are for; design asks for the surface that a purpose needs.
OF_A_TASK = ("surface_gym.agents.rules", "surface_gym.design")
# Learning and planning that is made for one task's observation, and the reports of its lines.
MADE_FOR_ONE = {
    "surface_gym.agents.evaluation.streams",
    "surface_gym.agents.learning.algorithms",
    "surface_gym.agents.module_policy",
    "surface_gym.agents.planning.layouts",
    "surface_gym.agents.scheduling.flow_answer",
}


def names_of_tasks(module: str) -> Iterator[str]:
    """Find the names of tasks in a file's code: as text, imported, or looked up."""
    tree = ast.parse(FILES[module].read_text())
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and node.value in TEXTS:
            yield f"{node.lineno}: {node.value!r}"
        elif isinstance(node, ast.ImportFrom):
            for each in node.names:
                if each.name in CLASSES and node.module in {*MODULES, "surface_gym.tasks"}:
                    yield f"{node.lineno}: import {each.name}"
        elif isinstance(node, ast.Attribute) and node.attr in {*CLASSES, *SHIPPED}:
            yield from [f"{node.lineno}: {node.attr}"] * (ast.unparse(node.value) == "sg.tasks")


def found() -> dict[str, list[str]]:
    """The names of tasks in files that are no task's own, by module."""
    named: dict[str, list[str]] = defaultdict(list)
    for module in FILES:
        if module not in OWN and not module.startswith(OF_A_TASK):
            for each in names_of_tasks(module):
                named[module].append(each)
    return dict(named)


def test_nobody_names_a_task():
    assert {module: each for module, each in found().items() if module not in MADE_FOR_ONE} == {}
    assert set(found()) == MADE_FOR_ONE  # none that no longer does


def test_the_configuration_and_the_core_import_no_task():
    core = [name for name in FILES if name.startswith(("surface_gym.core", "surface_gym.cuda"))]
    for module in ("surface_gym.config", "surface_gym.env", "surface_gym.vector_env", *core):
        assert not imported(module) & MODULES, module
