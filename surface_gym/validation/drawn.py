"""Random scenes in MuJoCo and in our model: uneven supports, and parcels that push each other.

Uneven supports. Eq. (1) describes a rigid flat base on equal springs: it minimises the sum of N^2 /
(2 k) under the balance of forces. If a spring's top is h above the plane, the spring is compressed
by h more, and the problem is
    minimise  sum of N_i^2 / (2 k_i) - N_i h_i   under vertical and moment balance,  N >= 0,
so that N_i = max(0, k_i (plane_i + h_i)): the pressure plane of Eq. (1) with an offset k h at each
contact. With all h equal and all k equal it is Eq. (1). If k h varies much more than the mean load,
three contacts carry everything.

MuJoCo's runs on uneven heights are compared with `end_pose`, whose time steps use this law. Runs on
uneven stiffnesses are compared with `surface_gym.simulate` and `Surface.stiffness`. Both together
show which spread of stiffness has the same effect as a spread of heights.

Meetings. One of two parcels runs into the other.

Crowds. Parcels are scattered over rolling rotors, and pile up before braking rotors. So they start
at rest, and most of them touch. In phase 1, the axes in front brake, and the rear parcels roll and
press against the front parcels. In phase 2, the front parcels roll, and the axes in the rear brake.
In phase 3, the rear parcels roll and hit the front parcels, where the axes brake again.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import nnls

from surface_gym import checks
from surface_gym.parcel import Base, Disc, Parcel, Polygon, Rectangle, make_bodies
from surface_gym.physics.collision import World
from surface_gym.physics.references import advance_implicit, find_support, load_point
from surface_gym.physics.rollout import distance_between
from surface_gym.physics.types import (
    ARM_X,
    ARM_Y,
    NORMAL,
    STATE_SIZE,
    Array,
    Booleans,
    make_scratch,
    table_row,
)
from surface_gym.simulation import Encounter, simulate, simulate_together, start_state
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory
from surface_gym.validation import simulation
from surface_gym.validation.comparison import IMPLICIT, INTEGRATIONS, PARCEL, PUSHED, SlopeCase
from surface_gym.validation.simulation import RECIPE, SIDES, TOGETHER_RECIPE, Recipe, Sides

CASES = (SlopeCase(10.0), PUSHED)
UNIT = np.array([1e3, 1e3, 180.0 / math.pi])  # factors from [m, m, rad] to [mm, mm, deg]


def uneven_normal_forces(
    arms: Array, heights: Array, stiffness: Array, weight: float, load: ArrayLike
) -> Array:
    """Compute normal forces / mass (n,) [m/s^2] of contacts with unequal height and stiffness.

    Forces and moments balance. If the parcel tips, the moments balance as well as possible.

    Args:
        arms: (n, 2) [m] contacts relative to the centre of mass.
        heights: (n,) [m] heights above the plane.
        stiffness: (n,) [1/s^2] stiffness per mass.
        weight: [m/s^2] normal load per mass.
        load: (2,) [m] point of action of the weight, relative to the centre of mass.
    """
    scale = float(np.abs(arms).max()) or 1.0
    target = np.array([1.0, *(np.asarray(load) / scale)])
    # Minimise the sum of (N_i - k_i h_i)^2 / k_i over N_i / sqrt(k_i), with heavily weighted
    # balance rows.
    heavy = np.array([1e6, 1e4, 1e4])
    balance = heavy[:, np.newaxis] * np.vstack([np.ones(len(arms)), arms.T / scale])
    mean = stiffness.mean()
    root = np.sqrt(stiffness / mean)
    system = np.vstack([balance * root, np.eye(len(arms))])
    scaled, _ = nnls(system, np.concatenate([heavy * target, root * heights * mean / weight]))
    share = root * scaled
    return np.asarray(weight * share / share.sum())


def end_pose(
    surface: Surface, parcel: Parcel, pose: ArrayLike, velocity: ArrayLike, duration: float,
    heights: ArrayLike, stiffness: float, dt: float = 1e-3,
) -> Array:  # fmt: skip
    """Run implicit time steps with normal forces of uneven supports; return the end pose (3,).

    `heights` (rows, columns) [m] are the heights of the elements' tops. `stiffness` [1/s^2] is a
    contact's stiffness divided by the parcel's mass. `surface.stiffness` holds factors of this
    stiffness. For all other arguments see `simulate`.
    """
    tops = checks.array("heights", heights, (surface.rows, surface.columns))
    grid, body = surface.grid, parcel.body
    scratch = make_scratch()
    state = start_state(parcel, np.asarray(pose), np.asarray(velocity))
    for step in range(round(duration / dt)):
        contacts = find_support(grid, body, state, scratch, 0.5 * dt)
        if contacts.total == 0:
            raise ValueError(f"duration must end on the surface, left it after {step * dt:g} s")
        arms = np.column_stack([table_row(scratch, row, contacts.total) for row in (ARM_X, ARM_Y)])
        # The element of each contact, at the pose of `find_support` after half a step.
        place = state[:2] + 0.5 * dt * state[3:5] + arms - surface.origin
        column, row = np.rint(place / (surface.pitch_x, surface.pitch_y)).astype(np.int64).T
        load = load_point(grid, body, state)
        table_row(scratch, NORMAL, contacts.total)[:] = uneven_normal_forces(
            arms, tops[row, column], stiffness * grid.stiffness[row, column], grid.gravity_normal,
            load,
        )  # fmt: skip
        advance_implicit(grid, body, state, scratch, contacts, dt)
    arm = start_state(parcel, np.array([0.0, 0.0, state[2]]), np.zeros(3))[:2]
    return np.array([state[0] - arm[0], state[1] - arm[1], state[2]])


@dataclass(frozen=True)
class Unevenness:
    """Spread of the elements' heights, or spread of the elements' stiffnesses."""

    height: float = 0.0  # [m] standard deviation
    stiffness: float = 0.0  # [-] standard deviation of the logarithm

    @property
    def name(self) -> str:
        if self.height:
            return f"height {1e6 * self.height:g} um"
        return f"log stiffness {self.stiffness:g}"


EVEN = Unevenness()
UNEVEN = (
    Unevenness(height=1e-6), Unevenness(height=5e-6), Unevenness(height=20e-6),
    Unevenness(stiffness=0.3), Unevenness(stiffness=0.6), Unevenness(stiffness=1.2),
)  # fmt: skip


@dataclass(frozen=True)
class SurfaceDraw:
    """A `SlopeCase` on a surface whose elements have random heights or stiffnesses."""

    case: SlopeCase
    unevenness: Unevenness
    seed: int

    @property
    def surface(self) -> Surface:
        """The case's surface with random stiffness."""
        return replace(
            self.case.surface, stiffness=np.exp(self.unevenness.stiffness * self._normal(1))
        )

    @property
    def heights(self) -> Array:
        """(rows, columns) [m] random heights of the elements' tops."""
        return self.unevenness.height * self._normal(0)

    def _normal(self, stream: int) -> Array:
        surface = self.case.surface
        rng = np.random.default_rng((self.seed, stream))
        return rng.standard_normal((surface.rows, surface.columns))


