"""The loop: counts, the fixed layout in place of the policy, and a device that is lost."""

import math
from dataclasses import replace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from benchmarks.tracking import SimulatedClock
from surface_gym.agents.runtime import controller as runtime, deciders, protocol
from surface_gym.machine.messages import AxesAcknowledgement, ParcelDeparture
from tests.agents.runtime import made
from tests.agents.runtime.made import Always, entered


@pytest.fixture
def device() -> made.ScriptedDevice:
    return made.ScriptedDevice(SimulatedClock())


def frames(first: float, last: float, late: float = 0.02) -> list:
    times = np.arange(first, last, 0.02).tolist()
    return [(taken + late, made.frame(taken)) for taken in times]


def run(
    device: made.ScriptedDevice, seconds: float, action: Any = made.BRAKE, takes: float = 0.0,
    **config: float,
) -> runtime.ControlLoop:  # fmt: skip
    loop = made.loop_of(device, Always(action, device.clock, takes), **config)
    loop.run(seconds, made.nothing)
    return loop


def test_a_decision_a_period(device) -> None:
    device.script = [(0.0, entered()), *frames(0.02, 0.8)]
    controller = Always(made.BRAKE, device.clock)
    loop = made.loop_of(device, controller)
    loop.run(0.8, made.nothing)
    counts = loop.counts
    assert counts.periods == counts.kept == counts.decisions == counts.sent == 20
    assert counts.missed == counts.skipped == counts.by_fixed_layout == counts.out_of_range == 0
    assert controller.begins == [True] + [False] * 19
    assert all((angles[1:3] == 0.0).all() for angles in device.sent)
    assert loop.latencies.late == pytest.approx([0.0] * 20, abs=1e-9)
    assert max(loop.latencies.sensor) < 0.0601


def test_a_deadline_that_is_missed_is_counted(device) -> None:
    device.script = [(0.0, entered()), *frames(0.02, 0.9)]
    loop = run(device, 0.8, takes=0.05)
    counts = loop.counts
    assert (counts.kept, counts.missed, counts.periods + counts.skipped) == (0, counts.periods, 20)
    assert counts.skipped > 0
    assert loop.latencies.policy == pytest.approx([0.05] * counts.decisions)


def test_the_fixed_layout_replaces_the_policy_while_no_frames_come(device) -> None:
    device.script = [(0.0, entered()), *frames(0.02, 0.2), *frames(0.6, 0.9)]
    counts = run(device, 0.88, watchdog=0.15).counts
    assert counts.watchdog == 1
    # The last frame comes at 0.2 s, the next at 0.62 s.
    assert counts.by_fixed_layout == pytest.approx((0.62 - 0.2 - 0.15) / 0.04, abs=1)
    assert counts.decisions == 22 - counts.by_fixed_layout
    layouts = [tuple(each.ravel()) for each in device.sent]
    assert len(set(layouts)) == 2  # the policy's, and one that was arranged once
    assert layouts[0] == layouts[-1]


class SlowClock(SimulatedClock):
    def now(self) -> float:
        self.time += 0.001
        return self.time


def test_messages_take_a_share_of_a_period_and_the_rest_waits() -> None:
    device = made.ScriptedDevice(SlowClock())
    device.script = [(0.0, entered()), *((0.1, made.frame(0.02 + 1e-4 * k)) for k in range(40))]
    loop = run(device, 0.4)
    assert loop.counts.kept == loop.counts.periods == 10
    assert loop.counts.frames == 40
    assert max(loop.latencies.work) < 0.04
    device.script = [(0.0, AxesAcknowledgement(1, 0.0))] * (runtime.MAX_MESSAGES + 1)
    faults = run(device, 0.1).counts.faults
    assert [name.split(" a period")[0] for name in faults] == [
        f"device must give at most {runtime.MAX_MESSAGES} messages"
    ]


def test_no_parcel_no_commands(device) -> None:
    device.script = [(taken, made.frame(taken, number=None)) for taken in np.arange(0.0, 0.4, 0.02)]
    loop = run(device, 0.4)
    assert loop.counts.sent == loop.counts.watchdog == 0
    assert loop.counts.frames == 20
    assert not loop.has_parcel


def test_a_listener_hears_all_and_its_error_is_the_loss_of_the_device(device) -> None:
    script = [(0.0, entered()), (0.1, made.frame(0.08))]
    device.script, device.away = list(script), [(0.3, 0.4)]
    listener, heard = Mock(), []
    listener.hear.side_effect = lambda messages, *_: heard.append([*messages])
    loop = made.loop_of(device, Always(made.BRAKE, device.clock), listeners=[listener])
    loop.run(0.4, made.nothing)
    assert [message for each in heard for message in each] == [message for _, message in script]
    assert len(heard) == loop.counts.periods - loop.counts.lost
    commands = [call.args for call in listener.hear_command.call_args_list]
    assert [number for number, _ in commands] == list(range(1, len(device.sent) + 1))
    assert all(angles is sent for (_, angles), sent in zip(commands, device.sent, strict=True))
    listener.hear.side_effect = OSError("no space is left")
    device.away = []
    loop.run(0.6, made.nothing)
    assert loop.counts.faults["no space is left"] >= 1


