"""Sine, cosine, length and random numbers of modules: the C library's and NumPy's to the bit."""

import ctypes
import math

import llvmlite.binding as llvm
import numpy as np

from surface_gym.compiler import exact, random
from surface_gym.compiler.jit import compiled

MANY = 1_000_000


@compiled
def compute(x, y, found):
    for k in range(x.shape[0]):
        found[0, k], found[1, k], found[2, k] = (
            exact.sin(x[k]), exact.cos(x[k]), exact.hypot(x[k], y[k])
        )  # fmt: skip


@compiled
def draw(words, found):
    for k in range(found.shape[0]):
        found[k] = random.draw_normal(words)
    return random.draw_uniform(words)


def test_sine_cosine_and_length_are_those_of_the_c_library():
    rng = np.random.default_rng(0)
    special = [0.0, -0.0, 1e-320, 1e-9, 1e-300, 1e150, 1e300, -1.7e308]
    special += [math.inf, -math.inf, math.nan]
    x = np.concatenate([
        rng.uniform(-7.0, 7.0, MANY // 2), rng.normal(size=MANY // 4) * 1e-3,
        rng.uniform(-1e6, 1e6, MANY // 4), special, special[::-1],
    ])  # fmt: skip
    y = np.roll(x, 7)
    found = np.empty((3, len(x)))
    compute(x, y, found)
    kind = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double, ctypes.c_double)
    hypot = kind(llvm.address_of_symbol("hypot"))
    lengths = [hypot(*each) for each in zip(x.tolist(), y.tolist(), strict=True)]
    np.testing.assert_array_equal(found[2], lengths)
    known = np.abs(x) < exact.MOST
    for row, function in zip(found, (math.sin, math.cos), strict=False):
        expected = np.array([function(each) for each in x[known].tolist()])
        np.testing.assert_array_equal(row[known].view(np.int64), expected.view(np.int64))
        beyond = row[np.isfinite(x) & ~known]
        assert (np.abs(beyond) <= 1.0).all()
        assert np.isnan(row[~np.isfinite(x)]).all()


def test_random_numbers_are_those_that_numpy_draws():
    generator = np.random.default_rng(7)
    words, found = random.read_words(generator), np.empty(MANY)
    uniform = draw(words, found)
    np.testing.assert_array_equal(found, generator.standard_normal(MANY))
    assert uniform == generator.random()
    np.testing.assert_array_equal(words, random.read_words(generator))
    assert np.abs(found).max() > random.EDGE
