"""OPC UA: messages come out as they went in, and whatever is wrong moves no axis."""

import asyncio
import math
import socket
import struct
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from asyncua import Client, ua
from asyncua.crypto import cert_gen
from asyncua.ua import ua_binary
from cryptography.x509.oid import ExtendedKeyUsageOID

from surface_gym.agents.runtime import opcua
from surface_gym.agents.runtime.cli import open_device
from surface_gym.agents.runtime.config import RuntimeConfig, parse_address
from surface_gym.agents.runtime.opcua import OpcUaDevice, OpcUaSecurity
from surface_gym.agents.runtime.opcua_server import OpcUaServer
from surface_gym.agents.runtime.protocol import DeviceLost
from surface_gym.agents.runtime.simulator import SimulatorProcess
from surface_gym.machine import messages as ms
from tests.agents.runtime import made
from tests.agents.runtime.made import PATIENCE, TOKEN, until

SHAPE = (2, 3)
SECURITY = OpcUaSecurity(TOKEN)


class Machine:
    """A server in a thread, which notes the axes that were set."""

    def __init__(self, port: int = 0, security: OpcUaSecurity = SECURITY) -> None:
        self.axes: list[tuple[int, np.ndarray]] = []
        self.loop = asyncio.new_event_loop()
        self.thread = threading.Thread(target=self.loop.run_forever)
        self.thread.start()
        self.gates: list[tuple[float, float]] = []
        place = (self.set_axes, time.monotonic, "127.0.0.1", port)
        self.server = OpcUaServer("stop", SHAPE, security, *place, open_gate=self.open_gate)
        self.do(self.server.start())
        self.url = f"opc.tcp://127.0.0.1:{self.server.port}"

    def set_axes(self, command: int, angles: np.ndarray) -> ms.AxesAcknowledgement:
        self.axes.append((command, angles))
        return ms.AxesAcknowledgement(command, time.monotonic())

    def open_gate(self, begin: float, end: float) -> None:
        self.gates.append((begin, end))

    def do(self, work: Coroutine[Any, Any, Any]) -> Any:
        return asyncio.run_coroutine_threadsafe(work, self.loop).result(PATIENCE)

    def show(self, message: ms.Message) -> None:
        self.do(self.server.publish(ms.to_fields(message)))

    def write(self, name: str, value: Any) -> None:
        """Show a raw value, as a machine that is broken might."""
        node, empty = self.server._nodes[name], ua.Variant([], ua.VariantType.String, is_array=True)
        attribute = self.server.iserver.aspace[node].attributes[ua.AttributeIds.Value]
        attribute.value = None  # any type may follow
        given = empty if value == [] else ua.Variant(value)
        self.do(self.server.iserver.write_attribute_value(node, ua.DataValue(given)))

    def close(self) -> None:
        self.do(self.server.stop())
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join()
        self.loop.close()


def connected(machine: Machine, **options: Any) -> OpcUaDevice:
    device = OpcUaDevice(machine.url, "stop", SHAPE, SECURITY, **options)
    connect(device)
    return device


def connect(device: OpcUaDevice) -> None:
    def attempt() -> bool:
        with suppress(DeviceLost):
            device.connect()
            return True
        return False

    until(attempt)


def close(device: OpcUaDevice) -> None:
    """Close a device, and wait for its thread."""
    link = device._link
    device.close()
    if link is not None:
        link.thread.join(PATIENCE)
        assert not link.thread.is_alive()


def fault_of(device: OpcUaDevice) -> str:
    """Why a device is lost."""

    def lost() -> str:
        try:
            device.read()
        except DeviceLost as error:
            return str(error)
        return ""

    return until(lost)


@pytest.fixture(scope="module")
def machine() -> Iterator[Machine]:
    machine = Machine()
    yield machine
    machine.close()


@pytest.fixture
def device(machine: Machine) -> Iterator[OpcUaDevice]:
    machine.axes.clear()
    device = connected(machine)
    yield device
    close(device)


