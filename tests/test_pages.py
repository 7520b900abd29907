"""The pages in docs/ are those the docstrings give."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import pytest

DOCS = Path(__file__).parent.parent / "docs" / "environments"
pages = SimpleNamespace(**runpy.run_path(str(DOCS.with_name("pages.py"))))


@pytest.mark.parametrize("name", pages.pages())
def test_docs_are_up_to_date(name: str) -> None:
    """If not: `python docs/pages.py docs/environments`."""
    assert (DOCS / name).read_text() == pages.pages()[name]


def test_a_page_lists_every_feature_term_and_option() -> None:
    for name, task_class in pages.TASKS.items():
        page = pages.page(name)
        task = task_class()
        for feature in task.features:
            assert f"| {feature.name} |" in page
        for word in (*task.terms, *task.options):
            assert f"`{word}`" in page


def test_the_command_writes_them(tmp_path: Path) -> None:
    pages.main([str(tmp_path / "new")])
    written = {path.name: path.read_text() for path in (tmp_path / "new").iterdir()}
    assert written == pages.pages()
