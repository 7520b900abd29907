"""What a driver of a machine offers to the control loop: a handful of calls, none of which waits.

All times are [s] by `time.monotonic()` of the machine that the loop runs on; a driver whose camera
has a clock of its own converts. All poses are those of the centroid of a parcel's base.
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from surface_gym.parcel import Parcel

Angles = NDArray[np.float64]  # (rows, columns) [rad] of the zone's modules, row by row from y < 0
Triple = tuple[float, float, float]


class DeviceLost(ConnectionError):
    """The device is not there, or what it says cannot be understood: connect anew."""


@dataclass(frozen=True, eq=False)
class Entered:
    """A parcel enters."""

    number: int  # of the parcel: each has another
    at: float  # [s] when pose and velocity were so
    parcel: Parcel  # its base, as a scale or a picture tells; its load taken as evenly spread
    pose: Triple  # [m, m, rad] about, by the conveyor and its guides
    velocity: Triple  # [m/s, m/s, rad/s] about
    goal: tuple[float, ...]  # what is asked, as the task's starts have it
    tilt: float = 0.0  # [rad] of the surface
    path: NDArray[np.float64] | None = None  # (PATH_POINTS,) [m] y of a path to follow


@dataclass(frozen=True, eq=False)
class Frame:
    """What the camera saw."""

    taken: float  # [s] when it looked
    number: int | None = None  # of the parcel seen; None: there is none on the surface
    pose: Triple = (0.0, 0.0, 0.0)  # [m, m, rad]; the angle is continuous beyond pi
    axes: Angles | None = None  # as encoders tell at that time; None: there are none


@dataclass(frozen=True)
class AxesTaken:
    """The device has taken axes to turn to."""

    command: int  # the number that `set_axes` returned
    at: float  # [s] when the axes began to turn
    refused: str = ""  # why the device did not take them; empty: it did


@dataclass(frozen=True)
class Left:
    """A parcel is gone."""

    number: int  # of the parcel
    outcome: str  # how it went, in words; "success" is one
    figures: dict[str, float] = field(default_factory=dict)  # of the task, as `info` has them


Message = Entered | Frame | AxesTaken | Left


class Device(Protocol):
    """A machine: a camera over a surface whose axes turn.

    Each call returns at once. What goes wrong for good is a `DeviceLost`, after which the loop
    calls `close` and, after a while, `connect` again.
    """

    def connect(self) -> None:
        """Find the device and begin anew.

        Raises:
            DeviceLost: it is not there.
        """

    def close(self) -> None:
        """Let go of it; also where it is not connected."""

    def read(self) -> list[Message]:
        """All that has come since the last call, in the order in which it came.

        Raises:
            DeviceLost: it is gone.
        """

    def set_axes(self, angles: Angles) -> int:
        """Have the zone's modules turn to angles (rows, columns) [rad] in -pi/2 to pi/2.

        The zone is the widest there is; what is said of a place without a module does nothing.

        Returns:
            A number for the command, which an `AxesTaken` may tell of later.

        Raises:
            DeviceLost: it is gone.
        """
