"""Streams are led on a simulated machine, in simulated time and over a socket."""

import json
import socket
from dataclasses import replace

import numpy as np
import pytest
import tyro

from benchmarks.tracking import SimulatedClock
from surface_gym.agents.runtime import cli, protocol, simulator
from surface_gym.agents.runtime.config import RuntimeConfig, SimulatorConfig, WorldOptions
from surface_gym.agents.runtime.simulator import MachineServer
from surface_gym.agents.runtime.worlds import SimulatedMachine, SimulatedStream
from surface_gym.flow.state import ENTERED
from surface_gym.layouts import ROLLING
from surface_gym.machine import messages as ms
from surface_gym.machine.log import read_log
from surface_gym.machine.messages import AxesAcknowledgement, Detections, ParcelEntry
from tests.agents.runtime import made, streams
from tests.agents.runtime.made import TOKEN, of_kind
from tests.agents.runtime.streams import CONFIG, entry, picture, world

LATE = streams.LATE


def test_the_machine_reports_what_enters_departs_and_is_seen() -> None:
    machine = world()
    said = machine.advance(6.0)
    entered = [message for _, message in of_kind(ParcelEntry, said)]
    departed = [message for _, message in of_kind(ms.ParcelDeparture, said)]
    pictures = of_kind(Detections, said)
    assert [each.number for each in entered] == list(range(len(entered)))
    assert len(entered) == machine.streams.tally[0, ENTERED] > len(departed) > 2
    assert {each.outcome for each in departed} <= {"success", "wrong"}
    np.testing.assert_allclose([due - each.taken_at for due, each in pictures], LATE)
    assert len(pictures) == pytest.approx(6.0 / 0.02, abs=1)
    numbers, poses = machine.poses
    seen = np.array(max((each for _, each in pictures), key=lambda each: each.taken_at).poses)
    away = np.linalg.norm(poses[:, np.newaxis, :2] - seen[:, :2], axis=2)
    assert len(seen) == len(numbers)
    assert away.min(axis=1).max() < 0.05


def test_the_same_seed_gives_the_same_pictures() -> None:
    one, same, other = (
        [each.poses for _, each in of_kind(Detections, world(seed, false=0.3).advance(2.0))]
        for seed in (0, 0, 1)
    )
    assert one == same != other


@pytest.mark.parametrize(
    ("options", "low", "high"),
    [({}, 1.0, 1.0), ({"lost": 0.3}, 0.6, 0.8), ({"false": 0.5}, 1.3, 1.7), ({"late": 0.1}, 1, 1)],
)
def test_shares_of_lost_and_false_poses(options, low, high) -> None:
    machine, shown, there = world(**options), 0, 0
    for k in range(1, 400):
        for due, each in of_kind(Detections, machine.advance(0.02 * k - 0.0025)):
            shown += len(each.poses)
            there += len(machine.poses[0])
            assert due - each.taken_at == pytest.approx(options.get("late", LATE))
    assert low <= shown / there <= high


def test_touching_parcels_are_seen_as_one() -> None:
    counts = []
    for merged in (0.0, 1.0):
        machine = world(merged=merged)
        machine.set_axes(1, np.zeros(machine.shape))  # all brake, so that parcels collide
        pictures = of_kind(Detections, machine.advance(12.0))
        counts.append(sum(len(each.poses) for _, each in pictures))
    assert machine.streams.tally[0, 3] > 0
    assert counts[1] < counts[0]


def test_a_jam_is_reported_and_the_surface_begins_anew() -> None:
    machine = world()
    machine.set_axes(1, np.zeros(machine.shape))
    said = machine.advance(30.0)
    departed = [message for _, message in of_kind(ms.ParcelDeparture, said)]
    numbers = [message.number for _, message in of_kind(ParcelEntry, said)]
    assert "jam" in {each.outcome for each in departed}
    assert len(numbers) == len(set(numbers))


def test_parcels_enter_only_by_the_gate() -> None:
    config = CONFIG.replace(gate=True, queue=2)
    machine = world(config=config)
    said = machine.advance(1.0)
    waiting = [message for _, message in of_kind(ParcelEntry, said)]
    assert waiting
    assert all(message.waits for message in waiting)
    machine.open_gate(1.1, 1.14)
    entered = of_kind(ParcelEntry, machine.advance(2.0))
    entered = [message for _, message in entered if not message.waits]
    assert [(each.number, round(each.at, 6)) for each in entered] == [(0, 1.1)]
    machine.open_gate(2.5, 2.54)
    machine.set_axes(1, np.full(machine.shape, ROLLING))
    assert machine.streams.tally[0, ENTERED] == 1


