"""The mutation test: the changes it makes, and its verdict on each."""

import ast
import sys
from pathlib import Path
from typing import Any

import pytest

from benchmarks import mutation
from benchmarks.mutation import Mutant, Workspace, sample_mutants
from benchmarks.mutation_targets import EQUIVALENTS, TARGETS, Target

REPOSITORY = Path(__file__).parents[2]
SOURCE = '''
"""Twice a number."""
from dataclasses import dataclass
Number = int | float


@dataclass(frozen=True)
class Held:
    value: int | None


def twice(value: int | float = 3) -> int | float:
    if value < 0:
        raise ValueError(f"not below {0 + 0}, got {value - 0}")
    return value * 2
'''


def test_every_module_test_and_equivalent_of_the_tables_exists():
    for target in TARGETS:
        for path in (target.module, *target.near, *target.wide):
            assert (REPOSITORY / path.split("::")[0]).exists(), path
    for each in EQUIVALENTS:
        lines = (REPOSITORY / each.module).read_text(encoding="utf-8").splitlines()
        assert each.was in [line.strip() for line in lines], each
        assert each.was != each.becomes


class TestSample:
    @pytest.fixture(autouse=True)
    def _needs(self):
        pytest.importorskip("cosmic_ray")

    def test_each_mutant_is_the_module_with_one_line_changed(self):
        lines = SOURCE.splitlines()
        for mutant in sample_mutants(SOURCE, 100, "0"):
            ast.parse(mutant.text)
            changed = mutant.text.splitlines()
            ((line, was, becomes),) = [
                (k, *pair) for k, pair in enumerate(zip(lines, changed, strict=True), 1)
                if pair[0] != pair[1]
            ]  # fmt: skip
            assert (line, was.strip(), becomes.strip()) == (mutant.line, mutant.was, mutant.becomes)

    def test_types_decorators_and_errors_are_never_changed(self):
        changed = {mutant.was for mutant in sample_mutants(SOURCE, 100, "0")}
        head = "def twice(value: int | float = 3) -> int | float:"
        assert changed == {head, "if value < 0:", "return value * 2"}
        defaults = [m.becomes for m in sample_mutants(SOURCE, 100, "0") if m.was.startswith("def")]
        assert all("int | float =" in line for line in defaults)

    def test_it_follows_from_the_seed_and_grows_at_its_end(self):
        assert sample_mutants(SOURCE, 2, "1") == sample_mutants(SOURCE, 4, "1")[:2]
        assert len({tuple(sample_mutants(SOURCE, 2, str(seed))) for seed in range(9)}) > 1


def test_a_missing_cosmic_ray_and_a_module_that_is_not_in_the_table_are_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "cosmic_ray.plugins", None)
    with pytest.raises(ImportError, match="pip install cosmic-ray"):
        sample_mutants(SOURCE, 1, "0")
    with pytest.raises(SystemExit, match=r"modules must be in .*, got 'nowhere'"):
        mutation.main(["--modules", "tasks/sort", "nowhere"])


class TestWorkspace:
    """A repository of one function and one test."""

    TARGET = Target("all", "package/twice.py", ("tests/test_twice.py",), ())
    TEST = "from package.twice import twice\n\n\ndef test_twice():\n    assert twice({}) == {}\n"

    @pytest.fixture
    def repository(self, tmp_path, monkeypatch):
        repository = tmp_path / "repository"
        for name in ("package", "tests"):
            (repository / name).mkdir(parents=True)
        (repository / "package" / "twice.py").write_text("def twice(x):\n    return x * 2\n")
        (repository / "tests" / "test_twice.py").write_text(self.TEST.format(2, 4))
        monkeypatch.setattr(mutation, "REPOSITORY", repository)
        monkeypatch.setattr(mutation, "COPIED", ("package", "tests"))
        return repository

    def run(self, repository: Path, becomes: str) -> dict[str, Any]:
        """Test a mutant in a new workspace."""
        text = f"def twice(x):\n    {becomes}\n"
        mutant = Mutant(becomes, 0, 2, "twice", "return x * 2", becomes, text)
        return Workspace(repository.parent, limit=60).test(self.TARGET, mutant)

    def test_a_survivor_is_tested_again_when_tests_change(self, repository):
        killed = self.run(repository, "return x / 2")
        assert killed["outcome"] == "killed"
        assert killed["by"] == "tests/test_twice.py::test_twice"
        assert self.run(repository, "return x + 2")["outcome"] == "survived"
        written = (repository.parent / "results.jsonl").read_text()
        assert self.run(repository, "return x + 2")["outcome"] == "survived"
        assert (repository.parent / "results.jsonl").read_text() == written
        (repository / "tests" / "test_twice.py").write_text(self.TEST.format(3, 6))
        assert self.run(repository, "return x + 2")["outcome"] == "killed"
        assert (repository / "package" / "twice.py").read_text().endswith("x * 2\n")

    def test_tests_that_fail_without_a_mutant_are_an_error(self, repository):
        (repository / "tests" / "test_twice.py").write_text(self.TEST.format(2, 5))
        with pytest.raises(RuntimeError, match="fail without a mutant"):
            self.run(repository, "return x / 2")
