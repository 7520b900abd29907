"""Presence: on/off sensors under the base, an observer, and physical bounds on its estimate."""

import math
from dataclasses import dataclass, field

from surface_gym import checks
from surface_gym.compiler.jit import kernel_function
from surface_gym.physics.contacts import EDGE_TOLERANCE
from surface_gym.physics.types import GYRATION, OMEGA, RADIUS, THETA, VX, VY, Array, X, Y
from surface_gym.sensors import kalman
from surface_gym.sensors.base import Entry, Physics
from surface_gym.sensors.kalman import (
    COVARIANCE,
    LAST,
    MODEL_SIZE,
    SIZE,
    Observer,
    correct,
    measure,
)
from surface_gym.state import GRAVITY_X, GRAVITY_Y, EnvState


@kernel_function
def between_places(low: float, high: float, count: int) -> tuple[int, int]:
    """Return the lowest and the highest index in [low, high]. Indices are 0 to `count` - 1.

    If no index lies in [low, high], the first result is above the second. `low` and `high` may be
    any floats.
    """
    first, last = count, -1
    if low <= 0.0:
        first = 0
    elif low < count:
        first = math.ceil(low)
    if high >= count - 1.0:
        last = count - 1
    elif high >= 0.0:
        last = math.floor(high)
    return first, last


@kernel_function
def covered_columns(
    state: EnvState,
    row: int,
    x: float,
    y: float,
    cosine: float,
    sine: float,
) -> tuple[int, int]:
    """Return the first and last column in which a module of row `row` is under a base.

    The base is at (x, y) [m]; `cosine` and `sine` belong to the base's angle. A module is under the
    base if its distance F_lambda from every edge is at most 0 (Section 3.2). If no module is under
    the base, the first column is greater than the last column.
    """
    reach = state.body[RADIUS] + EDGE_TOLERANCE
    dy = state.elements.y0 + state.elements.pitch_y * row - y
    square = reach * reach - dy * dy
    if square < 0.0:
        return 1, 0
    high = math.sqrt(square)
    low = -high
    edges = state.edges
    for k in range(edges.shape[0]):
        nx = cosine * edges[k, 0] - sine * edges[k, 1]
        ny = sine * edges[k, 0] + cosine * edges[k, 1]
        room = edges[k, 2] + EDGE_TOLERANCE - ny * dy
        if nx > 1e-12:
            high = min(high, room / nx)
        elif nx < -1e-12:
            low = max(low, room / nx)
        elif room < 0.0:
            return 1, 0
    per_pitch = 1.0 / state.elements.pitch_x
    return between_places(
        (x + low - state.elements.x0) * per_pitch,
        (x + high - state.elements.x0) * per_pitch,
        state.rotor.shape[1],
    )


@kernel_function
def distance_and_normal(
    state: EnvState, dx: float, dy: float, cosine: float, sine: float, ux: float, uy: float
) -> tuple[float, float, float]:
    """Return the distance [m] from the base to a point, and the base's normal (x, y).

    The point is at (dx, dy) [m] relative to the centroid. The distance is the largest edge
    distance F_lambda of the paper's Section 3.2, and is negative inside the base. An edge is left
    out if its normal points against the direction (ux, uy). The normal (x, y) points outwards from
    the edge, or from the circle of a disc. `cosine` and `sine` belong to the base's angle.
    """
    x = cosine * dx + sine * dy
    y = cosine * dy - sine * dx
    wx = cosine * ux + sine * uy
    wy = cosine * uy - sine * ux
    edges = state.edges
    radius = state.body[RADIUS]
    farthest = -4.0 * radius
    best = -4.0 * radius
    nx = 0.0
    ny = 0.0
    for k in range(edges.shape[0]):
        beyond = edges[k, 0] * x + edges[k, 1] * y - edges[k, 2]
        score = beyond
        if edges[k, 0] * wx + edges[k, 1] * wy < 0.0:
            score -= 2.0 * radius
        if score > best:
            best = score
            farthest = beyond
            nx = edges[k, 0]
            ny = edges[k, 1]
    if farthest > -4.0 * radius:
        return farthest, cosine * nx - sine * ny, sine * nx + cosine * ny
    # A disc has no edges; its padding edges are far away.
    distance = math.sqrt(dx * dx + dy * dy)
    per_distance = 1.0 / distance if distance > 0.0 else 0.0
    return distance - radius, dx * per_distance, dy * per_distance


