"""The simulator as a process of this one's: begun, killed and begun again."""

import os
import subprocess
import sys
from pathlib import Path

from .simulator import LISTENING
from .socket_device import address_of

STOP = 5.0  # [s] that it is given to end


class SimulatorProcess:
    """A simulator that is begun at once. Use it as a context: it ends with it.

    Args:
        arguments: of the simulator's command, without a port.
        log: file that takes what it says in error.

    Raises:
        ValueError: it does not begin.
    """

    def __init__(self, arguments: list[str], log: Path) -> None:
        self._arguments = [*arguments, "--parent", str(os.getpid())]
        self._log = log
        self._process = self._begin(0, subprocess.PIPE)
        assert self._process.stdout is not None
        told = self._process.stdout.readline().decode()
        self._process.stdout.close()
        if not told.startswith(LISTENING):
            self.close()
            raise ValueError(f"simulator must begin, got: {log.read_text().strip()[-500:]}")
        self.address = address_of(told.removeprefix(LISTENING).strip())

    def __enter__(self) -> "SimulatorProcess":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def begin_again(self) -> None:
        """Kill it without a warning, and begin another in its place."""
        self._process.kill()
        self._process.wait()
        self._process = self._begin(self.address[1], subprocess.DEVNULL)

    def close(self) -> None:
        """End it."""
        self._process.terminate()
        try:
            self._process.wait(STOP)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _begin(self, port: int, out: int) -> "subprocess.Popen[bytes]":
        module = f"{__name__.rpartition('.')[0]}.simulator"
        with self._log.open("ab") as log:
            return subprocess.Popen(
                [
                    sys.executable,
                    "-m",
                    module,
                    *self._arguments,
                    "--port",
                    str(port),
                ],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=log,
                start_new_session=True,  # Ctrl-C is for the loop, which ends it
            )


class Drill:
    """Kills a simulator every so often.

    Args:
        process: of the simulator.
        every: [s] from kill to kill; 0: never.
        begun: [s] by the loop's clock.
    """

    def __init__(self, process: SimulatorProcess, every: float, begun: float) -> None:
        self._process = process
        self._every = every
        self._next = begun + every
        self.kills = 0

    def turn(self, now: float) -> None:
        """Kill it if it is time to."""
        if self._every > 0.0 and now >= self._next:
            self._next += self._every
            self.kills += 1
            self._process.begin_again()
