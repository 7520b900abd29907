"""The simulated machine, whole runs over a socket, and the command that starts both."""

import json
import math
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest
import tyro
from rich.console import Console

import surface_gym as sg
from benchmarks.tracking import SimulatedClock
from surface_gym import agents
from surface_gym.agents.runtime import cli, config, deciders, protocol, report, simulator
from surface_gym.agents.runtime.cli import load_controller, load_policy, main, simulator_arguments
from surface_gym.agents.runtime.config import RuntimeConfig, SimulatorConfig, WorldOptions
from surface_gym.agents.runtime.controller import ControlLoop, LoopConfig
from surface_gym.agents.runtime.protocol import DeviceLost, SocketDevice
from surface_gym.agents.runtime.simulator import MAX_BEHIND, MachineServer, SimulatorProcess, serve
from surface_gym.agents.runtime.worlds import SimulatedMachine
from surface_gym.config import EnvConfig
from surface_gym.machine import messages as ms
from surface_gym.machine.messages import Frame
from surface_gym.tasks.start import Draw, Start
from tests.agents.runtime import made
from tests.agents.runtime.made import CONFIG, PATIENCE, TOKEN, entered, estimator, of_kind, until
from tests.machine.recorded import ESTIMATE

PAUSE = 0.1
BRAKE = 0


def world(seed: int = 0, **options: float) -> SimulatedMachine:
    return SimulatedMachine(made.CONFIG, seed, 0.0, WorldOptions(**{"pause": PAUSE, **options}))


def test_parcel_after_parcel_enters_and_leaves() -> None:
    said = world().advance(12.0)
    entered, left = of_kind(ms.ParcelEntry, said), of_kind(ms.ParcelDeparture, said)
    assert len(left) >= 2
    assert [message.number for _, message in entered] == list(range(len(entered)))
    for (gone, _), (due, message) in zip(left, entered[1:], strict=False):
        assert due == message.at == pytest.approx(gone + PAUSE, abs=0.006)
    assert all("stop_error" in message.metrics for _, message in left)


def test_an_entry_states_the_tilt_of_the_surface() -> None:
    class Tilted(sg.tasks.Stop):
        def start(self, draw: Draw) -> Start:
            return super().start(draw)._replace(tilt=0.05, tilt_direction=-2.0)

    machine = SimulatedMachine(replace(CONFIG, task=Tilted()), 0, 0.0, WorldOptions(pause=PAUSE))
    (_, entry), *_ = of_kind(ms.ParcelEntry, machine.advance(0.2))
    assert (entry.tilt, entry.tilt_direction) == pytest.approx((0.05, -2.0))


def test_the_same_seed_gives_the_same_messages() -> None:
    one, same, other = (world(seed).advance(0.5) for seed in (0, 0, 1))
    poses = [[m.pose for _, m in of_kind(ms.Frame, said)] for said in (one, same, other)]
    assert poses[0] == poses[1] != poses[2]


def test_frames_come_at_the_cameras_rate_and_late() -> None:
    frames = of_kind(ms.Frame, world().advance(1.0))
    taken = np.array([message.taken_at for _, message in frames])
    np.testing.assert_allclose(np.diff(taken), 0.02)
    np.testing.assert_allclose([due for due, _ in frames] - taken, 0.04)
    before = [message.number for _, message in frames if message.taken_at < PAUSE - 0.01]
    assert before == [None] * 4
    x = np.array([message.pose[0] for _, message in frames if message.number == 0])
    noise = np.diff(x, n=3) / math.sqrt(20.0)  # of what is smooth
    assert 0.0003 < noise.std() < 0.003
    camera = replace(made.CONFIG.sensors, drop=0.5)
    dropping = SimulatedMachine(replace(made.CONFIG, sensors=camera), 0, 0.0, WorldOptions())
    assert 15 < len(dropping.advance(1.0)) < 35


def test_axes_that_are_set_turn_and_others_are_refused() -> None:
    machine = world(encoders=True)
    machine.advance(PAUSE + 0.02)
    for wrong in (np.zeros((1, 1)), np.full((4, 16), 1.6), np.full((4, 16), np.nan)):
        assert machine.set_axes(0, wrong).refused
    frames = of_kind(ms.Frame, machine.advance(PAUSE + 0.1))
    assert (np.abs(frames[-1][1].axes - math.pi / 2.0) < 1e-9).all()
    answer = machine.set_axes(5, np.zeros(machine.shape))
    assert answer == ms.AxesAcknowledgement(5, machine.now)
    frames = of_kind(ms.Frame, machine.advance(machine.now + PAUSE + 0.4))
    first, last = (frames[k][1].axes for k in (0, -1))
    assert set(np.sign(first[last == 0.0])) == {1.0}  # they are on their way
    assert first[last == 0.0].max() < math.pi / 2.0
    assert (last == 0.0).sum() in (2 * 16, 4 * 16)  # by the line's width
    with pytest.raises(ValueError, match="pause"):
        WorldOptions(pause=-1.0)


