"""OPC UA between the control loop and a machine: the machine's variables, and the loop as a client.

Axes and poses are arrays of numbers that a PLC can use. An array begins with a sequence number and
a time, so that a single write changes all of it. Other messages are lines of
`surface_gym.machine.messages` in one variable.
"""

import asyncio
import logging
import time
from collections import deque
from collections.abc import Awaitable, Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Any
from urllib.parse import urlparse

import numpy as np
from asyncua import Client, ua
from asyncua.client.ua_client import UaClient, UASocketProtocol
from asyncua.common.connection import TransportLimits
from asyncua.common.shortcuts import Shortcuts
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from asyncua.ua import ua_binary

from surface_gym import checks
from surface_gym.machine import messages as ms

from . import protocol
from .config import LOOPBACK, check_private

NAMESPACE = "urn:surface-gym:machine"  # of the variables, and name of the server
LOOP = "urn:surface-gym:loop"  # name of the client
USER = "surface-gym"  # default user; the password is the token
HELLO, CLOCK, AXES, GATE, MESSAGES = "Hello", "Clock", "Axes", "Gate", "Messages"
TIMES = ("at", "taken")  # fields of messages with a time [s] of the machine's clock
RECENT = 16  # number of the latest messages in MESSAGES
MAX_CHUNK = 1 << 16  # [bytes]
LIMITS = TransportLimits(MAX_CHUNK, MAX_CHUNK, max_chunk_count=16, max_message_size=1 << 20)
TIMEOUT = 1.0  # [s] maximum time of an answer
BEAT = 0.25  # [s] between heartbeats
SILENCE = 3.0  # [s] from the last heartbeat, or attempt to connect, until a link is given up
RETRY = 0.05  # [s] between attempts to connect
PUBLISHING = 5.0  # [ms] requested interval between notifications
SESSION_TIMEOUT = 2000.0  # [ms] from the last sign of life to the end of a session
QUEUE = 64  # notifications of a variable between two publications
MAX_WAITING = 1000  # maximum number of messages between two reads
OFFSETS = 32  # heartbeats from which the clocks' difference is taken


@dataclass(frozen=True)
class ArrayLayout:
    """Order of a message's fields in an array. The array begins with the sequence number."""

    node: str  # name of the variable
    fields: tuple[str, ...]  # in order; a pose has three numbers, others have one; -1: no value
    # last field: "axes" of the zone, or the number of "poses" and then the poses; "": none
    rest: str = ""


ARRAYS = {
    "frame": ArrayLayout("Frame", ("taken", "number", "pose"), "axes"),
    "detections": ArrayLayout("Detections", ("taken",), "poses"),
    "taken": ArrayLayout("Taken", ("command", "at")),
}


def to_numbers(fields: dict[str, Any]) -> list[float] | None:
    """Return a message's fields as numbers. If a message is sent as text, return None."""
    layout = ARRAYS.get(fields["kind"])
    if layout is None or fields.get("refused"):
        return None
    values: list[float] = []
    for name in layout.fields:
        values += np.ravel(-1.0 if fields[name] is None else fields[name]).tolist()
    rest = [] if fields.get(layout.rest) is None else fields[layout.rest]
    values += [float(len(rest))] if layout.rest == "poses" else []
    return values + np.ravel(rest).tolist()


def from_numbers(kind: str, values: list[float], shape: tuple[int, int]) -> dict[str, Any]:
    """Convert the numbers of an array to the fields of a message of the kind `kind`.

    The fields are not checked yet. `shape` is (rows, columns) of the widest zone.
    """
    layout, used = ARRAYS[kind], 0
    fields: dict[str, Any] = {"kind": kind}
    for name in layout.fields:
        part = values[used : used + (3 if name == "pose" else 1)]
        used += len(part)
        fields[name] = part if name == "pose" else _scalar(name, part)
    rest = np.array(values[used:])
    if layout.rest == "axes":
        fields["axes"] = rest.reshape(shape).tolist() if rest.size else None
    elif layout.rest:  # a PLC's array has a fixed length, so that rows may follow the last pose
        count = checks.integer("count of poses", _scalar("count", values[used : used + 1]), 0)
        fields[layout.rest] = rest[1 : 1 + 3 * count].reshape(count, 3).tolist()
    elif rest.size:
        raise ValueError(f"{layout.node} must have {used + 1} numbers, got {len(values) + 1}")
    return {**fields, "refused": ""} if kind == "taken" else fields


