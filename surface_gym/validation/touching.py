"""Two parcels that push each other, on drawn surfaces: MuJoCo beside the analytic model."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from surface_gym.parcel import Base, Disc, Parcel, Polygon, Rectangle
from surface_gym.simulation import Encounter, simulate_together
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory
from surface_gym.validation import simulation
from surface_gym.validation.scene import SIDES
from surface_gym.validation.simulation import TOGETHER_RECIPE

Array = NDArray[np.float64]

DURATION = 0.5  # [s]
STEPS = (1e-3, 5e-3)  # [s] of the analytic model
COM_HEIGHT = 0.05  # [m] of both, so that they press at one height
MARGIN = 0.12  # [m] beyond the analytic model's paths within which elements are built
UNIT = np.array([1e3, 1e3, 180.0 / math.pi])  # [m, m, rad] in [mm, mm, deg]


@dataclass(frozen=True)
class Meeting:
    """A drawn surface and two drawn parcels, one of which runs into the other at 0.5 to 2 m/s."""

    seed: int

    @cached_property
    def drawn(self) -> tuple[Surface, tuple[Parcel, Parcel], Array, Array]:
        """Surface, parcels, poses (2, 3) and velocities (2, 3): the first ones drawn with which
        the parcels touch, stay on the surface and do not tip.
        """
        rng = np.random.default_rng(self.seed)
        while True:
            drawn = _draw(rng)
            encounter = simulate_together(*drawn, DURATION, STEPS[0])
            ends = {trajectory.end for trajectory in encounter.trajectories}
            tips = any(trajectory.tipping.any() for trajectory in encounter.trajectories)
            if len(encounter.touches.time) > 0 and ends == {"duration"} and not tips:
                return drawn

    def analytic(self, dt: float) -> Encounter:
        """Run the meeting by the analytic model."""
        return simulate_together(*self.drawn, DURATION, dt)

    def mujoco(self, harder: float = 1.0) -> tuple[Trajectory, ...]:
        """Run the meeting in MuJoCo, its step divided and its sides harder by a factor."""
        surface, parcels, poses, velocities = self.drawn
        within = np.zeros((surface.rows, surface.columns), dtype=bool)
        paths = self.analytic(STEPS[0]).trajectories
        for parcel, path in zip(parcels, paths, strict=True):
            for x, y, _ in path.pose[::10]:
                away = np.hypot(*np.meshgrid(surface.x - x, surface.y - y))
                within |= away < parcel.base.reach + MARGIN
        return simulation.simulate_together(
            surface,
            parcels,
            poses,
            velocities,
            DURATION,
            within,
            TOGETHER_RECIPE.finer(harder),
            SIDES.harder(harder),
        )


def _draw(rng: np.random.Generator) -> tuple[Surface, tuple[Parcel, Parcel], Array, Array]:
    """Draw a surface, two parcels and their starts, one behind the other."""
    shape = (20, 24)
    surface = Surface(
        axis=rng.uniform(-math.pi, math.pi, shape),
        rotor=rng.random(shape) < rng.uniform(0.2, 0.8),
        mu_max=rng.uniform(0.1, 0.5),
        tilt=math.radians(rng.uniform(0.0, 8.0)),
    )
    parcels = (_draw_parcel(rng), _draw_parcel(rng))
    apart = sum(parcel.base.reach for parcel in parcels) + rng.uniform(0.01, 0.1)
    turns = rng.uniform(-math.pi, math.pi, 2)
    poses = np.array([[0.5, 1.0, turns[0]], [0.5 + apart, 1.0 + rng.uniform(-0.1, 0.1), turns[1]]])
    velocities = np.zeros((2, 3))
    velocities[0] = rng.uniform(0.5, 2.0), rng.uniform(-0.1, 0.1), rng.uniform(-1.0, 1.0)
    return surface, parcels, poses, velocities


def _draw_parcel(rng: np.random.Generator) -> Parcel:
    kind = rng.integers(3)
    base: Base
    if kind == 0:
        base = Rectangle(rng.uniform(0.2, 0.4), rng.uniform(0.2, 0.4))
    elif kind == 1:
        base = Disc(rng.uniform(0.12, 0.2))
    else:
        corners = rng.integers(4, 8)
        angle = 2.0 * math.pi * (np.arange(corners) + rng.uniform(-0.3, 0.3, corners)) / corners
        reach = rng.uniform(0.15, 0.22)
        base = Polygon(reach * np.column_stack([np.cos(angle), np.sin(angle)]))
    return Parcel(base, mass=math.exp(rng.uniform(0.0, 2.5)), com_height=COM_HEIGHT)


@dataclass(frozen=True, eq=False)
class MeetingRun:
    """Differences of a meeting's ends from MuJoCo's, [mm, mm, deg]."""

    meeting: Meeting
    analytic: Array  # (steps, 2, 3) by the analytic model's step and by parcel
    harder: Array  # (2, 3) of MuJoCo with half the step and sides twice as hard
    tips: bool  # MuJoCo's parcels come more than 1 mrad out of level


def run_meeting(meeting: Meeting) -> MeetingRun:
    """Run a meeting by all of them."""
    mujoco = meeting.mujoco()
    reference = _ends(mujoco)
    analytic = [_ends(meeting.analytic(dt).trajectories) for dt in STEPS]
    tips = any(bool(trajectory.tipping.any()) for trajectory in mujoco)
    harder = UNIT * (_ends(meeting.mujoco(2.0)) - reference)
    return MeetingRun(meeting, UNIT * (np.array(analytic) - reference), harder, tips)


def _ends(trajectories: tuple[Trajectory, ...]) -> Array:
    """(2, 3) [m, m, rad]."""
    return np.array([trajectory.pose[-1] for trajectory in trajectories])


def apart(differences: Array) -> tuple[float, float]:
    """Distance [mm] and angle [deg] of the worse parcel, of differences (2, 3) [mm, mm, deg]."""
    distance = np.hypot(differences[:, 0], differences[:, 1])
    return float(distance.max()), float(np.abs(differences[:, 2]).max())
