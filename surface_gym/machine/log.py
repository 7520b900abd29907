"""Logs of a machine, and what to command for one.

A log is gzipped text (`.jsonl.gz`), each message as a line of JSON. Its first line describes the
surface, and its last line tells how many lines precede it. Each line between has "passed" [s], the
time at which the controller read or sent the message; "way": "in" from the machine, "out" to it, or
"note"; and "message". A note has the kind "site": where the rotors are, and which modules obey, for
the parcels that follow.
"""

import gzip
import json
import math
import zlib
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from surface_gym import checks, files
from surface_gym.layouts import ROLLING
from surface_gym.lines import BaseLine, Site
from surface_gym.machine import messages as ms
from surface_gym.parcel import Parcel
from surface_gym.physics.types import Array, Booleans

VERSION = 1  # of the format
MAX_LINES = 10_000_000
# [s] maximum change of the pictures' median delay over a log; pictures wait up to a control period
# for their reader, more or less as the two rates drift
MAX_DRIFT = 0.05
MAX_TURN = 10.0  # [s] maximum time of a quarter turn
MIN_FRAMES = 8  # minimum pictures of a usable run
KINDS = ("coast", "brake", "steer")  # of successive runs
ROLL = 0.2  # [s] at the start, in which every run coasts
HOLD = (0.12, 0.3)  # [s] range of the time for which axes brake or steer
PAUSE = (0.06, 0.2)  # [s] range of the time for which they roll between


def excitation(
    shape: tuple[int, int], seconds: float, *, run: int = 0, period: float = 0.04
) -> Array:
    """Return the axes (periods, rows, columns) [rad] of a run to record.

    Runs of three kinds take turns: the parcel coasts; it is braked in short pulses; it is steered
    in short pulses of 45 deg to either side. All modules of the zone do the same. A dozen runs
    suffice for most parameters; runs of one kind do not.

    Args:
        shape: (rows, columns) of the widest zone.
        seconds: [s] duration.
        run: number of the run; equal numbers give equal commands.
        period: [s] between commands.
    """
    rows, columns = (checks.integer("shape", each, least=1) for each in shape)
    seconds = checks.positive("seconds", seconds, *checks.DURATION)
    period = checks.positive("period", period, *checks.CONTROL_PERIOD)
    kind = KINDS[checks.integer("run", run, least=0) % len(KINDS)]
    rng = np.random.default_rng([run, len(KINDS)])
    angles = np.full(max(1, round(seconds / period)), ROLLING)
    begin, side = ROLL + rng.uniform(*PAUSE), 1.0 if rng.random() < 0.5 else -1.0
    while kind != "coast" and begin < seconds:
        end = begin + rng.uniform(*HOLD)
        angle = 0.0 if kind == "brake" else side * 0.25 * math.pi
        angles[math.ceil(begin / period) : math.ceil(end / period)] = angle
        begin, side = end + (rng.uniform(*PAUSE) if rng.random() < 0.7 else 0.0), -side
    return np.broadcast_to(angles[:, np.newaxis, np.newaxis], (len(angles), rows, columns)).copy()


