"""How MuJoCo is set so that the sides of parcels hit each other without rebound."""

from dataclasses import dataclass, fields, replace

from surface_gym import checks


@dataclass(frozen=True)
class Sides:
    """MuJoCo's contact parameters between the sides of parcels.

    Springs behind the recipe's low impedance, as under the base, but damped so much that what has
    hit stays: the damper stops a closing speed v within 1 / damping, the sides then v / damping
    deep in each other, and the spring pushes them out at v stiffness / damping^2.

    Raises:
        ValueError: a value is not positive, or the friction negative.
    """

    stiffness: float = 1e5  # [1/s^2] of a contact / effective mass
    damping: float = 5e3  # [1/s] of a contact / effective mass
    creep_damping: float = 2.5  # [1/s] sides come to hold in impedance / creep_damping = 0.04 ms
    friction: float = 0.3  # [-]

    def __post_init__(self) -> None:
        for field in fields(self):
            allowed = checks.not_negative if field.name == "friction" else checks.positive
            object.__setattr__(self, field.name, allowed(field.name, getattr(self, field.name)))

    def harder(self, factor: float) -> "Sides":
        """The same, with what has hit stopped in a shorter time."""
        return replace(
            self,
            stiffness=factor * self.stiffness,
            damping=factor * self.damping,
            creep_damping=factor * self.creep_damping,
        )


SIDES = Sides()
