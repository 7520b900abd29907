"""Pictures of many scenes side by side."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from surface_gym.rendering import Scene, SceneParcel, TilePainter, Traffic
from tests.rendering.conftest import EXITS, LONG


def tiles(scenes, width=1280):
    return TilePainter(width).draw(scenes)


@pytest.fixture
def at(empty):
    """A line with one parcel at an x [m]."""

    def scene(x, waiting=0, **fields):
        parcel = SceneParcel(LONG, (x, 1.0, 0.0), 0)
        traffic = Traffic(EXITS, (2, 1, 3), waiting=waiting)
        return replace(empty, **({"parcels": (parcel,), "traffic": traffic, "title": "a"} | fields))

    return scene


@pytest.mark.parametrize("count", [1, 2, 5, 16, 64])
def test_any_number_of_scenes_fits_a_picture_of_a_useful_shape(sorting, at, count):
    alone = [sorting.scene(3 * k % 150, title=f"env {k}") for k in range(count)]
    streams = [at(0.2 * (k % 16)) for k in range(min(count, 16))]
    for scenes in (alone, streams):
        height, width, colours = tiles(scenes).shape
        assert (width, colours) == (1280, 3)
        assert height % 2 == 0
        assert 0.3 < width / height < 4.0


def test_a_scene_changes_its_own_tile_alone(sorting):
    scenes = [sorting.scene(20)] * 4
    before = tiles(scenes)
    quarters = []
    for k in range(4):
        moved = [*scenes]
        moved[k] = sorting.scene(80)
        rows, columns = np.nonzero((tiles(moved) != before).any(axis=2))
        assert len(rows) > 0
        quarters.append((rows.mean(), columns.mean(), np.ptp(rows), np.ptp(columns)))
    first, second, third, fourth = quarters
    assert first[0] == second[0] < third[0] == fourth[0]  # a row of two above a row of two
    assert first[1] == third[1] < second[1] == fourth[1]
    assert all(tall < 470 and wide < 640 for _, _, tall, wide in quarters)


def test_a_stream_changes_its_own_tile_alone(at):
    scenes = [at(1.0)] * 4
    before = tiles(scenes)
    ends = []
    for k in range(4):
        moved = [*scenes]
        moved[k] = at(5.0, waiting=3, title="another")
        rows = np.flatnonzero((tiles(moved) != before).any(axis=(1, 2)))
        ends.append((rows[0], rows[-1]))
    assert all(last < first for (_, last), (first, _) in pairwise(ends))


def test_a_kept_painter_draws_as_a_fresh_one_and_takes_both_kinds_in_turn(sorting, at):
    painter = TilePainter()
    alone = [sorting.scene(20 + k, zone=(9, 2, 3 + k, 16)) for k in range(6)]
    streams = [at(1.0), at(2.0, traffic=Traffic(EXITS, (0, 9, 0))), at(3.0)]
    for scenes in (alone[:4], alone[:4][::-1], alone, streams, streams[::-1], streams[:2]):
        np.testing.assert_array_equal(painter.draw(scenes), tiles(scenes))


def test_scenes_that_do_not_fit_each_other_are_refused(sorting, at):
    scene = sorting.scene(20)
    with pytest.raises(ValueError, match="scenes must be at least one"):
        tiles([])
    with pytest.raises(ValueError, match="scenes must be of surfaces of one size"):
        tiles([scene, replace(scene, pitch=0.2)])
    with pytest.raises(ValueError, match="scenes must all have traffic or none of them, got both"):
        tiles([at(1.0), scene])
    wider = at(1.0).rotor.copy()
    wider[6:14] = True
    with pytest.raises(ValueError, match=r"scenes must show as many rows.*got \[14, 18\]"):
        tiles([at(1.0), at(1.0, rotor=wider)])


def test_a_width_that_does_not_do_is_refused(sorting):
    rotor = np.ones((4, 400), bool)
    for traffic, least in ((None, 832), (Traffic((), ()), 852)):
        long = Scene(np.zeros((4, 400)), rotor, traffic=traffic)
        message = f"width must be at least {least} for 400 columns, got 640"
        with pytest.raises(ValueError, match=message):
            tiles([long], 640)
    with pytest.raises(ValueError, match="width must be even"):
        tiles([sorting.scene(20)], 1281)
