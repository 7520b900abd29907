from dataclasses import replace

import numpy as np
import pytest

from surface_gym.rendering import ExitSide, ExitSpeed, Heading, Path, Scene, StopLine

WRONG = {
    "rotor of another shape": ({"rotor": np.ones((20, 39), bool)}, "rotor must have the shape"),
    "rotor of numbers": ({"rotor": np.ones((20, 40))}, "rotor must be an array of booleans"),
    "no element": ({"axis": np.zeros((0, 0)), "rotor": np.zeros((0, 0), bool)}, "axis must have"),
    "axis not finite": ({"axis": np.full((20, 40), np.nan)}, "axis must be finite"),
    "outline of two points": ({"outline": [[0, 0], [1, 0]]}, "outline must have at least 3"),
    "flat outline": ({"outline": [[0, 0], [1, 0], [2, 0]]}, "outline must enclose an area"),
    "pose without theta": ({"pose": (1.0, 1.0)}, "pose must have the shape"),
    "sensed pose not finite": ({"sensed_pose": (1.0, np.inf, 0.0)}, "sensed_pose must be finite"),
    "trail of poses": ({"trail": np.zeros((5, 3))}, "trail must have the shape"),
    "no pitch": ({"pitch": 0.0}, "pitch must be greater than 0"),
    "zone of two numbers": ({"zone": (3, 16)}, "zone must be first row, rows"),
    "zone of no row": ({"zone": (9, 0, 3, 16)}, "zone's rows must be a whole number"),
    "zone past the end": ({"zone": (9, 2, 30, 16)}, "zone must lie within"),
    "another goal": ({"goal": "sort"}, "goal must be one of the goals"),
    "readings that are numbers": ({"readings": (("time", 1.0),)}, "readings must be pairs"),
}


@pytest.mark.parametrize(("fields", "message"), WRONG.values(), ids=WRONG)
def test_a_wrong_field_is_named(bare, fields, message):
    with pytest.raises(ValueError, match=message):
        replace(bare, **fields)


@pytest.mark.parametrize(
    ("goal", "arguments", "message"),
    [
        (ExitSide, (2,), "side must be one of -1, 0, 1"),
        (StopLine, (np.nan,), "x must be a finite number"),
        (ExitSpeed, (-0.1, 1.0), "ratio must be at least 0"),
        (ExitSpeed, (0.5, -1.0), "speed must be at least 0"),
        (Path, ([[0.0, 1.0]],), "points must be at least 2"),
        (Heading, ("left",), "angle must be a finite number"),
    ],
)
def test_a_goal_that_cannot_be_asked_is_refused(goal, arguments, message):
    with pytest.raises(ValueError, match=message):
        goal(*arguments)


def test_a_scene_keeps_copies(bare):
    axis = np.zeros((20, 40))
    scene = replace(bare, axis=axis)
    axis[:] = 1.0
    assert not scene.axis.any()


def test_the_zone_obeys(bare):
    zoned = replace(bare, zone=(9, 2, 3, 16))
    assert zoned.obeys.sum() == 2 * 16
    assert zoned.obeys[9:11, 3:19].all()
    assert bare.obeys.all()
    assert isinstance(zoned, Scene)
