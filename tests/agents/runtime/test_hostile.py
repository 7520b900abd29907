"""Devices that do their worst: the loop goes on, the axes are safe, and there is a report."""

import io
import json
import math
import socket
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import count, repeat
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from benchmarks.tracking import SimulatedClock
from surface_gym.agents.runtime import cli, protocol, report
from surface_gym.agents.runtime.config import RuntimeConfig
from surface_gym.agents.runtime.controller import ControlLoop
from surface_gym.machine import messages as ms
from surface_gym.machine.messages import AxesAcknowledgement, Message, ParcelDeparture, to_line
from tests.agents.runtime import made

STEP = 0.02  # [s] between the machine's turns
CALM = 10  # turns in which it behaves well
PERIODS, SECONDS = 30, 1.2
HELLO = to_line(protocol.hello("stop", (4, 16)))

Says = Callable[[float], bytes]  # what the machine sends at a time [s]


def line(message: Message, **changed: Any) -> bytes:
    return json.dumps({**ms.to_fields(message), **changed}).encode() + b"\n"


def frame(now: float, **changed: Any) -> bytes:
    """What a camera that is 20 ms late sends of a parcel that stops at x = 1 m."""
    return line(made.frame(now - STEP, x=min(0.125 + now, 1.0)), **changed)


def entered(now: float, number: int = 1, **changed: Any) -> bytes:
    return line(made.entered(number, now), **changed)


def left(number: int = 0, outcome: str = "missed", **changed: Any) -> bytes:
    return line(ParcelDeparture(number, outcome), **changed)


def with_frames(says: Says) -> Says:
    """What is sent before each frame of a camera that works."""
    return lambda now: says(now) + frame(now)


@dataclass
class SharedClock(SimulatedClock):
    def __post_init__(self) -> None:
        super().__init__()
        self.turn: Callable[[], None] = lambda: None

    def sleep_until(self, moment: float) -> None:
        while self.time < moment - 1e-9:
            self.time = min(moment, self.time + STEP)
            self.turn()