@dataclass(frozen=True, eq=False)
class PoseShifts:
    """End poses on random surfaces minus the end pose on the even surface."""

    case: SlopeCase
    unevenness: Unevenness
    mujoco: Array  # (draws, 3) [mm, mm, deg]
    analytic: Array  # (draws, 3) [mm, mm, deg] on the same surfaces


def draw_surfaces(draws: int, seed: int) -> tuple[SurfaceDraw, ...]:
    """Combine every case with an even surface, and with `draws` surfaces of each `Unevenness`."""
    return tuple(
        SurfaceDraw(case, unevenness, seed + k)
        for case in CASES
        for unevenness, count in ((EVEN, 1), *((uneven, draws) for uneven in UNEVEN))
        for k in range(count)
    )


def run_draw(draw: SurfaceDraw) -> Array:
    """Run a draw's case. Return two end poses (2, 3), first MuJoCo's, then our model's."""
    case, surface, heights = draw.case, draw.surface, draw.heights
    start = (case.pose, case.velocity, case.duration)
    mujoco = simulation.simulate(surface, PARCEL, *start, heights=heights).pose[-1]
    step = INTEGRATIONS[IMPLICIT].dt
    if draw.unevenness.height > 0.0:
        analytic = end_pose(surface, PARCEL, *start, heights, RECIPE.stiffness, step)
    else:
        analytic = simulate(surface, PARCEL, *start, step, IMPLICIT).pose[-1]
    return np.stack([mujoco, analytic])


