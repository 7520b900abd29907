"""`python -m benchmarks.transports`: speed and safety of the control loop's transports.

A machine with 220 modules runs in another process. At 25 Hz it sends a pose and 220 encoder angles;
the loop sends 220 angles. First, the time of commands is measured. Then the machine is killed and
started again. At the end, the machine gets invalid commands, and the loop gets invalid messages.
"""

import asyncio
import json
import multiprocessing
import os
import socket
import struct
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from asyncua import Client, ua
from rich.console import Console

from benchmarks.figure import Figure, figure_table
from surface_gym.agents.runtime import protocol
from surface_gym.agents.runtime.controller import LoopConfig
from surface_gym.agents.runtime.opcua import NAMESPACE, USER, OpcUaDevice, OpcUaSecurity
from surface_gym.agents.runtime.opcua_server import OpcUaServer
from surface_gym.agents.runtime.simulator import MachineServer, PacedMachine
from surface_gym.machine import messages as ms
from surface_gym.machine.messages import AxesAcknowledgement, Frame

SHAPE = (11, 20)  # rows and columns of modules
PERIOD = 0.04  # [s]
TOKEN = "0123456789abcdef"
HOST = "127.0.0.1"
BATCH = 100  # wrong commands in a request
PATIENCE = 60.0  # [s]
KINDS = ("malformed", "oversized", "replayed", "late")
LOOP = LoopConfig(PERIOD, longest_wait=0.2)


@dataclass(frozen=True)
class TransportConfig:
    """Measure the transports between loop and machine on this computer."""

    periods: int = 1500
    """Number of control periods for the time of commands."""
    restarts: int = 6
    """Number of times that the machine is killed and started again."""
    messages: int = 10_000
    """Number of invalid messages of each kind, a multiple of 100."""
    transports: tuple[str, ...] = ("socket", "OPC UA")
    """Transports to measure."""
    json: Path | None = None
    """File for the figures."""


class _World:
    """A machine without physics, which counts valid commands."""

    def __init__(self) -> None:
        self.shape, self.now = SHAPE, time.monotonic()
        self.obeyed = self.out_of_range = self.left = 0
        self.kind, self.wrong = "", wrong_message("")
        self._limits = protocol.AxisLimits(SHAPE, None)

    def stand_still(self, seconds: float) -> None:
        self.now += seconds

    def greet(self) -> list[ms.Message]:
        return []

    def advance(self, until: float) -> list[tuple[float, ms.Message]]:
        messages: list[tuple[float, ms.Message]] = []
        while self.now <= until:
            self.now += PERIOD
            messages.append((self.now, Frame(self.now, 0, (1.0, 1.0, 0.0), np.zeros(SHAPE))))
        return messages

    def set_axes(self, command: int, angles: ms.Angles) -> AxesAcknowledgement:
        fault = self._limits.fault(angles)
        if not fault:
            self.obeyed += 1
            self.out_of_range += not np.all(np.abs(angles) <= 0.5 * np.pi + 1e-6)
        return AxesAcknowledgement(command, time.monotonic(), fault)

    def answer(self, pipe: Connection) -> list[dict[str, Any]]:
        """Answer a request for memory [MB] and counts; return invalid messages to be sent."""
        if pipe.poll():
            self.kind, self.left = pipe.recv()
            self.wrong = wrong_message(self.kind)
            if not self.left:
                pipe.send((memory(), self.obeyed, self.out_of_range))
        if not self.left:
            return []
        self.left -= BATCH
        if not self.left:
            pipe.send(())
        return [self.wrong] * BATCH


