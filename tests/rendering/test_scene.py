"""Scenes refuse what cannot be drawn, and keep copies."""

from dataclasses import replace

import numpy as np
import pytest

from surface_gym.rendering import SceneParcel, Traffic
from surface_gym.rendering.scene import (
    ExitMark,
    ExitSide,
    ExitSpeed,
    Heading,
    InletMark,
    Path,
    StopLine,
)
from tests.rendering.conftest import EXITS, SMALL

ROTOR = np.ones((20, 66), bool)
OVER = Traffic((ExitMark("on", 0, 6.0, 6.7),), (0,))
HIGH = Traffic((ExitMark("on", 0, 6.0, 6.6, (1.5, 2.1)),), (0,))
BEFORE = Traffic((ExitMark("A", 1, -0.1, 0.5),), (0,))
LOST = SceneParcel(SMALL, (0.5, 1.0, 0.0), 3)
ALL, MOUTH = ExitMark("all", 0, 6.0, 6.6), ExitMark("mouth", 0, 6.0, 6.6, (0.5, 1.1))
OVERLAPPING = (EXITS[0], ExitMark("C", 1, 1.9, 2.5), EXITS[2])


def test_a_wrong_field_is_named(busy):
    for wrong, message in (
        ({"rotor": ROTOR[:, 1:]}, "rotor must have the shape"),
        ({"rotor": 1.0 * ROTOR}, "rotor must be an array of booleans"),
        ({"axis": np.zeros((0, 0)), "rotor": ROTOR[:0, :0]}, "axis must have"),
        ({"axis": np.full((20, 66), np.nan)}, "axis must be finite"),
        ({"pitch": 0.0}, "pitch must be greater than 0"),
        ({"origin": (0.05,)}, "origin must have the shape"),
        ({"tilt": "steep"}, "tilt must be a finite number"),
        ({"tilt_direction": 90.0}, "tilt_direction must be between"),
        ({"zone": (3, 16)}, "zone must be first row, rows"),
        ({"zone": (9, 0, 3, 16)}, "zone's rows must be a whole number"),
        ({"zone": (9, 2, 60, 16)}, "zone must lie within"),
        ({"goal": "sort"}, "goal must be one of the goals"),
        ({"readings": (("time", 1.0),)}, "readings must be pairs"),
        ({"traffic": OVER}, "exits must lie within the surface, x from 0 to 6.6 m"),
        ({"traffic": BEFORE}, "exits must lie within the surface"),
        ({"traffic": HIGH}, "exits must lie within the surface, y from 0 to 2 m"),
        ({"parcels": (SMALL,)}, "parcels must be SceneParcel"),
        ({"parcels": (LOST,)}, "a parcel's exit must be an index among the 3 exits, got 3"),
        ({"parcels": (LOST,), "traffic": None}, "an index among the 0 exits"),
        ({"touching": ((0, 1, 1),)}, "touching must be pairs of indices"),
        ({"touching": ((1, 1),)}, "touching must be pairs of two parcels"),
        ({"touching": ((0, 4),)}, "touching must be indices among"),
        ({"touching": ((-1, 0),)}, "touching must be a whole number"),
    ):
        with pytest.raises(ValueError, match=message):
            replace(busy, **wrong)


def test_a_part_that_cannot_be_is_refused():
    right = {
        Traffic: {"exits": EXITS, "delivered": (0, 0, 0)},
        SceneParcel: {"outline": SMALL, "pose": (0.0, 0.0, 0.0)},
        ExitMark: {"name": "A", "side": 1, "first": 0.0, "last": 1.0},
        InletMark: {"name": "A", "side": 0, "first": 0.0, "last": 1.0},
    }
    for kind, wrong, message in (
        (Traffic, {"exits": ("A", *EXITS[1:])}, "exits must be ExitMark, got 'A'"),
        (Traffic, {"exits": OVERLAPPING}, "exits of one side must not overlap"),
        (Traffic, {"exits": (ALL, MOUTH), "delivered": (0, 0)}, "exits of one side must not"),
        (Traffic, {"inlets": EXITS[:1]}, "inlets must be InletMark"),
        (Traffic, {"queues": (1,)}, "queues must be one count for each of the 0 inlets"),
        (Traffic, {"queues": (-1,)}, "queues must be a whole number"),
        (Traffic, {"delivered": (1, 2)}, "delivered must be one count for each of the 3"),
        (Traffic, {"delivered": (1, 0, -1)}, "delivered must be a whole number"),
        (Traffic, {"missorted": 0.5}, "missorted must be a whole number"),
        (Traffic, {"waiting": -1}, "waiting must be a whole number"),
        (SceneParcel, {"outline": [[0, 0], [1, 0]]}, "outline must have at least 3"),
        (SceneParcel, {"outline": [[0, 0], [1, 0], [2, 0]]}, "outline must enclose an area"),
        (SceneParcel, {"pose": (1.0, 1.0)}, "pose must have the shape"),
        (SceneParcel, {"exit": -1}, "exit must be a whole number of at least 0"),
        (SceneParcel, {"trail": np.zeros((5, 3))}, "trail must have the shape"),
        (SceneParcel, {"sensed_pose": (1.0, np.inf, 0.0)}, "sensed_pose must be finite"),
        (SceneParcel, {"label": 7}, "label must be a text"),
        (SceneParcel, {"group": -1}, "group must be a whole number"),
        (ExitMark, {"span": (0.0, 1.0)}, "span must be the least and the greatest y of a mouth"),
        (ExitMark, {"side": 0, "span": (1.0, 1.0)}, "span must be the least and the greatest y"),
        (ExitMark, {"side": 0, "span": 1.0}, "span must have the shape"),
        (InletMark, {"name": 1}, "name must be a text"),
        (InletMark, {"side": 2}, "side must be one of -1, 0, 1"),
        (InletMark, {"first": 1.0}, "last must be greater than first"),
        (ExitMark, {"name": 1}, "name must be a text"),
        (ExitMark, {"side": 2}, "side must be one of -1, 0, 1"),
        (ExitMark, {"first": np.nan}, "first must be a finite number"),
        (ExitMark, {"last": "far"}, "last must be a finite number"),
        (ExitMark, {"first": 1.0, "last": 1.0}, "last must be greater than first"),
        (ExitSide, {"side": 2}, "side must be one of -1, 0, 1"),
        (StopLine, {"x": np.nan}, "x must be a finite number"),
        (ExitSpeed, {"ratio": -0.1, "speed": 1.0}, "ratio must be at least 0"),
        (ExitSpeed, {"ratio": 0.5, "speed": -1.0}, "speed must be at least 0"),
        (Path, {"points": [[0.0, 1.0]]}, "points must be at least 2"),
        (Heading, {"angle": "left"}, "angle must be a finite number"),
    ):
        with pytest.raises(ValueError, match=message):
            kind(**right.get(kind, {}) | wrong)


def test_a_scene_keeps_copies_its_zone_obeys_and_exits_may_touch(busy, bare, empty):
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
    exits = (ExitMark("A", 1, 0.0, 1.1), ExitMark("B", 1, 1.1, 3.0), ExitMark("on", 0, 3.0, 6.6))
    assert replace(empty, traffic=Traffic(exits, (0, 0, 0))).exits == exits
    mouths = (MOUTH, ExitMark("other", 0, 6.0, 6.6, (1.1, 1.5)))
    assert replace(empty, traffic=Traffic(mouths, (0, 0))).exits == mouths
