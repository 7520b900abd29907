"""What a pattern of covered modules tells an estimate: which switched, and which contradict it.

The pattern is the one that the base covers at `lane.truth`; the estimate lies in `lane.kept`.
"""

import math

from surface_gym.dynamics.compiled import lane_function
from surface_gym.dynamics.contacts import EDGE_TOLERANCE
from surface_gym.dynamics.types import OMEGA, RADIUS, THETA, VX, VY, Array, X, Y
from surface_gym.lanes.lane import Lane
from surface_gym.sensors.observer import correct, measure
from surface_gym.sensors.outline import between_places, covered_columns, outside

GATE = 4.0  # standard deviations an equation may be off; beyond it the estimate is mended otherwise


@lane_function
def _take_switch(
    lane: Lane,
    x: float,
    y: float,
    covered: bool,
    interval: float,
    tolerance: float,
    switches: int,
) -> None:
    """The perimeter passed the module at (x, y) within the last `interval` [s], as did others."""
    kept = lane.kept
    lead = 0.5 * interval
    theta = kept[THETA] - lead * kept[OMEGA]
    dx = x - kept[X] + lead * kept[VX]
    dy = y - kept[Y] + lead * kept[VY]
    # The module's velocity as the base sees it, turned to point outwards: it tells which edge
    # passed.
    outwards = -1.0 if covered else 1.0
    ux = outwards * (-kept[VX] + kept[OMEGA] * dy)
    uy = outwards * (-kept[VY] - kept[OMEGA] * dx)
    distance, nx, ny = outside(lane, dx, dy, math.cos(theta), math.sin(theta), ux, uy)
    lever = nx * dy - ny * dx
    speed = nx * kept[VX] + ny * kept[VY] - lever * kept[OMEGA]
    variance = measure(kept, -nx, -ny, lever, lead)
    when = speed * interval
    unsure = switches * (when * when / 12.0 + tolerance * tolerance)
    if distance * distance > GATE * GATE * (variance + unsure):
        return
    gain = 1.0 / (variance + unsure)
    correct(kept, -distance * gain, gain)


@lane_function
def _take_contradiction(lane: Lane, x: float, y: float, covered: bool, tolerance: float) -> float:
    """The perimeter lies on the other side of the module at (x, y) than the estimate has it.

    It may lie anywhere there, so that the estimate is moved but gets no surer.

    Returns:
        [m] how far the estimate was on the wrong side; 0 if that is within the tolerance.
    """
    kept = lane.kept
    dx = x - kept[X]
    dy = y - kept[Y]
    cosine, sine = math.cos(kept[THETA]), math.sin(kept[THETA])
    distance, nx, ny = outside(lane, dx, dy, cosine, sine, 0.0, 0.0)
    wrong = distance if covered else -distance
    if wrong <= tolerance:
        return 0.0
    variance = measure(kept, -nx, -ny, nx * dy - ny * dx, 0.0)
    unsure = variance + tolerance * tolerance
    if distance * distance > GATE * GATE * unsure:
        return wrong
    correct(kept, -distance / unsure, 0.0)
    return wrong


@lane_function
def covered_by_both(
    lane: Lane, row: int, pose: Array, other: Array
) -> tuple[int, int, int, int, int, int]:
    """Columns of a row that a base covers in one pose and in another.

    Returns:
        First and last column of the first pose, of the second, and of both together.
    """
    first, last = covered_columns(lane, row, pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2]))
    was_first, was_last = covered_columns(
        lane, row, other[0], other[1], math.cos(other[2]), math.sin(other[2])
    )
    return first, last, was_first, was_last, min(first, was_first), max(last, was_last)


@lane_function
def rows_of_both(lane: Lane, y: float, other_y: float) -> tuple[int, int]:
    """First and last row that a base can cover from either of two places."""
    reach = lane.body[RADIUS] + EDGE_TOLERANCE
    low = (min(y, other_y) - reach - lane.elements.y0) / lane.elements.pitch_y
    high = (max(y, other_y) + reach - lane.elements.y0) / lane.elements.pitch_y
    return between_places(low, high, lane.rotor.shape[0])


@lane_function
def _count_switches(lane: Lane, sampled: Array) -> int:
    """How many modules switched since the last sample, which the pose `sampled` (3,) gave."""
    truth = lane.truth
    first_row, last_row = rows_of_both(lane, truth[1], sampled[1])
    switches = 0
    for row in range(first_row, last_row + 1):
        first, last, was_first, was_last, low, high = covered_by_both(lane, row, truth, sampled)
        for column in range(low, high + 1):
            differ = (first <= column <= last) != (was_first <= column <= was_last)
            switches += lane.rotor[row, column] and differ
    return switches


