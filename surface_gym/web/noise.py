"""Camera noise for a page, which draws the same numbers as NumPy from a generator's state."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from surface_gym.compiler.jit import compiled
from surface_gym.compiler.random import Words, draw_normal, draw_uniform, read_words
from surface_gym.core.batch import BaseBatch
from surface_gym.physics.types import Array
from surface_gym.state import NOISE_ROWS

NORMALS = 3  # normal numbers per row of noise, followed by a uniform number
ONLY = np.zeros(1, dtype=np.int64)


class NoiseStart(NamedTuple):
    """States of a seed's generator for a page."""

    first: list[str]  # state before drawing noise, as words in hexadecimal digits
    then: list[str]  # state after drawing the start
    drawn: int  # number of parcel rows with noise


class NotingGenerator(np.random.Generator):
    """A generator that records its state before the first noise, and counts draws of noise."""

    def __init__(self, seed: int) -> None:
        super().__init__(np.random.default_rng(seed).bit_generator)
        self.first: list[str] | None = None
        self.drawn = 0

    def standard_normal(self, size: Any = None, *args: Any, **named: Any) -> Any:
        """Draw normal numbers like NumPy."""
        if size == (NOISE_ROWS, 3):
            self.first = self.first or write_state(self)
            self.drawn += 1
        return super().standard_normal(size, *args, **named)


def write_state(generator: np.random.Generator) -> list[str]:
    """Return the words of a PCG64 generator's state in hexadecimal digits."""
    return [f"{word:x}" for word in read_words(generator).view(np.uint64).tolist()]


@compiled
def draw_noise(words: Words, noise: Array) -> int:
    """Draw the noise (rows, NORMALS + 1) of a parcel, like a batch."""
    for row in range(noise.shape[0]):
        for k in range(NORMALS):
            noise[row, k] = draw_normal(words)
    for row in range(noise.shape[0]):
        noise[row, NORMALS] = draw_uniform(words)
    return 0


def noise_arguments() -> tuple[Any, ...]:
    """Make arguments of `draw_noise`."""
    return np.zeros(4, dtype=np.int64), np.zeros((NOISE_ROWS, NORMALS + 1))


def place(batch: BaseBatch, seed: int) -> NoiseStart | None:
    """Place the start of `reset(seed=...)` into a batch of one environment, without noise.

    Noise would take most of a start's bytes, so the page draws the noise. The function returns the
    generator's states from which the page draws it, or None if sensors draw no noise.
    """
    generator = NotingGenerator(seed)
    batch.seed(0, generator)
    batch.place_drawn(ONLY)
    batch.parcels.noise[:] = 0.0
    if generator.first is None:
        return None
    return NoiseStart(generator.first, write_state(generator), generator.drawn)


def describe_noise(batch: BaseBatch, starts: Sequence[NoiseStart | None]) -> dict[str, Any] | None:
    """Describe the noise of each seed's start for a page, with the rows used per period."""
    if not batch.config.draws:
        return None
    return {
        "used": batch.config.draws,  # maximum rows of noise per control period
        "states": [each._asdict() for each in starts if each is not None],
    }
