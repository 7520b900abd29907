"""Encoding of pictures into files for pages: small, sharp and the same to the byte each time."""

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import KDTree

from surface_gym.files import replacing

Picture = NDArray[np.uint8]  # (height, width, 3)

# Colours of a film: the drawings are flat, and few take little room.
INKS = 96  # that most pixels are drawn with
MIXED = 64  # between these, where edges are smoothed
SAMPLES = 36  # pictures of a film that its colours are chosen from
LEAST = 4  # pixels of a colour for it to count
RARE = 0.3  # [-] power of its number of pixels that it counts with
WEIGHTS = np.array([1 << 16, 1 << 8, 1])  # of red, green and blue in a colour's number
REST = 1.0  # [s] for which the last picture stays before a film begins anew


def write_film(
    pictures: Sequence[Picture],
    seconds: float,
    width: int,
    file: Path,
    inks: Sequence[Sequence[int]] = (),
) -> None:
    """Write an animated WebP, lossless in its few colours, that repeats.

    Args:
        pictures: at equal intervals, all of one shape.
        seconds: [s] each is shown.
        width: [px] of the film.
        file: to write.
        inks: colours (red, green, blue) that are kept, however little is drawn with them.
    """
    small = [_narrowed(picture, width) for picture in pictures]
    every = max(1, len(small) // SAMPLES)
    palette = _palette(pictures[::every], small[::every])
    palette = np.concatenate([np.array(inks, dtype=np.uint8).reshape(-1, 3), palette])
    frames = [Image.fromarray(_in_colours(picture, palette)) for picture in small]
    shown = [round(1000.0 * seconds)] * len(frames)
    shown[-1] += round(1000.0 * REST)
    written = io.BytesIO()
    frames[0].save(
        written,
        "WEBP",
        save_all=True,
        append_images=frames[1:],
        duration=shown,
        loop=0,
        lossless=True,
        quality=80,
        method=4,
    )
    with replacing(file) as part:
        part.write_bytes(written.getvalue())


def write_still(picture: Picture, file: Path) -> None:
    """Write a PNG.

    Args:
        picture: to write.
        file: that it is written to.
    """
    written = io.BytesIO()
    Image.fromarray(picture).save(written, "PNG", optimize=True)
    with replacing(file) as part:
        part.write_bytes(written.getvalue())


def _palette(pictures: Sequence[Picture], small: Sequence[Picture]) -> Picture:
    """Choose colours (colours, 3): the inks of pictures, and the mixtures that small ones need."""
    inks, counts = _colours(pictures)
    first = inks[np.argsort(-counts, kind="stable")[:INKS]]
    mixed, counts = _colours(small)
    weights = np.ceil(counts**RARE).astype(np.int64)
    between = Image.fromarray(np.repeat(mixed, weights, axis=0)[np.newaxis]).quantize(MIXED)
    others = np.array(between.getpalette(), dtype=np.uint8).reshape(-1, 3)
    return np.concatenate([first, others[:MIXED]])


def _colours(pictures: Sequence[Picture]) -> tuple[Picture, NDArray[np.int64]]:
    """Count the pixels of each colour (colours, 3); rare colours are left out."""
    numbers, counts = np.unique(
        np.concatenate([_encoded(picture).ravel() for picture in pictures]), return_counts=True
    )
    return _decoded(numbers[counts >= LEAST]), counts[counts >= LEAST]


def _in_colours(picture: Picture, palette: Picture) -> Picture:
    """Replace every pixel of a picture by the nearest colour of a palette."""
    numbers, places = np.unique(_encoded(picture), return_inverse=True)
    _, nearest = KDTree(palette).query(_decoded(numbers))
    return palette[nearest][places.reshape(picture.shape[:2])]


def _encoded(colours: Picture) -> NDArray[np.int64]:
    """Encode colours (..., 3) as numbers (...)."""
    return colours @ WEIGHTS


def _decoded(numbers: NDArray[np.int64]) -> Picture:
    """Decode numbers (colours,) to colours (colours, 3)."""
    return (numbers[:, np.newaxis] // WEIGHTS % 256).astype(np.uint8)


def _narrowed(picture: Picture, width: int) -> Picture:
    image = Image.fromarray(picture)
    height = round(image.height * width / image.width)
    return np.asarray(image.resize((width, height), Image.Resampling.LANCZOS))
