"""The simulator: a machine with the package's physics behind a socket, in a separate process.

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
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import surface_gym as sg
from surface_gym import actions
from surface_gym.config import EnvConfig
from surface_gym.core import batch
from surface_gym.flow.base import StreamTask
from surface_gym.parcel import Base
from surface_gym.physics.step import tilt_of_gravity
from surface_gym.physics.types import COM_HEIGHT, MASS, RADIUS
from surface_gym.state import GRAVITY_COLUMNS, RUNNING, EnvState

from ..library import find_task
from . import controller, estimator, protocol as wire
from .config import TOKEN, SimulatorConfig, WorldOptions, find_token, parse_address
from .stream_simulator import SimulatedStream

if TYPE_CHECKING:
    from .opcua_server import OpcUaServer

HOST = "127.0.0.1"  # local only, since messages contain times of the local clock
LISTENING = "listening on "
ONLY = np.zeros(1, dtype=np.int64)  # index of the only environment
# [s] maximum delay that the physics catches up; beyond it, the world stands still
MAX_BEHIND = 0.25
MAX_NEWCOMERS = 8  # maximum number of connections without proof
STOP_TIMEOUT = 5.0  # [s] maximum time for the process to end


class SimulatedMachine:
    """A surface, its parcels and a camera, driven by the caller's clock.

    The physics is at most one step ahead of the caller's clock, so commanded axes never turn early.
    Frames are delayed by the camera's delay.
    """

    def __init__(
        self, env_config: EnvConfig, seed: int, begun: float, options: WorldOptions
    ) -> None:
        self._camera = estimator.device_camera(env_config.sensors)
        self.dt = env_config.timing.dt
        self._every = self._camera.frame_steps(self.dt)
        self._latency = self._camera.latency
        if self._latency is None:
            self._latency = self._every * self.dt
        self._limit = env_config.task.periods * env_config.timing.steps
        self._batch = batch.Batch(
            replace(
                env_config,
                actions="modules",
                orientations=actions.ANY,
                control_period=self.dt,
                sensors=sg.sensors.Exact(),
                observe=(),
                observe_axes=False,
                info=(),
            ),
            1,
        )
        kind = self._batch.config.action_kind
        self.shape = (kind.rows, kind.columns)
        self._limits = controller.AxisLimits(self.shape, None)
        generator, self._noise = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(2))
        self._batch.seed(0, generator)
        self._options = options
        self._now = begun
        self._step = 0
        self._number = -1
        self._present = False
        self._enters = begun + options.pause
        self._command = np.full((1, kind.size), sg.layouts.ROLLING)

    @property
    def now(self) -> float:
        """Time [s] of the physics."""
        return self._now

    def stand_still(self, seconds: float) -> None:
        """Let time [s] pass without motion, after the physics fell too far behind the clock."""
        self._now += seconds
        self._enters += seconds

    def greet(self) -> list[wire.Message]:
        """Return no messages: control resumes with the next parcel."""
        return []

    def open_gate(self, begin: float, end: float) -> None:
        raise ValueError(f"gate must be that of a stream, got times {begin:g} to {end:g} s")

    def set_axes(self, command: int, angles: wire.Angles) -> wire.AxesAcknowledgement:
        fault = self._limits.fault(angles)
        if not fault:
            self._command[0] = angles.ravel()
        return wire.AxesAcknowledgement(command, self._now, fault)

    def advance(self, until: float) -> list[tuple[float, wire.Message]]:
        """Simulate until a time [s]; return messages with the time [s] at which each is due."""
        messages: list[tuple[float, wire.Message]] = []
        while self._now <= until:
            if not self._present and self._now >= self._enters:
                messages.append((self._now, self._enter()))
            if self._present:
                self._batch.step(self._command)
            self._now += self.dt
            self._step += 1
            if self._step % self._every == 0:
                frame = self._take_frame()
                if frame is not None:
                    assert self._latency is not None
                    messages.append((self._now + self._latency, frame))
            if self._present:
                ends = self._batch.outcome[0] != RUNNING
                if ends or self._batch.parcels.steps[0] >= self._limit:
                    messages.append((self._now, self._depart(bool(ends))))
        return messages

    def _enter(self) -> wire.ParcelEntry:
        self._command[:] = sg.layouts.ROLLING
        self._batch.reset(ONLY)
        self._present = True
        self._number += 1
        state, entry = self._batch.view(0), self._camera.entry
        spread = np.array(
            [entry.position] * 2 + [entry.angle] + [entry.speed] * 2 + [entry.turning]
        )
        tilt, direction = tilt_of_gravity(*state.surface[GRAVITY_COLUMNS].tolist())
        known = state.truth + spread * self._noise.standard_normal(6)
        return wire.ParcelEntry(
            self._number,
            self._now,
            _known_parcel(state),
            wire.triple(known[:3]),
            wire.triple(known[3:]),
            tuple(state.goal.tolist()),
            tilt,
            state.path.copy() if len(state.path) else None,
            direction,
        )

    def _depart(self, ends: bool) -> wire.ParcelDeparture:
        parcels, task = self._batch.parcels, self._batch.task
        self._present = False
        self._enters = self._now + self._options.pause
        outcome = self._batch.outcomes[int(parcels.outcome[0])] if ends else "out of time"
        metrics = dict(zip(task.metrics, parcels.metrics[0].tolist(), strict=True))
        return wire.ParcelDeparture(self._number, outcome, metrics)

    def _take_frame(self) -> wire.Frame | None:
        """Return a frame; None if it is lost."""
        camera = self._camera
        noise, lot = self._noise.standard_normal(3), self._noise.random()
        if lot < camera.drop:
            return None
        if not self._present:
            return wire.Frame(self._now)
        spread = np.array([camera.position_noise] * 2 + [camera.angle_noise])
        pose = self._batch.parcels.truth[0, :3] + spread * noise
        axes = None
        if self._options.encoders:
            axes = estimator.zone_angles(self._batch.axes(0), self._batch.view(0).zone, self.shape)
        return wire.Frame(self._now, self._number, wire.triple(pose), axes)


def _known_parcel(state: EnvState) -> sg.Parcel:
    """Return an environment's parcel with an even load, since a device does not know the load."""
    corners: NDArray[np.float64] = state.corners
    base: Base
    if np.ptp(corners, axis=0).max() == 0.0:
        base = sg.Disc(float(state.body[RADIUS]))
    else:
        apart = np.abs(corners - np.roll(corners, 1, axis=0)).max(axis=1) > 0.0
        base = sg.Polygon(corners[apart])
    return sg.Parcel(base, mass=float(state.body[MASS]), com_height=float(state.body[COM_HEIGHT]))