@pytest.fixture
def broken(machine: Machine) -> Iterator[Machine]:
    """The machine, whole again afterwards."""
    machine.axes.clear()
    yield machine
    server = machine.server
    server._machine_clock = server._guard._now = time.monotonic
    for name in ("Frame", "Detections", "Taken"):
        machine.write(name, [0.0])
    machine.write("Messages", [])
    server.iserver.set_attribute_value_callback(
        server._nodes["Clock"], lambda *_: ua.DataValue(ua.Variant(server._machine_clock()))
    )


class Writer:
    """Another client of the machine, which writes what it likes."""

    def __init__(self, machine: Machine, **options: Any) -> None:
        self.machine = machine
        self.client = Client(machine.url, **options)
        self.client.set_user(opcua.USER)
        self.client.set_password(TOKEN)
        self.client.session_timeout = 5000
        machine.do(self.client.connect())

    def write(self, values: Any, name: str = "Axes", kind: Any = ua.VariantType.Double) -> str:
        """The name of the status of a write."""
        node = self.client.get_node(self.machine.server._nodes[name])
        value = ua.DataValue(ua.Variant(values, kind))
        try:
            self.machine.do(node.write_value(value))
        except ua.UaStatusCodeError as error:
            return type(error).__name__
        return "Good"

    def close(self) -> None:
        self.machine.do(self.client.disconnect())


@pytest.fixture
def writer(machine: Machine) -> Iterator[Writer]:
    machine.axes.clear()
    writer = Writer(machine)
    yield writer
    writer.close()


def command(sequence: float = 1.0, late: float = 0.0, angles: Any = (0.1,) * 6) -> list[float]:
    return [sequence, time.monotonic() - late, *angles]


AXES = np.arange(6.0).reshape(SHAPE) / 10.0
MESSAGES = [
    ms.Frame(1.25),
    ms.Frame(1.25, 3, (0.1, 1.0, 0.2)),
    ms.Frame(1.25, 3, (0.1, 1.0, 0.2), AXES),
    ms.AxesAcknowledgement(7, 2.5),
    ms.AxesAcknowledgement(7, 2.5, "out of range"),
    ms.ParcelDeparture(3, "success", {"stop_error": 0.001}),
    made.entered(4, 2.5),
]


@pytest.mark.parametrize("message", MESSAGES)
def test_fields_come_out_of_numbers_as_they_went_in(message: ms.Message) -> None:
    fields = ms.to_fields(message)
    values = opcua.to_numbers(fields)
    if values is None:  # it is a line
        assert fields["kind"] in ("left", "entered") or fields["refused"]
    else:
        assert opcua.from_numbers(fields["kind"], values, SHAPE) == fields


def test_rows_of_poses_are_numbers_too() -> None:
    for poses in ([], [[0.1, 1.0, 0.0], [0.5, 1.0, 3.0]]):
        fields = {"kind": "detections", "taken": 2.5, "poses": poses}
        values = opcua.to_numbers(fields)
        assert opcua.from_numbers("detections", values, SHAPE) == fields
        # The array of a PLC is as long as for its most parcels.
        assert opcua.from_numbers("detections", [*values, 7.0, 7.0, 7.0], SHAPE) == fields
    for wrong in ([2.5], [2.5, 0.5], [2.5, -2.0], [2.5, 2.0, 0.1, 0.1, 0.1]):
        with pytest.raises(ValueError, match=r"reshape|count of poses must"):
            opcua.from_numbers("detections", wrong, SHAPE)
    with pytest.raises(ValueError, match="Taken must have 3 numbers"):
        opcua.from_numbers("taken", [1.0, 2.0, 3.0], SHAPE)


