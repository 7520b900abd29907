"""Sets of contacts made by hand or drawn, for the compiled functions that take them."""

import numpy as np

from surface_gym.dynamics.entries import dual_normal_forces
from surface_gym.dynamics.types import Grid, Scratch

WEIGHT = 9.81  # [m/s^2] normal load / mass
PITCH = 0.1  # [m]


def make_contacts(
    arms: np.ndarray,
    axis: np.ndarray | None = None,
    rotor: np.ndarray | None = None,
    normal: np.ndarray | None = None,
    stiffness: np.ndarray | None = None,
) -> Scratch:
    """Scratch that holds contacts at arms (n, 2) [m].

    By default rotors, all at 0 rad, of the same stiffness and unloaded.
    """
    count = len(arms)
    axis = np.zeros(count) if axis is None else axis
    return Scratch(
        arm_x=arms[:, 0].copy(),
        arm_y=arms[:, 1].copy(),
        axis_x=np.cos(axis),
        axis_y=np.sin(axis),
        rotor=np.ones(count, dtype=bool) if rotor is None else rotor.copy(),
        stiffness=np.ones(count) if stiffness is None else stiffness.copy(),
        normal=np.zeros(count) if normal is None else normal.copy(),
        edges=np.zeros((0, 3)),
        slide=np.zeros((count, 4)),
    )


def make_grid(
    mu_max: float = 0.5, mu_min: float = 0.01, mu_support: float = 0.005, along: float = 0.0
) -> Grid:
    """A grid of one element, for functions that read no more than friction and gravity."""
    return Grid(
        direction=np.array([[[1.0, 0.0]]]),
        rotor=np.ones((1, 1), dtype=bool),
        stiffness=np.ones((1, 1)),
        x0=0.0,
        y0=0.0,
        pitch=PITCH,
        mu_max=mu_max,
        mu_min=mu_min,
        mu_support=mu_support,
        gravity_along=along,
        gravity_normal=WEIGHT,
    )


def draw_arms(rng: np.random.Generator, count: int) -> np.ndarray:
    """Arms (count, 2) [m] of elements of a 5 x 5 grid, from a point near their mean."""
    grid = PITCH * np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), axis=-1).reshape(-1, 2)
    arms = grid[rng.choice(25, count, replace=False)]
    return arms - arms.mean(axis=0) + rng.uniform(-0.05, 0.05, size=2)


def dual(
    arms: np.ndarray, load: np.ndarray, stiffness: np.ndarray | None = None
) -> tuple[np.ndarray, bool]:
    """The dual's answer in the form of the references'."""
    contacts = make_contacts(arms, stiffness=stiffness)
    degenerate = dual_normal_forces(contacts, len(arms), WEIGHT, load[0], load[1], PITCH)
    return contacts.normal, degenerate