def memory() -> float:
    """Return the memory [MB] of this process."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def wrong_message(kind: str) -> dict[str, Any]:
    """Return the fields of an invalid frame; a valid one for "replayed", to be sent repeatedly."""
    at = time.monotonic() - 3600.0 * (kind == "late")
    fields = ms.to_fields(Frame(at, 0, (1.0, 1.0, 0.0), np.zeros(SHAPE)))
    if kind == "malformed":
        fields["pose"] = [1e9, 1.0, 0.0]
    elif kind == "oversized":
        fields["axes"] = 3 * fields["axes"]
    return fields


async def _serve_opcua(pipe: Connection, port: int) -> None:
    world: Any = _World()
    machine = PacedMachine(world)
    place = (machine.set_axes, time.monotonic, HOST, port)
    server = OpcUaServer("stop", SHAPE, OpcUaSecurity(TOKEN), *place)
    await server.start()
    pipe.send((server.port, time.monotonic()))
    while True:
        machine.advance(time.monotonic())
        for message in machine.due(time.monotonic()):
            await server.publish(ms.to_fields(message))
        await asyncio.sleep(min(0.005, machine.rest(time.monotonic())))
        for fields in world.answer(pipe):
            if world.kind == "replayed":
                server._sequences["frame"] -= 1
            await server.publish(fields)


def serve(transport: str, pipe: Connection, port: int) -> None:
    """Run the machine; this process does nothing else."""
    if transport == "OPC UA":
        asyncio.run(_serve_opcua(pipe, port))
    world: Any = _World()
    server = MachineServer(world, "stop", socket.create_server((HOST, port)), TOKEN)
    pipe.send((server._listener.getsockname()[1], time.monotonic()))
    while True:
        server.step(time.monotonic())
        server.wait(time.monotonic())
        for fields in world.answer(pipe):
            server._send(ms.to_line(fields))


class Machine:
    """The process that runs the machine."""

    def __init__(self, transport: str, port: int = 0) -> None:
        context = multiprocessing.get_context("spawn")
        self.transport = transport
        self.pipe, there = context.Pipe()
        self.process = context.Process(target=serve, args=(transport, there, port), daemon=True)
        self.process.start()
        self.port, self.ready = self.pipe.recv()

    def state(self) -> tuple[float, int, int]:
        """Return the memory [MB], the number of obeyed commands, and how many were out of range."""
        self.pipe.send(("", 0))
        if not self.pipe.poll(PATIENCE):
            raise TimeoutError("the machine hangs")
        return self.pipe.recv()

    def kill(self) -> None:
        self.process.kill()
        self.process.join()

    def device(self) -> protocol.Device:
        if self.transport == "OPC UA":
            url = f"opc.tcp://{HOST}:{self.port}"
            return OpcUaDevice(url, "stop", SHAPE, OpcUaSecurity(TOKEN))
        return protocol.SocketDevice((HOST, self.port), "stop", SHAPE, TOKEN)


class Loop:
    """A control loop that reads and sends every period, and reconnects as `ControlLoop` does."""

    def __init__(self, device: protocol.Device) -> None:
        self.device, self._rng = device, np.random.default_rng(0)
        self._connected = self._greeted = False
        self._next, self._wait = 0.0, LOOP.first_wait
        self.sent: dict[int, float] = {}  # [s] when each command was sent
        self.taken: dict[int, float] = {}  # [s] when the machine obeyed each command
        self.work: list[float] = []  # [s] of each period
        self.frames = self.lost = 0

    def step(self) -> None:
        begun = time.monotonic()
        try:
            if not self._connected and begun >= self._next:
                self.device.connect()
                self._connected, self._greeted = True, False
            if self._connected:
                for message in self.device.read():
                    self._wait, self._greeted = LOOP.first_wait, True
                    self.frames += isinstance(message, Frame)
                    if isinstance(message, AxesAcknowledgement) and not message.refused:
                        self.taken[message.command] = message.at
            if self._connected and self._greeted:
                angles = self._rng.uniform(-0.5 * np.pi, 0.5 * np.pi, SHAPE)
                at = time.monotonic()
                self.sent[self.device.set_axes(angles)] = at
        except protocol.DeviceLost:
            if self._connected:
                self.device.close()
                self.lost += 1
            self._connected, self._next = False, begun + self._wait
            self._wait = min(2.0 * self._wait, LOOP.longest_wait)
        self.work.append(time.monotonic() - begun)

    def run(self, goes_on: Callable[[], bool]) -> int:
        """Run while `goes_on()` is true; return the number of missed periods."""
        due, missed = time.monotonic() + PERIOD, 0
        while goes_on():
            time.sleep(max(0.0, due - time.monotonic()))
            self.step()
            late = int((time.monotonic() - due) / PERIOD)
            missed += late
            due += PERIOD * (late + 1)
        return missed

    def obey(self) -> int:
        """Run until the machine obeys a new command; return the command's number."""
        latest = max(self.taken, default=0)
        self.run(lambda: max(self.taken, default=0) <= latest)
        return min(k for k in self.taken if k > latest)


