import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.dynamics.axes import directions_of

ROOT = math.sqrt(0.5)


@pytest.mark.parametrize(
    ("degrees", "cosine", "sine"),
    [
        (0.0, 1.0, 0.0),
        (45.0, ROOT, ROOT),
        (90.0, 0.0, 1.0),
        (135.0, -ROOT, ROOT),
        (180.0, -1.0, 0.0),
        (225.0, -ROOT, -ROOT),
        (270.0, 0.0, -1.0),
        (315.0, ROOT, -ROOT),
    ],
)
def test_multiples_of_45_deg_are_exact(degrees: float, cosine: float, sine: float) -> None:
    turns = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    angles = np.radians(degrees) + 2.0 * math.pi * turns
    np.testing.assert_array_equal(directions_of(angles), [[cosine, sine]] * 5)


def test_every_other_angle_has_its_cosine_and_sine() -> None:
    angles = np.concatenate([np.linspace(-10.0, 10.0, 4001), [1e-300, 1e-9, math.pi / 4 + 1e-12]])
    expected = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    np.testing.assert_allclose(directions_of(angles), expected, rtol=0.0, atol=3e-15)
    assert directions_of(np.array([math.pi / 4 + 1e-12]))[0, 0] != ROOT


def test_a_surface_has_the_same_directions() -> None:
    surface = sg.layouts.sorting()
    assert set(map(tuple, surface.grid.direction.tolist())) == {(0.0, 1.0), (ROOT, ROOT)}


@pytest.mark.parametrize("degrees", np.arange(0.05, 0.6, 0.05))
@pytest.mark.parametrize("size", ["S", "B"])
def test_the_study_s_loop_stays_on_a_slight_slope(degrees: float, size: str) -> None:
    """It divided by the 6e-17 that the cosine of 90 deg was, and threw the parcel off."""
    surface = sg.layouts.sorting(size, tilt=math.radians(degrees))
    run = sg.simulate(
        surface, sg.layouts.box(size), sg.layouts.start(size), duration=2.0, method="explicit"
    )
    assert run.end == "duration"
    assert np.abs(run.pose[:, :2] - run.pose[0, :2]).max() < 0.05
