"""Messages come out of the socket as they went in, or not at all."""

import json
import math
import socket
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.agents.runtime import protocol
from surface_gym.agents.runtime.config import parse_address
from surface_gym.machine import messages as ms
from surface_gym.machine.messages import to_line
from tests.agents.runtime.made import TOKEN

SHAPE = (2, 3)
TRIANGLE = sg.Polygon([[0.0, 0.0], [0.3, 0.0], [0.0, 0.3]])


def again_and_again(call: Callable[[], Any]) -> None:
    for _ in range(1000):
        call()


def there_and_back(message: Any) -> Any:
    line = to_line(ms.to_fields(message))
    assert line.endswith(b"\n")
    assert line.count(b"\n") == 1
    return ms.from_fields(ms.from_line(line), SHAPE)


@pytest.mark.parametrize(
    "message",
    [
        ms.Frame(1.25),
        ms.Frame(1.25, 3, (0.1, 1.0, 0.2)),
        ms.Detections(1.25),
        ms.Detections(1.25, ((0.1, 1.0, 0.2), (0.5, 1.1, -0.2))),
        ms.AxesAcknowledgement(7, 2.5),
        ms.AxesAcknowledgement(7, 2.5, "out of range"),
        ms.ParcelDeparture(3, "success", {"stop_error": 0.001}),
    ],
)
def test_messages_come_out_as_they_went_in(message) -> None:
    back = there_and_back(message)
    assert type(back) is type(message)
    assert vars(back) == vars(message)


def test_axes_come_out_as_they_went_in() -> None:
    axes = np.arange(6.0).reshape(SHAPE) / 10.0
    np.testing.assert_array_equal(there_and_back(ms.Frame(0.0, 0, axes=axes)).axes, axes)
    fields = ms.from_line(to_line(ms.axes_to_fields(4, axes)))
    number, back = ms.axes_from_fields(fields, SHAPE)
    assert number == 4
    np.testing.assert_array_equal(back, axes)


def test_a_gate_s_times_come_out_as_they_went_in() -> None:
    fields = ms.from_line(to_line(ms.gate_to_fields(1.5, 1.75)))
    assert ms.gate_from_fields(fields) == (1.5, 1.75)
    with pytest.raises(ValueError, match="end"):
        ms.gate_from_fields({"kind": "gate", "begin": 0.0, "end": None})


@pytest.mark.parametrize("base", [sg.Rectangle(0.3, 0.2), sg.Disc(0.15), TRIANGLE])
def test_a_parcel_has_the_same_base_around_its_centroid(base) -> None:
    path = np.linspace(0.0, 1.0, 4)
    sent = ms.ParcelEntry(
        2,
        1.5,
        sg.Parcel(base, mass=3.0),
        (0.1, 1.0, 0.0),
        (1.0, 0.0, 0.0),
        (0.5,),
        0.1,
        path,
        tilt_direction=2.0,
    )
    back = there_and_back(sent)
    assert not back.waits
    assert there_and_back(replace(sent, waits=True)).waits
    assert (back.number, back.at, back.pose, back.velocity) == (2, 1.5, sent.pose, sent.velocity)
    assert (back.goal, back.parcel.mass) == ((0.5,), 3.0)
    assert (back.tilt, back.tilt_direction) == (0.1, 2.0)
    np.testing.assert_array_equal(back.path, path)
    assert back.parcel.base.gyration == pytest.approx(base.gyration)
    assert back.parcel.base.reach == pytest.approx(base.reach)
    np.testing.assert_allclose(back.parcel.base.centroid, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    "line",
    [
        b"", b"{", b"[1, 2]", b"{}", b'{"kind": 3}', b'{"kind": "frame", "taken": NaN}',
        b"\xff\xfe", b"[" * 100_000, b"cos\nsystem\n(S'ls'\ntR.",  # what would be a pickle
    ],
)  # fmt: skip
def test_a_line_that_is_no_message_is_refused(line) -> None:
    with pytest.raises(ValueError, match=r"line must|numbers must"):
        ms.from_line(line)


FRAME = ms.to_fields(ms.Frame(0.0, 0, axes=np.zeros(SHAPE)))
ENTERED = ms.to_fields(
    ms.ParcelEntry(0, 0.0, sg.Parcel(sg.Disc(0.1)), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), ())
)
ACKNOWLEDGED = ms.to_fields(ms.AxesAcknowledgement(0, 0.0))
DETECTED = ms.to_fields(ms.Detections(0.0))
DEPARTED = ms.to_fields(ms.ParcelDeparture(0, "missed"))


