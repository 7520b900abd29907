"""Streams: who comes, where to and how fast, by what odds, and what is refused."""

import dataclasses
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.flow.arrivals import Arrival, Arrivals, Poisson, Schedule, Spread, Steady, Trace
from surface_gym.flow.exits import chutes, sides
from surface_gym.flow.stream import Stream

LONG = 3600.0 * 5  # [s] for statistics: some 6000 parcels
SMALL, LARGE = sg.layouts.box("S"), sg.layouts.box("B")
BAG = sg.Parcel(sg.Disc(0.2), mass=3.0)
TRACE = Trace((Arrival(0.0, SMALL, 1.0, "left"), Arrival(2.5, BAG, 2.0, "straight")))


def drawn(stream: Stream, duration: float = LONG, exits: Any = None, seed: int = 0) -> Arrivals:
    return stream.draw(np.random.default_rng(seed), duration, exits or chutes())


def shares(places: Any, count: int) -> list[float]:
    return (np.bincount(places, minlength=count) / len(places)).tolist()


NAMES = ("time", "parcel", "speed", "exit")


def test_arrivals_are_arrays_of_one_length() -> None:
    arrivals = drawn(Stream(), 60.0)
    assert len(arrivals) == 20
    for name, kind in zip(NAMES, (np.float64, np.int64) * 2, strict=True):
        values = getattr(arrivals, name)
        assert (values.shape, values.dtype) == ((20,), kind)
    assert arrivals.kinds == (SMALL,)
    nobody = drawn(Stream(Schedule(((0, 0), (70, 900)))), 60.0)
    assert [len(getattr(nobody, name)) for name in NAMES] == [len(nobody)] * 4 == [0] * 4


@pytest.mark.parametrize(
    "law", [Steady(900.0), Spread(900.0, 0.5), Poisson(900.0), Schedule(((0, 900),), 0.3)], ids=repr
)
def test_the_seed_fixes_the_stream(law: Any) -> None:
    stream = Stream(law, ("S", "B"), speeds=(1.0, 2.0))
    one, same, other = (drawn(stream, 60.0, seed=seed) for seed in (5, 5, 6))
    assert one.kinds == same.kinds
    for name in NAMES:
        np.testing.assert_array_equal(getattr(one, name), getattr(same, name))
    assert one.speed.tobytes() != other.speed.tobytes()
    np.testing.assert_array_equal(one.time, law.times(np.random.default_rng(5), 60.0))


@pytest.mark.parametrize(
    ("parcels", "destinations", "kinds", "exits"),
    [
        (("S", "B", BAG), None, [1 / 3] * 3, [0.2] * 5),
        (
            (("S", 3), "B", (BAG, 4.0)), {"right 2": 1.0, "left 1": 3.0},
            [0.375, 0.125, 0.5], [0.75, 0.0, 0.0, 0.25, 0.0],
        ),
    ],
)  # fmt: skip
def test_odds_are_equal_or_those_given(
    parcels: Any, destinations: Any, kinds: Any, exits: Any
) -> None:
    arrivals = drawn(Stream(parcels=parcels, destinations=destinations))
    assert arrivals.kinds == (SMALL, LARGE, BAG)
    assert shares(arrivals.parcel, 3) == pytest.approx(kinds, abs=0.03)
    assert shares(arrivals.exit, 5) == pytest.approx(exits, abs=0.03)


def test_speeds_are_uniform_and_do_not_depend_on_kind_and_exit_or_all_the_same() -> None:
    arrivals = drawn(Stream(parcels=("S", "B"), speeds=(0.5, 2.5)))
    together = np.corrcoef([arrivals.parcel, arrivals.exit, arrivals.speed])
    assert np.abs(together - np.eye(3)).max() < 0.05
    speed = arrivals.speed
    assert 0.5 <= speed.min() < 0.51
    assert 2.49 < speed.max() < 2.5
    assert speed.mean() == pytest.approx(1.5, abs=0.03)
    assert set(drawn(Stream(speeds=0.7)).speed) == {0.7}


def test_a_change_of_one_thing_leaves_the_others_as_they_were() -> None:
    stream = Stream(Spread(900.0, 0.5), ("S", "B"), speeds=(1.0, 2.0))
    before = drawn(stream)
    faster = drawn(dataclasses.replace(stream, speeds=3.0))
    np.testing.assert_array_equal(faster.exit, before.exit)
    np.testing.assert_array_equal(faster.parcel, before.parcel)
    all_small = drawn(dataclasses.replace(stream, parcels=("S",)))
    np.testing.assert_array_equal(all_small.speed, before.speed)
    np.testing.assert_array_equal(all_small.time, before.time)


def test_a_steady_stream_goes_on_the_same_in_a_longer_episode() -> None:
    stream = Stream(parcels=("S", "B"), speeds=(1.0, 2.0))
    short, long = drawn(stream, 30.0), drawn(stream, 90.0)
    for name in NAMES:
        np.testing.assert_array_equal(getattr(short, name), getattr(long, name)[: len(short)])


@pytest.mark.parametrize("law", [Steady(900.0), Spread(900.0, 0.5), Poisson(900.0, 0.4)], ids=repr)
def test_another_rate_changes_nothing_else(law: Any) -> None:
    stream = Stream(law, ("S", "B"), {"left 1": 1.0}, (1.0, 2.0))
    faster = stream.with_rate(1800.0)
    assert faster.arrivals == dataclasses.replace(law, rate=1800.0)
    assert dataclasses.replace(faster, arrivals=law) == stream
    assert len(drawn(faster)) == pytest.approx(2 * len(drawn(stream)), rel=0.1)


