"""Devices of the control loop, their limits and clocks, and their protocol on a socket.

A machine's driver implements the four calls of `Device`, which never wait. All times are [s] of
`time.monotonic()` on the loop's computer; a driver converts the times of its camera.

On a socket, each message is a line of `surface_gym.machine.messages`. The first line is the
device's "hello". With a token, both sides then send a "proof" that they have the token.
"""

import hmac
import secrets
import socket
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from surface_gym import checks
from surface_gym.machine import messages as ms
from surface_gym.machine.messages import Angles, Message
from surface_gym.physics.types import Array

if TYPE_CHECKING:
    from surface_gym.lines import Site
    from surface_gym.machine.log import LogWriter
    from surface_gym.parcel import Parcel

    from .report import Counts, Latencies

VERSION = 1  # version of the protocol, equal on both sides
MAX_LINE = 1 << 18  # [bytes]
MAX_READ = 1 << 15  # [bytes] per period: 0.8 MB/s at 25 Hz
MAX_LINES = 64  # lines per period: 1600 per second at 25 Hz
MAX_TIME = 0.01  # [s] reading time per period
MAX_FULL = 25  # maximum successive periods with the maximum amount
TIMEOUT = 0.02  # [s] timeout of connecting
RIGHT_ANGLE = 0.5 * np.pi + 1e-9  # [rad] largest angle of an axis
GREETING_TIMEOUT = 2.0  # [s] from the connection to the other side's proof


class DeviceLost(ConnectionError):
    """Error: the device is absent or sends invalid messages. The loop then reconnects."""


class Device(Protocol):
    """Interface of a machine: a camera over a surface with turning axes.

    Each call returns at once. A lasting fault raises `DeviceLost`. The loop then calls `close` and,
    after a while, `connect` again.
    """

    def connect(self) -> None:
        """Connect to the device, at first and after a connection was lost."""

    def close(self) -> None:
        """Disconnect, if connected."""

    def read(self) -> list[Message]:
        """Return the messages since the last call, in order."""

    def set_axes(self, angles: Angles) -> int:
        """Turn the zone's modules to angles (rows, columns) [rad] in -pi/2 to pi/2.

        The array `angles` covers the widest zone. An angle without a module has no effect.

        Returns:
            The number of the command, for a later acknowledgement.
        """


class GatedDevice(Device, Protocol):
    """Interface of a machine that has a gate for a stream of parcels."""

    def open_gate(self, begin: float, end: float) -> None:
        """Let one parcel enter between `begin` and `end` [s], as soon as there is room."""


class Listener(Protocol):
    """Receiver of all messages and commands between a loop and its device. No method waits."""

    def hear(self, messages: Sequence[Message], counts: "Counts", latencies: "Latencies") -> None:
        """Receive a period's messages (possibly none), and the run's counts and latencies."""

    def hear_command(self, number: int, angles: Angles) -> None:
        """Receive the number and the angles (rows, columns) [rad] of a command that was sent."""

    def hear_tracked(self, taken_at: float, poses: Mapping[int, Array]) -> None:
        """Receive the time [s] of a picture, and poses (3,) [m, m, rad] by the parcels' numbers."""


class MessageLog:
    """A `Listener` that writes all messages and commands to a log.

    Args:
        log: the log; the caller closes it.
        site_of: returns a parcel's rotors and zone.
        now: clock [s] of the messages.
        shared: whether parcels share the surface, as in a stream.
    """

    def __init__(
        self, log: "LogWriter", site_of: "Callable[[Parcel], Site]", now: Callable[[], float],
        shared: bool = False,
    ) -> None:  # fmt: skip
        self._log, self._site_of, self._now, self._shared = log, site_of, now, shared

    def hear(self, messages: Sequence[Message], *_: object) -> None:
        passed = self._now()
        for message in messages:
            if isinstance(message, ms.ParcelEntry):
                self._log.write_site(passed, self._site_of(message.parcel), self._shared)
            self._log.write(passed, "in", ms.to_fields(message))

    def hear_command(self, number: int, angles: Angles) -> None:
        self._log.write(self._now(), "out", ms.axes_to_fields(number, angles))

    def hear_tracked(self, taken_at: float, poses: Mapping[int, Array]) -> None:
        self._log.write_tracked(self._now(), taken_at, poses)


class Clock(Protocol):
    """Clock of the loop: the machine's clock, or a test clock."""

    def now(self) -> float:
        """Return a monotonic time [s]."""

    def sleep_until(self, moment: float) -> None:
        """Wait until the time `moment` [s]. Return at once if this time has passed."""


class WallClock:
    """The machine's clock, `time.monotonic()`."""

    def now(self) -> float:
        return time.monotonic()

    def sleep_until(self, moment: float) -> None:
        left = moment - time.monotonic()
        if left > 0.0:
            time.sleep(left)


class AxisLimits:
    """Limits of axis angles. The control loop checks every command, and sends no invalid command.

    Args:
        shape: (rows, columns) of the widest zone.
        allowed: [rad] allowed angles. If None, all angles from -pi/2 to pi/2 are allowed.
    """

    def __init__(self, shape: tuple[int, int], allowed: tuple[float, ...] | None) -> None:
        self._shape = shape
        self._allowed = None if allowed is None else np.array(allowed)

    def fault(self, angles: Angles) -> str:
        """Return why angles (rows, columns) [rad] are invalid, or "" if all angles are valid."""
        if angles.shape != self._shape:
            return f"axes must have the shape {self._shape}, got {angles.shape}"
        if not np.isfinite(angles).all():
            return "axes must be finite"
        if (np.abs(angles) > RIGHT_ANGLE).any():
            return f"axes must be between -pi/2 and pi/2, got {np.abs(angles).max():g} in them"
        if self._allowed is not None:
            apart = np.abs(angles[..., np.newaxis] - self._allowed).min(axis=-1)
            if apart.max() > 1e-9:
                worst = angles.ravel()[int(apart.argmax())]
                return f"axes must be some of those on offer, got {worst:g}"
        return ""


