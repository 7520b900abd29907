"""Eq. (1) on uneven supports, and the analytic model run quasi-statically with it.

Eq. (1) is what a rigid flat base does on equal springs: the minimum of the sum of N^2 / (2 k) under
the balance of forces. If a spring's top stands h above the plane, it is pressed in h further, and
    minimise  sum of N_i^2 / (2 k_i) - N_i h_i   under vertical and moment balance,  N >= 0,
so that N_i = max(0, k_i (plane_i + h_i)): the pressure plane of Eq. (1) with an offset k h at each
contact. With all h equal and all k equal it is Eq. (1); where k h spreads far beyond the mean load,
three contacts carry all.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import nnls

from surface_gym import checks
from surface_gym.parcel import Parcel
from surface_gym.physics.references import advance_implicit, find_support, load_point
from surface_gym.physics.types import ARM_X, ARM_Y, NORMAL, make_scratch, table_row
from surface_gym.simulation import start_state
from surface_gym.surface import Surface

Array = NDArray[np.float64]


def uneven_normal_forces(
    arms: Array, heights: Array, stiffness: Array, weight: float, load: ArrayLike
) -> Array:
    """The normal forces on contacts of unequal height and stiffness.

    Args:
        arms: (n, 2) [m] from the centre of mass to the contacts.
        heights: (n,) [m] of the contacts above the plane.
        stiffness: (n,) [1/s^2] of the contacts / mass.
        weight: [m/s^2] normal load / mass.
        load: (2,) [m] where it acts, from the centre of mass.

    Returns:
        (n,) [m/s^2] normal forces / mass. Where the contacts cannot carry the load (the parcel
        tips), the moments come as near to balance as they can.
    """
    scale = float(np.abs(arms).max()) or 1.0
    target = np.array([1.0, *(np.asarray(load) / scale)])
    # The least sum of (N_i - k_i h_i)^2 / k_i, in N_i / root k_i, the balance as heavy rows above.
    heavy = np.array([1e6, 1e4, 1e4])
    balance = heavy[:, np.newaxis] * np.vstack([np.ones(len(arms)), arms.T / scale])
    mean = stiffness.mean()
    root = np.sqrt(stiffness / mean)
    system = np.vstack([balance * root, np.eye(len(arms))])
    scaled, _ = nnls(system, np.concatenate([heavy * target, root * heights * mean / weight]))
    share = root * scaled
    return np.asarray(weight * share / share.sum())


def end_pose(
    surface: Surface,
    parcel: Parcel,
    pose: ArrayLike,
    velocity: ArrayLike,
    duration: float,
    heights: ArrayLike,
    stiffness: float,
    dt: float = 1e-3,
) -> Array:
    """Where the implicit model ends with the normal forces of uneven supports.

    Args:
        surface: the surface; its `stiffness` multiplies that of a contact.
        parcel: the parcel.
        pose: (x, y, theta) [m, m, rad] of the base's frame at the start.
        velocity: (vx, vy, omega) [m/s, m/s, rad/s] of that frame at the start.
        duration: [s] simulated, in whole steps.
        heights: (rows, columns) [m] of the tops of the elements above the plane.
        stiffness: [1/s^2] of a contact / parcel mass.
        dt: [s] step.

    Returns:
        (3,) [m, m, rad] pose of the base's frame.

    Raises:
        ValueError: `heights` has another shape, or the parcel leaves the surface.
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
        # The element under each contact: its place half a step on, as find_support sees it.
        place = state[:2] + 0.5 * dt * state[3:5] + arms - surface.origin
        column, row = np.rint(place / (surface.pitch_x, surface.pitch_y)).astype(np.int64).T
        load = load_point(grid, body, state)
        table_row(scratch, NORMAL, contacts.total)[:] = uneven_normal_forces(
            arms,
            tops[row, column],
            stiffness * grid.stiffness[row, column],
            grid.gravity_normal,
            load,
        )
        advance_implicit(grid, body, state, scratch, contacts, dt)
    arm = start_state(parcel, np.array([0.0, 0.0, state[2]]), np.zeros(3))[:2]
    return np.array([state[0] - arm[0], state[1] - arm[1], state[2]])
