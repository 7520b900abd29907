"""The messages between a machine and the control loop, and their form on a socket.

A driver of a machine is a `Device`: four calls, none of which waits. All times are [s] by
`time.monotonic()` of the machine that the loop runs on; a driver whose camera has a clock of its
own converts. All poses are those of the centroid of a parcel's base.

On a socket each message is a line of JSON with a `kind`: "hello", "entered", "frame", "taken" or
"left" from the device, and "axes" to it. Lines are checked in full; reading runs no code.
"""

import json
import math
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.parcel import Base, Disc, Parcel, Polygon, Rectangle

VERSION = 1  # of the protocol, which both sides must have
MAX_LINE = 1_000_000  # [bytes]

Angles = NDArray[np.float64]  # (rows, columns) [rad] of the zone's modules, row by row from y < 0
Triple = tuple[float, float, float]


class DeviceLost(ConnectionError):
    """The device is not there, or its messages cannot be understood: connect anew."""


@dataclass(frozen=True, eq=False)
class Entered:
    """A parcel enters."""

    number: int  # of the parcel, which no other has
    at: float  # [s] of the pose and the velocity
    parcel: Parcel  # its base and mass; its load is taken as evenly spread
    pose: Triple  # [m, m, rad] roughly, by the conveyor and its guides
    velocity: Triple  # [m/s, m/s, rad/s] roughly
    goal: tuple[float, ...]  # of the task, as its starts have it
    tilt: float = 0.0  # [rad] of the surface
    path: NDArray[np.float64] | None = None  # (PATH_POINTS,) [m] y of a path to follow


@dataclass(frozen=True, eq=False)
class Frame:
    """A picture of the camera."""

    taken_at: float  # [s]
    number: int | None = None  # of the parcel seen; None: there is none on the surface
    pose: Triple = (0.0, 0.0, 0.0)  # [m, m, rad]; the angle is continuous beyond pi
    axes: Angles | None = None  # by encoders at that time; None: there are none


@dataclass(frozen=True)
class AxesAcknowledged:
    """The device has answered a command of axes."""

    command: int  # the number that `set_axes` returned
    at: float  # [s] when the axes began to turn
    refused: str = ""  # why the device did not accept them; empty: it did


@dataclass(frozen=True)
class Departed:
    """A parcel has left."""

    number: int  # of the parcel
    outcome: str  # in words; "success" is one
    metrics: dict[str, float] = field(default_factory=dict)  # of the task, as in `info`


Message = Entered | Frame | AxesAcknowledged | Departed


class Device(Protocol):
    """A machine: a camera over a surface whose axes turn.

    Each call returns at once. A lasting fault is a `DeviceLost`, after which the loop calls `close`
    and, after a while, `connect` again.
    """

    def connect(self) -> None:
        """Find the device and start anew."""

    def close(self) -> None:
        """Disconnect, if it is connected."""

    def read(self) -> list[Message]:
        """Return the messages since the last call, in their order."""

    def set_axes(self, angles: Angles) -> int:
        """Turn the zone's modules to angles (rows, columns) [rad] in -pi/2 to pi/2.

        The zone is the widest there is; angles of places without a module have no effect.

        Returns:
            A number for the command, to which an `AxesAcknowledged` may refer later.
        """


def to_line(fields: dict[str, Any]) -> bytes:
    """Return a message as a line."""
    return json.dumps(fields, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def from_line(line: bytes) -> dict[str, Any]:
    """Return the fields of a line."""
    try:
        fields = json.loads(line, parse_constant=_refuse_constant)
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"line must be JSON, got {line[:80]!r}: {error}") from None
    if not isinstance(fields, dict) or not isinstance(fields.get("kind"), str):
        raise ValueError(f"line must be an object with a kind, got {line[:80]!r}")
    return fields


def _refuse_constant(name: str) -> None:
    raise ValueError(f"numbers must be finite, got {name}")


def hello(task: str, shape: tuple[int, int]) -> dict[str, Any]:
    """Return a device's first message: its version, its task and its widest zone."""
    return {"kind": "hello", "protocol": VERSION, "task": task, "zone": list(shape)}


