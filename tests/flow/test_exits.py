"""Exits and inlets: their order, where they lie, who comes by them, and what is refused."""

import math
from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pytest

from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import Arrival, Steady, Trace, read_trace, write_trace
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.exits import (
    EXITS,
    Exit,
    Exits,
    Inlet,
    Inlets,
    chutes,
    end,
    exits_option,
    side_by_side,
    sides,
)
from surface_gym.flow.stream import Stream
from surface_gym.parcel import Parcel, Rectangle
from surface_gym.physics.types import VX, VY
from tests import environments as te

LEFT = Exit("left", 1, 0.5, 2.0)
STRAIGHT = Exit("straight", 0)


def test_chutes_are_two_to_either_side_and_sides_as_long_as_the_line() -> None:
    exits = chutes()
    assert exits.names == ("left 1", "left 2", "right 1", "right 2", "straight")
    spans = [[1, 0.6, 2.8], [1, 3.2, 5.8], [-1, 0.6, 2.8], [-1, 3.2, 5.8]]
    np.testing.assert_allclose(exits.table, [*spans, [0, -math.inf, math.inf]])
    exits = sides(4.5)
    assert exits.names == ("left", "right", "straight")
    np.testing.assert_array_equal(exits.table[:2], [[1, 0.0, 4.5], [-1, 0.0, 4.5]])


@pytest.mark.parametrize("name", EXITS)
def test_presets_scale_with_the_line_which_must_be_long(name: str) -> None:
    short, long = EXITS[name](3.0), EXITS[name](6.0)
    assert short.names == long.names
    aside = long.table[:, 0] != 0.0
    np.testing.assert_allclose(2.0 * short.table[aside, 1:], long.table[aside, 1:])
    np.testing.assert_array_equal(short.table[~aside], long.table[~aside])  # of y
    for length in (0.0, -1.0, math.nan, None):
        with pytest.raises(ValueError, match="length must be"):
            EXITS[name](length)


def test_exits_are_counted_gone_through_hashed_and_found_by_name() -> None:
    exits = Exits([LEFT, STRAIGHT])
    assert (len(exits), list(exits)) == (2, [LEFT, STRAIGHT])
    assert exits == Exits((LEFT, STRAIGHT))
    assert len({exits, Exits((LEFT, STRAIGHT)), sides()}) == 2
    assert [chutes().place(name) for name in chutes().names] == [0, 1, 2, 3, 4]
    with pytest.raises(ValueError, match=r"exit must be one of 'left 1', .*, got 'left'"):
        chutes().place("left")
    with pytest.raises(FrozenInstanceError):
        exits.exits = ()
    with pytest.raises(ValueError, match="read-only"):
        exits.table[0, 0] = 0.0


