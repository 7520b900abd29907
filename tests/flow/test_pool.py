"""Bodies are kept as long as an episode has use for them."""

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.core.resets import place_parcel
from surface_gym.flow.batch import BodyPool
from tests.environments import HEPTAGON, TRIANGLE
from tests.flow.flows import BOX, LARGE_BOX, SHORT


def make_pool() -> BodyPool:
    return BodyPool(lambda parcel: place_parcel(parcel, SHORT, None), BOX)


def sizes(count: int) -> list[sg.Parcel]:
    return [sg.Parcel(sg.Rectangle(0.2 + 0.001 * k, 0.2)) for k in range(count)]


def test_parcels_that_are_alike_share_a_row() -> None:
    pool = make_pool()
    row = pool.take(BOX)
    assert pool.take(sg.layouts.box("S")) == row
    assert pool.take(LARGE_BOX) != row
    assert pool.parcel(row) == BOX


def test_a_row_is_free_after_its_last_user() -> None:
    pool = make_pool()
    rows = [pool.take(parcel) for parcel in (BOX, BOX, LARGE_BOX)]
    pool.give_back(rows[:1])
    assert pool.parcel(rows[1]) == BOX
    pool.give_back(rows[1:])
    with pytest.raises(KeyError):
        pool.parcel(rows[1])
    taken = {pool.take(parcel) for parcel in sizes(16)}
    assert taken == set(range(16))


def test_more_parcels_take_more_rows_and_leave_the_others() -> None:
    pool = make_pool()
    parcels = sizes(40)
    rows = [pool.take(parcel) for parcel in parcels]
    assert len(set(rows)) == 40
    assert len(pool.bodies.body) == 64
    for row, parcel in zip(rows, parcels, strict=True):
        placement = place_parcel(parcel, SHORT, None)
        np.testing.assert_array_equal(pool.bodies.body[row], placement.body)
        np.testing.assert_array_equal(pool.bodies.corners[row], placement.corners)
        assert pool.parcel(row) == parcel


def test_more_edges_widen_the_rows_of_all() -> None:
    pool = make_pool()
    row = pool.take(BOX)
    narrow = pool.bodies.corners[row].copy()
    wide = pool.take(HEPTAGON)
    assert pool.bodies.edges.shape[1] == pool.bodies.corners.shape[1] == 7
    np.testing.assert_array_equal(pool.bodies.corners[row, :4], narrow)
    np.testing.assert_array_equal(pool.bodies.corners[row, 4:], np.tile(narrow[:1], (3, 1)))
    np.testing.assert_array_equal(
        pool.bodies.corners[wide], place_parcel(HEPTAGON, SHORT, None).corners
    )


def test_rows_do_not_run_out_where_all_are_given_back() -> None:
    pool = make_pool()
    for _ in range(30):
        rows = [pool.take(parcel) for parcel in (*sizes(12), TRIANGLE, HEPTAGON)]
        pool.give_back(rows)
    assert len(pool.bodies.body) == 16


def test_a_parcel_that_does_not_fit_takes_nothing() -> None:
    pool = BodyPool(lambda parcel: place_parcel(parcel, sg.lines.Line(), None), BOX)
    with pytest.raises(ValueError, match="parcel"):
        pool.take(sg.Parcel(sg.Rectangle(2.0, 0.3)))
    assert {pool.take(parcel) for parcel in sizes(16)} == set(range(16))