def compare_draws(draws: Sequence[SurfaceDraw], results: Sequence[Array]) -> tuple[PoseShifts, ...]:
    """Subtract the end poses on the even surface from the end poses on random surfaces.

    `results` holds the result (2, 3) of `run_draw` for each draw in `draws`.
    """
    table = UNIT * np.array(results)

    def ends_of(case: SlopeCase, unevenness: Unevenness) -> Array:
        return table[[draw.case == case and draw.unevenness == unevenness for draw in draws]]

    return tuple(
        PoseShifts(case, uneven, *np.moveaxis(ends_of(case, uneven) - ends_of(case, EVEN), 1, 0))
        for case in CASES
        for uneven in UNEVEN
    )


def root_mean_square(shifts: Array) -> tuple[float, float]:
    """Compute root mean square distance [mm] and angle [deg] of shifts (draws, 3) [mm, mm, deg]."""
    x, y, theta = np.mean(shifts**2, axis=0)
    return math.sqrt(x + y), math.sqrt(theta)


STEPS = (1e-3, 5e-3)  # [s] steps of the analytic model
COM_HEIGHT = 0.05  # [m] of parcels that touch, so that they press at one height
MARGIN = 0.12  # [m] elements are built up to this distance from the analytic model's paths
MEETING = 0.5  # [s] duration


class TouchingScene(ABC):
    """Random parcels that push each other."""

    seed: int

    @abstractmethod
    def analytic(self, dt: float) -> tuple[Encounter, ...]:
        """Run the scene in our model in steps of `dt` [s]; return a result per setting of axes."""

    @abstractmethod
    def mujoco(self, harder: float = 1.0) -> tuple[Trajectory, ...]:
        """Run the scene in MuJoCo. Time step and duration of impacts are divided by `harder`."""

    def within_reach(self, surface: Surface, parcels: Sequence[Parcel], every: int) -> Booleans:
        """Find all elements near the parcels' paths; return a mask (rows, columns).

        The search uses one step in `every` steps of a path.
        """
        within = np.zeros((surface.rows, surface.columns), dtype=bool)
        for run in self.analytic(STEPS[0]):
            for parcel, path in zip(parcels, run.trajectories, strict=True):
                for x, y, _ in path.pose[::every]:
                    away = np.hypot(*np.meshgrid(surface.x - x, surface.y - y))
                    within |= away < parcel.base.reach + MARGIN
        return within


@dataclass(frozen=True)
class Meeting(TouchingScene):
    """A random surface and two random parcels. One parcel hits the other at 0.5 to 2 m/s."""

    seed: int

    @cached_property
    def drawn(self) -> tuple[Surface, tuple[Parcel, Parcel], Array, Array]:
        """Surface, parcels, poses (2, 3) and velocities (2, 3) at the start.

        The draw is repeated until the parcels touch each other, stay on the surface and do not tip.
        """
        rng = np.random.default_rng(self.seed)
        while True:
            drawn = _draw_meeting(rng)
            encounter = simulate_together(*drawn, MEETING, STEPS[0])
            if len(encounter.touches.time) > 0 and _stays(encounter):
                return drawn

    def analytic(self, dt: float) -> tuple[Encounter, ...]:
        return (simulate_together(*self.drawn, MEETING, dt),)

    def mujoco(self, harder: float = 1.0) -> tuple[Trajectory, ...]:
        surface, parcels, *_ = self.drawn
        within = self.within_reach(surface, parcels, every=10)
        recipe, sides = TOGETHER_RECIPE.finer(harder), SIDES.harder(harder)
        return simulation.simulate_together(*self.drawn, MEETING, within, recipe, sides)


def _stays(encounter: Encounter) -> bool:
    """Return whether all parcels stay on the surface and no parcel tips."""
    paths = encounter.trajectories
    return all(path.end == "duration" and not path.tipping.any() for path in paths)


