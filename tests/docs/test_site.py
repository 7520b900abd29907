"""The site builds without a warning, and asks no other host for anything."""

import os
import re
import shutil
import subprocess
import sys
from importlib.util import find_spec

import pytest

from tests.docs.reading import DOCS, ROOT

pytestmark = pytest.mark.skipif(
    find_spec("zensical") is None, reason="zensical, of the extra `docs`, is missing"
)

# What a page of the site loads by itself; a link that a reader may follow is none.
LOADED = re.compile(
    r'<(?:script|img|link rel="(?:stylesheet|preconnect)")[^>]*(?:src|href)="([^"]+)'
)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The built site; the checkout is left as it is."""
    copy = tmp_path_factory.mktemp("checkout")
    for folder in ("docs", "surface_gym", "agents"):
        shutil.copytree(
            ROOT / folder, copy / folder, ignore=shutil.ignore_patterns("__pycache__", "shipped")
        )
    shutil.copy(ROOT / "mkdocs.yml", copy)
    done = subprocess.run(
        [sys.executable, "-m", "zensical", "build", "--strict"],
        cwd=copy,
        capture_output=True,
        text=True,
        env={**os.environ, "NO_COLOR": "1"},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return copy / "build" / "site"


def test_every_page_is_built(site):
    for page in DOCS.glob("**/*.md"):
        name = page.relative_to(DOCS).with_suffix("")
        folder = name.parent if name.name == "index" else name
        assert (site / folder / "index.html").is_file(), page


def test_no_other_host_is_asked(site):
    for page in site.glob("**/*.html"):
        for loaded in LOADED.findall(page.read_text()):
            assert not loaded.startswith(("http:", "https:", "//")), (page, loaded)


def test_public_names_stand_in_the_reference(site):
    import surface_gym
    from surface_gym import agents, design

    reference = "".join(page.read_text() for page in (site / "api").glob("*/index.html"))
    names = {
        "surface_gym": set(surface_gym.__all__) - {"lines", "sensors", "tasks"},
        "surface_gym.design": design.__all__,
        "agents": agents.__all__,
    }
    for module, public in names.items():
        for name in public:
            assert f'id="{module}.{name}"' in reference, name
