"""Colours are distinct to every eye, and texts on them are read."""

import numpy as np
import pytest

from surface_gym.rendering.ink import EXITS, INK, PAPER, axis_colours, exit_colour, text_on

FOUR = np.radians([0.0, 45.0, -45.0, 90.0])

# What a dichromat sees of linear RGB: Vienot, Brettel and Mollon (1999), Color Res. Appl. 24:243.
RGB_TO_LMS = np.array(
    [[17.8824, 43.5161, 4.11935], [3.45565, 27.1554, 3.86714], [0.0299566, 0.184309, 1.46709]]
)
SEEN = {
    "all colours": np.eye(3),
    "no red": np.array([[0.0, 2.02344, -2.52581], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "no green": np.array([[1.0, 0.0, 0.0], [0.494207, 0.0, 1.24827], [0.0, 0.0, 1.0]]),
}
RGB_TO_XYZ = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)


def cielab(srgb, cones):
    """CIELAB of colours as an eye with these cones sees them."""
    part = np.asarray(srgb) / 255.0
    linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    seen = linear @ (np.linalg.inv(RGB_TO_LMS) @ cones @ RGB_TO_LMS).T
    xyz = np.clip(seen, 0.0, 1.0) @ RGB_TO_XYZ.T / RGB_TO_XYZ.sum(axis=1)
    f = np.where(xyz > (6 / 29) ** 3, np.cbrt(xyz), xyz * (29 / 6) ** 2 / 3 + 4 / 29)
    x, y, z = np.moveaxis(f, -1, 0)
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=-1)


def test_half_a_turn_is_the_same_colour_they_change_gradually_and_exits_take_them_again():
    angles = np.linspace(-np.pi, np.pi, 50)
    np.testing.assert_array_equal(axis_colours(angles), axis_colours(angles + np.pi))
    colours = axis_colours(np.radians(np.arange(0, 181))).astype(int)
    assert np.abs(np.diff(colours, axis=0)).max() <= 5
    assert [exit_colour(k) for k in range(len(EXITS), 2 * len(EXITS))] == list(EXITS)


@pytest.mark.parametrize("eye", SEEN)
def test_the_four_orientations_and_the_exits_differ_clearly_to_every_eye(eye):
    lab = cielab(np.vstack([axis_colours(FOUR), EXITS]), SEEN[eye])
    apart = np.linalg.norm(lab[:, np.newaxis] - lab, axis=-1) + 1e3 * np.eye(len(lab))
    assert apart[:4, :4].min() > 25.0  # 2.3 is a just noticeable difference
    assert apart.min() > (40.0 if eye == "all colours" else 20.0)


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


@pytest.mark.parametrize("eye", SEEN)
def test_plots_tell_the_first_controllers_apart(eye):
    pytest.importorskip("matplotlib", reason="matplotlib, of the extra `agents`, is missing")
    from matplotlib.colors import to_rgb

    from surface_gym.agents.evaluation.pictures import choose_colours

    chosen = list(choose_colours(map(str, range(11))).values())
    assert chosen[:10] == list(dict.fromkeys(chosen))
    lab = cielab(255.0 * np.array([to_rgb(colour) for colour in chosen[:3]]), SEEN[eye])
    apart = np.linalg.norm(lab[:, np.newaxis] - lab, axis=-1)
    assert apart[np.triu_indices(3, 1)].min() > 35.0
