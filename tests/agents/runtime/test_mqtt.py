"""Telemetry reaches a real broker; one that is slow, gone or hostile changes nothing."""

import asyncio
import json
import socket
import threading
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest
from amqtt.broker import Broker
from paho.mqtt import client as paho
from pwdlib import PasswordHash
from pwdlib.hashers.argon2 import Argon2Hasher

from benchmarks.tracking import SimulatedClock
from surface_gym.agents.runtime import mqtt
from surface_gym.agents.runtime.cli import open_listeners
from surface_gym.agents.runtime.config import RuntimeConfig
from surface_gym.agents.runtime.mqtt import BrokerOptions, Telemetry
from surface_gym.agents.runtime.report import Counts, Latencies
from surface_gym.machine.messages import ParcelDeparture, to_fields
from tests.agents.runtime import made
from tests.agents.runtime.made import until

USER, PASSWORD = "dashboard", "0123456789abcdef"
HOST = "127.0.0.1"


def free_port() -> int:
    with socket.create_server((HOST, 0)) as listener:
        return listener.getsockname()[1]


@pytest.fixture(scope="module")
def options(tmp_path_factory: pytest.TempPathFactory) -> BrokerOptions:
    folder, port = tmp_path_factory.mktemp("broker"), free_port()
    quick = Argon2Hasher(time_cost=1, memory_cost=8, parallelism=1)
    hashes = folder / "users"
    hashes.write_text(f"{USER}:{PasswordHash((quick,)).hash(PASSWORD)}\n")
    password = folder / "password"
    password.write_text(PASSWORD + "\n")
    password.chmod(0o600)
    return BrokerOptions(HOST, port, USER, password)


@pytest.fixture(scope="module")
def broker(options: BrokerOptions) -> Iterator[None]:
    """A broker that lets in its user only."""
    loop = asyncio.new_event_loop()
    thread = threading.Thread(target=loop.run_forever)
    thread.start()
    assert options.password_file is not None
    auth = {"password_file": str(options.password_file.parent / "users")}
    config = {
        "listeners": {"default": {"type": "tcp", "bind": f"{HOST}:{options.port}"}},
        "plugins": {"amqtt.plugins.authentication.FileAuthPlugin": auth},
    }

    async def start() -> Broker:
        broker = Broker(config)
        await broker.start()
        return broker

    async def stop(broker: Broker) -> None:
        await broker.shutdown()
        # It does not wait for the connections of clients that have just left.
        if others := asyncio.all_tasks() - {asyncio.current_task()}:
            await asyncio.wait(others, timeout=10.0)
        await asyncio.sleep(0.1)  # transports close in the loop's next rounds

    broker = asyncio.run_coroutine_threadsafe(start(), loop).result(60.0)
    yield
    asyncio.run_coroutine_threadsafe(stop(broker), loop).result(60.0)
    loop.call_soon_threadsafe(loop.stop)
    thread.join()
    loop.close()