def _scalar(name: str, part: list[float]) -> Any:
    value = part[0] if part else None
    if name in TIMES or value is None:
        return value
    if value == -1.0 and name == "number":
        return None
    return int(value) if float(value).is_integer() else value


def sequenced(name: str, value: Any) -> tuple[int, list[float]]:
    """Check an array received as `name`. Return the first (sequence) number, and the rest."""
    if not isinstance(value, list) or not value:
        raise ValueError(f"{name} must be an array of numbers, got {value!r:.80}")
    values = ms.numbers(name, value, (None,)).tolist()
    return checks.integer(name, _scalar("command", values[:1]), 0, ms.MAX_NUMBER), values[1:]


class _NullArray:
    """Reader that refuses arrays of type Null, whose claimed length could exhaust the memory."""

    @staticmethod
    def pack_array(data: Any) -> bytes:
        return ua_binary.Primitives.Int32.pack(-1 if data is None else len(data))

    @staticmethod
    def unpack_array(_data: Any, length: int) -> None:
        raise ua.UaError(f"array must have content, got {length} times nothing")


def harden() -> None:
    """Limit how much memory an attacker can make asyncua use, and turn off asyncua's log."""
    type.__setattr__(ua_binary.Primitives1, "Null", _NullArray)
    ua_binary.MAX_RESHAPE_ELEMENTS = MAX_CHUNK
    logging.getLogger("asyncua").setLevel(logging.CRITICAL + 1)


@dataclass(frozen=True)
class OpcUaSecurity:
    """Credentials of both sides of a connection."""

    password: str  # of the user; it is the token
    user: str = USER
    certificates: Path | None = None  # folder with own.der, own.pem and peer.der; None: loopback

    def check(self, host: str) -> None:
        """Raise an error if the host is another computer and there are no certificates."""
        for name in () if self.certificates is None else ("own.der", "own.pem", "peer.der"):
            self.file(name).stat()
        if self.certificates is None and host not in LOOPBACK:
            raise ValueError(
                f"certificates must be given for hosts other than {LOOPBACK[0]}, got none for "
                f"{host!r}"
            )

    def file(self, name: str) -> Path:
        """Return a certificate file's path; raise a ValueError if other users can read own.pem."""
        assert self.certificates is not None
        if name == "own.pem":
            check_private(name, self.certificates / name)
        return self.certificates / name


async def within(seconds: float, work: Awaitable[Any]) -> Any:
    """Return the result of `work`, or raise a TimeoutError after a time [s].

    `asyncio.wait_for` would wait longer, because some work of asyncua cannot be cancelled.
    """
    task = asyncio.ensure_future(work)
    done, _ = await asyncio.wait([task], timeout=seconds)
    if not done:
        task.cancel()
        raise asyncio.TimeoutError(f"no answer within {seconds:g} s")
    return task.result()


class _Transport(UASocketProtocol):
    """A connection that closes if the server sends too much."""

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        held = len(self.receive_buffer or b"")
        if held > MAX_CHUNK or self._connection._incoming_size > LIMITS.max_message_size:
            self.disconnect_socket()


class _Transports(UaClient):
    def _make_protocol(self) -> UASocketProtocol:
        self.protocol = _Transport(self._timeout, self.security_policy, LIMITS)
        self.protocol.pre_request_hook = self._pre_request_hook
        self.protocol.on_connection_lost = self._on_transport_lost
        self.protocol.is_session_closing = self._is_session_closing
        return self.protocol


