"""The scene of Tables 5 and 6 in MuJoCo, for any surface and parcel."""

import math
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surface_gym import checks
from surface_gym.bases import Disc, Rectangle
from surface_gym.dynamics.types import GRAVITY
from surface_gym.parcel import Parcel
from surface_gym.surface import Surface
from surface_gym.validation.recipe import MAX_TILT, RECIPE, Recipe

# MuJoCo reserves memory with the square of the degrees of freedom: 0.9 GB for this many.
MAX_ROTORS = 4_000
MAX_ELEMENTS = 40_000
BASE = "base"
LEAST_BODY_HEIGHT = 0.02  # [m] of the parcel's shape; only its underside touches anything


@dataclass(frozen=True, eq=False)
class Scene:
    """A compiled MuJoCo model of a parcel on a surface, and who is who in it.

    The parcel's free joint comes first, so qpos[:7] and qvel[:6] are its base frame's.
    """

    model: Any  # mujoco.MjModel
    base_geom: int  # the parcel's shape
    rotor_dof: NDArray[np.int64]  # (geoms,) degree of freedom of the rotor, -1 for others


def load_mujoco() -> ModuleType:
    """The mujoco package, imported when it is needed.

    Raises:
        ImportError: it is not installed; the message says how to.
    """
    try:
        import mujoco
    except ImportError as error:
        raise ImportError(
            f"the validation needs MuJoCo ({error}): pip install 'surface_gym[validation]'"
        ) from None
    return mujoco


def build(
    surface: Surface,
    parcel: Parcel,
    recipe: Recipe = RECIPE,
    heights: ArrayLike | None = None,
    within: NDArray[np.bool_] | None = None,
) -> Scene:
    """Build a parcel, a hinged sphere for each rotor and a fixed sphere for each support.

    The tops of the spheres lie in the plane z = 0 and the surface's tilt is in the direction of
    gravity, as in Section 6.1.

    Args:
        surface: the surface.
        parcel: the parcel; a prism twice as high as its centre of mass.
        recipe: rotors and contact parameters.
        heights: (rows, columns) [m] of the tops of the elements above the plane; None: flat.
        within: (rows, columns) the elements to build; None: all. `reachable` gives those that a
            run can touch.

    Raises:
        ValueError: the tilt is beyond the recipe, there are more elements than MuJoCo can hold in
            memory, or an array has another shape.
        ImportError: MuJoCo is not installed.
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
    _add_parcel(mujoco, spec, parcel)
    for row, column in zip(*np.nonzero(built), strict=True):
        _add_element(mujoco, spec, surface, recipe, row, column, top[row, column])
    model = spec.compile()
    base_geom = model.geom(BASE).id
    dof = np.where(model.geom_bodyid > 0, model.body_dofadr[model.geom_bodyid], -1)
    dof[base_geom] = -1
    return Scene(model, base_geom, dof.astype(np.int64))


def _set_options(mujoco: Any, spec: Any, surface: Surface, recipe: Recipe) -> None:
    option = spec.option
    option.timestep = recipe.step
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    # MuJoCo 4.0.0 factorises sparse Newton systems wrongly (mended in 4.0.1, its issue 3767).
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = recipe.friction_stiffening
    option.tolerance = recipe.tolerance
    option.gravity = [
        GRAVITY * math.sin(surface.tilt),
        0.0,
        -GRAVITY * math.cos(surface.tilt),
    ]


def _add_parcel(mujoco: Any, spec: Any, parcel: Parcel) -> None:
    """A prism on its base. Only its vertical inertia is the parcel's; the others steer how fast
    it settles, not where it goes, and are those of a prism of even density.
    """
    body = spec.worldbody.add_body(name="parcel")
    body.add_freejoint()
    vertical = parcel.moment_of_inertia
    level = 0.5 * vertical + parcel.mass * parcel.com_height**2 / 3.0
    body.explicitinertial = True
    body.mass = parcel.mass
    body.ipos = [*parcel.centre_of_mass, parcel.com_height]
    body.iquat = [1.0, 0.0, 0.0, 0.0]
    body.inertia = [level, level, vertical]
    height = max(2.0 * parcel.com_height, LEAST_BODY_HEIGHT)
    half, base = 0.5 * height, parcel.base
    shape: dict[str, Any]
    if isinstance(base, Rectangle):
        shape = {
            "type": mujoco.mjtGeom.mjGEOM_BOX,
            "size": [base.length / 2.0, base.width / 2.0, half],
            "pos": [0.0, 0.0, half],
        }
    elif isinstance(base, Disc):
        shape = {
            "type": mujoco.mjtGeom.mjGEOM_CYLINDER,
            "size": [base.radius, half, 0.0],
            "pos": [0.0, 0.0, half],
        }
    else:
        corners = [[*corner, z] for z in (0.0, height) for corner in base.outline]
        spec.add_mesh(name=BASE, uservert=np.ravel(corners))
        shape = {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": BASE}
    body.add_geom(name=BASE, contype=0, conaffinity=0, **shape)


def _add_element(
    mujoco: Any, spec: Any, surface: Surface, recipe: Recipe, row: int, column: int, top: float
) -> None:
    """A sphere, on a hinge along the rotor's axis or fixed, that touches the base alone."""
    name = f"{row},{column}"
    place = [surface.x[column], surface.y[row], top - recipe.rotor_radius]
    sphere = {"name": name, "size": [recipe.rotor_radius, 0, 0], "contype": 0, "conaffinity": 0}
    if surface.rotor[row, column]:
        half_turn = 0.5 * surface.axis[row, column]
        rotor = spec.worldbody.add_body(
            name=name, pos=place, quat=[math.cos(half_turn), 0.0, 0.0, math.sin(half_turn)]
        )
        rotor.add_joint(
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=[1.0, 0.0, 0.0],
            solimp_friction=_constant(recipe.bearing_impedance),
        )
        rotor.explicitinertial = True
        rotor.mass = recipe.rotor_mass
        rotor.ipos = [0.0, 0.0, 0.0]
        rotor.iquat = [1.0, 0.0, 0.0, 0.0]
        rotor.inertia = [
            recipe.rotor_inertia,
            recipe.rotor_cross_inertia,
            recipe.rotor_cross_inertia,
        ]
        rotor.add_geom(**sphere)
        friction = surface.mu_max
    else:
        spec.worldbody.add_geom(pos=place, **sphere)
        friction = surface.mu_support
    pair = spec.add_pair(geomname1=name, geomname2=BASE, condim=3)
    pair.friction = [friction, friction, 0.0, 0.0, 0.0]
    ratio = surface.grid.stiffness[row, column]
    pair.solref = [-recipe.stiffness * ratio, -recipe.damping * math.sqrt(ratio)]
    # A held contact has no spring (zero would select the contact's own solref).
    pair.solreffriction = [-1e-9, -recipe.creep_damping]
    pair.solimp = _constant(recipe.impedance)


def _constant(impedance: float) -> list[float]:
    """MuJoCo's solimp of an impedance that does not depend on the penetration."""
    return [impedance, impedance, 0.001, 0.5, 2.0]
