"""Messages between a machine and the control loop, and their format on a socket.

A driver of a machine implements `Device`: four calls that never wait. All times are [s] of
`time.monotonic()` on the loop's computer; a driver converts the clock of its camera. All poses
refer to the centroid of a parcel's base.

On a socket, each message is a line of JSON with a `kind`: "hello", "entered", "frame", "taken" or
"left" from the device, and "axes" to it. Lines are fully validated; reading them runs no code. With
a token, each side must first prove by "proof" that it has the token.
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

VERSION = 1  # version of the protocol, equal on both sides
MAX_LINE = 1 << 18  # [bytes]
MAX_READ = 1 << 15  # [bytes] per period: 0.8 MB/s at 25 Hz
MAX_LINES = 64  # lines per period: 1600 per second at 25 Hz
MAX_TIME = 0.01  # [s] reading time per period
MAX_FULL = 25  # maximum successive periods with the maximum amount
MAX_TEXT = 1000  # maximum characters of a text
MAX_NUMBER = 2**53  # maximum number of a parcel or a command
MAX_VERTICES = 256  # maximum vertices of a base
GREETING_TIMEOUT = 2.0  # [s] from the connection to the other side's proof

Angles = NDArray[np.float64]  # (rows, columns) [rad] of the zone's modules, row by row from y < 0
Triple = tuple[float, float, float]


class DeviceLost(ConnectionError):
    """The device is absent, or its messages are invalid: reconnect."""


@dataclass(frozen=True, eq=False)
class ParcelEntry:
    """A parcel enters."""

    number: int  # unique number of the parcel
    at: float  # [s] time of the pose and the velocity
    parcel: Parcel  # base and mass; the load is assumed even
    pose: Triple  # [m, m, rad] roughly, from the conveyor and its guides
    velocity: Triple  # [m/s, m/s, rad/s] roughly
    goal: tuple[float, ...]  # the task's goal, as in its starts
    tilt: float = 0.0  # [rad] tilt of the surface, downhill towards +x
    path: NDArray[np.float64] | None = None  # (PATH_POINTS,) [m] y of the path to follow


@dataclass(frozen=True, eq=False)
class Frame:
    """A picture of the camera."""

    taken_at: float  # [s]
    number: int | None = None  # number of the visible parcel; None: no parcel on the surface
    pose: Triple = (0.0, 0.0, 0.0)  # [m, m, rad]; the angle is continuous beyond pi
    axes: Angles | None = None  # encoder angles at that time; None: no encoders


@dataclass(frozen=True)
class AxesAcknowledgement:
    """The device has answered a command of axes."""

    command: int  # the number that `set_axes` returned
    at: float  # [s] when the axes began to turn
    refused: str = ""  # why the device refused the command; empty: accepted


@dataclass(frozen=True)
class ParcelDeparture:
    """A parcel has departed."""

    number: int  # number of the parcel
    outcome: str  # text, e.g. "success"
    metrics: dict[str, float] = field(default_factory=dict)  # the task's metrics, as in `info`


Message = ParcelEntry | Frame | AxesAcknowledgement | ParcelDeparture


class Device(Protocol):
    """Interface of a machine: a camera over a surface with turning axes.

    Each call returns at once. A lasting fault raises `DeviceLost`. The loop then calls `close` and,
    after a while, `connect` again.
    """

    def connect(self) -> None:
        """Connect to the device and start anew."""

    def close(self) -> None:
        """Disconnect, if connected."""

    def read(self) -> list[Message]:
        """Return the messages since the last call, in order."""

    def set_axes(self, angles: Angles) -> int:
        """Turn the zone's modules to angles (rows, columns) [rad] in -pi/2 to pi/2.

        The zone is the widest one; angles without a module have no effect.

        Returns:
            The number of the command, for a later acknowledgement.
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
    """Return a device's first message: version, task and widest zone.

    A nonce requests the other side's proof of the token.
    """
    fields = {"kind": "hello", "protocol": VERSION, "task": task, "zone": list(shape)}
    return {**fields, "nonce": nonce} if nonce else fields


def make_nonce() -> str:
    """Return a unique text for the other side's proof."""
    return secrets.token_hex(16)


def prove(token: str, side: str, nonce: str) -> str:
    """Return the proof that a side ("loop" or "device") has the token, for the other's nonce."""
    return hmac.digest(token.encode(), f"{side} {nonce}".encode(), "sha256").hex()


