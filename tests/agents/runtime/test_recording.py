"""A log of messages and commands tells the surface."""

import numpy as np
import pytest

import surface_gym as sg
from benchmarks.tracking import SimulatedClock, SimulatedDevice
from surface_gym.agents.rules.sorting import StreamEventRule
from surface_gym.agents.runtime.cli import load_controller, main
from surface_gym.agents.runtime.config import RuntimeConfig, WorldOptions
from surface_gym.agents.runtime.deciders import ExcitationController
from surface_gym.agents.runtime.protocol import MessageLog
from surface_gym.agents.runtime.worlds import SimulatedMachine
from surface_gym.config import EnvConfig
from surface_gym.machine.command import main as identify
from surface_gym.machine.log import LoggedSurface, LogWriter, read_log
from surface_gym.machine.messages import ParcelEntry
from tests.agents.runtime import streams
from tests.agents.runtime.made import QUARTER_TURN

CONFIG = EnvConfig(
    "stop", actions="modules", sensors=sg.sensors.Camera(latency=0.04),
    actuators=sg.Actuators(axis_speed=0.5 * np.pi / QUARTER_TURN),
)  # fmt: skip
LINE = CONFIG.chosen_line


def logged(tmp_path, seconds: float) -> int:
    """Log a simulated machine that is excited, and return the number of commands."""
    clock = SimulatedClock()
    world = SimulatedMachine(CONFIG, 0, 0.0, WorldOptions(pause=0.1))
    device, sent = SimulatedDevice(world, clock), 0
    log = LogWriter(
        tmp_path / "run.jsonl.gz", LoggedSurface.of_line(LINE, QUARTER_TURN, world.shape)
    )
    listener = MessageLog(log, lambda parcel: LINE.site(parcel.base), clock.now)
    controller, present, state = ExcitationController(CONFIG), False, None
    offered = np.array(CONFIG.chosen_orientations)
    for _ in range(round(seconds / 0.04)):
        clock.time += 0.04
        messages = device.read()
        listener.hear(messages)
        for message in messages:
            if isinstance(message, ParcelEntry):
                present, state = True, None
        if present:
            action, state = controller.predict(np.zeros((1, 1), dtype=np.float32), state)
            angles = offered[action[0]].reshape(world.shape)
            listener.hear_command(device.set_axes(angles), angles)
            sent += 1
    log.close()
    return sent


def test_a_log_tells_the_friction_of_the_machine(tmp_path, capsys, monkeypatch) -> None:
    sent = logged(tmp_path, 14.0)
    log = read_log(tmp_path / "run.jsonl.gz")
    assert len(log.runs) >= 6
    assert all(run.acknowledged for run in log.runs)
    assert sum(len(run.sent) for run in log.runs) <= sent
    assert log.delay == pytest.approx(0.06, abs=0.03)
    monkeypatch.chdir(tmp_path)
    identify(["run.jsonl.gz", "--free", "mu_max", "--dt", "0.002", "--out", "found"])
    found = sg.Estimate.load(tmp_path / "found/estimate.json")
    assert found.values["mu_max"] == pytest.approx(0.5, abs=0.02)
    assert "mu_max" in capsys.readouterr().out
    assert (tmp_path / "found/report.html").is_file()


def test_a_log_of_a_stream_tells_the_friction_from_parcels_that_are_alone(tmp_path) -> None:
    """Detections have no identity, so the log tells which parcels were seen in each picture."""
    clock, world = SimulatedClock(), streams.world(lost=0.05, false=0.05)
    surface = LoggedSurface.of_line(streams.CONFIG.chosen_line, QUARTER_TURN, world.shape)
    log = LogWriter(tmp_path / "run.jsonl.gz", surface)
    listener = MessageLog(log, lambda _: streams.CONFIG.site, clock.now, shared=True)
    rule = StreamEventRule(streams.CONFIG)
    loop = streams.loop_of(SimulatedDevice(world, clock), clock, rule, [listener])
    loop.run(15.0, lambda _: None)
    log.close()
    read = read_log(tmp_path / "run.jsonl.gz")
    assert len(read.runs) >= 8
    assert all(np.diff(run.taken).min() > 0.0 for run in read.runs)
    assert all(run.sent[0] < run.taken[0] for run in read.runs[1:])  # axes had turned before
    found = sg.identify([read], free=["mu_max"], dt=0.002)
    assert found.values["mu_max"] == pytest.approx(0.5, abs=0.02)


def test_identify_ends_with_one_line(tmp_path) -> None:
    with pytest.raises(SystemExit, match="error: "):
        identify([str(tmp_path / "none.jsonl.gz")])
    with pytest.raises(SystemExit, match="error: position_noise and angle_noise"):
        identify([str(tmp_path / "none.jsonl.gz"), "--position-noise", "0.001"])


def test_an_excitation_is_of_a_task_of_one_parcel() -> None:
    controller, config = load_controller(RuntimeConfig("excitation", task="slow"))
    assert isinstance(controller, ExcitationController)
    assert config.task.name == "slow"
    with pytest.raises(SystemExit, match="error: task must be given"):
        main(["excitation"])
    with pytest.raises(SystemExit, match="error: task must be of one parcel"):
        main(["excitation", "--task", "flow"])


def test_a_controller_of_excitations_repeats_them() -> None:
    controller, offered = ExcitationController(CONFIG), np.array(CONFIG.chosen_orientations)
    for run in range(3):
        state = None
        for k in range(40):
            action, state = controller.predict(np.zeros((1, 1), dtype=np.float32), state)
            shape = (CONFIG.action_kind.rows, CONFIG.action_kind.columns)
            expected = sg.excitation(shape, 10.0, run=run)[k]
            np.testing.assert_allclose(offered[action[0]].reshape(shape), expected)
