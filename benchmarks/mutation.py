"""A mutation test: how many small faults, put into the code one at a time, the tests detect.

`python -m benchmarks.mutation --help`. It works in a copy of the repository, and can be interrupted
and resumed: a mutant that was detected stays so while its module is the same, and one that survived
is tested again after a test has changed.
"""

import ast
import hashlib
import importlib
import json
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import tyro
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.mutation_targets import EQUIVALENTS, TARGETS, Target

REPOSITORY = Path(__file__).parents[1]
COPIED = ("surface_gym", "agents", "benchmarks", "docs", "examples", "tests")
MAX_SECONDS = 1800  # [s] of wall time for a run of tests, whatever else the machine does
KILLED, SURVIVED, EQUIVALENT = "killed", "survived", "equivalent"

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


def sample_mutants(source: str, count: int, seed: str) -> list[Mutant]:
    """Draw mutants of a module's source, each at another place.

    Code that does not run, or is only read, is never changed. A larger sample begins with a smaller
    one.

    Raises:
        ImportError: cosmic-ray is not installed.
    """
    try:
        plugins = importlib.import_module("cosmic_ray.plugins")
        mutating = importlib.import_module("cosmic_ray.mutating")
    except ImportError:
        raise ImportError(
            "a mutation test needs cosmic-ray (extra 'mutation'): pip install cosmic-ray"
        ) from None
    operators = {name: plugins.get_operator(f"core/{name}")() for name in OPERATORS}
    rng = random.Random(seed)
    by_place = _operators_by_place(source, operators)
    places = sorted(by_place)
    rng.shuffle(places)
    functions = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)]
    found = []
    for place in places[:count]:
        name, occurrence = rng.choice(by_place[place])
        text = mutating.mutate_code(source, operators[name], occurrence)
        around = [f for f in functions if f.lineno <= place[0] <= (f.end_lineno or 0)]
        function = max(around, key=lambda f: f.lineno).name if around else ""
        lines = _first_difference(source, text)
        found.append(Mutant(name, occurrence, place[0], function, *lines, text))
    return found


def _operators_by_place(
    source: str, operators: dict[str, Any]
) -> dict[Place, list[tuple[str, int]]]:
    """Return the operators that can change each place: names, and occurrences in the module."""
    nodes = importlib.import_module("cosmic_ray.ast")
    excluded = list(_excluded_spans(ast.parse(source)))
    found: dict[Place, list[tuple[str, int]]] = {}
    occurrences = dict.fromkeys(operators, 0)
    for node in nodes.ast_nodes(nodes.get_ast(source)):
        for name, operator in operators.items():
            for place, _ in operator.mutation_positions(node):
                if not any(begin <= place < end for begin, end in excluded):
                    found.setdefault(place, []).append((name, occurrences[name]))
                occurrences[name] += 1
    return found


def _first_difference(source: str, text: str) -> tuple[str, str]:
    """Return the first line that differs, before and after."""
    pairs = zip_longest(source.splitlines(), text.splitlines(), fillvalue="")
    was, becomes = next(pair for pair in pairs if pair[0] != pair[1])
    return was.strip(), becomes.strip()


def _excluded_spans(tree: ast.Module) -> Iterator[tuple[Place, Place]]:
    """Yield the spans of annotations, decorators, errors and names of types."""
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
    """Return the first place of a node, and the place after its last."""
    return (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)


@dataclass(frozen=True)
class RunResult:
    """The result of a run of tests."""

    failed: str  # the first test that failed, or another cause; "": all passed
    seconds: float  # [s] of the processor


