"""The command: its options, the processes that it starts and the report that it leaves."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tyro
from rich.console import Console

from surface_gym.agents.runtime import cli as reports
from surface_gym.agents.runtime import controller, simulator
from surface_gym.agents.runtime.cli import load_policy, main, make_env_config, simulator_arguments
from surface_gym.agents.runtime.config import RuntimeConfig, SimulatorConfig
from surface_gym.agents.runtime.protocol import DeviceLost, Frame, Message, SocketDevice
from surface_gym.agents.runtime.simulator import SimulatorProcess
from surface_gym.config import EnvConfig
from tests.agents.runtime.made import CONFIG, entered, estimator

PATIENCE = 120.0  # [s] for another process, on a computer that does other work

RUN = reports.Run("stop-ppo", 0, "stop", "lab", "simulator", 0.04, 0.2, 600.0, (1.0, 2.0, 3.0), 2)


class TestReport:
    def counted(self) -> tuple[controller.Counts, controller.Latencies]:
        counts = controller.Counts(periods=15_000, kept=14_990, missed=10, lost=5)
        counts.parcels.update(["success", "success", "missed"])
        return counts, controller.Latencies(policy=[0.001 * k for k in range(101)])

    def test_it_is_written_whole(self, tmp_path) -> None:
        file = reports.write_report(reports.make_report(RUN, *self.counted()), tmp_path / "out")
        report = json.loads(file.read_text())
        assert report["counts"]["missed"] == 10
        assert report["counts"]["parcels"] == {"success": 2, "missed": 1}
        assert report["success"] == pytest.approx(2.0 / 3.0)
        assert report["budget"]["policy"] == pytest.approx([0.05, 0.09, 0.099, 0.1])
        assert report["budget"]["sensor"] is None

    def test_it_is_shown(self, capsys) -> None:
        reports.show_report(reports.make_report(RUN, *self.counted()), Console(width=200))
        printed = capsys.readouterr().out
        for part in ("period of 40 ms", "50.00", "10 missed", "lost 5 times", "success 0.667"):
            assert part in printed

    def test_nothing_happened(self, capsys) -> None:
        reports.show_report(
            reports.make_report(RUN, controller.Counts(unfit=1), controller.Latencies()),
            Console(width=200),
        )
        assert "0 parcels; 1 that do not fit" in capsys.readouterr().out
        assert reports.percentiles([]) is None


class TestConfig:
    @pytest.mark.parametrize(
        ("given", "message"),
        [
            ({"minutes": 0.0}, "minutes"),
            ({"watchdog": -1.0}, "watchdog"),
            ({"address": "nowhere"}, "address"),
        ],
    )
    def test_what_is_not_allowed_is_refused(self, given, message) -> None:
        with pytest.raises(ValueError, match=message):
            RuntimeConfig("stop-ppo", **given)

    @pytest.mark.parametrize(
        ("name", "message"), [("nobody", "name must be a folder or one of"), ("flow-ppo", "parcel")]
    )
    def test_a_policy_that_does_not_exist(self, name, message) -> None:
        with pytest.raises(ValueError, match=message):
            load_policy(RuntimeConfig(name))

    def test_the_environment_is_the_policy_s(self) -> None:
        policy = load_policy(RuntimeConfig("slow-dqn", seed=1))
        env_config = make_env_config(policy, "lab")
        assert env_config == EnvConfig(task="slow", preset="lab", **policy.env_kwargs)

    def test_a_run_s_folder_holds_a_policy(self) -> None:
        from surface_gym import agents

        folder = Path(agents.__file__).parent / "shipped/stop-ppo/seed-0"
        assert load_policy(RuntimeConfig(str(folder))).card.task == "stop"

    def test_the_simulator_is_of_the_same_environment(self) -> None:
        config = RuntimeConfig("stop-ppo", preset="camera", start=3)
        policy = load_policy(config)
        env_config = make_env_config(policy, config.preset)
        given = tyro.cli(SimulatorConfig, args=simulator_arguments(config, env_config))
        assert given == SimulatorConfig(task="stop", preset="camera", control_period=0.04, seed=3)
        assert simulator.make_env_config(given).actuators == env_config.actuators

    def test_an_error_ends_the_command_with_one_line(self) -> None:
        with pytest.raises(SystemExit, match="error: name must be"):
            main(["nobody"])
        with pytest.raises(SystemExit, match="error: task must be"):
            simulator.main(["--task", "nobody"])


class TestDecisions:
    def test_axes_on_offer_and_the_conveyors(self) -> None:
        assert controller.allowed_angles(CONFIG) == (*CONFIG.chosen_orientations, np.pi / 2.0)
        assert controller.allowed_angles(replace(CONFIG, orientations="any")) is None

    @pytest.mark.parametrize("task", ["sort", "track"])
    def test_the_fixed_layout_of_a_task(self, task) -> None:
        env_config = EnvConfig(task=task, actions="halves", observe=("parcel",))
        layouts = controller.FixedLayouts(env_config)
        bounds = env_config.observation_space()
        command = layouts.arrange(np.clip(0.0, bounds.low, bounds.high))
        assert command.shape == (layouts.kind.size,)
        assert len(np.unique(command)) == 1

    def test_a_layout_of_another_process_is_the_same(self) -> None:
        held = estimator()
        held.reset(entered())
        observation = held.observe(0.0)
        with controller.ProcessArranger(held.config) as arranger:
            assert arranger.wait_until_ready(PATIENCE)
            arranger.ask(np.zeros_like(observation))  # one that is asked for too late
            arranger.ask(observation)
            layout = until(arranger.layout)
        expected = controller.FixedLayouts(held.config).arrange(observation)
        np.testing.assert_array_equal(layout, expected)


def until(call: Callable[[], Message | None]) -> Message:
    """The first result of a call that is not None."""
    ends = time.monotonic() + PATIENCE
    while time.monotonic() < ends:
        found = call()
        if found is not None:
            return found
        time.sleep(0.01)
    raise TimeoutError


class TestProcess:
    """A simulator that is started, killed and started again."""

    def frame_of(self, device: SocketDevice) -> Frame:
        """The first frame of a simulator that may have yet to start."""

        def find() -> Frame | None:
            try:
                messages = device.read()
            except DeviceLost:
                reconnect(device)
                return None
            return next((each for each in messages if isinstance(each, Frame)), None)

        return until(find)

    def test_it_is_there_again_at_the_same_address(self, tmp_path) -> None:
        arguments = ["--task", "stop", "--preset", "camera"]
        with SimulatorProcess(arguments, tmp_path / "log") as process:
            device = SocketDevice(process.address, "stop", (4, 16))
            first = self.frame_of(device)
            assert first.taken_at <= time.monotonic()
            process._process.kill()
            process._process.wait()
            with pytest.raises(DeviceLost):
                until(lambda: device.read() and None)
            arguments += ["--port", str(process.address[1])]
            with SimulatorProcess(arguments, tmp_path / "log") as again:
                assert again.address == process.address
                assert self.frame_of(device).taken_at > first.taken_at
            device.close()
        assert (tmp_path / "log").read_text() == ""

    def test_one_that_does_not_start_says_why(self, tmp_path) -> None:
        with pytest.raises(ValueError, match="task must be one of"):
            SimulatorProcess(["--task", "nobody"], tmp_path / "log")


def reconnect(device: SocketDevice) -> None:
    """Connect, if it is there."""
    try:
        device.connect()
    except DeviceLost:
        time.sleep(0.05)


def test_ctrl_c_ends_a_run_with_its_report(tmp_path) -> None:
    program = [sys.executable, "-c", "from surface_gym.cli import main; main()"]
    with subprocess.Popen(
        [*program, "runtime", "stop-ppo", "--preset", "camera", "--out", str(tmp_path)],
        cwd=Path(__file__).parents[3],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ, "PYTHONUNBUFFERED": "1", "TERM": "dumb"},
        text=True,
    ) as process:
        for line in process.stdout:
            if line.startswith("ready"):
                break
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        printed = process.stdout.read()
        assert process.wait(PATIENCE) == 0, printed
    assert "stopped" in printed
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["counts"]["missed"] <= report["counts"]["periods"]
    assert report["counts"]["out_of_range"] == report["counts"]["refused"] == 0
