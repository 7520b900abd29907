"""The messages between a machine and the control loop, and their form on a socket.

A driver of a machine is a `Device`: four calls, none of which waits. All times are [s] by
`time.monotonic()` of the machine that the loop runs on; a driver whose camera has a clock of its
own converts. All poses are those of the centroid of a parcel's base.

On a socket each message is a line of JSON with a `kind`: "hello", "entered", "frame", "taken" or
"left" from the device, and "axes" to it. Lines are checked in full; reading runs no code. Where
there is a token, each side proves by "proof" that it has it, before anything else counts.
"""

import hmac
import json
import math
import secrets
import socket
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.parcel import Base, Disc, Parcel, Polygon, Rectangle

VERSION = 1  # of the protocol, which both sides must have
MAX_LINE = 1 << 18  # [bytes]
MAX_READ = 1 << 15  # [bytes] in a period: at 25 Hz, 0.8 MB/s
MAX_LINES = 64  # in a period: at 25 Hz, 1600 a second
MAX_TIME = 0.01  # [s] in a period, to read them
MAX_FULL = 25  # periods in a row in which as much came
MAX_TEXT = 1000  # characters of a text
MAX_NUMBER = 2**53  # of a parcel or a command
MAX_VERTICES = 256  # of a parcel's base
GREETING_TIMEOUT = 2.0  # [s] from the connection until the other side has proved who it is

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
    tilt: float = 0.0  # [rad] of the surface, downhill towards +x
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
        fields = json.loads(line.decode(), parse_constant=_refuse_constant)
    except (UnicodeDecodeError, json.JSONDecodeError, RecursionError) as error:
        raise ValueError(f"line must be JSON, got {line[:80]!r}: {error}") from None
    if not isinstance(fields, dict) or not isinstance(fields.get("kind"), str):
        raise ValueError(f"line must be an object with a kind, got {line[:80]!r}")
    return fields


def _refuse_constant(name: str) -> None:
    raise ValueError(f"numbers must be finite, got {name}")


def hello(task: str, shape: tuple[int, int], nonce: str = "") -> dict[str, Any]:
    """Return a device's first message: its version, its task and its widest zone.

    A nonce asks the other side to prove that it has the token.
    """
    fields = {"kind": "hello", "protocol": VERSION, "task": task, "zone": list(shape)}
    return {**fields, "nonce": nonce} if nonce else fields


def make_nonce() -> str:
    """Return a text that was never used before, for the other side's proof."""
    return secrets.token_hex(16)


def prove(token: str, side: str, nonce: str) -> str:
    """Return the proof that a side, "loop" or "device", has a token: by the other side's nonce."""
    return hmac.digest(token.encode(), f"{side} {nonce}".encode(), "sha256").hex()


def check_proof(fields: dict[str, Any], token: str, side: str, nonce: str) -> None:
    """Raise a ValueError unless the fields are a side's proof that it has a token."""
    checks.one_of("kind", fields["kind"], ("proof",))
    proof = text("proof", fields.get("proof"))
    if not hmac.compare_digest(proof.encode(), prove(token, side, nonce).encode()):
        raise ValueError("proof must be by the token of this side, got another")


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
        number=None if number is None else _count("number", number),
        pose=_triple("pose", fields["pose"], checks.pose),
        axes=None if axes is None else _numbers("axes", axes, shape),
    )


def _entered(fields: dict[str, Any], _shape: tuple[int, int]) -> Entered:
    path = fields["path"]
    return Entered(
        number=_count("number", fields["number"]),
        at=checks.number("at", fields["at"]),
        parcel=Parcel(_base(fields["base"]), mass=fields["mass"], com_height=fields["com_height"]),
        pose=_triple("pose", fields["pose"], checks.pose),
        velocity=_triple("velocity", fields["velocity"], checks.velocity),
        goal=tuple(_numbers("goal", fields["goal"], (None,)).tolist()),
        tilt=checks.within("tilt", fields["tilt"], -0.5 * math.pi, 0.5 * math.pi),
        path=None if path is None else _numbers("path", path, (None,)),
    )


def _acknowledged(fields: dict[str, Any], _shape: tuple[int, int]) -> AxesAcknowledged:
    return AxesAcknowledged(
        command=_count("command", fields["command"]),
        at=checks.number("at", fields["at"]),
        refused=text("refused", fields["refused"]),
    )