class TestOverASocket:
    @pytest.fixture
    def server(self) -> Iterator[MachineServer]:
        listener = socket.create_server(("127.0.0.1", 0))
        server = MachineServer(world(), "stop", listener)
        yield server
        server.close()

    def address(self, server: MachineServer) -> tuple[str, int]:
        return server._listener.getsockname()

    def run(self, server: MachineServer, steps: int) -> ControlLoop:
        """A loop in step with the server: all arrives within a period, whatever the load."""
        clock = SimulatedClock()
        device = protocol.SocketDevice(self.address(server), "stop", made.estimator().shape)
        loop = made.loop_of(device, made.Always(BRAKE, clock))
        for k in range(1, steps):
            clock.time = 0.005 * k
            if k % 8 == 0:
                loop.step(clock.time)
            server.step(clock.time)
        loop._device.close()
        return loop

    def test_a_policy_controls_parcel_after_parcel(self, server) -> None:
        loop = self.run(server, 1500)
        counts = loop.counts
        assert sum(counts.parcels.values()) >= 2
        assert counts.decisions > 40
        assert counts.refused == counts.out_of_range == counts.lost == server.refused == 0
        assert counts.connected == 1
        assert counts.frames > 300
        assert counts.watchdog == counts.by_fixed_layout == 0
        # Axes begin to turn at once, by the next physics step.
        assert max(loop.latencies.send) < 0.04 + 0.006
        assert LoopConfig().period == pytest.approx(0.04)

    def test_it_serves_as_long_as_asked_and_stands_still_where_the_clock_ran_away(
        self, server
    ) -> None:
        clock, turns = SimulatedClock(), iter([True, True, False])

        def goes_on() -> bool:
            clock.time += 0.02
            return next(turns)

        serve(server, clock, goes_on)
        assert server._world.now > 0.03
        server.step(0.2)
        later = server._world.now + MAX_BEHIND + 100.0
        server.step(later)
        assert server._world.now == pytest.approx(later, abs=0.006)
        assert server._world._number == 0

    def test_only_who_proves_to_have_the_token_is_connected(self) -> None:
        listener = socket.create_server(("127.0.0.1", 0))
        server = MachineServer(world(), "stop", listener, TOKEN)
        devices = [
            SocketDevice(listener.getsockname(), "stop", (4, 16), token)
            for token in (TOKEN, TOKEN.upper(), None)
        ]
        owner, *strangers = devices
        strangers.append(SocketDevice(listener.getsockname(), "stop", (4, 16)))
        clock = SimulatedClock()

        def serve_and_read(device: SocketDevice) -> None:
            for _ in range(20):
                clock.time += 0.005
                server.step(clock.time)
                device.read()

        owner.connect()
        serve_and_read(owner)
        assert owner._greeted
        for stranger in strangers:
            stranger.connect()
            if stranger is strangers[-1]:  # one that does not even listen
                stranger.set_axes(np.zeros((4, 16)))
            with pytest.raises(DeviceLost, match=r"token must be given|gone"):
                serve_and_read(stranger)
        with ExitStack() as stack:
            for _ in range(2 * simulator.MAX_NEWCOMERS):  # and many that say nothing
                stack.enter_context(socket.create_connection(listener.getsockname()))
                serve_and_read(owner)
            assert len(server._newcomers) == simulator.MAX_NEWCOMERS
            server.step(clock.time + protocol.GREETING_TIMEOUT + 0.1)
            assert server._newcomers == []
        owner.set_axes(np.zeros((4, 16)))
        serve_and_read(owner)
        assert (server._world._command == 0.0).all()
        for device in (*devices, *strangers):
            device.close()
        server.close()

    @pytest.mark.parametrize("line", [b"stop!\n", ms.to_line({"kind": "axes", "command": 1})])
    def test_a_loop_that_sends_another_line_is_cut_off(self, server, line) -> None:
        with socket.create_connection(self.address(server)) as connected:
            server.step(0.0)
            assert ms.from_line(connected.recv(4096).splitlines()[0])["task"] == "stop"
            connected.sendall(line)
            connected.settimeout(5.0)
            for k in range(1, 4):
                server.step(0.01 * k)
            while connected.recv(4096):
                pass


RUN = {"agent": "stop-ppo", "period": 0.04, "seconds": 600.0, "load": (1.0, 2.0, 3.0), "cores": 2}


