"""The simulator: a simulated machine behind a socket or OPC UA, in a separate process.

Start it by `python -m surface_gym.agents.runtime.simulator`, or by `SimulatorProcess` in Python.
"""

import asyncio
import heapq
import os
import secrets
import select
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from surface_gym.config import EnvConfig
from surface_gym.flow.base import StreamTask
from surface_gym.machine import messages as ms

from ..library import find_task
from . import protocol
from .config import TOKEN, SimulatorConfig, find_token, make_env_config, parse_address
from .worlds import SimulatedMachine, SimulatedStream, SimulatedWorld

HOST = "127.0.0.1"  # local only, since messages contain times of the local clock
LISTENING = "listening on "
# [s] maximum delay that the physics catches up; beyond it, the world stands still
MAX_BEHIND = 0.25
MAX_NEWCOMERS = 8  # maximum number of connections without proof
STOP_TIMEOUT = 5.0  # [s] maximum time for the process to end


@dataclass(frozen=True, eq=False)
class _Newcomer:
    """A connection that has not proved the token yet."""

    connection: protocol.Connection
    nonce: str
    until: float  # [s] deadline of the proof


class PacedMachine:
    """A simulated machine that follows a clock, and holds back messages until they are due."""

    def __init__(self, world: SimulatedWorld) -> None:
        self._world = world
        self._outbox: list[tuple[float, int, ms.Message]] = []  # sorted by due time [s]
        self._count = 0
        self.refused = 0  # number of invalid commands

    def advance(self, now: float) -> None:
        """Simulate until `now` [s]."""
        behind = now - self._world.now
        if behind > MAX_BEHIND:
            self._world.stand_still(behind)
        for due, message in self._world.advance(now):
            self._count += 1
            heapq.heappush(self._outbox, (due, self._count, message))

    def due(self, now: float) -> Iterator[ms.Message]:
        """Yield the messages that are due until `now` [s]."""
        while self._outbox and self._outbox[0][0] <= now:
            yield heapq.heappop(self._outbox)[2]

    def rest(self, now: float) -> float:
        """Return the time [s] from `now` until the next message or physics step is due."""
        due = self._outbox[0][0] if self._outbox else self._world.now
        return max(0.0, min(due, self._world.now) - now)

    def set_axes(self, command: int, angles: ms.Angles) -> ms.AxesAcknowledgement:
        answer = self._world.set_axes(command, angles)
        self.refused += bool(answer.refused)
        return answer


