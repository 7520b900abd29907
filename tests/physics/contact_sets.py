"""Sets of contacts made by hand or drawn, for the compiled functions that take them."""

from typing import Any, NamedTuple

import numpy as np

import surface_gym as sg
from surface_gym.physics import types as ph
from surface_gym.physics.references import dual_normal_forces
from tests.environments import outside

WEIGHT = 9.81  # [m/s^2] normal load / mass
PITCH = 0.1  # [m]
SQUARE = np.array([[-0.1, -0.1], [0.1, -0.1], [-0.1, 0.1], [0.1, 0.1]])


class Friction(NamedTuple):
    """Friction of rotors along and across their axes, and of supports."""

    along: float = 0.5  # [-]
    across: float = 0.01  # [-]
    support: float = 0.005  # [-]


TABLE_1 = Friction()


def make_contacts(
    arms: np.ndarray,
    axis: np.ndarray | None = None,
    rotor: np.ndarray | None = None,
    normal: np.ndarray | None = None,
    stiffness: np.ndarray | None = None,
    friction: Friction = TABLE_1,
) -> tuple[ph.Scratch, ph.Contacts]:
    """Scratch that holds contacts at arms (n, 2) [m], and how many it holds.

    By default rotors, all at 0 rad, of the same stiffness and unloaded.
    """
    count = len(arms)
    rotor = np.ones(count, dtype=bool) if rotor is None else rotor
    angle = np.zeros(count) if axis is None else axis
    scratch = ph.make_scratch()
    for row, values in (
        (ph.ARM_X, arms[:, 0]),
        (ph.ARM_Y, arms[:, 1]),
        (ph.AXIS_X, np.where(rotor, np.cos(angle), 1.0)),
        (ph.AXIS_Y, np.where(rotor, np.sin(angle), 0.0)),
        (ph.STIFFNESS, np.ones(count) if stiffness is None else stiffness),
        (ph.MU_ALONG, np.where(rotor, friction.along, friction.support)),
        (ph.MU_ACROSS, np.where(rotor, friction.across, friction.support)),
        (ph.NORMAL, np.zeros(count) if normal is None else normal),
    ):
        ph.table_row(scratch, row, count)[:] = values
    scratch.marks[ph.KIND : ph.KIND + count] = rotor
    supports = np.flatnonzero(~rotor)
    scratch.marks[ph.ISOTROPIC : ph.ISOTROPIC + len(supports)] = supports
    return scratch, ph.Contacts(count, len(supports), len(supports))


def make_grid(gravity_x: float = 0.0, gravity_y: float = 0.0) -> ph.Grid:
    """A grid of one element, for functions that read no more than gravity."""
    return sg.Surface(np.zeros((1, 1)), np.ones((1, 1), dtype=bool)).grid._replace(
        gravity_x=gravity_x, gravity_y=gravity_y, gravity_normal=WEIGHT
    )


def scan(surface: sg.Surface, parcel: sg.Parcel, pose: Any) -> np.ndarray:
    """(rows, columns) the largest F_lambda of Section 3.2 at each element."""
    return outside(parcel.base, pose, *np.meshgrid(surface.x, surface.y))


def draw_arms(rng: np.random.Generator, count: int) -> np.ndarray:
    """Arms (count, 2) [m] of elements of a 5 x 5 grid, from a point near their mean."""
    grid = PITCH * np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), axis=-1).reshape(-1, 2)
    arms = grid[rng.choice(25, count, replace=False)]
    return arms - arms.mean(axis=0) + rng.uniform(-0.05, 0.05, size=2)


def dual(
    arms: np.ndarray, load: np.ndarray, stiffness: np.ndarray | None = None
) -> tuple[np.ndarray, bool]:
    """The dual's answer in the form of the references'."""
    scratch, contacts = make_contacts(arms, stiffness=stiffness)
    degenerate = dual_normal_forces(scratch, contacts.total, WEIGHT, load[0], load[1], PITCH)
    return ph.table_row(scratch, ph.NORMAL, contacts.total), degenerate
