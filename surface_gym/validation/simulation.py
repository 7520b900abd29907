"""`simulate` with MuJoCo in place of the analytic model."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surface_gym import checks
from surface_gym.parcel import Parcel
from surface_gym.physics.types import GRAVITY
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory
from surface_gym.validation.reach import reachable, under
from surface_gym.validation.recipe import RECIPE, Recipe
from surface_gym.validation.scene import Scene, build, load_mujoco

Array = NDArray[np.float64]

TIPPING = 1e-3  # [rad] out of level; the contacts' springs give way by some 1e-5


def simulate(
    surface: Surface,
    parcel: Parcel,
    pose: ArrayLike,
    velocity: ArrayLike = (0.0, 0.0, 0.0),
    duration: float = 1.0,
    recipe: Recipe = RECIPE,
    heights: ArrayLike | None = None,
) -> Trajectory:
    """Move a parcel over a surface whose axes stay as they are, as `surface_gym.simulate` does.

    Only the elements the parcel can reach are built.

    Args:
        surface: the surface, tilted by at most 15 deg.
        parcel: the parcel.
        pose: (x, y, theta) [m, m, rad] of the base's frame at the start.
        velocity: (vx, vy, omega) [m/s, m/s, rad/s] of that frame at the start.
        duration: [s] simulated; the last step is shortened to end there.
        recipe: step, contact parameters and rotors.
        heights: (rows, columns) [m] of the tops of the elements above the plane; None: flat.

    Returns:
        The trajectory, a row for each step of the recipe. `tipping` says where the base is more
        than 1 mrad out of level. It ends early where the centre of mass passes the edge of the
        surface.

    Raises:
        ValueError: an argument is not allowed, the start is off the surface, the step is too
            coarse for the springs under the base, or MuJoCo cannot build the scene (see `build`).
        RuntimeError: MuJoCo diverged; a smaller step helps.
        ImportError: MuJoCo is not installed.
    """
    start = checks.array("pose", pose, (3,))
    motion = checks.array("velocity", velocity, (3,))
    duration = checks.positive("duration", duration)
    bearing = under(surface, parcel, start)
    if not bearing.any() or not _is_over(surface, parcel, start[np.newaxis])[0]:
        raise ValueError(f"pose must be on the surface, got {tuple(start.tolist())}")
    stiffness = recipe.stiffness * surface.grid.stiffness[bearing]
    _check_step(recipe, stiffness)
    scene = build(
        surface, parcel, recipe, heights, reachable(surface, parcel, start, motion, duration)
    )
    tops = np.zeros(bearing.shape) if heights is None else np.asarray(heights, dtype=np.float64)
    sag = static_sag(tops[bearing], stiffness, GRAVITY * math.cos(surface.tilt))
    time, place, speed = _run(scene, surface, start, motion, sag, duration, recipe)
    return trajectory_of(surface, parcel, start[2], time, place, speed)


def static_sag(tops: Array, stiffness: Array, weight: float) -> float:
    """[m] by which a level base sinks below the plane until the springs under it carry it.

    Args:
        tops: (contacts,) [m] above the plane.
        stiffness: (contacts,) [1/s^2] of a spring / parcel mass.
        weight: [m/s^2] normal load / mass.
    """
    highest_first = np.argsort(tops)[::-1]
    k = stiffness[highest_first]
    # Carried by the highest few alone it would sink to here; the least is where no other helps.
    alone = (weight - np.cumsum(k * tops[highest_first])) / np.cumsum(k)
    return float(alone.min())


def normal_forces(scene: Scene, data: Any) -> tuple[NDArray[np.int64], Array]:
    """Geoms of the elements that touch the base, and the normal forces [N] between them."""
    contact = data.contact
    row = contact.efc_address
    touching = row >= 0
    geom = contact.geom[touching].sum(axis=1) - scene.base_geom
    return geom, data.efc_force[row[touching]]


def _check_step(recipe: Recipe, stiffness: Array) -> None:
    """The parcel bounces without end where a step is longer than its springs' swing."""
    longest = 1.0 / math.sqrt(stiffness.sum())
    if recipe.step > longest:
        raise ValueError(
            f"recipe.step must be at most {longest:.1e} s on the {len(stiffness)} elements under "
            f"the base, got {recipe.step:g}"
        )