def test_the_option_is_a_preset_or_exits_of_ones_own() -> None:
    assert exits_option("chutes", 3.0) == chutes(3.0)
    assert exits_option([LEFT], 3.0) == Exits((LEFT,))
    assert exits_option(sides(), 3.0) == sides()
    for value in ("doors", None, 3):
        with pytest.raises(
            ValueError, match="exits must be one of 'chutes', 'sides', 'end', 'mouth', 'mouths'"
        ):
            exits_option(value, 3.0)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": ""}, "name must be text without spaces at its ends, got ''"),
        ({"name": "le\0ft"}, "name must hold neither NUL nor half a letter"),
        ({"side": 2}, "side must be one of -1, 0, 1, got 2"),
        ({"last": math.nan}, "last must be a finite number, got nan"),
        ({"last": 0.5}, "last must be greater than first, 0.5, got 0.5 for 'left'"),
        ((), r"exits must be at least one Exit in a tuple, got \(\)"),
        ((LEFT, "straight"), "exits must be Exit objects, got 'straight'"),
        ((LEFT, Exit("left", 0)), "exits must have names of their own, got 'left' twice"),
        (
            (LEFT, STRAIGHT, Exit("wide", 1, 1.9)),
            "exits must not overlap on one side, got 'left' from 0.5 to 2 m and 'wide' "
            "from 1.9 to inf m",
        ),
    ],
)
def test_exits_that_are_bad_or_do_not_go_together_are_refused(changes: Any, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        _ = replace(LEFT, **changes) if isinstance(changes, dict) else Exits(changes)


BOX = Parcel(Rectangle(0.3, 0.2))
ALL_EDGES = Inlets(
    (Inlet("top", 0, -0.3, 0.3), Inlet("left", 1, 1.0, 2.0), Inlet("right", -1, 1.0, 2.0))
)


def begun(stream: Stream, **arguments) -> StreamBatch:
    return te.begun(EnvConfig("singulate", actions="parcels", stream=stream, **arguments))


def one_by(inlet: str, aside: float = 0.0, turned: float = 0.0) -> Stream:
    return Stream(Trace((Arrival(0.0, BOX, 0.5, "end", inlet, aside, turned),)))


@pytest.mark.parametrize(
    ("inlet", "place", "way"),
    [
        ("top", (0.15, 0.7), (1.0, 0.0)),
        ("left", (1.5, 1.4 - 0.15), (0.0, -1.0)),
        ("right", (1.5, 0.15), (0.0, 1.0)),
    ],
)
def test_a_parcel_comes_with_its_rear_at_the_edge_and_goes_away_from_it(inlet, place, way) -> None:
    batch = begun(one_by(inlet), inlets=ALL_EDGES)
    truth = batch.parcels.truth[0]
    np.testing.assert_allclose(truth[:2], place, atol=1e-12)
    np.testing.assert_allclose(truth[VX : VY + 1], np.multiply(0.5, way), atol=1e-12)


def test_aside_is_to_the_left_as_it_comes_and_leaves_the_whole_base_within_the_span() -> None:
    for inlet, axis, sign in (("top", 1, 1.0), ("left", 0, 1.0), ("right", 0, -1.0)):
        middle = begun(one_by(inlet), inlets=ALL_EDGES).parcels.truth[0, axis]
        for aside in (-1.0, 0.5):
            width = 0.6 if inlet == "top" else 1.0
            found = begun(one_by(inlet, aside), inlets=ALL_EDGES).parcels.truth[0, axis]
            assert found - middle == pytest.approx(sign * aside * 0.5 * (width - 0.2))


@pytest.mark.parametrize("turned", [-2.0, 0.4, math.pi / 2])
def test_a_turned_base_touches_the_edge_and_the_ends_of_the_span(turned: float) -> None:
    batch = begun(one_by("top", 1.0, turned), inlets=ALL_EDGES)
    x, y, theta = batch.parcels.truth[0, :3]
    outline = BOX.base.outline
    corner_x = x + math.cos(theta) * outline[:, 0] - math.sin(theta) * outline[:, 1]
    corner_y = y + math.sin(theta) * outline[:, 0] + math.cos(theta) * outline[:, 1]
    assert corner_x.min() == pytest.approx(0.0, abs=1e-12)
    assert corner_y.max() == pytest.approx(0.7 + 0.3)


def test_one_inlet_that_is_blocked_does_not_hold_up_the_others() -> None:
    arrivals = [Arrival(0.0, BOX, 0.01, "end", "line 1")]
    arrivals += [Arrival(0.01 * k, BOX, 0.8, "end", f"line {k}") for k in (1, 2)]
    batch = begun(Stream(Trace(tuple(arrivals))), inlets=side_by_side(2), tilt=0.0)
    for _ in range(4):
        batch.step(np.full((1, 64), 0))  # all are braked, so that the first bars its line
    assert batch.streams.number[0, :2].tolist() == [0, 2]
    assert batch.infos()["waiting"].tolist() == [1]
    assert batch.streams.coming[0] == 1  # the first that has not entered


def test_origins_share_the_parcels_out() -> None:
    stream = Stream(Steady(90_000.0), parcels=(BOX,), origins={"line 1": 3.0, "line 2": 1.0})
    drawn = stream.draw(np.random.default_rng(0), 200.0, end(), side_by_side(2))
    assert np.bincount(drawn.inlet).tolist() == pytest.approx([3750, 1250], rel=0.05)
    with pytest.raises(ValueError, match="origins must be one of 'line 1', 'line 2', got 'west'"):
        Stream(origins={"west": 1.0}).check(end(), side_by_side(2))


def test_a_window_numbers_so_many_in_a_row_by_chance() -> None:
    drawn = Stream(Steady(3600.0), window=4).draw(np.random.default_rng(0), 100.0, end())
    windows = drawn.number.reshape(-1, 4)
    assert (np.sort(windows) == np.arange(100).reshape(-1, 4)).all()
    assert 10 < (windows[:, 0] % 4 > 0).sum() < 25  # of 25
    plain = Stream(Steady(3600.0)).draw(np.random.default_rng(0), 100.0, end())
    assert plain.number.tolist() == list(range(100))


def test_a_trace_keeps_inlet_place_and_turn(tmp_path) -> None:
    stream = Stream(Steady(3600.0), (BOX,), speeds=0.5, aside=(-1.0, 1.0), turned=(-0.5, 0.5))
    drawn = stream.draw(np.random.default_rng(3), 10.0, end(), side_by_side(3))
    file = tmp_path / "trace.csv"
    write_trace(file, drawn, end(), side_by_side(3))
    again = read_trace(file).within(10.0, end(), side_by_side(3))
    for name in ("time", "speed", "inlet", "aside", "turned"):
        np.testing.assert_array_equal(getattr(again, name), getattr(drawn, name))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (None, "inlets must be Inlets, or a tuple of Inlet objects, got None"),
        ((), "inlets must be at least one Inlet in a tuple"),
        (("top",), "inlets must be Inlet objects, got 'top'"),
        ((Inlet("a"), Inlet("a")), "inlets must have names of their own, got 'a' twice"),
        ((Inlet("far", 0, 2.0, 3.0),), "inlets must lie beside the rotors, from -0.7 to 0.7 m"),
    ],
)
def test_inlets_that_are_bad_are_refused(given, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        EnvConfig("singulate", inlets=given)
    with pytest.raises(ValueError, match="last must be greater than first"):
        Inlet("none", 0, 0.2, 0.1)
