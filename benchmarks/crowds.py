"""Parcel steps per second of a crowd on one surface, compared with parcels that are stepped alone.

24 parcels are on a slope of 6 deg with 1.4 m x 5 m of rotors, in two scenes. In the stream, they
move down at about 0.5 m/s (8000 parcels per hour), since the axes brake as much as the slope pulls.
They touch in a few per cent of the steps. In the held crowd, they press against each other before
axes that brake. For comparison, each parcel is stepped alone on the same surface from the same
start. Both ways are timed in turn, as in `environments.py`.
"""

import math
import time
from collections.abc import Callable

import numpy as np

import surface_gym as sg
from benchmarks.figure import Figure
from surface_gym.parcel import make_bodies
from surface_gym.physics.collision import ContactMaterial, World, make_world_scratch
from surface_gym.physics.rollout import Records, run_implicit, run_world
from surface_gym.physics.types import STATE_SIZE, Array, make_scratch
from surface_gym.simulation import simulate_together, start_state
from surface_gym.validation.drawn import draw_parcel, scatter

PARCELS = 24
SHAPE = (14, 56)  # rows and columns
TILT = math.radians(6.0)
DRAG = math.acos(2.0 * math.tan(TILT))  # [rad] of axes by which friction of 0.5 balances the slope
SPEED = 0.5  # [m/s]
GATE = 40  # first column of braking axes, for the held crowd
PILING = 4.0  # [s]
DT = 0.005  # [s]
STEPS = 100  # before parcels of the stream reach the end
SCENES = 4
ROUNDS = 15

STREAM = f"crowd, {PARCELS} parcels of 8000 an hour"
HELD = f"crowd, {PARCELS} parcels held, in touch"
LEAST_STREAM = 0.7  # parcel steps of the stream, over those of its parcels alone


def _slope(axis: Array) -> sg.Surface:
    return sg.Surface(axis, np.ones(SHAPE, dtype=bool), tilt=TILT)


class _Race:
    """Parcels that are stepped from the same starts, either together or alone."""

    def __init__(
        self, surface: sg.Surface, parcels: list[sg.Parcel], poses: Array, speed: float
    ) -> None:
        velocities = np.full((len(parcels), 3), (speed, 0.0, 0.0))
        velocities += speed * np.random.default_rng(0).normal(0.0, 0.05, velocities.shape)
        starts = zip(parcels, poses, velocities, strict=True)
        self.start = np.stack([start_state(*each) for each in starts])
        self.grid, self.bodies = surface.grid, [parcel.body for parcel in parcels]
        rows = np.arange(len(parcels))
        present = np.ones(len(parcels), dtype=np.bool_)
        self.world = World(self.start.copy(), present, rows, make_bodies(parcels))
        self.scratch = make_world_scratch(len(parcels))
        self.alone = [make_scratch() for _ in parcels]
        shape, room = (STEPS + 1, len(parcels)), 100 * STEPS + len(self.scratch.pair)
        self.records = Records(
            np.zeros((*shape, STATE_SIZE)), np.zeros(shape, dtype=np.int64),
            np.zeros(room, dtype=np.int64), np.zeros((room, 2), dtype=np.int64), np.zeros(room),
        )  # fmt: skip
        self.states = np.zeros((STEPS + 1, STATE_SIZE))

    def step_together(self) -> int:
        """Step all parcels together; return the number of parcel steps."""
        self.world.state[:] = self.start
        material = ContactMaterial(0.0, 0.3)
        arguments = (self.grid, self.world, material, self.scratch, self.records)
        following, _ = run_world(*arguments, 1, STEPS, 0, DT)
        return int(following - 1) * len(self.start)

    def step_alone(self) -> int:
        """Step each parcel alone; return the number of parcel steps."""
        done = 0
        for start, body, scratch in zip(self.start, self.bodies, self.alone, strict=True):
            self.states[0] = start
            reports = self.records.report[:, 0]
            done += run_implicit(self.grid, body, self.states, reports.copy(), scratch, DT)
        return done


def _draw(seed: int) -> tuple[_Race, _Race]:
    """Draw a stream and a held crowd of the same parcels."""
    rng = np.random.default_rng(seed)
    parcels = [draw_parcel(rng) for _ in range(PARCELS)]
    poses = scatter(rng, parcels, (0.3, 0.2, -math.pi), (4.3, 1.2, math.pi), 0.03)
    turns = np.where(np.indices(SHAPE).sum(axis=0) % 2, DRAG, -DRAG)
    stream = _Race(_slope(turns), parcels, poses, SPEED)
    brake = np.arange(SHAPE[1]) >= GATE
    held = _slope(np.broadcast_to(np.where(brake, 0.0, 0.5 * math.pi), SHAPE))
    runs = simulate_together(held, parcels, poses, duration=PILING).trajectories
    return stream, _Race(held, parcels, np.array([run.pose[-1] for run in runs]), 0.0)


def _speed(steps: Callable[[], int]) -> float:
    begin = time.perf_counter()
    return steps() / (time.perf_counter() - begin)


def crowd_figures() -> list[Figure]:
    """Measure parcel steps per second together and alone, and their ratios."""
    races = [_draw(seed) for seed in range(SCENES)]
    figures = []
    for k, (name, least) in enumerate(((STREAM, LEAST_STREAM), (HELD, None))):
        together, alone = np.array(
            [
                [(_speed(race[k].step_together), _speed(race[k].step_alone)) for race in races]
                for _ in range(ROUNDS)
            ]
        )[1:].T
        figures += [
            Figure(f"{name}, together", float(np.median(together)), "parcel steps/s"),
            Figure(f"{name}, each alone", float(np.median(alone)), "parcel steps/s"),
            Figure(f"{name}, over each alone", float(np.median(together / alone)), "", least=least),
        ]
    return figures
