"""Telemetry of a run to an MQTT broker, for dashboards. The broker cannot send anything back."""

import json
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from paho.mqtt import client as paho

from surface_gym.machine.messages import Angles, Message, to_fields
from surface_gym.physics.types import Array

from .config import LOOPBACK, read_secret
from .report import STAGES, Counts, Latencies, percentiles

TOPIC = "surface-gym"  # beginning of all topics
REPORT_EVERY = 1.0  # [s]
RECENT = 250  # number of the latest durations behind the percentiles
MAX_SENT = 16  # maximum number of reports that the broker has not read
# [bytes] that a broker may send: it only confirms a connection, and that it is alive
MAX_RECEIVED = 4096
KEEP_ALIVE = 10  # [s]
LONGEST_WAIT = 30  # [s] between attempts to connect
STATES = ("frame", "detections")  # messages with poses; the latest is shown


@dataclass(frozen=True)
class BrokerOptions:
    """The broker's address, the certificate of the broker's authority, a user and a password."""

    host: str
    port: int
    user: str | None = None
    password_file: Path | None = None
    ca: Path | None = None  # certificate of the broker's authority; None: loopback without TLS

    def __post_init__(self) -> None:
        if self.ca is None and self.host not in LOOPBACK:
            raise ValueError(
                f"mqtt_ca must be given for hosts other than {LOOPBACK[0]}, got none for "
                f"{self.host!r}"
            )


class _Client(paho.Client):
    """A client that disconnects if the broker sends more than confirmations."""

    received = 0  # [bytes] since the connection

    def _sock_recv(self, bufsize: int) -> bytes:
        self.received += bufsize
        if self.received > MAX_RECEIVED:
            self.received = 0
            raise ConnectionError("broker must only confirm, got more")
        return super()._sock_recv(bufsize)


class Telemetry:
    """A `Listener` that reports to a broker; reports are dropped if the broker is slow.

    Args:
        task: name of the run's task; topics contain this name.
        now: clock [s] of the reports.
    """

    def __init__(
        self, options: BrokerOptions, task: str, now: Callable[[], float] = time.monotonic
    ) -> None:
        self._now, self._reported = now, now()
        self._latest: dict[str, Any] | None = None  # the latest poses
        self._topic = f"{TOPIC}/{task}"
        self._client = _Client(paho.CallbackAPIVersion.VERSION2)
        if options.user is not None:
            file = options.password_file
            password = None if file is None else read_secret("mqtt_password_file", file)
            self._client.username_pw_set(options.user, password)
        if options.ca is not None:
            self._client.tls_set(str(options.ca))
        self._client.reconnect_delay_set(1, LONGEST_WAIT)
        self._client.connect_async(options.host, options.port, KEEP_ALIVE)
        self._client.loop_start()  # a thread; only this thread waits for the broker
        self._sent: deque[paho.MQTTMessageInfo] = deque()

    def publish(self, name: str, data: Any) -> None:
        """Publish data as surface-gym/TASK/`name`, unless the broker is slow or absent."""
        while self._sent and _is_gone(self._sent[0]):
            self._sent.popleft()
        if len(self._sent) < MAX_SENT and self._client.is_connected():
            payload = json.dumps(data, separators=(",", ":"))
            self._sent.append(self._client.publish(f"{self._topic}/{name}", payload))

    def hear(self, messages: Sequence[Message], counts: Counts, latencies: Latencies) -> None:
        """Publish entries and departures immediately, and the other reports once per second."""
        for message in messages:
            fields = to_fields(message)
            if fields["kind"] in STATES:
                self._latest = fields
            elif fields["kind"] != "taken":
                self.publish(fields["kind"], fields)
        now = self._now()
        if now - self._reported >= REPORT_EVERY:
            self._reported = now
            times = {name: percentiles(getattr(latencies, name)[-RECENT:]) for name in STAGES}
            self.publish("counts", asdict(counts))
            self.publish("latencies", times)
            self.publish("parcels", self._latest)

    def hear_command(self, number: int, angles: Angles) -> None:
        """Do nothing: commands are not reported."""

    def hear_tracked(self, taken_at: float, poses: Mapping[int, Array]) -> None:
        """Do nothing: `hear` reports the detections."""

    def close(self) -> None:
        self._client.disconnect()
        self._client.loop_stop()


def _is_gone(info: paho.MQTTMessageInfo) -> bool:
    try:
        return info.is_published()
    except RuntimeError:  # the connection was lost
        return True
