"""The site: its reference shows examples and fields, it builds without a warning
and asks no other host for anything.
"""

import html
import os
import re
import shutil
import subprocess
import sys
import textwrap

import pytest

import surface_gym
from surface_gym import agents, design
from tests.docs.reading import DOCS, ROOT

# What a page of the site loads by itself; a link that a reader may follow is none.
LOADED = re.compile(
    r'<(?:script|img|link rel="(?:stylesheet|preconnect)")[^>]*(?:src|href)="([^"]+)'
)
REPOSITORY = "https://repository.example/surface"
SIGNATURE = re.compile(r'<div class="doc-signature highlight">(.*?)</div>', re.DOTALL)
SOURCE = '''
    """A parcel on its way."""

    from dataclasses import dataclass


    @dataclass(frozen=True)
    class Parcel:
        """A parcel.

        >>> Parcel(1.0)
        Parcel(mass=1.0)

        It has a mass.
        """

        mass: float  # [kg] of all of it
        # [m] from the middle,
        # in x and in y
        offset: tuple[float, float] = (0.0, 0.0)
        name: str = ""
'''


def needed(module: str):
    return pytest.importorskip(module, reason=f"{module}, of the extra `docs`, is missing")


def test_an_example_is_fenced_and_fields_are_listed_with_their_comments(tmp_path):
    griffe = needed("griffe")
    (tmp_path / "goods.py").write_text(textwrap.dedent(SOURCE))
    extensions = griffe.load_extensions(str(DOCS / "docstrings.py"))
    parcel = griffe.load("goods", search_paths=[tmp_path], extensions=extensions)["Parcel"]
    text = parcel.docstring.value
    assert "```pycon\n>>> Parcel(1.0)\nParcel(mass=1.0)\n```\n\nIt has a mass." in text
    *_, listed = parcel.docstring.parse("google")
    assert {field.name: field.description for field in listed.value} == {
        "mass": "[kg] of all of it",
        "offset": "[m] from the middle, in x and in y",
    }


def test_a_page_that_asks_for_a_replay_gets_it():
    """The recordings are made by `python docs/replays.py`."""
    markdown = needed("markdown")
    from docs.replays import ASKED, FOLDER, RECORDINGS, makeExtension

    assert {file.stem for file in FOLDER.iterdir()} == {*RECORDINGS}
    text = (DOCS / "replay.md").read_text()
    shown = markdown.markdown(text, extensions=[makeExtension()])
    assert shown.count("srcdoc=") == 3
    assert not ASKED.search(shown)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site; the checkout is left as it is."""
    needed("zensical")
    needed("latex2mathml")
    copy = tmp_path_factory.mktemp("checkout")
    ignored = shutil.ignore_patterns("__pycache__", "shipped")
    for folder in ("docs", "surface_gym", "agents", "examples"):
        shutil.copytree(ROOT / folder, copy / folder, ignore=ignored)
    shutil.copy(ROOT / "mkdocs.yml", copy)
    build = [sys.executable, "-m", "zensical", "build", "--strict"]
    quiet = {**os.environ, "NO_COLOR": "1", "REPOSITORY_URL": REPOSITORY}
    done = subprocess.run(build, cwd=copy, capture_output=True, text=True, env=quiet)
    assert done.returncode == 0, done.stdout + done.stderr
    return copy / "build" / "site"


class TestSite:
    def test_every_page_is_built(self, site):
        for page in set(DOCS.glob("**/*.md")) - set(DOCS.glob("joss/*")):
            name = page.relative_to(DOCS).with_suffix("")
            folder = name.parent if name.name == "index" else name
            assert (site / folder / "index.html").is_file(), page

    def test_no_other_host_is_asked(self, site):
        for page in site.glob("**/*.html"):
            for loaded in LOADED.findall(page.read_text()):
                assert not loaded.startswith(("http:", "https:", "//")), (page, loaded)

    def test_the_first_page_has_the_film_where_the_two_lines_come(self, site):
        text = (site / "index.html").read_text()
        assert re.search(r'<div id="live">\s*<p><img [^>]*src="images/start.webp"', text)
        assert '<script type="module" src="assets/live.js">' in text
        assert (site / "assets" / "live.js").is_file()

    def test_formulas_are_mathml_that_needs_no_script(self, site):
        text = (site / "physics" / "index.html").read_text()
        written = (DOCS / "physics.md").read_text()
        assert text.count("<math") == len(re.findall(r"(\$\$?).+?\1", written, re.DOTALL))
        for left in ("arithmatex", "$", "\\(", "\\["):
            assert left not in re.sub(r"<(script|code).*?</\1>", "", text, flags=re.DOTALL), left
        for formula in re.findall(r"<math.*?</math>", text):  # all of LaTeX was understood
            assert "\\" not in formula
            assert "&<" not in formula

    def test_helper_scripts_are_not_published(self, site):
        published = {file.suffix for file in site.rglob("*") if file.is_file()}
        assert not published & {".py", ".pyc", ".yml"}

    def test_signatures_are_wrapped_and_the_environment_is_described(self, site):
        for page in (site / "api").glob("*/index.html"):
            for code in SIGNATURE.findall(page.read_text()):
                lines = html.unescape(re.sub(r"<[^>]+>", "", code)).splitlines()
                assert max(map(len, lines)) <= 88, (page, lines)
        text = (site / "api" / "environments" / "index.html").read_text()
        for name in ("SmartSurfaceEnv", "SmartSurfaceEnv.reset", "SmartSurfaceEnv.step"):
            described = text.partition(f'id="surface_gym.{name}"')[2].partition("<h")[0]
            assert re.search(r"<p>[A-Z][^<]{30}", described), name

    def test_each_page_leads_to_the_repository_and_asks_it_for_nothing(self, site):
        for page in site.glob("**/index.html"):
            text = page.read_text()
            assert f'<a href="{REPOSITORY}" title="Repository"' in text, page
            assert 'data-md-component="source"' not in text, page

    def test_public_names_stand_in_the_reference(self, site):
        reference = "".join(page.read_text() for page in (site / "api").glob("*/index.html"))
        names = {
            "surface_gym": set(surface_gym.__all__) - {"lines", "sensors", "tasks"},
            "surface_gym.design": design.__all__,
            "agents": agents.__all__,
        }
        for module, public in names.items():
            for name in public:
                assert f'id="{module}.{name}"' in reference, name