class _Link:
    """A connection in a thread. The thread reconnects until `stop` is called or a fault occurs."""

    def __init__(
        self,
        url: str,
        expected: tuple[str, tuple[int, int]],
        security: OpcUaSecurity,
        prefix: str | None,
        now: Callable[[], float],
    ) -> None:
        self._url, self._security, self._prefix, self._now = url, security, prefix, now
        self._task, self._shape = expected
        self.ready = False  # whether the machine has greeted
        self.fault = ""  # why it has ended
        self.error = "no answer yet"  # why there is no connection yet
        self.alive = now()  # [s] when it last showed life
        self.inbox: deque[ms.Message] = deque()
        self._last: dict[str, int] = {}  # latest sequence number of each variable
        self._offsets: deque[tuple[float, float]] = deque(maxlen=OFFSETS)
        # by variable, the command to write: its sequence, its times [s], and angles
        self._next: dict[str, tuple[int, list[float], list[float]]] = {}
        self._loop = asyncio.new_event_loop()
        self._stopped = asyncio.Event()
        self._wake = asyncio.Event()
        self.thread = Thread(target=self._run, daemon=True)
        self.thread.start()

    def stop(self) -> None:
        self._call(self._stopped.set)

    def send(self, name: str, sequence: int, times: list[float], angles: list[float]) -> None:
        """Let the thread write a command to the variable `name`.

        The command consists of its number `sequence`, the time now, `times` [s] and `angles` [rad].
        If an older command still waits for the thread, the new command replaces the older command.
        """
        self._next[name] = (sequence, [self._now(), *times], angles)
        self._call(self._wake.set)

    def _call(self, function: Callable[[], None]) -> None:
        with suppress(RuntimeError):  # it has ended
            self._loop.call_soon_threadsafe(function)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        try:
            self._loop.run_until_complete(self._connect())
        finally:
            self._loop.run_until_complete(self._loop.shutdown_asyncgens())
            self._loop.close()

    async def _connect(self) -> None:
        while not (self._stopped.is_set() or self.fault):
            self.alive = self._now()
            with suppress(Exception):  # of the library, as it opens and closes a connection
                await self._talk()
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._stopped.wait(), RETRY)

    async def _talk(self) -> None:
        """Exchange messages until the link is stopped, or raise an error."""
        client = Client(self._url, timeout=TIMEOUT)
        client.uaclient = _Transports(TIMEOUT)
        client.uaclient.pre_request_hook = client._wait_until_ready
        client.nodes = Shortcuts(client.uaclient.session)
        client.application_uri = LOOP
        client.session_timeout = SESSION_TIMEOUT
        client.set_user(self._security.user)
        client.set_password(self._security.password)
        if self._security.certificates is not None:
            files = map(self._security.file, ("own.der", "own.pem"))
            peer = self._security.file("peer.der").read_bytes()
            await client.set_security(SecurityPolicyBasic256Sha256, *files, server_certificate=peer)
        lost = asyncio.Event()

        async def on_lost(error: Exception) -> None:
            self.error = f"the machine is gone: {error}"
            lost.set()

        client.connection_lost_callback = on_lost
        try:
            await within(2.0 * TIMEOUT, client.connect())
            await self._exchange(client, lost)
        except Exception as error:  # whatever a hostile server makes of the library
            self.error = str(error) or type(error).__name__
            if self.ready or not isinstance(error, OSError | asyncio.TimeoutError):
                self.fault = self.error
        finally:
            with suppress(Exception):
                await within(BEAT, client.disconnect())
            client.disconnect_socket()

    async def _exchange(self, client: Client, lost: asyncio.Event) -> None:
        prefix = self._prefix
        if prefix is None:
            prefix = f"ns={await client.get_namespace_index(NAMESPACE)};s="
        hello = await client.get_node(prefix + HELLO).read_value()
        protocol.check_hello(ms.from_line(str(hello).encode()), self._task, self._shape)
        clock = client.get_node(prefix + CLOCK)
        await self._beat(clock)
        parameters = (self._listen(client, prefix), self._write(client, prefix), self._beats(clock))
        waits = [asyncio.ensure_future(each) for each in (*parameters, lost.wait())]
        waits.append(asyncio.ensure_future(self._stopped.wait()))
        try:
            done, _ = await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for each in waits:
                each.cancel()
        for each in done:
            each.result()
        if lost.is_set():
            raise ConnectionError(self.error)

    async def _beats(self, clock: Any) -> None:
        while True:
            await asyncio.sleep(BEAT)
            await self._beat(clock)

    async def _beat(self, clock: Any) -> None:
        """Read the machine's clock, note that the machine is alive, and compare the two clocks."""
        before = self._now()
        there = checks.number("Clock", await within(TIMEOUT, clock.read_value()))
        after = self.alive = self._now()
        self._offsets.append((after - before, 0.5 * (before + after) - there))

    @property
    def _offset(self) -> float:
        """[s] time of this computer's clock minus the time of the machine's clock.

        Each recent answer of the machine gives a difference. Use the fastest answer's difference.
        """
        return min(self._offsets)[1]

    async def _write(self, client: Client, prefix: str) -> None:
        while True:
            await self._wake.wait()
            self._wake.clear()
            while self._next:
                name, (sequence, times, angles) = self._next.popitem()
                values = [float(sequence), *(each - self._offset for each in times), *angles]
                value = ua.DataValue(ua.Variant(values, ua.VariantType.Double))
                try:  # without a time beside the value, which some PLCs refuse
                    await client.get_node(prefix + name).write_value(value)
                except ua.UaStatusCodeError as error:
                    if name == AXES:
                        refusal = (sequence, self._now(), str(error)[:200])
                        self.inbox.append(ms.AxesAcknowledgement(*refusal))

    async def _listen(self, client: Client, prefix: str) -> None:
        kinds = {prefix + layout.node: kind for kind, layout in ARRAYS.items()}
        nodes = [client.get_node(name) for name in (*kinds, prefix + MESSAGES)]
        async with await client.create_subscription(PUBLISHING, queue_maxsize=MAX_WAITING) as all_:
            await all_.subscribe_data_change(nodes, queuesize=QUEUE, sampling_interval=PUBLISHING)
            self.ready = True
            async for event in all_:
                kind = kinds.get(event.node.nodeid.to_string(), "")
                for fields in self._new(kind, event.value):
                    for name in TIMES:
                        if name in fields:
                            fields[name] = checks.number(name, fields[name]) + self._offset
                    self.inbox.append(ms.from_fields(fields, self._shape))
                if len(self.inbox) > MAX_WAITING:
                    raise ValueError(f"device must give at most {MAX_WAITING} messages, got more")
        raise ConnectionError("the machine has ended the subscription")

    def _new(self, kind: str, value: Any) -> list[dict[str, Any]]:
        """Return the fields of the new messages in a variable's value.

        `kind` is the kind of the messages. If `kind` is "", `value` is a list of text lines, and a
        line holds a message of any kind. Messages sent before the connection are left out.
        """
        if kind:
            sequence, values = sequenced(ARRAYS[kind].node, value)
            found = {sequence: from_numbers(kind, values, self._shape)} if values else {}
        else:
            lines = [str(each).partition(" ") for each in (value or [])[-RECENT:] if each]
            found = {int(number): ms.from_line(line.encode()) for number, _, line in lines}
            sequence = max(found, default=0)
        last = self._last.setdefault(kind, sequence)
        self._last[kind] = max(last, sequence)
        new = [fields for number, fields in found.items() if number > last]
        if not kind and len(new) < min(sequence - last, RECENT):
            raise ValueError(f"Messages must have all numbers from {last + 1} to {sequence}")
        return new


