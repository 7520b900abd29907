"""Which tests go first, which are enough for a first look, and which only run at night."""

import re
from collections.abc import Iterable
from pathlib import Path

import pytest

# By the beginning of their names: those that compile most, then those that take longest. Whoever
# comes later finds the code compiled, and short tests at the end leave no processor waiting.
FIRST = (
    # Each of these three compiles what others need, which wait for it if they begin beside it.
    "tests/flow/test_env.py::TestEpisodes",
    "tests/test_vector_env.py::TestBesideSingles",
    "tests/test_axes.py",
    "tests/flow/test_env.py",
    "tests/test_env.py",
    "tests/agents/rules/",
    "tests/test_own.py",
    "tests/agents/test_programs.py",
    "tests/parallel/",
    "tests/agents/learning/",
    "tests/agents/evaluation/",
    "tests/docs/test_site.py",
    "tests/cuda/test_kernels.py",
    "tests/web/test_tasks.py",
    "tests/test_play.py",
    "tests/web/test_home.py",
    "tests/agents/runtime/test_simulator.py",
    "tests/learners/",
    "tests/agents/test_tuning.py",
    "tests/agents/planning/",
    # Pages need the modules of those above, which are then there.
    "tests/web/test_playground.py",
    "tests/web/test_agents.py",
    "tests/paper/",
    "tests/test_docs.py",
    "tests/test_wheel.py",
)

# Folders whose tests share a fixture that takes long: one process runs them.
TOGETHER = ("tests/paper/",)

# Of each part those that fail first when it breaks, and one environment of each class.
SMOKE = (
    "tests/agents/learning/test_config.py",
    "tests/agents/test_policy.py",
    "tests/agents/rules/test_layouts.py::test_they_sort",
    "tests/design/test_fixed_layout.py::test_it_finds_the_least",
    "tests/physics/test_friction.py",
    "tests/physics/test_signed_distance.py",
    "tests/physics/test_step.py",
    "tests/flow/test_env.py::TestEpisodes::test_action_spaces",
    "tests/flow/test_exits.py",
    "tests/flow/test_stream.py",
    "tests/tasks/test_sort.py::TestEnds::test_by_choice",
    "tests/test_parcel.py",
    "tests/test_config.py::test_",
    "tests/test_simulation.py",
    "tests/test_surface.py",
    "tests/test_vector_env.py::TestBesideSingles::test_also_over_whole_episodes",
)

COLLECTED = pytest.StashKey[list[str]]()  # names of all tests, those left out too

# Beginnings of the names of tests that only run at night, with * for any text.
NIGHTLY = tuple(
    line
    for line in (Path(__file__).parent / "nightly.txt").read_text().splitlines()
    if line and not line.startswith("#")
)


def _pattern(lines: Iterable[str]) -> re.Pattern[str]:
    return re.compile("|".join(re.escape(line).replace(r"\*", ".*") for line in lines))


_NIGHTLY = _pattern(NIGHTLY)


def is_nightly(name: str) -> bool:
    """Return whether a line of nightly.txt fits the beginning of a test's name."""
    return _NIGHTLY.match(name) is not None


def unused_lines(names: Iterable[str]) -> list[str]:
    """Return the lines of nightly.txt that fit no test in their files.

    A file without any test counts as one whose libraries are not installed.
    """
    of_files: dict[str, list[str]] = {}
    for name in names:
        of_files.setdefault(name.partition("::")[0], []).append(name)
    return [
        line
        for line in NIGHTLY
        if (found := of_files.get(line.partition("::")[0]))
        and not any(map(_pattern([line]).match, found))
    ]


def place_of(name: str) -> int:
    """Place of a test in the order, by its name; those not in FIRST share the last."""
    found = (k for k, beginning in enumerate(FIRST) if name.startswith(beginning))
    return next(found, len(FIRST))
