"""A world behind a socket."""

import heapq
import select
import socket
from collections.abc import Callable

from .clock import Clock
from .device import Message
from .link import Link, LinkLost
from .wire import axes_of, fields_of, fields_of_message, hello, line_of
from .world import World

MOST_BEHIND = 0.25  # [s] that the physics makes up for; beyond, the world stands still


class Server:
    """Says what a world has to say to whoever connects, and does what it is told.

    One may be connected at a time; who comes later takes the place of who was there.

    Args:
        world: to serve.
        task: its name.
        listener: a socket that listens, which becomes the server's own.
    """

    def __init__(self, world: World, task: str, listener: socket.socket) -> None:
        self._world = world
        self._task = task
        self._listener = listener
        self._listener.setblocking(False)
        self._link: Link | None = None
        self._outbox: list[tuple[float, int, Message]] = []  # by when each is due
        self._said = 0
        self.refused = 0  # commands that were not allowed

    def turn(self, now: float) -> None:
        """All that is to be done at a time [s]; returns at once."""
        behind = now - self._world.now
        if behind > MOST_BEHIND:
            self._world.stand_still(behind)
        for due, message in self._world.advance(now):
            self._post(due, message)
        self._accept()
        self._obey()
        while self._outbox and self._outbox[0][0] <= now:
            self._say(heapq.heappop(self._outbox)[2])

    def wait(self, now: float) -> None:
        """Wait until there is something to do, from a time [s] on."""
        due = self._outbox[0][0] if self._outbox else self._world.now
        ready: list[socket.socket | Link] = [self._listener]
        if self._link is not None:
            ready.append(self._link)
        select.select(ready, [], [], max(0.0, min(due, self._world.now) - now))

    def close(self) -> None:
        """Let go of all sockets."""
        self._drop()
        self._listener.close()

    def _accept(self) -> None:
        try:
            connected, _ = self._listener.accept()
        except BlockingIOError:
            return
        self._drop()
        self._link = Link(connected)
        self._send(line_of(hello(self._task, self._world.shape)))

    def _obey(self) -> None:
        if self._link is None:
            return
        try:
            for line in self._link.lines():
                command, angles = axes_of(fields_of(line), self._world.shape)
                taken = self._world.set_axes(command, angles)
                self.refused += bool(taken.refused)
                self._say(taken)
        except (LinkLost, ValueError):
            self._drop()

    def _post(self, due: float, message: Message) -> None:
        self._said += 1
        heapq.heappush(self._outbox, (due, self._said, message))

    def _say(self, message: Message) -> None:
        self._send(line_of(fields_of_message(message)))

    def _send(self, line: bytes) -> None:
        if self._link is not None:
            try:
                self._link.send(line)
            except LinkLost:
                self._drop()

    def _drop(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None


def serve(server: Server, clock: Clock, goes_on: Callable[[], bool]) -> None:
    """Serve in real time for as long as it is to go on."""
    while goes_on():
        server.turn(clock.now())
        server.wait(clock.now())
