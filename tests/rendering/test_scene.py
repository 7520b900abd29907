"""Scenes refuse what cannot be drawn, and keep copies."""

from dataclasses import replace

import numpy as np
import pytest

from surface_gym.rendering import SceneParcel, Traffic
from surface_gym.rendering.scene import ExitMark, ExitSide, ExitSpeed, Heading, Path, StopLine
from tests.rendering.conftest import EXITS, SMALL

WRONG = {
    "rotor of another shape": ({"rotor": np.ones((20, 65), bool)}, "rotor must have the shape"),
    "rotor of numbers": ({"rotor": np.ones((20, 66))}, "rotor must be an array of booleans"),
    "no element": ({"axis": np.zeros((0, 0)), "rotor": np.zeros((0, 0), bool)}, "axis must have"),
    "axis not finite": ({"axis": np.full((20, 66), np.nan)}, "axis must be finite"),
    "no pitch": ({"pitch": 0.0}, "pitch must be greater than 0"),
    "origin of one number": ({"origin": (0.05,)}, "origin must have the shape"),
    "tilt that is a text": ({"tilt": "steep"}, "tilt must be a finite number"),
    "zone of two numbers": ({"zone": (3, 16)}, "zone must be first row, rows"),
    "zone of no row": ({"zone": (9, 0, 3, 16)}, "zone's rows must be a whole number"),
    "zone past the end": ({"zone": (9, 2, 60, 16)}, "zone must lie within"),
    "another goal": ({"goal": "sort"}, "goal must be one of the goals"),
    "readings that are numbers": ({"readings": (("time", 1.0),)}, "readings must be pairs"),
    "an exit past the end": (
        {"traffic": Traffic((ExitMark("on", 0, 6.0, 6.7),), (0,))},
        "exits must lie within the surface, x from 0 to 6.6 m",
    ),
    "an exit before the beginning": (
        {"traffic": Traffic((ExitMark("A", 1, -0.1, 0.5),), (0,))},
        "exits must lie within the surface",
    ),
    "parcels of another kind": ({"parcels": (SMALL,)}, "parcels must be SceneParcel"),
    "a parcel that leaves nowhere": (
        {"parcels": (SceneParcel(SMALL, (0.5, 1.0, 0.0), 3),)},
        "a parcel's exit must be an index among the 3 exits, got 3",
    ),
    "three that touch": ({"touching": ((0, 1, 1),)}, "touching must be pairs of indices"),
    "touching itself": ({"touching": ((1, 1),)}, "touching must be pairs of two parcels"),
    "touching one that is not there": ({"touching": ((0, 4),)}, "touching must be indices among"),
    "touching before the first": ({"touching": ((-1, 0),)}, "touching must be a whole number"),
}


@pytest.mark.parametrize(("fields", "message"), WRONG.values(), ids=WRONG)
def test_a_wrong_field_is_named(busy, fields, message):
    with pytest.raises(ValueError, match=message):
        replace(busy, **fields)


def test_a_parcel_with_an_exit_needs_traffic(bare):
    parcel = replace(bare.parcels[0], exit=0)
    with pytest.raises(ValueError, match="an index among the 0 exits"):
        replace(bare, parcels=(parcel,))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"exits": ("A", *EXITS[1:])}, "exits must be ExitMark, got 'A'"),
        (
            {"exits": (EXITS[0], ExitMark("C", 1, 1.9, 2.5), EXITS[2])},
            "exits of one side must not overlap",
        ),
        ({"delivered": (1, 2)}, "delivered must be one count for each of the 3"),
        ({"delivered": (1, 0, -1)}, "delivered must be a whole number"),
        ({"missorted": 0.5}, "missorted must be a whole number"),
        ({"waiting": -1}, "waiting must be a whole number"),
    ],
)
def test_traffic_that_cannot_be_is_refused(empty, fields, message):
    with pytest.raises(ValueError, match=message):
        replace(empty.traffic, **fields)


@pytest.mark.parametrize(
    ("kind", "arguments", "message"),
    [
        (ExitSide, (2,), "side must be one of -1, 0, 1"),
        (StopLine, (np.nan,), "x must be a finite number"),
        (ExitSpeed, (-0.1, 1.0), "ratio must be at least 0"),
        (ExitSpeed, (0.5, -1.0), "speed must be at least 0"),
        (Path, ([[0.0, 1.0]],), "points must be at least 2"),
        (Heading, ("left",), "angle must be a finite number"),
        (ExitMark, (1, 1, 0.0, 1.0), "name must be a text"),
        (ExitMark, ("A", 2, 0.0, 1.0), "side must be one of -1, 0, 1"),
        (ExitMark, ("A", 1, np.nan, 1.0), "first must be a finite number"),
        (ExitMark, ("A", 1, 0.0, "far"), "last must be a finite number"),
        (ExitMark, ("A", 1, 1.0, 1.0), "last must be greater than first"),
    ],
)
def test_a_goal_or_an_exit_that_cannot_be_is_refused(kind, arguments, message):
    with pytest.raises(ValueError, match=message):
        kind(*arguments)


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
        SceneParcel(**({"outline": SMALL, "pose": (0.0, 0.0, 0.0)} | fields))


def test_exits_may_end_where_the_next_and_the_surface_begin(empty):
    exits = (ExitMark("A", 1, 0.0, 1.1), ExitMark("B", 1, 1.1, 3.0), ExitMark("on", 0, 3.0, 6.6))
    assert replace(empty, traffic=Traffic(exits, (0, 0, 0))).exits == exits


def test_a_scene_keeps_copies_and_takes_lists_and_its_zone_obeys(busy, bare):
    axis, counts = np.zeros((20, 66)), [1, 0, 2]
    traffic = Traffic(list(EXITS), counts)
    kept = replace(busy, axis=axis, traffic=traffic, parcels=list(busy.parcels))
    axis[:], counts[0] = 1.0, 9
    assert not kept.axis.any()
    assert kept.traffic.delivered == (1, 0, 2)
    assert kept.parcels == busy.parcels
    assert kept.exits == EXITS
    zoned = replace(bare, zone=(9, 2, 3, 16))
    assert zoned.obeys.sum() == 2 * 16
    assert zoned.obeys[9:11, 3:19].all()
    assert bare.obeys.all()