def to_fields(message: Message) -> dict[str, Any]:
    """Return the fields of a device's message."""
    if isinstance(message, Frame):
        return {
            "kind": "frame",
            "taken": message.taken_at,
            "number": message.number,
            "pose": list(message.pose),
            "axes": None if message.axes is None else message.axes.tolist(),
        }
    if isinstance(message, Entered):
        return {
            "kind": "entered",
            "number": message.number,
            "at": message.at,
            "base": _base_fields(message.parcel.base),
            "mass": message.parcel.mass,
            "com_height": message.parcel.com_height,
            "pose": list(message.pose),
            "velocity": list(message.velocity),
            "goal": list(message.goal),
            "tilt": message.tilt,
            "path": None if message.path is None else message.path.tolist(),
        }
    if isinstance(message, AxesAcknowledged):
        return {
            "kind": "taken",
            "command": message.command,
            "at": message.at,
            "refused": message.refused,
        }
    return {
        "kind": "left",
        "number": message.number,
        "outcome": message.outcome,
        "figures": message.metrics,  # so called since the protocol's first version
    }


def from_fields(fields: dict[str, Any], shape: tuple[int, int]) -> Message:
    """Return a device's message of its fields; `shape` is (rows, columns) of the widest zone."""
    kind = checks.one_of("kind", fields["kind"], tuple(_READERS))
    try:
        return _READERS[kind](fields, shape)
    except KeyError as error:
        raise ValueError(f"{kind} must have {error}, got {', '.join(fields)}") from None


def _frame(fields: dict[str, Any], shape: tuple[int, int]) -> Frame:
    number, axes = fields["number"], fields["axes"]
    return Frame(
        taken_at=checks.number("taken", fields["taken"]),
        number=None if number is None else checks.integer("number", number, least=0),
        pose=_triple("pose", fields["pose"]),
        axes=None if axes is None else np.array(checks.array("axes", axes, shape)),
    )


def _entered(fields: dict[str, Any], _shape: tuple[int, int]) -> Entered:
    path = fields["path"]
    return Entered(
        number=checks.integer("number", fields["number"], least=0),
        at=checks.number("at", fields["at"]),
        parcel=Parcel(_base(fields["base"]), mass=fields["mass"], com_height=fields["com_height"]),
        pose=_triple("pose", fields["pose"]),
        velocity=_triple("velocity", fields["velocity"]),
        goal=tuple(checks.array("goal", np.array(fields["goal"], float), (None,)).tolist()),
        tilt=checks.within("tilt", fields["tilt"], -0.5 * math.pi, 0.5 * math.pi),
        path=None if path is None else checks.array("path", path, (None,)),
    )


def _acknowledged(fields: dict[str, Any], _shape: tuple[int, int]) -> AxesAcknowledged:
    return AxesAcknowledged(
        command=checks.integer("command", fields["command"], least=0),
        at=checks.number("at", fields["at"]),
        refused=_text("refused", fields["refused"]),
    )


def _departed(fields: dict[str, Any], _shape: tuple[int, int]) -> Departed:
    metrics = fields["figures"]
    if not isinstance(metrics, dict):
        raise ValueError(f"figures must be an object, got {metrics!r}")
    return Departed(
        number=checks.integer("number", fields["number"], least=0),
        outcome=_text("outcome", fields["outcome"]),
        metrics={name: checks.number(name, value) for name, value in metrics.items()},
    )


_READERS: dict[str, Callable[[dict[str, Any], tuple[int, int]], Message]] = {
    "entered": _entered,
    "frame": _frame,
    "taken": _acknowledged,
    "left": _departed,
}


def axes_to_fields(command: int, angles: Angles) -> dict[str, Any]:
    """Return the fields of a command of axes."""
    return {"kind": "axes", "command": command, "angles": angles.tolist()}


def axes_from_fields(fields: dict[str, Any], shape: tuple[int, int]) -> tuple[int, Angles]:
    """Return the number of a command and its angles (rows, columns) [rad], unchecked."""
    checks.one_of("kind", fields["kind"], ("axes",))
    number = checks.integer("command", fields.get("command"), least=0)
    return number, np.array(checks.array("angles", fields.get("angles"), shape))


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{name} must be text, got {value!r}")
    return value