class Dashboard:
    """A subscriber to all topics."""

    def __init__(self, options: BrokerOptions) -> None:
        self.seen: SimpleQueue[tuple[str, Any]] = SimpleQueue()
        subscribed = threading.Event()
        self.client = paho.Client(paho.CallbackAPIVersion.VERSION2)
        self.client.username_pw_set(USER, PASSWORD)
        self.client.on_connect = lambda client, *_: client.subscribe("surface-gym/#")
        self.client.on_subscribe = lambda *_: subscribed.set()
        self.client.on_message = lambda *given: self.seen.put(
            (given[-1].topic, json.loads(given[-1].payload))
        )
        self.client.connect(options.host, options.port)
        self.client.loop_start()
        assert subscribed.wait(60.0)

    def close(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()


@pytest.mark.usefixtures("broker")
def test_a_dashboard_sees_departures_poses_counts_and_times(options) -> None:
    clock = SimulatedClock()
    dashboard, telemetry = Dashboard(options), Telemetry(options, "stop", clock.now)
    until(telemetry._client.is_connected)
    left = ParcelDeparture(0, "success", {"stop_error": 0.001})
    script = [(0.1, made.entered(0, 0.1)), (0.5, made.frame(0.5)), (2.0, left)]
    device = made.ScriptedDevice(clock, list(script))
    counts, latencies = Counts(), Latencies()
    counts.sent, latencies.work = 7, [0.001, 0.003]
    for k in range(60):
        clock.time = 0.04 * k
        telemetry.hear(device.read(), counts, latencies)
    seen: dict[str, Any] = {}

    def receive() -> bool:
        while not dashboard.seen.empty():
            topic, data = dashboard.seen.get()
            seen[topic.removeprefix("surface-gym/stop/")] = data
        return len(seen) == 5

    until(receive)
    for name, message in (("entered", script[0][1]), ("parcels", script[1][1]), ("left", left)):
        assert seen[name] == to_fields(message)
    assert seen["counts"]["sent"] == 7
    assert seen["latencies"]["work"] == pytest.approx([0.002, 0.0028, 0.00298, 0.003])
    assert seen["latencies"]["send"] is None
    telemetry.close()
    dashboard.close()


@pytest.mark.usefixtures("broker")
def test_a_wrong_password_publishes_nothing(options, tmp_path) -> None:
    wrong = tmp_path / "password"
    wrong.write_text("another")
    wrong.chmod(0o600)
    dashboard = Dashboard(options)
    telemetry = Telemetry(BrokerOptions(HOST, options.port, USER, wrong), "stop")
    refused = threading.Event()
    telemetry._client.on_connect = lambda *given: given[3].is_failure and refused.set()
    assert refused.wait(60.0)
    telemetry.publish("counts", 1)
    telemetry.close()
    right = Telemetry(options, "stop")
    until(right._client.is_connected)
    right.publish("counts", 2)
    assert dashboard.seen.get(timeout=60.0) == ("surface-gym/stop/counts", 2)
    right.close()
    dashboard.close()


CONFIRMED = b"\x20\x02\x00\x00"  # that a client is connected
FLOOD = b"\x30\xff\xff\xff\x7f" + b"x" * 200_000  # the beginning of a message of 268 MB


@pytest.mark.parametrize(
    "answer", [b"", CONFIRMED, CONFIRMED + FLOOD, FLOOD, CONFIRMED + bytes(range(256)), None]
)
def test_a_broker_that_is_slow_or_gone_or_hostile_takes_no_room(answer) -> None:
    with socket.create_server((HOST, 0)) as listener:
        telemetry = Telemetry(BrokerOptions(HOST, listener.getsockname()[1]), "stop")
        telemetry._client.reconnect_delay_set(1, 1)
        peer, _ = listener.accept()
        if answer is None:  # it goes at once
            peer.close()
        else:
            with peer:
                peer.settimeout(60.0)
                peer.recv(4096)
                received = telemetry._client.received
                with suppress(ConnectionError):
                    peer.sendall(answer)
                if answer == CONFIRMED:
                    until(telemetry._client.is_connected)
                elif len(answer) > 1000:
                    until(lambda: telemetry._client._sock is None)
                for _ in range(10_000):  # which it never reads
                    telemetry.publish("counts", "x" * 1000)
                assert len(telemetry._sent) <= mqtt.MAX_SENT
                assert len(telemetry._client._out_packet) <= mqtt.MAX_SENT + 2
                assert len(telemetry._client._in_packet["packet"]) <= mqtt.MAX_RECEIVED
                assert received <= mqtt.MAX_RECEIVED
        telemetry.close()


def test_a_broker_that_was_gone_is_there_again() -> None:
    with socket.create_server((HOST, 0)) as listener:
        telemetry = Telemetry(BrokerOptions(HOST, listener.getsockname()[1]), "stop")
        for _ in range(2):
            with listener.accept()[0] as peer:
                peer.settimeout(60.0)
                peer.recv(4096)
                peer.sendall(CONFIRMED)
                until(telemetry._client.is_connected)
                telemetry.publish("counts", 1)
                while not peer.recv(4096).endswith(b"surface-gym/stop/counts1"):
                    pass
                for _ in range(1000):  # more than fits, left unread
                    telemetry.publish("counts", "x" * 100_000)
                assert len(telemetry._sent) == mqtt.MAX_SENT
            until(lambda: not telemetry._client.is_connected())
        telemetry.close()


def test_telemetry_is_only_there_if_asked_for_and_safe(tmp_path: Path) -> None:
    with ExitStack() as stack:
        assert open_listeners(RuntimeConfig("stop-ppo"), made.estimator(), stack) == []
        config = RuntimeConfig("stop-ppo", mqtt=f"{HOST}:{free_port()}")
        (asked,) = open_listeners(config, made.estimator(), stack)
        assert isinstance(asked, Telemetry)
    with pytest.raises(ValueError, match="host:port"):
        RuntimeConfig("stop-ppo", mqtt="nowhere")
    with pytest.raises(ValueError, match="mqtt_ca must be given"):
        BrokerOptions("192.0.2.1", 1883)
    open_to_all = tmp_path / "password"
    open_to_all.write_text(PASSWORD)
    open_to_all.chmod(0o644)
    with pytest.raises(ValueError, match="mqtt_password_file must have the mode 600"):
        Telemetry(BrokerOptions(HOST, 1883, USER, open_to_all), "stop")
