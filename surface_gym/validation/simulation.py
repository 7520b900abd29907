"""MuJoCo's scene of Tables 5 and 6, and runs of parcels in it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import combinations
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from surface_gym import checks
from surface_gym.parcel import Base, Disc, Parcel, Rectangle
from surface_gym.physics.contacts import EDGE_TOLERANCE
from surface_gym.physics.types import GRAVITY, Array, Booleans, Integers
from surface_gym.surface import Surface
from surface_gym.trajectory import Trajectory

MAX_TILT = math.radians(15.0)  # [rad] end of Table 5's range
# MuJoCo's memory grows with the square of the degrees of freedom: 0.9 GB for these limits.
MAX_ROTORS = 4_000
MAX_ELEMENTS = 40_000

BASE = "base"  # name of the first parcel's shape
BELT = 0.01  # [m] height of the belt around the centre of mass by which parcels touch
# [m] minimum height of the parcel's shape; only its underside touches anything
LEAST_BODY_HEIGHT = 0.02


@dataclass(frozen=True)
class Recipe:
    """Rotors of Table 5, and contact parameters for Coulomb's law on stiff springs.

    A contact in MuJoCo is a spring and a damper with an impedance d. With d near 0, the penetration
    determines the force, so every contact has the same stiffness, as Eq. (1) assumes. With
    d near 1 (MuJoCo's default), a sliding contact is also lifted, because of the friction cone.
    """

    step: float = 1e-4  # [s]
    # [1/s^2] contact stiffness / parcel mass; 3e6 N/m for 5.48 kg. It is multiplied by
    # `Surface.stiffness`, which is a ratio.
    stiffness: float = 5.474e5
    damping: float = 391.5  # [1/s] contact damping / parcel mass
    impedance: float = 1e-4  # [-] d of a contact, MuJoCo's minimum
    # [1/s] damping of a held contact, with time constant impedance / creep_damping = 2 ms. A
    # sliding contact carries mu creep_damping v more per unit mass, since the friction cone still
    # lifts it slightly.
    creep_damping: float = 0.05
    friction_stiffening: float = 1e5  # [-] MuJoCo's impratio
    bearing_impedance: float = 0.9999  # [-] d of a rotor's bearing friction
    tolerance: float = 1e-12  # [-] tolerance of the constraint solver
    rotor_radius: float = 0.01  # [m] Table 5
    rotor_mass: float = 8.61e-3  # [kg] Table 5
    rotor_inertia: float = 4.30e-7  # [kg m^2] about the axis, Table 5
    # [kg m^2] across the axis; Table 5 prints e-2 for y, a misprint
    rotor_cross_inertia: float = 2.87e-7

    def __post_init__(self) -> None:
        checks.settle(self, **{field.name: checks.positive for field in fields(self)})
        for name in ("impedance", "bearing_impedance"):
            checks.within(name, getattr(self, name), 1e-4, 0.9999)

    def stiffer(self, factor: float) -> "Recipe":
        """Return a copy with `factor` times the contact stiffness, and the same damping ratio."""
        return replace(
            self, stiffness=factor * self.stiffness, damping=math.sqrt(factor) * self.damping
        )

    def finer(self, factor: float) -> "Recipe":
        """Return a copy with the time step divided by a factor."""
        return replace(self, step=self.step / factor)

    def lighter_rotors(self, factor: float) -> "Recipe":
        """Return a copy with the rotors' inertia / `factor`. Eq. (2)-(4) neglect this inertia."""
        return replace(
            self,
            rotor_mass=self.rotor_mass / factor,
            rotor_inertia=self.rotor_inertia / factor,
            rotor_cross_inertia=self.rotor_cross_inertia / factor,
        )


@dataclass(frozen=True)
class Sides:
    """Contact parameters between the sides of parcels, for impacts without rebound.

    Contacts have the low impedance of the `Recipe`, and enough damping to prevent a rebound. If two
    sides meet at a speed v [m/s], the damper stops them in a time of 1 / damping [s]. The sides
    then overlap by v / damping [m]. Afterwards, the spring separates the sides at a speed of
    v * stiffness / damping^2 [m/s].
    """

    stiffness: float = 1e5  # [1/s^2] contact stiffness / effective mass
    damping: float = 5e3  # [1/s] contact damping / effective mass
    # [1/s] damping of held sides; time constant impedance / creep_damping = 0.01 ms. Slip may stop
    # and return within a hit of 0.2 ms, which slower friction would not follow.
    creep_damping: float = 10.0
    friction: float = 0.3  # [-]

    def __post_init__(self) -> None:
        allowed = {field.name: checks.positive for field in fields(self)}
        checks.settle(self, **(allowed | {"friction": checks.not_negative}))

    def harder(self, factor: float) -> "Sides":
        """Return a copy for impacts whose duration is divided by a factor."""
        return replace(
            self,
            stiffness=factor * self.stiffness,
            damping=factor * self.damping,
            creep_damping=factor * self.creep_damping,
        )


@dataclass(frozen=True, eq=False)
class Swivel:
    """Parameters of axes that turn gradually. The centre of the turn is the rotor's contact."""

    target: Array  # (rows, columns) [rad] axes to turn to, by the shorter way
    start: float  # [s]
    speed: float  # [rad/s]
    patch: float = 0.0  # [m] radius of contact patches, with a torque of up to 2/3 mu_max N patch


SWIVEL_ARMATURE = 1e3  # [kg m^2] of a turning axis, so that no contact disturbs its motion
RECIPE = Recipe()
SIDES = Sides()


@dataclass(frozen=True, eq=False)
class MujocoScene:
    """A compiled MuJoCo model of parcels on a surface, and the rotors' degrees of freedom.

    The parcels' joints are the first joints of the model. So qpos[:7] is the pose of the first
    parcel's base frame, and qvel[:6] is the velocity of this frame.
    """

    model: Any  # mujoco.MjModel
    rotor_dof: Integers  # (geoms,) degree of freedom of a rotor, -1 for other geoms


def load_mujoco() -> ModuleType:
    """Import the mujoco package."""
    try:
        import mujoco
    except ImportError as error:
        raise ImportError(
            f"the validation needs MuJoCo ({error}): pip install 'surface_gym[validation]'"
        ) from None
    return mujoco


def build(
    surface: Surface, parcels: Parcel | Sequence[Parcel], recipe: Recipe = RECIPE,
    heights: ArrayLike | None = None, within: ArrayLike | None = None, sides: Sides = SIDES,
    swivel: Swivel | None = None,
) -> MujocoScene:  # fmt: skip
    """Build prisms for parcels, hinged spheres for rotors, and fixed spheres for other elements.

    A driven module's sphere has a surface velocity. The tops of the spheres lie in the plane z = 0,
    and the direction of gravity represents the tilt, as in Section 6.1. If there are several
    parcels, each parcel has a belt, a thin shape at the height of its centre of mass. Only the
    belts of the parcels touch each other, as in the analytic model.

    Args:
        parcels: one parcel or several, built as prisms twice as high as their centres of mass.
        recipe: rotors and contact parameters.
        heights: (rows, columns) [m] heights of the elements' tops above the plane. None means 0.
        within: mask (rows, columns) of the elements to build. None means all. `reachable` returns
            the elements that a run can touch.
        sides: contact parameters between parcels.
        swivel: how axes turn during a run. None means that axes do not turn.
    """
    if abs(surface.tilt) > MAX_TILT + 1e-12:
        raise ValueError(
            f"tilt must be between -15 and 15 deg, where the recipe holds, "
            f"got {math.degrees(surface.tilt):g} deg"
        )
    shape = (surface.rows, surface.columns)
    top = np.zeros(shape) if heights is None else checks.array("heights", heights, shape)
    built = np.ones(shape, dtype=bool) if within is None else np.asarray(within, dtype=bool)
    if built.shape != shape:
        raise ValueError(f"within must have the shape {shape}, got {built.shape}")
    rotors, elements = int((built & surface.rotor).sum()), int(built.sum())
    if rotors > MAX_ROTORS or elements > MAX_ELEMENTS:
        raise ValueError(
            f"surface must have at most {MAX_ROTORS} rotors and {MAX_ELEMENTS} elements in reach "
            f"for MuJoCo's memory, got {rotors} and {elements}: make the surface smaller or the "
            f"run shorter"
        )
    mujoco = load_mujoco()
    spec = mujoco.MjSpec()
    _set_options(mujoco, spec, surface, recipe)
    parcels = [parcels] if isinstance(parcels, Parcel) else parcels
    bases = [f"{BASE}{k or ''}" for k in range(len(parcels))]
    belts = [f"belt{k}" for k in range(len(parcels))] if len(parcels) > 1 else []
    for k, parcel in enumerate(parcels):
        body = _add_parcel(mujoco, spec, parcel, bases[k])
        if belts:
            _add_belt(mujoco, spec, body, parcel, belts[k])
    for row, column in zip(*np.nonzero(built), strict=True):
        _add_element(mujoco, spec, surface, recipe, row, column, top[row, column], bases, swivel)
    for one, other in combinations(belts, 2):
        pair = spec.add_pair(geomname1=one, geomname2=other, condim=3)
        pair.friction = [sides.friction, sides.friction, 0.0, 0.0, 0.0]
        pair.solref = [-sides.stiffness, -sides.damping]
        pair.solreffriction = [-1e-9, -sides.creep_damping]
        pair.solimp = _constant_impedance(recipe.impedance)
    model = spec.compile()
    last = model.body_dofadr + model.body_dofnum - 1  # after the joint about which an axis turns
    dof = np.where(model.geom_bodyid > 0, last[model.geom_bodyid], -1)
    dof[np.isin(model.geom_bodyid, np.flatnonzero(model.body_dofnum == 6))] = -1
    return MujocoScene(model, dof.astype(np.int64))


def _set_options(mujoco: Any, spec: Any, surface: Surface, recipe: Recipe) -> None:
    option = spec.option
    option.timestep = recipe.step
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    # MuJoCo 4.0.0 factorises sparse Newton systems wrongly (fixed in 4.0.1, its issue 3767).
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = recipe.friction_stiffening
    option.tolerance = recipe.tolerance
    grid = surface.grid
    option.gravity = [grid.gravity_x, grid.gravity_y, -grid.gravity_normal]


def _add_parcel(mujoco: Any, spec: Any, parcel: Parcel, name: str) -> Any:
    """Add a parcel to the scene `spec` of the module `mujoco`, as a prism on the parcel's base.

    The prism has the parcel's inertia about the vertical. The other two inertias are computed for
    even density. These two inertias affect how fast the prism settles on the springs, but not the
    motion along the surface.
    """
    body = spec.worldbody.add_body()
    body.add_freejoint()
    vertical = parcel.moment_of_inertia
    level = 0.5 * vertical + parcel.mass * parcel.com_height**2 / 3.0
    body.explicitinertial = True
    body.mass = parcel.mass
    body.ipos = [*parcel.centre_of_mass, parcel.com_height]
    body.iquat = [1.0, 0.0, 0.0, 0.0]
    body.inertia = [level, level, vertical]
    height = max(2.0 * parcel.com_height, LEAST_BODY_HEIGHT)
    _add_prism(mujoco, spec, body, parcel.base, name, 0.0, height)
    return body


def _add_prism(
    mujoco: Any, spec: Any, body: Any, base: Base, name: str, low: float, height: float
) -> None:
    """Add a prism with the cross-section `base` to a MuJoCo body.

    The prism is between the heights `low` and `low + height` [m] in the body's frame. The prism
    touches only shapes that are paired with the prism.
    """
    half = 0.5 * height
    shape: dict[str, Any]
    if isinstance(base, Rectangle):
        shape = {
            "type": mujoco.mjtGeom.mjGEOM_BOX,
            "size": [base.length / 2.0, base.width / 2.0, half],
            "pos": [0.0, 0.0, low + half],
        }
    elif isinstance(base, Disc):
        shape = {
            "type": mujoco.mjtGeom.mjGEOM_CYLINDER,
            "size": [base.radius, half, 0.0],
            "pos": [0.0, 0.0, low + half],
        }
    else:
        corners = [[*corner, z] for z in (low, low + height) for corner in base.outline]
        spec.add_mesh(name=name, uservert=np.ravel(corners))
        shape = {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": name}
    body.add_geom(name=name, contype=0, conaffinity=0, **shape)


def _add_belt(mujoco: Any, spec: Any, body: Any, parcel: Parcel, name: str) -> None:
    """Add a belt at the height of the centre of mass. Parcels touch each other with their belts.

    The belt of a disc is a sphere whose equator is at this height. MuJoCo finds contacts of spheres
    exactly, but the normals of cylinders may be inexact.
    """
    if isinstance(parcel.base, Disc):
        body.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[parcel.base.radius, 0.0, 0.0],
            pos=[0.0, 0.0, parcel.com_height], contype=0, conaffinity=0,
        )  # fmt: skip
    else:
        low = parcel.com_height - 0.5 * BELT
        _add_prism(mujoco, spec, body, parcel.base, name, low, BELT)


def _add_element(
    mujoco: Any, spec: Any, surface: Surface, recipe: Recipe, row: int, column: int, top: float,
    bases: Sequence[str], swivel: Swivel | None,
) -> None:  # fmt: skip
    """Add a sphere with its top at `top` [m]. The sphere is an idle rotor, or it is fixed.

    An idle rotor turns about its axis. If `swivel` is not None, the axis can turn about the
    vertical. The sphere touches only the shapes with names in `bases`.
    """
    name = f"{row},{column}"
    place = [surface.x[column], surface.y[row], top - recipe.rotor_radius]
    sphere = {"name": name, "size": [recipe.rotor_radius, 0, 0], "contype": 0, "conaffinity": 0}
    if surface.driven[row, column]:
        assert surface.surface_velocity is not None
        velocity = [*surface.surface_velocity[row, column], 0.0, 0.0, 0.0, 0.0]
        spec.worldbody.add_geom(pos=place, surfacevel=velocity, **sphere)
        friction = surface.mu_max
    elif surface.rotor[row, column]:
        half_turn = 0.5 * surface.axis[row, column]
        rotor = spec.worldbody.add_body(
            name=name, pos=place, quat=[math.cos(half_turn), 0.0, 0.0, math.sin(half_turn)]
        )
        if swivel is not None:
            hinge = mujoco.mjtJoint.mjJNT_HINGE
            rotor.add_joint(type=hinge, axis=[0.0, 0.0, 1.0], armature=SWIVEL_ARMATURE)
        rotor.add_joint(
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=[1.0, 0.0, 0.0],
            solimp_friction=_constant_impedance(recipe.bearing_impedance),
        )
        rotor.explicitinertial = True
        rotor.mass = recipe.rotor_mass
        rotor.ipos = [0.0, 0.0, 0.0]
        rotor.iquat = [1.0, 0.0, 0.0, 0.0]
        across = recipe.rotor_cross_inertia
        rotor.inertia = [recipe.rotor_inertia, across, across]
        rotor.add_geom(**sphere)
        friction = surface.mu_max
    else:
        spec.worldbody.add_geom(pos=place, **sphere)
        friction = surface.mu_support
    ratio = surface.grid.stiffness[row, column]
    spin = 0.0  # [m] largest torque about the vertical over the load
    if swivel is not None and surface.rotor[row, column]:
        spin = 2.0 / 3.0 * float(friction) * swivel.patch
    for base in bases:
        pair = spec.add_pair(geomname1=name, geomname2=base, condim=4 if spin else 3)
        pair.friction = [friction, friction, spin, 0.0, 0.0]
        pair.solref = [-recipe.stiffness * ratio, -recipe.damping * math.sqrt(ratio)]
        # A held contact has no spring (zero would select the contact's own solref).
        pair.solreffriction = [-1e-9, -recipe.creep_damping]
        pair.solimp = _constant_impedance(recipe.impedance)


def _constant_impedance(impedance: float) -> list[float]:
    """Return MuJoCo's `solimp` for an impedance that does not depend on the penetration."""
    return [impedance, impedance, 0.001, 0.5, 2.0]


TIPPING = 1e-3  # [rad] tilt of the base; the contacts' springs yield by about 1e-5
# Friction between sides holds within one step, and impacts last 20 steps. Rotors have almost no
# inertia, since the analytic model has none.
TOGETHER_RECIPE = Recipe(step=1e-5).lighter_rotors(1000.0)


def simulate(
    surface: Surface,
    parcel: Parcel,
    pose: ArrayLike,
    velocity: ArrayLike = (0.0, 0.0, 0.0),
    duration: float = 1.0,
    recipe: Recipe = RECIPE,
    heights: ArrayLike | None = None,
) -> Trajectory:
    """Move a parcel over a surface. The first five arguments are as in `surface_gym.simulate`.

    `heights` (rows, columns) [m] are the heights of the elements' tops above the plane. If
    `heights` is None, all heights are 0. Only elements that the parcel can reach are built. The
    trajectory has one row per time step of the recipe. The trajectory's array `tipping` marks rows
    in which the base is tilted by more than 1 mrad.

    Raises:
        ValueError: an argument is not allowed, the start is off the surface, the step is too
            coarse for the springs under the base, or MuJoCo cannot build the scene (see `build`).
        RuntimeError: MuJoCo diverged; a smaller time step helps.
        ImportError: MuJoCo is not installed.
    """
    start = checks.array("pose", pose, (3,))
    motion = checks.array("velocity", velocity, (3,))
    duration = checks.positive("duration", duration)
    bearing = elements_under(surface, parcel, start)
    if not bearing.any() or not _is_over(surface, parcel, start[np.newaxis])[0]:
        raise ValueError(f"pose must be on the surface, got {tuple(start.tolist())}")
    stiffness = recipe.stiffness * surface.grid.stiffness[bearing]
    # The parcel bounces endlessly if the step is longer than the period of its springs.
    longest = 1.0 / math.sqrt(stiffness.sum())
    if recipe.step > longest:
        raise ValueError(
            f"recipe.step must be at most {longest:.1e} s on the {len(stiffness)} elements under "
            f"the base, got {recipe.step:g}"
        )
    within = reachable(surface, parcel, start, motion, duration)
    only = ([parcel], start[np.newaxis], motion[np.newaxis])
    return simulate_together(surface, *only, duration, within, recipe, heights=heights)[0]


def simulate_together(
    surface: Surface,
    parcels: Sequence[Parcel],
    poses: ArrayLike,
    velocities: ArrayLike,
    duration: float,
    within: Booleans,
    recipe: Recipe = TOGETHER_RECIPE,
    sides: Sides = SIDES,
    turns: Sequence[tuple[float, Array]] = (),
    heights: ArrayLike | None = None,
    swivel: Swivel | None = None,
) -> tuple[Trajectory, ...]:
    """Move several parcels with collisions, like `surface_gym.simulate_together`.

    Poses and velocities are (parcels, 3). `within` (rows, columns) selects the elements to build.
    `heights` (rows, columns) [m] are the elements' tops above the plane; None means 0. A pair in
    `turns` has a time [s] and axis angles (rows, columns) [rad]. At this time, all axes jump to
    these angles. `swivel` describes axes that turn gradually; None means no gradual turns.
    """
    start = checks.array("poses", poses, (len(parcels), 3))
    motion = checks.array("velocities", velocities, start.shape)
    duration = checks.positive("duration", duration)
    scene = build(surface, parcels, recipe, heights, within, sides, swivel)
    tops = np.zeros(within.shape) if heights is None else np.asarray(heights, dtype=np.float64)
    sags = []
    for parcel, pose in zip(parcels, start, strict=True):
        bearing = elements_under(surface, parcel, pose) & within
        stiffness = recipe.stiffness * surface.grid.stiffness[bearing]
        sags.append(static_sag(tops[bearing], stiffness, GRAVITY * math.cos(surface.tilt)))
    return _run(scene, surface, parcels, start, motion, sags, duration, recipe, turns, swivel)


def elements_under(surface: Surface, parcel: Parcel, pose: ArrayLike) -> Booleans:
    """Return a mask (rows, columns) of elements under the base. Section 3.2 has the condition."""
    x, y, theta = np.asarray(pose, dtype=np.float64)
    dx, dy = np.meshgrid(surface.x - x, surface.y - y)
    cosine, sine = math.cos(theta), math.sin(theta)
    outside = parcel.base.functions(cosine * dx + sine * dy, cosine * dy - sine * dx)
    return np.asarray(outside.max(axis=0) <= EDGE_TOLERANCE)


def reachable(
    surface: Surface, parcel: Parcel, pose: ArrayLike, velocity: ArrayLike, duration: float
) -> Booleans:
    """Find elements (rows, columns) that an unbraked parcel could reach in a duration [s]."""
    x, y, _ = np.asarray(pose, dtype=np.float64)
    vx, vy, omega = np.asarray(velocity, dtype=np.float64)
    arm = math.hypot(*parcel.centre_of_mass)
    gyration = parcel.moment_of_inertia / parcel.mass
    speed = math.hypot(math.hypot(vx, vy) + arm * abs(omega), omega * math.sqrt(gyration))
    downhill = GRAVITY * abs(math.sin(surface.tilt))
    if surface.surface_velocity is not None:
        speed += float(np.nan_to_num(np.abs(surface.surface_velocity)).max()) * math.sqrt(2.0)
    path = speed * duration + 0.5 * downhill * duration**2
    outline = parcel.base.outline
    base = float(np.hypot(outline[:, 0], outline[:, 1]).max())
    pitch = max(surface.pitch_x, surface.pitch_y)
    # Twice the arm: the frame may be one arm away from the centre of mass at both ends.
    distance = np.hypot(*np.meshgrid(surface.x - x, surface.y - y))
    return np.asarray(distance <= path + base + 2.0 * arm + pitch)


def static_sag(tops: Array, stiffness: Array, weight: float) -> float:
    """Return how far [m] a level base that rests on springs lies below a reference plane.

    `tops` (contacts,) [m] are the heights of the unloaded springs above this plane. `stiffness` and
    `weight` are divided by the mass.
    """
    highest_first = np.argsort(tops)[::-1]
    k = stiffness[highest_first]
    # Depths if only the highest few springs carry; the smallest depth is the solution.
    alone = (weight - np.cumsum(k * tops[highest_first])) / np.cumsum(k)
    return float(alone.min())


def normal_forces(data: Any) -> tuple[Integers, Array]:
    """Return the pairs (contacts, 2) of MuJoCo's geoms that touch, and their normal forces [N]."""
    contact = data.contact
    row = contact.efc_address
    touching = row >= 0
    return contact.geom[touching], data.efc_force[row[touching]]


def _run(
    scene: MujocoScene, surface: Surface, parcels: Sequence[Parcel], start: Array, motion: Array,
    sags: Sequence[float], duration: float, recipe: Recipe, turns: Sequence[tuple[float, Array]],
    swivel: Swivel | None,
) -> tuple[Trajectory, ...]:  # fmt: skip
    """Simulate the scene for `duration` [s], and return one trajectory per parcel.

    Parcels begin at poses `start` (parcels, 3) with velocities `motion` (parcels, 3), at the depths
    `sags` (parcels,) [m] below the plane. For `turns` and `swivel` see `simulate_together`.
    """
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
    # A bearing's friction is proportional to its rotor's load, which MuJoCo does not support.
    loss_per_newton = float(surface.mu_min) * recipe.rotor_radius
    turned = {round(when / recipe.step): axis for when, axis in turns}
    if swivel is not None:
        swivelling, apart = _find_swivels(scene, surface, swivel)
    for k in range(steps + 1):
        if k > 0:
            if k - 1 in turned:
                _turn_axes(scene, turned[k - 1])
            if k > whole:
                model.opt.timestep = rest
            if swivel is not None:  # what remains to turn, at most at the axes' speed
                done = max(0.0, data.time - swivel.start) * swivel.speed
                left = np.clip((np.abs(apart) - done) / recipe.step, 0.0, swivel.speed)
                data.qvel[swivelling] = np.sign(apart) * left * (data.time >= swivel.start)
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


def _find_rotors(scene: MujocoScene) -> dict[int, tuple[int, int]]:
    """Return each rotor's row and column by the index of the rotor's body in MuJoCo."""
    names = {k: scene.model.body(k).name.partition(",") for k in range(1, scene.model.nbody)}
    return {k: (int(row), int(column)) for k, (row, comma, column) in names.items() if comma}


def _turn_axes(scene: MujocoScene, axis: Array) -> None:
    """Turn the hinges of all rotors to the axes `axis` (rows, columns) [rad]."""
    for k, place in _find_rotors(scene).items():
        half_turn = 0.5 * axis[place]
        scene.model.body_quat[k] = math.cos(half_turn), 0.0, 0.0, math.sin(half_turn)


def _find_swivels(scene: MujocoScene, surface: Surface, swivel: Swivel) -> tuple[Integers, Array]:
    """Return indices (rotors,) of axes' degrees of freedom, and planned turns (rotors,) [rad]."""
    bodies = _find_rotors(scene)
    places = tuple(np.transpose(list(bodies.values())))
    apart = swivel.target[places] - surface.axis[places]
    return scene.model.body_dofadr[list(bodies)], apart - np.pi * np.floor(apart / np.pi + 0.5)


def _make_trajectory(
    surface: Surface, parcel: Parcel, theta: float, time: Array, place: Array, speed: Array
) -> Trajectory:
    """Make a parcel's trajectory in the plane, until the centre of mass leaves the surface.

    `place` (T, 7) and `speed` (T, 6) are from MuJoCo. `theta` [rad] is the angle at the start.
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


def _is_over(surface: Surface, parcel: Parcel, pose: Array) -> Booleans:
    """Return a mask (T,) of the poses (T, 3) at which the centre of mass is over the surface."""
    com_x, com_y = parcel.centre_of_mass
    cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
    x = pose[:, 0] + cosine * com_x - sine * com_y
    y = pose[:, 1] + sine * com_x + cosine * com_y
    # An element covers the square of one pitch around it.
    half_length = 0.5 * surface.pitch_x * surface.columns
    half_width = 0.5 * surface.pitch_y * surface.rows
    along = np.abs(x - surface.x.mean()) <= half_length
    return np.asarray(along & (np.abs(y - surface.y.mean()) <= half_width))
