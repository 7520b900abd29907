"""Surfaces: geometry, what they refuse, and that nothing changes one."""

import dataclasses
import math

import numpy as np
import pytest

import surface_gym as sg

AXIS = np.zeros((3, 4))
ROTOR = np.ones((3, 4), dtype=bool)


def test_places_of_the_elements() -> None:
    surface = sg.Surface(AXIS, ROTOR, pitch=0.2, origin=(1.0, -1.0))
    assert (surface.rows, surface.columns) == (3, 4)
    np.testing.assert_allclose(surface.x, [1.0, 1.2, 1.4, 1.6])
    np.testing.assert_allclose(surface.y, [-1.0, -0.8, -0.6])


def test_defaults_are_table_1() -> None:
    surface = sg.Surface(AXIS, ROTOR)
    assert (surface.mu_max, surface.mu_min, surface.mu_support) == (0.5, 0.01, 0.005)
    assert (surface.pitch, surface.origin, surface.tilt) == (0.1, (0.05, 0.05), 0.0)


def test_lists_and_integers_are_taken() -> None:
    surface = sg.Surface([[0, 1]], [[True, False]], pitch=1, tilt=0)
    assert surface.axis.dtype == np.float64
    assert surface.rotor.tolist() == [[True, False]]


def test_the_arrays_are_read_only_copies() -> None:
    axis, rotor = AXIS.copy(), ROTOR.copy()
    surface = sg.Surface(axis, rotor)
    axis[:] = 1.0
    rotor[:] = False
    assert (surface.axis == 0.0).all()
    assert surface.rotor.all()
    with pytest.raises(ValueError, match="read-only"):
        surface.axis[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        surface.rotor[0, 0] = False
    with pytest.raises(dataclasses.FrozenInstanceError):
        surface.tilt = 0.1


def test_replace_makes_another_surface_with_another_grid() -> None:
    flat = sg.Surface(AXIS, ROTOR)
    assert flat.grid.gravity_along == 0.0
    tilted = dataclasses.replace(flat, tilt=0.1)
    assert tilted.grid.gravity_along == pytest.approx(9.81 * math.sin(0.1))
    assert tilted.grid.gravity_normal == pytest.approx(9.81 * math.cos(0.1))
    assert flat.grid.gravity_along == 0.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"axis": np.zeros((3, 5))}, r"rotor must have the shape of axis, \(3, 5\), got \(3, 4\)"),
        ({"axis": np.zeros(4)}, r"axis must have the shape \(any, any\), got \(4,\)"),
        ({"axis": np.zeros((0, 4))}, "axis must have at least one row and one column"),
        ({"axis": ROTOR}, "axis must be an array of numbers"),
        ({"rotor": ROTOR[:2]}, r"rotor must have the shape of axis, \(3, 4\), got \(2, 4\)"),
        ({"rotor": ROTOR.astype(float)}, "rotor must be an array of booleans, got .*float64"),
        ({"rotor": ROTOR.astype(int)}, "rotor must be an array of booleans, got .*int64"),
        ({"rotor": None}, "rotor must be an array of booleans"),
        ({"rotor": [[True], [True, False]]}, "rotor must be an array of booleans"),
        ({"stiffness": np.ones((3, 5))}, r"stiffness must have the shape \(3, 4\), got \(3, 5\)"),
        ({"stiffness": np.zeros((3, 4))}, "stiffness must be greater than 0, got 0.0"),
        ({"stiffness": 1.0}, r"stiffness must have the shape \(3, 4\), got \(\)"),
        ({"origin": (0.0,)}, r"origin must have the shape \(2\), got \(1,\)"),
        ({"mu_max": [[0.5], [0.5, 0.5]]}, "mu_max must be an array of numbers"),
        ({"mu_max": np.ones((3, 5))}, r"mu_max must have the shape \(3, 4\), got \(3, 5\)"),
        ({"tilt": -1.0}, "tilt must be between -pi/4 and pi/4 .*, got -1.0"),
    ],
)
def test_what_is_not_allowed_is_refused(changes: dict[str, object], message: str) -> None:
    fields: dict[str, object] = {"axis": AXIS, "rotor": ROTOR, **changes}
    with pytest.raises(ValueError, match=f"^{message}"):
        sg.Surface(**fields)
