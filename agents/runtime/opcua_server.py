"""A machine as an OPC UA server: variables to read, and commands that one client may write.

Without this module, asyncua admits anybody, accepts values of several writers, and reads any
amount. Here a user and a password are required. The first client that writes a command owns the
machine until its session ends. A command must have a valid length, numbers, sequence and time.
"""

import asyncio
import hmac
import math
from collections import deque
from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from asyncua import Server, ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.permission_rules import SimpleRoleRuleset, User, UserRole
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession
from asyncua.server.user_managers import UserManager

from surface_gym import checks
from surface_gym.machine import messages as ms

from . import opcua, protocol
from .opcua import ARRAYS, AXES, CLOCK, GATE, HELLO, LIMITS, MAX_CHUNK, MESSAGES, NAMESPACE, RECENT

MAX_AGE = 0.25  # [s] maximum age of a command
MAX_CONNECTIONS = 16
GREETING_TIMEOUT = 2.0  # [s] from the connection to a session with a password
SESSION_TIMEOUTS = (1000.0, 5000.0)  # [ms] least and greatest, from the last sign of life
WELCOME_AFTER = 0.1  # [s] from a subscription to the greeting; older messages count as known
MAX_PENDING = 64  # maximum number of requests of a client at a time

SetAxes = Callable[[int, ms.Angles], ms.AxesAcknowledgement]
Code = ua.StatusCodes


class _Users(UserManager):
    def __init__(self, security: opcua.OpcUaSecurity) -> None:
        self._security = security
        self._peer = security.certificates and security.file("peer.der").read_bytes()

    def get_user(
        self, _server: Any, username: Any = None, password: Any = None, certificate: Any = None
    ) -> User | None:
        """Return the user if name, password and certificate are correct, else None."""
        given = f"{username}\0{password}".encode()
        right = f"{self._security.user}\0{self._security.password}".encode()
        known = self._peer is None or certificate == self._peer
        return (
            User(UserRole.User, username) if hmac.compare_digest(given, right) and known else None
        )


class _Permissions(SimpleRoleRuleset):
    """Permissions of users to read, write and subscribe. All other services are refused."""

    def __init__(self) -> None:
        super().__init__()
        for name in ("Call", "HistoryRead", "RegisterNodes", "TransferSubscriptions"):
            identity = ua.NodeId(getattr(ua.ObjectIds, f"{name}Request_Encoding_DefaultBinary"))
            self._permission_dict[UserRole.User].discard(identity)


@dataclass
class _Input:
    """A variable for commands."""

    size: int  # numbers after the sequence and the time
    most: float  # greatest absolute number
    act: Callable[[int, list[float]], Awaitable[bool]]  # obeys a command, or returns False
    sequence: int = -1  # the owner's latest


class _OwnerSession(InternalSession):
    """A client's session, in which each write is checked."""

    async def write(self, params: ua.WriteParameters) -> list[ua.StatusCode]:
        if not self.external:
            return await super().write(params)
        codes = [await self.iserver.command(self, each) for each in params.NodesToWrite]
        return [ua.StatusCode(code) for code in codes]

    async def create_monitored_items(self, params: Any) -> Any:
        made = await super().create_monitored_items(params)
        if self.external:
            self.iserver.welcome()
        return made

    async def close_session(self, delete_subs: bool = True) -> None:
        await super().close_session(delete_subs)
        self.iserver.release(self)