GATE = 4.0  # maximum residual of an equation in standard deviations; `agree` handles larger ones


@kernel_function
def _take_switch(
    state: EnvState,
    x: float,
    y: float,
    covered: bool,
    interval: float,
    tolerance: float,
    switches: int,
) -> None:
    """Correct the estimate, since the module at (x, y) switched in the last `interval` [s].

    Args:
        covered: whether the module's switch is pressed now.
        tolerance: [m] tolerance of the switching position.
        switches: number of modules that switched in the interval. All these modules together have
            the weight of a single measurement.
    """
    estimate = state.sensor_state
    lead = 0.5 * interval
    theta = estimate[THETA] - lead * estimate[OMEGA]
    dx = x - estimate[X] + lead * estimate[VX]
    dy = y - estimate[Y] + lead * estimate[VY]
    # The module's velocity relative to the base, pointing outwards, shows which edge passed.
    outwards = -1.0 if covered else 1.0
    ux = outwards * (-estimate[VX] + estimate[OMEGA] * dy)
    uy = outwards * (-estimate[VY] - estimate[OMEGA] * dx)
    distance, nx, ny = distance_and_normal(state, dx, dy, math.cos(theta), math.sin(theta), ux, uy)
    lever = nx * dy - ny * dx
    speed = nx * estimate[VX] + ny * estimate[VY] - lever * estimate[OMEGA]
    variance = measure(estimate, -nx, -ny, lever, lead)
    when = speed * interval
    unsure = switches * (when * when / 12.0 + tolerance * tolerance)
    if distance * distance > GATE * GATE * (variance + unsure):
        return
    gain = 1.0 / (variance + unsure)
    correct(estimate, -distance * gain, gain)


@kernel_function
def _take_contradiction(
    state: EnvState, x: float, y: float, covered: bool, tolerance: float
) -> float:
    """Correct the estimate if a module at (x, y) is on the wrong side of the estimated perimeter.

    `covered` is whether the module's switch is pressed. The perimeter's exact position is unknown,
    so the correction moves the estimate without reducing the variance. Return how far [m] the
    module is on the wrong side. A distance within the `tolerance` [m] counts as 0.
    """
    estimate = state.sensor_state
    dx = x - estimate[X]
    dy = y - estimate[Y]
    cosine, sine = math.cos(estimate[THETA]), math.sin(estimate[THETA])
    distance, nx, ny = distance_and_normal(state, dx, dy, cosine, sine, 0.0, 0.0)
    wrong = distance if covered else -distance
    if wrong <= tolerance:
        return 0.0
    variance = measure(estimate, -nx, -ny, nx * dy - ny * dx, 0.0)
    unsure = variance + tolerance * tolerance
    if distance * distance > GATE * GATE * unsure:
        return wrong
    correct(estimate, -distance / unsure, 0.0)
    return wrong


@kernel_function
def covered_by_both(
    state: EnvState, row: int, pose: Array, other: Array
) -> tuple[int, int, int, int, int, int]:
    """Find the columns of a row that a base covers at `pose` and at `other`.

    Return the first and last column at `pose`, at `other`, and at either pose.
    """
    first, last = covered_columns(
        state, row, pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2])
    )
    was_first, was_last = covered_columns(
        state, row, other[0], other[1], math.cos(other[2]), math.sin(other[2])
    )
    return first, last, was_first, was_last, min(first, was_first), max(last, was_last)


@kernel_function
def rows_of_both(state: EnvState, y: float, other_y: float) -> tuple[int, int]:
    """Return the first and last row that a base centred at `y` or `other_y` [m] can cover."""
    reach = state.body[RADIUS] + EDGE_TOLERANCE
    low = (min(y, other_y) - reach - state.elements.y0) / state.elements.pitch_y
    high = (max(y, other_y) + reach - state.elements.y0) / state.elements.pitch_y
    return between_places(low, high, state.rotor.shape[0])


