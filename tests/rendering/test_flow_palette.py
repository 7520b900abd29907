import numpy as np
import pytest

from surface_gym.rendering.palette import EXITS, INK, PAPER, axis_colours, exit_colour, text_on
from tests.rendering.test_palette import FOUR, SEEN, cielab


@pytest.mark.parametrize("eye", SEEN)
def test_exits_differ_clearly_from_each_other_and_from_the_orientations(eye):
    lab = cielab(np.vstack([EXITS, axis_colours(FOUR)]), SEEN[eye])
    apart = np.linalg.norm(lab[:, np.newaxis] - lab, axis=-1)[np.triu_indices(len(lab), 1)]
    assert apart.min() > (40.0 if eye == "all colours" else 20.0)  # 2.3 is just noticeable


@pytest.mark.parametrize("place", range(len(EXITS)))
def test_a_text_on_an_exit_s_colour_has_contrast(place):
    """At least 4.5 to 1, by https://www.w3.org/TR/WCAG21/#dfn-contrast-ratio."""

    def luminance(colour):
        part = np.array(colour) / 255.0
        linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
        return linear @ [0.2126, 0.7152, 0.0722]

    ground = exit_colour(place)
    low, high = sorted([luminance(ground), luminance(text_on(ground))])
    assert text_on(ground) in (INK, PAPER)
    assert (high + 0.05) / (low + 0.05) >= 4.5


def test_exits_beyond_the_colours_take_them_again():
    assert [exit_colour(k) for k in range(len(EXITS), 2 * len(EXITS))] == list(EXITS)
