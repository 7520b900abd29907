"""The code in README.md and docs/ runs, and prints what the page says."""

import contextlib
import io
from dataclasses import fields
from pathlib import Path

import pytest

from surface_gym import pages
from surface_gym.flow.task import FEATURES, TERMS, Flow
from tests.docs.reading import PAGES, code_blocks

# Pages that need a package, and the extra that has it.
NEEDS = {"docs/flow.md": ("pettingzoo", "multi"), "docs/validation.md": ("mujoco", "validation")}
WITH_CODE = [page for page in PAGES if "python" in dict(code_blocks(page))]


@pytest.mark.parametrize("page", WITH_CODE)
def test_the_code_of_a_page_runs(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One block after the other; a text block shows what the code before it prints."""
    if page in NEEDS:
        package, extra = NEEDS[page]
        pytest.importorskip(package, reason=f"{package}, of the extra `{extra}`, is missing")
    monkeypatch.chdir(tmp_path)
    names, printed = {"__name__": "__main__"}, ""
    blocks = code_blocks(page)
    for language, text in blocks:
        if language == "python":
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(compile(text, page, "exec"), names)
            printed = out.getvalue()
        elif language == "text":
            assert text == printed


def test_the_page_of_a_flow_lists_every_feature_term_and_argument() -> None:
    page = pages.flow_page()
    for feature in FEATURES:
        assert f"| {feature.name} |" in page
    for word in (*TERMS, *(field.name for field in fields(Flow) if field.init)):
        assert f"| `{word}` |" in page