def _departed(fields: dict[str, Any], _shape: tuple[int, int]) -> Departed:
    metrics = fields["figures"]
    if not isinstance(metrics, dict):
        raise ValueError(f"figures must be an object, got {metrics!r}")
    return Departed(
        number=_count("number", fields["number"]),
        outcome=text("outcome", fields["outcome"]),
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
    number = _count("command", fields.get("command"))
    return number, _numbers("angles", fields.get("angles"), shape)


def text(name: str, value: Any) -> str:
    """Return a text that is not too long, or raise an error."""
    if not isinstance(value, str) or len(value) > MAX_TEXT:
        raise ValueError(f"{name} must be text of at most {MAX_TEXT} characters, got {value!r}")
    return value


def _count(name: str, value: Any) -> int:
    return checks.integer(name, value, least=0, most=MAX_NUMBER)


def _numbers(name: str, value: Any, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    """Return finite numbers as an array of a shape; true and false among them are refused."""
    result = np.array(checks.array(name, value, shape))
    if any(isinstance(each, bool) for each in np.array(value, dtype=object).flat):
        raise ValueError(f"{name} must be an array of numbers, got {value!r}")
    return result


def _triple(name: str, value: Any, check: Callable[..., NDArray[np.float64]]) -> Triple:
    first, second, third = check(name, _numbers(name, value, (3,)), (3,)).tolist()
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
            corners = _numbers("corners", fields["corners"], (None, 2))
            if len(corners) > MAX_VERTICES:
                raise ValueError(f"corners must be at most {MAX_VERTICES}, got {len(corners)}")
            return Polygon(corners)
    raise ValueError(f"base must have a radius, a length and a width, or corners, got {fields!r}")


TIMEOUT = 0.02  # [s] to connect


class ConnectionLost(ConnectionError):
    """The other side is gone, does not read, sends no lines, or too much."""


class Connection:
    """One side of a connection; its calls return at once, and take in a bounded amount."""

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._socket.setblocking(False)
        with suppress(OSError):  # a pair of sockets has no such option
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._partial = b""
        self._lines: deque[bytes] = deque()  # that are whole
        self._waiting = b""
        self._full = 0  # calls in a row that took in as much as one may

    def fileno(self) -> int:
        return self._socket.fileno()

    def lines(self) -> list[bytes]:
        """Return at most MAX_LINES lines since the last call, of MAX_READ bytes; others wait."""
        gone, left = False, MAX_READ if len(self._lines) < MAX_LINES else 0
        while left > 0 and not gone:
            try:
                chunk = self._socket.recv(left)
            except BlockingIOError:
                break
            except OSError:
                chunk = b""
            gone = not chunk
            left -= len(chunk)
            self._partial += chunk
        *whole, self._partial = self._partial.split(b"\n")
        self._lines.extend(whole)
        taken = [self._lines.popleft() for _ in range(min(MAX_LINES, len(self._lines)))]
        self._full = self._full + 1 if self._lines or left == 0 else 0
        if self._full > MAX_FULL:
            raise ConnectionLost(
                f"the other side must send at most {MAX_LINES} lines and {MAX_READ} bytes a "
                f"period, got more in {self._full} in a row"
            )
        if len(self._partial) > MAX_LINE:
            raise ConnectionLost(f"line must have at most {MAX_LINE} bytes, got more")
        if gone and not taken:
            raise ConnectionLost("the other side is gone")
        return taken

    def put_back(self, lines: list[bytes]) -> None:
        """Keep lines for the next call."""
        self._lines.extendleft(reversed(lines))

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
    """The `Device` behind a socket: the simulator, or a machine that speaks the protocol.

    Args:
        address: host and port where it listens.
        task: that it must have.
        shape: (rows, columns) of the widest zone that it must have.
        token: that both sides prove to have; None: it must ask for none.
        now: the clock [s] of the greeting's timeout.
    """

    def __init__(
        self,
        address: tuple[str, int],
        task: str,
        shape: tuple[int, int],
        token: str | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self._address = address
        self._task = task
        self._shape = shape
        self._token = token
        self._now = now
        self._connection: Connection | None = None
        self._greeted = False  # it has said who it is, and proved it
        self._nonce = ""  # for its proof, which is awaited
        self._until = 0.0  # [s] that it has for it
        self._command = 0

    def connect(self) -> None:
        self.close()
        try:
            connected = socket.create_connection(self._address, timeout=TIMEOUT)
        except OSError as error:
            raise DeviceLost(f"{self._address} is not there: {error}") from None
        self._connection = Connection(connected)
        self._greeted, self._nonce = False, ""
        self._until = self._now() + GREETING_TIMEOUT

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def read(self) -> list[Message]:
        if self._connection is None:
            raise DeviceLost("not connected")
        messages, until = [], self._now() + MAX_TIME
        try:
            lines = self._connection.lines()
            for k, line in enumerate(lines):
                if self._now() > until:
                    self._connection.put_back(lines[k:])
                    break
                fields = from_line(line)
                if self._greeted:
                    messages.append(from_fields(fields, self._shape))
                elif self._token is not None and self._nonce:
                    check_proof(fields, self._token, "device", self._nonce)
                    self._greeted = True
                else:
                    self._answer(self._connection, fields)
        except (ConnectionLost, ValueError, RecursionError) as error:
            raise DeviceLost(str(error)) from None
        if not self._greeted and self._now() > self._until:
            raise DeviceLost(f"device must greet within {GREETING_TIMEOUT:g} s, got no greeting")
        return messages

    def _answer(self, connection: Connection, fields: dict[str, Any]) -> None:
        """Check a greeting, and prove to have the token if there is one."""
        checks.one_of("kind", fields["kind"], ("hello",))
        checks.one_of("protocol", fields.get("protocol"), (VERSION,))
        checks.one_of("task", fields.get("task"), (self._task,))
        zone = _numbers("zone", fields.get("zone"), (2,))
        if tuple(zone) != self._shape:
            raise ValueError(f"zone must be {self._shape}, got {fields['zone']}")
        if self._token is None:
            if "nonce" in fields:
                raise ValueError(
                    "token must be given, by --token-file or SURFACE_GYM_TOKEN, got none"
                )
            self._greeted = True
            return
        if "nonce" not in fields:
            raise ValueError("device must ask for the token, got a greeting without a nonce")
        proof = prove(self._token, "loop", text("nonce", fields["nonce"]))
        self._nonce = make_nonce()
        connection.send(to_line({"kind": "proof", "proof": proof, "nonce": self._nonce}))

    def set_axes(self, angles: Angles) -> int:
        if self._connection is None:
            raise DeviceLost("not connected")
        self._command += 1
        try:
            self._connection.send(to_line(axes_to_fields(self._command, angles)))
        except (ConnectionLost, ValueError) as error:
            raise DeviceLost(str(error)) from None
        return self._command
