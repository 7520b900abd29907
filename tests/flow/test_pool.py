"""Bodies are kept as long as an episode has use for them."""

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.core.resets import place_parcel
from surface_gym.flow.batch import BodyPool
from tests.environments import HEPTAGON, TRIANGLE
from tests.flow.flows import BOX, LARGE_BOX, SHORT


def pool() -> BodyPool:
    return BodyPool(lambda parcel: place_parcel(parcel, SHORT, None), BOX)


def sizes(count: int) -> list[sg.Parcel]:
    return [sg.Parcel(sg.Rectangle(0.2 + 0.001 * k, 0.2)) for k in range(count)]


def test_parcels_that_are_alike_share_a_row() -> None:
    bodies = pool()
    row = bodies.take(BOX)
    assert bodies.take(sg.layouts.box("S")) == row
    assert bodies.take(LARGE_BOX) != row
    assert bodies.parcel(row) == BOX


def test_a_row_is_free_after_its_last_user() -> None:
    bodies = pool()
    rows = [bodies.take(parcel) for parcel in (BOX, BOX, LARGE_BOX)]
    bodies.give_back(rows[:1])
    assert bodies.parcel(rows[1]) == BOX
    bodies.give_back(rows[1:])
    with pytest.raises(KeyError):
        bodies.parcel(rows[1])
    taken = {bodies.take(parcel) for parcel in sizes(16)}
    assert taken == set(range(16))


def test_more_parcels_take_more_rows_and_leave_the_others() -> None:
    bodies = pool()
    parcels = sizes(40)
    rows = [bodies.take(parcel) for parcel in parcels]
    assert len(set(rows)) == 40
    assert len(bodies.bodies.body) == 64
    for row, parcel in zip(rows, parcels, strict=True):
        placement = place_parcel(parcel, SHORT, None)
        np.testing.assert_array_equal(bodies.bodies.body[row], placement.body)
        np.testing.assert_array_equal(bodies.bodies.corners[row], placement.corners)
        assert bodies.parcel(row) == parcel


def test_more_edges_widen_the_rows_of_all() -> None:
    bodies = pool()
    row = bodies.take(BOX)
    narrow = bodies.bodies.corners[row].copy()
    wide = bodies.take(HEPTAGON)
    assert bodies.bodies.edges.shape[1] == bodies.bodies.corners.shape[1] == 7
    np.testing.assert_array_equal(bodies.bodies.corners[row, :4], narrow)
    np.testing.assert_array_equal(bodies.bodies.corners[row, 4:], np.tile(narrow[:1], (3, 1)))
    np.testing.assert_array_equal(
        bodies.bodies.corners[wide], place_parcel(HEPTAGON, SHORT, None).corners
    )


def test_rows_do_not_run_out_where_all_are_given_back() -> None:
    bodies = pool()
    for _ in range(30):
        rows = [bodies.take(parcel) for parcel in (*sizes(12), TRIANGLE, HEPTAGON)]
        bodies.give_back(rows)
    assert len(bodies.bodies.body) == 16


def test_a_parcel_that_does_not_fit_takes_nothing() -> None:
    bodies = BodyPool(lambda parcel: place_parcel(parcel, sg.lines.Line(), None), BOX)
    with pytest.raises(ValueError, match="parcel"):
        bodies.take(sg.Parcel(sg.Rectangle(2.0, 0.3)))
    assert {bodies.take(parcel) for parcel in sizes(16)} == set(range(16))
