"""The cache of compiled code: it is used, and it notices an edit in any file of the physics."""

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import surface_gym

PACKAGE = Path(surface_gym.__file__).parent
PHYSICS = sorted(path.name for path in (PACKAGE / "dynamics").glob("*.py"))

PROBE = """
import surface_gym as sg
from surface_gym.dynamics.run import run_implicit
surface, parcel = sg.layouts.sorting(), sg.layouts.box("S")
run = sg.simulate(surface, parcel, sg.layouts.start("S"), (1.5, 0.0, 0.0))
print(run.pose[-1].tobytes().hex(), sum(run_implicit.stats.cache_hits.values()))
"""


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """A copy of the package without compiled code."""
    shutil.copytree(PACKAGE, tmp_path / "surface_gym", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "surface_gym"


def probe(package: Path) -> tuple[str, int]:
    """The end pose as bytes, and how often the loop came from the cache, in a new process."""
    environment = {**os.environ, "PYTHONPATH": str(package.parent)}
    environment.pop("NUMBA_CACHE_DIR", None)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", PROBE],
        cwd=package.parent,
        env=environment,
        capture_output=True,
        text=True,
        check=True,
    )
    pose, hits = done.stdout.split()
    return pose, int(hits)


def edit(path: Path, old: str, new: str) -> None:
    source = path.read_text()
    assert old in source
    path.write_text(source.replace(old, new))


def test_compiled_code_is_reused_until_a_file_it_is_inlined_from_changes(copied: Path) -> None:
    first, hits = probe(copied)
    assert hits == 0
    assert probe(copied) == (first, 1)

    # `run_implicit` lives in run.py; its friction comes from another file.
    edit(copied / "dynamics" / "friction.py", "ROUNDING = 1e-5", "ROUNDING = 1e-2")
    edited, hits = probe(copied)
    assert hits == 0
    assert edited != first

    edit(copied / "dynamics" / "friction.py", "ROUNDING = 1e-2", "ROUNDING = 1e-5")
    assert probe(copied)[0] == first


@pytest.mark.parametrize("name", PHYSICS)
def test_every_file_of_the_physics_counts(copied: Path, name: str) -> None:
    def digest() -> str:
        spec = importlib.util.spec_from_file_location("copy", copied / "dynamics" / "compiled.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module._SOURCE_DIGEST

    before = digest()
    assert digest() == before
    with (copied / "dynamics" / name).open("a") as file:
        file.write("# edited\n")
    assert digest() != before