def test_pictures_that_stop_lead_to_safe_axes() -> None:
    machine, axes = world(), []
    rule = streams.Rolls()
    rule.predict = lambda *_, **__: (np.zeros((1, 16), dtype=int), None)  # all brake
    blind = (2.0, 3.0)

    def look(now: float) -> None:
        axes.append((now, machine._batch.surfaces.target[0].copy()))
        machine._every = 10**9 if blind[0] <= now < blind[1] else 4

    loop = streams.lead(machine, rule, look, 4.0)
    assert loop.counts.watchdog == 1
    assert 0.6 / 0.04 < loop.counts.by_fixed_layout < 1.1 / 0.04
    while_blind = [each for now, each in axes if 2.4 < now < 2.9]
    assert all((each == ROLLING).all() for each in while_blind)
    assert (axes[-1][1] == 0.0).any()


def test_a_message_of_the_other_kind_of_machine_is_of_no_use() -> None:
    device = made.ScriptedDevice(SimulatedClock(), [(0.0, picture(0.0, (0.3, 1.0)))])
    loop = made.loop_of(device, made.Always(made.BRAKE, device.clock))
    loop.run(0.2, made.nothing)
    assert loop.counts.frames == 0
    device = made.ScriptedDevice(SimulatedClock(), [(0.0, ms.Frame(0.0, 3)), (0.1, entry())])
    other = streams.loop_of(device, device.clock)
    other.run(0.3, made.nothing)
    assert other.counts.unused == 1
    assert other.counts.sent > 0


def test_entries_that_are_impossible_are_counted_and_the_loop_goes_on() -> None:
    device = made.ScriptedDevice(SimulatedClock(), [])
    wrong = [entry(1, goal=(7.0, 0.0, 0.0)), entry(2, at=-9.0), entry(0), entry(0)]
    device.script = [(0.1, each) for each in wrong] + [(0.2, AxesAcknowledgement(3, 0.2))]
    loop = streams.loop_of(device, device.clock)
    loop.run(0.15, made.nothing)
    assert loop.counts.unfit == 2
    assert len(loop.counts.faults) == 2


def test_a_machine_that_was_lost_is_led_on_over_the_socket() -> None:
    clock, machine = SimulatedClock(), world(2)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        server = MachineServer(machine, "flow", listener, TOKEN)
        held = streams.fresh()
        device = protocol.SocketDevice(
            listener.getsockname()[:2], "flow", held.shape, TOKEN, clock.now
        )
        loop = streams.loop_of(device, clock)
        tracked = []

        def between(now: float) -> None:
            server.step(now)
            numbers, _ = machine.poses
            known = set(held.numbers.tolist())
            tracked.append((now, len(numbers), len(known & set(numbers.tolist()))))
            if loop.counts.lost == 0 and now > 3.0:
                server._drop()

        loop.run(8.0, between)
        server.close()
    assert loop.counts.lost == 1
    assert loop.counts.connected == 2
    late = [(there, known) for now, there, known in tracked if now > 4.5]
    assert sum(known for _, known in late) > 0.9 * sum(there for there, _ in late) > 0
    assert server.refused == 0


def test_a_gate_of_one_parcel_at_a_time_is_refused() -> None:
    one = SimulatedMachine(made.CONFIG, 0, 0.0, WorldOptions())
    with pytest.raises(ValueError, match="gate must be of a stream"):
        one.open_gate(0.0, 1.0)


def test_the_simulators_stream_is_the_policys() -> None:
    options = RuntimeConfig("flow-schedule", preset="camera", start=3)
    options = replace(options, world=replace(options.world, rate=900.0, lost=0.1, late=0.02))
    policy, env_config = cli.load_controller(options)
    given = tyro.cli(SimulatorConfig, args=cli.simulator_arguments(options, env_config))
    made_config = simulator.find_env_config(given)
    assert made_config.stream_task.gate
    assert made_config.stream_task.stream.arrivals.rate == 900.0
    assert made_config.stream_task.max_parcels == env_config.stream_task.max_parcels
    assert (given.world.lost, given.world.late, given.seed) == (0.1, 0.02, 3)
    assert isinstance(
        simulator.make_world(replace(given, seed=0), made_config, 0.0), SimulatedStream
    )
    assert policy is not None


def test_rules_of_streams_are_led() -> None:
    rule, env_config = cli.load_controller(RuntimeConfig("singulate: time slots", preset="camera"))
    assert env_config.task.name == "singulate"
    assert rule.predict(np.zeros((1, *env_config.observation_space().shape), dtype=np.float32))


def test_the_command_leads_a_stream(tmp_path, capsys) -> None:
    cli.main(
        ["flow: event rule", "--preset", "camera", "--minutes", "0.05", "--out", str(tmp_path),
         "--log", str(tmp_path / "run.jsonl.gz"), "--world.rate", "3000", "--world.false", "0.05"]
    )  # fmt: skip
    counts = json.loads((tmp_path / "report.json").read_text())["counts"]
    assert counts["decisions"] > 0.5 * counts["periods"]
    assert counts["frames"] > 50
    assert not counts["faults"]
    assert f"decisions {counts['decisions']}" in capsys.readouterr().out
    log = read_log(tmp_path / "run.jsonl.gz")
    assert len(log.runs) + sum(log.unused.values()) >= 1
