"""docs/learners.md says what the examples' own commands kept."""

from typing import Any

import pytest
import yaml

from tests.learners.runs import EXAMPLES

DOCS = EXAMPLES.parents[1] / "docs"
PAGE = (DOCS / "learners.md").read_text()
SORT = ("rllib_sort", "cleanrl_sort", "torchrl_sort", "zoo")


def kept(example: str) -> dict[str, Any]:
    return yaml.safe_load((DOCS / "learners" / f"{example}.yml").read_text())


@pytest.mark.parametrize("example", SORT)
def test_success_is_what_was_kept(example: str) -> None:
    figures = kept(example)["figures"]
    shares = [figures[starts][box] for starts in figures for box in ("S", "B", "both")]
    seconds = kept(example)["seconds"]
    assert f"| {seconds} | " + " | ".join(f"{share:.3f}" for share in shares) + " |" in PAGE


def test_the_flow_is_what_was_kept() -> None:
    run = kept("rllib_flow")
    assert f"{run['figures']['left by their exit']:.3f} of the parcels" in PAGE
    assert f"{run['seconds']} s" in PAGE


@pytest.mark.parametrize("example", [*SORT, "rllib_flow"])
def test_versions_are_those_of_its_requirements_and_of_the_page(example: str) -> None:
    """Where the example has requirements of its own."""
    versions = kept(example)["versions"]
    file = EXAMPLES / f"{example.split('_')[0]}.txt"
    asked = dict(
        line.replace("[rllib]", "").split("==")
        for line in (file.read_text().splitlines() if file.is_file() else [])
        if not line.startswith("#")
    )
    for name in versions.keys() - {"python", "surface_gym"}:
        version = versions[name].split("+")[0]  # without the build
        assert asked.get(name, version) == version
        assert version in PAGE


@pytest.mark.parametrize("file", sorted(EXAMPLES.glob("*.py")), ids=lambda file: file.stem)
def test_an_example_is_short(file: Any) -> None:
    assert len(file.read_text().splitlines()) <= 80
