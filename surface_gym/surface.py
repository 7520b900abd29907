"""A smart surface: a grid of orientable rotors and low-friction supports."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np

from surface_gym import checks
from surface_gym.physics.step import axis_directions, split_gravity
from surface_gym.physics.types import Array, Booleans, Grid, check_capacity


class ElementGrid:
    """Base class of objects on a grid with a pitch."""

    pitch: float | tuple[float, float]  # [m] between neighbours: one, or in x and in y

    @property
    def pitch_x(self) -> float:
        """Return the distance [m] from column to column."""
        return self.pitch if isinstance(self.pitch, float) else self.pitch[0]

    @property
    def pitch_y(self) -> float:
        """Return the distance [m] from row to row."""
        return self.pitch if isinstance(self.pitch, float) else self.pitch[1]

    def check_capacity(self, base: Any, size: tuple[int, int]) -> None:
        """Raise a ValueError if a base has too many edges, or may touch too many elements.

        `size` is the surface's number of columns and number of rows.
        """
        check_capacity(len(base.edges), base.reach, (self.pitch_x, self.pitch_y), size)


class Elements(ElementGrid, ABC):
    """Elements on a grid; base class of surfaces and lines."""

    # [-] friction along a rotor's axis, across it, and of a support: one number or an array
    mu_max: Any
    mu_min: Any
    mu_support: Any

    @property
    @abstractmethod
    def rows(self) -> int:
        """Return the number of elements in y."""

    @property
    @abstractmethod
    def columns(self) -> int:
        """Return the number of elements in x."""

    @cached_property
    def friction(self) -> Array:
        """Friction (rows, columns, 3) [-] along and across a rotor's axis, and on a support."""
        each = (self.mu_max, self.mu_min, self.mu_support)
        grid = [np.broadcast_to(np.asarray(mu), (self.rows, self.columns)) for mu in each]
        return np.stack(grid, axis=-1)


