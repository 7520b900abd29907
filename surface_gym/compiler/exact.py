"""Sine, cosine and vector length, equal to the GNU C library to the bit.

WebAssembly lacks these functions, and browsers' versions differ in the last bit for one argument in
thirty. The functions here repeat the steps of the C library for processors with fused multiply-add
(IBM Accurate Mathematical Library, 2001). They use a table of sines and cosines for every 1/128
rad, and short series between its entries. Exact sums and products by Dekker (1971) replace fused
multiply-add.
"""

import math
from decimal import Decimal, localcontext

import numpy as np

from surface_gym.compiler.jit import inlined, linked

SPLITTER = 134217729.0  # 2^27 + 1
MOST = 1e8  # [rad] larger arguments differ from the C library in the last bits
BIG = 52776558133248.0  # 1.5 2^45: adding it rounds to multiples of 1/128
ROUND = 6755399441055744.0  # 1.5 2^52: adding it rounds to whole numbers
PER_QUARTER = 0.6366197723675814  # 2 / pi
HALF_PI, HALF_PI_LOW = 1.5707963267948966, 6.123233995736766e-17
# Half of pi in parts, whose products with whole numbers are exact.
PARTS = (
    1.5707963407039642, -1.3909067564377153e-8, -4.97899623147991e-17, -1.9034889620193266e-25,
)  # fmt: skip
# Series of sine near 0, and of sine and cosine between the table's.
SMALL = (
    -0.16666666666666666, 0.008333333333332329, -0.00019841269834414642, 2.7557298068607706e-6,
    -2.5022014848318398e-8,
)  # fmt: skip
SINE_3, SINE_5 = -0.16666666666666488, 0.008333332142857223
COSINE_2, COSINE_4, COSINE_6 = 0.5, -0.04166666666666644, 0.001388888740079376
ANGLES = 112  # entries of the table, 1/128 rad apart


def _make_table() -> np.ndarray:
    """Compute a table (ANGLES, 4): sine, sine's rounding error, cosine, cosine's rounding error."""
    table = np.zeros((ANGLES, 4))
    with localcontext() as context:
        context.prec = 50
        for k in range(ANGLES):
            x, series = Decimal(k) / 128, [Decimal(0), Decimal(0)]
            term = Decimal(1)
            for n in range(40):  # 1, x, x^2 / 2 ...
                series[1 - n % 2] += term if n % 4 < 2 else -term
                term *= x / (n + 1)
            for place, value in enumerate(series):
                table[k, 2 * place] = float(value)
                table[k, 2 * place + 1] = float(value - Decimal(float(value)))
    return table


TABLE = _make_table()


@inlined
def _add(a: float, b: float) -> tuple[float, float]:
    """Return the rounded sum a + b, and the rounding error. These two numbers add up to a + b."""
    high = a + b
    part = high - a
    return high, a - (high - part) + (b - part)


@inlined
def _multiply(a: float, b: float) -> tuple[float, float]:
    """Return the rounded product a * b and the rounding error. The two numbers add up to a * b."""
    high = a * b
    big_a, big_b = SPLITTER * a, SPLITTER * b
    a_high, b_high = big_a - (big_a - a), big_b - (big_b - b)
    a_low, b_low = a - a_high, b - b_high
    return high, a_low * b_low - (high - a_high * b_high - a_low * b_high - a_high * b_low)


@inlined
def _fuse(a: float, b: float, c: float) -> float:
    """Compute a * b + c, rounded only once."""
    high, low = _multiply(a, b)
    added, rest = _add(high, c)
    return added + (rest + low)


# Below, products and sums are fused only if it matters in more than 1 of 10^8 cases.


@linked
def _small_cosine(x: float, dx: float) -> float:
    """Compute the cosine of a small angle x + dx [rad]; dx is the rounding error of x."""
    up = BIG + abs(x)
    rest = abs(x) - (up - BIG) + (-dx if x < 0.0 else dx)
    k = int(128.0 * (up - BIG))
    square = rest * rest
    s = _fuse(rest * square, SINE_3 + square * SINE_5, rest)
    c = square * (COSINE_2 + square * (COSINE_4 + square * COSINE_6))
    more = TABLE[k, 3] - s * TABLE[k, 1]
    return TABLE[k, 2] + _fuse(-TABLE[k, 0], s, _fuse(-TABLE[k, 2], c, more))