def _draw_meeting(rng: np.random.Generator) -> tuple[Surface, tuple[Parcel, Parcel], Array, Array]:
    """Draw a surface, two parcels, poses (2, 3) and velocities (2, 3).

    Only the rear parcel moves.
    """
    shape = (20, 24)
    surface = Surface(
        axis=rng.uniform(-math.pi, math.pi, shape),
        rotor=rng.random(shape) < rng.uniform(0.2, 0.8),
        mu_max=rng.uniform(0.1, 0.5),
        tilt=math.radians(rng.uniform(0.0, 8.0)),
    )
    parcels = (_draw_one_of_two(rng), _draw_one_of_two(rng))
    apart = sum(parcel.base.reach for parcel in parcels) + rng.uniform(0.01, 0.1)
    turns = rng.uniform(-math.pi, math.pi, 2)
    poses = np.array([[0.5, 1.0, turns[0]], [0.5 + apart, 1.0 + rng.uniform(-0.1, 0.1), turns[1]]])
    velocities = np.zeros((2, 3))
    velocities[0] = rng.uniform(0.5, 2.0), rng.uniform(-0.1, 0.1), rng.uniform(-1.0, 1.0)
    return surface, parcels, poses, velocities


def _draw_one_of_two(rng: np.random.Generator) -> Parcel:
    kind = rng.integers(3)
    base: Base
    if kind == 0:
        base = Rectangle(rng.uniform(0.2, 0.4), rng.uniform(0.2, 0.4))
    else:
        base = Disc(rng.uniform(0.12, 0.2)) if kind == 1 else _draw_polygon(rng, 0.3, 0.15, 0.22)
    return Parcel(base, mass=math.exp(rng.uniform(0.0, 2.5)), com_height=COM_HEIGHT)


def draw_parcel(rng: np.random.Generator) -> Parcel:
    """Draw a parcel of a crowd: with odds 4 : 1 : 1 a rectangle, a polygon or a disc."""
    kind = rng.integers(6)
    base: Base
    if kind > 1:
        base = Rectangle(rng.uniform(0.2, 0.45), rng.uniform(0.2, 0.4))
    else:
        base = Disc(rng.uniform(0.12, 0.2)) if kind == 0 else _draw_polygon(rng, 0.2, 0.17, 0.24)
    return Parcel(base, mass=math.exp(rng.uniform(0.0, 2.5)), com_height=COM_HEIGHT)


def _draw_polygon(rng: np.random.Generator, spread: float, least: float, most: float) -> Polygon:
    """Draw a polygon with four to seven corners on a circle.

    The circle's radius is from `least` to `most` [m]. The corners are evenly spaced on the circle,
    then shifted along the circle by up to `spread` times the spacing.
    """
    corners = rng.integers(4, 8)
    angle = 2.0 * math.pi * (np.arange(corners) + rng.uniform(-spread, spread, corners)) / corners
    return Polygon(rng.uniform(least, most) * np.column_stack([np.cos(angle), np.sin(angle)]))


TILT = math.radians(6.0)
SHAPE = (14, 42)  # rows and columns: 1.4 m x 4.2 m
BRAKE, ROLL = 0.0, math.pi / 2  # [rad] axes along the slope, and across it
GATE = 28  # column from which on axes brake while the crowd gathers
GATHERING, STOPPING = 2.5, 0.5  # [s]
LEAST, MOST = 6, 12  # parcels
# [s] start of: front brakes, rear rolls; front rolls, rear brakes; front brakes, rear rolls
PHASES = (0.0, 0.2, 0.5)
CROWD = 1.0  # [s] duration
# Impacts are stopped five times more slowly than in meetings, which allows a longer step. Crowds
# close by less than 0.5 m/s. Pressed sides yield as little as in meetings.
CROWD_RECIPE = Recipe().lighter_rotors(1000.0)
CROWD_SIDES = Sides(damping=1e3, creep_damping=0.5)


def scatter(
    rng: np.random.Generator,
    parcels: Sequence[Parcel],
    low: tuple[float, float, float],
    high: tuple[float, float, float],
    gap: float,
) -> Array:
    """Draw uniform poses (parcels, 3) in [low, high]. Parcels are more than `gap` [m] apart."""
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


