"""The cache of compiled code: it is used, and it notices an edit of any function it is made of."""

import errno
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest
from numba.core.caching import CompileResultCacheImpl, IndexDataCacheFile

import surface_gym
from surface_gym.compiler import jit
from surface_gym.compiler.jit import (
    Baseline,
    compile_for,
    compiled,
    compute_digest,
    find_baseline,
    inlined,
    kernel_function,
    linked,
)

PACKAGE = Path(surface_gym.__file__).parent

PROBE = """
import numpy as np
import surface_gym as sg
from surface_gym.physics.references import find_support
from surface_gym.physics.types import make_scratch
from surface_gym.simulation import start_state
surface, parcel = sg.layouts.sorting(), sg.layouts.box("S")
state = start_state(parcel, np.array(sg.layouts.start("S")), np.zeros(3))
found = find_support(surface.grid, parcel.body, state, make_scratch(), 0.0)
print(found.total, sum(find_support.stats.cache_hits.values()))
"""


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """A copy of the package without compiled code."""
    shutil.copytree(PACKAGE, tmp_path / "surface_gym", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path / "surface_gym"


def probe(package: Path) -> tuple[int, int]:
    """How many contacts a box has, and how often the search for them came from the cache, in a new
    process with a copy of the package, whose compiled code is kept beside it.
    """
    environment = {**os.environ, "PYTHONPATH": str(package.parent)}
    environment.pop("NUMBA_CACHE_DIR", None)
    command = [sys.executable, "-W", "error", "-c", PROBE]
    printed = subprocess.check_output(command, cwd=package.parent, env=environment, text=True)
    contacts, hits = map(int, printed.split())
    return contacts, hits


def edit(path: Path, old: str, new: str) -> None:
    source = path.read_text()
    assert old in source
    path.write_text(source.replace(old, new))


def test_compiled_code_is_reused_until_a_file_it_is_inlined_from_changes(copied: Path) -> None:
    first, hits = probe(copied)
    assert hits == 0
    assert probe(copied) == (first, 1)

    # `find_support` lives in step.py; the contacts come from another file.
    edit(copied / "physics" / "contacts.py", "EDGE_TOLERANCE = 1e-9", "EDGE_TOLERANCE = 0.11")
    edited, hits = probe(copied)
    assert hits == 0
    assert edited != first

    edit(copied / "physics" / "contacts.py", "EDGE_TOLERANCE = 0.11", "EDGE_TOLERANCE = 1e-9")
    assert probe(copied) == (first, 1)  # which is still in the cache


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    return tmp_path


def hits_of(number: float) -> int:
    """How often a function made anew came from the cache, which is called once."""
    double = compiled(lambda x: 2.0 * x, "double")
    assert double(number) == 2.0 * number
    return sum(double.stats.cache_hits.values())


@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("left", [0, 20])
def test_a_cache_cut_short_is_made_anew(ending: str, left: int, cache: Path) -> None:
    assert hits_of(1.5) == 0
    (file,) = cache.rglob(f"*.{ending}")
    file.write_bytes(file.read_bytes()[:left])
    assert hits_of(1.5) == 0
    assert hits_of(1.5) == 1


@pytest.fixture
def precompiled(
    cache: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> Path:
    """A folder of code for a baseline, here the processor itself; the cache is empty."""
    processor = numba.core.registry.cpu_target.target_context.codegen().magic_tuple()[1]
    monkeypatch.setattr(jit, "find_baseline", lambda: Baseline(processor, ()))
    assert hits_of(1.5) == 0
    folder = tmp_path_factory.mktemp("precompiled")
    monkeypatch.setattr(jit, "PRECOMPILED", folder)
    for file in cache.rglob("double-*"):
        file.rename(folder / file.name)
    return folder


class TestPrecompiled:
    def test_it_is_loaded_and_not_copied(self, precompiled: Path, cache: Path) -> None:
        assert len(list(precompiled.iterdir())) == 2
        assert hits_of(1.5) == 1
        assert not list(cache.rglob("double-*"))

    @pytest.mark.usefixtures("precompiled")
    def test_a_processor_without_the_baseline_compiles(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(jit, "find_baseline", lambda: None)
        assert hits_of(1.5) == 0

    def test_a_damaged_file_is_compiled(self, precompiled: Path) -> None:
        (file,) = precompiled.glob("*.nbc")
        file.write_bytes(file.read_bytes()[:20])
        assert hits_of(1.5) == 0
        assert hits_of(1.5) == 1

    def test_a_baseline_is_one_of_this_machine(self) -> None:
        """Its instructions are those that LLVM finds here."""
        found = find_baseline()
        features = numba.core.codegen.ll.get_host_cpu_features()
        assert found is None or all(features[each] for each in found.features)


@pytest.mark.usefixtures("cache")
def test_what_is_compiled_is_announced_once(capsys: pytest.CaptureFixture[str]) -> None:
    for _ in range(2):
        assert compile_for(compiled(lambda x: 3.0 * x, "triple"), 2.0)(2.0) == 6.0
    assert re.fullmatch(
        r"surface_gym: compiling triple, once \.\.\. \d+ s\n", capsys.readouterr().err
    )


RACE = """
import sys, time
from surface_gym.compiler.jit import compile_for, compiled
slow = compiled(lambda x: 3.0 * x, "slow")
compile = slow._compiler.compile
def compile_slowly(*given):
    time.sleep(0.5)
    return compile(*given)
slow._compiler.compile = compile_slowly
print("ready", flush=True)
function = compile_for(slow, 2.0) if sys.stdin.readline() == "compile\\n" else slow
assert function(2.0) == 6.0
print(sum(slow.stats.cache_hits.values()))
"""


def test_of_processes_that_begin_together_one_compiles(tmp_path: Path) -> None:
    (tmp_path / "race.py").write_text(RACE)
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, str(tmp_path / "race.py")]
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    processes = [subprocess.Popen(command, env=environment, **pipes) for _ in range(3)]
    for each in processes:
        assert each.stdout.readline() == "ready\n"
    for each, order in zip(processes, ["compile", "call", "call"], strict=True):
        each.stdin.write(f"{order}\n")
        each.stdin.flush()
    assert sorted(each.communicate()[0] for each in processes) == ["0\n", "1\n", "1\n"]
    assert not list(tmp_path.rglob("*.lock"))


@pytest.mark.usefixtures("cache")
def test_a_full_disk_is_reported_once_and_nothing_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(IndexDataCacheFile, "save", full)
    with pytest.warns(RuntimeWarning, match=r"not kept.*No space left on device") as warned:
        assert [hits_of(1.5), hits_of(1.5)] == [0, 0]
    assert len(warned) == 1


def test_where_no_folder_can_be_written_it_is_compiled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CompileResultCacheImpl, "_locator_classes", [])
    with pytest.warns(RuntimeWarning, match="not kept: no folder for it can be written"):
        assert hits_of(1.5) == 0


def make_chain() -> tuple[Any, Any, Any]:
    """Two functions that Python calls, and a linked one which both call."""

    @linked
    def halve(x):
        return 0.5 * x

    @inlined
    def halve_sum(x, y):
        return halve(x + y)

    @linked
    def quarter(values, k):
        return halve(halve_sum(values[k], values[k + 1]))

    @kernel_function
    def pick(values, k):
        return values[k]

    @inlined
    def add(values, k):
        return halve_sum(pick(values, k), 0.0) + quarter(values, k)

    def kernel(values, k):
        return add(values, k)

    def other(values, k):
        return -quarter(values, k)

    return compiled(kernel, "kernel"), compiled(other, "other"), quarter


def test_linked_functions_are_read_from_the_cache(cache: Path) -> None:
    values = np.array([1.0, 2.0, 8.0])
    for read in (0, 1):
        kernel, other, quarter = make_chain()
        assert quarter(values, 1) == 2.5
        assert other(values, 1) == -2.5
        assert kernel(values, 1) == 2.5 + 1.0
        assert kernel(values, 0) == 0.75 + 0.5
        assert sum(other.stats.cache_hits.values()) == read
        assert sum(quarter.stats.cache_hits.values()) == read
        if not read:  # `kernel` again, with `quarter` from the cache
            for file in cache.rglob("kernel-*"):
                file.unlink()


KERNELS = """
from collections import namedtuple
from surface_gym.compiler.jit import compiled, inlined, kernel_function, linked

TERMS = namedtuple("Made", "one two")(1.0, 2.0)  # each process makes a class of its own

@linked
def halve(x):
    return 0.5 * x

@inlined
def halve_sum(x, terms):
    return halve(x + terms.one)

@kernel_function
def add(x):
    return halve_sum(x, TERMS) + halve(x)

def kernel(x):
    return FACTOR * add(x)

print(compiled(kernel)(3.0))
print(*(sum(each.stats.cache_hits.values()) for each in (add, halve_sum, halve)))
"""


def test_a_new_process_reads_inlined_functions_for_another_kernel(tmp_path: Path) -> None:
    file = tmp_path / "kernels.py"
    printed = []
    edited = KERNELS.replace("halve_sum(x, TERMS) + halve(x)", "halve(x) + halve_sum(x, TERMS)")
    for factor, source in ((1.0, KERNELS), (2.0, KERNELS), (2.0, edited)):
        file.write_text(f"FACTOR = {factor}\n{source}")
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
        command = [sys.executable, str(file)]
        printed.append(subprocess.check_output(command, env=environment, text=True).split())
    # `halve_sum` and `halve` are part of `add`; they are read on their own if `add` is edited.
    assert printed == [
        ["3.5", "0", "0", "0"],
        ["7.0", "1", "0", "0"],
        ["7.0", "0", "1", "1"],
    ]


@pytest.mark.usefixtures("cache")
def test_reading_beyond_an_array_in_a_linked_chain_is_an_error() -> None:
    for _ in range(2):
        kernel = make_chain()[0]
        with pytest.raises(IndexError):
            kernel(np.array([1.0, 2.0]), 2)


@pytest.mark.parametrize("decorate", [linked, inlined, kernel_function])
def test_from_python_a_linked_function_is_the_python_it_is(decorate: Any) -> None:
    @decorate
    def triple(x, times=3):
        return times * x

    assert triple("ab") == "ababab"
    assert triple(2.0, times=2) == 4.0
    assert compiled(lambda x: triple(x), "triple")(2.0) == 6.0


@pytest.mark.usefixtures("cache")
def test_a_linked_function_is_called_also_where_an_inlined_one_contains_the_call() -> None:
    @linked
    def triple(x):
        return 3.0 * x

    @inlined
    def triple_twice(x):
        return triple(triple(x))

    assert compiled(lambda x: triple_twice(x), "twice")(2.0) == 18.0
    (own,) = (each.library.get_llvm_str() for each in triple.overloads.values())
    (of_caller,) = (each.library.get_llvm_str() for each in triple_twice.overloads.values())
    assert "alwaysinline" in of_caller
    assert "alwaysinline" not in own
    assert re.search(r"^declare .*triple", of_caller, re.MULTILINE)


SOURCE = """
import math
from typing import NamedTuple
from numba import njit

class Pair(NamedTuple):
    first: float
    second: float

FACTOR = 2.0
UNUSED = 1.0

@njit
def inner(x):
    return FACTOR * x

def outer(x, share=0.5):
    "Add three numbers."
    return inner(x) + math.sin(share) + Pair(1.0, x).second

def other(x):
    return x
"""


CLOSURES = """
def make(function):
    @njit
    def made(x):
        return function(x)
    return made

of_inner, of_other = make(inner), make(njit(other))
"""


def digest(source: str, name: str = "outer") -> str:
    names: dict[str, object] = {"__name__": "made"}
    exec(source, names)
    return compute_digest(names[name])


# Each with an edit, and whether it is of what is compiled.
EDITS = {
    "a constant of a callee": ("FACTOR = 2.0", "FACTOR = 3.0", True),
    "a callee": ("return FACTOR * x", "return FACTOR + x", True),
    "how a callee is compiled": ("@njit", "@njit(fastmath=True)", True),
    "a default": ("share=0.5", "share=0.25", True),
    "a function of a library": ("math.sin", "math.cos", True),
    "a field of a tuple": ("first: float", "zeroth: float", True),
    "a constant not used": ("UNUSED = 1.0", "UNUSED = 3.0", False),
    "a function not called": ("    return x\n", "    return -x\n", False),
    "a comment": ("import math", "# why\nimport math", False),
    "a docstring": ("Add three numbers.", "Return a sum.", False),
}


@pytest.mark.parametrize(("old", "new", "noticed"), EDITS.values(), ids=EDITS)
def test_a_digest_notices_an_edit_of_what_is_compiled(old: str, new: str, noticed: bool) -> None:
    assert old in SOURCE
    assert (digest(SOURCE.replace(old, new)) != digest(SOURCE)) is noticed


def test_a_digest_tells_apart_functions_that_close_over_others() -> None:
    source = SOURCE + CLOSURES
    assert digest(source, "of_inner") != digest(source, "of_other")
    assert digest(source, "of_inner") == digest(source, "of_inner")
