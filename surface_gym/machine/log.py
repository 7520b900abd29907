"""Logs of a machine, and commands for runs that are logged.

A log is gzipped text (`.jsonl.gz`) with one message per line, as JSON. The first line describes the
surface, and the last line has the number of lines before it. All other lines have three fields.
"passed" [s] is the time at which the controller read or sent the message. "way" is "in" (from the
machine), "out" (to the machine) or "note". "message" is the message. A note "site" holds for the
parcels that enter after it: where rotors are, which modules are commanded, and whether several
parcels are on the surface at once. A note "tracked" has the numbers and the poses of the parcels
that the controller recognised in a picture of a stream.
"""

import gzip
import json
import math
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from surface_gym import checks, files
from surface_gym.layouts import ROLLING
from surface_gym.lines import BaseLine, Site
from surface_gym.machine import messages as ms
from surface_gym.parcel import Parcel, make_bodies
from surface_gym.physics.collision import World
from surface_gym.physics.rollout import distance_between
from surface_gym.physics.types import STATE_SIZE, Array, Booleans

VERSION = 1  # of the format
MAX_LINES = 10_000_000
# [s] maximum change of the pictures' median delay over a log; pictures wait up to a control period
# for their reader, more or less as the two rates drift
MAX_DRIFT = 0.05
MAX_TURN = 10.0  # [s] maximum time of a quarter turn
MIN_FRAMES = 8  # minimum pictures of a usable run
LOOKBACK = 2.0  # [s] before a parcel's entry from which commands still matter to it
APART = 0.01  # [m] minimum distance of parcels that surely do not touch
BRAKES = 0.4  # [-] share of the pulses that brake; the others steer
RESTS = 0.5  # [-] share of the pulses after which the modules roll
ROLL = 0.2  # [s] at the start, in which the parcel coasts
HOLD = (0.12, 0.3)  # [s] range of the time for which axes brake or steer
PAUSE = (0.06, 0.2)  # [s] range of the time for which they roll between


def excitation(
    shape: tuple[int, int], seconds: float, *, run: int = 0, period: float = 0.04
) -> Array:
    """Return axes (periods, rows, columns) [rad] to command in a run that is logged.

    First, the parcel rolls. Then short pulses brake the parcel (axes at 0 deg), or lead the parcel
    to alternate sides (axes at 45 or -45 deg). All modules of the zone get the same angle. Only
    lateral forces distinguish friction from tilt, because the tilt acts along the line. A dozen
    runs suffice for most parameters.

    Args:
        shape: (rows, columns) of the widest zone.
        seconds: [s] duration of the run.
        run: number of the run, which is the seed of the commands.
        period: [s] time between commands.
    """
    rows, columns = (checks.integer("shape", each, least=1) for each in shape)
    seconds = checks.positive("seconds", seconds, *checks.DURATION)
    period = checks.positive("period", period, *checks.CONTROL_PERIOD)
    rng = np.random.default_rng([checks.integer("run", run, least=0), 3])
    angles = np.full(max(1, round(seconds / period)), ROLLING)
    begin, side = ROLL + rng.uniform(*PAUSE), 1.0 if rng.random() < 0.5 else -1.0
    while begin < seconds:
        end = begin + rng.uniform(*HOLD)
        angle = 0.0 if rng.random() < BRAKES else side * 0.25 * math.pi
        angles[math.ceil(begin / period) : math.ceil(end / period)] = angle
        begin, side = end + (rng.uniform(*PAUSE) if rng.random() < RESTS else 0.0), -side
    return np.broadcast_to(angles[:, np.newaxis, np.newaxis], (len(angles), rows, columns)).copy()


