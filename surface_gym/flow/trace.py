"""Traces: streams of parcels as they were recorded, in files of comma-separated values."""

import csv
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from typing import TextIO

import numpy as np

from surface_gym import checks
from surface_gym.flow.arrivals import LATEST, Arrivals, check_speed
from surface_gym.flow.exits import Exits, check_name
from surface_gym.parcel import Parcel, Rectangle

COLUMNS = ("time", "length", "width", "mass", "speed", "exit")  # [s, m, m, kg, m/s], a name


@dataclass(frozen=True)
class Arrival:
    """One parcel of a trace.

    Raises:
        ValueError: a negative time, a parcel that is none, a speed that is not positive or more
            than 5 m/s, an exit's name that is no text or empty.
    """

    time: float  # [s]
    parcel: Parcel
    speed: float  # [m/s] along the line
    exit: str  # name of the exit it is to leave by

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", checks.not_negative("time", self.time, LATEST))
        if not isinstance(self.parcel, Parcel):
            raise ValueError(f"parcel must be a Parcel, got {self.parcel!r}")
        object.__setattr__(self, "speed", check_speed("speed", self.speed))
        check_name("exit", self.exit)


@dataclass(frozen=True)
class Trace:
    """A recorded stream: who came when, how fast and where to. Nothing is drawn.

    Raises:
        ValueError: no arrival at all, something that is none, or a time that falls.
    """

    arrivals: tuple[Arrival, ...]

    def __post_init__(self) -> None:
        if not isinstance(self.arrivals, (tuple, list)) or not self.arrivals:
            raise ValueError(
                f"arrivals must be at least one Arrival in a tuple, got {self.arrivals!r}"
            )
        for each in self.arrivals:
            if not isinstance(each, Arrival):
                raise ValueError(f"arrivals must be Arrival objects, got {each!r}")
        for before, after in itertools.pairwise(self.arrivals):
            _check_order(before, after)
        object.__setattr__(self, "arrivals", tuple(self.arrivals))

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Of the exits that parcels leave by, each once."""
        return tuple(dict.fromkeys(each.exit for each in self.arrivals))

    @property
    def kinds(self) -> tuple[Parcel, ...]:
        """The parcels, each once however many are alike."""
        return self._recorded.kinds

    @cached_property
    def _recorded(self) -> Arrivals:
        """All of them, the exits by their places among the names."""
        kinds = tuple(dict.fromkeys(each.parcel for each in self.arrivals))
        kind = {parcel: place for place, parcel in enumerate(kinds)}
        name = {name: place for place, name in enumerate(self.names)}
        return Arrivals(
            time=np.array([each.time for each in self.arrivals]),
            parcel=np.array([kind[each.parcel] for each in self.arrivals]),
            kinds=kinds,
            speed=np.array([each.speed for each in self.arrivals]),
            exit=np.array([name[each.exit] for each in self.arrivals]),
        )

    def check(self, exits: Exits) -> None:
        """Raise a ValueError that names an exit of the trace that is none of some exits."""
        for name in self.names:
            exits.place(name)

    def within(self, duration: float, exits: Exits) -> Arrivals:
        """The arrivals before a duration [s].

        Raises:
            ValueError: an exit of the trace is none of these.
        """
        recorded = self._recorded
        count = int(np.searchsorted(recorded.time, duration))
        place = np.array([exits.place(name) for name in self.names])
        return Arrivals(
            time=recorded.time[:count].copy(),
            parcel=recorded.parcel[:count].copy(),
            kinds=recorded.kinds,
            speed=recorded.speed[:count].copy(),
            exit=place[recorded.exit[:count]],
        )


def read_trace(path: str | PathLike[str], exits: Exits | None = None) -> Trace:
    """Read a trace from a file of comma-separated values (UTF-8).

    The first line names the columns, in any order: time [s], length [m], width [m], mass [kg],
    speed [m/s] and exit, a name. Each further line is a parcel, in order of time; blank ones are
    skipped.

    Args:
        path: of the file.
        exits: that the parcels may leave by; None: not known yet.

    Raises:
        ValueError: what the file holds is not allowed; the error names the line.
        OSError: there is no such file, or it cannot be read.
    """
    arrivals: list[Arrival] = []
    with open(path, encoding="utf-8-sig", newline="") as file:
        lines = csv.reader(file, strict=True)
        rows = filter(None, lines)
        try:
            header = [name.strip() for name in next(rows, [])]
            _check_header(header)
            for row in rows:
                arrival = _arrival(header, row)
                if arrivals:
                    _check_order(arrivals[-1], arrival)
                if exits is not None:
                    exits.place(arrival.exit)
                arrivals.append(arrival)
        except UnicodeDecodeError:
            raise ValueError(f"path must lead to UTF-8 text, got {str(path)!r}") from None
        except (ValueError, csv.Error) as error:
            raise ValueError(f"line {max(1, lines.line_num)}: {error}") from None
    if not arrivals:
        raise ValueError(f"line {lines.line_num}: a parcel must follow, got the end of the file")
    return Trace(tuple(arrivals))


def write_trace(path: str | PathLike[str], arrivals: Arrivals, exits: Exits) -> None:
    """Write the arrivals of an episode, so that `read_trace` reads back the same.

    Args:
        path: of the file; one that is there is replaced.
        arrivals: of the episode.
        exits: that they were drawn with.

    Raises:
        ValueError: no arrivals, or a parcel that is more than a length, a width and a mass.
        OSError: the file cannot be written.
    """
    if len(arrivals) == 0:
        raise ValueError("arrivals must be at least one parcel, got none")
    sizes = [_size(parcel) for parcel in arrivals.kinds]
    with open(path, "w", encoding="utf-8", newline="") as file:
        _write(file, arrivals, sizes, exits.names)


def _write(
    file: TextIO, arrivals: Arrivals, sizes: Sequence[tuple[float, ...]], names: Sequence[str]
) -> None:
    rows = csv.writer(file, lineterminator="\n")
    rows.writerow(COLUMNS)
    for time, kind, speed, leaving in zip(
        arrivals.time.tolist(), arrivals.parcel, arrivals.speed.tolist(), arrivals.exit, strict=True
    ):
        rows.writerow([time, *sizes[kind], speed, names[leaving]])


def _size(parcel: Parcel) -> tuple[float, float, float]:
    """[m, m, kg] the length, width and mass of a parcel that is nothing but these."""
    base = parcel.base
    if not isinstance(base, Rectangle) or parcel != Parcel(base, parcel.mass):
        raise ValueError(
            f"arrivals must be rectangles with a mass, and all else by default, got {parcel!r}"
        )
    return base.length, base.width, parcel.mass


def _check_header(header: list[str]) -> None:
    for name in header:
        checks.one_of("column", name, COLUMNS)
    missing = [name for name in COLUMNS if name not in header]
    if missing or len(header) > len(COLUMNS):
        raise ValueError(
            f"columns must be {', '.join(COLUMNS)}, each once, got {', '.join(header) or 'none'}"
        )


def _arrival(header: list[str], row: list[str]) -> Arrival:
    if len(row) != len(header):
        raise ValueError(f"a row must have {len(header)} entries, got {len(row)}")
    text = dict(zip(header, row, strict=True))
    time, length, width, mass, speed = _numbers(text)
    parcel = Parcel(Rectangle(length, width), mass)
    return Arrival(time, parcel, speed, text["exit"].strip())


def _numbers(text: dict[str, str]) -> Iterator[float]:
    for name in COLUMNS[:-1]:
        try:
            number = float(text[name])
        except ValueError:
            raise ValueError(f"{name} must be a finite number, got {text[name]!r}") from None
        yield checks.number(name, number)


def _check_order(before: Arrival, after: Arrival) -> None:
    if after.time < before.time:
        raise ValueError(f"time must not fall, got {after.time!r} after {before.time!r}")
