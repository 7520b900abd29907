"""Parcels: defaults, inertia, centre of mass, and what they refuse."""

import dataclasses
import math

import numpy as np
import pytest

import surface_gym as sg

BOX = sg.Rectangle(0.25, 0.25)
TRIANGLE = sg.Polygon([(0.0, 0.0), (0.3, 0.0), (0.0, 0.3)])


def test_defaults_are_table_1() -> None:
    parcel = sg.Parcel(BOX)
    assert (parcel.mass, parcel.com_height) == (10.0, 0.1)
    assert parcel.moment_of_inertia == pytest.approx(10.0 * (0.25**2 + 0.25**2) / 12.0)


def test_a_given_inertia_is_kept() -> None:
    parcel = sg.Parcel(BOX, mass=5.48, inertia=0.057)
    assert parcel.moment_of_inertia == 0.057
    assert parcel.body.gyration == pytest.approx(0.057 / 5.48)


def test_the_centre_of_mass_is_offset_from_the_centroid() -> None:
    assert sg.Parcel(TRIANGLE).centre_of_mass == pytest.approx((0.1, 0.1))
    shifted = sg.Parcel(TRIANGLE, com_offset=(0.02, -0.03))
    assert shifted.centre_of_mass == pytest.approx((0.12, 0.07))


def test_a_parcel_is_frozen() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        sg.Parcel(BOX).mass = 1.0


def test_parcels_with_equal_fields_are_equal() -> None:
    assert sg.Parcel(BOX) == sg.Parcel(sg.Rectangle(0.25, 0.25))
    assert sg.Parcel(BOX) != sg.Parcel(BOX, mass=9.0)
    assert len({sg.Parcel(BOX), sg.Parcel(sg.Rectangle(0.25, 0.25))}) == 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"base": None}, "base must be a Rectangle, a Disc or a Polygon, got None"),
        ({"base": (0.25, 0.25)}, "base must be a Rectangle, a Disc or a Polygon"),
        ({"base": sg.Rectangle}, "base must be a Rectangle, a Disc or a Polygon"),
        ({"mass": 0.0}, "mass must be greater than 0, got 0.0"),
        ({"mass": -1.0}, "mass must be greater than 0, got -1.0"),
        ({"mass": math.nan}, "mass must be a finite number, got nan"),
        ({"mass": None}, "mass must be a finite number, got None"),
        ({"mass": "10"}, "mass must be a finite number, got '10'"),
        ({"com_height": -0.1}, "com_height must be at least 0, got -0.1"),
        ({"inertia": 0.0}, "inertia must be greater than 0, got 0.0"),
        ({"inertia": math.inf}, "inertia must be a finite number, got inf"),
        ({"com_offset": (0.2, 0.0)}, "com_offset must keep the centre of mass over the base"),
        ({"com_offset": (0.0, np.nan)}, "com_offset must be finite, got nan"),
        ({"com_offset": 0.0}, r"com_offset must have the shape \(2\)"),
        ({"com_offset": None}, r"com_offset must "),
    ],
)
def test_what_is_not_allowed_is_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        sg.Parcel(**{"base": BOX, **changes})
