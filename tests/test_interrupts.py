"""Ctrl-C ends every long run of compiled code, and the pieces it takes are one run to the bit."""

import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

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
import signal

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
signal.signal(signal.SIGINT, signal.default_int_handler)  # also in a shell's background


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


def test_ctrl_c_ends_a_long_run():
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


def simulated(*start: Any, **settings: Any) -> list[Any]:
    run = sg.simulate(sg.layouts.sorting(), BOX, *start, **settings)
    return [run.time, run.pose, run.velocity, run.tipping, run.end]


def simulated_together() -> list[Any]:
    poses, velocities = [REST, (0.9, 1.0, 0.0)], [(1.5, 0.0, 0.0), (0.2, 0.0, 0.0)]
    line = sg.layouts.line([[sg.layouts.ROLLING]])
    run = sg.simulate_together(line, [BOX, BOX], poses, velocities, duration=0.303)
    assert len(run.touches.time) > 0
    return [*(each.pose for each in run.trajectories), run.touches.time, run.touches.impulse]


def stepped(*task: Any, **settings: Any) -> list[Any]:
    envs = SmartSurfaceVectorEnv(9, *task, **settings)
    envs.action_space.seed(0)
    seen = [envs.reset(seed=3)[0]]
    for _ in range(5):
        seen += envs.step(envs.action_space.sample())[:2]
    return seen


def designed(workers: int) -> list[Any]:
    line = Case(BOX).line(4)
    axes = np.full((1, line.rows, line.columns), 0.25 * np.pi)
    given = runs.make_runs(np.linspace(0.5, 2.0, 40))
    ends = runs.run_all(line, axes, [BOX], given, workers=workers)
    return [ends.pose, ends.steps]


FLOW = {"stream": Stream(Steady(5000.0)), "actions": "parcels", "max_parcels": 4}
THREE_RUNS = 3 * int(runs.LONGEST / runs.STEP)
# Each with what says how long a piece is, and how long they are to be.
PIECES: dict[str, tuple[Callable[[], list[Any]], tuple[Any, str], tuple[int, ...]]] = {
    "simulate": (
        partial(simulated, REST, (1.5, 0.0, 0.3), duration=0.3012, dt=0.001),
        (simulation, "PIECE"), (1, 7, 100, 301),
    ),
    "a run that ends early": (  # after 20 steps
        partial(simulated, (3.8, 1.0, 0.0), (1.5, 0.0, 0.0), dt=0.01),
        (simulation, "PIECE"), (1, 12, 13, 14, 15),
    ),
    "simulate_together": (simulated_together, (simulation, "PIECE"), (1, 6, 50)),
    **{
        f"{name}, {threads} threads": (each, (module, attribute), (length,))
        for threads in (1, 2)
        for name, each, module, attribute, length in (
            ("parcels", partial(stepped, threads=threads), assembly, "LOOK", 1),
            ("streams", partial(stepped, "flow", threads=threads, **FLOW), assembly, "LOOK", 1),
            ("design", partial(designed, threads), runs, "MOST_STEPS", THREE_RUNS),
        )
    },
}  # fmt: skip


@pytest.mark.parametrize("name", PIECES)
def test_its_pieces_are_one_run_to_the_bit(name, monkeypatch):
    run, length, pieces = PIECES[name]
    whole = run()
    assert "early" not in name or whole[-1] == "left the surface"
    for piece in pieces:
        monkeypatch.setattr(*length, piece)
        for found, wanted in zip(run(), whole, strict=True):
            np.testing.assert_array_equal(found, wanted)
