"""The motion a parcel should have: what local rules hold the motion above each module against."""

import numpy as np
from numpy.typing import NDArray

from ..sight import LineSight, PathSight
from .modules import Motion

# Found by trying, on other starts than any reported.
ASIDE = 5.0  # [m/s] to the side where Sort wants the parcel off: more than there ever is
CENTRING = 2.0  # [1/s] speed back to the line's middle per offset from it
STRAIGHTENING = 4.0  # [1/s] turning speed back to theta = 0 per angle off it
CROSSING = 16.0  # [1/s] speed back to a path per error across it
TURNING = 16.0  # [1/s] turning speed per angle left, near the asked angle
# [m rad/s^2] that a turn is planned to be slowed by, times the half length: less than half of what
# 90 deg everywhere does, so that a period too late is not too late.
END_OF_TURN = 1.0
CLOSE_ENOUGH = 0.025  # [rad] off the asked angle, where 0.035 is allowed: nothing left to turn


def wholly_in_zone(see: LineSight) -> NDArray[np.bool_]:
    """(lanes,) no module of the lead-in bears: its last is centred half a pitch before the zone."""
    inside: NDArray[np.bool_] = see.into_zone - see.reach > -see.pitch[0] / 2.0
    return inside


def off_the_line(see: LineSight) -> Motion:
    """Sort: straight on until the parcel is wholly in the zone, then to the asked side."""
    side = np.where(wholly_in_zone(see), see.side, 0.0)
    vy = np.where(side != 0.0, ASIDE * side, -CENTRING * see.offset)
    return Motion(see.vx, vy, -STRAIGHTENING * see.theta)


def turned(see: LineSight) -> Motion:
    """Orient: straight on until the parcel is wholly in the zone, then turning to the asked angle.

    Nothing is asked across: modules at 90 deg keep the parcel from drifting anyway.
    """
    left = see.angle - see.theta
    size = np.where(np.abs(left) > CLOSE_ENOUGH, np.abs(left), 0.0)
    fastest = np.sqrt(2.0 * END_OF_TURN / see.half_length * size)
    omega = np.sign(left) * np.minimum(TURNING * size, fastest)
    return Motion(see.vx, see.vy, np.where(wholly_in_zone(see), omega, 0.0))


def along_path(see: PathSight) -> Motion:
    """Track: along the path at the asked speed, back to it, and not turned."""
    # The slope 0.1 m ahead, which the parcel reaches while its velocity is being turned.
    cosine = 1.0 / np.sqrt(1.0 + see.slope[:, 1] ** 2)
    sine = see.slope[:, 1] * cosine
    across = -CROSSING * see.cross_error
    vx = see.asked_speed * cosine - across * sine
    vy = see.asked_speed * sine + across * cosine
    return Motion(vx, vy, -STRAIGHTENING * see.theta)