@kernel_function
def _count_switches(state: EnvState, sampled: Array) -> int:
    """Return the number of modules that switched since the base had the pose `sampled` (3,)."""
    truth = state.truth
    first_row, last_row = rows_of_both(state, truth[1], sampled[1])
    switches = 0
    for row in range(first_row, last_row + 1):
        first, last, was_first, was_last, low, high = covered_by_both(state, row, truth, sampled)
        for column in range(low, high + 1):
            differ = (first <= column <= last) != (was_first <= column <= was_last)
            switches += state.rotor[row, column] and differ
    return switches


@kernel_function
def take_switches(state: EnvState, sampled: Array, interval: float, tolerance: float) -> None:
    """Correct the estimate with all modules that have switched since the last sample.

    The last sample was `interval` [s] ago, when the base had the pose `sampled` (3,). A switch's
    position has the standard deviation `tolerance` [m]. All switches of one sample share the error
    of the estimate, so together these switches have the weight of one switch.
    """
    truth = state.truth
    switches = _count_switches(state, sampled)
    if switches == 0:
        return
    first_row, last_row = rows_of_both(state, truth[1], sampled[1])
    for row in range(first_row, last_row + 1):
        y = state.elements.y0 + state.elements.pitch_y * row
        first, last, was_first, was_last, low, high = covered_by_both(state, row, truth, sampled)
        for column in range(low, high + 1):
            covered = first <= column <= last
            if state.rotor[row, column] and covered != (was_first <= column <= was_last):
                x = state.elements.x0 + state.elements.pitch_x * column
                _take_switch(state, x, y, covered, interval, tolerance, switches)


@kernel_function
def take_contradictions(state: EnvState, tolerance: float) -> float:
    """Correct the estimate by every module whose switch contradicts the estimate.

    Return the largest distance [m] of these modules from the estimated perimeter. If all distances
    are within the `tolerance` [m], return 0.
    """
    truth = state.truth
    estimate = state.sensor_state
    worst = 0.0
    first_row, last_row = rows_of_both(state, truth[1], estimate[Y])
    for row in range(first_row, last_row + 1):
        y = state.elements.y0 + state.elements.pitch_y * row
        first, last, has_first, has_last, low, high = covered_by_both(state, row, truth, estimate)
        for column in range(low, high + 1):
            covered = first <= column <= last
            if state.rotor[row, column] and covered != (has_first <= column <= has_last):
                x = state.elements.x0 + state.elements.pitch_x * column
                worst = max(worst, _take_contradiction(state, x, y, covered, tolerance))
    return worst


@kernel_function
def worst_contradiction(state: EnvState) -> tuple[float, float, float, float]:
    """Find the module whose switch contradicts the estimated pose most.

    Returns:
        The distance [m] from the module to the edge of the estimated base, the module's position
        (x, y) [m] relative to the estimated centroid, and 1 if the module is covered, else -1. If
        no switch contradicts the estimate, all four numbers are 0.
    """
    truth = state.truth
    estimate = state.sensor_state
    cosine, sine = math.cos(estimate[THETA]), math.sin(estimate[THETA])
    worst, worst_x, worst_y, worst_side = 0.0, 0.0, 0.0, 0.0
    first_row, last_row = rows_of_both(state, truth[1], estimate[Y])
    for row in range(first_row, last_row + 1):
        dy = state.elements.y0 + state.elements.pitch_y * row - estimate[Y]
        first, last, has_first, has_last, low, high = covered_by_both(state, row, truth, estimate)
        for column in range(low, high + 1):
            covered = first <= column <= last
            if state.rotor[row, column] and covered != (has_first <= column <= has_last):
                dx = state.elements.x0 + state.elements.pitch_x * column - estimate[X]
                side = 1.0 if covered else -1.0
                wrong = side * distance_and_normal(state, dx, dy, cosine, sine, 0.0, 0.0)[0]
                if wrong > worst:
                    worst, worst_x, worst_y, worst_side = wrong, dx, dy, side
    return worst, worst_x, worst_y, worst_side


@kernel_function
def mean_of_pressed(state: EnvState) -> tuple[int, float, float]:
    """Return the number of pressed switches, and the mean position [m] of their modules."""
    truth = state.truth
    pressed, x, y = 0, 0.0, 0.0
    cosine, sine = math.cos(truth[THETA]), math.sin(truth[THETA])
    first_row, last_row = rows_of_both(state, truth[1], truth[1])
    for row in range(first_row, last_row + 1):
        first, last = covered_columns(state, row, truth[0], truth[1], cosine, sine)
        for column in range(first, last + 1):
            if state.rotor[row, column]:
                pressed += 1
                x += state.elements.x0 + state.elements.pitch_x * column
                y += state.elements.y0 + state.elements.pitch_y * row
    per_module = 1.0 / max(pressed, 1)
    return pressed, x * per_module, y * per_module