@dataclass(frozen=True, eq=False)
class LoggedSurface:
    """The machine's surface, as its builder knows it."""

    rows: int  # of elements
    columns: int
    pitch: tuple[float, float]  # [m] in x and y
    origin: tuple[float, float]  # [m] centre of element [0, 0]
    friction: tuple[float, float, float]  # [-] assumed mu_max, mu_min and mu_support
    quarter_turn: float  # [s] assumed time in which an axis turns by 90 deg
    zone: tuple[int, int]  # (rows, columns) of the widest zone, the shape of commands

    def __post_init__(self) -> None:
        count = (checks.integer, 1, checks.ELEMENTS)
        checks.settle(self, rows=count, columns=count, pitch=checks.pitch, origin=checks.place)
        checks.not_negative("quarter_turn", self.quarter_turn, MAX_TURN)
        pitch = self.pitch if isinstance(self.pitch, tuple) else (self.pitch, self.pitch)
        friction = checks.array("friction", self.friction, (3,)).tolist()
        for name, mu in zip(("mu_max", "mu_min", "mu_support"), friction, strict=True):
            checks.friction(name, mu, (1, 1))
        zone = tuple(checks.integer("zone", each, least=1) for each in self.zone)
        checks.set_fields(self, pitch=pitch, friction=tuple(friction), zone=zone)

    @classmethod
    def of_line(cls, line: BaseLine, quarter_turn: float, zone: tuple[int, int]) -> "LoggedSurface":
        """Describe an environment's line.

        Raises:
            ValueError: friction differs between elements.
        """
        friction = line.friction.reshape(-1, 3)
        if np.ptp(friction, axis=0).any():
            raise ValueError("line must have one friction of each kind to be logged, got several")
        pitch = (line.pitch_x, line.pitch_y)
        mu_max, mu_min, mu_support = friction[0].tolist()
        return cls(
            line.rows, line.columns, pitch, line.origin, (mu_max, mu_min, mu_support),
            quarter_turn, zone,
        )  # fmt: skip


class LogWriter:
    """Writes a log; `close` completes it.

    Args:
        file: the log's file, which must not exist.
        surface: the machine's surface.
    """

    def __init__(self, file: Path, surface: LoggedSurface) -> None:
        file.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._stream = gzip.GzipFile(file, "xb", compresslevel=1)
        except FileExistsError:
            raise ValueError(f"log must be a new file, got {str(file)!r}, which exists") from None
        self._lines = 0
        self._write({"kind": "log", "version": VERSION, "surface": vars(surface)})

    def write(self, passed: float, way: str, message: dict[str, Any]) -> None:
        """Write a message that passed at a time [s]; `way` is "in", "out" or "note"."""
        self._write({"passed": passed, "way": way, "message": message})

    def write_site(self, passed: float, site: Site) -> None:
        """Write the rotors and the zone for the parcels that follow."""
        rotor = ["".join("01"[each] for each in row) for row in site.rotor.tolist()]
        self.write(passed, "note", {"kind": "site", "rotor": rotor, "zone": list(site.zone)})

    def close(self) -> None:
        if not self._stream.closed:
            self._write({"kind": "end", "lines": self._lines})
            self._stream.close()

    def _write(self, fields: dict[str, Any]) -> None:
        self._stream.write(ms.to_line(fields))
        self._lines += 1


@dataclass(frozen=True, eq=False)
class LoggedRun:
    """The passage of one parcel over the surface."""

    parcel: Parcel
    tilt: float  # [rad] stated tilt of the surface, downhill towards +x
    rotor: Booleans  # (rows, columns) a rotor, else a support
    taken: Array  # (frames,) [s] times of the pictures
    poses: Array  # (frames, 3) [m, m, rad] of the base's centroid
    sent: Array  # (commands,) [s] times at which the axes began to turn, or of the commands
    axes: Array  # (commands, rows, columns) [rad] of the whole surface
    acknowledged: bool  # whether the machine said when the axes of each command began to turn


@dataclass(frozen=True, eq=False)
class MachineLog:
    """The runs of a log."""

    surface: LoggedSurface
    runs: tuple[LoggedRun, ...]
    unused: dict[str, int]  # number of other runs by reason
    delay: float  # [s] median time from a picture's stated time to its message


@dataclass
class _Passage:
    """Messages of a parcel that is on the surface."""

    entry: ms.ParcelEntry
    site: Site
    frames: dict[float, ms.Triple] = field(default_factory=dict)
    sent: dict[int, tuple[float, Array]] = field(default_factory=dict)
    begun: dict[int, float] = field(default_factory=dict)
    refused: set[int] = field(default_factory=set)