class OpcUaDevice:
    """The `Device` behind an OPC UA server: a PLC, or the simulator.

    Args:
        url: address of the server, opc.tcp://host:port or opc.tcp://user@host:port.
        task: required task of the machine.
        shape: required (rows, columns) of the machine's widest zone.
        security: user, password and certificates.
        prefix: start of the variables' node ids, e.g. "ns=4;s=Surface.". If `prefix` is
            None, the prefix is found on the server.
        now: clock [s].
    """

    def __init__(
        self,
        url: str,
        task: str,
        shape: tuple[int, int],
        security: OpcUaSecurity,
        prefix: str | None = None,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        security.check(urlparse(url).hostname or "")
        harden()
        self._arguments = (url, (task, shape), security, prefix, now)
        self._now = now
        self._link: _Link | None = None
        self._command = 0

    def connect(self) -> None:
        if self._link is not None and self._is_silent(self._link):
            self.close()
        if self._link is None:
            self._link = _Link(*self._arguments)
        if not (self._link.ready or self._link.fault):
            raise protocol.DeviceLost(f"{self._arguments[0]} is not there: {self._link.error}")

    def close(self) -> None:
        if self._link is not None:
            self._link.stop()
            self._link = None

    def _is_silent(self, link: _Link) -> bool:
        return self._now() - link.alive > SILENCE

    def _linked(self) -> _Link:
        if self._link is None:
            raise protocol.DeviceLost("not connected")
        if self._link.fault:
            raise protocol.DeviceLost(self._link.fault)
        if self._is_silent(self._link):
            raise protocol.DeviceLost(f"the machine must answer within {SILENCE:g} s")
        return self._link

    def read(self) -> list[ms.Message]:
        inbox = self._linked().inbox
        return [inbox.popleft() for _ in range(len(inbox))]

    def set_axes(self, angles: ms.Angles) -> int:
        self._command += 1
        self._linked().send(AXES, self._command, [], angles.ravel().tolist())
        return self._command

    def open_gate(self, begin: float, end: float) -> None:
        """Let one parcel enter between `begin` and `end` [s]. The machine must have a gate."""
        self._command += 1
        self._linked().send(GATE, self._command, [begin, end], [])
