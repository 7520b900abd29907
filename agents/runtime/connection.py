"""Lines over a socket that never waits, and the driver of a machine behind one."""

import socket
from contextlib import suppress

from surface_gym import checks

from . import protocol
from .protocol import MAX_LINE, Angles, DeviceLost, Message

CHUNK = 1 << 16  # [bytes] read at a time
TIMEOUT = 0.05  # [s] to connect


class ConnectionLost(ConnectionError):
    """The other side is gone, does not read, or sends no lines."""


class Connection:
    """One side of a connection; its calls return at once.

    Args:
        connected: a socket, which it closes.
    """

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._socket.setblocking(False)
        with suppress(OSError):  # a pair of sockets has no such option
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._partial = b""
        self._waiting = b""

    def fileno(self) -> int:
        """Return the file descriptor, for `select`."""
        return self._socket.fileno()

    def lines(self) -> list[bytes]:
        """Return the lines since the last call.

        Raises:
            ConnectionLost: the other side is gone and no line is left, or a line is too long.
        """
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
        """Send a line; the part that cannot be sent now is sent before the next.

        Raises:
            ConnectionLost: the other side is gone, or has not read for long.
        """
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
        """Disconnect."""
        self._socket.close()


class SocketDevice:
    """The `Device` behind a socket: the simulator, or a machine that speaks the protocol.

    Args:
        address: host and port.
        task: name of the task that it must do.
        shape: (rows, columns) of the widest zone that it must have.
    """

    def __init__(self, address: tuple[str, int], task: str, shape: tuple[int, int]) -> None:
        self._address = address
        self._task = task
        self._shape = shape
        self._connection: Connection | None = None
        self._greeted = False
        self._command = 0

    def connect(self) -> None:
        """Connect to the device.

        Raises:
            DeviceLost: it is not there.
        """
        self.close()
        try:
            connected = socket.create_connection(self._address, timeout=TIMEOUT)
        except OSError as error:
            raise DeviceLost(f"{self._address} is not there: {error}") from None
        self._connection = Connection(connected)
        self._greeted = False

    def close(self) -> None:
        """Disconnect."""
        if self._connection is not None:
            self._connection.close()
            self._connection = None

    def read(self) -> list[Message]:
        """Return the messages since the last call.

        Raises:
            DeviceLost: it is gone, is another than expected, or breaks the protocol.
        """
        if self._connection is None:
            raise DeviceLost("not connected")
        messages = []
        try:
            for line in self._connection.lines():
                fields = protocol.from_line(line)
                if self._greeted:
                    messages.append(protocol.from_fields(fields, self._shape))
                else:
                    checks.one_of("kind", fields["kind"], ("hello",))
                    checks.one_of("protocol", fields.get("protocol"), (protocol.VERSION,))
                    checks.one_of("task", fields.get("task"), (self._task,))
                    checks.array("zone", fields.get("zone"), (2,))
                    if tuple(fields["zone"]) != self._shape:
                        raise ValueError(f"zone must be {self._shape}, got {fields['zone']}")
                    self._greeted = True
        except (ConnectionLost, ValueError) as error:
            raise DeviceLost(str(error)) from None
        return messages

    def set_axes(self, angles: Angles) -> int:
        """Turn the zone's modules to angles (rows, columns) [rad].

        Raises:
            DeviceLost: it is gone.
        """
        if self._connection is None:
            raise DeviceLost("not connected")
        self._command += 1
        try:
            self._connection.send(protocol.to_line(protocol.axes_to_fields(self._command, angles)))
        except (ConnectionLost, ValueError) as error:
            raise DeviceLost(str(error)) from None
        return self._command