def check_proof(fields: dict[str, Any], token: str, side: str, nonce: str) -> None:
    """Raise a ValueError unless the fields contain a valid proof of a side."""
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
    if isinstance(message, ParcelEntry):
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
    if isinstance(message, AxesAcknowledgement):
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
        "figures": message.metrics,  # name since the protocol's first version
    }


def from_fields(fields: dict[str, Any], shape: tuple[int, int]) -> Message:
    """Return a device's message from its fields; `shape` is (rows, columns) of the widest zone."""
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


def _entered(fields: dict[str, Any], _shape: tuple[int, int]) -> ParcelEntry:
    path = fields["path"]
    return ParcelEntry(
        number=_count("number", fields["number"]),
        at=checks.number("at", fields["at"]),
        parcel=Parcel(_base(fields["base"]), mass=fields["mass"], com_height=fields["com_height"]),
        pose=_triple("pose", fields["pose"], checks.pose),
        velocity=_triple("velocity", fields["velocity"], checks.velocity),
        goal=tuple(_numbers("goal", fields["goal"], (None,)).tolist()),
        tilt=checks.within("tilt", fields["tilt"], -0.5 * math.pi, 0.5 * math.pi),
        path=None if path is None else _numbers("path", path, (None,)),
    )


def _acknowledged(fields: dict[str, Any], _shape: tuple[int, int]) -> AxesAcknowledgement:
    return AxesAcknowledgement(
        command=_count("command", fields["command"]),
        at=checks.number("at", fields["at"]),
        refused=text("refused", fields["refused"]),
    )


def _departed(fields: dict[str, Any], _shape: tuple[int, int]) -> ParcelDeparture:
    metrics = fields["figures"]
    if not isinstance(metrics, dict):
        raise ValueError(f"figures must be an object, got {metrics!r}")
    return ParcelDeparture(
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
    """Return the fields of an axis command."""
    return {"kind": "axes", "command": command, "angles": angles.tolist()}


def axes_from_fields(fields: dict[str, Any], shape: tuple[int, int]) -> tuple[int, Angles]:
    """Return the number and the unchecked angles (rows, columns) [rad] of an axis command."""
    checks.one_of("kind", fields["kind"], ("axes",))
    number = _count("command", fields.get("command"))
    return number, _numbers("angles", fields.get("angles"), shape)


def text(name: str, value: Any) -> str:
    """Return a text of limited length, or raise an error."""
    if not isinstance(value, str) or len(value) > MAX_TEXT:
        raise ValueError(f"{name} must be text of at most {MAX_TEXT} characters, got {value!r}")
    return value


def _count(name: str, value: Any) -> int:
    return checks.integer(name, value, least=0, most=MAX_NUMBER)


def _numbers(name: str, value: Any, shape: tuple[int | None, ...]) -> NDArray[np.float64]:
    """Return finite numbers as an array of a shape; booleans raise an error."""
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


TIMEOUT = 0.02  # [s] timeout of connecting


class ConnectionLost(ConnectionError):
    """The other side is gone, does not read, sends no lines, or sends too much."""


class Connection:
    """One side of a connection; calls return at once, and read a bounded amount."""

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._socket.setblocking(False)
        with suppress(OSError):  # socket pairs have no such option
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._partial = b""
        self._lines: deque[bytes] = deque()  # complete lines
        self._waiting = b""
        self._full = 0  # successive calls that read the maximum

    def fileno(self) -> int:
        return self._socket.fileno()

    def lines(self) -> list[bytes]:
        """Return new lines, at most MAX_LINES and MAX_READ bytes; others wait."""
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
        """Send a line; an unsent rest goes before the next line."""
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
    """The `Device` behind a socket: the simulator, or a machine with this protocol.

    Args:
        address: host and port of the device.
        task: required task of the device.
        shape: required (rows, columns) of its widest zone.
        token: shared token that both sides prove; None: the device must not request one.
        now: clock [s] for the timeout of the greeting.
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
        self._greeted = False  # whether it has greeted and proved the token
        self._nonce = ""  # nonce of the awaited proof
        self._until = 0.0  # [s] deadline of the proof
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
        """Check a greeting, and send the proof of the token if there is one."""
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
