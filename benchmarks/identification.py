"""`python -m benchmarks.identification`: errors of surfaces that are identified from logs.

A hidden surface is an environment in steps of 0.1 ms, with random friction, tilt, axes, camera and
load. `identify` sees only the pictures and the commands in its log.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import process_time

import numpy as np
import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import track
from rich.table import Table

import surface_gym as sg
from surface_gym.actions import ANY
from surface_gym.config import EnvConfig
from surface_gym.core.batch import Batch
from surface_gym.layouts import ROLLING
from surface_gym.lines import Line
from surface_gym.machine.log import LoggedRun, LoggedSurface, MachineLog
from surface_gym.physics.types import Array
from surface_gym.state import RUNNING
from surface_gym.tasks.start import Parcels, Start

DT = 1e-4  # [s] of the hidden surface
FRAME = 0.02  # [s] between pictures
PERIOD = 0.04  # [s] between commands
NOISE = (0.002, math.radians(0.5))  # [m, rad]
LOST = 0.02  # [-] share of missing pictures
ONLY = np.zeros(1, dtype=np.int64)
ASSUMED_TURN = 0.05  # [s]
FREE = ("mu_max", "mu_min", "mu_support", "tilt", "quarter_turn", "latency", "com_x", "com_y")
# Required limits of the root-mean-square errors, in the units of the parameters.
ASKED = (0.002, 0.001, 0.0015, 0.001, 0.001, 0.001, 0.002, 0.002)


@dataclass(frozen=True)
class HiddenSurface:
    """True parameters of a surface, camera and load, which a log should reveal."""

    mu_max: float  # [-]
    mu_min: float  # [-]
    mu_support: float  # [-]
    tilt: float  # [rad]
    quarter_turn: float  # [s]
    latency: float  # [s] delay of the logged times of pictures
    com_x: float  # [m]
    com_y: float  # [m]
    stiffness: float = 0.0  # [-] log-normal spread of the elements' stiffness

    @staticmethod
    def draw(rng: np.random.Generator, stiffness: float = 0.0) -> "HiddenSurface":
        return HiddenSurface(
            rng.uniform(0.35, 0.65), rng.uniform(0.006, 0.02), rng.uniform(0.003, 0.01),
            rng.uniform(0.0, 0.1), rng.uniform(0.03, 0.1), rng.uniform(0.0, 0.03),
            rng.uniform(-0.02, 0.02), rng.uniform(-0.02, 0.02), stiffness,
        )  # fmt: skip


@dataclass(frozen=True)
class Recording:
    """How a log is recorded."""

    runs: int = 40
    seconds: float = 1.5  # [s] maximum duration of a run, in which the parcel may leave
    is_excited: bool = True  # whether axes turn by `excitation`; otherwise parcels coast
    acknowledged: bool = True  # whether the log states when axes began to turn
    dead_time: float = 0.0  # [s] from a command to the start of the turn


def record(hidden: HiddenSurface, recording: Recording, rng: np.random.Generator) -> MachineLog:
    """Run parcels over a hidden surface, and return the log."""
    line = Line(mu_max=hidden.mu_max, mu_min=hidden.mu_min, mu_support=hidden.mu_support)
    com = (hidden.com_x, hidden.com_y)
    parcel = sg.Parcel(sg.Rectangle(0.32, 0.38), com_offset=com)
    batch = Batch(
        EnvConfig(
            sg.tasks.Slow(parcels=(parcel,)), line=line, actions="modules", orientations=ANY,
            zone=(4, 26), control_period=DT,
            actuators=sg.Actuators(axis_speed=0.5 * math.pi / hidden.quarter_turn),
            randomisation=sg.Randomisation(stiffness=hidden.stiffness),
        ),
        1,
    )  # fmt: skip
    batch.seed(0, rng)
    kind = batch.config.action_kind
    surface = LoggedSurface.of_line(Line(), ASSUMED_TURN, (kind.rows, kind.columns))
    uneven = np.exp(hidden.stiffness * rng.standard_normal(batch.surfaces.stiffness.shape[1:]))
    runs = []
    for number in range(recording.runs):
        start = _draw_start(parcel, hidden, rng)
        batch.place(ONLY, start)
        if hidden.stiffness:
            batch.surfaces.stiffness[0] = uneven
        batch.begin(ONLY)
        runs.append(_record_run(batch, hidden, recording, number, rng))
    return MachineLog(surface, tuple(runs), {}, FRAME)


def _draw_start(parcel: sg.Parcel, hidden: HiddenSurface, rng: np.random.Generator) -> Start:
    x, y, theta = 0.3 + 0.02 * rng.random(), 1.0 + rng.normal(0.0, 0.01), rng.normal(0.0, 0.05)
    speed = rng.uniform(1.0, 1.8)
    velocity = (speed, rng.normal(0.0, 0.02), rng.normal(0.0, 0.1))
    parcels = Parcels((parcel,), ONLY)
    return Start(parcels, ([x], [y], [theta]), velocity, (0.5, speed), hidden.tilt)


def _record_run(
    batch: Batch, hidden: HiddenSurface, recording: Recording, number: int, rng: np.random.Generator
) -> LoggedRun:
    """Run one parcel, which the batch has placed at its start; return its part of the log."""
    kind = batch.config.action_kind
    axes = sg.excitation((kind.rows, kind.columns), recording.seconds, run=number, period=PERIOD)
    if not recording.is_excited:
        axes[:] = ROLLING
    offset = 0.01 + DT * rng.integers(0, 100)  # [s] of the commands
    sent = offset + PERIOD * np.arange(len(axes))
    begins = np.round((sent + recording.dead_time) / DT).astype(int)
    command = np.full((1, kind.size), ROLLING)
    every, taken, poses = round(FRAME / DT), [], []
    for step in range(round(recording.seconds / DT)):
        if step % every == 0 and (step == 0 or rng.random() >= LOST):
            taken.append(step * DT)
            spread = np.array([NOISE[0], NOISE[0], NOISE[1]])
            poses.append(batch.parcels.truth[0, :3] + spread * rng.standard_normal(3))
        for k in np.nonzero(begins == step)[0]:
            command[0] = axes[k].ravel()
        batch.step(command)
        if batch.outcome[0] != RUNNING:
            break
    body = batch.bodies
    row = int(batch.parcels.body[0])
    zone = body.zone[row]
    whole = np.full((len(axes), *body.rotor[row].shape), ROLLING)
    margin = (kind.rows - int(zone[1])) // 2
    rows = slice(int(zone[0]), int(zone[0] + zone[1]))
    columns = slice(int(zone[2]), int(zone[2] + zone[3]))
    whole[:, rows, columns] = axes[:, margin : margin + int(zone[1])]
    known = replace(batch.parcel(0), com_offset=(0.0, 0.0))
    stated = np.array(taken) + hidden.latency
    return LoggedRun(
        known, 0.0, body.rotor[row].copy(), stated, np.array(poses), sent, whole,
        recording.acknowledged,
    )  # fmt: skip


@dataclass(frozen=True)
class StudyOptions:
    """Identify hidden surfaces; print the errors, and how often intervals contain the truth."""

    surfaces: int = 20
    """Number of surfaces."""
    stiffness: float = 0.0
    """Log-normal spread of the elements' stiffness, which `identify` does not model."""
    seed: int = 0
    """Seed of the first surface."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Identify all surfaces, and print a table."""
    options = tyro.cli(StudyOptions, prog="python -m benchmarks.identification", args=arguments)
    console = Console(stderr=True)
    numbers = range(options.seed, options.seed + options.surfaces)
    errors, halves, explained, seconds = [], [], [], []
    for number in track(numbers, "identifying", console=console):
        rng = np.random.default_rng(number)
        hidden = HiddenSurface.draw(rng, options.stiffness)
        log = record(hidden, Recording(), rng)
        begun = process_time()
        found = sg.identify([log], free=FREE)
        seconds.append(process_time() - begun)
        errors.append([found.values[name] - getattr(hidden, name) for name in FREE])
        halves.append(
            [0.5 * (found.intervals[name][1] - found.intervals[name][0]) for name in FREE]
        )
        explained.append(found.is_explained)
    _show(np.array(errors), np.array(halves), explained, seconds)


def _show(
    errors: Array, halves: Array, explained: Sequence[bool], seconds: Sequence[float]
) -> None:
    table = Table("parameter", "rms error", "asked", "half interval", "within", box=SIMPLE_HEAD)
    for k, name in enumerate(FREE):
        within = np.mean(np.abs(errors[:, k]) <= halves[:, k])
        rms, half = np.sqrt(np.mean(errors[:, k] ** 2)), np.median(halves[:, k])
        table.add_row(name, f"{rms:.5f}", f"{ASKED[k]:g}", f"{half:.5f}", f"{100 * within:.0f} %")
    console = Console()
    console.print(table)
    console.print(
        f"{len(errors)} surfaces, all intervals {100 * np.mean(np.abs(errors) <= halves):.1f} %; "
        f"explained {sum(explained)}; {np.median(seconds):.0f} s each, at most {max(seconds):.0f} s"
    )


if __name__ == "__main__":
    main()
