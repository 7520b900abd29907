"""What happens when clocks jump, devices stop, controllers compete and numbers begin again."""

import itertools
import math
import socket
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from benchmarks.tracking import SimulatedClock
from surface_gym.agents.runtime import controller as runtime
from surface_gym.agents.runtime.config import WorldOptions
from surface_gym.agents.runtime.protocol import SocketDevice
from surface_gym.agents.runtime.simulator import MachineServer
from surface_gym.agents.runtime.worlds import SimulatedMachine
from surface_gym.machine import messages as ms
from surface_gym.machine.messages import (
    AxesAcknowledgement,
    Frame,
    Message,
    ParcelDeparture,
    ParcelEntry,
)
from tests.agents.runtime import made
from tests.agents.runtime.made import TOKEN, Always, entered
from tests.agents.runtime.test_hostile import Machine, SharedClock, frame, line, loop_over

PERIOD = 0.04  # [s]
LATE = 0.02  # [s] from a picture to its message


class JumpingClock(SimulatedClock):
    """A clock that jumps once, and on which nobody sleeps for long."""

    def __init__(self, at: float = math.inf, by: float = 0.0) -> None:
        super().__init__()
        self.at, self.by = at, by
        self.after: list[Callable[[], None]] = []  # what is done after the jump

    def sleep_until(self, moment: float) -> None:
        assert moment - self.time < 2.0 * PERIOD + 1e-9
        super().sleep_until(moment)
        if self.time >= self.at:
            self.time, self.at = self.time + self.by, math.inf
            for do in self.after:
                do()


@dataclass
class Camera(made.ScriptedDevice):
    """A device that sees its parcel every period, and acknowledges commands."""

    number: Callable[[float], int] = lambda _: 0  # of its parcel at a time [s]
    x: Callable[[float], float] = lambda now: min(0.125 + now, 1.0)  # where the parcel is [m]
    sees: Callable[[float], bool] = lambda _: True  # at a time [s]
    answers: Callable[[float], bool] = lambda _: True
    pending: list[Message] = field(default_factory=list)

    def read(self) -> list[Message]:
        now = self.clock.now()
        messages, self.pending = [*super().read(), *self.pending], []
        if self.sees(now):
            messages.append(made.frame(now - LATE, self.number(now), self.x(now - LATE)))
        return messages

    def set_axes(self, angles: ms.Angles) -> int:
        number, now = super().set_axes(angles), self.clock.now()
        if self.answers(now):
            self.pending.append(AxesAcknowledgement(number, now))
        return number


def control(
    device: made.ScriptedDevice, seconds: float, action: int = made.BRAKE
) -> tuple[runtime.ControlLoop, str]:
    """A loop that ran, and who decided in each period: policy "p", layout "f", or nobody "-"."""
    loop = made.loop_of(device, Always(action, device.clock))
    deciders: list[str] = []

    def note(_: float) -> None:
        counts = loop.counts
        by_policy = counts.decisions > deciders.count("p")
        by_layout = counts.by_fixed_layout > deciders.count("f")
        deciders.append("p" if by_policy else "f" if by_layout else "-")

    loop.run(seconds, note)
    assert loop.counts.out_of_range == 0
    return loop, "".join(deciders)


@pytest.mark.parametrize("by", [0.5, 5.0, 3600.0])
def test_a_clock_that_jumps_ahead_brings_the_layout_until_a_frame_is_there(by) -> None:
    clock = JumpingClock(0.4, by)
    # The camera's clock jumps as well; it is dark for two more periods.
    device = Camera(clock, [(0.0, entered())], sees=lambda now: not 0.4 < now < by + 0.5)
    loop, deciders = control(device, by + 1.2)
    counts = loop.counts
    assert counts.lost == 0
    assert counts.periods + counts.skipped == round((by + 1.2) / PERIOD)
    assert counts.skipped == pytest.approx(by / PERIOD, abs=2)
    assert "p" * 8 + "fff" + "p" * 8 in deciders