@pytest.mark.parametrize("law", [Schedule(((0, 900),)), TRACE])
def test_not_every_stream_has_another_rate(law: Any) -> None:
    message = "arrivals must be Steady, Spread or Poisson to have another rate, got (Sch|Trace)"
    with pytest.raises(ValueError, match=message):
        Stream(law).with_rate(900.0)
    with pytest.raises(ValueError, match="rate must be greater than 0, got 0"):
        Stream().with_rate(0)
    with pytest.raises(ValueError, match="least_gap must be at most the mean gap"):
        Stream(Poisson(900.0, 1.0)).with_rate(3601.0)


def test_streams_are_hashable_and_equal_however_they_are_written() -> None:
    one = Stream(Steady(900), ["S", ("B", 2)], {"left": 1, "right": 2}, [1, 2])
    other = Stream(
        Steady(900.0), ((SMALL, 1.0), (LARGE, 2.0)), (("left", 1.0), ("right", 2.0)), (1.0, 2.0)
    )
    assert one == other
    assert len({one, other, Stream(), Stream(TRACE)}) == 3
    assert one.kinds == (SMALL, LARGE)
    with pytest.raises(dataclasses.FrozenInstanceError):
        one.speeds = 1.0


class TestWithATrace:
    def test_it_brings_its_own_parcels_exits_and_speeds(self) -> None:
        rng = np.random.default_rng(0)
        before = rng.bit_generator.state
        arrivals = Stream(TRACE).draw(rng, 60.0, sides())
        assert rng.bit_generator.state == before
        assert arrivals.time.tolist() == [0.0, 2.5]
        assert [arrivals.kinds[place] for place in arrivals.parcel] == [SMALL, BAG]
        assert arrivals.speed.tolist() == [1.0, 2.0]
        assert arrivals.exit.tolist() == [0, 2]
        assert Stream(TRACE).kinds == (SMALL, BAG)
        # Only what comes in time is there.
        assert len(Stream(TRACE).draw(np.random.default_rng(0), 2.5, sides())) == 1

    def test_it_may_be_read_from_a_file(self, tmp_path: Path) -> None:
        path = tmp_path / "trace.csv"
        path.write_text("time,length,width,mass,speed,exit\n1,0.25,0.25,10,1.5,left\n")
        assert Stream.from_csv(path) == Stream(Trace((Arrival(1.0, SMALL, 1.5, "left"),)))
        with pytest.raises(ValueError, match="line 2: exit must be one of"):
            Stream.from_csv(path, chutes())

    @pytest.mark.parametrize(
        "given", [{"parcels": ("B",)}, {"destinations": {"left": 1.0}}, {"speeds": (1.0, 2.0)}]
    )
    def test_no_others_may_be_given(self, given: dict[str, Any]) -> None:
        message = f"^{next(iter(given))} must be left out with a Trace, which has its own, got"
        with pytest.raises(ValueError, match=message):
            Stream(TRACE, **given)


@pytest.mark.parametrize(
    ("stream", "message"),
    [
        (Stream(destinations={"left": 1, "up": 1}), "destinations must be one of .*, got 'up'"),
        (Stream(Trace((Arrival(0, SMALL, 1, "up"),))), "exit must be one of .*, got 'up'"),
    ],
)
def test_exits_that_are_not_there_are_refused(stream: Stream, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        stream.check(sides())
    with pytest.raises(ValueError, match=message):
        drawn(stream, 60.0, sides())


@pytest.mark.parametrize("stream", [Stream(), Stream(TRACE)])
@pytest.mark.parametrize("duration", [0.0, -1.0, math.nan, math.inf, None])
def test_an_episode_must_last(stream: Stream, duration: Any) -> None:
    stream.check(sides())
    with pytest.raises(ValueError, match=r"^duration must be .*, got"):
        drawn(stream, duration, sides())


BAD: dict[str, list[tuple[Any, str]]] = {
    "arrivals": [
        (900.0, "arrivals must be Steady, .* or a Trace, got 900.0"),
    ],
    "parcels": [
        ((), r"parcels must be at least one of 'S', 'B' or a Parcel .*, got \(\)"),
        (("S", "C"), "parcel must be 'S', 'B' or a Parcel, got 'C'"),
        ((("S", 1, 2),), r"parcels must be in pairs with their odds, got \('S', 1, 2"),
        ((("S", 0),), "odds of parcels must be greater than 0, got 0"),
    ],
    "destinations": [
        ({}, r"destinations must be None or the odds of .*, got \(\)"),
        ({1: 1.0}, "destinations must be text without spaces .*, got 1"),
        ((("left", 1), ("left", 2)), "destinations must name each once, got 'left' twice"),
    ],
    "speeds": [
        (5.1, "speeds must be between 0 and 5, got 5.1"),
        ((1.0, math.inf), "speeds must be a finite number, got inf"),
        ((2.0, 1.0), "speeds must be the least and then the greatest, got"),
        ((1.0, 2.0, 3.0), "speeds must be one number or two"),
    ],
}


@pytest.mark.parametrize("name", BAD)
def test_what_is_not_allowed_is_refused(name: str) -> None:
    for value, message in BAD[name]:
        with pytest.raises(ValueError, match=f"^{message}"):
            Stream(**{name: value})