def hello(task: str, shape: tuple[int, int], nonce: str = "") -> dict[str, Any]:
    """Return a device's first message: version, task and widest zone (rows, columns).

    If `nonce`, a random text, is given, the control loop must prove that the loop knows the token.
    """
    fields = {"kind": "hello", "protocol": VERSION, "task": task, "zone": list(shape)}
    return {**fields, "nonce": nonce} if nonce else fields


def check_hello(fields: dict[str, Any], task: str, shape: tuple[int, int]) -> None:
    """Raise a ValueError unless `fields` are a "hello" with `VERSION`, `task` and zone `shape`."""
    checks.one_of("kind", fields["kind"], ("hello",))
    checks.one_of("protocol", fields.get("protocol"), (VERSION,))
    checks.one_of("task", fields.get("task"), (task,))
    zone = ms.numbers("zone", fields.get("zone"), (2,))
    if tuple(zone) != shape:
        raise ValueError(f"zone must be {shape}, got {fields['zone']}")


def make_nonce() -> str:
    """Return a random text. The other side needs this text for its proof; see `prove`."""
    return secrets.token_hex(16)


def prove(token: str, side: str, nonce: str) -> str:
    """Answer a nonce: return the proof that `side` ("loop" or "device") has the token."""
    return hmac.digest(token.encode(), f"{side} {nonce}".encode(), "sha256").hex()


def check_proof(fields: dict[str, Any], token: str, side: str, nonce: str) -> None:
    """Raise a ValueError unless a message's fields contain the proof of a side; see `prove`."""
    checks.one_of("kind", fields["kind"], ("proof",))
    proof = ms.text("proof", fields.get("proof"))
    if not hmac.compare_digest(proof.encode(), prove(token, side, nonce).encode()):
        raise ValueError("proof must be by the token of this side, got another")


class ConnectionLost(ConnectionError):
    """Error: the other side is gone, does not read, sends too long a line, or sends too much."""


class Connection:
    """One side of a socket connection; calls return at once, and read a limited amount."""

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._socket.setblocking(False)
        # A short queue, so that a side that does not read is noticed within seconds.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, MAX_READ)
        with suppress(OSError):  # socket pairs have no such option
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._partial = b""
        self._lines: deque[bytes] = deque()  # complete lines
        self._waiting = b""
        self._full = 0  # successive calls that read the maximum

    def fileno(self) -> int:
        return self._socket.fileno()

    def lines(self) -> list[bytes]:
        """Read at most MAX_READ bytes; return at most MAX_LINES lines, and keep the rest."""
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
        """Put lines back; the next call of the method `lines` returns them first."""
        self._lines.extendleft(reversed(lines))

    def send(self, line: bytes) -> None:
        """Send a line. If the buffer is full, the next `send` begins with the rest of this line."""
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
        shape: required (rows, columns) of the device's widest zone.
        token: secret that the two sides must prove to know. If None, the device must not request a
            proof.
        now: clock [s]. The device must identify itself within `GREETING_TIMEOUT` [s].
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
        self._begun = 0.0  # [s] time of the connection
        self._command = 0

    def connect(self) -> None:
        self.close()
        try:
            connected = socket.create_connection(self._address, timeout=TIMEOUT)
        except OSError as error:
            raise DeviceLost(f"{self._address} is not there: {error}") from None
        self._connection = Connection(connected)
        self._greeted, self._nonce = False, ""
        self._begun = self._now()

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
                fields = ms.from_line(line)
                if self._greeted:
                    messages.append(ms.from_fields(fields, self._shape))
                elif self._token is not None and self._nonce:
                    check_proof(fields, self._token, "device", self._nonce)
                    self._greeted = True
                else:
                    self._answer(self._connection, fields)
        except (ConnectionLost, ValueError, RecursionError) as error:
            raise DeviceLost(str(error)) from None
        age = self._now() - self._begun  # negative if the clock was set back
        if not self._greeted and not 0.0 <= age <= GREETING_TIMEOUT:
            raise DeviceLost(f"device must greet within {GREETING_TIMEOUT:g} s, got no greeting")
        return messages

    def _answer(self, connection: Connection, fields: dict[str, Any]) -> None:
        """Check the device's `hello`. If there is a token, answer with a proof of the token."""
        check_hello(fields, self._task, self._shape)
        if self._token is None:
            if "nonce" in fields:
                raise ValueError(
                    "token must be given, by --token-file or SURFACE_GYM_TOKEN, got none"
                )
            self._greeted = True
            return
        if "nonce" not in fields:
            raise ValueError("device must ask for the token, got a greeting without a nonce")
        proof = prove(self._token, "loop", ms.text("nonce", fields["nonce"]))
        self._nonce = make_nonce()
        connection.send(ms.to_line({"kind": "proof", "proof": proof, "nonce": self._nonce}))

    def set_axes(self, angles: Angles) -> int:
        if self._connection is None:
            raise DeviceLost("not connected")
        self._command += 1
        self._send(ms.axes_to_fields(self._command, angles))
        return self._command

    def open_gate(self, begin: float, end: float) -> None:
        self._send(ms.gate_to_fields(begin, end))

    def _send(self, fields: dict[str, Any]) -> None:
        if self._connection is None:
            raise DeviceLost("not connected")
        try:
            self._connection.send(ms.to_line(fields))
        except (ConnectionLost, ValueError) as error:
            raise DeviceLost(str(error)) from None
