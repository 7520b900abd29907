"""A parcel: a rigid body with a flat base."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from surface_gym import bounds, checks
from surface_gym.bases import Base, check_base
from surface_gym.dynamics.types import Body


@dataclass(frozen=True)
class Parcel:
    """A rigid parcel. Its pose is its base frame's; the defaults are those of Table 1.

    Raises:
        ValueError: a mass, height or inertia that is not allowed, a base that is none, or a
            centre of mass that is not over the base, or a number beyond `surface_gym.bounds`.

    >>> from surface_gym import Rectangle
    >>> round(Parcel(Rectangle(0.25, 0.25)).moment_of_inertia, 4)  # m (b^2 + h^2) / 12
    0.1042
    """

    base: Base
    mass: float = 10.0  # [kg]
    com_height: float = 0.1  # [m] z_g, centre of mass above the base
    inertia: float | None = None  # [kg m^2] about the vertical through the centre of mass
    com_offset: tuple[float, float] = (0.0, 0.0)  # [m] centre of mass from the base's centroid

    def __post_init__(self) -> None:
        check_base(self.base)
        set_field = object.__setattr__
        set_field(self, "mass", checks.positive("mass", self.mass, *bounds.MASS))
        height = checks.not_negative("com_height", self.com_height, bounds.COM_HEIGHT)
        set_field(self, "com_height", height)
        if self.inertia is not None:
            least, most = (self.mass * (part * self.base.reach) ** 2 for part in bounds.GYRATION)
            set_field(self, "inertia", checks.positive("inertia", self.inertia, least, most))
        x, y = checks.place("com_offset", self.com_offset)
        set_field(self, "com_offset", (x, y))
        if self.base.functions(*self.centre_of_mass).max() > 0.0:
            raise ValueError(f"com_offset must keep the centre of mass over the base, got {(x, y)}")

    @cached_property
    def centre_of_mass(self) -> tuple[float, float]:
        """[m] its projection on the base, in the base's frame."""
        x, y = self.base.centroid
        return (x + self.com_offset[0], y + self.com_offset[1])

    @cached_property
    def rear(self) -> float:
        """[m] from the rearmost point of the base to its frame's origin, at theta = 0."""
        return -float(self.base.outline[:, 0].min())

    @property
    def moment_of_inertia(self) -> float:
        """[kg m^2] J; where none is given, that of a load spread evenly over the base."""
        return self.mass * self.base.gyration if self.inertia is None else self.inertia

    @cached_property
    def body(self) -> Body:
        """The parcel as the compiled physics reads it."""
        return Body(
            edges=np.asarray(self.base.edges, dtype=np.float64),
            radius=self.base.reach,
            com_x=self.com_offset[0],
            com_y=self.com_offset[1],
            com_height=self.com_height,
            gyration=self.base.gyration if self.inertia is None else self.inertia / self.mass,
        )