def _run(
    scene: Scene,
    surface: Surface,
    start: Array,
    motion: Array,
    sag: float,
    duration: float,
    recipe: Recipe,
) -> tuple[Array, Array, Array]:
    """Times (T,), the base frame's place and quaternion (T, 7), its velocity (T, 6)."""
    mujoco = load_mujoco()
    model = scene.model
    data = mujoco.MjData(model)
    half_turn = 0.5 * start[2]
    data.qpos[:7] = start[0], start[1], -sag, math.cos(half_turn), 0, 0, math.sin(half_turn)
    data.qvel[:6] = motion[0], motion[1], 0, 0, 0, motion[2]
    whole = math.floor(duration / recipe.step + 1e-6)
    rest = duration - whole * recipe.step
    steps = whole + (rest > 1e-6 * recipe.step)
    time, place, speed = np.zeros(steps + 1), np.zeros((steps + 1, 7)), np.zeros((steps + 1, 6))
    place[0], speed[0] = data.qpos[:7], data.qvel[:6]
    # A bearing's friction grows with the load its rotor carries, which MuJoCo has no name for.
    loss_per_newton = surface.mu_min * recipe.rotor_radius
    for k in range(1, steps + 1):
        if k > whole:
            model.opt.timestep = rest
        mujoco.mj_step(model, data)
        geom, force = normal_forces(scene, data)
        dof = scene.rotor_dof[geom]
        rolling = dof >= 0
        model.dof_frictionloss[:] = 0.0
        model.dof_frictionloss[dof[rolling]] = loss_per_newton * force[rolling]
        time[k], place[k], speed[k] = data.time, data.qpos[:7], data.qvel[:6]
    if any(warning.number for warning in data.warning) or not np.isfinite(place).all():
        raise RuntimeError(
            f"MuJoCo diverged at a step of {recipe.step:g} s and a stiffness of "
            f"{recipe.stiffness:g} 1/s^2; a smaller step helps"
        )
    return time, place, speed


def trajectory_of(
    surface: Surface, parcel: Parcel, theta: float, time: Array, place: Array, speed: Array
) -> Trajectory:
    """The motion in the plane, up to where the centre of mass leaves the surface.

    Args:
        surface: the surface.
        parcel: the parcel.
        theta: [rad] at the start.
        time: (T,) [s].
        place: (T, 7) the base frame's place [m] and quaternion.
        speed: (T, 6) its velocity [m/s, rad/s].
    """
    w, i, j, k = place[:, 3:].T
    turned = np.unwrap(np.arctan2(2.0 * (w * k + i * j), 1.0 - 2.0 * (j * j + k * k)))
    turned += theta - turned[0]
    pose = np.column_stack([place[:, :2], turned])
    velocity = np.column_stack([speed[:, :2], speed[:, 5]])
    tipping = 2.0 * np.hypot(i, j) > TIPPING
    over = _is_over(surface, parcel, pose)
    steps = len(time) if over.all() else int(np.argmin(over))
    done = slice(0, steps)
    end = "duration" if over.all() else "left the surface"
    return Trajectory(time[done], pose[done], velocity[done], tipping[done], end)


def _is_over(surface: Surface, parcel: Parcel, pose: Array) -> NDArray[np.bool_]:
    """Whether the centre of mass is over the surface, (T,), at poses (T, 3)."""
    com_x, com_y = parcel.centre_of_mass
    cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x = pose[:, 0] + cosine * com_x - sine * com_y
    y = pose[:, 1] + sine * com_x + cosine * com_y
    # An element stands for the square of one pitch around it.
    half_length = 0.5 * surface.pitch_x * surface.columns
    half_width = 0.5 * surface.pitch_y * surface.rows
    along = np.abs(x - surface.x.mean()) <= half_length
    return np.asarray(along & (np.abs(y - surface.y.mean()) <= half_width))
