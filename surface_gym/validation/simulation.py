"""`simulate` and `simulate_together` with MuJoCo in place of the analytic model."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surface_gym import checks
from surface_gym.parcel import Parcel
from surface_gym.physics.contacts import EDGE_TOLERANCE
from surface_gym.physics.types import GRAVITY
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory
from surface_gym.validation.scene import RECIPE, SIDES, Recipe, Scene, Sides, build, load_mujoco

Array = NDArray[np.float64]

TIPPING = 1e-3  # [rad] out of level; the contacts' springs give way by some 1e-5
# The sides stop each other within 0.2 ms. Rotors without inertia, as the analytic model has none.
TOGETHER_RECIPE = Recipe(step=2e-5).lighter_rotors(1000.0)


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

    Only the elements that the parcel can reach are built.

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
    bearing = elements_under(surface, parcel, start)
    if not bearing.any() or not _is_over(surface, parcel, start[np.newaxis])[0]:
        raise ValueError(f"pose must be on the surface, got {tuple(start.tolist())}")
    stiffness = recipe.stiffness * surface.grid.stiffness[bearing]
    # The parcel bounces without end where a step is longer than its springs' swing.
    longest = 1.0 / math.sqrt(stiffness.sum())
    if recipe.step > longest:
        raise ValueError(
            f"recipe.step must be at most {longest:.1e} s on the {len(stiffness)} elements under "
            f"the base, got {recipe.step:g}"
        )
    within = reachable(surface, parcel, start, motion, duration)
    scene = build(surface, parcel, recipe, heights, within)
    tops = np.zeros(bearing.shape) if heights is None else np.asarray(heights, dtype=np.float64)
    sag = static_sag(tops[bearing], stiffness, GRAVITY * math.cos(surface.tilt))
    only = (start[np.newaxis], motion[np.newaxis], [sag])
    return _run(scene, surface, [parcel], *only, duration, recipe)[0]


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
        duration: [s] simulated; the last step is shortened to end there.
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
    scene = build(surface, parcels, recipe, None, within, sides)
    sags = []
    for parcel, pose in zip(parcels, start, strict=True):
        bearing = elements_under(surface, parcel, pose) & within
        stiffness = recipe.stiffness * surface.grid.stiffness[bearing]
        weight = GRAVITY * math.cos(surface.tilt)
        sags.append(static_sag(np.zeros(len(stiffness)), stiffness, weight))
    return _run(scene, surface, parcels, start, motion, sags, duration, recipe)


def elements_under(surface: Surface, parcel: Parcel, pose: ArrayLike) -> NDArray[np.bool_]:
    """Find the elements under a base, (rows, columns): Section 3.2's F_lambda <= 0.

    Args:
        surface: the surface.
        parcel: the parcel.
        pose: (x, y, theta) [m, m, rad] of the base's frame.
    """
    x, y, theta = np.asarray(pose, dtype=np.float64)
    dx, dy = np.meshgrid(surface.x - x, surface.y - y)
    cosine, sine = math.cos(theta), math.sin(theta)
    outside = parcel.base.functions(cosine * dx + sine * dy, cosine * dy - sine * dx)
    return np.asarray(outside.max(axis=0) <= EDGE_TOLERANCE)


def reachable(
    surface: Surface, parcel: Parcel, pose: ArrayLike, velocity: ArrayLike, duration: float
) -> NDArray[np.bool_]:
    """Find the elements, (rows, columns), that a parcel's energy can take it to, without friction.

    Args:
        surface: the surface.
        parcel: the parcel.
        pose: (x, y, theta) [m, m, rad] of the base's frame at the start.
        velocity: (vx, vy, omega) [m/s, m/s, rad/s] of that frame at the start.
        duration: [s].
    """
    x, y, _ = np.asarray(pose, dtype=np.float64)
    vx, vy, omega = np.asarray(velocity, dtype=np.float64)
    arm = math.hypot(*parcel.centre_of_mass)
    gyration = parcel.moment_of_inertia / parcel.mass
    speed = math.hypot(math.hypot(vx, vy) + arm * abs(omega), omega * math.sqrt(gyration))
    downhill = GRAVITY * abs(math.sin(surface.tilt))
    path = speed * duration + 0.5 * downhill * duration**2
    outline = parcel.base.outline
    base = float(np.hypot(outline[:, 0], outline[:, 1]).max())
    pitch = max(surface.pitch_x, surface.pitch_y)
    # Twice the arm: the base's frame is one arm from the centre of mass at either end of the path.
    distance = np.hypot(*np.meshgrid(surface.x - x, surface.y - y))
    return np.asarray(distance <= path + base + 2.0 * arm + pitch)


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


def normal_forces(data: Any) -> tuple[NDArray[np.int64], Array]:
    """Geoms (contacts, 2) of the pairs that touch, and the normal forces [N] between them."""
    contact = data.contact
    row = contact.efc_address
    touching = row >= 0
    return contact.geom[touching], data.efc_force[row[touching]]


def _run(
    scene: Scene,
    surface: Surface,
    parcels: Sequence[Parcel],
    start: Array,
    motion: Array,
    sags: Sequence[float],
    duration: float,
    recipe: Recipe,
) -> tuple[Trajectory, ...]:
    """Step the scene from poses (parcels, 3) and velocities (parcels, 3) to its end."""
    mujoco = load_mujoco()
    model, count = scene.model, len(parcels)
    data = mujoco.MjData(model)
    for k, (x, y, theta) in enumerate(start):
        turn = math.cos(0.5 * theta), 0.0, 0.0, math.sin(0.5 * theta)
        data.qpos[7 * k : 7 * k + 7] = x, y, -sags[k], *turn
        data.qvel[6 * k : 6 * k + 6] = motion[k, 0], motion[k, 1], 0.0, 0.0, 0.0, motion[k, 2]
    whole = math.floor(duration / recipe.step + 1e-6)
    rest = duration - whole * recipe.step
    steps = whole + (rest > 1e-6 * recipe.step)
    time = np.zeros(steps + 1)
    place, speed = np.zeros((steps + 1, count, 7)), np.zeros((steps + 1, count, 6))
    # A bearing's friction grows with the load its rotor carries, which MuJoCo has no name for.
    loss_per_newton = float(surface.mu_min) * recipe.rotor_radius
    for k in range(steps + 1):
        if k > 0:
            if k > whole:
                model.opt.timestep = rest
            mujoco.mj_step(model, data)
            geoms, force = normal_forces(data)
            dof = scene.rotor_dof[geoms].max(axis=1)
            rolling = dof >= 0
            model.dof_frictionloss[:] = 0.0
            np.add.at(model.dof_frictionloss, dof[rolling], loss_per_newton * force[rolling])
        time[k] = data.time
        place[k] = data.qpos[: 7 * count].reshape(count, 7)
        speed[k] = data.qvel[: 6 * count].reshape(count, 6)
    if any(warning.number for warning in data.warning) or not np.isfinite(place).all():
        raise RuntimeError(
            f"MuJoCo diverged at a step of {recipe.step:g} s and a stiffness of "
            f"{recipe.stiffness:g} 1/s^2; a smaller step helps"
        )
    return tuple(
        _make_trajectory(surface, parcel, start[k, 2], time, place[:, k], speed[:, k])
        for k, parcel in enumerate(parcels)
    )


def _make_trajectory(
    surface: Surface, parcel: Parcel, theta: float, time: Array, place: Array, speed: Array
) -> Trajectory:
    """Motion in the plane, up to where the centre of mass leaves the surface.

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
    done = slice(0, len(time) if over.all() else int(np.argmin(over)))
    end = "duration" if over.all() else "left the surface"
    return Trajectory(time[done], pose[done], velocity[done], tipping[done], end)


def _is_over(surface: Surface, parcel: Parcel, pose: Array) -> NDArray[np.bool_]:
    """Check at poses (T, 3) whether the centre of mass is over the surface, (T,)."""
    com_x, com_y = parcel.centre_of_mass
    cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x = pose[:, 0] + cosine * com_x - sine * com_y
    y = pose[:, 1] + sine * com_x + cosine * com_y
    # An element stands for the square of one pitch around it.
    half_length = 0.5 * surface.pitch_x * surface.columns
    half_width = 0.5 * surface.pitch_y * surface.rows
    along = np.abs(x - surface.x.mean()) <= half_length
    return np.asarray(along & (np.abs(y - surface.y.mean()) <= half_width))