MOVES = 60  # maximum moves of an estimate, one module each, before a restart
# [-] square of the length, relative to the base's radius, that converts a turn to a displacement.
# Larger values prefer shifts to turns, since headings have smaller errors than positions.
TURN_WEIGHT = 2.0
BUILD_UP = 0.1  # [s] assumed duration over which a contradiction has built up
MOST_BUILT_UP = 0.03  # [m] maximum displacement of the base's rim; larger ones cause a restart
HEADINGS = 36  # number of headings to try in a restart


@kernel_function
def agree(state: EnvState, tolerance: float) -> None:
    """Move the estimated pose until no switch contradicts the pose by more than `tolerance` [m].

    Small moves are tried first. The pose's correction, divided by the time `BUILD_UP` [s], is added
    to the velocity. The variances of pose and velocity grow, since they were too small.
    """
    estimate = state.sensor_state
    x, y, theta = estimate[X], estimate[Y], estimate[THETA]
    if _move(state, tolerance) > tolerance:
        _start_over(state, tolerance, x, y, theta)
    shift_x, shift_y, turn = estimate[X] - x, estimate[Y] - y, estimate[THETA] - theta
    size = math.sqrt(shift_x * shift_x + shift_y * shift_y + (state.body[RADIUS] * turn) ** 2)
    share = min(1.0, MOST_BUILT_UP / max(size, MOST_BUILT_UP))
    _build_up(estimate, share * shift_x, share * shift_y, share * turn)


@kernel_function
def _build_up(estimate: Array, shift_x: float, shift_y: float, turn: float) -> None:
    """Correct the velocity after the pose was corrected by a shift [m] and a turn [rad].

    Add the shift and the turn, divided by `BUILD_UP` [s], to the velocity. Increase the covariance.
    """
    per_time = 1.0 / BUILD_UP
    estimate[VX] += per_time * shift_x
    estimate[VY] += per_time * shift_y
    estimate[OMEGA] += per_time * turn
    for i in range(SIZE):
        by_i = (shift_x, shift_y, turn)[i % 3] * (1.0 if i < 3 else per_time)
        for j in range(SIZE):
            by_j = (shift_x, shift_y, turn)[j % 3] * (1.0 if j < 3 else per_time)
            estimate[COVARIANCE + SIZE * i + j] += by_i * by_j


@kernel_function
def _move(state: EnvState, tolerance: float) -> float:
    """Repeatedly move the pose until no module is on the wrong side of the estimated perimeter.

    Each move corrects the module that is farthest on the wrong side. Return the largest distance
    [m] that remains. This distance is at most `tolerance` if the moves succeed.
    """
    estimate = state.sensor_state
    square = TURN_WEIGHT * state.body[RADIUS] * state.body[RADIUS]
    wrong = 0.0
    for _ in range(MOVES):
        wrong, dx, dy, side = worst_contradiction(state)
        if wrong <= tolerance:
            return wrong
        cosine, sine = math.cos(estimate[THETA]), math.sin(estimate[THETA])
        _, nx, ny = distance_and_normal(state, dx, dy, cosine, sine, 0.0, 0.0)
        lever = nx * dy - ny * dx
        step = side * wrong / (1.0 + lever * lever / square)
        estimate[X] += step * nx
        estimate[Y] += step * ny
        estimate[THETA] -= step * lever / square
    return wrong