def measure_latency(transport: str, periods: int) -> list[Figure]:
    """Measure the time from sending a command until the machine obeys, and missed periods."""
    machine = Machine(transport)
    loop = Loop(machine.device())
    loop.obey()
    loop.sent, loop.taken, loop.work, loop.frames = {}, {}, [], 0
    missed = loop.run(lambda: len(loop.work) < periods)
    loop.obey()
    loop.device.close()
    machine.kill()
    ways = [1e3 * (loop.taken[k] - at) for k, at in loop.sent.items() if k in loop.taken]
    lost = sum(k not in loop.taken for k in loop.sent if k < max(loop.taken))
    work = 1e3 * np.array(loop.work)
    asked = transport == "OPC UA"
    return [
        Figure(f"{transport}: command, median", np.median(ways), "ms", 2.0 if asked else None),
        Figure(
            f"{transport}: command, 99 %", np.percentile(ways, 99), "ms", 10.0 if asked else None
        ),
        Figure(f"{transport}: command, longest", max(ways), "ms"),
        Figure(f"{transport}: work of a period, 99 %", np.percentile(work, 99), "ms"),
        Figure(f"{transport}: missed of {periods} periods", missed, "", 0.0 if asked else None),
        Figure(f"{transport}: commands without effect", lost, ""),
        Figure(f"{transport}: states received per period", loop.frames / periods, ""),
    ]


def _start_again(machine: Machine, loop: Loop) -> tuple[Machine, float]:
    """Start a killed machine after 1 s; return it, and the time [s] when it obeys the loop."""
    ends = time.monotonic() + 1.0
    loop.run(lambda: time.monotonic() < ends)
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(Machine, machine.transport, machine.port)
        taken = loop.taken[loop.obey()]
        return future.result(), taken


def measure_restarts(transport: str, restarts: int) -> list[Figure]:
    """Measure the time from a restarted machine's first listening to its first obeyed command."""
    machine = Machine(transport)
    loop = Loop(machine.device())
    loop.obey()
    times = []
    for _ in range(restarts):
        machine.kill()
        machine, taken = _start_again(machine, loop)
        times.append(taken - machine.ready)
    loop.device.close()
    machine.kill()
    asked = 0.5 if transport == "OPC UA" else None
    return [
        Figure(f"{transport}: in control after a restart, median", np.median(times), "s"),
        Figure(f"{transport}: longest of {restarts}", max(times), "s", asked),
    ]


def wrong_command(kind: str, number: int, size: int) -> list[float]:
    """Return sequence, time and angles of an invalid command; with kind "", it is valid."""
    rng, at = np.random.default_rng(number), time.monotonic()
    angles = rng.uniform(-1.0, 1.0, size)
    if kind == "malformed":
        angles[rng.integers(size)] = rng.choice([np.nan, np.inf, -np.inf, 2.0, -1e300])
    elif kind == "oversized":
        angles = rng.uniform(-1.0, 1.0, 3 * size)
    sequence = 0 if kind == "replayed" else number + 1
    return [float(sequence), at - 3600.0 * (kind == "late"), *angles.tolist()]


async def _attack_opcua(port: int, kind: str, count: int) -> int:
    """Write invalid commands as a user with the password; return the number of accepted ones."""
    client = Client(f"opc.tcp://{HOST}:{port}")
    client.set_user(USER)
    client.set_password(TOKEN)
    accepted = 0
    async with client:
        node = ua.NodeId("Axes", await client.get_namespace_index(NAMESPACE))
        right = ua.DataValue(ua.Variant(wrong_command("", 0, SHAPE[0] * SHAPE[1])))
        await client.get_node(node).write_value(right)
        for first in range(1, count + 1, BATCH):
            values = [wrong_command(kind, first + k, SHAPE[0] * SHAPE[1]) for k in range(BATCH)]
            writes = [
                ua.WriteValue(node, ua.AttributeIds.Value, None, ua.DataValue(ua.Variant(each)))
                for each in values
            ]
            for part in range(0, BATCH, 25):  # below the largest message
                parameters = ua.WriteParameters(writes[part : part + 25])
                accepted += sum(each.is_good() for each in await client.uaclient.write(parameters))
    return accepted