class Workspace:
    """A copy of the repository to test mutants in, and the results so far."""

    def __init__(self, folder: Path, limit: int) -> None:
        self._copy = folder.resolve() / "copy"
        self._cache = folder.resolve() / "cache"
        self._results = folder.resolve() / "results.jsonl"
        self._limit = limit
        self._known: dict[str, dict[str, Any]] = {}
        for name in COPIED:
            shutil.rmtree(self._copy / name, ignore_errors=True)
            ignore = shutil.ignore_patterns("__pycache__")
            shutil.copytree(REPOSITORY / name, self._copy / name, symlinks=True, ignore=ignore)
        for file in REPOSITORY.iterdir():
            if file.is_file():
                shutil.copy2(file, self._copy)
        link = self._copy / "surface_gym" / "agents"
        if (self._copy / "agents").is_dir() and not link.exists():
            link.symlink_to(self._copy / "agents")  # an installation finds the repository's own
        self._tests = _digest(*sorted((self._copy / "tests").rglob("*.py")))
        if self._results.exists():
            for line in self._results.read_text().splitlines():
                result = json.loads(line)
                self._known[result["key"]] = result

    def test(self, target: Target, mutant: Mutant) -> dict[str, Any]:
        """Return the result of a mutant, known or tested now.

        Raises:
            RuntimeError: a test fails without a mutant.
        """
        module = self._copy / target.module
        killed = f"{_digest(module)} {mutant.operator} {mutant.occurrence}"
        survived = f"{killed} {self._tests} {' '.join((*target.near, *target.wide))}"
        for key in (killed, survived):
            if key in self._known:
                return self._known[key]
        self._check(target)
        source = module.read_text(encoding="utf-8")
        compiled = set(self._cache.rglob("*"))
        try:
            module.write_text(mutant.text, encoding="utf-8")
            near = self._run((target.module, *target.near))
            wide = RunResult("", 0.0) if near.failed or not target.wide else self._run(target.wide)
        finally:
            module.write_text(source, encoding="utf-8")
            for file in set(self._cache.rglob("*")) - compiled:
                if file.is_file():
                    file.unlink()
        if "::" in wide.failed and self._run((wide.failed,)).failed:
            raise RuntimeError(f"{wide.failed} fails without a mutant")
        by = near.failed or wide.failed
        return self._keep(
            key=killed if by else survived,
            module=target.module,
            line=mutant.line,
            function=mutant.function,
            was=mutant.was,
            becomes=mutant.becomes,
            operator=mutant.operator,
            outcome=KILLED if by else SURVIVED,
            by=by,
            seconds=round(near.seconds + wide.seconds, 1),
        )

    def _check(self, target: Target) -> None:
        """Raise an error unless the tests pass without a mutant, and fill the compiler's cache."""
        near = [self._copy / path.split("::")[0] for path in (target.module, *target.near)]
        key = f"{target.module} {_digest(*near)}"
        if key in self._known:
            return
        run = self._run((target.module, *target.near), 10)
        if run.failed:
            raise RuntimeError(f"the tests of {target.module} fail without a mutant: {run.failed}")
        self._keep(key=key, module=target.module, outcome="unchanged", seconds=run.seconds)

    def _run(self, tests: tuple[str, ...], patience: int = 1) -> RunResult:
        """Run tests in the copy, within the limits times `patience`."""
        limit = patience * self._limit
        # Python recognises an edited file by its size and the second of its edit: a mutant may have
        # both of the file before, so no bytecode is kept.
        environment = {
            **os.environ,
            "PYTHONPATH": str(self._copy),
            "PYTHONDONTWRITEBYTECODE": "1",
            "NUMBA_CACHE_DIR": str(self._cache),
        }
        options = "-x -q --no-header --tb=no -rfE -p no:cacheprovider -o addopts=--doctest-modules"
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", *options.split(), *tests],
            cwd=self._copy,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            start_new_session=True,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (limit, limit)),
        )
        try:
            output, _ = process.communicate(timeout=patience * MAX_SECONDS)
        except subprocess.TimeoutExpired:
            output = ""
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        if process.returncode == 0:
            return RunResult("", spent)
        if process.returncode < 0:
            return RunResult(f"ended by {signal.Signals(-process.returncode).name}", spent)
        found = re.search(r"^(?:FAILED|ERROR) (\S+)", output, re.MULTILINE)
        return RunResult(found[1] if found else output.strip()[-200:], spent)

    def _keep(self, **result: Any) -> dict[str, Any]:
        """Add a result to the file."""
        self._known[result["key"]] = result
        with self._results.open("a") as file:
            file.write(json.dumps(result) + "\n")
        return result


