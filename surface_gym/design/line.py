"""A line of rotors amid supports, sized for a parcel."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.layouts import ROLLING, lead_in_under, rows_under
from surface_gym.parcel import Parcel
from surface_gym.surface import Pitched, Surface

RUN_OUT = 1.0  # [m] of rolling columns behind the zone, beyond the base's length


@dataclass(frozen=True)
class DesignLine(Pitched):
    """A line of rotors amid supports: a lead-in, a zone with task axes, and a run-out.

    Lead-in and run-out roll along x. The supports on either side bear a parcel that has left the
    line. The first column and the first row lie half a pitch from 0.

    Raises:
        ValueError: a count below 1, a pitch that is not positive, negative friction, `mu_min`
            greater than `mu_max`, or a number beyond `surface_gym.checks`.
    """

    rows: int  # of rotors
    columns: int  # of the zone
    lead_in: int  # columns before it
    run_out: int  # columns behind it
    beside: int  # rows of supports on either side
    pitch: float | tuple[float, float] = 0.1  # [m] between neighbours: one, or in x and in y
    mu_max: float = 0.5  # [-] friction along a rotor's axis
    mu_min: float = 0.01  # [-] friction across it
    mu_support: float = 0.005  # [-] friction of a support

    def __post_init__(self) -> None:
        for name in ("rows", "columns", "lead_in", "run_out", "beside"):
            checks.integer(name, getattr(self, name), least=1, most=checks.ELEMENTS)
        object.__setattr__(self, "pitch", checks.pitch("pitch", self.pitch))
        for name in ("mu_max", "mu_min", "mu_support"):
            mu = checks.not_negative(name, getattr(self, name), checks.FRICTION)
            object.__setattr__(self, name, mu)
        checks.rolling(self.mu_max, self.mu_min)
        if math.prod(self.shape) > checks.ELEMENTS:
            raise ValueError(
                f"rows times columns must be at most {checks.ELEMENTS:_}, got {self.shape}"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the whole surface."""
        return self.rows + 2 * self.beside, self.lead_in + self.columns + self.run_out

    @property
    def line_y(self) -> float:
        """Middle of the line [m]."""
        return 0.5 * self.pitch_y * self.shape[0]

    @property
    def zone_x(self) -> tuple[float, float]:
        """Start and end of the zone [m], half a pitch before and behind its columns."""
        first = self.pitch_x * self.lead_in
        return first, first + self.pitch_x * self.columns

    @property
    def zone(self) -> tuple[slice, slice]:
        """Slices of the surface's rows and columns that form the zone."""
        return (
            slice(self.beside, self.beside + self.rows),
            slice(self.lead_in, self.lead_in + self.columns),
        )

    @cached_property
    def rotor(self) -> NDArray[np.bool_]:
        """Mask (rows, columns) of the rotors; all other elements are supports."""
        rotor = np.zeros(self.shape, dtype=np.bool_)
        rotor[self.beside : self.beside + self.rows] = True
        return rotor

    def axes(self, zone_axis: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the surface's axes (..., rows, columns) [rad] for zone axes of that form."""
        axis = np.full((*zone_axis.shape[:-2], *self.shape), ROLLING)
        axis[(..., *self.zone)] = zone_axis
        return axis

    def surface(self, zone_axis: NDArray[np.float64], tilt: float = 0.0) -> Surface:
        """Build the surface for `simulate` from zone axes (rows, columns) [rad].

        Raises:
            ValueError: axes of another shape, or a tilt that is not allowed.
        """
        axis = checks.array("zone_axis", zone_axis, (self.rows, self.columns))
        origin = (0.5 * self.pitch_x, 0.5 * self.pitch_y)
        return Surface(
            self.axes(axis), self.rotor, self.pitch, origin,
            self.mu_max, self.mu_min, self.mu_support, tilt,
        )  # fmt: skip

    def start(self, parcel: Parcel) -> tuple[float, float, float]:
        """Return the pose (x, y, theta) [m, m, rad] of a parcel whose rear is at x = 0."""
        return (parcel.rear, self.line_y - parcel.base.centroid[1], 0.0)


def line_for(
    parcel: Parcel,
    columns: int,
    rows: int | None = None,
    pitch: float | tuple[float, float] = 0.1,
    mu_max: float = 0.5,
    mu_min: float = 0.01,
    mu_support: float = 0.005,
) -> DesignLine:
    """Size a line for a parcel by the rule that the study's two boxes follow.

    The rows of rotors are the greatest even number that lies under the parcel. The lead-in is as
    long as the parcel, which therefore starts wholly on it.

    Args:
        parcel: the largest that runs on the line.
        columns: number of columns in the zone.
        rows: number of rows of rotors; None: by the rule.
        pitch: [m] between neighbours: one, or in x and in y.
        mu_max: [-] friction along a rotor's axis.
        mu_min: [-] friction across it.
        mu_support: [-] friction of a support.

    >>> from surface_gym import layouts
    >>> [(line.rows, line.lead_in) for line in (line_for(layouts.box(size), 8) for size in "SB")]
    [(2, 3), (4, 5)]
    """
    pitch = checks.pitch("pitch", pitch)
    pitch_x, pitch_y = pitch if isinstance(pitch, tuple) else (pitch, pitch)
    length, width = np.ptp(parcel.base.outline, axis=0).tolist()
    lead_in = lead_in_under(length, pitch_x)
    reach = 2.0 * parcel.base.reach
    return DesignLine(
        rows=rows_under(width, pitch_y) if rows is None else rows,
        columns=columns,
        lead_in=lead_in,
        run_out=lead_in + math.ceil(RUN_OUT / pitch_x),
        beside=math.ceil(reach / pitch_y) + 2,
        pitch=pitch,
        mu_max=mu_max,
        mu_min=mu_min,
        mu_support=mu_support,
    )