class TestRoundTrip:
    def test_messages_arrive_in_order_and_only_new_ones(self, machine, device) -> None:
        read: list[ms.Message] = []
        for sent in MESSAGES:
            machine.show(sent)
        until(lambda: read.extend(device.read()) or len(read) >= len(MESSAGES))
        assert len(read) == len(MESSAGES)
        for kind in {type(each) for each in MESSAGES}:
            sent = [ms.to_fields(each) for each in MESSAGES if type(each) is kind]
            back = [ms.to_fields(each) for each in read if type(each) is kind]
            for one, other in zip(
                sorted(sent, key=str), sorted(back, key=str), strict=True
            ):  # an acknowledgement may be a line or an array
                for name in set(one) - set(opcua.TIMES):
                    assert one[name] == other[name]
                for name in set(one) & set(opcua.TIMES):  # by the difference of the clocks
                    assert one[name] == pytest.approx(other[name], abs=opcua.TIMEOUT)

    def test_axes_are_set_and_acknowledged(self, machine, device) -> None:
        first = device.set_axes(AXES)
        answer = until(device.read)
        assert [each.command for each in answer] == [first]
        ((number, angles),) = machine.axes
        assert number == first
        np.testing.assert_array_equal(angles, AXES)
        before = time.monotonic()
        for _ in range(1000):  # nothing waits, and the latest counts
            last = device.set_axes(-AXES)
        assert time.monotonic() - before < PATIENCE
        until(lambda: machine.axes[-1][0] == last)
        assert len(machine.axes) <= 1001

    def test_a_gate_opens(self, machine, device) -> None:
        now = time.monotonic()
        device.open_gate(now, now + 0.04)
        ((begin, end),) = until(lambda: machine.gates)
        assert begin == pytest.approx(now, abs=opcua.TIMEOUT)
        assert end - begin == pytest.approx(0.04)
        assert device.read() == []

    def test_a_clock_of_another_time_is_converted(self, broken) -> None:
        shift = 1e6  # [s] by which the machine's clock is behind
        broken.server._machine_clock = lambda: time.monotonic() - shift
        broken.server._guard._now = broken.server._machine_clock
        device = connected(broken)
        device.set_axes(AXES)
        (answer,) = until(device.read)  # accepted, since its time is the machine's
        assert answer.refused == ""
        now = time.monotonic()
        broken.show(ms.Frame(now - shift))
        (frame,) = [each for each in until(device.read) if isinstance(each, ms.Frame)]
        assert frame.taken_at == pytest.approx(now, abs=opcua.TIMEOUT)
        close(device)


NAN, INF = math.nan, math.inf
REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "too short": (lambda: command(angles=[0.1] * 5), "BadTypeMismatch"),
    "too long": (lambda: command(angles=[0.1] * 600), "BadTypeMismatch"),
    "empty": (list, "BadTypeMismatch"),
    "one number": (lambda: 1.0, "BadTypeMismatch"),
    "not a number": (lambda: command(angles=[0.1] * 5 + [NAN]), "BadOutOfRange"),
    "infinite": (lambda: command(angles=[INF] + [0.1] * 5), "BadOutOfRange"),
    "beyond a right angle": (lambda: command(angles=[-1.6] * 6), "BadOutOfRange"),
    "time not a number": (lambda: command(late=NAN), "BadOutOfRange"),
    "late": (lambda: command(late=0.5), "BadInvalidTimestamp"),
    "before all time": (lambda: command(late=1e300), "BadInvalidTimestamp"),
    "early": (lambda: command(late=-0.5), "BadInvalidTimestamp"),
    "sequence not a number": (lambda: command(NAN), "BadOutOfRange"),
    "sequence a fraction": (lambda: command(5.5), "BadSequenceNumberInvalid"),
    "sequence negative": (lambda: command(-1.0), "BadSequenceNumberInvalid"),
    "sequence huge": (lambda: command(1e300), "BadSequenceNumberInvalid"),
}


