"""English of docstrings and comments, and names of classes: see CONTRIBUTING.md."""

import ast
import io
import re
import tokenize
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.test_layers import FILES, ROOT

# Phrases that readers read twice, and what to write.
PHRASES = {
    r"\bthose of\b|\bthat of\b|\bthe ones? that\b|\bof which\b|\bof those\b": "repeat the noun",
    r"(?:^|[.!?] )(?:Of|Where|By) ": "begin with the subject",
    r", which (?:come|are|have)\b": "use a participle: 'boxes arriving'",
    r"(?<![\w.\]])\.\d": "write a digit before the point",
    r"\bone's own\b|\btold\b|\bhonest|\bknows nothing of\b": "use a plain word",
}
# A class is a noun: what a participle would name, and adjectives.
PARTICIPLE = re.compile(
    r"_?(?:\w*[^e]ed|Seen|Kept|Found|Thrown|Chosen|Drawn|Given|Held|Taken|Known|Lost|Sent|Made)"
)
# Files with phrases or names that are yet to be changed. This list only shrinks.
UNCHANGED: tuple[str, ...] = (
    "agents/base.py",
    "agents/export/web.py",
    "agents/learning/local.py",
    "agents/learning/modules.py",
    "agents/learning/shared.py",
    "agents/rules/base.py",
    "agents/rules/braking.py",
    "agents/rules/decoding.py",
    "agents/rules/singulation.py",
    "agents/rules/slopes.py",
    "agents/rules/sorting.py",
    "agents/rules/steering.py",
    "agents/runtime/controller.py",
    "agents/scheduling/decisions.py",
    "agents/scheduling/features.py",
    "agents/scheduling/leading.py",
    "surface_gym/checks.py",
    "surface_gym/compiler/linking.py",
    "surface_gym/config.py",
    "surface_gym/core/assembly.py",
    "surface_gym/core/kernel.py",
    "surface_gym/design/case.py",
    "surface_gym/design/cli.py",
    "surface_gym/design/limits.py",
    "surface_gym/design/search.py",
    "surface_gym/env.py",
    "surface_gym/flow/base.py",
    "surface_gym/flow/sequence.py",
    "surface_gym/flow/singulate.py",
    "surface_gym/flow/state.py",
    "surface_gym/flow/task.py",
    "surface_gym/lines.py",
    "surface_gym/physics/types.py",
    "surface_gym/player.py",
    "surface_gym/rendering/scene.py",
    "surface_gym/sensors/base.py",
    "surface_gym/sensors/camera.py",
    "surface_gym/tasks/base.py",
    "surface_gym/tasks/benchmark.py",
    "surface_gym/tasks/features.py",
    "surface_gym/tasks/paths.py",
    "surface_gym/tasks/planning.py",
    "surface_gym/tasks/start.py",
    "surface_gym/tasks/track.py",
    "surface_gym/web/build.py",
)


def is_unchanged(path: Path) -> bool:
    return str(path.relative_to(ROOT)).startswith(UNCHANGED)


@cache
def prose(path: Path) -> tuple[tuple[int, str], ...]:
    """Line and text, on one line, of every docstring's paragraph and every block of comments."""
    source = path.read_text()
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            for paragraph in (ast.get_docstring(node) or "").split("\n\n"):
                line = node.body[0].lineno if node.body else 1
                found.append((line, " ".join(paragraph.split())))
    comments: list[tuple[int, str]] = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            text, whole = token.string[1:].strip(), token.line.lstrip().startswith("#")
            if whole and comments and comments[-1][0] == token.start[0] - 1:
                text = f"{comments.pop()[1]} {text}"
            comments.append((token.start[0], text))
    return (*found, *comments)


@pytest.mark.parametrize("phrase", PHRASES)
def test_prose_has_no_phrase_that_is_read_twice(phrase: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {text}"
        for path in FILES.values()
        if not is_unchanged(path)
        for line, text in prose(path)
        if re.search(phrase, text)
    ]
    assert not found, f"{len(found)} texts, {PHRASES[phrase]}:\n" + "\n".join(found)


def classes() -> Iterator[tuple[str, Path]]:
    for path in FILES.values():
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                yield node.name, path


def test_a_class_is_a_noun() -> None:
    found = [
        f"{path.relative_to(ROOT)}: {name}"
        for name, path in classes()
        if PARTICIPLE.fullmatch(name) and not is_unchanged(path)
    ]
    assert not found, "classes named by participles:\n" + "\n".join(found)


def test_a_name_of_a_class_has_one_meaning() -> None:
    places = defaultdict(list)
    for name, path in classes():
        if not is_unchanged(path):
            places[name].append(str(path.relative_to(ROOT)))
    twice = [f"{name}: {', '.join(files)}" for name, files in places.items() if len(files) > 1]
    assert not twice, "names of several classes:\n" + "\n".join(twice)


def test_the_list_of_unchanged_files_names_files() -> None:
    for name in UNCHANGED:
        assert (ROOT / name).exists(), name