@pytest.mark.parametrize("by", [0.3, 5.0, 3600.0])
def test_a_clock_that_is_set_back_brings_the_layout_until_frames_are_newer(by) -> None:
    clock = JumpingClock(0.4, -by)
    device = Camera(clock, [(0.0, entered())])
    loop, deciders = control(device, 1.6)
    counts = loop.counts
    assert counts.periods == len(deciders) == 40
    assert (counts.lost, counts.set_back, counts.watchdog) == (0, 1, 1)
    # The last frame that was used came at 0.36 s; 0.2 s later the layout is there.
    assert deciders in ("p" * 14 + "f" * 3 + "p" * 23, "p" * 15 + "f" * 25)
    assert deciders.endswith("p") == (by < 1.0)


@pytest.mark.parametrize("by", [5.0, 3600.0])
def test_a_clock_that_is_set_back_is_the_next_parcels_clock(by) -> None:
    clock, then = JumpingClock(0.4, -by), 1.2 - by
    device = Camera(clock, [(0.0, entered())], number=lambda now: int(then <= now < 0.0))
    device.x = lambda now: 0.125 + min(max(0.0, now - then), 0.5) if now < 0.0 else 0.125 + now
    clock.after.append(lambda: device.script.append((then, entered(1, then))))
    _, deciders = control(device, 1.6)
    assert deciders.endswith("f" * 14 + "p" * 11)


@pytest.mark.parametrize("by", [5.0, 3600.0])
def test_a_clock_that_is_set_back_while_the_device_is_away_delays_nothing(by) -> None:
    clock = JumpingClock(0.8, -by)
    device = made.ScriptedDevice(clock, away=[(0.2, math.inf), (-math.inf, -by + 2.0)])
    device.script = []
    loop, _ = control(device, 5.0)
    assert loop.counts.connected == 2


def test_frames_from_the_future_bring_the_layout() -> None:
    clock = JumpingClock()
    device = Camera(clock, [(0.0, entered())], sees=lambda now: now < 0.4)
    device.script += [(0.4, made.frame(0.4 + ahead, x=0.5)) for ahead in (0.2, 1.0, 1e12)]
    loop, deciders = control(device, 1.2)
    assert deciders == "p" * 14 + "f" * 16
    assert loop.counts.frames_unused == 3


class Stopping(Machine):
    """A machine that acknowledges, and whose process stops for a while, with open sockets."""

    def turn(self) -> None:
        if 0.4 <= self.clock.now() < 5.0:
            return
        super().turn()
        lines = [ms.from_line(sent) for sent in self.received.split(b"\n")[:-1]]
        self.received = self.received.rpartition(b"\n")[2]
        for fields in lines:
            self.waiting += line(AxesAcknowledgement(fields["command"], self.clock.now()))


def run_over(machine: Machine, seconds: float) -> Any:
    """Run a loop that brakes on a machine behind a socket, and return its counts."""
    loop = loop_over(machine)
    loop.run(seconds, made.nothing)
    machine.end()
    return loop.counts


def test_a_device_that_is_stopped_is_lost_and_found_again() -> None:
    counts = run_over(Stopping(SharedClock(), frame), 8.0)
    assert counts.periods == counts.kept == 200
    names = list(counts.faults)
    assert names[0] == "device must send a message within 2 s of a command, got none"
    assert counts.by_fixed_layout == pytest.approx((2.0 - 0.2) / PERIOD, abs=2)
    assert set(names[1:]) <= {"device must greet within 2 s, got no greeting"}
    assert counts.decisions > 0.3 / PERIOD + 2.0 / PERIOD  # before, and again in the end


def test_a_device_that_neither_answers_nor_reads_is_lost_when_its_queue_is_full() -> None:
    counts = run_over(Machine(SharedClock(), lambda _: b"", reads=False), 30.0)
    assert set(counts.faults) == {"the other side does not read"}
    assert counts.periods == 750


def test_acknowledgements_that_stop_bring_the_layout_until_they_return() -> None:
    clock = JumpingClock()
    device = Camera(clock, [(0.0, entered())], answers=lambda now: not 0.4 <= now < 0.8)
    loop, deciders = control(device, 1.2)
    assert deciders == "p" * 16 + "f" * 4 + "p" * 10
    assert (loop.counts.unacknowledged, loop.counts.lost) == (1, 0)