@dataclass
class Machine:
    """A machine behind a socket: it greets, has a parcel, and does its worst after a while."""

    clock: SharedClock
    worst: Says
    greeting: bytes | None = HELLO  # None: it does its worst at once
    reads: bool = True
    closes: bool = False

    def __post_init__(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.listener.setblocking(False)
        self.peer: socket.socket | None = None
        self.turns: Iterator[bytes] = iter(())
        self.waiting, self.received = b"", b""

    def turn(self) -> None:
        with suppress(BlockingIOError):
            accepted, _ = self.listener.accept()
            self.close()
            self.peer, self.turns, self.waiting = accepted, self.say(), b""
            accepted.setblocking(False)
            accepted.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self.peer is None:
            return
        self.waiting = self.waiting or next(self.turns)
        if self.peer is None:
            return
        with suppress(OSError):
            self.waiting = self.waiting[self.peer.send(self.waiting) :]
        with suppress(OSError):
            self.received += self.peer.recv(1 << 16) if self.reads else b""

    def say(self) -> Iterator[bytes]:
        if self.greeting is not None:
            yield self.greeting
            yield entered(self.clock.now(), 0)
            for _ in range(CALM):
                yield frame(self.clock.now())
        for _ in repeat(None):
            yield self.worst(self.clock.now())
            if self.closes:
                self.close()

    def close(self) -> None:
        if self.peer is not None:
            self.peer.close()
            self.peer = None

    def end(self) -> None:
        self.close()
        self.listener.close()


def trickle(text: bytes) -> Says:
    rest = iter(text)
    return lambda _: bytes([next(rest, 32)])


def numbered(says: Callable[[int], bytes]) -> Says:
    numbers = count(1)
    return lambda _: says(next(numbers))


@cache
def burst() -> bytes:
    return b"".join(entered(0.3, number) for number in range(1, 20_001))


def wrong(**changed: Any) -> Says:
    return with_frames(lambda now: entered(now, **changed))


# By name: what it sends, and the name of the fault for which it is given up.
LOST: dict[str, tuple[Says, str]] = {
    "goal infinite": (lambda now: entered(now).replace(b"[1.0]", b"[1e999]"), "goal must"),
    "goal missing": (lambda now: entered(now).replace(b"goal", b"gaol"), "must have 'goal'"),
    "pose not a number": (lambda now: frame(now, pose=[math.nan, 1, 0]), "numbers must be finite"),
    "pose infinite": (lambda now: frame(now).replace(b"1.0", b"1e999"), "pose must be finite"),
    "5000 digits": (lambda now: frame(now).replace(b"1.0", b"1" * 5000), "Exceeds the limit"),
    "nested 100 000 deep": (lambda _: b"[" * 100_000 + b"\n", "line must"),
    "garbage": (lambda _: bytes(range(256)), "line must be JSON"),
    "empty lines": (lambda _: b"\n" * 1000, "line must be JSON"),
    "a list": (lambda _: b"[1, 2, 3]\n", "line must be an object"),
    "kind a list": (lambda _: b'{"kind": ["frame"]}\n', "line must be an object"),
    "greets again": (lambda _: HELLO, "kind must be one of"),
    "sends axes": (lambda _: to_line(ms.axes_to_fields(1, np.zeros((4, 16)))), "kind must"),
    "never stops": (lambda _: b"x" * (1 << 22), "line must have at most"),
    "never stops with frames": (lambda now: frame(now) * 40_000, "must send at most"),
    "20 000 parcels in a burst": (lambda _: burst(), "must send at most"),
}  # fmt: skip

# What it sends before and after a frame of a camera that stopped: the fixed layout is safe.
SAFE: dict[str, Says] = {
    "silent": lambda _: b"",
    "half a message": lambda now: frame(now)[:20] if now < 0.3 else b"",
    "a byte at a time": trickle(b" " * 1000),
    "frames an hour ahead": lambda now: frame(now + 3600.0),
    "frames ahead and now": lambda now: frame(now + 0.2) + frame(now, number=9),
    "clock set back": lambda now: frame(now - 3600.0),
    "clock stands still": lambda _: frame(0.2),
    "stamps run backwards": lambda now: frame(0.2 - 0.01 * now),
    "frames from before time": lambda now: frame(now, taken=-1e300),
    "frames after all time": lambda now: frame(now, taken=1e300),
    "frames of another parcel": lambda now: frame(now, number=7),
    "frames of none": lambda now: frame(now, number=None),
    "the same parcel enters again and again": lambda now: entered(now, 0),
    "only acknowledges": lambda now: line(AxesAcknowledgement(1, now)),
    "parcels leave that never entered": numbered(lambda k: left(k)),
}

# What it sends beside frames of a camera that works: the policy goes on.
CONTROLLED: dict[str, Says] = {
    "a parcel that never was leaves": lambda _: left(99),
    "commands acknowledged that never were": lambda now: line(AxesAcknowledgement(2**53, now)),
    "acknowledged an hour ahead": lambda now: line(AxesAcknowledgement(1, now + 3600.0)),
    "acknowledged before all time": lambda _: line(AxesAcknowledgement(1, -1e300)),
    "refuses all": numbered(lambda k: line(AxesAcknowledgement(k, 0.0, "[/x] no"))),
    "frames an hour ahead between": lambda now: frame(now + 3600.0),
    "frames twice": frame,
    "the same parcel enters twice": lambda now: entered(now, 0),
}


# A parcel that enters, and the name of the fault for which it is left alone.
UNFIT: dict[str, tuple[dict[str, Any], str]] = {
    "no goal": ({"goal": []}, "goal must"),
    "two goals": ({"goal": [1.0, 1.0]}, "goal must"),
    "a goal beyond physics": ({"goal": [1e300]}, "goal must be between"),
    "too long": ({"base": {"length": 1.9, "width": 0.3}}, "long"),
    "an hour ago": ({"at": -3600.0}, "at must be within"),
    "in an hour": ({"at": 3600.0}, "at must be within"),
}

# What it sends in place of a greeting, and the name of the fault for which it is given up.
GREETINGS: dict[str, tuple[bytes, str]] = {
    "nothing": (b"", "device must greet within 2 s"),
    "half of one": (HELLO[:20], "device must greet within 2 s"),
    "a message": (left(), "kind must be one of 'hello'"),
    "another version": (HELLO.replace(b'"protocol":1', b'"protocol":2'), "protocol must be"),
    "another task": (to_line(protocol.hello("sort", (4, 16))), "task must be one of 'stop'"),
    "another size": (to_line(protocol.hello("stop", (4, 17))), "zone must be"),
    "a size of truths": (HELLO.replace(b"[4,16]", b"[true,16]"), "zone must be"),
    "no size": (to_line({"kind": "hello", "protocol": 1, "task": "stop"}), "zone must be"),
    "a question": (to_line(protocol.hello("stop", (4, 16), "1")), "token must be given"),
    "UTF-16": (HELLO.decode().encode("utf-16"), "line must be"),
}


def loop_over(machine: Machine) -> ControlLoop:
    """A loop that brakes on a machine behind a socket."""
    clock = machine.clock
    clock.turn = machine.turn
    address, shape = machine.listener.getsockname(), made.estimator().shape
    device = protocol.SocketDevice(address, "stop", shape, now=clock.now)
    return made.loop_of(device, made.Always(made.BRAKE, clock))


def run(machine: Machine, folder: Any, seconds: float = SECONDS) -> dict[str, Any]:
    """The report's counts of a loop on a machine."""
    loop = loop_over(machine)
    config = RuntimeConfig("stop-ppo", minutes=seconds / 60.0, out=folder)
    printed = io.StringIO()
    cli.run_and_report(loop, config, made.CONFIG, Console(file=printed, width=200))
    machine.end()
    counts: dict[str, Any] = json.loads((folder / "report.json").read_text())["counts"]
    assert counts["periods"] == counts["kept"] == round(seconds / 0.04)
    assert counts["out_of_range"] == 0
    assert "\x1b[2J" not in printed.getvalue()
    assert all(name in printed.getvalue() for name in (*counts["parcels"], *counts["faults"]))
    for sent in machine.received.split(b"\n")[:-1]:
        if b"axes" in sent:
            _, angles = ms.axes_from_fields(ms.from_line(sent), (4, 16))
            assert np.abs(angles).max() <= 0.5 * math.pi
    return counts


@pytest.mark.parametrize(("worst", "fault"), LOST.values(), ids=LOST)
def test_a_device_that_cannot_be_understood_is_given_up_by_name(tmp_path, worst, fault) -> None:
    counts = run(Machine(SharedClock(), worst), tmp_path, seconds=1.6)
    assert any(fault in name for name in counts["faults"])
    assert counts["lost"] >= 1
    assert counts["attempts"] >= 2


@pytest.mark.parametrize("worst", SAFE.values(), ids=SAFE)
def test_only_a_frame_that_was_used_calms_the_watchdog(tmp_path, worst) -> None:
    """The last good frame comes at 0.24 s; 0.2 s later the fixed layout is there."""
    counts = run(Machine(SharedClock(), worst), tmp_path)
    assert counts["lost"] == 0
    assert counts["watchdog"] == 1
    assert counts["decisions"] <= 13
    assert counts["by_fixed_layout"] >= 15


@pytest.mark.parametrize("worst", CONTROLLED.values(), ids=CONTROLLED)
def test_what_is_of_no_use_does_not_end_control(tmp_path, worst) -> None:
    counts = run(Machine(SharedClock(), with_frames(worst)), tmp_path)
    assert counts["lost"] == counts["watchdog"] == 0
    assert counts["decisions"] >= PERIODS - 3


@pytest.mark.parametrize(("fields", "fault"), UNFIT.values(), ids=UNFIT)
def test_a_parcel_that_is_not_of_the_task_is_left_alone_by_name(tmp_path, fields, fault) -> None:
    counts = run(Machine(SharedClock(), lambda now: entered(now, **fields)), tmp_path)
    assert all(fault in name for name in counts["faults"])
    assert counts["unfit"] > PERIODS
    assert counts["lost"] == 0
    assert counts["sent"] <= CALM


@pytest.mark.parametrize("outcome", ["[/x]", "\x1b[2J", "\ud800\n", "x" * 1000])
def test_a_parcel_leaves_for_itself_alone_however_it_is_called(tmp_path, outcome) -> None:
    turn = count()

    def worst(now: float) -> bytes:  # another enters before it has left, again and again
        enters = b"" if next(turn) else entered(now, 1)
        return enters + left(0, outcome) + frame(now, number=1)

    counts = run(Machine(SharedClock(), worst), tmp_path)
    (name,) = counts["parcels"]
    assert name in ("[/x]", "?[2J", "??", "x" * 200)
    assert counts["parcels"][name] == 1
    assert counts["unused"] >= PERIODS
    assert counts["decisions"] >= PERIODS - 3


@pytest.mark.parametrize(("greeting", "fault"), GREETINGS.values(), ids=GREETINGS)
def test_a_device_that_does_not_greet_is_given_up_and_tried_again(
    tmp_path, greeting, fault
) -> None:
    said = iter((greeting,))
    machine = Machine(SharedClock(), lambda _: next(said, b""), greeting=None)
    counts = run(machine, tmp_path, seconds=2.4)
    assert any(fault in name for name in counts["faults"])
    assert counts["lost"] >= 1
    assert counts["attempts"] >= 2
    assert counts["sent"] == counts["frames"] == 0


def test_a_device_that_is_gone_at_once_or_does_not_read(tmp_path) -> None:
    counts = run(Machine(SharedClock(), lambda _: b"", greeting=None, closes=True), tmp_path)
    assert counts["lost"] >= 3
    assert set(counts["faults"]) == {"the other side is gone"}
    deaf = Machine(SharedClock(), frame, reads=False)
    assert run(deaf, tmp_path)["decisions"] >= PERIODS - 3


def test_outcomes_without_end_are_counted_in_few_names(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(report, "MAX_NAMES", 5)
    worst = numbered(lambda k: entered(0.02 * k, k) + left(k, f"outcome {k}"))
    counts = run(Machine(SharedClock(), worst), tmp_path)
    assert len(counts["parcels"]) == 5 + 1
    assert counts["parcels"]["others"] > 20