class _Guard(InternalServer):
    """The services for all connections. Only one session, the owner, may write commands."""

    def __init__(self, users: UserManager, now: Callable[[], float]) -> None:
        super().__init__(users)
        self._now = now
        self._owner: InternalSession | None = None
        self.inputs: dict[ua.NodeId, _Input] = {}
        self.welcome: Callable[[], None] = lambda: None  # called for each new reader
        self.max_connections = MAX_CONNECTIONS
        self.max_pending_activation_seconds = GREETING_TIMEOUT
        self.min_session_timeout_ms, self.max_session_timeout_ms = SESSION_TIMEOUTS
        self.max_pending_messages_per_connection = MAX_PENDING
        self.max_unacked_messages_per_subscription = MAX_PENDING
        self.max_monitored_item_queue_size = opcua.QUEUE
        self.max_subscriptions = MAX_CONNECTIONS
        self.allow_remote_admin = False

    def create_session(self, name: str, **options: Any) -> InternalSession:
        return _OwnerSession(self, self.aspace, self.subscription_service, name, **options)

    def lookup_external_session(self, auth_token: ua.NodeId) -> None:
        """Refuse to resume a session. asyncua would resume it before checking the password."""

    def register_server(self, *_: Any) -> None:
        raise ServiceError(Code.BadServiceUnsupported)  # asyncua would ask for no password

    def release(self, session: InternalSession) -> None:
        if self._owner is session:
            self._owner = None
            for each in self.inputs.values():
                each.sequence = -1

    async def command(self, session: InternalSession, value: ua.WriteValue) -> int:
        """Obey the command that a session writes, and return a status code."""
        given = self.inputs.get(value.NodeId)
        if given is None or value.AttributeId != ua.AttributeIds.Value:
            return Code.BadNotWritable
        if self._owner not in (None, session):
            return Code.BadUserAccessDenied
        code = self._fault(given, value)
        if code != Code.Good:
            return code
        sequence, _, *values = value.Value.Value.Value
        self._owner, given.sequence = session, int(sequence)
        if not await given.act(given.sequence, values):
            return Code.BadOutOfRange
        await self.aspace.write_attribute_value(value.NodeId, value.AttributeId, value.Value)
        return Code.Good

    def _fault(self, given: _Input, value: ua.WriteValue) -> int:
        variant = value.Value.Value
        if variant is None or variant.VariantType != ua.VariantType.Double or value.IndexRange:
            return Code.BadTypeMismatch
        if not isinstance(variant.Value, list) or len(variant.Value) != 2 + given.size:
            return Code.BadTypeMismatch
        array = np.array(variant.Value, dtype=np.float64)
        if not np.isfinite(array).all() or np.abs(array[2:]).max() > given.most:
            return Code.BadOutOfRange
        sequence, late = array[0], self._now() - array[1]
        if not sequence.is_integer() or not given.sequence < sequence <= ms.MAX_NUMBER:
            return Code.BadSequenceNumberInvalid
        return Code.Good if -ms.MAX_EARLY <= late <= MAX_AGE else Code.BadInvalidTimestamp


class _Peer(OPCUAProtocol):
    """A client's connection. If the client sends too much, connection and session are closed."""

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        if len(self._buffer) > MAX_CHUNK and self.transport is not None:
            self.transport.abort()

    async def _process_one_msg(self, header: Any, buf: Any) -> bool:
        is_gone = self.transport is None or self.transport.is_closing()
        return not is_gone and await super()._process_one_msg(header, buf)

    def connection_lost(self, ex: BaseException | None) -> None:
        super().connection_lost(ex)
        if self.processor is not None and self.processor.session is not None:
            closing = self.processor.session.close_session(True)
            self.closing_tasks.append(asyncio.ensure_future(closing))


class _Listener(BinaryServer):
    def _make_protocol(self) -> OPCUAProtocol:
        return _Peer(self.iserver, self._policies, self.clients, self.closing_tasks, self.limits)


