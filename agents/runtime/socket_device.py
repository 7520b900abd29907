"""A device behind a socket: the driver of the simulator, and of whatever speaks as it does."""

import socket

from surface_gym import checks

from .device import Angles, DeviceLost, Message
from .link import Link, LinkLost
from .wire import PROTOCOL, axes_fields, fields_of, line_of, message_of

WAIT = 0.05  # [s] for a connection, and for the first line


def address_of(text: str) -> tuple[str, int]:
    """A host and a port, of "host:port".

    Raises:
        ValueError: it is none.
    """
    host, colon, port = text.rpartition(":")
    if not colon or not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise ValueError(f"address must be host:port, got {text!r}")
    return host, int(port)


class SocketDevice:
    """A `Device` behind a socket.

    Args:
        address: host and port.
        task: name of the task that it must do.
        shape: (rows, columns) of the widest zone that it must have.
    """

    def __init__(self, address: tuple[str, int], task: str, shape: tuple[int, int]) -> None:
        self._address = address
        self._task = task
        self._shape = shape
        self._link: Link | None = None
        self._greeted = False
        self._command = 0

    def connect(self) -> None:
        """Find the device.

        Raises:
            DeviceLost: it is not there.
        """
        self.close()
        try:
            connected = socket.create_connection(self._address, timeout=WAIT)
        except OSError as error:
            raise DeviceLost(f"{self._address} is not there: {error}") from None
        self._link = Link(connected)
        self._greeted = False

    def close(self) -> None:
        """Let go of it."""
        if self._link is not None:
            self._link.close()
            self._link = None

    def read(self) -> list[Message]:
        """All that has come.

        Raises:
            DeviceLost: it is gone, is another than was expected, or says what it must not.
        """
        if self._link is None:
            raise DeviceLost("not connected")
        messages = []
        try:
            for line in self._link.lines():
                fields = fields_of(line)
                if self._greeted:
                    messages.append(message_of(fields, self._shape))
                else:
                    checks.one_of("kind", fields["kind"], ("hello",))
                    checks.one_of("protocol", fields.get("protocol"), (PROTOCOL,))
                    checks.one_of("task", fields.get("task"), (self._task,))
                    checks.array("zone", fields.get("zone"), (2,))
                    if tuple(fields["zone"]) != self._shape:
                        raise ValueError(f"zone must be {self._shape}, got {fields['zone']}")
                    self._greeted = True
        except (LinkLost, ValueError) as error:
            raise DeviceLost(str(error)) from None
        return messages

    def set_axes(self, angles: Angles) -> int:
        """Have the zone's modules turn to angles (rows, columns) [rad].

        Raises:
            DeviceLost: it is gone.
        """
        if self._link is None:
            raise DeviceLost("not connected")
        self._command += 1
        try:
            self._link.send(line_of(axes_fields(self._command, angles)))
        except (LinkLost, ValueError) as error:
            raise DeviceLost(str(error)) from None
        return self._command
