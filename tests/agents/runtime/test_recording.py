"""A logged device is the device, and its log tells the surface."""

from collections import deque

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.agents.runtime.cli import load_controller, main
from surface_gym.agents.runtime.config import RuntimeConfig, WorldOptions
from surface_gym.agents.runtime.protocol import Angles, Device, Message, ParcelEntry
from surface_gym.agents.runtime.recording import ExcitationController, LoggedDevice
from surface_gym.agents.runtime.simulator import SimulatedMachine
from surface_gym.config import EnvConfig
from surface_gym.machine.command import main as identify
from surface_gym.machine.log import LoggedSurface, LogWriter, read_log
from tests.agents.runtime.made import QUARTER_TURN, ManualClock

CONFIG = EnvConfig(
    "stop", actions="modules", sensors=sg.sensors.Camera(latency=0.04),
    actuators=sg.Actuators(axis_speed=0.5 * np.pi / QUARTER_TURN),
)  # fmt: skip
LINE = CONFIG.chosen_line


class LocalMachine:
    """A simulated machine without a socket."""

    def __init__(self, clock: ManualClock) -> None:
        self._machine = SimulatedMachine(CONFIG, 0, 0.0, WorldOptions(pause=0.1))
        self._clock = clock
        self._due: deque[tuple[float, Message]] = deque()
        self._command = 0
        self.connected = False
        self.shape = self._machine.shape

    def connect(self) -> None:
        self.connected = True

    def close(self) -> None:
        self.connected = False

    def read(self) -> list[Message]:
        self._due.extend(self._machine.advance(self._clock.now()))
        now = self._clock.now()
        messages = [message for due, message in self._due if due <= now]
        self._due = deque((due, message) for due, message in self._due if due > now)
        return messages

    def set_axes(self, angles: Angles) -> int:
        self._command += 1
        self._due.append((self._clock.now(), self._machine.set_axes(self._command, angles)))
        return self._command


def drive(device: Device, clock: ManualClock, shape: tuple[int, int], seconds: float) -> int:
    """Excite a device, and return the number of commands."""
    controller, present, state, sent = ExcitationController(CONFIG), False, None, 0
    offered = np.array(CONFIG.chosen_orientations)
    device.connect()
    for _ in range(round(seconds / 0.04)):
        clock.time += 0.04
        for message in device.read():
            if isinstance(message, ParcelEntry):
                present, state = True, None
        if present:
            action, state = controller.predict(np.zeros((1, 1), dtype=np.float32), state)
            device.set_axes(offered[action[0]].reshape(shape))
            sent += 1
    device.close()
    return sent


def logged(tmp_path, seconds: float) -> tuple[LocalMachine, int]:
    clock = ManualClock()
    machine = LocalMachine(clock)
    surface = LoggedSurface.of_line(LINE, QUARTER_TURN, machine.shape)
    log = LogWriter(tmp_path / "run.jsonl.gz", surface)
    device = LoggedDevice(machine, log, lambda parcel: LINE.site(parcel.base), clock.now)
    sent = drive(device, clock, machine.shape, seconds)
    log.close()
    return machine, sent


def test_a_log_tells_the_friction_of_the_machine(tmp_path, capsys, monkeypatch) -> None:
    machine, sent = logged(tmp_path, 14.0)
    assert not machine.connected
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
