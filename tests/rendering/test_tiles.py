from dataclasses import replace

import numpy as np
import pytest

from surface_gym.rendering import TilePainter, draw_tiles


@pytest.mark.parametrize("lanes", [1, 2, 5, 16, 64])
def test_any_number_of_lanes_fits_a_picture_of_a_useful_shape(sorting, lanes):
    scenes = [sorting.scene(3 * k % 150, title=f"lane {k}") for k in range(lanes)]
    picture = draw_tiles(scenes)
    height, width, colours = picture.shape
    assert (width, colours) == (1280, 3)
    assert height % 2 == 0
    assert 0.3 < width / height < 4.0


def test_a_lane_changes_its_own_tile_alone(sorting):
    scenes = [sorting.scene(20)] * 4
    before = draw_tiles(scenes)
    quarters = []
    for lane in range(4):
        moved = [*scenes]
        moved[lane] = sorting.scene(80)
        rows, columns = np.nonzero((draw_tiles(moved) != before).any(axis=2))
        assert len(rows) > 0
        quarters.append((rows.mean(), columns.mean(), np.ptp(rows), np.ptp(columns)))
    first, second, third, fourth = quarters
    assert first[0] == second[0] < third[0] == fourth[0]  # a row of two above a row of two
    assert first[1] == third[1] < second[1] == fourth[1]
    assert all(tall < 470 and wide < 640 for _, _, tall, wide in quarters)


def test_a_kept_painter_draws_as_a_fresh_one(sorting):
    painter = TilePainter()
    for count, step in ((4, 20), (4, 60), (6, 60)):
        scenes = [sorting.scene(step + k, zone=(9, 2, 3 + k, 16)) for k in range(count)]
        np.testing.assert_array_equal(painter.draw(scenes), draw_tiles(scenes))


def test_no_lane_and_lanes_of_several_surfaces_are_refused(sorting):
    scene = sorting.scene(20)
    with pytest.raises(ValueError, match="scenes must be at least one"):
        draw_tiles([])
    with pytest.raises(ValueError, match="scenes must be of surfaces of one size"):
        draw_tiles([scene, replace(scene, pitch=0.2)])
    long = replace(scene, axis=np.zeros((2, 400)), rotor=np.ones((2, 400), bool), zone=None)
    with pytest.raises(ValueError, match="width must be at least 832 for 400 columns, got 640"):
        draw_tiles([long], 640)
    with pytest.raises(ValueError, match="width must be even"):
        draw_tiles([scene], 1281)
