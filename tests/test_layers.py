"""Layers of the code: imports go downwards, and no two folders import each other."""

import ast
import itertools
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# From the lowest up. A room imports from rooms before it, and from none after it. Rooms in one
# line do not import each other.
LAYERS = (
    ("checks", "files", "physics"),
    ("parcel", "rendering"),
    ("surface",),
    ("layouts", "trajectory"),
    ("lines", "simulation", "randomisation"),
    ("state", "together"),
    ("sensors", "tasks"),
    ("core",),
)


def module_of(path: Path) -> str:
    """The name a file is imported by."""
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    if parts[0] == "agents":
        parts.insert(0, "surface_gym")
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {
    module_of(path): path
    for folder in ("surface_gym", "agents")
    for path in sorted((ROOT / folder).rglob("*.py"))
}


def imported(module: str) -> set[str]:
    """The package's own modules that a module imports, at its top or inside a function."""
    path = FILES[module]
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names = [each.name for each in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package.split(".")[: len(package.split(".")) - node.level + 1]
            base = ".".join([*above, *filter(None, [node.module])]) if node.level else node.module
            names = [f"{base}.{each.name}" for each in node.names]
        else:
            continue
        for name in names:
            while name and name not in FILES:
                name = name.rpartition(".")[0]
            found.add(name)
    return found - {"", module}


IMPORTS = {module: imported(module) for module in FILES}


def room_of(module: str) -> str:
    """The folder of a module; of one that lies in none, its own name."""
    path = FILES[module]
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    return module if package in ("surface_gym", "surface_gym.agents") else package


def edges() -> dict[str, set[str]]:
    """The rooms that each room imports."""
    found = defaultdict(set)
    for module, others in IMPORTS.items():
        found[room_of(module)] |= {room_of(each) for each in others} - {room_of(module)}
    return dict(found)


def circles(graph: dict[str, set[str]]) -> list[set[str]]:
    """Sets of nodes that reach each other."""
    reach = {node: set(itertools.chain.from_iterable(_walk(graph, node))) for node in graph}
    return [
        {other for other in graph if other in reach[node] and node in reach[other]}
        for node in graph
        if node in reach[node]
    ]


def _walk(graph: dict[str, set[str]], node: str) -> list[set[str]]:
    found, waiting = [], [node]
    seen = set()
    while waiting:
        others = graph.get(waiting.pop(), set()) - seen
        seen |= others
        found.append(others)
        waiting.extend(others)
    return found


def test_no_file_imports_itself_through_others():
    assert circles({m: o - {"surface_gym", "surface_gym.agents"} for m, o in IMPORTS.items()}) == []


def test_no_two_folders_import_each_other():
    graph = edges()
    mutual = {
        tuple(sorted((a, b)))
        for a, others in graph.items()
        for b in others
        if a in graph.get(b, ())
    }
    assert mutual == set()


@pytest.mark.parametrize("upper", range(1, len(LAYERS)))
def test_layers_import_downwards(upper: int):
    above = {f"surface_gym.{room}" for line in LAYERS[upper:] for room in line}
    graph = edges()
    for line in LAYERS[:upper]:
        for room in line:
            assert not graph.get(f"surface_gym.{room}", set()) & above, room


@pytest.mark.parametrize(
    ("room", "never"),
    [
        ("surface_gym.physics", "surface_gym.tasks"),
        ("surface_gym.tasks", "surface_gym.core"),
        ("surface_gym.agents.learning", "surface_gym.agents.evaluation"),
        ("surface_gym.agents.planning", "surface_gym.agents.learning"),
        ("surface_gym.agents.rules", "surface_gym.agents.planning"),
    ],
)
def test_who_knows_nothing_of_whom(room: str, never: str):
    reached = set(itertools.chain.from_iterable(_walk(edges(), room)))
    assert room in edges()
    assert never not in reached
