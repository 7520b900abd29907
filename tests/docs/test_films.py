"""Films of the documentation are written as they are drawn."""

import numpy as np
import pytest

Image = pytest.importorskip("PIL.Image", reason="pillow, of the extra `agents`, is missing")

from tests.docs.reading import DOCS  # noqa: E402


@pytest.fixture
def encoding(monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    import encoding

    return encoding


def moving_square(pictures: int = 5) -> list[np.ndarray]:
    """White, with a red square that moves to the right."""
    shown = np.full((pictures, 40, 80, 3), 255, dtype=np.uint8)
    for place, picture in enumerate(shown):
        picture[10:30, 10 * place : 10 * place + 20] = (190, 15, 70)
    return list(shown)


def test_a_film_shows_each_picture_in_its_colours(encoding, tmp_path):
    pictures = moving_square()
    encoding.write_film(pictures, 0.04, 80, tmp_path / "film.webp")
    film = Image.open(tmp_path / "film.webp")
    assert (film.n_frames, film.size, film.info["loop"]) == (5, (80, 40), 0)
    for place, picture in enumerate(pictures):
        film.seek(place)
        np.testing.assert_array_equal(np.asarray(film.convert("RGB")), picture)


def test_the_last_picture_stays(encoding, tmp_path):
    encoding.write_film(moving_square(), 0.04, 80, tmp_path / "film.webp")
    film = Image.open(tmp_path / "film.webp")
    shown = []
    for place in range(film.n_frames):
        film.seek(place)
        film.load()
        shown.append(film.info["duration"])
    assert shown == [40, 40, 40, 40, 1040]


def test_a_film_is_the_same_to_the_byte(encoding, tmp_path):
    for name in ("one.webp", "other.webp"):
        encoding.write_film(moving_square(), 0.04, 60, tmp_path / name)
    assert (tmp_path / "one.webp").read_bytes() == (tmp_path / "other.webp").read_bytes()