@pytest.mark.parametrize(
    ("fields", "changed", "message"),
    [
        (FRAME, {"kind": "system"}, "kind must be one of"), (FRAME, {"taken": "now"}, "taken"),
        (FRAME, {"taken": None}, "taken"), (FRAME, {"number": -1}, "number"),
        (FRAME, {"number": 2**60}, "number"), (FRAME, {"pose": [1e9, 1.0, 0.0]}, "pose must be be"),
        (FRAME, {"pose": [0.3, True, 0.0]}, "pose"), (ENTERED, {"mass": True}, "mass must"),
        (ENTERED, {"goal": {}}, "goal must"), (ENTERED, {"goal": [{}]}, "goal must"),
        (ENTERED, {"goal": [10**400]}, "goal must"), (ENTERED, {"goal": ["1"]}, "goal must"),
        (ENTERED, {"goal": [True]}, "goal must"), (ENTERED, {"goal": [1.0, True]}, "goal must"),
        (ENTERED, {"goal": json.loads("[" * 900 + "]" * 900)}, "goal must"),
        (ENTERED, {"base": [0.1]}, "base must"), (ENTERED, {"velocity": [1e300, 0, 0]}, "velocity"),
        (ENTERED, {"base": {"corners": [[math.cos(k), math.sin(k)] for k in range(6000)]}},
         "corners must be at most"),
        (DEPARTED, {"outcome": "x" * 100_000}, "outcome must be text of at most"),
        (FRAME, {"pose": [0.0, 1.0]}, "pose"), (FRAME, {"pose": ["0", 1.0, 2.0]}, "pose"),
        (FRAME, {"axes": [[0.0]]}, "axes"), (ENTERED, {"base": {"radius": -1.0}}, "radius"),
        (ENTERED, {"base": {"shape": "disc"}}, "base"), (ENTERED, {"base": "disc"}, "base"),
        (ENTERED, {"base": {"corners": [[0, 0], [1, 1]]}}, "vertices"),
        (ENTERED, {"mass": 0.0}, "mass"), (ENTERED, {"goal": ["left"]}, "goal|could not convert"),
        (ENTERED, {"tilt": 3.0}, "tilt"), (ENTERED, {"tilt_direction": 90.0}, "tilt_direction"),
        (ENTERED, {"path": [None]}, "path"),
        (ACKNOWLEDGED, {"command": 0.5}, "command"), (ACKNOWLEDGED, {"refused": 3}, "refused"),
        (ENTERED, {"waits": 1}, "waits"), (DETECTED, {"taken": True}, "taken"),
        (DETECTED, {"poses": {}}, "poses"), (DETECTED, {"poses": [[0.0, 1.0]]}, "poses"),
        (DETECTED, {"poses": [[0.0, 1.0, 0.0]] * 513}, "poses must be a list of at most 512"),
        (DETECTED, {"poses": [[0.0, 1e9, 0.0]]}, "poses"),
        (DEPARTED, {"outcome": 0}, "outcome"), (DEPARTED, {"figures": []}, "figures"),
        (DEPARTED, {"figures": {"error": "large"}}, "error"),
    ],
)  # fmt: skip
def test_a_field_that_is_not_allowed_is_refused(fields, changed, message) -> None:
    with pytest.raises(ValueError, match=message):
        ms.from_fields({**fields, **changed}, SHAPE)


def test_a_field_that_is_missing_is_named_and_what_is_not_finite_is_not_sent() -> None:
    with pytest.raises(ValueError, match="frame must have 'taken'"):
        ms.from_fields({"kind": "frame", "number": None, "axes": None}, SHAPE)
    with pytest.raises(ValueError, match="JSON"):
        to_line(ms.axes_to_fields(0, np.array([[math.nan]])))


@pytest.mark.parametrize(
    "fields", [{"kind": "axes"}, {"kind": "axes", "command": 0, "angles": [[1.0]]}, ACKNOWLEDGED]
)
def test_other_messages_than_axis_commands_are_refused(fields) -> None:
    with pytest.raises(ValueError, match=r"must"):
        ms.axes_from_fields(fields, SHAPE)


@pytest.fixture
def ends() -> Iterator[tuple[protocol.Connection, protocol.Connection]]:
    here, there = map(protocol.Connection, socket.socketpair())
    yield here, there
    here.close()
    there.close()


def test_lines_arrive_whole_and_an_end_is_noticed_once_all_is_read(ends) -> None:
    here, there = ends
    assert there.lines() == []
    here.send(b"one\ntw")
    assert there.lines() == [b"one"]
    here.send(b"o\nlast\n")
    here.close()
    assert there.lines() == [b"two", b"last"]
    with pytest.raises(protocol.ConnectionLost, match="gone"):
        there.lines()
    with pytest.raises(protocol.ConnectionLost, match="gone"):
        again_and_again(lambda: there.send(b"hello\n"))