class TestRefusals:
    @pytest.mark.parametrize(("values", "status"), REFUSED.values(), ids=REFUSED)
    def test_a_wrong_command_is_refused(self, machine, writer, values, status) -> None:
        assert writer.write(values()) == status
        assert machine.axes == []

    def test_a_replayed_and_an_old_command_are_refused(self, machine, writer) -> None:
        assert writer.write(command(5)) == "Good"
        for old in (5, 4, 0):
            assert writer.write(command(old)) == "BadSequenceNumberInvalid"
        assert writer.write(command(6)) == "Good"
        assert [number for number, _ in machine.axes] == [5, 6]

    def test_nothing_else_can_be_written_or_changed(self, machine, writer) -> None:
        assert writer.write([1] * 8, kind=ua.VariantType.Int32) == "BadTypeMismatch"
        assert writer.write([1.0] * 8, kind=ua.VariantType.Float) == "BadTypeMismatch"
        for name in ("Frame", "Clock", "Hello"):
            assert writer.write(command(), name) == "BadNotWritable"
        objects = writer.client.get_objects_node()
        for work in (
            objects.add_folder(2, "mine"),
            writer.client.delete_nodes([writer.client.get_node(machine.server._nodes["Axes"])]),
            writer.client.get_node(ua.ObjectIds.Server).call_method("0:GetMonitoredItems", 1),
        ):
            with pytest.raises(ua.UaStatusCodeError):
                machine.do(work)
        assert machine.axes == []

    def test_a_second_writer_is_refused_as_long_as_the_first_is_there(
        self, machine, device, writer
    ) -> None:
        device.set_axes(AXES)
        until(lambda: machine.axes)
        assert writer.write(command(1000)) == "BadUserAccessDenied"
        assert len(machine.axes) == 1
        close(device)
        until(lambda: machine.server._guard._owner is None)
        assert writer.write(command(1)) == "Good"
        late = connected(machine)
        late.set_axes(AXES)
        (answer,) = until(late.read)
        assert "denied" in answer.refused.lower()
        close(late)

    def test_an_owner_that_shows_no_life_is_one_no_more(self, machine) -> None:
        silent = Writer(machine, watchdog_intervall=100.0)
        silent.client.session_timeout = 1000
        machine.do(silent.client.disconnect())
        machine.do(silent.client.connect())
        assert silent.write(command()) == "Good"
        until(lambda: machine.server._guard._owner is None)
        assert silent.write(command(2)) != "Good"
        with suppress(Exception):
            silent.close()

    @pytest.mark.parametrize(("user", "password"), [
        (opcua.USER, TOKEN.upper()), ("admin", TOKEN), (opcua.USER, ""), (None, None),
    ])  # fmt: skip
    def test_nobody_enters_without_user_and_password(self, machine, user, password) -> None:
        client = Client(machine.url)
        if user is not None:
            client.set_user(user)
            client.set_password(password)
        with pytest.raises(ua.UaStatusCodeError):
            machine.do(client.connect())
        device = OpcUaDevice(machine.url, "stop", SHAPE, OpcUaSecurity(password or "x", user or ""))
        connect(device)
        assert fault_of(device)
        close(device)

    def test_nobody_continues_the_session_of_another(self, machine, device) -> None:
        """The library would let anybody in who names a session's number, which is counted up."""
        device.set_axes(AXES)
        until(lambda: machine.axes)
        (token,) = machine.server.iserver._external_sessions
        thief = Client(machine.url)
        machine.do(thief.connect_sessionless())
        thief.uaclient.session.restore_authentication_token(token)
        thief._policy_ids = machine.do(thief.get_endpoints())[0].UserIdentityTokens
        node = thief.get_node(machine.server._nodes["Axes"])
        for work in (
            thief.activate_session(username=opcua.USER, password="wrong"),
            node.write_value(ua.DataValue(ua.Variant(command(99), ua.VariantType.Double))),
        ):
            with pytest.raises((ua.UaError, ConnectionError, asyncio.TimeoutError)):
                machine.do(asyncio.wait_for(work, 0.5))
        assert len(machine.axes) == 1
        thief.disconnect_socket()


