"""Lines over a socket that never waits."""

import socket
from contextlib import suppress

from .wire import LONGEST

PIECE = 1 << 16  # [bytes] read at a time


class LinkLost(ConnectionError):
    """The other side is gone, does not read, or sends what is no line."""


class Link:
    """One side of a connection. Its calls return at once.

    Args:
        connected: a socket, which becomes the link's own.
    """

    def __init__(self, connected: socket.socket) -> None:
        self._socket = connected
        self._socket.setblocking(False)
        with suppress(OSError):  # a pair of sockets has no such option
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._partial = b""
        self._waiting = b""

    def fileno(self) -> int:
        """For `select`."""
        return self._socket.fileno()

    def lines(self) -> list[bytes]:
        """Those that have come since the last call.

        Raises:
            LinkLost: the other side is gone and there is none, or it sends what is no line.
        """
        gone = False
        while True:
            try:
                piece = self._socket.recv(PIECE)
            except BlockingIOError:
                break
            except OSError:
                piece = b""
            if not piece:
                gone = True
                break
            self._partial += piece
            if len(self._partial) > LONGEST and b"\n" not in self._partial:
                raise LinkLost(f"line must have at most {LONGEST} bytes")
        *whole, self._partial = self._partial.split(b"\n")
        if gone and not whole:
            raise LinkLost("the other side is gone")
        return whole

    def send(self, line: bytes) -> None:
        """Send a line; what does not go now goes before the next.

        Raises:
            LinkLost: the other side is gone, or has not read for long.
        """
        self._waiting += line
        try:
            while self._waiting:
                self._waiting = self._waiting[self._socket.send(self._waiting) :]
        except BlockingIOError:
            if len(self._waiting) > LONGEST:
                raise LinkLost("the other side does not read") from None
        except OSError as error:
            raise LinkLost(f"the other side is gone: {error}") from None

    def close(self) -> None:
        """Let go of it."""
        self._socket.close()
