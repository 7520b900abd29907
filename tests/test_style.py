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
        if PARTICIPLE.fullmatch(name)
    ]
    assert not found, "classes named by participles:\n" + "\n".join(found)


def test_a_name_of_a_class_has_one_meaning() -> None:
    places = defaultdict(list)
    for name, path in classes():
        places[name].append(str(path.relative_to(ROOT)))
    twice = [f"{name}: {', '.join(files)}" for name, files in places.items() if len(files) > 1]
    assert not twice, "names of several classes:\n" + "\n".join(twice)