@dataclass(frozen=True, eq=False)
class _Newcomer:
    """A connection before its proof of the token."""

    connection: wire.Connection
    nonce: str
    until: float  # [s] deadline of the proof


class PacedMachine:
    """A simulated machine in step with a clock, and its messages until they are due."""

    def __init__(self, world: SimulatedMachine | SimulatedStream) -> None:
        self._world = world
        self._outbox: list[tuple[float, int, wire.Message]] = []  # sorted by due time [s]
        self._count = 0
        self.refused = 0  # number of invalid commands

    def advance(self, now: float) -> None:
        """Simulate until a time [s]."""
        behind = now - self._world.now
        if behind > MAX_BEHIND:
            self._world.stand_still(behind)
        for due, message in self._world.advance(now):
            self._count += 1
            heapq.heappush(self._outbox, (due, self._count, message))

    def due(self, now: float) -> Iterator[wire.Message]:
        """Yield the messages that are due at a time [s]."""
        while self._outbox and self._outbox[0][0] <= now:
            yield heapq.heappop(self._outbox)[2]

    def rest(self, now: float) -> float:
        """Return how long [s] there is nothing to do."""
        due = self._outbox[0][0] if self._outbox else self._world.now
        return max(0.0, min(due, self._world.now) - now)

    def set_axes(self, command: int, angles: wire.Angles) -> wire.AxesAcknowledgement:
        answer = self._world.set_axes(command, angles)
        self.refused += bool(answer.refused)
        return answer


