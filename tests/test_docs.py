"""The code in README.md and docs/ runs and prints what the page says."""

import contextlib
import io

import pytest

from tests.docs.reading import PAGES, code_blocks

# Pages that need a package, and the extra that has it.
NEEDS = {"docs/flow.md": ("pettingzoo", "multi"), "docs/validation.md": ("mujoco", "validation")}
# Learning takes as few steps as there are.
SHORTER = {"learn(20_000)": "learn(1)", "learn(300_000)": "learn(1)"}
WITH_CODE = [page for page in PAGES if "python" in dict(code_blocks(page))]


@pytest.mark.parametrize("page", WITH_CODE)
def test_the_code_of_a_page_runs(page, tmp_path, monkeypatch):
    if page in NEEDS:
        package, extra = NEEDS[page]
        pytest.importorskip(package, reason=f"{package}, of the extra `{extra}`, is missing")
    monkeypatch.chdir(tmp_path)
    names, printed = {"__name__": "__main__"}, ""
    blocks = code_blocks(page)
    for language, text in blocks:
        for long, short in SHORTER.items():
            text = text.replace(long, short)
        if language == "python":
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(compile(text, page, "exec"), names)
            printed = out.getvalue()
        elif language == "text":
            assert text == printed
