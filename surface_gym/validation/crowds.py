"""Crowds on a slope in MuJoCo and in the model, held by braking axes and released in two parts.

Parcels are scattered over rolling rotors, and pile up before braking rotors. So they start at rest,
and most of them touch. In phase 1, the front brakes, and the rear rolls and presses against it. In
phase 2, the front is released and the rear is held. In phase 3, the rear is released and hits the
front, which brakes again.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from surface_gym.parcel import Base, Disc, Parcel, Polygon, Rectangle
from surface_gym.physics.collision import World
from surface_gym.physics.rollout import distance_between
from surface_gym.physics.types import STATE_SIZE, Array, Booleans
from surface_gym.simulation import Encounter, make_bodies, simulate_together, start_state
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory
from surface_gym.validation import simulation
from surface_gym.validation.drawn import COM_HEIGHT, MARGIN, STEPS, UNIT, ends
from surface_gym.validation.simulation import Recipe, Sides

TILT = math.radians(6.0)
SHAPE = (14, 42)  # rows and columns: 1.4 m x 4.2 m
BRAKE, ROLL = 0.0, math.pi / 2  # [rad] axes along the slope, and across it
GATE = 28  # column from which on axes brake while the crowd gathers
GATHERING, STOPPING = 2.5, 0.5  # [s]
LEAST, MOST = 6, 12  # parcels
# [s] start of: front brakes, rear rolls; front rolls, rear brakes; front brakes, rear rolls
PHASES = (0.0, 0.2, 0.5)
DURATION = 1.0  # [s]
# Impacts are stopped five times more slowly than in meetings, which allows a longer step. Crowds
# close by less than 0.5 m/s. Pressed sides yield as little as in meetings.
RECIPE = Recipe().lighter_rotors(1000.0)
SIDES = Sides(damping=1e3, creep_damping=0.5)


def draw_parcel(rng: np.random.Generator) -> Parcel:
    """Draw a parcel: four in six are rectangles, one is a polygon and one a disc."""
    kind = rng.integers(6)
    base: Base
    if kind == 0:
        base = Disc(rng.uniform(0.12, 0.2))
    elif kind == 1:
        corners = rng.integers(4, 8)
        angle = 2.0 * math.pi * (np.arange(corners) + rng.uniform(-0.2, 0.2, corners)) / corners
        base = Polygon(rng.uniform(0.17, 0.24) * np.column_stack([np.cos(angle), np.sin(angle)]))
    else:
        base = Rectangle(rng.uniform(0.2, 0.45), rng.uniform(0.2, 0.4))
    return Parcel(base, mass=math.exp(rng.uniform(0.0, 2.5)), com_height=COM_HEIGHT)


def scatter(
    rng: np.random.Generator,
    parcels: Sequence[Parcel],
    low: tuple[float, float, float],
    high: tuple[float, float, float],
    gap: float,
) -> Array:
    """Draw poses (parcels, 3) between two corners; repeat each until parcels keep a gap [m]."""
    count = len(parcels)
    poses = np.zeros((count, 3))
    present, rows = np.ones(count, dtype=np.bool_), np.arange(count)
    world = World(np.zeros((count, STATE_SIZE)), present, rows, make_bodies(parcels))
    for k, parcel in enumerate(parcels):
        clear = False
        while not clear:
            poses[k] = rng.uniform(low, high)
            world.state[k] = start_state(parcel, poses[k], np.zeros(3))
            clear = all(distance_between(world, other, k) > gap for other in range(k))
    return poses


@dataclass(frozen=True, eq=False)
class Pile:
    """Parcels at rest before the axes turn."""

    parcels: tuple[Parcel, ...]
    poses: Array  # (parcels, 3) [m, m, rad]

    @cached_property
    def surfaces(self) -> tuple[Surface, ...]:
        """One surface per phase. Half of the parcels have their centres over the front."""
        columns = 0.05 + 0.1 * np.arange(SHAPE[1])
        front = columns > np.median(self.poses[:, 0])
        return _surface(front), _surface(~front), _surface(front)

    def analytic(self, dt: float) -> tuple[Encounter, ...]:
        """Run the phases one after the other, with step `dt` [s], until a parcel leaves."""
        poses, velocities = self.poses, np.zeros_like(self.poses)
        runs = []
        for surface, begin, end in zip(self.surfaces, PHASES, (*PHASES[1:], DURATION), strict=True):
            run = simulate_together(surface, self.parcels, poses, velocities, end - begin, dt)
            poses = ends(run.trajectories)
            velocities = np.array([each.velocity[-1] for each in run.trajectories])
            runs.append(run)
            if any(each.end != "duration" for each in run.trajectories):
                break
        return tuple(runs)

    def mujoco(self, harder: float = 1.0) -> tuple[Trajectory, ...]:
        """Run all phases in MuJoCo, with a step smaller and sides harder by a factor."""
        first, *others = self.surfaces
        within = np.zeros(SHAPE, dtype=bool)
        for run in self.analytic(STEPS[0]):
            for parcel, path in zip(self.parcels, run.trajectories, strict=True):
                for x, y, _ in path.pose[::20]:
                    away = np.hypot(*np.meshgrid(first.x - x, first.y - y))
                    within |= away < parcel.base.reach + MARGIN
        turns = [(time, each.axis) for time, each in zip(PHASES[1:], others, strict=True)]
        return simulation.simulate_together(
            first, self.parcels, self.poses, np.zeros_like(self.poses), DURATION, within,
            RECIPE.finer(harder), SIDES.harder(harder), turns,
        )  # fmt: skip


@dataclass(frozen=True)
class Crowd:
    """A random crowd of 6 to 12 parcels on a slope of 6 deg."""

    seed: int

    @cached_property
    def pile(self) -> Pile:
        """The first random pile in which all parcels stay on the surface and none tips later."""
        rng = np.random.default_rng(self.seed)
        while True:
            parcels = tuple(draw_parcel(rng) for _ in range(rng.integers(LEAST, MOST + 1)))
            poses = scatter(rng, parcels, (0.3, 0.3, -math.pi), (2.8, 1.1, math.pi), 0.0)
            for columns, duration in ((GATE, GATHERING), (0, STOPPING)):
                brakes = np.arange(SHAPE[1]) >= columns
                run = simulate_together(_surface(brakes), parcels, poses, duration=duration)
                poses = ends(run.trajectories)
                if any(each.end != "duration" for each in run.trajectories):
                    break
            else:
                pile = Pile(parcels, poses)
                paths = [each for run in pile.analytic(STEPS[0]) for each in run.trajectories]
                if all(path.end == "duration" and not path.tipping.any() for path in paths):
                    return pile


def _surface(brakes: Booleans) -> Surface:
    """Make a slope of rotors with some braking columns."""
    axis = np.broadcast_to(np.where(brakes, BRAKE, ROLL), SHAPE)
    return Surface(axis, np.ones(SHAPE, dtype=bool), tilt=TILT)


@dataclass(frozen=True, eq=False)
class CrowdRun:
    """Differences of a crowd's end poses from MuJoCo's [mm, mm, deg]."""

    crowd: Crowd
    analytic: Array  # (steps, parcels, 3) analytic model, by step
    harder: Array  # (parcels, 3) MuJoCo with half the step and sides twice as hard
    tips: bool  # whether MuJoCo's parcels tilt by more than 1 mrad


def run_crowd(crowd: Crowd) -> CrowdRun:
    """Run a crowd in MuJoCo (twice) and by the analytic model."""
    mujoco = crowd.pile.mujoco()
    reference = ends(mujoco)
    analytic = [ends(crowd.pile.analytic(dt)[-1].trajectories) for dt in STEPS]
    tips = any(bool(trajectory.tipping.any()) for trajectory in mujoco)
    harder = UNIT * (ends(crowd.pile.mujoco(2.0)) - reference)
    return CrowdRun(crowd, UNIT * (np.array(analytic) - reference), harder, tips)