class OpcUaServer(Server):
    """An OPC UA server of a machine.

    Args:
        task: task of the machine.
        shape: (rows, columns) of the machine's widest zone.
        security: user, password and certificates.
        set_axes: function of a command's number and angles [rad]. The function sets axes to the
            angles, and returns an acknowledgement.
        now: clock [s] of the machine.
        host, port: address where the server listens; port 0 means any free port.
        open_gate: function that lets one parcel enter between two times [s]; None without a gate.
        greet: function that returns the messages for a new reader.
    """

    def __init__(
        self,
        task: str,
        shape: tuple[int, int],
        security: opcua.OpcUaSecurity,
        set_axes: SetAxes,
        now: Callable[[], float],
        host: str = "127.0.0.1",
        port: int = 0,
        open_gate: Callable[[float, float], None] | None = None,
        greet: Callable[[], Sequence[ms.Message]] = tuple,
    ) -> None:
        security.check(host)
        opcua.harden()
        self._guard = _Guard(_Users(security), now)
        self._guard.welcome = self._welcome
        self._greet = greet
        self._greetings: set[asyncio.Task[None]] = set()
        super().__init__(self._guard)
        self._security, self._machine_clock = security, now
        self._greeting = ms.to_line(protocol.hello(task, shape)).decode().strip()
        self._shape, self._set_axes, self._open_gate = shape, set_axes, open_gate
        self._sequences = dict.fromkeys((*ARRAYS, MESSAGES), 0)
        self._recent: deque[str] = deque(maxlen=RECENT)
        self._nodes: dict[str, ua.NodeId] = {}
        self.host = host
        self.set_endpoint(f"opc.tcp://{host}:{port}/")
        self.limits = LIMITS

    @property
    def port(self) -> int:
        assert self.bserver is not None
        return self.bserver.port

    async def start(self) -> None:
        await self.init()
        await self.set_application_uri(NAMESPACE)
        policy = ua.SecurityPolicyType.NoSecurity
        if self._security.certificates is not None:
            policy = ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt
            await self.load_certificate(self._security.file("own.der"))
            await self.load_private_key(self._security.file("own.pem"))
        self.set_security_policy([policy], _Permissions())
        self.set_identity_tokens([ua.UserNameIdentityToken])
        await self._add_nodes()
        await self._setup_server_nodes()
        await self.iserver.start()
        host, port = self._get_bind_socket_info()
        self.bserver = _Listener(self.iserver, host or "", port or 0, self.limits)
        self.bserver.set_policies(self._policies)
        await self.bserver.start()

    async def _add_nodes(self) -> None:
        index = await self.register_namespace(NAMESPACE)
        parent = await self.get_objects_node().add_object(index, "Surface")
        double, text = ua.VariantType.Double, ua.VariantType.String
        rows, columns = self._shape
        inputs = {AXES: _Input(rows * columns, protocol.RIGHT_ANGLE, self._turn)}
        if self._open_gate is not None:
            inputs[GATE] = _Input(2, math.inf, self._open)
        values = {
            HELLO: ua.Variant(self._greeting, text),
            CLOCK: ua.Variant(0.0, double),
            **{name: ua.Variant([0.0] * (2 + each.size), double) for name, each in inputs.items()},
            **{layout.node: ua.Variant([0.0], double) for layout in ARRAYS.values()},
            MESSAGES: ua.Variant([], text, is_array=True),
        }
        for name, value in values.items():
            node = await parent.add_variable(ua.NodeId(name, index), f"{index}:{name}", value)
            self._nodes[name] = node.nodeid
            if name in inputs:
                await node.set_writable()
                self._guard.inputs[node.nodeid] = inputs[name]
        self.iserver.set_attribute_value_callback(
            self._nodes[CLOCK], lambda *_: ua.DataValue(ua.Variant(self._machine_clock(), double))
        )

    async def _turn(self, sequence: int, angles: list[float]) -> bool:
        answer = self._set_axes(sequence, np.reshape(angles, self._shape))
        if not answer.refused:
            await self.publish(ms.to_fields(answer))
        return not answer.refused

    async def _open(self, _: int, times: list[float]) -> bool:
        assert self._open_gate is not None
        self._open_gate(*times)
        return True

    def _welcome(self) -> None:
        greeting = asyncio.ensure_future(self._publish_greeting())
        self._greetings.add(greeting)
        greeting.add_done_callback(self._greetings.discard)

    async def _publish_greeting(self) -> None:
        await asyncio.sleep(WELCOME_AFTER)
        for message in self._greet():
            await self.publish(ms.to_fields(message))

    async def publish(self, fields: dict[str, Any]) -> None:
        """Publish a message's fields to all clients."""
        values = opcua.to_numbers(fields)
        kind = MESSAGES if values is None else checks.one_of("kind", fields["kind"], tuple(ARRAYS))
        self._sequences[kind] += 1
        sequence = self._sequences[kind]
        if values is None:
            self._recent.append(f"{sequence} {ms.to_line(fields).decode().strip()}")
            shown = ua.Variant(list(self._recent), ua.VariantType.String)
        else:
            shown = ua.Variant([float(sequence), *map(float, values)], ua.VariantType.Double)
        name = MESSAGES if values is None else ARRAYS[kind].node
        await self.iserver.write_attribute_value(self._nodes[name], ua.DataValue(shown))
