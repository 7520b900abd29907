"""When two bases on their way come to touch."""

import math

from surface_gym.dynamics.compiled import inlined, linked
from surface_gym.dynamics.gap import Motion, Outline, gap_between, place_at

TOUCH = 1e-6  # [m] a gap that counts as none, and an overlap that is left
MAX_ADVANCES = 64


@inlined
def _reach(outline: Outline) -> float:
    """[m] from the centre of mass to the farthest corner; turning moves no other point as much."""
    square = 0.0
    for k in range(outline.corners.shape[0]):
        x = outline.corners[k, 0] - outline.com_x
        y = outline.corners[k, 1] - outline.com_y
        square = max(square, x * x + y * y)
    return math.sqrt(square)


@linked
def time_of_impact(
    first: Outline, moved: Motion, second: Outline, shifted: Motion, dt: float
) -> float:
    """[s] until two bases touch, at most dt; infinite if they do not.

    No point of a base nears the other faster than its centre of mass does along the normal and its
    farthest corner by turning, so that they may go on for as long as their gap takes at that speed.

    Args:
        first: a base.
        moved: its motion.
        second: another.
        shifted: the motion of that.
        dt: [s] of the step.
    """
    turning = abs(moved.omega) * _reach(first) + abs(shifted.omega) * _reach(second)
    time = 0.0
    for _ in range(MAX_ADVANCES):
        gap = gap_between(
            first, place_at(first, moved, time), second, place_at(second, shifted, time)
        )
        if gap.width <= TOUCH:
            return time
        speed = turning
        speed += gap.nx * (moved.vx - shifted.vx) + gap.ny * (moved.vy - shifted.vy)
        if speed * (dt - time) <= gap.width:
            return math.inf
        time += (gap.width - 0.5 * TOUCH) / speed
    return time
