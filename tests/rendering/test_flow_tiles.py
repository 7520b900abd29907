import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.rendering import ExitMark, FlowParcel, FlowScene, TilePainter, draw_tiles


def lane(x, **fields):
    """A line with one parcel at an x [m]."""
    rotor = np.zeros((20, 66), bool)
    rotor[8:12, :60] = True
    told = {
        "axis": np.full((20, 66), math.pi / 2),
        "rotor": rotor,
        "exits": (ExitMark("A", 1, 1.0, 2.0), ExitMark("on", 0, 6.0, 6.6)),
        "delivered": (2, 3),
        "parcels": (FlowParcel(sg.Rectangle(0.45, 0.25).outline, (x, 1.0, 0.0), 0),),
        "title": "a lane",
    }
    return FlowScene(**(told | fields))


@pytest.mark.parametrize("lanes", [1, 2, 5, 16])
def test_any_number_of_lanes_fits_a_picture(lanes):
    picture = draw_tiles([lane(0.2 * k) for k in range(lanes)])
    height, width, colours = picture.shape
    assert (width, colours) == (1280, 3)
    assert height % 2 == 0
    assert 0.3 < width / height < 4.0


def test_a_lane_changes_its_own_tile_alone():
    scenes = [lane(1.0)] * 4
    before = draw_tiles(scenes)
    ends = []
    for k in range(4):
        moved = [*scenes]
        moved[k] = lane(5.0, waiting=3, title="another")
        rows = np.flatnonzero((draw_tiles(moved) != before).any(axis=(1, 2)))
        ends.append((rows[0], rows[-1]))
    assert all(last < first for (_, last), (first, _) in pairwise(ends))


def test_a_kept_painter_draws_as_a_fresh_one_and_takes_both_kinds_in_turn(sorting):
    painter = TilePainter()
    streams = [lane(1.0), lane(2.0, delivered=(0, 9)), lane(3.0)]
    for scenes in (streams, streams[::-1], [sorting.scene(20)] * 3, streams[:2]):
        np.testing.assert_array_equal(painter.draw(scenes), draw_tiles(scenes))


def test_lanes_that_do_not_fit_each_other_are_refused(sorting):
    with pytest.raises(ValueError, match="scenes must be all Scene or all FlowScene, got both"):
        draw_tiles([lane(1.0), sorting.scene(20)])
    with pytest.raises(ValueError, match="scenes must be of surfaces of one size"):
        draw_tiles([lane(1.0), replace(lane(1.0), pitch=(0.1, 0.2))])
    wider = lane(1.0).rotor.copy()
    wider[6:14] = True
    with pytest.raises(ValueError, match=r"scenes must show as many rows.*got \[14, 18\]"):
        draw_tiles([lane(1.0), replace(lane(1.0), rotor=wider)])


def test_a_line_too_long_for_the_width_is_refused_with_the_width_it_needs():
    rotor = np.ones((4, 400), bool)
    long = FlowScene(np.zeros((4, 400)), rotor, exits=(), delivered=())
    with pytest.raises(ValueError, match="width must be at least 852 for 400 columns, got 640"):
        draw_tiles([long], 640)