@linked
def _small_sine(x: float, dx: float) -> float:
    """Compute the sine of a small angle x + dx [rad]; dx is the rounding error of x."""
    if abs(x) < 0.126:
        square = x * x
        rest = SMALL[1] + square * (SMALL[2] + square * (SMALL[3] + square * SMALL[4]))
        series = _fuse(rest, square, SMALL[0])
        if dx == 0.0:
            return x + series * x * square
        return x + _fuse(_fuse(series, x, -0.5 * dx), square, dx)
    up = BIG + abs(x)
    rest = abs(x) - (up - BIG)
    off = -dx if x <= 0.0 else dx
    k = int(128.0 * (up - BIG))
    square = rest * rest
    s = rest + _fuse(rest * square, SINE_3 + square * SINE_5, off)
    c = rest * off + square * (COSINE_2 + square * (COSINE_4 + square * COSINE_6))
    more = TABLE[k, 1] + s * TABLE[k, 3]
    found = TABLE[k, 0] + _fuse(TABLE[k, 2], s, _fuse(-TABLE[k, 0], c, more))
    return -found if x < 0.0 else found


@linked
def _turned(x: float, quarters: int) -> float:
    """Turn an angle x [rad] by `quarters` quarter turns, and return the sine of the result."""
    turns = x * PER_QUARTER + ROUND - ROUND
    y = x - turns * PARTS[0] - turns * PARTS[1]  # exact products
    first = turns * PARTS[2]
    near = y - first
    near_low = y - near - first
    second = turns * PARTS[3]
    angle = near - second
    angle_low = near_low + (near - angle - second)
    quadrant = (int(turns) + quarters) & 3
    found = _small_cosine(angle, angle_low) if quadrant & 1 else _small_sine(angle, angle_low)
    return -found if quadrant > 1 else found


@linked
def sin(x: float) -> float:
    """Compute the sine of an angle [rad]."""
    size = abs(x)
    if size < 2.0**-26:
        return x
    if size < 0.85546875:
        return _small_sine(x, 0.0)
    if size < 2.426265:
        found = _small_cosine(HALF_PI - size, HALF_PI_LOW)
        return -found if x < 0.0 else found
    return _turned(x if size < MOST else x % (2.0 * math.pi), 0)


@linked
def cos(x: float) -> float:
    """Compute the cosine of an angle [rad]."""
    size = abs(x)
    if size < 2.0**-27:
        return 1.0
    if size < 0.85546875:
        return _small_cosine(x, 0.0)
    if size < 2.426265:
        y = HALF_PI - size
        near = y + HALF_PI_LOW
        return _small_sine(near, y - near + HALF_PI_LOW)
    return _turned(x if size < MOST else x % (2.0 * math.pi), 1)


@inlined
def _measure(long: float, short: float) -> float:
    """Compute the length of the vector (long, short), with long >= short > 0 and finite squares."""
    length = math.sqrt(long * long + short * short)
    if length <= 2.0 * short:
        rest = length - short
        first = long * (2.0 * rest - long)
        second = (rest - 2.0 * (long - short)) * rest
    else:
        rest = length - long
        first = 2.0 * rest * (long - 2.0 * short)
        second = (4.0 * rest - short) * short + rest * rest
    return length - (first + second) / (2.0 * length)


@linked
def hypot(x: float, y: float) -> float:
    """Compute the length of a vector (x, y) (Borges, An Improved Algorithm for hypot, 2019)."""
    if math.isinf(x) or math.isinf(y):
        return math.inf
    if math.isnan(x) or math.isnan(y):
        return math.nan
    long, short = max(abs(x), abs(y)), min(abs(x), abs(y))
    if not short > long * 2.0**-54:
        return long + short
    if long > 2.0**511:
        return _measure(long * 2.0**-600, short * 2.0**-600) * 2.0**600
    if short < 2.0**-459:
        return _measure(long * 2.0**600, short * 2.0**600) * 2.0**-600
    return _measure(long, short)
