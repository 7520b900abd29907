"""An assortment: the same for the same seed, of all shapes, within its sizes and loads."""

import re

import numpy as np
import pytest

from surface_gym.assortment import assortment
from surface_gym.bases import Disc, Polygon, Rectangle

MANY = assortment(400, seed=3)


def test_the_same_seed_gives_the_same_parcels() -> None:
    for again, parcel in zip(assortment(12, seed=3), MANY[:12], strict=True):
        np.testing.assert_array_equal(again.base.outline, parcel.base.outline)
        assert again.com_offset == parcel.com_offset
    assert assortment(1, seed=4) != MANY[:1]


def test_shapes_come_in_turn() -> None:
    for place, parcel in enumerate(MANY):
        base = parcel.base
        assert isinstance(base, (Rectangle, Rectangle, Disc, Polygon)[place % 4])
        if place % 4 == 0:
            assert isinstance(base, Rectangle)
            assert base.length == base.width
    assert any(
        b.length != b.width for b in (p.base for p in MANY[1::4]) if isinstance(b, Rectangle)
    )


@pytest.mark.parametrize("sizes", [(0.2, 0.45), (0.15, 0.5), (0.3, 0.3)])
def test_sizes_are_within_their_bounds(sizes: tuple[float, float]) -> None:
    extents = np.array(
        [np.ptp(parcel.base.outline, axis=0) for parcel in assortment(200, 0, sizes, load=0.01)]
    )
    least = min(sizes[0], 0.75 * sizes[0])  # a polygon's, of the least circle
    assert extents.min() >= least - 1e-9
    assert extents.max() <= sizes[1] + 1e-9


def test_lengths_are_uniform() -> None:
    """A square's mean and spread are those of the uniform law, within four standard errors."""
    lengths = np.array([np.ptp(parcel.base.outline[:, 0]) for parcel in assortment(1600, 1)[::4]])
    spread = 0.25 / np.sqrt(12.0)
    assert lengths.mean() == pytest.approx(0.325, abs=4.0 * spread / np.sqrt(len(lengths)))
    assert lengths.std() == pytest.approx(spread, rel=0.1)


def test_loads_are_uniform_in_a_disc_over_the_base() -> None:
    offsets = np.array([parcel.com_offset for parcel in MANY])
    distance = np.hypot(*offsets.T)
    assert distance.max() <= 0.03
    # In a disc, the square of the distance is uniform.
    assert (distance**2).mean() == pytest.approx(0.5 * 0.03**2, rel=0.15)
    assert np.abs(offsets.mean(axis=0)).max() < 4.0 * 0.015 / np.sqrt(len(MANY))
    for parcel in MANY:
        assert parcel.base.functions(*parcel.centre_of_mass).max() <= 0.0


def test_none_is_off_centre_where_no_load_is() -> None:
    assert {parcel.com_offset for parcel in assortment(8, 0, load=0.0)} == {(0.0, 0.0)}


def test_polygons_are_convex_and_hold_their_centroid() -> None:
    for parcel in MANY[3::4]:
        corners = parcel.base.outline
        edges = np.roll(corners, -1, axis=0) - corners
        after = np.roll(edges, -1, axis=0)
        assert (edges[:, 0] * after[:, 1] - edges[:, 1] * after[:, 0] > 0.0).all()
        assert parcel.base.functions(*parcel.base.centroid).max() < 0.0


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"count": 0}, "count must be a whole number of at least 1, got 0"),
        ({"count": 2.0}, "count must be a whole number of at least 1, got 2.0"),
        ({"seed": -1}, "seed must be a whole number of at least 0, got -1"),
        ({"sizes": (0.4, 0.2)}, "sizes must rise within (0.0001, 1000.0) m, got (0.4, 0.2)"),
        ({"sizes": (0.0, 0.2)}, "sizes must rise within"),
        ({"sizes": (0.2, 2000.0)}, "sizes must rise within"),
        ({"sizes": 0.2}, "sizes must have the shape (2)"),
        ({"load": -0.01}, "load must be at least 0, got -0.01"),
        ({"load": 50.0}, "load must lie over most bases, got 50 m"),
    ],
)
def test_what_is_not_allowed(arguments: dict[str, object], told: str) -> None:
    with pytest.raises(ValueError, match=f"^{re.escape(told)}"):
        assortment(**{"count": 4, "seed": 0, **arguments})  # type: ignore[arg-type]