def _triple(name: str, value: Any) -> tuple[float, float, float]:
    first, second, third = checks.array(name, value, (3,)).tolist()
    return (first, second, third)


def _base_fields(base: Base) -> dict[str, Any]:
    if isinstance(base, Disc):
        return {"radius": base.radius}
    if isinstance(base, Rectangle):
        return {"length": base.length, "width": base.width}
    return {"corners": (base.outline - np.array(base.centroid)).tolist()}


def _base(fields: Any) -> Base:
    if isinstance(fields, dict):
        if set(fields) == {"radius"}:
            return Disc(fields["radius"])
        if set(fields) == {"length", "width"}:
            return Rectangle(fields["length"], fields["width"])
        if set(fields) == {"corners"}:
            return Polygon(fields["corners"])
    raise ValueError(f"base must have a radius, a length and a width, or corners, got {fields!r}")


CHUNK = 1 << 16  # [bytes] read at a time
TIMEOUT = 0.05  # [s] to connect


class ConnectionLost(ConnectionError):
    """The other side is gone, does not read, or sends no lines."""


class Connection:
    """One side of a connection; its calls return at once."""

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._socket.setblocking(False)
        with suppress(OSError):  # a pair of sockets has no such option
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._partial = b""
        self._waiting = b""

    def fileno(self) -> int:
        return self._socket.fileno()

    def lines(self) -> list[bytes]:
        """Return the lines since the last call."""
        gone = False
        while True:
            try:
                chunk = self._socket.recv(CHUNK)
            except BlockingIOError:
                break
            except OSError:
                chunk = b""
            if not chunk:
                gone = True
                break
            self._partial += chunk
            if len(self._partial) > MAX_LINE and b"\n" not in self._partial:
                raise ConnectionLost(f"line must have at most {MAX_LINE} bytes")
        *whole, self._partial = self._partial.split(b"\n")
        if gone and not whole:
            raise ConnectionLost("the other side is gone")
        return whole

    def send(self, line: bytes) -> None:
        """Send a line; the part that cannot be sent now is sent before the next."""
        self._waiting += line
        try:
            while self._waiting:
                self._waiting = self._waiting[self._socket.send(self._waiting) :]
        except BlockingIOError:
            if len(self._waiting) > MAX_LINE:
                raise ConnectionLost("the other side does not read") from None
        except OSError as error:
            raise ConnectionLost(f"the other side is gone: {error}") from None

    def close(self) -> None:
        self._socket.close()


class SocketDevice:
    """The `Device` behind a socket: the simulator, or a machine that speaks the protocol."""

    def __init__(self, address: tuple[str, int], task: str, shape: tuple[int, int]) -> None:
        self._address = address
        self._task = task
        self._shape = shape
        self._connection: Connection | None = None
        self._greeted = False
        self._command = 0

    def connect(self) -> None:
        self.close()
        try:
            connected = socket.create_connection(self._address, timeout=TIMEOUT)
        except OSError as error:
            raise DeviceLost(f"{self._address} is not there: {error}") from None
        self._connection = Connection(connected)
        self._greeted = False

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def read(self) -> list[Message]:
        if self._connection is None:
            raise DeviceLost("not connected")
        messages = []
        try:
            for line in self._connection.lines():
                fields = from_line(line)
                if self._greeted:
                    messages.append(from_fields(fields, self._shape))
                else:
                    checks.one_of("kind", fields["kind"], ("hello",))
                    checks.one_of("protocol", fields.get("protocol"), (VERSION,))
                    checks.one_of("task", fields.get("task"), (self._task,))
                    checks.array("zone", fields.get("zone"), (2,))
                    if tuple(fields["zone"]) != self._shape:
                        raise ValueError(f"zone must be {self._shape}, got {fields['zone']}")
                    self._greeted = True
        except (ConnectionLost, ValueError) as error:
            raise DeviceLost(str(error)) from None
        return messages

    def set_axes(self, angles: Angles) -> int:
        if self._connection is None:
            raise DeviceLost("not connected")
        self._command += 1
        try:
            self._connection.send(to_line(axes_to_fields(self._command, angles)))
        except (ConnectionLost, ValueError) as error:
            raise DeviceLost(str(error)) from None
        return self._command
