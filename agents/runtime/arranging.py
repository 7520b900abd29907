"""Fixed layouts arranged beside the loop: some take tenths of a second of simulation."""

import signal
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Protocol

from surface_gym.settings import Settings

from .deciding import Command, FixedLayouts, Observation

STOP = 5.0  # [s] that the process is given to end


class Arranger(Protocol):
    """Arranges a layout for each parcel."""

    def ask(self, observation: Observation) -> None:
        """A parcel has entered, and is observed so; returns at once."""

    def layout(self) -> Command | None:
        """The command of the parcel asked for last; None: it is not there yet."""


class ArrangedHere:
    """Layouts that are arranged at once, by this process."""

    def __init__(self, layouts: FixedLayouts) -> None:
        self._layouts = layouts
        self._layout: Command | None = None

    def ask(self, observation: Observation) -> None:
        """Arrange."""
        self._layout = self._layouts.arrange(observation)

    def layout(self) -> Command | None:
        """The command."""
        return self._layout


class ArrangedApart:
    """Layouts that a process of its own arranges. Use it as a context.

    Args:
        settings: of the policy's environment.
    """

    def __init__(self, settings: Settings) -> None:
        context = get_context("spawn")
        self._here, there = context.Pipe()
        self._process = context.Process(target=_arrange, args=(settings, there), daemon=True)
        self._process.start()
        there.close()
        self._asked = 0
        self._layout: Command | None = None

    def __enter__(self) -> "ArrangedApart":
        return self

    def __exit__(self, *_: object) -> None:
        self._here.close()
        self._process.join(STOP)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._process.close()

    def wait_until_ready(self, timeout: float) -> bool:
        """Whether the process is there after a time [s] at most."""
        return self._here.poll(timeout) and self._here.recv() == 0

    def ask(self, observation: Observation) -> None:
        """Have a layout arranged."""
        self._asked += 1
        self._layout = None
        self._here.send((self._asked, observation))

    def layout(self) -> Command | None:
        """The command; None: it is not there yet."""
        while self._here.poll():
            asked, layout = self._here.recv()
            if asked == self._asked:
                self._layout = layout
        return self._layout


def _arrange(settings: Settings, connection: Connection) -> None:
    """Arrange what is asked for, until nobody asks any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the loop ends this process
    layouts = FixedLayouts(settings)
    connection.send(0)
    try:
        while True:
            asked, observation = connection.recv()
            while connection.poll():  # the latest is the one that counts
                asked, observation = connection.recv()
            connection.send((asked, layouts.arrange(observation)))
    except (EOFError, OSError):
        connection.close()