def test_parcels_are_counted_by_how_they_left(device) -> None:
    device.script = [
        (0.0, entered(0)), (0.2, ParcelDeparture(0, "success")), (0.24, entered(1, at=0.24)),
        (0.4, ParcelDeparture(1, "missed")),
    ]  # fmt: skip
    controller = Always(made.ROLL, device.clock)
    loop = made.loop_of(device, controller)
    loop.run(0.48, made.nothing)
    assert dict(loop.counts.parcels) == {"success": 1, "missed": 1}
    assert controller.begins.count(True) == 2


def test_a_device_that_is_lost_is_found_again(device) -> None:
    device.script = [(0.0, entered()), (3.0, entered(1, at=3.0))]
    device.away = [(0.2, 2.5)]
    loop = run(device, 4.0, first_wait=0.1, longest_wait=0.8)
    counts = loop.counts
    assert (counts.lost, counts.connected) == (1, 2)
    apart = np.diff(device.connects[1:])
    assert apart.max() <= 0.8 + 0.04 + 1e-9
    assert (np.diff(apart[:3]) > 0.0).all()  # it waits longer and longer
    assert counts.unconnected > 50
    assert loop.has_parcel
    assert counts.sent == counts.decisions + counts.by_fixed_layout == 4 + 26


def test_a_device_that_is_lost_while_axes_are_sent(device) -> None:
    device.script = [(0.0, entered())]
    device.away = [(0.0805, 0.5)]  # after it was read from
    counts = run(device, 0.4, takes=0.01).counts
    assert (counts.lost, counts.sent) == (1, 1)


def test_what_the_device_refuses_is_counted_and_forgotten(device) -> None:
    refused, taken = AxesAcknowledgement(1, 0.05, "no"), AxesAcknowledgement(2, 0.09)
    early = AxesAcknowledgement(3, 0.11)  # by a clock that is late: before it was sent
    device.script = [(0.0, entered()), (0.06, refused), (0.1, taken), (0.14, early)]
    loop = run(device, 0.2)
    assert (loop.counts.refused, loop.latencies.send) == (1, pytest.approx([0.01, 0.0]))
    # It has seen nothing since the entry: the whole way is that time and what the axes take.
    assert loop.latencies.whole[0] == pytest.approx(0.08 + 0.01 + 0.05)


@pytest.mark.parametrize("action", [16, -1, 0.5, None])
def test_an_action_or_an_axis_that_is_not_on_offer_is_not_sent(device, action) -> None:
    device.script = [(0.0, entered())]
    others = replace(made.CONFIG, orientations=(0.1, 0.2, 0.3, 0.4))
    loop = made.loop_of(device, Always(made.BRAKE if action is None else action, device.clock))
    if action is None:
        loop._limits = protocol.AxisLimits(made.estimator().shape, deciders.allowed_angles(others))
    loop.run(0.2, made.nothing)
    assert device.sent == []
    assert loop.counts.out_of_range == loop.counts.held == 5


def test_a_parcel_with_no_place_here_is_left_alone(device) -> None:
    device.script = [(0.0, entered(goal=())), (0.2, entered(1, at=0.2))]
    counts = run(device, 0.4).counts
    assert (counts.unfit, counts.decisions) == (1, 6)


def test_an_observation_out_of_bounds_is_not_for_the_policy(device) -> None:
    device.script = [
        (0.0, entered(velocity=(19.0, 0.0, 0.0))),
        (0.06, made.frame(0.02, x=math.nan)),
    ]
    counts = run(device, 0.2).counts
    assert counts.strayed == counts.by_fixed_layout >= 1
    assert counts.lost == 1


@pytest.mark.parametrize("name", ["period", "watchdog", "first_wait", "longest_wait"])
def test_times_are_positive(name) -> None:
    with pytest.raises(ValueError, match=name):
        runtime.LoopConfig(**{name: 0.0})


@pytest.mark.parametrize(
    ("angles", "message"),
    [
        ([[0.0, math.pi / 2.0]], ""), ([[0.0]], "shape"), ([[0.0, math.nan]], "finite"),
        ([[0.0, 1.6]], "between"), ([[0.0, 0.1]], "on offer"),
    ],
)  # fmt: skip
def test_what_may_be_sent(angles, message) -> None:
    fault = protocol.AxisLimits((1, 2), (0.0, math.pi / 2.0)).fault(np.array(angles))
    assert message in fault
    assert bool(message) == bool(fault)
    assert protocol.AxisLimits((1, 2), None).fault(np.array([[0.3, -1.5]])) == ""
