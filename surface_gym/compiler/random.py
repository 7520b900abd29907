"""Random numbers equal to NumPy's: PCG64, and normal numbers by the ziggurat method.

Sources: O'Neill, PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms for
Random Number Generation, 2014; Marsaglia and Tsang, The Ziggurat Method for Generating Random
Variables, 2000, with the 256 layers that NumPy uses.
"""

import math

import numpy as np
from numba.np.random._constants import (
    fi_double as HEIGHT,
    ki_double as WITHIN,
    wi_double as WIDTH,
    ziggurat_nor_inv_r as INVERSE,
    ziggurat_nor_r as EDGE,
)
from numpy.typing import NDArray

from surface_gym.compiler.jit import inlined, linked

Words = NDArray[np.int64]  # (4,) state and increment of a generator, 64 bits each, the higher first

MULTIPLIER_HIGH, MULTIPLIER_LOW = np.uint64(0x2360ED051FC65DA4), np.uint64(0x4385DF649FCCF645)
UNIT = 2.0**-53
HALF, LOW_HALF = np.uint64(32), np.uint64(0xFFFFFFFF)
ONE, LAST, WORD = np.uint64(1), np.uint64(63), np.uint64(64)
LAYER, FAR, SIGN = np.uint64(0xFF), np.uint64(0xFFFFFFFFFFFFF), np.uint64(0x100)
TURN, TO_FAR, TO_UNIT, TO_TAIL = np.uint64(58), np.uint64(9), np.uint64(11), np.uint64(17)


def read_words(generator: np.random.Generator) -> Words:
    """Read the state of a PCG64 generator."""
    state = generator.bit_generator.state["state"]
    words = [part for name in ("state", "inc") for part in divmod(state[name], 2**64)]
    return np.array(words, dtype=np.uint64).view(np.int64)


@inlined
def _multiply_high(a: np.uint64, b: np.uint64) -> np.uint64:
    """Return the higher 64 bits of the product a b, which has 128 bits."""
    a_high, a_low, b_high, b_low = a >> HALF, a & LOW_HALF, b >> HALF, b & LOW_HALF
    middle = a_high * b_low + ((a_low * b_low) >> HALF)
    other = a_low * b_high + (middle & LOW_HALF)
    return a_high * b_high + (middle >> HALF) + (other >> HALF)


@linked
def draw_bits(words: Words) -> np.uint64:
    """Draw 64 random bits, and advance `words`, the state of the generator."""
    high, low = np.uint64(words[0]), np.uint64(words[1])
    more_high, more_low = np.uint64(words[2]), np.uint64(words[3])
    high = high * MULTIPLIER_LOW + low * MULTIPLIER_HIGH + _multiply_high(low, MULTIPLIER_LOW)
    low = low * MULTIPLIER_LOW + more_low
    high += more_high
    if low < more_low:
        high += ONE
    words[0], words[1] = np.int64(high), np.int64(low)
    mixed, turn = high ^ low, high >> TURN
    return (mixed >> turn) | (mixed << ((WORD - turn) & LAST))


@linked
def draw_uniform(words: Words) -> float:
    """Draw a uniform number in [0, 1), and advance `words`, the state of the generator."""
    return np.float64(draw_bits(words) >> TO_UNIT) * UNIT


@linked
def draw_normal(words: Words) -> float:
    """Draw a standard normal number, and advance `words`, the state of the generator."""
    while True:
        bits = draw_bits(words)
        layer, far = np.int64(bits & LAYER), (bits >> TO_FAR) & FAR
        x = np.float64(far) * WIDTH[layer]
        if bits & SIGN != np.uint64(0):
            x = -x
        if far < WITHIN[layer]:
            return x
        if layer == 0:
            return _draw_tail(words, (bits >> TO_TAIL) & ONE != np.uint64(0))
        between = (HEIGHT[layer - 1] - HEIGHT[layer]) * draw_uniform(words) + HEIGHT[layer]
        if between < math.exp(-0.5 * x * x):
            return x


@linked
def _draw_tail(words: Words, negative: bool) -> float:
    """Draw a normal number above EDGE, beyond the last layer. If `negative`, change its sign."""
    while True:
        beyond = -INVERSE * math.log1p(-draw_uniform(words))
        height = -math.log1p(-draw_uniform(words))
        if height + height > beyond * beyond:
            return -(EDGE + beyond) if negative else EDGE + beyond
