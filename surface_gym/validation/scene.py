"""The scene of Tables 5 and 6 in MuJoCo, for any surface and parcel."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surface_gym import checks
from surface_gym.parcel import Parcel
from surface_gym.physics.types import GRAVITY
from surface_gym.surface import Surface
from surface_gym.validation.parts import BASE, add_belt, add_element, add_parcel, constant_impedance
from surface_gym.validation.recipe import MAX_TILT, RECIPE, Recipe
from surface_gym.validation.sides import Sides

# MuJoCo reserves memory with the square of the degrees of freedom: 0.9 GB for this many.
MAX_ROTORS = 4_000
MAX_ELEMENTS = 40_000


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
    mujoco, spec, top, built = _begin(surface, recipe, heights, within)
    add_parcel(mujoco, spec, parcel, BASE)
    for row, column in zip(*np.nonzero(built), strict=True):
        add_element(mujoco, spec, surface, recipe, row, column, top[row, column], (BASE,))
    return _compile(spec)


def build_together(
    surface: Surface, parcels: Sequence[Parcel], recipe: Recipe, sides: Sides, within: ArrayLike
) -> Scene:
    """Build parcels that push each other by belts at the height of their centres of mass, where
    the analytic model has them do so; the free joint of each comes after those before it.

    Args:
        surface: the surface.
        parcels: the parcels; prisms twice as high as their centres of mass.
        recipe: rotors and contact parameters.
        sides: contact parameters between parcels.
        within: (rows, columns) the elements to build.

    Raises:
        ValueError: as `build`.
        ImportError: MuJoCo is not installed.
    """
    mujoco, spec, top, built = _begin(surface, recipe, None, within)
    bases = tuple(f"{BASE}{k or ''}" for k in range(len(parcels)))
    belts = tuple(f"belt{k}" for k in range(len(parcels)))
    for parcel, base, belt in zip(parcels, bases, belts, strict=True):
        body = add_parcel(mujoco, spec, parcel, base)
        add_belt(mujoco, spec, body, parcel, belt)
    for row, column in zip(*np.nonzero(built), strict=True):
        add_element(mujoco, spec, surface, recipe, row, column, top[row, column], bases)
    for one, other in combinations(belts, 2):
        pair = spec.add_pair(geomname1=one, geomname2=other, condim=3)
        pair.friction = [sides.friction, sides.friction, 0.0, 0.0, 0.0]
        pair.solref = [-sides.stiffness, -sides.damping]
        pair.solreffriction = [-1e-9, -sides.creep_damping]
        pair.solimp = constant_impedance(recipe.impedance)
    return _compile(spec)


def _begin(
    surface: Surface, recipe: Recipe, heights: ArrayLike | None, within: ArrayLike | None
) -> tuple[ModuleType, Any, NDArray[np.float64], NDArray[np.bool_]]:
    """MuJoCo, a model with its options set, the tops of the elements and which are to be built."""
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
    return mujoco, spec, top, built


def _compile(spec: Any) -> Scene:
    model = spec.compile()
    base_geom = model.geom(BASE).id
    dof = np.where(model.geom_bodyid > 0, model.body_dofadr[model.geom_bodyid], -1)
    dof[np.isin(model.geom_bodyid, np.flatnonzero(model.body_dofnum == 6))] = -1
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