class MachineServer(PacedMachine):
    """Server of a simulated machine. It sends messages over a socket, and receives commands.

    The server serves one loop at a time, and refuses other loops. If the server has a token, a loop
    must first prove that the loop has this token, too.
    """

    def __init__(
        self,
        world: SimulatedWorld,
        task: str,
        listener: socket.socket,
        token: str | None = None,
    ) -> None:
        super().__init__(world)
        self._task = task
        self._token = token
        self._newcomers: list[_Newcomer] = []
        self._listener = listener
        self._listener.setblocking(False)
        self._connection: protocol.Connection | None = None

    def step(self, now: float) -> None:
        self.advance(now)
        self._set_axes()  # first, since a loop that is gone makes room
        self._accept(now)
        self._admit(now)
        for message in self.due(now):
            self._send_message(message)

    def wait(self, now: float) -> None:
        """Wait from `now` [s] until a message or physics step is due, or data arrive."""
        ready: list[socket.socket | protocol.Connection] = [self._listener]
        ready += [each.connection for each in self._newcomers]
        if self._connection is not None:
            ready.append(self._connection)
        select.select(ready, [], [], self.rest(now))

    def close(self) -> None:
        self._drop()
        for each in self._newcomers:
            each.connection.close()
        self._listener.close()

    def _accept(self, now: float) -> None:
        try:
            connected, _ = self._listener.accept()
        except OSError:  # no connection, or a closed one
            return
        connection = protocol.Connection(connected)
        if self._token is None:
            self._take(connection, protocol.hello(self._task, self._world.shape))
            return
        nonce = protocol.make_nonce()
        self._newcomers.append(_Newcomer(connection, nonce, now + protocol.GREETING_TIMEOUT))
        with suppress(protocol.ConnectionLost):
            connection.send(ms.to_line(protocol.hello(self._task, self._world.shape, nonce)))
        if len(self._newcomers) > MAX_NEWCOMERS:
            self._newcomers.pop(0).connection.close()

    def _admit(self, now: float) -> None:
        """Accept new clients that prove that they know the token.

        If a proof is wrong or late, close the connection.
        """
        waiting, self._newcomers = self._newcomers, []
        for each in waiting:
            try:
                lines = each.connection.lines()
                if not lines and now <= each.until:
                    self._newcomers.append(each)
                    continue
                fields = ms.from_line(b"".join(lines[:1]))
                assert self._token is not None
                protocol.check_proof(fields, self._token, "loop", each.nonce)
                proof = protocol.prove(self._token, "device", ms.text("nonce", fields.get("nonce")))
            except (protocol.ConnectionLost, ValueError, RecursionError):
                each.connection.close()
            else:
                self._take(each.connection, {"kind": "proof", "proof": proof})

    def _take(self, connection: protocol.Connection, answer: dict[str, Any]) -> None:
        """Connect a control loop and send `answer`. While a loop is connected, refuse new loops."""
        is_free = self._connection is None
        try:
            connection.send(ms.to_line(answer if is_free else {"kind": "busy"}))
        except protocol.ConnectionLost:
            is_free = False
        if not is_free:
            connection.close()
            return
        self._connection = connection
        for message in self._world.greet():
            self._send_message(message)

    def _set_axes(self) -> None:
        if self._connection is None:
            return
        try:
            for line in self._connection.lines():
                fields = ms.from_line(line)
                if fields["kind"] == "gate":
                    self._world.open_gate(*ms.gate_from_fields(fields))
                    continue
                command, angles = ms.axes_from_fields(fields, self._world.shape)
                self._send_message(self.set_axes(command, angles))
        except (protocol.ConnectionLost, ValueError, RecursionError):
            self._drop()

    def _send_message(self, message: ms.Message) -> None:
        self._send(ms.to_line(ms.to_fields(message)))

    def _send(self, line: bytes) -> None:
        if self._connection is not None:
            try:
                self._connection.send(line)
            except protocol.ConnectionLost:
                self._drop()

    def _drop(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None


def serve(server: MachineServer, clock: protocol.Clock, goes_on: Callable[[], bool]) -> None:
    """Run a server in real time while `goes_on()` is true."""
    while goes_on():
        server.step(clock.now())
        server.wait(clock.now())


async def serve_opcua(
    config: SimulatorConfig,
    world: SimulatedWorld,
    place: tuple[str, str],
    clock: protocol.Clock,
    goes_on: Callable[[], bool],
) -> None:
    """Serve a world by OPC UA in real time while `goes_on()` is true.

    `place` holds the task's name, and the token that the control loop sends as its password.
    """
    from .opcua import OpcUaSecurity
    from .opcua_server import OpcUaServer

    task, token = place
    machine = PacedMachine(world)
    server = OpcUaServer(
        task,
        world.shape,
        OpcUaSecurity(token, certificates=config.certificates),
        machine.set_axes,
        clock.now,
        config.host,
        config.opcua or 0,
        open_gate=world.open_gate if world.has_gate else None,
        greet=world.greet,
    )
    await server.start()
    try:
        print(f"{LISTENING}{server.host}:{server.port}", flush=True)
        while goes_on():
            machine.advance(clock.now())
            for message in machine.due(clock.now()):
                await server.publish(ms.to_fields(message))
            await asyncio.sleep(machine.rest(clock.now()))
    finally:
        await server.stop()


def find_env_config(config: SimulatorConfig) -> EnvConfig:
    """Return the configuration of the simulated environment."""
    task, world = find_task(config.task), config.world
    given: dict[str, Any] = {"control_period": config.control_period}
    if isinstance(task, StreamTask):
        given |= {"actions": "parcels", "gate": world.gate}
        if world.most is not None:
            given["max_parcels"] = world.most
        if world.rate is not None:
            given["stream"] = task.stream.with_rate(world.rate)
    return make_env_config(config, task=task, **given)


def make_world(config: SimulatorConfig, env_config: EnvConfig, begun: float) -> SimulatedWorld:
    """Make a configuration's simulated machine. The machine's time begins at `begun` [s]."""
    kind = SimulatedStream if env_config.task.is_stream else SimulatedMachine
    return kind(env_config, config.seed, begun, config.world)


def run_simulator(config: SimulatorConfig) -> None:
    """Serve a simulated machine until Ctrl-C, or until the parent process has ended."""
    clock, env_config = protocol.WallClock(), find_env_config(config)
    world = make_world(config, env_config, clock.now())
    world.advance(clock.now())  # compile now
    token = find_token(config.token_file, make=True)
    assert token is not None

    def goes_on() -> bool:
        return config.parent in (None, os.getppid())

    task = env_config.task.name
    if config.opcua is not None:
        asyncio.run(serve_opcua(config, world, (task, token), clock, goes_on))
        return
    listener = socket.create_server((HOST, config.port))
    server = MachineServer(world, task, listener, token)
    print(f"{LISTENING}{HOST}:{listener.getsockname()[1]}", flush=True)
    try:
        serve(server, clock, goes_on)
    finally:
        server.close()


class SimulatorProcess:
    """Context manager of a simulator in a separate process. The process ends with the context.

    The process gets the token in an environment variable that other users cannot read. The
    default token is random.
    """

    def __init__(self, arguments: list[str], log: Path, token: str | None = None) -> None:
        self.token = token or secrets.token_hex()
        module = f"{__name__.rpartition('.')[0]}.simulator"
        with log.open("ab") as errors:
            self._process = subprocess.Popen(
                [sys.executable, "-m", module, *arguments, "--parent", str(os.getpid())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=errors,
                env={**os.environ, TOKEN: self.token},
                start_new_session=True,  # Ctrl-C only reaches the loop, which ends this process
            )
        assert self._process.stdout is not None
        line = self._process.stdout.readline().decode()
        self._process.stdout.close()
        if not line.startswith(LISTENING):
            self.close()
            raise ValueError(
                f"simulator must start, got: {log.read_text(errors='replace').strip()[-500:]}"
            )
        self.address = parse_address(line.removeprefix(LISTENING).strip())

    def __enter__(self) -> "SimulatorProcess":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._process.terminate()
        try:
            self._process.wait(STOP_TIMEOUT)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command. If it fails, print the error in one line."""
    import tyro

    config = tyro.cli(SimulatorConfig, prog=f"python -m {__package__}.simulator", args=arguments)
    try:
        run_simulator(config)
    except (ValueError, OSError) as error:
        sys.exit(f"error: {error}")
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