class MachineServer(PacedMachine):
    """Server of a simulated machine: sends its messages over a socket, and receives axis commands.

    Only one loop is connected at a time; others are refused until it is gone. With a token, a loop
    must first prove that it has the token.
    """

    def __init__(
        self,
        world: SimulatedMachine | SimulatedStream,
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
        self._connection: wire.Connection | None = None

    def step(self, now: float) -> None:
        self.advance(now)
        self._set_axes()  # first, since a loop that is gone makes room
        self._accept(now)
        self._admit(now)
        for message in self.due(now):
            self._send_message(message)

    def wait(self, now: float) -> None:
        """Wait from a time [s] until a message is due or arrives."""
        ready: list[socket.socket | wire.Connection] = [self._listener]
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
        connection = wire.Connection(connected)
        if self._token is None:
            self._take(connection, wire.hello(self._task, self._world.shape))
            return
        nonce = wire.make_nonce()
        self._newcomers.append(_Newcomer(connection, nonce, now + wire.GREETING_TIMEOUT))
        with suppress(wire.ConnectionLost):
            connection.send(wire.to_line(wire.hello(self._task, self._world.shape, nonce)))
        if len(self._newcomers) > MAX_NEWCOMERS:
            self._newcomers.pop(0).connection.close()

    def _admit(self, now: float) -> None:
        """Accept newcomers that prove the token; close the others."""
        waiting, self._newcomers = self._newcomers, []
        for each in waiting:
            try:
                lines = each.connection.lines()
                if not lines and now <= each.until:
                    self._newcomers.append(each)
                    continue
                fields = wire.from_line(b"".join(lines[:1]))
                assert self._token is not None
                wire.check_proof(fields, self._token, "loop", each.nonce)
                proof = wire.prove(self._token, "device", wire.text("nonce", fields.get("nonce")))
            except (wire.ConnectionLost, ValueError, RecursionError):
                each.connection.close()
            else:
                self._take(each.connection, {"kind": "proof", "proof": proof})

    def _take(self, connection: wire.Connection, answer: dict[str, Any]) -> None:
        """Connect a loop with an answer, or refuse it while another one is connected."""
        is_free = self._connection is None
        try:
            connection.send(wire.to_line(answer if is_free else {"kind": "busy"}))
        except wire.ConnectionLost:
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
                fields = wire.from_line(line)
                if fields["kind"] == "gate":
                    self._world.open_gate(*wire.gate_from_fields(fields))
                    continue
                command, angles = wire.axes_from_fields(fields, self._world.shape)
                self._send_message(self.set_axes(command, angles))
        except (wire.ConnectionLost, ValueError, RecursionError):
            self._drop()

    def _send_message(self, message: wire.Message) -> None:
        self._send(wire.to_line(wire.to_fields(message)))

    def _send(self, line: bytes) -> None:
        if self._connection is not None:
            try:
                self._connection.send(line)
            except wire.ConnectionLost:
                self._drop()

    def _drop(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None


def serve(server: MachineServer, clock: controller.Clock, goes_on: Callable[[], bool]) -> None:
    """Serve in real time while `goes_on()` is true."""
    while goes_on():
        server.step(clock.now())
        server.wait(clock.now())


async def serve_opcua(
    machine: PacedMachine,
    server: "OpcUaServer",
    clock: controller.Clock,
    goes_on: Callable[[], bool],
) -> None:
    """Serve by OPC UA in real time while `goes_on()` is true."""
    await server.start()
    try:
        print(f"{LISTENING}{server.host}:{server.port}", flush=True)
        while goes_on():
            machine.advance(clock.now())
            for message in machine.due(clock.now()):
                await server.publish(wire.to_fields(message))
            await asyncio.sleep(machine.rest(clock.now()))
    finally:
        await server.stop()


def make_env_config(config: SimulatorConfig) -> EnvConfig:
    """Return the configuration of the simulated environment."""
    task, world = find_task(config.task), config.world
    given: dict[str, Any] = {"preset": config.preset, "control_period": config.control_period}
    if isinstance(task, StreamTask):
        given |= {"actions": "parcels", "gate": world.gate}
        if world.most is not None:
            given["max_parcels"] = world.most
        if world.rate is not None:
            given["stream"] = task.stream.with_rate(world.rate)
    return EnvConfig(task=task, **given)


def make_world(config: SimulatorConfig, begun: float) -> SimulatedMachine | SimulatedStream:
    """Make the machine of a configuration, which begins at a time [s]."""
    env_config = make_env_config(config)
    kind = SimulatedStream if env_config.task.is_stream else SimulatedMachine
    return kind(env_config, config.seed, begun, config.world)


def run_simulator(config: SimulatorConfig) -> None:
    """Serve until Ctrl-C, or until the parent process has ended."""
    clock = controller.WallClock()
    world = make_world(config, clock.now())
    world.advance(clock.now())  # compile now
    token = find_token(config.token_file, make=True)
    assert token is not None

    def goes_on() -> bool:
        return config.parent in (None, os.getppid())

    if config.opcua is not None:
        from .opcua import OpcUaSecurity
        from .opcua_server import OpcUaServer

        security = OpcUaSecurity(token, certificates=config.certificates)
        machine = PacedMachine(world)
        task, has_gate = make_env_config(config).task, isinstance(world, SimulatedStream)
        opcua = OpcUaServer(
            task.name,
            world.shape,
            security,
            machine.set_axes,
            clock.now,
            config.host,
            config.opcua,
            open_gate=world.open_gate if has_gate else None,
            greet=world.greet,
        )
        asyncio.run(serve_opcua(machine, opcua, clock, goes_on))
        return
    listener = socket.create_server((HOST, config.port))
    server = MachineServer(world, make_env_config(config).task.name, listener, token)
    print(f"{LISTENING}{HOST}:{listener.getsockname()[1]}", flush=True)
    try:
        serve(server, clock, goes_on)
    finally:
        server.close()


class SimulatorProcess:
    """A simulator in a separate process, which ends with this context.

    The default token is random. The token is passed in an environment variable, which other users
    cannot read.
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
    """Run the command; an error ends it with one line."""
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
