"""Noise of a camera for a page, which draws it as NumPy does, from the states of its generator."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from surface_gym.compiler.jit import compiled
from surface_gym.compiler.random import Words, draw_normal, draw_uniform, read_words
from surface_gym.core.batch import BaseBatch
from surface_gym.physics.types import Array
from surface_gym.state import NOISE_ROWS

NORMALS = 3  # of a row of noise; a uniform number follows them
ONLY = np.zeros(1, dtype=np.int64)


class NoiseStart(NamedTuple):
    """States of a seed's generator, which a page goes on from."""

    first: list[str]  # words of the state in hexadecimal digits, before noise is drawn
    then: list[str]  # after all of the start is drawn
    drawn: int  # rows of parcels for which it is drawn


class NotingGenerator(np.random.Generator):
    """A generator that notes its state before it first draws noise, and how often it does."""

    def __init__(self, seed: int) -> None:
        super().__init__(np.random.default_rng(seed).bit_generator)
        self.first: list[str] | None = None
        self.drawn = 0

    def standard_normal(self, size: Any = None, *args: Any, **named: Any) -> Any:
        """Draw normal numbers, as NumPy does."""
        if size == (NOISE_ROWS, 3):
            self.first = self.first or write_state(self)
            self.drawn += 1
        return super().standard_normal(size, *args, **named)


def write_state(generator: np.random.Generator) -> list[str]:
    """Write the words of a PCG64 generator's state in hexadecimal digits."""
    return [f"{word:x}" for word in read_words(generator).view(np.uint64).tolist()]


@compiled
def draw_noise(words: Words, noise: Array) -> int:
    """Draw the noise (rows, NORMALS + 1) that a parcel uses up row by row, as a batch does."""
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
    """Place the start of a seed into a batch of one environment, as `reset(seed=...)` draws it.

    Noise is left out, which takes most of a start's bytes: a page draws it. Return what the page
    needs for that, or None where sensors draw no noise.
    """
    generator = NotingGenerator(seed)
    batch.seed(0, generator)
    batch.place_drawn(ONLY)
    batch.parcels.noise[:] = 0.0
    if generator.first is None:
        return None
    return NoiseStart(generator.first, write_state(generator), generator.drawn)


def describe_noise(batch: BaseBatch, starts: Sequence[NoiseStart | None]) -> dict[str, Any] | None:
    """Describe the noise of each seed's start, and how much of it parcels use, for a page."""
    if not batch.config.draws:
        return None
    return {
        "used": batch.config.draws,  # rows of noise in a control period, at most
        "states": [each._asdict() for each in starts if each is not None],
    }