def _digest(*files: Path) -> str:
    """Return a digest of the contents of files."""
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]


@dataclass(frozen=True)
class MutationConfig:
    """Put small faults into the code, one at a time, and count those that the tests detect."""

    modules: tuple[str, ...] = ()
    """Ends of the paths of modules, without .py; none: every one of the table."""
    sample: int = 5
    """Faults in each module."""
    seed: int = 0
    """Of the sample; a larger sample holds a smaller one."""
    folder: Path = Path("mutation")
    """For the copy, its compiled code and results.jsonl."""
    limit: int = 200
    """[s] of processor time for a run of tests; a fault that takes longer is detected."""


def _is_equivalent(target: Target, mutant: Mutant) -> bool:
    """Return whether a mutant is in the table of equivalents."""
    place = (target.module, mutant.function, mutant.was, mutant.becomes)
    return any(place == (e.module, e.function, e.was, e.becomes) for e in EQUIVALENTS)


def _choose_targets(modules: tuple[str, ...]) -> list[Target]:
    """Return the targets whose modules have one of the endings; all without any."""
    for end in modules:
        if not any(target.module.endswith(f"{end}.py") for target in TARGETS):
            raise ValueError(f"modules must be in benchmarks/mutation_targets.py, got {end!r}")
    ends = tuple(f"{end}.py" for end in modules) or ("",)
    return [target for target in TARGETS if target.module.endswith(ends)]


def _results_table(results: list[tuple[Target, str, float]]) -> Table:
    """Make a table of the counts by area."""
    table = Table("area", title="mutants")
    for column in ("tested", KILLED, EQUIVALENT, SURVIVED, "killed of the others", "CPU s each"):
        table.add_column(column, justify="right")
    for area in (*dict.fromkeys(target.area for target, _, _ in results), "all"):
        of_area = [row for row in results if area in (row[0].area, "all")]
        counts = {
            outcome: sum(row[1] == outcome for row in of_area)
            for outcome in (KILLED, EQUIVALENT, SURVIVED)
        }
        run = len(of_area) - counts[EQUIVALENT]
        table.add_row(
            area,
            str(len(of_area)),
            *map(str, counts.values()),
            f"{counts[KILLED] / run:.0%}" if run else "",
            f"{sum(row[2] for row in of_area) / run:.0f}" if run else "",
        )
    return table


def main(arguments: Sequence[str] | None = None) -> None:
    """Run `python -m benchmarks.mutation` with some arguments; None: the process's own."""
    config = tyro.cli(MutationConfig, prog="python -m benchmarks.mutation", args=arguments)
    console = Console()
    try:
        targets = _choose_targets(config.modules)
        samples = [
            sample_mutants(
                (REPOSITORY / target.module).read_text(encoding="utf-8"),
                config.sample,
                f"{config.seed} {target.module}",
            )
            for target in targets
        ]
    except (ImportError, ValueError) as error:
        sys.exit(str(error))
    config.folder.mkdir(parents=True, exist_ok=True)
    workspace = Workspace(config.folder, config.limit)
    results: list[tuple[Target, str, float]] = []
    # The first of every module, then the second: an interrupted run covers all of them.
    in_turn = [
        (target, mutants[k])
        for k in range(config.sample)
        for target, mutants in zip(targets, samples, strict=True)
        if k < len(mutants)
    ]
    for target, mutant in track(in_turn, "testing", console=console, transient=True):
        if _is_equivalent(target, mutant):
            results.append((target, EQUIVALENT, 0.0))
            continue
        try:
            result = workspace.test(target, mutant)
        except RuntimeError as error:
            sys.exit(str(error))
        results.append((target, result["outcome"], result["seconds"]))
        if result["outcome"] == SURVIVED:
            where = f"{target.module}:{mutant.line}"
            console.print(
                f"survived: {where}\n  - {mutant.was}\n  + {mutant.becomes}", markup=False
            )
    console.print(_results_table(results))


if __name__ == "__main__":
    main()