class TestHostility:
    @pytest.mark.parametrize(
        "sent",
        [
            bytes(range(256)) * 300,
            b"MSGF" + struct.pack("<II", 1 << 31, 0) + b"x" * 200_000,
            b"HELF" + struct.pack("<I", 0),
            b"HELF" + struct.pack("<I", 1 << 20) + b"\xff" * (1 << 20),
        ],
    )
    def test_whoever_sends_anything_is_cut_off(self, machine, device, sent) -> None:
        address = parse_address(machine.url)
        with socket.create_connection(address) as stranger, suppress(ConnectionError):
            stranger.settimeout(PATIENCE)
            stranger.sendall(sent)
            while stranger.recv(4096):
                pass
        device.set_axes(AXES)
        assert until(device.read)

    def test_an_array_of_nothing_takes_no_time(self) -> None:
        opcua.harden()
        for kind in range(26):
            value = bytes([0x80 | kind]) + struct.pack("<i", 2**31 - 1) + bytes(100)
            with pytest.raises((ua.UaError, ValueError)):
                ua_binary.variant_from_binary(ua.utils.Buffer(value))

    @pytest.mark.parametrize(
        ("name", "value", "fault"),
        [
            ("Frame", [1e6, 1.0, NAN, 0.0, 1.0, 0.0], "must be finite"),
            ("Frame", [1e6, 1.0, 0.0, INF, 1.0, 0.0], "must be finite"),
            ("Frame", [1e6, 1.0, 0.0, 1e9, 1.0, 0.0], "pose must be between"),
            ("Frame", [1e6, 1.0, 0.5, 0.0, 1.0, 0.0], "number must be a whole number"),
            ("Frame", [1e6, 1.0, 0.0, 0.0], "pose must"),
            ("Frame", [1e6, 1.0, 0.0, 0.0, 1.0, 0.0, 0.5], "reshape"),
            ("Frame", [1e6 + 0.5, 1.0, -1.0, 0.0, 1.0, 0.0], "Frame must be a whole number"),
            ("Frame", [], "must be an array of numbers"),
            ("Frame", "a text", "must be an array of numbers"),
            ("Frame", ["1", "2"], "Frame must"),
            ("Taken", [1e6, -2.0, 1.0], "command must be a whole number"),
            ("Messages", ["1000000 {}"], "line must be an object"),
            ("Messages", ["a text"], "invalid literal"),
            ("Messages", ["1000000 " + "[" * 50_000], "line must"),
            ("Messages", ['1000000 {"kind":"left"}'], "Messages must have all numbers"),
            ("Clock", NAN, "Clock must be a finite number"),
            ("Clock", "noon", "Clock must be a finite number"),
        ],
    )
    def test_a_machine_that_cannot_be_understood_is_lost(self, name, value, fault, broken) -> None:
        device = connected(broken)
        broken.write(name, value)
        assert fault in fault_of(device)
        with pytest.raises(DeviceLost):
            device.set_axes(AXES)
        close(device)
        with pytest.raises(DeviceLost, match="not connected"):
            device.read()

    def test_old_and_repeated_frames_are_ignored(self, broken) -> None:
        device = connected(broken)
        for sequence in (5.0, 5.0, 4.0, 5.0, 6.0):
            broken.write("Frame", [sequence, 1.0, 7.0, 0.1 * sequence, 1.0, 0.0])
        read: list[Any] = []
        until(lambda: read.extend(device.read()) or len(read) >= 2)
        assert [each.pose[0] for each in read] == pytest.approx([0.5, 0.6])
        close(device)

    @pytest.mark.parametrize(("task", "shape"), [("sort", SHAPE), ("stop", (4, 16))])
    def test_another_machine_is_refused(self, machine, task, shape) -> None:
        device = OpcUaDevice(machine.url, task, shape, SECURITY)
        connect(device)
        assert "must be" in fault_of(device)
        close(device)


def test_a_machine_that_was_gone_is_there_again(machine, device) -> None:
    device.set_axes(AXES)
    until(lambda: machine.axes)
    machine.do(machine.server.bserver.stop())
    assert fault_of(device)
    close(device)
    with pytest.raises(DeviceLost, match="is not there"):
        device.connect()
    machine.do(machine.server.bserver.start())
    connect(device)
    assert device.set_axes(-AXES) == 2
    until(lambda: machine.axes[1:])
    np.testing.assert_array_equal(machine.axes[1][1], -AXES)


