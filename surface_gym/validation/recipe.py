"""How MuJoCo is set so that its contacts converge to Coulomb's on stiff springs."""

import math
from dataclasses import dataclass, fields, replace

from surface_gym import checks

MAX_TILT = math.radians(15.0)  # [rad] end of Table 5's range


@dataclass(frozen=True)
class Recipe:
    """The rotors of Table 5 and MuJoCo's contact parameters.

    MuJoCo's contact is a spring and damper behind an impedance d: with d near 0 the penetration
    sets the force, so that every contact has the same stiffness, as Eq. (1) assumes. With the
    defaults, d near 1, the friction cone lifts sliding contacts.

    Raises:
        ValueError: a value is not positive, or an impedance not one that MuJoCo can have.
    """

    step: float = 1e-4  # [s]
    # [1/s^2] of a contact / parcel mass; 3e6 N/m under 5.48 kg. The surface's own `stiffness`, a
    # ratio, multiplies it.
    stiffness: float = 5.474e5
    damping: float = 391.5  # [1/s] of a contact / parcel mass
    impedance: float = 1e-4  # [-] d of a contact, MuJoCo's least
    # [1/s] How fast a contact comes to hold: in impedance / creep_damping = 2 ms. A sliding one
    # carries mu creep_damping v more per unit mass, the rest of what lifts it.
    creep_damping: float = 0.05
    friction_stiffening: float = 1e5  # [-] MuJoCo's impratio
    bearing_impedance: float = 0.9999  # [-] d of a rotor's bearing friction
    tolerance: float = 1e-12  # [-] of the constraint solver
    rotor_radius: float = 0.01  # [m] Table 5
    rotor_mass: float = 8.61e-3  # [kg] Table 5
    rotor_inertia: float = 4.30e-7  # [kg m^2] about the axis, Table 5
    rotor_cross_inertia: float = 2.87e-7  # [kg m^2] across it; Table 5 prints e-2 for y, a misprint

    def __post_init__(self) -> None:
        for field in fields(self):
            value = checks.positive(field.name, getattr(self, field.name))
            object.__setattr__(self, field.name, value)
        for name in ("impedance", "bearing_impedance"):
            checks.within(name, getattr(self, name), 1e-4, 0.9999)

    def stiffer(self, factor: float) -> "Recipe":
        """The same with other contact stiffness and the same damping ratio."""
        return replace(
            self,
            stiffness=factor * self.stiffness,
            damping=math.sqrt(factor) * self.damping,
        )

    def finer(self, factor: float) -> "Recipe":
        """The same with the step divided."""
        return replace(self, step=self.step / factor)

    def lighter_rotors(self, factor: float) -> "Recipe":
        """The same with the rotors' inertia divided, which the model of Eq. (2)-(4) leaves out."""
        return replace(
            self,
            rotor_mass=self.rotor_mass / factor,
            rotor_inertia=self.rotor_inertia / factor,
            rotor_cross_inertia=self.rotor_cross_inertia / factor,
        )


RECIPE = Recipe()