@dataclass(frozen=True, eq=False)
class LoggedSurface:
    """The machine's surface, as known from its construction."""

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

        `quarter_turn` [s] is the time in which an axis turns by 90 deg. `zone` is the
        shape (rows, columns) of commands.

        Raises:
            ValueError: the line's elements differ in friction.
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
    """Writer of a log. The method `close` writes the last line.

    Args:
        file: the log's file, which must not exist.
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
        """Write a message and its time `passed` [s]. `way` is "in", "out" or "note"."""
        self._write({"passed": passed, "way": way, "message": message})

    def write_site(self, passed: float, site: Site, shared: bool = False) -> None:
        """Write the note "site": where rotors are, and which modules are commanded.

        `passed` is the time of the note [s]. The note holds for parcels that enter later. `shared`
        says whether several of these parcels are on the surface at once.
        """
        rotor = ["".join("01"[each] for each in row) for row in site.rotor.tolist()]
        note = {"kind": "site", "rotor": rotor, "zone": list(site.zone), "shared": shared}
        self.write(passed, "note", note)

    def write_tracked(self, passed: float, taken_at: float, poses: Mapping[int, Array]) -> None:
        """Write the note "tracked". `poses` maps numbers of parcels to poses (3,) [m, m, rad].

        The poses are from a picture that was taken at `taken_at` [s]. `passed` is the later time
        [s] at which the controller knew the poses.
        """
        note = {"kind": "tracked", "taken": taken_at, "parcels": list(poses)}
        self.write(passed, "note", {**note, "poses": [each.tolist() for each in poses.values()]})

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
class _LoggedCommand:
    """A command to the machine, and the machine's answer."""

    number: int
    passed: float  # [s]
    axes: Array  # (rows, columns) [rad] of the whole surface
    begun: float | None = None  # [s] at which the axes began to turn
    refused: bool = False


@dataclass
class _Passage:
    """Messages and commands while a parcel is on the surface."""

    entry: ms.ParcelEntry
    site: Site
    commands: list[_LoggedCommand]
    frames: dict[float, ms.Triple] = field(default_factory=dict)
    alone_until: float = math.inf  # [s] time from which another parcel may touch it


def read_log(file: Path) -> MachineLog:
    """Read a log from a file.

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
    """Yield the number and the fields of every line in a log."""
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
    """Reader that collects the runs of a log, line by line."""

    def __init__(self, lines: Iterator[tuple[int, dict[str, Any]]]) -> None:
        self._lines = lines
        self._passages: dict[int, _Passage] = {}  # by the number of the parcel
        self._site: Site | None = None
        self._shared = False  # whether parcels share the surface
        self._recent: list[_LoggedCommand] = []
        self._finished: list[tuple[_Passage, list[float]]] = []  # with the times of pictures
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
        for each in list(self._passages):
            self._finish(each, "is still on the surface")
        self._check_drift()
        delay = float(np.median(self._delays)) if self._delays else 0.0
        # Only now, since the last commands of a parcel are acknowledged after it has left.
        runs = tuple(_make_run(*each) for each in self._finished)
        return MachineLog(self._surface, runs, dict(self._unused), delay)

    def _take(self, passed: float, way: str, fields: dict[str, Any]) -> None:
        if way == "note":
            kind = checks.one_of("kind", fields["kind"], ("site", "tracked"))
            (self._take_site if kind == "site" else self._take_tracked)(fields)
        elif way == "out":
            number, angles = ms.axes_from_fields(fields, self._surface.zone)
            if self._site is not None:
                self._take_command(_LoggedCommand(number, passed, self._whole(angles, self._site)))
        else:
            self._take_message(passed, ms.from_fields(fields, self._surface.zone))

    def _take_site(self, fields: dict[str, Any]) -> None:
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
        self._shared = bool(checks.one_of("shared", fields.get("shared", False), (False, True)))

    def _take_tracked(self, fields: dict[str, Any]) -> None:
        taken = checks.number("taken", fields["taken"])
        poses = checks.pose("poses", np.reshape(fields["poses"], (-1, 3)), (None, 3))
        seen = dict(zip(fields["parcels"], poses, strict=True))
        for number in self._passages.keys() & seen.keys():
            self._passages[number].frames.setdefault(taken, ms.triple(seen[number]))
        for pair in combinations(self._passages.keys() & seen.keys(), 2):
            one, other = (self._passages[number] for number in pair)
            parcels = one.entry.parcel, other.entry.parcel
            if _are_near(parcels, (seen[pair[0]], seen[pair[1]])):
                one.alone_until = min(one.alone_until, taken)
                other.alone_until = min(other.alone_until, taken)

    def _take_command(self, command: _LoggedCommand) -> None:
        self._recent.append(command)
        while len(self._recent) > 1 and self._recent[1].passed < command.passed - LOOKBACK:
            del self._recent[0]
        for passage in self._passages.values():
            passage.commands.append(command)

    def _take_message(self, passed: float, message: ms.Message) -> None:
        if isinstance(message, ms.ParcelEntry):
            if not message.waits:
                self._enter(message)
        elif not (self._passages or self._shared):
            return
        elif isinstance(message, ms.ParcelDeparture):
            self._finish(message.number, "")
        elif isinstance(message, ms.AxesAcknowledgement):
            self._acknowledge(passed, message)
        else:
            self._check_clock("frame", passed, message.taken_at)
            if isinstance(message, ms.Detections):
                self._delays.append(passed - message.taken_at)
            elif message.number in self._passages:
                self._delays.append(passed - message.taken_at)
                self._passages[message.number].frames.setdefault(message.taken_at, message.pose)

    def _enter(self, entry: ms.ParcelEntry) -> None:
        if self._shared and entry.number in self._passages:
            return  # a device says it again to a new connection
        if self._site is None:
            raise ValueError("a site must stand before the first parcel")
        if not self._shared:
            for each in list(self._passages):
                self._finish(each, "was followed by another before it left")
        before = list(self._recent) if self._shared else []
        self._passages[entry.number] = _Passage(entry, self._site, before)
        if entry.tilt_direction != 0.0:
            fault = "is on a surface that is tilted in another direction than +x"
            self._finish(entry.number, fault)

    def _acknowledge(self, passed: float, answer: ms.AxesAcknowledgement) -> None:
        if not answer.refused:
            self._check_clock("command", passed, answer.at)
        for command in reversed(self._recent):
            if command.number == answer.command:
                command.refused = bool(answer.refused)
                command.begun = None if answer.refused else answer.at
                break

    def _check_clock(self, what: str, passed: float, at: float) -> None:
        late = passed - at
        if not -ms.MAX_EARLY <= late <= ms.MAX_LATE:
            raise ValueError(
                f"time of a {what} must be at most {ms.MAX_LATE:g} s before its message and "
                f"{ms.MAX_EARLY:g} s after it, got {late:g} s before: another clock"
            )

    def _check_drift(self) -> None:
        """Raise a ValueError if the pictures' delay drifts, since then two clocks were used."""
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
        """Return the axes (rows, columns) [rad] of the whole surface from the zone's `angles`."""
        whole = np.full(site.rotor.shape, ROLLING)
        first_row, rows, first, columns = site.zone
        margin = (angles.shape[0] - rows) // 2
        whole[first_row : first_row + rows, first : first + columns] = angles[
            margin : margin + rows, :columns
        ]
        return whole

    def _finish(self, number: int, fault: str) -> None:
        """End the passage of parcel `number`. If `fault` is "", keep the passage as a run.

        `fault` says why the passage cannot be used, or is "". The reader counts the unused passages
        of each fault.
        """
        passage = self._passages.pop(number, None)
        if passage is None:
            return
        taken = [each for each in sorted(passage.frames) if each < passage.alone_until]
        if not fault and len(taken) < MIN_FRAMES:
            alone = "" if len(taken) == len(passage.frames) else " before another may touch it"
            fault = f"has fewer than {MIN_FRAMES} pictures{alone}"
        if fault:
            self._unused[f"parcel {fault}"] += 1
        else:
            self._finished.append((passage, taken))


