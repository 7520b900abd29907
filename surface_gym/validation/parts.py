"""Parcels and elements as parts of a MuJoCo model."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from surface_gym.parcel import Base, Disc, Parcel, Rectangle
from surface_gym.surface import Surface
from surface_gym.validation.recipe import Recipe

BASE = "base"
BELT = 0.01  # [m] of a parcel's height, around its centre of mass, at which its sides touch
LEAST_BODY_HEIGHT = 0.02  # [m] of the parcel's shape; only its underside touches anything


def add_parcel(mujoco: Any, spec: Any, parcel: Parcel, name: str) -> Any:
    """A prism on its base. Only its vertical inertia is the parcel's; the others steer how fast
    it settles, not where it goes, and are those of a prism of even density.
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
    """A shape of a body that touches what it is paired with alone."""
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


def add_belt(mujoco: Any, spec: Any, body: Any, parcel: Parcel, name: str) -> None:
    """What touches other parcels. A disc has a sphere, whose equator is at that height and whose
    contacts MuJoCo finds to the last digit, where a cylinder's normals may be off.
    """
    if isinstance(parcel.base, Disc):
        body.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[parcel.base.radius, 0.0, 0.0],
            pos=[0.0, 0.0, parcel.com_height],
            contype=0,
            conaffinity=0,
        )
    else:
        low = parcel.com_height - 0.5 * BELT
        _add_prism(mujoco, spec, body, parcel.base, name, low, BELT)


def add_element(
    mujoco: Any,
    spec: Any,
    surface: Surface,
    recipe: Recipe,
    row: int,
    column: int,
    top: float,
    bases: Sequence[str],
) -> None:
    """A sphere, on a hinge along the rotor's axis or fixed, that touches the bases alone."""
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
            solimp_friction=constant_impedance(recipe.bearing_impedance),
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
    ratio = surface.grid.stiffness[row, column]
    for base in bases:
        pair = spec.add_pair(geomname1=name, geomname2=base, condim=3)
        pair.friction = [friction, friction, 0.0, 0.0, 0.0]
        pair.solref = [-recipe.stiffness * ratio, -recipe.damping * math.sqrt(ratio)]
        # A held contact has no spring (zero would select the contact's own solref).
        pair.solreffriction = [-1e-9, -recipe.creep_damping]
        pair.solimp = constant_impedance(recipe.impedance)


def constant_impedance(impedance: float) -> list[float]:
    """MuJoCo's solimp of an impedance that does not depend on the penetration."""
    return [impedance, impedance, 0.001, 0.5, 2.0]