def test_a_report_is_written_whole_and_shown(tmp_path, capsys) -> None:
    counts = report.Counts(periods=15_000, kept=14_990, missed=10, lost=5)
    counts.parcels.update(["success", "success", "missed"])
    latencies = report.Latencies(policy=[0.001 * k for k in range(101)])
    whole = cli.make_report(RUN, counts, latencies)
    read = json.loads(cli.write_report(whole, tmp_path / "out").read_text())
    assert read["counts"]["missed"] == 10
    assert read["counts"]["parcels"] == {"success": 2, "missed": 1}
    assert read["success"] == pytest.approx(2.0 / 3.0)
    assert read["budget"]["policy"] == pytest.approx([0.05, 0.09, 0.099, 0.1])
    assert read["budget"]["sensor"] is None
    cli.show_report(whole, Console(width=200))
    printed = capsys.readouterr().out
    for part in ("period of 40 ms", "50.00", "missed 10", "lost 5", "success 0.667: 2 success"):
        assert part in printed
    nothing = cli.make_report(RUN, report.Counts(unfit=1), report.Latencies())
    cli.show_report(nothing, Console(width=200))
    assert "unfit 1" in capsys.readouterr().out
    assert report.percentiles([]) is None


def test_a_report_is_written_whatever_ends_the_run(tmp_path, monkeypatch) -> None:
    device = made.ScriptedDevice(SimulatedClock(), [(0.0, entered())])
    loop = made.loop_of(device, made.Always(BRAKE, device.clock))
    monkeypatch.setattr(cli, "show_report", None)
    for error in (RuntimeError, KeyboardInterrupt):
        monkeypatch.setattr(device, "set_axes", Mock(side_effect=error))
        with pytest.raises((RuntimeError, TypeError)):  # of the device, or of what prints
            cli.run_and_report(loop, RuntimeConfig("stop-ppo", out=tmp_path), CONFIG, Console())
        assert json.loads((tmp_path / "report.json").read_text())["counts"]["periods"] >= 1
        (tmp_path / "report.json").unlink()


@pytest.mark.parametrize(
    ("name", "given", "message"),
    [
        ("stop-ppo", {"minutes": 0.0}, "minutes"),
        ("stop-ppo", {"watchdog": -1.0}, "watchdog"),
        ("stop-ppo", {"address": "nowhere"}, "address"),
        ("nobody", {}, "name must be a folder, a rule of a stream"),
    ],
)
def test_what_is_not_allowed_is_refused(name, given, message) -> None:
    with pytest.raises(ValueError, match=message):
        load_policy(RuntimeConfig(name, **given))


def test_an_error_ends_the_command_with_one_line() -> None:
    with pytest.raises(SystemExit, match="error: name must be"):
        main(["nobody"])
    with pytest.raises(SystemExit, match="error: task must be"):
        simulator.main(["--task", "nobody"])


def test_the_environment_is_the_policys_and_the_simulators() -> None:
    """A run's folder holds a policy, too."""
    folder = Path(agents.__file__).parent / "shipped/stop-ppo/seed-0"
    assert load_policy(RuntimeConfig(str(folder))).card.task == "stop"
    policy, lab = load_controller(RuntimeConfig("slow-dqn", seed=1))
    assert lab == EnvConfig(task="slow", preset="lab", **policy.env_kwargs)
    options = RuntimeConfig("stop-ppo", preset="camera", start=3)
    _, env_config = load_controller(options)
    given = tyro.cli(SimulatorConfig, args=simulator_arguments(options, env_config))
    assert given == SimulatorConfig(task="stop", preset="camera", control_period=0.04, seed=3)
    assert simulator.find_env_config(given).actuators == env_config.actuators


def test_both_are_on_the_identified_surface(tmp_path) -> None:
    file = tmp_path / "estimate.json"
    ESTIMATE.save(file)
    options = RuntimeConfig("stop-ppo", estimate=file)
    _, env_config = load_controller(options)
    assert env_config.chosen_line.mu_max == ESTIMATE.values["mu_max"]
    assert env_config.sensors.latency == pytest.approx(0.04)
    given = tyro.cli(SimulatorConfig, args=simulator_arguments(options, env_config))
    simulated = simulator.find_env_config(given)
    assert simulated.chosen_line == env_config.chosen_line
    assert simulated.actuators == env_config.actuators