@dataclass(frozen=True)
class Crowd(TouchingScene):
    """A crowd of 6 to 12 random parcels on a slope of 6 deg. Axes hold and release the parcels."""

    seed: int

    @cached_property
    def pile(self) -> tuple[tuple[Parcel, ...], Array]:
        """Parcels, and their poses (parcels, 3) [m, m, rad] at rest before the run.

        The draw is repeated until no parcel leaves the surface or tips in the run.
        """
        rng = np.random.default_rng(self.seed)
        while True:
            parcels = tuple(draw_parcel(rng) for _ in range(rng.integers(LEAST, MOST + 1)))
            poses = scatter(rng, parcels, (0.3, 0.3, -math.pi), (2.8, 1.1, math.pi), 0.0)
            for columns, duration in ((GATE, GATHERING), (0, STOPPING)):
                brakes = np.arange(SHAPE[1]) >= columns
                run = simulate_together(_make_slope(brakes), parcels, poses, duration=duration)
                poses = ends(run.trajectories)
                if any(each.end != "duration" for each in run.trajectories):
                    break
            else:
                if all(map(_stays, _run_phases(parcels, poses, STEPS[0]))):
                    return parcels, poses

    def analytic(self, dt: float) -> tuple[Encounter, ...]:
        return _run_phases(*self.pile, dt)

    def mujoco(self, harder: float = 1.0) -> tuple[Trajectory, ...]:
        parcels, poses = self.pile
        first, *others = _make_slopes(poses)
        turns = [(time, each.axis) for time, each in zip(PHASES[1:], others, strict=True)]
        return simulation.simulate_together(
            first, parcels, poses, np.zeros_like(poses), CROWD,
            self.within_reach(first, parcels, every=20), CROWD_RECIPE.finer(harder),
            CROWD_SIDES.harder(harder), turns,
        )  # fmt: skip


def _make_slope(brakes: Booleans) -> Surface:
    """Make a slope of rotors; `brakes` (columns,) says which columns brake."""
    axis = np.broadcast_to(np.where(brakes, BRAKE, ROLL), SHAPE)
    return Surface(axis, np.ones(SHAPE, dtype=bool), tilt=TILT)


def _make_slopes(poses: Array) -> tuple[Surface, ...]:
    """Make three surfaces, one for each part (phase) of a run.

    In phases 1 and 3, a column brakes if the column's x is greater than the parcels' median x. In
    phase 2, the other columns brake.
    """
    columns = 0.05 + 0.1 * np.arange(SHAPE[1])
    front = columns > np.median(poses[:, 0])
    return _make_slope(front), _make_slope(~front), _make_slope(front)


def _run_phases(parcels: Sequence[Parcel], poses: Array, dt: float) -> tuple[Encounter, ...]:
    """Simulate a crowd from poses (parcels, 3), phase by phase, until a parcel's run ends early."""
    velocities = np.zeros_like(poses)
    runs = []
    for surface, begin, end in zip(_make_slopes(poses), PHASES, (*PHASES[1:], CROWD), strict=True):
        run = simulate_together(surface, parcels, poses, velocities, end - begin, dt)
        poses = ends(run.trajectories)
        velocities = np.array([each.velocity[-1] for each in run.trajectories])
        runs.append(run)
        if any(each.end != "duration" for each in run.trajectories):
            break
    return tuple(runs)


@dataclass(frozen=True, eq=False)
class TouchingRun:
    """Differences from MuJoCo's end poses [mm, mm, deg], in a scene `Meeting` or `Crowd`."""

    seed: int
    analytic: Array  # (steps, parcels, 3) analytic model, by step
    harder: Array  # (parcels, 3) MuJoCo with half the step and sides twice as hard
    tips: bool  # whether MuJoCo's parcels tilt by more than 1 mrad


def run_touching(scene: TouchingScene) -> TouchingRun:
    """Run a scene in our model, in MuJoCo, and in MuJoCo with half the step and shorter impacts."""
    mujoco = scene.mujoco()
    reference = ends(mujoco)
    analytic = [ends(scene.analytic(dt)[-1].trajectories) for dt in STEPS]
    tips = any(bool(trajectory.tipping.any()) for trajectory in mujoco)
    harder = UNIT * (ends(scene.mujoco(2.0)) - reference)
    return TouchingRun(scene.seed, UNIT * (np.array(analytic) - reference), harder, tips)


def ends(trajectories: tuple[Trajectory, ...]) -> Array:
    """Return the end poses (parcels, 3) [m, m, rad]."""
    return np.array([trajectory.pose[-1] for trajectory in trajectories])


def distances(differences: Array) -> Array:
    """Return distances [mm] and angles [deg] (parcels, 2) from pose differences (parcels, 3)."""
    return np.column_stack(
        [np.hypot(differences[:, 0], differences[:, 1]), np.abs(differences[:, 2])]
    )
