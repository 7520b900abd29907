"""The pages in docs/ are those the docstrings give."""

import re
import runpy
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import gymnasium as gym
import pytest

from surface_gym import registration
from surface_gym.flow.base import OF_ONE_PARCEL

DOCS = Path(__file__).parent.parent / "docs" / "environments"
pages = SimpleNamespace(**runpy.run_path(str(DOCS.with_name("pages.py"))))


WRITTEN = pages.pages()


@pytest.mark.parametrize("name", WRITTEN)
def test_pages_are_those_the_docstrings_give(name):
    """If not: `python docs/pages.py docs/environments`."""
    assert (DOCS / name).read_text() == WRITTEN[name]


def _arguments(task):
    return [each.name for each in fields(task) if each.init and each.name not in OF_ONE_PARCEL]


def test_a_page_lists_every_feature_term_option_and_argument():
    for name in (*pages.TASKS, *pages.STREAMS):
        task, page, base = registration.TASKS[name], WRITTEN[f"{name}.md"], pages.BASES.get(name)
        assert all(f"`{word}`" in page for word in task().options)
        while base:  # a page leads to the page of the task that it extends
            assert f"{base}.md#" in page
            page += WRITTEN[f"{base}.md"]
            base = pages.BASES.get(base)
        words = [*task.terms, *_arguments(task)] if name in pages.STREAMS else task.terms
        assert all(f"`{word}`" in page for word in words)
        assert all(re.search(rf"[|,] {feature.name}[ ,]", page) for feature in task.features)
        for each in OF_ONE_PARCEL:
            assert f"| `{each}` |" not in page


def test_every_environment_has_a_page():
    assert {*pages.TASKS, *pages.STREAMS} == {*registration.SHIPPED}


@pytest.mark.usefixtures("uncompiled")
@pytest.mark.parametrize("task", [*pages.TASKS, *pages.STREAMS])
def test_a_page_opens_with_its_film_its_spaces_the_import_and_an_example(task):
    top, _, rest = WRITTEN[f"{task}.md"].partition("\n### ")
    env = gym.make(pages.env_id(task))
    shown = ["webp", "| Action space |", f"{env.action_space.nvec.size} numbers of 0 to 3"]
    shown += ["| Observation space |", str(env.observation_space.shape)]
    shown += ["```pycon\n>>> import gymnasium as gym", f'gym.make("{env.spec.id}"']
    places = [top.index(text) for text in shown]
    assert places == sorted(places)
    assert ">>>" not in rest


def test_the_command_writes_them(tmp_path):
    pages.main([str(tmp_path / "new")])
    written = {path.name: path.read_text() for path in (tmp_path / "new").iterdir()}
    assert written == pages.pages()