def _are_near(parcels: tuple[Parcel, Parcel], poses: tuple[Array, Array]) -> bool:
    """Return whether the distance of two parcels at poses (3,) [m, m, rad] is at most `APART`."""
    away = float(np.linalg.norm(poses[0][:2] - poses[1][:2]))
    if away > parcels[0].base.reach + parcels[1].base.reach + APART:
        return False
    states = np.zeros((2, STATE_SIZE))
    states[:, :3] = poses  # of the centroid, where an even load has its centre of mass
    bodies = make_bodies([replace(each, com_offset=(0.0, 0.0)) for each in parcels])
    world = World(states, np.ones(2, np.bool_), np.arange(2), bodies)
    return bool(distance_between(world, 0, 1) <= APART)


def _make_run(passage: _Passage, taken: list[float]) -> LoggedRun:
    """Make a run from a passage and its usable pictures; `taken` [s] are the pictures' times."""
    # Commands after the last picture have no effect that is seen.
    sent = [each for each in passage.commands if not each.refused and each.passed <= taken[-1]]
    begun = np.array([each.passed if each.begun is None else each.begun for each in sent])
    order = np.argsort(begun, kind="stable")
    axes = np.array([each.axes for each in sent]).reshape(-1, *passage.site.rotor.shape)
    return LoggedRun(
        parcel=passage.entry.parcel,
        tilt=passage.entry.tilt,
        rotor=passage.site.rotor,
        taken=np.array(taken),
        poses=np.array([passage.frames[each] for each in taken]),
        sent=begun[order],
        axes=axes[order],
        acknowledged=all(each.begun is not None for each in sent),
    )