def read_log(file: Path) -> MachineLog:
    """Read a log.

    Raises:
        ValueError: the file is no log, is not complete, or has times that contradict each other.
        FileNotFoundError: the file does not exist.
    """
    try:
        return _LogReader(_fields(file)).read()
    except FileNotFoundError:
        raise
    except (ValueError, KeyError, TypeError, OSError, EOFError, zlib.error) as error:
        raise ValueError(f"{file} must be a complete log: {files.describe_damage(error)}") from None


def _fields(file: Path) -> Iterator[tuple[int, dict[str, Any]]]:
    """Yield the number and the fields of each line."""
    files.check_plain(file, files.TABLE)
    with gzip.open(file, "rb") as stream:
        for number in range(1, MAX_LINES + 1):
            line = stream.readline(files.LINE)
            if not line:
                return
            try:
                fields = json.loads(line.decode(), parse_constant=files.refuse_constant)
            except (ValueError, RecursionError) as error:
                raise ValueError(files.describe_at_line(error, number)) from None
            if not line.endswith(b"\n") or not isinstance(fields, dict):
                raise ValueError(f"line {number} must be an object of less than {files.LINE} bytes")
            yield number, fields
    raise ValueError(f"it must have at most {MAX_LINES} lines, got more")


class _LogReader:
    """Collects the runs of a log, line by line."""

    def __init__(self, lines: Iterator[tuple[int, dict[str, Any]]]) -> None:
        self._lines = lines
        self._passage: _Passage | None = None
        self._site: Site | None = None
        self._runs: list[LoggedRun] = []
        self._unused: Counter[str] = Counter()
        self._delays: list[float] = []  # [s] from pictures to their messages
        self._surface = self._read_header()

    def _read_header(self) -> LoggedSurface:
        _, header = next(self._lines, (0, {}))
        checks.one_of("kind", header.get("kind"), ("log",))
        checks.one_of("version", header.get("version"), (VERSION,))
        given = header["surface"]
        return LoggedSurface(**given)

    def read(self) -> MachineLog:
        before, number, ended = -math.inf, 1, False
        for number, fields in self._lines:
            if ended:
                raise ValueError(f"line {number} follows the last line")
            if fields.get("kind") == "end":
                checks.one_of("lines", fields.get("lines"), (number - 1,))
                ended = True
                continue
            try:
                passed = checks.number("passed", fields["passed"])
                if passed < before:
                    raise ValueError(f"passed must not fall, got {passed:g} s after {before:g} s")
                before = passed
                way = checks.one_of("way", fields["way"], ("in", "out", "note"))
                self._take(passed, way, fields["message"])
            except (ValueError, KeyError, TypeError) as error:
                raise ValueError(files.describe_at_line(error, number)) from None
        if not ended:
            raise ValueError(f"it is cut after line {number}: its last line must be an end")
        self._finish("is still on the surface")
        self._check_drift()
        delay = float(np.median(self._delays)) if self._delays else 0.0
        return MachineLog(self._surface, tuple(self._runs), dict(self._unused), delay)

    def _take(self, passed: float, way: str, fields: dict[str, Any]) -> None:
        if way == "note":
            self._take_site(fields)
        elif way == "out":
            number, angles = ms.axes_from_fields(fields, self._surface.zone)
            if self._passage is not None:
                self._passage.sent[number] = (passed, self._whole(angles, self._passage.site))
        else:
            self._take_message(passed, ms.from_fields(fields, self._surface.zone))

    def _take_site(self, fields: dict[str, Any]) -> None:
        checks.one_of("kind", fields["kind"], ("site",))
        shape = (self._surface.rows, self._surface.columns)
        rotor = np.array([[each == "1" for each in row] for row in fields["rotor"]], dtype=bool)
        if rotor.shape != shape:
            raise ValueError(f"rotor must be {shape[0]} rows of {shape[1]}, got {rotor.shape}")
        first_row, rows, first, columns = (
            checks.integer("zone", each, least=0) for each in fields["zone"]
        )
        if first_row + rows > shape[0] or first + columns > shape[1]:
            raise ValueError(f"zone must lie on the surface, got {fields['zone']}")
        if rows > self._surface.zone[0] or columns > self._surface.zone[1]:
            raise ValueError(f"zone must be within {self._surface.zone}, got {fields['zone']}")
        self._site = Site(rotor, (first_row, rows, first, columns))

    def _take_message(self, passed: float, message: ms.Message) -> None:
        if isinstance(message, ms.ParcelEntry):
            self._finish("was followed by another before it left")
            if self._site is None:
                raise ValueError("a site must stand before the first parcel")
            self._passage = _Passage(message, self._site)
            if message.tilt_direction != 0.0:
                self._finish("is on a surface that is tilted in another direction than +x")
        passage = self._passage
        if passage is None:
            return
        if isinstance(message, ms.ParcelDeparture):
            if message.number == passage.entry.number:
                self._finish("")
        elif isinstance(message, ms.Frame):
            self._check_clock("frame", passed, message.taken_at)
            if message.number == passage.entry.number:
                self._delays.append(passed - message.taken_at)
                passage.frames.setdefault(message.taken_at, message.pose)
        elif isinstance(message, ms.AxesAcknowledgement):
            if message.refused:
                passage.refused.add(message.command)
            else:
                self._check_clock("command", passed, message.at)
                passage.begun[message.command] = message.at

    def _check_clock(self, what: str, passed: float, at: float) -> None:
        late = passed - at
        if not -ms.MAX_EARLY <= late <= ms.MAX_LATE:
            raise ValueError(
                f"time of a {what} must be at most {ms.MAX_LATE:g} s before its message and "
                f"{ms.MAX_EARLY:g} s after it, got {late:g} s before: another clock"
            )

    def _check_drift(self) -> None:
        """Refuse pictures whose delay grows or shrinks over the log: their clock runs otherwise."""
        third = len(self._delays) // 3
        if third < MIN_FRAMES:
            return
        drift = float(np.median(self._delays[-third:]) - np.median(self._delays[:third]))
        if abs(drift) > MAX_DRIFT:
            raise ValueError(
                f"times of frames must be by the clock of the messages, got a delay that changes "
                f"by {drift:+.3f} s over the log"
            )

    def _whole(self, angles: ms.Angles, site: Site) -> Array:
        """Return the axes (rows, columns) [rad] of the surface from the widest zone's."""
        whole = np.full(site.rotor.shape, ROLLING)
        first_row, rows, first, columns = site.zone
        margin = (angles.shape[0] - rows) // 2
        whole[first_row : first_row + rows, first : first + columns] = angles[
            margin : margin + rows, :columns
        ]
        return whole

    def _finish(self, fault: str) -> None:
        """Keep the run of the parcel on the surface, or count why it is not used."""
        passage, self._passage = self._passage, None
        if passage is None:
            return
        if not fault and len(passage.frames) < MIN_FRAMES:
            fault = f"has fewer than {MIN_FRAMES} pictures"
        if fault:
            self._unused[f"parcel {fault}"] += 1
        else:
            self._runs.append(_make_run(passage))


def _make_run(passage: _Passage) -> LoggedRun:
    taken = sorted(passage.frames)
    kept = [  # commands after the last picture have no effect that is seen
        number
        for number, (passed, _) in passage.sent.items()
        if number not in passage.refused and passed <= taken[-1]
    ]
    sent = [
        (passage.begun.get(each, passage.sent[each][0]), passage.sent[each][1]) for each in kept
    ]
    sent.sort(key=lambda each: each[0])
    shape = passage.site.rotor.shape
    return LoggedRun(
        parcel=passage.entry.parcel,
        tilt=passage.entry.tilt,
        rotor=passage.site.rotor,
        taken=np.array(taken),
        poses=np.array([passage.frames[each] for each in taken]),
        sent=np.array([at for at, _ in sent]),
        axes=np.array([axes for _, axes in sent]).reshape(-1, *shape),
        acknowledged=all(number in passage.begun for number in kept),
    )