@kernel_function
def _start_over(state: EnvState, tolerance: float, x: float, y: float, theta: float) -> None:
    """Search for a consistent pose, starting at the middle of the pressed modules.

    A pose is consistent if no switch contradicts the pose by more than `tolerance` [m]. Headings
    are tried with increasing distance from `theta`. If no pose is consistent, the pose with the
    least contradiction is used. Without pressed modules, the estimate is (x, y, theta).
    """
    estimate = state.sensor_state
    best_x, best_y, best_theta, least = x, y, theta, math.inf
    pressed, middle_x, middle_y = mean_of_pressed(state)
    if pressed == 0:  # the parcel has left the rotors to an unknown position
        estimate[X], estimate[Y], estimate[THETA] = x, y, theta
        return
    for k in range(1, HEADINGS + 1):
        turn = k // 2 * (1.0 if k % 2 == 0 else -1.0)
        estimate[X], estimate[Y] = middle_x, middle_y
        estimate[THETA] = theta + turn * 2.0 * math.pi / HEADINGS
        wrong = _move(state, tolerance)
        if wrong < least:
            best_x, best_y, best_theta, least = estimate[X], estimate[Y], estimate[THETA], wrong
        if wrong <= tolerance:
            break
    estimate[X], estimate[Y], estimate[THETA] = best_x, best_y, best_theta


SURE = 3.0  # standard deviations of an entry that are considered
# [-] factor of the maximum energy of a centred load. With an off-centre load, the centroid is
# faster than the load, and parcels may push each other.
MARGIN = 4.0
# Maximum speeds, larger than in any task and within the bounds of every observation.
FASTEST = 9.0  # [m/s]
FASTEST_TURN = 100.0  # [rad/s]
MOST_TURN = 32.0 * math.pi  # [rad] maximum theta; further whole turns are not counted


@kernel_function
def most_energy(state: EnvState) -> float:
    """Return a limit of the energy [m^2/s^2], vx^2 + vy^2 + (gyration radius x omega)^2.

    Modules brake and do not push. So a parcel with a centred load has at most the energy of its
    entry, plus the energy that it gains if it rolls down the whole surface. The limit is `MARGIN`
    times the sum of these two energies, but at most `FASTEST`^2. `state.sensor_state` holds the
    prior of the velocity at the entry.
    """
    estimate = state.sensor_state
    rows, columns = state.rotor.shape
    energy = 2.0 * abs(state.surface[GRAVITY_X]) * state.elements.pitch_x * columns
    energy += 2.0 * abs(state.surface[GRAVITY_Y]) * state.elements.pitch_y * rows
    for k in range(3, SIZE):
        fastest = abs(estimate[k]) + SURE * math.sqrt(estimate[COVARIANCE + (SIZE + 1) * k])
        energy += fastest * fastest * (state.body[GYRATION] if k == OMEGA else 1.0)
    return min(MARGIN * energy, FASTEST * FASTEST)


@kernel_function
def keep_possible(state: EnvState, energy: float) -> None:
    """Move the estimated pose back over the surface, and limit the estimated energy [m^2/s^2]."""
    estimate = state.sensor_state
    rows, columns = state.rotor.shape
    elements, reach = state.elements, state.body[RADIUS]
    left, low = elements.x0 - 0.5 * elements.pitch_x, elements.y0 - 0.5 * elements.pitch_y
    _keep_within(estimate, X, left - reach, left + elements.pitch_x * columns + reach)
    _keep_within(estimate, Y, low - reach, low + elements.pitch_y * rows + reach)
    if abs(estimate[THETA]) > MOST_TURN:
        estimate[THETA] -= 2.0 * math.pi * math.floor(estimate[THETA] / (2.0 * math.pi))
    turning = state.body[GYRATION] * estimate[OMEGA] * estimate[OMEGA]
    has = estimate[VX] * estimate[VX] + estimate[VY] * estimate[VY] + turning
    if has > energy:
        slower = math.sqrt(energy / has)
        for k in range(3, SIZE):
            estimate[k] *= slower
    _keep_within(estimate, OMEGA, -FASTEST_TURN, FASTEST_TURN)


@kernel_function
def _keep_within(estimate: Array, k: int, low: float, high: float) -> None:
    """Limit coordinate `k` of the estimate to [low, high]."""
    if estimate[k] < low:
        estimate[k] = low
    elif estimate[k] > high:
        estimate[k] = high


# Columns of the params; the Entry comes last.
(
    EVERY,  # physics steps between samples
    DROP,
    TOLERANCE,
    MODEL,  # process noise of the observer
) = range(4)
ENTRY = MODEL + MODEL_SIZE
# Further numbers after the observer's: the base's pose and the step at the last sample, and the
# parcel's maximum energy. The switches of that sample are recomputed from the pose instead of being
# stored.
SAMPLED, STEP, ENERGY = LAST, LAST + 3, LAST + 4


