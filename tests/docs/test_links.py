"""Links of pages lead somewhere; pictures and films are made by the commands that make them."""

import re
import sys
from pathlib import Path
from pkgutil import resolve_name

import numpy as np
import pytest

from surface_gym.registry import GROUP
from tests.docs.reading import DOCS, PAGES, ROOT, prose

LINK = re.compile(r"\]\(([^()\s]+)\)")
ELSEWHERE = ("https://", "http://", "mailto:")
VIDEO = 400_000  # [bytes] at most
DOTTED = re.compile(r"\bsurface_gym(?:\.[A-Za-z_]\w*)+")
FILE = re.compile(r"`((?:surface_gym|agents|tests|examples|benchmarks|docs)/[\w./*-]+)`")
NAMED = re.compile(r"images/([\w-]+\.\w+)")


@pytest.fixture
def pictures(monkeypatch):
    """Functions of `docs/pictures.py` that make a picture, by its name."""
    monkeypatch.syspath_prepend(DOCS)
    monkeypatch.delitem(sys.modules, "pictures", raising=False)
    import pictures

    return pictures.PICTURES


def last_duration(film: Path) -> int:
    """Return for how many milliseconds the last picture of a film stays."""
    image = pytest.importorskip("PIL.Image", reason="pillow, of the extra `agents`, is missing")
    with image.open(film) as pictures:
        pictures.seek(pictures.n_frames - 1)
        pictures.load()
        return int(pictures.info["duration"])


def find_anchors(page: Path) -> set[str]:
    """Return the anchors of a page's headings, as Markdown makes them."""
    headings = re.findall(r"^#+ (.+)$", page.read_text(), re.MULTILINE)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower() for heading in headings]
    return {re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", heading).strip()) for heading in plain}


@pytest.mark.parametrize("page", PAGES)
def test_each_link_leads_somewhere_and_each_name_of_the_package_exists(page):
    for link in LINK.findall(prose(page)):
        if link.startswith(ELSEWHERE):
            continue
        path, _, anchor = link.partition("#")
        target = (ROOT / page).parent / path if path else ROOT / page
        assert target.exists(), link
        if anchor and target.suffix == ".md":
            assert anchor in find_anchors(target), link
    for name in DOTTED.findall((ROOT / page).read_text()):
        assert name == GROUP or resolve_name(name) is not None  # a group of entry points


@pytest.mark.parametrize("page", [*PAGES, "CONTRIBUTING.md"])
def test_each_file_that_is_named_exists(page):
    for path in FILE.findall((ROOT / page).read_text()):
        assert "NAME" in path or any(ROOT.glob(path)), path


def test_the_authors_of_the_surface_are_credited_wherever_it_is_cited():
    sources = ("CITATION.cff", "docs/citing.md", "agents/rules/local.py")
    for page in sources:
        text = " ".join((ROOT / page).read_text().replace("\n> ", " ").split())
        assert "Closed-Loop Control Strategies for a Modular Under-Actuated" in text, page
        assert "7628" in text, page
        if page != "agents/rules/local.py":
            assert "novel underactuated smart surface" in text, page
    for page in ("README.md", "docs/index.md"):
        text = (ROOT / page).read_text()
        assert "Bianchi" in text, page
        assert "citing.md#whose-surface-it-is" in text, page
    for page in PAGES:
        assert "vector_kwargs" not in (ROOT / page).read_text(), page


def test_the_words_of_the_domain_are_explained_on_the_first_page():
    """Behind its film; README and the gallery point there."""
    before, _, after = (DOCS / "index.md").read_text().partition("## Ten words\n")
    assert "images/start.webp" in before
    words = re.findall(r"^\| (.+?) \| .+ \|$", after, re.MULTILINE)
    assert len(words) == 1 + 10
    for word in ("zone", "lead-in", "S-box", "study"):
        assert sum(word in listed for listed in words) == 1
    for page in ("README.md", "docs/environments/index.md"):
        assert "index.md#ten-words" in (ROOT / page).read_text()


def test_every_picture_is_made_by_the_command_shown_small_and_in_its_help(pictures, capsys):
    """`python docs/pictures.py` makes what there is, and nothing else."""
    assert {file.name for file in (DOCS / "images").iterdir()} == set(pictures)
    shown = {name for page in PAGES for name in NAMED.findall((ROOT / page).read_text())}
    assert shown >= set(pictures)
    videos = list((DOCS / "images").glob("*.webp"))
    assert len(videos) == 11
    for video in videos:
        assert video.stat().st_size <= VIDEO, video.name
        assert last_duration(video) >= 1000, video.name
    from pictures import main

    with pytest.raises(SystemExit):
        main(["--only", "nothing.png"])
    assert "invalid choice: 'nothing.png'" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["--help"])
    help_text = "".join(capsys.readouterr().out.split())  # lines may break at a hyphen
    for name in pictures:
        assert name in help_text


@pytest.mark.parametrize("name", ["sort.png", "checkered.png", "alignment.png"])
def test_a_picture_is_made_the_same_again(name, pictures, tmp_path):
    pictures[name](tmp_path / name)
    same = (tmp_path / name).read_bytes() == (DOCS / "images" / name).read_bytes()
    assert same, f"python docs/pictures.py --only {name}"  # pytest would compare the bytes for long


def test_a_film_of_an_episode_is_cropped_to_what_moves(monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    from pictures import _cropped, _moving_area

    from surface_gym.rendering import Scene, SceneParcel

    outline = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]])
    axis = np.arange(600.0).reshape(20, 30)
    scenes = [
        Scene(axis, axis > 0.0, (SceneParcel(outline, (x, y, 0.0)),), zone=(9, 2, 3, 10))
        for x, y in ((0.15, 1.02), (1.55, 1.29))
    ]
    rows, columns = _moving_area(scenes)
    assert (rows, columns) == (slice(8, 15), slice(0, 18))
    scene = _cropped(scenes[1], rows, columns)
    np.testing.assert_array_equal(scene.axis, axis[8:15, :18])
    assert scene.zone == (1, 2, 3, 10)
    assert scene.origin == pytest.approx((0.05, 0.85))


def test_a_film_shows_each_picture_in_its_colours_and_the_last_stays(tmp_path, monkeypatch):
    image = pytest.importorskip("PIL.Image", reason="pillow, of the extra `agents`, is missing")
    monkeypatch.syspath_prepend(DOCS)
    from encoding import write_film

    pictures = np.full((5, 40, 80, 3), 255, dtype=np.uint8)
    for place, picture in enumerate(pictures):  # a red square that moves to the right
        picture[10:30, 10 * place : 10 * place + 20] = (190, 15, 70)
    for name, width in (("film", 80), ("narrow", 60), ("same", 60)):
        write_film(list(pictures), 0.04, width, tmp_path / f"{name}.webp")
    assert (tmp_path / "narrow.webp").read_bytes() == (tmp_path / "same.webp").read_bytes()
    film = image.open(tmp_path / "film.webp")
    assert (film.n_frames, film.size, film.info["loop"]) == (5, (80, 40), 0)
    for place, picture in enumerate(pictures):
        film.seek(place)
        np.testing.assert_array_equal(np.asarray(film.convert("RGB")), picture)
        assert film.info["duration"] == (40 if place < 4 else 1040)
