"""Colours. An axis has no direction, so its colours repeat after 180 degrees."""

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Colour: TypeAlias = tuple[int, int, int]

PAPER: Colour = (255, 255, 255)
PLATE: Colour = (244, 245, 246)  # the surface's supports
PLATE_EDGE: Colour = (203, 208, 214)
SUPPORT: Colour = (216, 220, 225)
ZONE: Colour = (255, 255, 255)
ZONE_EDGE: Colour = (112, 122, 136)
INK: Colour = (33, 39, 48)
FAINT_INK: Colour = (108, 116, 128)
PARCEL: Colour = (146, 152, 164)
GOAL: Colour = (190, 24, 72)
SENSED: Colour = (94, 60, 170)

# Far from the four orientations' colours and from each other, for dichromats too.
EXITS: tuple[Colour, ...] = (
    (172, 112, 252),
    (252, 216, 24),
    (84, 252, 180),
    (168, 12, 132),
    (12, 36, 132),
    (252, 180, 252),
    (180, 204, 108),
)

# The axis colours lie on an ellipse in Oklab (https://bottosson.github.io/posts/oklab). Its plane
# holds lightness and the way from blue to orange, which dichromats see too: 0 deg is dark, 90 deg
# light, 45 deg blue and -45 deg orange.
_CENTRE = np.array([0.620, 0.012, 0.005])
_TO_ROLLING = np.array([0.170, -0.080, -0.005])  # from the centre to 90 deg
_TO_PLUS = np.array([-0.055, -0.045, -0.125])  # to 45 deg

_OKLAB_TO_LMS = np.array(
    [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.2914855480],
    ]
)
_LMS_TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


def axis_colours(angle: ArrayLike) -> NDArray[np.uint8]:
    """Compute the colours (..., 3) in sRGB of axis angles (...) [rad].

    >>> axis_colours([0.0, np.pi / 4, np.pi]).tolist()  # 0 and 180 deg are one orientation
    [[127, 61, 77], [62, 119, 189], [127, 61, 77]]
    """
    double = 2.0 * np.asarray(angle, dtype=np.float64)[..., np.newaxis]
    oklab = _CENTRE - np.cos(double) * _TO_ROLLING + np.sin(double) * _TO_PLUS
    linear = (oklab @ _OKLAB_TO_LMS.T) ** 3 @ _LMS_TO_RGB.T
    encoded = np.where(
        linear <= 0.0031308,
        12.92 * linear,
        1.055 * np.maximum(linear, 0.0031308) ** (1.0 / 2.4) - 0.055,
    )
    return np.round(255.0 * encoded).astype(np.uint8)


def axis_colour(angle: float) -> Colour:
    """Compute the colour in sRGB of one axis angle [rad]."""
    red, green, blue = axis_colours(math.remainder(angle, math.pi)).tolist()
    return (red, green, blue)


def mixed(colour: Colour, other: Colour, share: float) -> Colour:
    """Mix a share of another colour into a colour."""
    red, green, blue = (round(a + share * (b - a)) for a, b in zip(colour, other, strict=True))
    return (red, green, blue)


def exit_colour(index: int) -> Colour:
    """Return the colour of an exit; colours repeat where there are more exits."""
    return EXITS[index % len(EXITS)]


def text_on(colour: Colour) -> Colour:
    """Choose the colour in which to write on another."""
    red, green, blue = colour
    return INK if 0.299 * red + 0.587 * green + 0.114 * blue > 120.0 else PAPER