@dataclass(frozen=True)
class Presence(Observer):
    """An on/off switch in each rotor module. The switch is on if the parcel covers the module.

    An observer estimates pose and velocity from the switches. The observer predicts motion by the
    simulation's physics with the true axes, nominal friction and a centred load, and propagates the
    estimate's uncertainty. If a switch changes, the parcel's perimeter passed the module's centre
    since the last sample. If a switch contradicts the estimate, the perimeter is on the other side
    of the module. Each switching or contradicting module gives one equation for a Kalman filter.
    `entry` describes the prior at the start.

    If contradictions remain, the estimate is moved as little as possible until it agrees with every
    module. If no move suffices, a search around the pressed modules finds a new estimate. The
    estimated pose stays over the surface. The estimated speed stays below a limit that follows from
    the speed at the entry.

    The errors of position were measured for all tasks, 37 controllers and both boxes, at a pitch of
    100 mm. With correct assumptions, the median error is 1.3 mm, and 99.9 % of errors are below
    21 mm. With the load off centre by up to half the way to the edge, 99.9 % are below 70 mm, and
    the maximum is 122 mm. With friction of 0.8 or 1.2 times the assumed value, 99.9 % are below
    46 mm, and the maximum is 79 mm. With all these deviations at once, a few errors reach about
    0.3 m. Parcels with such errors are leaving a line and press at most two switches. Their
    headings may have any error. Headings of squares may be off by a quarter turn.
    """

    sample_rate: float = 200.0  # [Hz] rate of all sensors; at most one sample per physics step
    drop: float = 0.0  # [-] probability of a sample to be lost
    mu_max: float | None = None  # [-] friction assumed by the observer; None: the line's
    mu_min: float | None = None  # [-]
    mu_support: float | None = None  # [-]
    friction_error: float = 0.0  # [-] relative error of friction
    acceleration_density: float = 0.1  # [m^2/s^3] error of the model, in x and y
    turn_density: float = 5.0  # [rad^2/s^3] error of the model in turning
    tolerance: float = 0.001  # [m] tolerance of the switching position
    entry: Entry = field(default_factory=Entry)  # prior of a parcel at its entry

    rate = ("sample_rate", "sample")
    sensor_size = ENERGY + 1

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.positive("sample_rate", self.sample_rate, *checks.FRAME_RATE)
        checks.positive("tolerance", self.tolerance, *checks.TOLERANCE)

    def numbers(self, dt: float) -> tuple[float, ...]:
        return (
            self.frame_steps(dt), self.drop, self.tolerance, self.acceleration_density,
            self.turn_density, self.friction_error, *self.entry.params,
        )  # fmt: skip

    @staticmethod
    @kernel_function
    def begin(numbers: Array, state: EnvState) -> None:
        """Reset the observer, and read the switches for the first time."""
        kalman.begin(numbers, ENTRY, state)
        state.sensor_state[ENERGY] = most_energy(state)
        _keep_sample(state, 0)

    @staticmethod
    @kernel_function
    def update(numbers: Array, state: EnvState, physics: Physics) -> None:
        """Predict over a physics step. If a sample of the switches is due, correct the estimate."""
        kalman.predict(numbers, MODEL, state, physics)
        keep_possible(state, state.sensor_state[ENERGY])
        if state.steps % int(numbers[EVERY]) != 0:
            return
        row = state.noise_row[0]
        state.noise_row[0] = row + 1
        if state.noise[row, 3] < numbers[DROP]:
            return
        interval = physics.dt * (state.steps - state.sensor_state[STEP])
        tolerance = numbers[TOLERANCE]
        take_switches(state, state.sensor_state[SAMPLED : SAMPLED + 3], interval, tolerance)
        # Without a pressed switch, the position off the rotors is unknown.
        if mean_of_pressed(state)[0] > 0 and take_contradictions(state, tolerance) > 0.0:
            agree(state, tolerance)
        keep_possible(state, state.sensor_state[ENERGY])
        _keep_sample(state, state.steps)


@kernel_function
def _keep_sample(state: EnvState, step: int) -> None:
    for k in range(3):
        state.sensor_state[SAMPLED + k] = state.truth[k]
    state.sensor_state[STEP] = step
