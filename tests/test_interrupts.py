"""Ctrl-C ends every long run of compiled code, and the pieces it takes are one run to the bit."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import simulation
from surface_gym.core import assembly
from surface_gym.design import runs
from surface_gym.design.case import Case
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.stream import Stream
from surface_gym.vector_env import SmartSurfaceVectorEnv

ROOT = Path(__file__).parent.parent
PROMPT = 10.0  # [s] for Ctrl-C on a busy machine; on an idle one it takes some tenths
BOX = sg.layouts.box("S")
REST = (0.5, 1.0, 0.0)

# Each is warm before it says that it begins, and would take minutes.
LONG = """
import numpy as np
import surface_gym as sg
from surface_gym.design import runs
from surface_gym.design.case import Case

box, surface = sg.layouts.box("S"), sg.layouts.sorting()
case = Case(box)
line = case.line(4)
axes = np.zeros((1, line.rows, line.columns))
envs = sg.SmartSurfaceVectorEnv(10_000, control_period=10.0)
envs.reset(seed=0)
actions = np.zeros(envs.action_space.shape, dtype=np.int64)


def simulate(duration):
    sg.simulate(surface, box, (0.5, 1.0, 0.0), duration=duration, dt=0.001)


def simulate_together(duration):
    poses = [(0.5, 1.0, 0.0), (1.5, 1.0, 0.0)]
    sg.simulate_together(surface, [box, box], poses, duration=duration, dt=0.001)


def design(duration):
    count = max(1, int(duration))
    given = runs.make_runs(np.full(count, 2.0))
    runs.run_all(line, axes, [box], given, dt=1e-4)


def step(duration):
    for _ in range(int(duration)):
        envs.step(actions)


for run in (simulate, simulate_together, design, step):
    run(0.01)
    try:
        print(run.__name__, flush=True)
        run(5_000.0)
    except KeyboardInterrupt:
        print("interrupted", flush=True)
"""


def test_ctrl_c_ends_a_long_run() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", LONG], cwd=ROOT, stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        for name in ("simulate", "simulate_together", "design", "step"):
            assert child.stdout.readline().strip() == name
            time.sleep(0.3)
            assert child.poll() is None
            child.send_signal(signal.SIGINT)
            since = time.monotonic()
            assert child.stdout.readline().strip() == "interrupted"
            assert time.monotonic() - since < PROMPT, name
        assert child.wait(10.0) == 0


def test_the_pieces_of_a_simulation_are_one_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def run() -> sg.Trajectory:
        return sg.simulate(
            sg.layouts.sorting(), BOX, REST, (1.5, 0.0, 0.3), duration=0.3012, dt=0.001
        )

    whole = run()
    for piece in (1, 7, 100, 301):
        monkeypatch.setattr(simulation, "PIECE", piece)
        pieces = run()
        assert pieces.pose.tobytes() == whole.pose.tobytes()
        assert pieces.velocity.tobytes() == whole.velocity.tobytes()
        assert pieces.tipping.tobytes() == whole.tipping.tobytes()
        assert (pieces.end, len(pieces.time)) == (whole.end, len(whole.time))


def test_a_run_that_ends_early_ends_in_any_piece(monkeypatch: pytest.MonkeyPatch) -> None:
    def run() -> sg.Trajectory:
        return sg.simulate(sg.layouts.sorting(), BOX, (3.8, 1.0, 0.0), (1.5, 0.0, 0.0), dt=0.01)

    whole = run()
    assert whole.end == "left the surface"
    last = len(whole.time) - 1
    for piece in (1, last - 1, last, last + 1):
        monkeypatch.setattr(simulation, "PIECE", piece)
        pieces = run()
        assert pieces.end == whole.end
        assert pieces.pose.tobytes() == whole.pose.tobytes()


def test_the_pieces_of_a_run_together_are_one_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def run() -> simulation.Encounter:
        return sg.simulate_together(
            sg.layouts.line([[sg.layouts.ROLLING]]),
            [BOX, BOX],
            [REST, (0.9, 1.0, 0.0)],
            [(1.5, 0.0, 0.0), (0.2, 0.0, 0.0)],
            duration=0.303,
        )

    whole = run()
    assert len(whole.touches.time) > 0
    for piece in (1, 6, 50):
        monkeypatch.setattr(simulation, "PIECE", piece)
        pieces = run()
        for one, other in zip(whole.trajectories, pieces.trajectories, strict=True):
            assert one.pose.tobytes() == other.pose.tobytes()
        assert pieces.touches.time.tobytes() == whole.touches.time.tobytes()
        assert pieces.touches.impulse.tobytes() == whole.touches.impulse.tobytes()


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("flows", [False, True], ids=["parcels", "streams"])
def test_the_pieces_of_a_control_period_are_one(
    flows: bool, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run() -> bytes:
        if flows:
            stream = Stream(Steady(5000.0))
            envs = SmartSurfaceVectorEnv(
                9, "flow", stream=stream, actions="parcels", max_parcels=4, threads=threads
            )
        else:
            envs = sg.SmartSurfaceVectorEnv(9, threads=threads)
        envs.action_space.seed(0)
        seen = [envs.reset(seed=3)[0].tobytes()]
        for _ in range(5):
            observation, reward, *_ = envs.step(envs.action_space.sample())
            seen += [observation.tobytes(), reward.tobytes()]
        return b"".join(seen)

    whole = run()
    monkeypatch.setattr(assembly, "LOOK", 1)  # an environment at a time
    assert run() == whole


@pytest.mark.parametrize("threads", [1, 2])
def test_the_pieces_of_a_design_are_one(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    line = Case(BOX).line(4)
    axes = np.full((1, line.rows, line.columns), 0.25 * np.pi)
    speeds = np.linspace(0.5, 2.0, 40)

    def run() -> runs.Ends:
        return runs.run_all(line, axes, [BOX], runs.make_runs(speeds), workers=threads)

    whole = run()
    monkeypatch.setattr(runs, "MOST_STEPS", 3 * int(runs.LONGEST / runs.STEP))  # 3 runs
    pieces = run()
    assert pieces.pose.tobytes() == whole.pose.tobytes()
    assert pieces.steps.tolist() == whole.steps.tolist()
