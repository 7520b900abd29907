from dataclasses import replace

import numpy as np
import pytest

from surface_gym.rendering import ExitMark, FlowParcel, FlowScene

BOX = np.array([[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]])
LEFT, RIGHT, ON = ExitMark("A", 1, 1.0, 1.8), ExitMark("B", -1, 1.0, 1.8), ExitMark("on", 0, 3, 4)


@pytest.fixture
def scene():
    return FlowScene(
        axis=np.zeros((20, 40)),
        rotor=np.ones((20, 40), bool),
        exits=(LEFT, RIGHT, ON),
        delivered=(1, 0, 2),
        parcels=(FlowParcel(BOX, (0.5, 1.0, 0.0), 0), FlowParcel(BOX, (0.9, 1.0, 0.0), 2)),
    )


WRONG = {
    "no element": ({"axis": np.zeros((0, 0)), "rotor": np.zeros((0, 0), bool)}, "axis must have"),
    "axis not finite": ({"axis": np.full((20, 40), np.nan)}, "axis must be finite"),
    "rotor of another shape": ({"rotor": np.ones((20, 39), bool)}, "rotor must have the shape"),
    "rotor of numbers": ({"rotor": np.ones((20, 40))}, "rotor must be an array of booleans"),
    "no pitch": ({"pitch": 0.0}, "pitch must be greater than 0"),
    "origin of one number": ({"origin": (0.05,)}, "origin must have the shape"),
    "tilt that is a text": ({"tilt": "steep"}, "tilt must be a finite number"),
    "zone of two numbers": ({"zone": (3, 16)}, "zone must be first row, rows"),
    "zone past the end": ({"zone": (9, 2, 30, 16)}, "zone must lie within"),
    "readings that are numbers": ({"readings": (("time", 1.0),)}, "readings must be pairs"),
    "exits of another kind": ({"exits": ("A", RIGHT, ON)}, "exits must be ExitMark, got 'A'"),
    "an exit past the end": (
        {"exits": (LEFT, RIGHT, ExitMark("on", 0, 4.0, 4.5))},
        "exits must lie within the surface, x from 0 to 4 m",
    ),
    "an exit before the beginning": (
        {"exits": (ExitMark("A", 1, -0.1, 0.5), RIGHT, ON)},
        "exits must lie within the surface",
    ),
    "exits in each other's way": (
        {"exits": (LEFT, ExitMark("C", 1, 1.7, 2.5), ON)},
        "exits of one side must not overlap",
    ),
    "too few counts": ({"delivered": (1, 2)}, "delivered must be one count for each of the 3"),
    "a count below zero": ({"delivered": (1, 0, -1)}, "delivered must be a whole number"),
    "half a parcel gone astray": ({"missorted": 0.5}, "missorted must be a whole number"),
    "a queue below zero": ({"waiting": -1}, "waiting must be a whole number"),
    "parcels of another kind": ({"parcels": (BOX,)}, "parcels must be FlowParcel"),
    "a parcel that leaves nowhere": (
        {"parcels": (FlowParcel(BOX, (0.5, 1.0, 0.0), 3),)},
        "a parcel's exit must be a place among the 3 exits, got 3",
    ),
    "three that touch": ({"touching": ((0, 1, 1),)}, "touching must be pairs of places"),
    "touching itself": ({"touching": ((1, 1),)}, "touching must be pairs of two parcels"),
    "touching one that is not there": ({"touching": ((0, 2),)}, "touching must be places among"),
    "touching before the first": ({"touching": ((-1, 0),)}, "touching must be a whole number"),
}


@pytest.mark.parametrize(("fields", "message"), WRONG.values(), ids=WRONG)
def test_a_wrong_field_is_named(scene, fields, message):
    with pytest.raises(ValueError, match=message):
        replace(scene, **fields)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((1, 1, 0.0, 1.0), "name must be a text"),
        (("A", 2, 0.0, 1.0), "side must be one of -1, 0, 1"),
        (("A", 1, np.nan, 1.0), "first must be a finite number"),
        (("A", 1, 0.0, "far"), "last must be a finite number"),
        (("A", 1, 1.0, 1.0), "last must be greater than first"),
    ],
)
def test_an_exit_that_cannot_be_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        ExitMark(*arguments)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"outline": [[0, 0], [1, 0]]}, "outline must have at least 3"),
        ({"outline": [[0, 0], [1, 0], [2, 0]]}, "outline must enclose an area"),
        ({"pose": (1.0, 1.0)}, "pose must have the shape"),
        ({"exit": -1}, "exit must be a whole number of at least 0"),
        ({"trail": np.zeros((5, 3))}, "trail must have the shape"),
        ({"sensed_pose": (1.0, np.inf, 0.0)}, "sensed_pose must be finite"),
        ({"label": 7}, "label must be a text"),
    ],
)
def test_a_parcel_that_cannot_be_is_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        FlowParcel(**({"outline": BOX, "pose": (0.0, 0.0, 0.0), "exit": 0} | fields))


def test_exits_may_end_where_the_next_and_the_surface_begin(scene):
    exits = (ExitMark("A", 1, 0.0, 1.1), ExitMark("B", 1, 1.1, 3.0), ExitMark("on", 0, 3.0, 4.0))
    assert replace(scene, exits=exits).exits == exits


def test_a_scene_keeps_copies_and_takes_lists(scene):
    axis, counts = np.zeros((20, 40)), [1, 0, 2]
    kept = replace(scene, axis=axis, delivered=counts, parcels=list(scene.parcels))
    axis[:], counts[0] = 1.0, 9
    assert not kept.axis.any()
    assert kept.delivered == (1, 0, 2)
    assert kept.parcels == scene.parcels


def test_the_zone_obeys(scene):
    zoned = replace(scene, zone=(9, 2, 3, 16))
    assert zoned.obeys.sum() == 2 * 16
    assert zoned.obeys[9:11, 3:19].all()
    assert scene.obeys.all()