def test_a_device_that_never_acknowledges_is_led_as_before() -> None:
    device = Camera(JumpingClock(), [(0.0, entered())], answers=lambda _: False)
    loop, deciders = control(device, 1.2)
    assert deciders == "p" * 30
    assert loop.counts.unacknowledged == 0


def test_a_device_that_fell_silent_in_the_dark_is_not_lost_without_acknowledgements() -> None:
    device = Camera(
        JumpingClock(), [(0.0, entered())], answers=lambda _: False, sees=lambda now: now < 0.4
    )
    loop, deciders = control(device, 6.0)
    assert set(deciders[15:]) == {"f"}
    assert loop.counts.lost == 0


@pytest.mark.parametrize("token", [None, TOKEN])
def test_a_second_controller_waits_until_the_first_is_gone(token) -> None:
    listener = socket.create_server(("127.0.0.1", 0))
    world = SimulatedMachine(made.CONFIG, 0, 0.0, WorldOptions(pause=0.1))
    server = MachineServer(world, "stop", listener, token)
    clock = SimulatedClock()
    loops = []
    for action in (made.BRAKE, made.ROLL):
        device = SocketDevice(
            listener.getsockname(), "stop", made.estimator().shape, token, clock.now
        )
        loop = made.loop_of(device, Always(action, clock))
        loop._estimator = made.StateEstimator(made.CONFIG) if loops else made.estimator()
        loop._estimator.clear()
        loops.append(loop)
    first, second = loops
    for k in range(1, 1200):
        clock.time = 0.005 * k
        if k % 8 == 0:
            first.step(clock.time)
        if k % 8 == 4 and k > 100:
            second.step(clock.time)
        server.step(clock.time)
    assert (first.counts.connected, first.counts.lost) == (1, 0)
    assert first.counts.decisions > 50
    assert second.counts.sent == second.counts.frames == 0
    assert second.counts.attempts >= 4
    assert all("busy" in name for name in second.counts.faults)
    first._device.close()
    for k in range(1200, 2000):
        clock.time = 0.005 * k
        if k % 8 == 4:
            second.step(clock.time)
        server.step(clock.time)
    assert second.counts.decisions > 10
    server.close()
    second._device.close()


def test_numbers_that_begin_again_are_another_parcel() -> None:
    clock = JumpingClock()
    device = Camera(clock, [(0.0, entered()), (0.6, entered(0, 0.6, goal=(0.7,)))])
    device.x = lambda now: min(0.125 + (now if now < 0.6 else now - 0.6), 1.0)
    loop, deciders = control(device, 1.2)
    assert loop._estimator.entered.goal == (0.7,)
    assert loop._estimator.entered.at == 0.6
    assert deciders == "p" * 30


def test_the_same_parcel_again_is_followed_to_the_entry() -> None:
    clock = JumpingClock()
    device = Camera(clock, [(0.0, entered()), (0.6, entered(0, 0.6))])
    device.x = lambda now: 0.125 + (now if now < 0.6 else now - 0.6)
    loop, deciders = control(device, 1.0, made.ROLL)
    assert deciders == "p" * 25
    assert loop.counts.unused == 1
    assert loop._estimator.estimate[0] == pytest.approx(device.x(1.0 - PERIOD), abs=0.05)


def test_commands_whose_numbers_begin_again_are_answered() -> None:
    clock = JumpingClock()

    class Restarting(Camera):
        def set_axes(self, angles: ms.Angles) -> int:
            if len(self.sent) == 10:
                self.sent.clear()
                self.pending.clear()  # the last answer is lost
            return super().set_axes(angles)

    loop, deciders = control(Restarting(clock, [(0.0, entered())]), 1.2)
    assert deciders == "p" * 30
    assert loop.counts.unacknowledged == 0


