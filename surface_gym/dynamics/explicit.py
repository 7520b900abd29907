"""The paper's own step, to the letter: Eq. (2)-(4) with the rule of Figure 5b."""

import math

from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import (
    ARM_X,
    ARM_Y,
    AXIS_X,
    AXIS_Y,
    MU_ACROSS,
    MU_ALONG,
    NORMAL,
    ROTOR,
    Contacts,
    Grid,
    Scratch,
)

STEEPNESS = 5000.0  # [s/m] k of Eq. (2), Section 6.1
RESTART_SPEED = 1e-4  # [m/s] given to a parcel that stands or reverses, Figure 5b


@inlined
def _sign(value: float) -> float:
    return (value > 0.0) * 1.0 - (value < 0.0) * 1.0


@inlined
def held_share(along_x: float, other_x: float) -> float:
    """What share of the forces along the axes holds a parcel that gravity does not move.

    sum F_x + m g sin(gamma) = 0 sets it. Friction along an axis cannot push, nor hold more than it
    does where the parcel slides.

    Args:
        along_x: [m/s^2] x of the forces along the axes, over the mass.
        other_x: [m/s^2] x of all others, gravity's pull among them.
    """
    return min(1.0, max(0.0, -other_x / along_x)) if along_x < 0.0 else 0.0


@inlined
def explicit_acceleration(
    grid: Grid,
    gyration: float,
    scratch: Scratch,
    contacts: Contacts,
    vx: float,
    vy: float,
    omega: float,
) -> tuple[float, float, float, float]:
    """Acceleration (x, y, theta) by Eq. (2)-(4), with Figure 5b's rule where vx is not positive.

    Returns:
        The acceleration, and the vx it starts from, which the rule changes.
    """
    standing = vx <= 0.0
    if standing:
        vx = RESTART_SPEED
    # The forces along the axes, which the rule may scale, and all others, per unit mass.
    along_x = along_y = along_w = 0.0
    other_x = other_y = other_w = 0.0
    table = scratch.table
    for i in range(contacts.total):
        x = table[ARM_X + i]
        y = table[ARM_Y + i]
        ux = vx - omega * y
        uy = vy + omega * x
        speed = math.sqrt(ux * ux + uy * uy)
        smooth = table[NORMAL + i] * math.tanh(STEEPNESS * speed)
        if scratch.marks[ROTOR + i]:
            ax = table[AXIS_X + i]
            ay = table[AXIS_Y + i]
            # cos(alpha) = a . V / |V|, and sin(alpha).
            f_par = table[MU_ALONG + i] * smooth * _sign(ax * ux + ay * uy)
            f_perp = table[MU_ACROSS + i] * smooth * _sign(ay * ux - ax * uy)
            along_x -= f_par * ax
            along_y -= f_par * ay
            along_w -= f_par * (x * ay - y * ax)
            fx = -f_perp * ay
            fy = f_perp * ax
        else:
            share = table[MU_ALONG + i] * smooth / speed if speed > 0.0 else 0.0
            fx = -share * ux
            fy = -share * uy
        other_x += fx
        other_y += fy
        other_w += x * fy - y * fx
    other_x += grid.gravity_along
    if standing and along_x + other_x <= 0.0:
        scale = held_share(along_x, other_x)
        return 0.0, scale * along_y + other_y, (scale * along_w + other_w) / gyration, 0.0
    return along_x + other_x, along_y + other_y, (along_w + other_w) / gyration, vx