def test_a_link_that_shows_no_life_is_replaced(machine) -> None:
    """Whatever the library waits for, the loop notices."""
    ahead = [0.0]
    device = connected(machine, now=lambda: time.monotonic() + ahead[0])
    link = device._link
    ahead[0] += opcua.SILENCE + 1.0
    with pytest.raises(DeviceLost, match="must answer"):
        device.read()
    link.alive = -1e9
    link._beat = None
    with suppress(DeviceLost):
        device.connect()
    assert device._link is not link
    connect(device)
    assert device.read() is not None
    link.thread.join(PATIENCE)
    close(device)


def make_certificates(folder: Path, names: tuple[str, ...]) -> list[Path]:
    """A folder of certificates for each, where the first two know each other."""
    folders = [folder / name for name in names]
    for each in folders:
        each.mkdir()
        asyncio.run(
            cert_gen.setup_self_signed_certificate(
                each / "own.pem", each / "own.der", "urn:test", "localhost",
                [ExtendedKeyUsageOID.CLIENT_AUTH, ExtendedKeyUsageOID.SERVER_AUTH], {},
            )
        )  # fmt: skip
        (each / "own.pem").chmod(0o600)
    for one, other in ((0, 1), (1, 0), (2, 0)):
        (folders[one] / "peer.der").write_bytes((folders[other] / "own.der").read_bytes())
    return folders


def test_certificates_encrypt_and_strangers_have_none(tmp_path) -> None:
    folders = make_certificates(tmp_path, ("machine", "loop", "stranger"))
    whole = [OpcUaSecurity(TOKEN, certificates=folder) for folder in folders]
    machine = Machine(security=whole[0])
    device = OpcUaDevice(machine.url, "stop", SHAPE, whole[1])
    connect(device)
    device.set_axes(AXES)
    assert until(device.read)[0].refused == ""
    close(device)
    for security in (whole[2], SECURITY):
        device = OpcUaDevice(machine.url, "stop", SHAPE, security)
        connect(device)
        assert fault_of(device)
        close(device)
    assert len(machine.axes) == 1
    machine.close()
    (folders[1] / "own.pem").chmod(0o644)
    with pytest.raises(ValueError, match="mode 600"):
        OpcUaDevice(machine.url, "stop", SHAPE, whole[1])
    (folders[0] / "peer.der").unlink()
    with pytest.raises(FileNotFoundError):
        OpcUaServer("stop", SHAPE, whole[0], machine.set_axes, time.monotonic)


def test_only_this_computer_is_reached_without_certificates() -> None:
    with pytest.raises(ValueError, match="certificates must be given"):
        OpcUaServer("stop", SHAPE, SECURITY, lambda *_: None, time.monotonic, host="0.0.0.0")
    with pytest.raises(ValueError, match="certificates must be given"):
        OpcUaDevice("opc.tcp://192.0.2.1:4840", "stop", SHAPE, SECURITY)
    assert parse_address("opc.tcp://me@host:4840/path") == ("host", 4840)
    with pytest.raises(ValueError, match="host:port"):
        RuntimeConfig("stop-ppo", address="opc.tcp://host")
    with pytest.raises(ValueError, match="token must be given"):
        open_device("opc.tcp://127.0.0.1:1", None, RuntimeConfig("stop-ppo"), "stop", SHAPE)


def test_the_simulator_is_a_server_in_another_process(tmp_path) -> None:
    arguments = ["--task", "stop", "--preset", "camera", "--opcua", "0"]
    with SimulatorProcess(arguments, tmp_path / "log") as process:
        url = "opc.tcp://{}:{}".format(*process.address)
        device = open_device(url, process.token, RuntimeConfig("stop-ppo"), "stop", (4, 16))
        assert isinstance(device, OpcUaDevice)
        connect(device)
        read: list[ms.Message] = []

        def has_read(kind: type) -> bool:
            read.extend(device.read())
            return any(isinstance(each, kind) for each in read)

        until(lambda: has_read(ms.ParcelEntry))
        device.set_axes(np.zeros((4, 16)))
        until(lambda: has_read(ms.AxesAcknowledgement))
        assert has_read(ms.Frame)
        close(device)