def test_what_is_taken_in_at_a_time_is_bounded(ends) -> None:
    here, there = ends
    here.send(b"a\n" * 3 * protocol.MAX_LINES)
    assert [len(there.lines()) for _ in range(4)] == [protocol.MAX_LINES] * 3 + [0]
    there.put_back([b"b", b"c"])
    assert there.lines() == [b"b", b"c"]
    sizes = []

    def flood() -> None:
        here.send((b"x" * 999 + b"\n") * 40)
        sizes.append(sum(map(len, there.lines())))

    with pytest.raises(protocol.ConnectionLost, match="must send at most"):
        again_and_again(flood)
    assert len(sizes) == protocol.MAX_FULL
    assert max(sizes) <= protocol.MAX_READ + 999


def test_a_side_that_does_not_read_or_end_its_line_is_given_up(ends) -> None:
    here, there = ends

    def send_and_read() -> None:
        here.send(b"x" * 10_000)
        there.lines()

    with pytest.raises(protocol.ConnectionLost, match="line must have"):
        again_and_again(send_and_read)
    with pytest.raises(protocol.ConnectionLost, match="does not read"):
        again_and_again(lambda: here.send(b"x" * (protocol.MAX_LINE // 4)))


@pytest.mark.parametrize("text", ["", "host", "host:", ":80", "host:0", "host:x", "host:99999"])
def test_an_address_without_host_or_port_is_refused(text) -> None:
    with pytest.raises(ValueError, match="host:port"):
        parse_address(text)


class TestDevice:
    """The driver, with the test as the machine."""

    @pytest.fixture
    def listener(self) -> Iterator[socket.socket]:
        with socket.create_server(("127.0.0.1", 0)) as listener:
            yield listener

    @pytest.fixture
    def device(self, listener: socket.socket) -> Iterator[protocol.SocketDevice]:
        device = protocol.SocketDevice(listener.getsockname(), "stop", SHAPE)
        yield device
        device.close()

    def receive(
        self, listener: socket.socket, device: protocol.SocketDevice, *lines: bytes
    ) -> list[Any]:
        """Messages that the device reads."""
        device.connect()
        connected, _ = listener.accept()
        with connected:
            connected.sendall(b"".join(lines))
        return device.read()

    def test_it_reads_messages(self, listener, device) -> None:
        lines = (to_line(protocol.hello("stop", SHAPE)), to_line(FRAME), to_line(ACKNOWLEDGED))
        read = [type(each) for each in self.receive(listener, device, *lines)]
        assert read == [ms.Frame, ms.AxesAcknowledgement]

    def test_one_that_has_the_token_proves_it(self, listener, device) -> None:
        device._token, nonce = TOKEN, "1"
        for proof in (protocol.prove(TOKEN, "loop", nonce), "", None):  # a stranger's
            device.connect()
            connected, _ = listener.accept()
            with connected:
                connected.sendall(to_line(protocol.hello("stop", SHAPE, nonce)))
                assert device.read() == []
                answer = ms.from_line(connected.recv(4096))
                protocol.check_proof(answer, TOKEN, "loop", nonce)
                with pytest.raises(ValueError, match="proof must be by the token"):
                    protocol.check_proof(answer, TOKEN, "loop", "2")
                connected.sendall(to_line({"kind": "proof", "proof": proof}))
            with pytest.raises(protocol.DeviceLost, match="proof must"):
                device.read()
        with pytest.raises(protocol.DeviceLost, match="device must ask for the token"):
            self.receive(listener, device, to_line(protocol.hello("stop", SHAPE)))

    def test_one_that_is_not_there(self) -> None:
        with socket.create_server(("127.0.0.1", 0)) as listener:
            address = listener.getsockname()
        device = protocol.SocketDevice(address, "stop", SHAPE)
        with pytest.raises(protocol.DeviceLost, match="not there"):
            device.connect()
        for call in (device.read, lambda: device.set_axes(np.zeros(SHAPE))):
            with pytest.raises(protocol.DeviceLost, match="not connected"):
                call()

    def test_it_sends_axes(self, listener, device) -> None:
        device.connect()
        connected, _ = listener.accept()
        with connected:
            assert device.set_axes(np.zeros(SHAPE)) == 1
            assert device.set_axes(np.ones(SHAPE)) == 2
            first = json.loads(connected.recv(4096).splitlines()[0])
        assert first == {"kind": "axes", "command": 1, "angles": [[0.0] * 3] * 2}
        with pytest.raises(protocol.DeviceLost):
            again_and_again(lambda: device.set_axes(np.zeros(SHAPE)))