def _attack_socket(port: int, kind: str, count: int) -> None:
    """Send invalid commands as a loop with the token.

    After a malformed or oversized command, wait until the machine refuses it or disconnects.
    """
    device = protocol.SocketDevice((HOST, port), "stop", SHAPE, TOKEN)
    sent, each = 0, 1 if kind in ("malformed", "oversized") else count
    while sent < count:
        with suppress(ConnectionError):
            device.connect()
            while not device._greeted:
                device.read()
            assert device._connection is not None
            for _ in range(min(each, count - sent)):
                sent += 1
                _, _, *angles = wrong_command(kind, sent, SHAPE[0] * SHAPE[1])
                rows = np.reshape(angles, (-1, SHAPE[1])).tolist()
                fields = {"kind": "axes", "command": 1, "angles": rows}
                device._connection.send(json.dumps(fields).encode() + b"\n")
                answers = device.read()
            while each == 1 and not any(isinstance(k, AxesAcknowledgement) for k in answers):
                answers = device.read()
    device.close()


def _attack_bytes(port: int, count: int) -> None:
    """Send malformed OPC UA chunks without a password."""
    rng = np.random.default_rng(0)
    for _ in range(0, count, BATCH):
        with socket.create_connection((HOST, port)) as stranger, suppress(ConnectionError):
            for _ in range(BATCH):
                body = rng.bytes(int(rng.integers(1, 200)))
                head = [b"HELF", b"OPNF", b"MSGF", b"MSGC", b"CLOF"][int(rng.integers(5))]
                stranger.sendall(head + struct.pack("<I", 8 + len(body)) + body)


def measure_wrong_commands(transport: str, count: int) -> list[Figure]:
    """Send invalid commands of each kind to the machine, and check that it still serves."""
    machine, figures = Machine(transport), []
    loop = Loop(machine.device())
    loop.obey()
    loop.device.close()
    attacks = (*KINDS, "chunks of strangers") if transport == "OPC UA" else KINDS
    for kind in attacks:
        before = machine.state()[0]
        begun = time.monotonic()
        if kind not in KINDS:
            _attack_bytes(machine.port, count)
        elif transport == "OPC UA":
            accepted = asyncio.run(_attack_opcua(machine.port, kind, count))
            figures.append(Figure(f"{transport}: {kind}, accepted of {count}", accepted, "", 0.0))
        else:
            _attack_socket(machine.port, kind, count)
        seconds = time.monotonic() - begun
        memory, _, out_of_range = machine.state()
        loop = Loop(machine.device())
        loop.obey()  # it still does
        loop.device.close()
        figures += [
            Figure(f"{transport}: {kind}, obeyed out of range", out_of_range, "", 0.0),
            Figure(f"{transport}: {kind}, memory gained", memory - before, "MB"),
            Figure(f"{transport}: {kind}, {count} in", seconds, "s"),
        ]
    machine.kill()
    return figures


def measure_wrong_messages(transport: str, count: int) -> list[Figure]:
    """Let the machine send invalid messages of each kind, and check that the loop still works."""
    machine, figures = Machine(transport), []
    loop = Loop(machine.device())
    loop.obey()
    for kind in KINDS:
        before, lost = memory(), loop.lost
        machine.pipe.send((kind, count))
        missed = loop.run(lambda: not machine.pipe.poll())
        machine.pipe.recv()
        loop.obey()
        name = f"{transport}: {count} {kind} messages to the loop"
        figures += [
            Figure(f"{name}, memory gained", memory() - before, "MB"),
            Figure(f"{name}, periods missed", missed, ""),
            Figure(f"{name}, connections given up", loop.lost - lost, ""),
        ]
    loop.device.close()
    machine.kill()
    return figures


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command."""
    config = tyro.cli(TransportConfig, prog="python -m benchmarks.transports", args=arguments)
    figures: list[Figure] = []
    for transport in config.transports:
        figures += measure_latency(transport, config.periods) if config.periods else []
        figures += measure_restarts(transport, config.restarts) if config.restarts else []
        if config.messages:
            figures += measure_wrong_commands(transport, config.messages)
            figures += measure_wrong_messages(transport, config.messages)
    load = ", ".join(f"{each:.1f}" for each in os.getloadavg())
    title = f"transports, load {load} on {os.cpu_count()} cores"
    Console().print(figure_table(figures, title))
    if config.json is not None:
        data = {"load": os.getloadavg(), "figures": [asdict(each) for each in figures]}
        config.json.write_text(json.dumps(data, indent=1) + "\n")


if __name__ == "__main__":
    main()
