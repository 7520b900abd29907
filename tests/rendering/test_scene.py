"""Goals refuse what cannot be drawn, and scenes keep copies."""

from dataclasses import replace

import numpy as np
import pytest

from surface_gym.rendering.scene import ExitSide, ExitSpeed, Heading, Path, StopLine


@pytest.mark.parametrize(
    ("kind", "wrong", "message"),
    [
        (ExitSide, {"side": 2}, "side must be one of -1, 0, 1"),
        (StopLine, {"x": np.nan}, "x must be a finite number"),
        (ExitSpeed, {"ratio": -0.1, "speed": 1.0}, "ratio must be at least 0"),
        (ExitSpeed, {"ratio": 0.5, "speed": -1.0}, "speed must be at least 0"),
        (Path, {"points": [[0.0, 1.0]]}, "points must be at least 2"),
        (Heading, {"angle": "left"}, "angle must be a finite number"),
    ],
)
def test_a_goal_that_cannot_be_is_refused(kind, wrong, message):
    with pytest.raises(ValueError, match=message):
        kind(**wrong)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"goal": "sort"}, "goal must be one of the goals or None, got 'sort'"),
        ({"readings": (("time", 1.0),)}, "readings must be pairs of label and text"),
        ({"readings": (("time", "1", "s"),)}, "readings must be pairs of label and text"),
    ],
)
def test_what_a_task_gives_a_scene_is_checked(bare, wrong, message):
    with pytest.raises(ValueError, match=message):
        replace(bare, **wrong)


def test_a_scene_keeps_copies_and_its_zone_obeys(busy, bare):
    axis = np.zeros((20, 66))
    kept = replace(busy, axis=axis)
    axis[:] = 1.0
    assert not kept.axis.any()
    zoned = replace(bare, zone=(9, 2, 3, 16))
    assert zoned.obeys.sum() == 2 * 16
    assert zoned.obeys[9:11, 3:19].all()
    assert bare.obeys.all()