def test_a_token_is_of_a_file_that_nobody_else_reads_or_of_the_environment(
    tmp_path, monkeypatch
) -> None:
    monkeypatch.delenv(config.TOKEN, raising=False)
    monkeypatch.chdir(tmp_path)
    assert config.find_token(None) is None
    made_up = config.find_token(None, make=True)
    assert made_up == config.find_token(config.TOKEN_FILE)
    assert made_up is not None
    assert len(made_up) == 64
    assert config.TOKEN_FILE.stat().st_mode & 0o777 == 0o600
    assert config.find_token(None, make=True) == made_up  # a simulator that is started again
    config.TOKEN_FILE.chmod(0o640)
    with pytest.raises(ValueError, match="mode 600"):
        config.find_token(config.TOKEN_FILE)
    with pytest.raises(FileNotFoundError):
        config.find_token(Path("none"))
    monkeypatch.setenv(config.TOKEN, TOKEN)
    assert config.find_token(None) == config.find_token(None, make=True) == TOKEN
    monkeypatch.setenv(config.TOKEN, "short")
    with pytest.raises(ValueError, match="at least 16 characters"):
        config.find_token(None)


@pytest.mark.parametrize("task", ["sort", "track"])
def test_the_fixed_layout_of_a_task(task) -> None:
    env_config = EnvConfig(task=task, actions="halves", observe=("parcel",))
    layouts = deciders.FixedLayouts(env_config)
    bounds = env_config.observation_space()
    command = layouts.arrange(np.clip(0.0, bounds.low, bounds.high))
    assert command.shape == (layouts.kind.size,)
    assert len(np.unique(command)) == 1


def test_a_layout_of_another_process_is_the_same() -> None:
    held = estimator()
    held.reset(entered())
    observation = held.observe(0.0)
    with deciders.ProcessArranger(held.config) as arranger:
        assert arranger.wait_until_ready(PATIENCE)
        for _ in range(3000):  # more than a pipe holds; the latest counts
            arranger.ask(np.zeros_like(observation))
        arranger.ask(observation)
        until(lambda: arranger.layout() is not None)
        layout = arranger.layout()
        arranger._process.kill()
        arranger._process.join()
        arranger.ask(observation)
        assert arranger.layout() is None
    layouts = deciders.FixedLayouts(held.config)
    np.testing.assert_array_equal(layout, layouts.arrange(observation))
    assert layouts.arrange(np.full_like(observation, np.nan)) is None
    # Axes on offer are the task's and the conveyors'.
    assert deciders.allowed_angles(CONFIG) == (*CONFIG.chosen_orientations, np.pi / 2.0)
    assert deciders.allowed_angles(replace(CONFIG, orientations="any")) is None


def first_frame(device: SocketDevice) -> Frame:
    """The first frame of a simulator that may have yet to start."""

    def find() -> Frame | None:
        try:
            messages = device.read()
        except DeviceLost:
            with suppress(DeviceLost):
                device.connect()
            return None
        return next((each for each in messages if isinstance(each, Frame)), None)

    return until(find)


def test_a_simulator_that_was_killed_is_there_again_at_the_same_address(tmp_path) -> None:
    arguments = ["--task", "stop", "--preset", "camera"]
    with SimulatorProcess(arguments, tmp_path / "log") as process:
        device = SocketDevice(process.address, "stop", (4, 16), process.token)
        first = first_frame(device)
        assert first.taken_at <= time.monotonic()
        process._process.kill()
        process._process.wait()
        with pytest.raises(DeviceLost):
            until(lambda: device.read() and None)
        arguments += ["--port", str(process.address[1])]
        with SimulatorProcess(arguments, tmp_path / "log", process.token) as again:
            assert again.address == process.address
            assert first_frame(device).taken_at > first.taken_at
        device.close()
    log = (tmp_path / "log").read_text().splitlines()
    assert [line for line in log if not line.startswith("surface_gym: compiling ")] == []
    # One that does not start says why.
    with pytest.raises(ValueError, match="task must be one of"):
        SimulatorProcess(["--task", "nobody"], tmp_path / "log")


def test_ctrl_c_ends_a_run_with_its_report(tmp_path) -> None:
    # Started in the background, as some shells start the tests, a process would not listen to it.
    listen = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
    program = listen + "from surface_gym.cli import main; main()"
    with subprocess.Popen(
        [sys.executable, "-c", program, "runtime", "stop-ppo", "--preset", "camera",
         "--out", str(tmp_path)],
        cwd=Path(__file__).parents[3], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        env={**os.environ, "PYTHONUNBUFFERED": "1", "TERM": "dumb"}, text=True,
    ) as process:  # fmt: skip
        for line in process.stdout:
            if line.startswith("ready"):
                break
        time.sleep(1.0)
        process.send_signal(signal.SIGINT)
        try:
            printed, _ = process.communicate(timeout=PATIENCE)
        finally:
            process.kill()
    assert process.returncode == 0, printed
    assert "stopped" in printed
    counts = json.loads((tmp_path / "report.json").read_text())["counts"]
    assert counts["missed"] <= counts["periods"]
    assert counts["out_of_range"] == counts["refused"] == 0
