"""Traces: read, written and read back, and files that are damaged."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

import surface_gym as sg
from surface_gym.flow.arrivals import (
    COLUMNS,
    Arrival,
    Arrivals,
    Schedule,
    Trace,
    read_trace,
    write_trace,
)
from surface_gym.flow.exits import Exit, Exits, chutes, sides
from surface_gym.flow.stream import Stream

HEADER = "time,length,width,mass,speed,exit\n"
FIRST = "0,0.25,0.25,10,1.5,left\n"
SMALL = sg.layouts.box("S")
ARRIVAL = Arrival(2.0, SMALL, 1.5, "left")

arrivals_of_a_trace = st.builds(
    Arrival,
    time=st.floats(0.0, 1e6),
    parcel=st.builds(
        lambda length, width, mass: sg.Parcel(sg.Rectangle(length, width), mass),
        *[st.floats(0.01, 2.0)] * 3,
    ),
    speed=st.floats(0.01, 5.0),
    exit=st.sampled_from(("left", "right", 'the "third", with a comma', "ø\n2")),
)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "trace.csv"


def read(path: Path, text: str, exits: Exits | None = None) -> Trace:
    path.write_bytes(text.encode())
    return read_trace(path, exits)


def test_a_file_is_read(path: Path) -> None:
    trace = read(path, HEADER + FIRST + "1.5,0.4,0.3,2.5,0.75,right\n", sides())
    large = sg.Parcel(sg.Rectangle(0.4, 0.3), mass=2.5)
    first, second = Arrival(0.0, SMALL, 1.5, "left"), Arrival(1.5, large, 0.75, "right")
    assert trace.arrivals == (first, second)
    assert trace.names == ("left", "right")


@pytest.mark.parametrize(
    "text",
    [
        "exit,speed,mass,width,length,time\nleft,1.5,10,0.25,0.25,0\n",  # another order
        "\ufeff" + HEADER + FIRST,  # as spreadsheets mark UTF-8
        HEADER.replace("\n", "\r\n") + FIRST.replace("\n", "\r\n"),
        "\n" + HEADER + "\n" + FIRST + "\n\n",
        HEADER.replace(",", " , ") + FIRST.replace(",", " , "),
        HEADER + '"0","0.25","0.25","1e1","1.5","left"\n',
    ],
)
def test_ways_to_write_the_same(path: Path, text: str) -> None:
    assert read(path, text) == Trace((Arrival(0.0, SMALL, 1.5, "left"),))


def test_parcels_that_are_alike_are_one() -> None:
    alike = sg.Parcel(sg.Rectangle(0.25, 0.25))
    other = sg.Parcel(sg.Rectangle(0.25, 0.25), mass=9.0)
    trace = Trace(tuple(Arrival(0.0, each, 1.0, "left") for each in (SMALL, other, alike)))
    assert trace.kinds == (SMALL, other)
    assert trace.within(1.0, sides()).parcel.tolist() == [0, 1, 0]


def test_what_is_drawn_has_the_exits_of_the_line_and_does_not_change_the_trace() -> None:
    trace = Trace((ARRIVAL,))
    trace.within(9.0, sides()).time[0] = -1.0
    assert trace.within(9.0, sides()).time.tolist() == [2.0]
    straight_first = Exits((Exit("straight", 0), Exit("left", 1)))
    assert trace.within(9.0, sides()).exit.tolist() == [0]
    assert trace.within(9.0, straight_first).exit.tolist() == [1]
    trace.check(sides())
    for call in (trace.check, lambda exits: trace.within(9.0, exits)):
        with pytest.raises(ValueError, match=r"exit must be one of 'left 1', .*, got 'left'"):
            call(chutes())
    together = Trace([ARRIVAL, ARRIVAL]).within(9.0, sides())
    assert isinstance(together, Arrivals)
    assert together.time.tolist() == [2.0, 2.0]


@given(st.lists(arrivals_of_a_trace, min_size=1, max_size=8))
def test_any_trace_is_read_back_the_same(tmp_path_factory: Any, arrivals: list[Arrival]) -> None:
    trace = Trace(tuple(sorted(arrivals, key=lambda each: each.time)))
    exits = Exits(tuple(Exit(name, 1, k, k + 1) for k, name in enumerate(trace.names)))
    path = tmp_path_factory.mktemp("traces") / "trace.csv"
    write_trace(path, trace.within(1e7, exits), exits)
    assert read_trace(path, exits) == trace


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "line 1: columns must be time, .*, exit, each once, got none"),
        (FIRST, "line 1: column must be one of 'time', .*, got '0'"),
        ("time,time,length,width,mass,speed,exit\n", "line 1: columns must be .* each once"),
        (HEADER, "line 1: a parcel must follow, got the end of the file"),
        (HEADER + FIRST + "1,0.25,0.25,10\n", "line 3: a row must have 6 entries, got 4"),
        (HEADER + "\n\n1,0.25\n", "line 4: a row must have 6 entries, got 2"),
        (HEADER + FIRST + '1,"0.25\n', "line 3: unexpected end of data"),
        (HEADER + FIRST + FIRST[:-3], "line 3 is cut: .* a line break; 2 whole lines stand before"),
        (HEADER + FIRST.replace("left", "le\0ft"), "line 2: it is not text: byte 22 is NUL"),
    ],
)
def test_a_damaged_file_is_refused_by_its_line(path: Path, text: str, message: str) -> None:
    with pytest.raises(ValueError, match=rf"trace\.csv holds no trace: {message}"):
        read(path, text)


@pytest.mark.parametrize(
    ("column", "entry", "message"),
    [
        ("mass", "-3", "be greater than 0, got -3.0"),
        ("mass", "heavy", "be a finite number, got 'heavy'"),
        ("length", "0", "be greater than 0, got 0.0"),
        ("speed", "inf", "be a finite number, got 'inf'"),
        ("speed", "6", "be between 0 and 5, got 6.0"), ("time", "-1", "be at least 0, got -1.0"),
        ("time", "3", "not fall, got 3.0 after 4.0"),
        ("exit", " ", "be text without spaces at its ends, got ''"),
        ("exit", "up", "be one of 'left', 'right', 'straight', got 'up'"),
    ],
)  # fmt: skip
def test_a_damaged_entry_is_refused(path: Path, column: str, entry: str, message: str) -> None:
    row = ["5", "0.25", "0.25", "10", "1.5", "left"]
    row[COLUMNS.index(column)] = entry
    text = HEADER + FIRST + "4,0.25,0.25,10,1.5,left\n" + ",".join(row) + "\n"
    with pytest.raises(ValueError, match=f"holds no trace: line 4: {column} must {message}$"):
        read(path, text, sides())


def test_a_file_that_is_not_there_or_no_text_is_refused(path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        read_trace(path)
    path.write_bytes(HEADER.encode() + b"\xff\xfe\n")
    with pytest.raises(ValueError, match=r"trace\.csv holds no trace: line 2: it is not UTF-8"):
        read_trace(path)


@pytest.mark.parametrize(
    "parcel",
    [
        sg.Parcel(sg.Disc(0.2)),
        sg.Parcel(sg.Rectangle(0.2, 0.2), com_height=0.2),
    ],
)
def test_only_what_can_be_read_back_is_written(path: Path, parcel: sg.Parcel) -> None:
    drawn = Stream(parcels=(parcel,)).draw(np.random.default_rng(0), 60.0, sides())
    with pytest.raises(ValueError, match=r"arrivals must be rectangles with a mass, .* got Parcel"):
        write_trace(path, drawn, sides())
    nobody = Stream(Schedule(((0, 0), (70, 900))))
    with pytest.raises(ValueError, match="arrivals must be at least one parcel, got none"):
        write_trace(path, nobody.draw(np.random.default_rng(0), 60.0, sides()), sides())
    assert not path.exists()


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: replace(ARRIVAL, time=-1.0), "time must be at least 0, got -1.0"),
        (lambda: replace(ARRIVAL, parcel="S"), "parcel must be a Parcel, got 'S'"),
        (lambda: replace(ARRIVAL, speed=5.1), "speed must be between 0 and 5, got 5.1"),
        (lambda: replace(ARRIVAL, exit=""), "exit must be text without spaces at its ends, got ''"),
        (lambda: Trace(()), r"arrivals must be at least one Arrival in a tuple, got \(\)"),
        (lambda: Trace(ARRIVAL), "arrivals must be at least one Arrival in a tuple, got Arrival"),
        (lambda: Trace((ARRIVAL, 3.0)), "arrivals must be Arrival objects, got 3.0"),
        (lambda: Trace((ARRIVAL, replace(ARRIVAL, time=1.0))), "time must not fall, got 1.0 after"),
    ],
)
def test_a_bad_arrival_or_trace_is_refused(make: Callable[[], Any], message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        make()
