"""`simulate_together` with MuJoCo in place of the analytic model."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surface_gym import checks
from surface_gym.parcel import Parcel
from surface_gym.physics.types import GRAVITY
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory
from surface_gym.validation.reach import under
from surface_gym.validation.recipe import Recipe
from surface_gym.validation.scene import Scene, build_together, load_mujoco
from surface_gym.validation.sides import SIDES, Sides
from surface_gym.validation.simulation import static_sag, trajectory_of

Array = NDArray[np.float64]

# The sides stop each other within 0.2 ms. Rotors without inertia, as the analytic model has none.
TOGETHER_RECIPE = Recipe(step=2e-5).lighter_rotors(1000.0)


def simulate_together(
    surface: Surface,
    parcels: Sequence[Parcel],
    poses: ArrayLike,
    velocities: ArrayLike,
    duration: float,
    within: NDArray[np.bool_],
    recipe: Recipe = TOGETHER_RECIPE,
    sides: Sides = SIDES,
) -> tuple[Trajectory, ...]:
    """Move parcels that push each other over a surface whose axes stay as they are.

    Args:
        surface: the surface, tilted by at most 15 deg.
        parcels: the parcels.
        poses: (parcels, 3) [m, m, rad] x, y, theta of the bases' frames at the start.
        velocities: (parcels, 3) [m/s, m/s, rad/s] of those frames at the start.
        duration: [s] simulated, in whole steps of the recipe.
        within: (rows, columns) the elements to build.
        recipe: step, contact parameters and rotors.
        sides: contact parameters between parcels.

    Returns:
        The trajectories, a row for each step of the recipe.

    Raises:
        ValueError: an argument is not allowed, or MuJoCo cannot build the scene.
        RuntimeError: MuJoCo diverged; a smaller step helps.
        ImportError: MuJoCo is not installed.
    """
    start = checks.array("poses", poses, (len(parcels), 3))
    motion = checks.array("velocities", velocities, start.shape)
    duration = checks.positive("duration", duration)
    scene = build_together(surface, parcels, recipe, sides, within)
    mujoco = load_mujoco()
    data = mujoco.MjData(scene.model)
    weight = GRAVITY * math.cos(surface.tilt)
    for k, parcel in enumerate(parcels):
        bearing = under(surface, parcel, start[k]) & within
        stiffness = recipe.stiffness * surface.grid.stiffness[bearing]
        sag = static_sag(np.zeros(len(stiffness)), stiffness, weight)
        x, y, theta = start[k]
        turn = math.cos(0.5 * theta), 0.0, 0.0, math.sin(0.5 * theta)
        data.qpos[7 * k : 7 * k + 7] = x, y, -sag, *turn
        data.qvel[6 * k : 6 * k + 6] = motion[k, 0], motion[k, 1], 0.0, 0.0, 0.0, motion[k, 2]
    steps = round(duration / recipe.step)
    count = len(parcels)
    time = np.arange(steps + 1, dtype=np.float64) * recipe.step
    place, speed = np.zeros((steps + 1, count, 7)), np.zeros((steps + 1, count, 6))
    loss_per_newton = float(surface.mu_min) * recipe.rotor_radius
    for step in range(steps + 1):
        place[step] = data.qpos[: 7 * count].reshape(count, 7)
        speed[step] = data.qvel[: 6 * count].reshape(count, 6)
        if step < steps:
            mujoco.mj_step(scene.model, data)
            _load_bearings(scene, data, loss_per_newton)
    if any(warning.number for warning in data.warning) or not np.isfinite(place).all():
        raise RuntimeError(f"MuJoCo diverged at a step of {recipe.step:g} s; a smaller step helps")
    return tuple(
        trajectory_of(surface, parcel, start[k, 2], time, place[:, k], speed[:, k])
        for k, parcel in enumerate(parcels)
    )


def _load_bearings(scene: Scene, data: Any, loss_per_newton: float) -> None:
    """Set the friction of the rotors' bearings by the load that they carry [N m / N]."""
    contact = data.contact
    row = contact.efc_address
    touching = row >= 0
    dof = scene.rotor_dof[contact.geom[touching]].max(axis=1)
    rolling = dof >= 0
    force = data.efc_force[row[touching]][rolling]
    scene.model.dof_frictionloss[:] = 0.0
    np.add.at(scene.model.dof_frictionloss, dof[rolling], loss_per_newton * force)
