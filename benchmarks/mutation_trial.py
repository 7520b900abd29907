"""A copy of the repository in which mutants are tried, one at a time, and what became of them."""

import hashlib
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.mutation_sample import Mutant
from benchmarks.mutation_targets import Target

REPOSITORY = Path(__file__).parents[1]
COPIED = ("surface_gym", "agents", "benchmarks", "docs/environments", "examples", "tests")
LONGEST = 1800  # [s] of the clock for a run of tests, whatever else the machine does
KILLED, SURVIVED = "killed", "survived"


@dataclass(frozen=True)
class Ran:
    """A run of tests."""

    failed: str  # the first test that failed, or what else went wrong; "": all passed
    seconds: float  # [s] of the processor


class Trial:
    """The copy, and what is known of each mutant already."""

    def __init__(self, folder: Path, limit: int) -> None:
        self._copy = folder.resolve() / "copy"
        self._cache = folder.resolve() / "cache"
        self._results = folder.resolve() / "results.jsonl"
        self._limit = limit
        self._known: dict[str, dict[str, Any]] = {}
        for name in COPIED:
            shutil.rmtree(self._copy / name, ignore_errors=True)
            left_out = shutil.ignore_patterns("__pycache__")
            shutil.copytree(REPOSITORY / name, self._copy / name, ignore=left_out)
        for file in REPOSITORY.iterdir():
            if file.is_file():
                shutil.copy2(file, self._copy)
        self._tests = _digest(*sorted((self._copy / "tests").rglob("*.py")))
        if self._results.exists():
            for line in self._results.read_text().splitlines():
                result = json.loads(line)
                self._known[result["key"]] = result

    def outcome(self, target: Target, mutant: Mutant) -> dict[str, Any]:
        """What became of a mutant: known, or tried now.

        Raises:
            RuntimeError: a test fails without it.
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
            wide = Ran("", 0.0) if near.failed or not target.wide else self._run(target.wide)
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
        """Raise an error unless the tests pass as they are; fills the cache of compiled code."""
        near = [self._copy / path.split("::")[0] for path in (target.module, *target.near)]
        key = f"{target.module} {_digest(*near)}"
        if key in self._known:
            return
        ran = self._run((target.module, *target.near), 10)
        if ran.failed:
            raise RuntimeError(f"the tests of {target.module} fail without a mutant: {ran.failed}")
        self._keep(key=key, module=target.module, outcome="as it is", seconds=ran.seconds)

    def _run(self, tests: tuple[str, ...], patience: int = 1) -> Ran:
        limit = patience * self._limit
        # Python tells an edited file by its size and the second of its edit: a mutant may share
        # both with what was there before, so no bytecode is kept.
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
            said, _ = process.communicate(timeout=patience * LONGEST)
        except subprocess.TimeoutExpired:
            said = ""
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        if process.returncode == 0:
            return Ran("", spent)
        if process.returncode < 0:
            return Ran(f"ended by {signal.Signals(-process.returncode).name}", spent)
        found = re.search(r"^(?:FAILED|ERROR) (\S+)", said, re.MULTILINE)
        return Ran(found[1] if found else said.strip()[-200:], spent)

    def _keep(self, **result: Any) -> dict[str, Any]:
        self._known[result["key"]] = result
        with self._results.open("a") as file:
            file.write(json.dumps(result) + "\n")
        return result


def _digest(*files: Path) -> str:
    return hashlib.sha256(b"".join(file.read_bytes() for file in files)).hexdigest()[:16]
