"""The house: imports go downwards, no two folders import each other, tests are in order."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.order import COLLECTED, FIRST, NIGHTLY, SMOKE, is_nightly, place_of, unused_lines

ROOT = Path(__file__).parents[1]

# From the lowest up: a room, which is a folder or a file beside the folders, imports nothing of
# later lines.
LAYERS = (
    ("checks", "files", "registry"),
    ("compiler",),
    ("physics", "rendering", "recording"),
    ("canvas", "parcel", "state", "surface"),
    ("layouts",),
    ("lines", "randomisation"),
    ("sensors", "tasks"),
    ("actions", "feature_groups"),
    ("config",),
    ("core", "flow", "env", "scenes", "machine"),
    ("trajectory", "simulation", "recorder", "player"),
    ("vector_env", "goal_env", "cuda", "web"),
    ("agents.base",),
    ("agents.planning",),
    ("agents.scheduling", "agents.library"),
    ("agents.rules",),
    ("agents.learning",),
    ("agents.evaluation", "agents.tuning"),
    ("agents.benchmark", "agents.datasets", "agents.export", "agents.train_cli"),
    ("agents.dataset_cli",),
)


def module_of(path: Path) -> str:
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    if parts[0] == "agents":
        parts.insert(0, "surface_gym")
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {
    module_of(path): path
    for folder in ("surface_gym", "agents")
    for path in sorted((ROOT / folder).rglob("*.py"))
}


def statements(tree: ast.AST, loading: bool) -> Iterator[ast.AST]:
    """Every statement, or those alone that run as the module is loaded."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if not (loading and isinstance(node, ast.FunctionDef)):
            yield node
            yield from statements(node, loading)


def imported(module: str, loading: bool = False) -> set[str]:
    """The package's own modules that a module imports, at all or as it is loaded."""
    path = FILES[module]
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    found = set()
    for node in statements(ast.parse(path.read_text()), loading):
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
    return found - {"", "surface_gym", "surface_gym.agents", module}


@cache
def imports() -> dict[str, set[str]]:
    return {module: imported(module) for module in FILES}


def room_of(module: str) -> str:
    """The folder of a module; of one that lies in none, its own name."""
    path = FILES[module]
    package = module if path.name == "__init__.py" else module.rpartition(".")[0]
    return module if package in ("surface_gym", "surface_gym.agents") else package


@cache
def edges() -> dict[str, set[str]]:
    found: dict[str, set[str]] = defaultdict(set)
    for module, others in imports().items():
        found[room_of(module)] |= {room_of(each) for each in others} - {room_of(module)}
    return dict(found)


def reached(graph: dict[str, set[str]], start: str) -> set[str]:
    """Every node that a node leads to."""
    found: set[str] = set()
    waiting = [start]
    while waiting:
        others = graph.get(waiting.pop(), set()) - found
        found |= others
        waiting.extend(others)
    return found


def test_no_file_needs_itself():
    """An import that runs later, inside a function, counts too."""
    circles = {module for module in FILES if module in reached(imports(), module)}
    assert sorted(circles) == []


def test_no_file_needs_itself_to_be_loaded():
    graph = {module: imported(module, loading=True) for module in FILES}
    assert [module for module in FILES if module in reached(graph, module)] == []


def test_no_two_folders_import_each_other():
    graph = {room: others for room, others in edges().items() if FILES[room].name == "__init__.py"}
    mutual = {
        tuple(sorted((room, other)))
        for room, others in graph.items()
        for other in others
        if room in graph.get(other, ())
    }
    assert mutual == set()


@pytest.mark.parametrize("room", [room for line in LAYERS for room in line])
def test_layers_import_downwards(room):
    (level,) = (k for k, line in enumerate(LAYERS) if room in line)
    above = {f"surface_gym.{each}" for line in LAYERS[level + 1 :] for each in line}
    assert not edges().get(f"surface_gym.{room}", set()) & above


@pytest.mark.parametrize(
    ("room", "never"),
    [
        ("surface_gym.tasks", "surface_gym.core"),
        ("surface_gym.core", "surface_gym.vector_env"),
        ("surface_gym.rendering", "surface_gym.state"),
        ("surface_gym.agents.planning", "surface_gym.agents.learning"),
        ("surface_gym.agents.planning", "surface_gym.agents.rules"),
        ("surface_gym.agents.learning", "surface_gym.agents.evaluation"),
    ],
)
def test_a_room_never_reaches_another(room, never):
    assert room in edges()
    assert never not in reached(edges(), room)


@pytest.mark.parametrize("name", [*FIRST, *SMOKE])
def test_what_is_named_is_there(name):
    file, *inside = name.split("::")
    assert (ROOT / file).exists()
    if inside:
        assert f" {inside[-1].partition('[')[0]}" in (ROOT / file).read_text()


def test_a_line_for_the_night_fits_the_beginning_of_names_with_any_text_between():
    of_cluster = "tests/parallel/test_jobs.py::test_two_share_what_there_is_and_are_used_again"
    assert is_nightly(f"{of_cluster}[a cluster]")
    assert not is_nightly(f"{of_cluster}[processes]")
    of_file = [line for line in NIGHTLY if line.startswith("tests/parallel/")]
    assert unused_lines(["tests/parallel/test_jobs.py::test_none"]) == of_file


def test_each_line_for_the_night_fits_a_test(request):
    # Where a single test of a file was asked for, others are not there.
    if any("::" in each for each in request.config.args):
        pytest.skip("not all tests of the files are collected")
    assert unused_lines(request.config.stash[COLLECTED]) == []


def test_those_not_named_come_last():
    assert place_of(f"{FIRST[1]}::TestSeeds") == 1
    assert place_of("tests/test_surface.py::test_it") == len(FIRST)
