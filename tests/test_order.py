"""The order of the tests names tests that are there."""

from pathlib import Path

import pytest

from tests.order import FIRST, NIGHTLY, SMOKE, place_of

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("name", [*FIRST, *NIGHTLY, *SMOKE])
def test_what_is_named_is_there(name: str) -> None:
    file, *inside = name.split("::")
    assert (ROOT / file).exists()
    if inside:
        assert f" {inside[-1].partition('[')[0]}" in (ROOT / file).read_text()


def test_those_not_named_come_last() -> None:
    assert place_of(f"{FIRST[1]}::TestSeeds") == 1
    assert place_of("tests/test_surface.py::test_it") == len(FIRST)