def test_a_restart_of_the_devices_clock_leaves_parcels_alone() -> None:
    clock = JumpingClock()
    clock.time = 100.0
    device = Camera(clock, [(100.0, entered(0, 100.0))], sees=lambda now: now < 100.4)
    device.script += [(100.4, entered(0, 0.0, goal=(0.7,))), (100.8, entered(1, 100.8))]
    device.script += [(100.4 + taken, made.frame(taken)) for taken in np.arange(0.0, 0.4, 0.04)]
    loop, deciders = control(device, 1.0)
    assert loop.counts.unfit == 1
    assert deciders.strip("p") == "-" * 10


NONE = (math.nan, math.inf, None, True, "1")
MESSAGES = {
    "frame taken": lambda none: Frame(none, 0, (0.3, 1.0, 0.0)),
    "frame number": lambda none: Frame(0.2, none, (0.3, 1.0, 0.0)),
    "frame pose": lambda none: Frame(0.2, 0, (none, 1.0, 0.0)),
    "frame axes": lambda none: Frame(0.2, 0, (0.3, 1.0, 0.0), np.full((4, 16), none)),
    "entry number": lambda none: entered(none, 0.2),
    "entry at": lambda none: entered(1, none),
    "entry pose": lambda none: entered(1, 0.2, pose=(0.1, none, 0.0)),
    "entry velocity": lambda none: entered(1, 0.2, velocity=(none, 0.0, 0.0)),
    "entry goal": lambda none: entered(1, 0.2, goal=(none,)),
    "entry tilt": lambda none: entered(1, 0.2, tilt=none),
    "entry parcel": lambda none: ParcelEntry(1, 0.2, none, made.POSE, made.VELOCITY, (1.0,)),
    "command": lambda none: AxesAcknowledgement(none, 0.2),
    "acknowledged": lambda none: AxesAcknowledgement(1, none),
    "departure": lambda none: ParcelDeparture(none, "success"),
    "outcome": lambda none: ParcelDeparture(0, none),
    "metrics": lambda none: ParcelDeparture(0, "success", {"error": none}),
}
# What has a meaning: a frame of no parcel, and an outcome that is a text.
ALLOWED = {("frame number", None), ("outcome", "1")}


@pytest.mark.parametrize(
    ("name", "none"),
    [each for each in itertools.product(MESSAGES, NONE) if each not in ALLOWED],
)
def test_a_number_that_is_none_is_a_fault_of_the_device(name, none) -> None:
    message = MESSAGES[name](none)
    device = Camera(JumpingClock(), [(0.0, entered()), (0.2, message), (0.6, entered(2, 0.6))])
    device.number = lambda now: 0 if now < 0.6 else 2
    loop, deciders = control(device, 1.2)
    assert loop.counts.lost == 1
    assert len(loop.counts.faults) == 1
    assert deciders.endswith("p" * 14)
    assert len(deciders) == 30


@pytest.mark.parametrize("none", NONE)
def test_a_command_without_a_number_is_a_fault_of_the_device(none) -> None:
    class Unnumbered(Camera):
        def set_axes(self, angles: Any) -> Any:
            super().set_axes(angles)
            return none

    loop, _ = control(Unnumbered(JumpingClock(), [(0.0, entered()), (0.4, entered(1, 0.4))]), 0.8)
    assert loop.counts.lost == 2


@pytest.mark.parametrize("error", [ValueError, OSError])
@pytest.mark.parametrize("call", ["connect", "read", "set_axes"])
def test_an_error_of_a_driver_is_the_loss_of_the_device(call, error) -> None:
    class Failing(Camera):
        def __getattribute__(self, name: str) -> Any:
            if name == call and 0.2 < object.__getattribute__(self, "clock").now() < 0.4:
                raise error("x must be finite")
            return super().__getattribute__(name)

    device = Failing(JumpingClock(), [(0.0, entered()), (0.8, entered(1, 0.8))])
    device.number = lambda now: int(now >= 0.8)
    if call == "connect":
        device.away = [(0.1, 0.3)]
    loop, deciders = control(device, 1.2)
    assert loop.counts.lost >= 1
    assert deciders.endswith("p" * 9)
    assert loop.counts.faults["x must be finite"] >= (call != "connect")