@dataclass(frozen=True, eq=False)
class Surface(Elements):
    """Rotors and supports on a grid, level or tilted.

    A rotor drags along its axis (`mu_max`) and rolls almost freely across it (`mu_min`), Eq. (2). A
    friction coefficient is one number, or an array (rows, columns) with one value per element.
    Defaults are from Table 1. Arrays are copied and become read-only.

    Raises:
        ValueError: an array is empty, not finite, or has another shape than `axis`; `pitch` is not
            positive; a friction coefficient is negative; `mu_min` is greater than `mu_max`; the
            tilt is not below 45 deg; the tilt's direction exceeds a full turn; `surface_velocity`
            is given for a support; or a number is outside the limits of `surface_gym.checks`.

    >>> import numpy as np
    >>> surface = Surface(axis=np.full((20, 30), np.pi / 2), rotor=np.ones((20, 30), bool))
    >>> surface.rows, surface.columns
    (20, 30)
    """

    axis: Array  # (rows, columns) [rad] rotor axis from x, anti-clockwise
    rotor: Booleans  # (rows, columns) an orientable rotor, else a support
    pitch: float | tuple[float, float] = 0.1  # [m] between neighbours: one, or in x and in y
    origin: tuple[float, float] = (0.05, 0.05)  # [m] centre of element [0, 0]
    mu_max: float | Array = 0.5  # [-] friction along a rotor's axis
    mu_min: float | Array = 0.01  # [-] friction across it
    mu_support: float | Array = 0.005  # [-] friction of a support, against the motion
    tilt: float = 0.0  # [rad] gamma, downhill towards `tilt_direction`
    # (rows, columns) [-] relative stiffness of each element; None: equal, as in Eq. (1)
    stiffness: Array | None = None
    tilt_direction: float = 0.0  # [rad] downhill direction, anti-clockwise from +x
    # (rows, columns, 2) [m/s] velocity in x and y of the surfaces of driven modules, which grip
    # alike in all directions; NaN: an idle rotor or a support; None: no module is driven
    surface_velocity: Array | None = None

    def __post_init__(self) -> None:
        axis = checks.array("axis", self.axis, (None, None))
        checks.angles("axis", axis)
        if axis.size == 0:
            raise ValueError(f"axis must have at least one row and one column, got {axis.shape}")
        rotor = checks.booleans("rotor", self.rotor)
        if rotor.shape != axis.shape:
            raise ValueError(f"rotor must have the shape of axis, {axis.shape}, got {rotor.shape}")
        if self.stiffness is not None:
            checks.settle(self, stiffness=(checks.array, axis.shape))
            _check_stiffness(self.stiffness)
        checks.set_fields(self, axis=axis, rotor=rotor)
        checks.settle(self, pitch=checks.pitch, origin=checks.place)
        for name in ("mu_max", "mu_min", "mu_support"):
            mu = checks.friction(name, getattr(self, name), axis.shape)
            checks.set_fields(self, **{name: mu if mu.ndim else float(mu)})
        checks.rolling(self.mu_max, self.mu_min)
        tilt = checks.number("tilt", self.tilt)
        if not abs(tilt) < math.pi / 4:
            raise ValueError(
                f"tilt must be between -pi/4 and pi/4 (45 deg), got {self.tilt!r}; {checks.DEGREES}"
            )
        checks.settle(self, tilt=checks.number, tilt_direction=checks.angle)
        if self.surface_velocity is not None:
            drive = _checked_drive(self.surface_velocity, rotor)
            checks.set_fields(self, surface_velocity=drive)

    def __reduce__(self) -> tuple[Any, ...]:
        """Let `pickle` and `copy` call the constructor, which makes the arrays read-only again."""
        return (type(self), tuple(getattr(self, field.name) for field in fields(self)))

    @property
    def rows(self) -> int:
        return int(self.axis.shape[0])

    @property
    def columns(self) -> int:
        return int(self.axis.shape[1])

    @property
    def x(self) -> Array:
        """Return x [m] of each column's centre (columns,)."""
        return self.origin[0] + self.pitch_x * np.arange(self.columns, dtype=np.float64)

    @property
    def y(self) -> Array:
        """Return y [m] of each row's centre (rows,)."""
        return self.origin[1] + self.pitch_y * np.arange(self.rows, dtype=np.float64)

    @cached_property
    def driven(self) -> Booleans:
        """Return a mask (rows, columns) of the driven modules."""
        if self.surface_velocity is None:
            return np.zeros(self.axis.shape, dtype=bool)
        return ~np.isnan(self.surface_velocity[..., 0])

    @cached_property
    def grid(self) -> Grid:
        """Return the surface as input of the compiled physics."""
        gravity_x, gravity_y, gravity_normal = split_gravity(self.tilt, self.tilt_direction)
        direction, drive = axis_directions(self.axis.ravel()), np.zeros((self.axis.size, 3))
        driven = self.driven.ravel()
        if self.surface_velocity is not None:  # axes of driven modules have no effect
            direction[driven] = 1.0, 0.0
            drive[driven, :2] = self.surface_velocity.reshape(-1, 2)[driven]
            drive[driven, 2] = 1.0
        return Grid(
            axis=np.arange(self.axis.size, dtype=np.int32).reshape(self.axis.shape),
            direction=direction,
            drive=drive,
            rotor=np.array(self.rotor),
            stiffness=np.ones(self.axis.shape) if self.stiffness is None else self.stiffness.copy(),
            friction=self.friction.copy(),
            x0=self.origin[0],
            y0=self.origin[1],
            pitch_x=self.pitch_x,
            pitch_y=self.pitch_y,
            along_factor=1.0,
            across_factor=1.0,
            support_factor=1.0,
            gravity_x=gravity_x,
            gravity_y=gravity_y,
            gravity_normal=gravity_normal,
        )


def _checked_drive(value: Any, rotor: Booleans) -> Array:
    """Return the velocities (rows, columns, 2) [m/s] of driven modules, or raise a ValueError.

    Other elements have NaN. Only elements that are true in `rotor` (rows, columns) may be driven.
    """
    drive = np.array(value, dtype=np.float64)
    if drive.shape != (*rotor.shape, 2):
        raise ValueError(
            f"surface_velocity must have the shape {(*rotor.shape, 2)}, got {drive.shape}"
        )
    idle = np.isnan(drive)
    if (idle[..., 0] != idle[..., 1]).any() or (~idle[..., 0] & ~rotor).any():
        raise ValueError(
            "surface_velocity must be two numbers for a driven module, which is among the rotors, "
            f"and NaN for all others, got {value!r}"
        )
    if not (np.abs(drive[~idle]) <= checks.SPEED).all():
        raise ValueError(f"surface_velocity must be at most {checks.SPEED:g} m/s, got {value!r}")
    return drive


def _check_stiffness(stiffness: Array) -> None:
    """Raise a ValueError if a stiffness or a ratio of two stiffnesses is not allowed."""
    least, most = float(stiffness.min()), float(stiffness.max())
    for value in (least, most):
        checks.positive("stiffness", value, *checks.STIFFNESS)
    if most / least > checks.STIFFNESS_RATIO:
        raise ValueError(
            f"stiffness must differ by a factor of at most {checks.STIFFNESS_RATIO:g}, "
            f"got {least:g} and {most:g} in it"
        )