@lane_function
def take_switches(lane: Lane, sampled: Array, interval: float, tolerance: float) -> None:
    """Correct the estimate by every module that switched since the base was at the pose `sampled`
    (3,), within the last `interval` [s]; sensors switch to within a `tolerance` [m].

    Switches of one sample share the error of the estimate they are judged by: together they weigh
    as one.
    """
    truth = lane.truth
    switches = _count_switches(lane, sampled)
    if switches == 0:
        return
    first_row, last_row = rows_of_both(lane, truth[1], sampled[1])
    for row in range(first_row, last_row + 1):
        y = lane.elements.y0 + lane.elements.pitch_y * row
        first, last, was_first, was_last, low, high = covered_by_both(lane, row, truth, sampled)
        for column in range(low, high + 1):
            covered = first <= column <= last
            if lane.rotor[row, column] and covered != (was_first <= column <= was_last):
                x = lane.elements.x0 + lane.elements.pitch_x * column
                _take_switch(lane, x, y, covered, interval, tolerance, switches)


@lane_function
def take_contradictions(lane: Lane, tolerance: float) -> float:
    """Correct the estimate by every module that it has covered and the sensor has not, or the
    other way about.

    Returns:
        [m] how far the estimate was on the wrong side of one, at most; 0 if that is within the
        tolerance [m] of where sensors switch.
    """
    truth = lane.truth
    estimate = lane.kept
    worst = 0.0
    first_row, last_row = rows_of_both(lane, truth[1], estimate[Y])
    for row in range(first_row, last_row + 1):
        y = lane.elements.y0 + lane.elements.pitch_y * row
        first, last, has_first, has_last, low, high = covered_by_both(lane, row, truth, estimate)
        for column in range(low, high + 1):
            covered = first <= column <= last
            if lane.rotor[row, column] and covered != (has_first <= column <= has_last):
                x = lane.elements.x0 + lane.elements.pitch_x * column
                worst = max(worst, _take_contradiction(lane, x, y, covered, tolerance))
    return worst


@lane_function
def worst_contradiction(lane: Lane) -> tuple[float, float, float, float]:
    """The module that the estimate is farthest on the wrong side of.

    Returns:
        [m] how far, 0 where none is; [m] where that module lies from the estimate's centroid; and
        1 where it is covered, else -1.
    """
    truth = lane.truth
    estimate = lane.kept
    cosine, sine = math.cos(estimate[THETA]), math.sin(estimate[THETA])
    worst, worst_x, worst_y, worst_side = 0.0, 0.0, 0.0, 0.0
    first_row, last_row = rows_of_both(lane, truth[1], estimate[Y])
    for row in range(first_row, last_row + 1):
        dy = lane.elements.y0 + lane.elements.pitch_y * row - estimate[Y]
        first, last, has_first, has_last, low, high = covered_by_both(lane, row, truth, estimate)
        for column in range(low, high + 1):
            covered = first <= column <= last
            if lane.rotor[row, column] and covered != (has_first <= column <= has_last):
                dx = lane.elements.x0 + lane.elements.pitch_x * column - estimate[X]
                side = 1.0 if covered else -1.0
                wrong = side * outside(lane, dx, dy, cosine, sine, 0.0, 0.0)[0]
                if wrong > worst:
                    worst, worst_x, worst_y, worst_side = wrong, dx, dy, side
    return worst, worst_x, worst_y, worst_side


@lane_function
def mean_of_pressed(lane: Lane) -> tuple[int, float, float]:
    """How many switches are pressed, and the middle [m] of their modules."""
    truth = lane.truth
    pressed, x, y = 0, 0.0, 0.0
    cosine, sine = math.cos(truth[THETA]), math.sin(truth[THETA])
    first_row, last_row = rows_of_both(lane, truth[1], truth[1])
    for row in range(first_row, last_row + 1):
        first, last = covered_columns(lane, row, truth[0], truth[1], cosine, sine)
        for column in range(first, last + 1):
            if lane.rotor[row, column]:
                pressed += 1
                x += lane.elements.x0 + lane.elements.pitch_x * column
                y += lane.elements.y0 + lane.elements.pitch_y * row
    per_module = 1.0 / max(pressed, 1)
    return pressed, x * per_module, y * per_module


@lane_function
def is_any_pressed(lane: Lane) -> bool:
    """Whether any switch is pressed."""
    truth = lane.truth
    cosine, sine = math.cos(truth[THETA]), math.sin(truth[THETA])
    first_row, last_row = rows_of_both(lane, truth[1], truth[1])
    for row in range(first_row, last_row + 1):
        first, last = covered_columns(lane, row, truth[0], truth[1], cosine, sine)
        for column in range(first, last + 1):
            if lane.rotor[row, column]:
                return True
    return False
