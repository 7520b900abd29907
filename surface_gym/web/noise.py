"""Noise of a camera for a page, which draws it as NumPy does.

A page gets the states of NumPy's generator, and the tables of its ziggurat method.
"""

import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numba.np.random import _constants

from surface_gym.core.batch import BaseBatch
from surface_gym.state import NOISE_ROWS

TABLES = "ziggurat.json"  # which a page loads when a camera is chosen
ONLY = np.zeros(1, dtype=np.int64)


class NoiseStart(NamedTuple):
    """States of a seed's generator, which a page goes on from."""

    first: list[str]  # state and increment in hexadecimal digits, before noise is drawn
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
            self.first = self.first or read_state(self)
            self.drawn += 1
        return super().standard_normal(size, *args, **named)


def read_state(generator: np.random.Generator) -> list[str]:
    """Read the state of a PCG64 generator, and its increment, in hexadecimal digits."""
    state = generator.bit_generator.state["state"]
    return [f"{state[name]:x}" for name in ("state", "inc")]


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
    return NoiseStart(generator.first, read_state(generator), generator.drawn)


def describe_noise(batch: BaseBatch, starts: Sequence[NoiseStart | None]) -> dict[str, Any] | None:
    """Describe the noise of each seed's start, and how much of it parcels use, for a page."""
    if not batch.config.draws:
        return None
    return {
        "used": batch.config.draws,  # rows of noise in a control period, at most
        "states": [each._asdict() for each in starts if each is not None],
    }


def make_tables() -> str:
    """Write the tables of the ziggurat method for normal numbers as JSON.

    Source: Marsaglia and Tsang (2000), with the 256 layers that NumPy uses.
    """
    tables = {
        "within": [int(each) for each in _constants.ki_double],
        "width": [float(each) for each in _constants.wi_double],
        "height": [float(each) for each in _constants.fi_double],
        "edge": float(_constants.ziggurat_nor_r),
        "inverse": float(_constants.ziggurat_nor_inv_r),
    }
    return json.dumps(tables, separators=(",", ":")) + "\n"
