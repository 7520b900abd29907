"""An estimate that contradicts the switches is moved to agree with them, or started over."""

import math

from surface_gym.dynamics.compiled import lane_function
from surface_gym.dynamics.types import OMEGA, RADIUS, THETA, VX, VY, Array, X, Y
from surface_gym.lanes.lane import Lane
from surface_gym.sensors.observer import COVARIANCE, SIZE
from surface_gym.sensors.outline import outside
from surface_gym.sensors.switches import mean_of_pressed, worst_contradiction

MOVES = 60  # of an estimate, a module each, before it is started over
# [-] square of the length, over the base's radius, by which a turn counts as a displacement: the
# longer, the rather a pose is shifted than turned. Headings err less than positions do.
TURN_WEIGHT = 2.0
BUILD_UP = 0.1  # [s] over which a contradiction is taken to have built up
MOST_BUILT_UP = 0.03  # [m] of the base's rim; more than that is a start over
HEADINGS = 36  # over a full turn, tried where an estimate is started over


@lane_function
def agree(lane: Lane, tolerance: float) -> None:
    """Move the estimate least, until it contradicts no switch by more than a tolerance [m].

    The velocity is corrected by what the pose is, as built up over some time, and both are doubted
    by as much: the estimate was too sure of itself.
    """
    kept = lane.kept
    x, y, theta = kept[X], kept[Y], kept[THETA]
    if _move(lane, tolerance) > tolerance:
        _start_over(lane, tolerance, x, y, theta)
    shift_x, shift_y, turn = kept[X] - x, kept[Y] - y, kept[THETA] - theta
    size = math.sqrt(shift_x * shift_x + shift_y * shift_y + (lane.body[RADIUS] * turn) ** 2)
    share = min(1.0, MOST_BUILT_UP / max(size, MOST_BUILT_UP))
    _build_up(kept, share * shift_x, share * shift_y, share * turn)


@lane_function
def _build_up(kept: Array, shift_x: float, shift_y: float, turn: float) -> None:
    """Correct the velocity by what the pose was, and doubt both along that."""
    per_time = 1.0 / BUILD_UP
    kept[VX] += per_time * shift_x
    kept[VY] += per_time * shift_y
    kept[OMEGA] += per_time * turn
    for i in range(SIZE):
        by_i = (shift_x, shift_y, turn)[i % 3] * (1.0 if i < 3 else per_time)
        for j in range(SIZE):
            by_j = (shift_x, shift_y, turn)[j % 3] * (1.0 if j < 3 else per_time)
            kept[COVARIANCE + SIZE * i + j] += by_i * by_j


@lane_function
def _move(lane: Lane, tolerance: float) -> float:
    """Move the pose onto the right side of the module that it contradicts most, and again.

    Returns:
        [m] how far it is still on the wrong side of one.
    """
    kept = lane.kept
    square = TURN_WEIGHT * lane.body[RADIUS] * lane.body[RADIUS]
    wrong = 0.0
    for _ in range(MOVES):
        wrong, dx, dy, side = worst_contradiction(lane)
        if wrong <= tolerance:
            return wrong
        cosine, sine = math.cos(kept[THETA]), math.sin(kept[THETA])
        _, nx, ny = outside(lane, dx, dy, cosine, sine, 0.0, 0.0)
        lever = nx * dy - ny * dx
        step = side * wrong / (1.0 + lever * lever / square)
        kept[X] += step * nx
        kept[Y] += step * ny
        kept[THETA] -= step * lever / square
    return wrong


@lane_function
def _start_over(lane: Lane, tolerance: float, x: float, y: float, theta: float) -> None:
    """Look for a pose that agrees from the middle of the pressed modules, the heading turned from
    `theta` further and further; of those that do not agree the best is taken. Where nothing is
    pressed, the estimate stays at (x, y).
    """
    kept = lane.kept
    best_x, best_y, best_theta, least = x, y, theta, math.inf
    pressed, middle_x, middle_y = mean_of_pressed(lane)
    if pressed == 0:  # the parcel has left the rotors, it is not known where to
        kept[X], kept[Y], kept[THETA] = x, y, theta
        return
    for k in range(1, HEADINGS + 1):
        turn = k // 2 * (1.0 if k % 2 == 0 else -1.0)
        kept[X], kept[Y] = middle_x, middle_y
        kept[THETA] = theta + turn * 2.0 * math.pi / HEADINGS
        wrong = _move(lane, tolerance)
        if wrong < least:
            best_x, best_y, best_theta, least = kept[X], kept[Y], kept[THETA], wrong
        if wrong <= tolerance:
            break
    kept[X], kept[Y], kept[THETA] = best_x, best_y, best_theta
