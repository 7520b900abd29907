"""Kalman filters of pose, velocity and constants (friction and load), predicted by the physics.

`state.sensor_state` holds the estimate of the physics' state vector, followed by its covariance.

An `AdaptiveCamera` also estimates three constants: the factor of mu_max, and the centre of mass in
the base's frame, x and y. Their effect on a step's velocities follows from the step's contacts.
Friction grows with the factor, and another position of the load changes the normal forces (Eq. 1).
"""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

from surface_gym import checks
from surface_gym.compiler.jit import inlined, kernel_function
from surface_gym.lines import BaseLine
from surface_gym.physics import types as ph
from surface_gym.physics.contacts import bounded
from surface_gym.physics.friction import friction_gradient
from surface_gym.physics.step import OFF_SURFACE, step_implicit
from surface_gym.physics.types import Array, Body, Grid, Scratch
from surface_gym.sensors.base import LEARNED, Entry, Physics, Sensor, enter
from surface_gym.state import GRAVITY_NORMAL, GRAVITY_X, GRAVITY_Y, NOISE_ROWS, EnvState

SIZE = 6  # pose and velocity
COVARIANCE = ph.STATE_SIZE  # first column; row by row
GAIN = COVARIANCE + SIZE * SIZE  # first column of a correction's own memory
DECAY = GAIN + SIZE  # first column of a prediction's own memory, 3 x 3
LAST = DECAY + 9

# Process noise in a sensor's params from some column on: densities of the physics' error, and the
# relative error of accelerations by friction.
DENSITY, TURN_DENSITY, FRICTION_ERROR, MODEL_SIZE = range(4)

FRICTION_ERROR_TIME = 0.04  # [s] correlation time of friction errors, a control period
# coefficients assumed by an observer; None: the line's
FRICTIONS = ("mu_max", "mu_min", "mu_support")
STICTION_SPEED = 0.03  # [m/s] a rotor with a smaller slip along its axis holds the parcel


@dataclass(frozen=True)
class Observer(Sensor):
    """A sensor that estimates pose and velocity by prediction and correction."""

    rate: ClassVar[tuple[str, str]]  # name of the field with the rate [Hz], and name of its events

    def __post_init__(self) -> None:
        sensor: Any = self  # each observer defines these fields with its own defaults
        for name in ("acceleration_density", "turn_density"):
            checks.positive(name, getattr(self, name), *checks.DENSITY)
        checks.not_negative("friction_error", sensor.friction_error, checks.FRICTION_ERROR)
        for name in FRICTIONS:
            if getattr(self, name) is not None:
                checks.not_negative(name, getattr(self, name), checks.FRICTION)
        if None not in (sensor.mu_max, sensor.mu_min):
            checks.rolling(sensor.mu_max, sensor.mu_min)
        if checks.within("drop", sensor.drop, 0.0, 1.0) == 1.0:
            raise ValueError(f"drop must be less than 1, got {sensor.drop!r}")
        checks.instance("entry", sensor.entry, Entry, "an Entry")

    def frame_steps(self, dt: float) -> int:
        """Return the number of physics steps of `dt` [s] between frames or samples."""
        name, each = self.rate
        steps = round(1.0 / (getattr(self, name) * dt))
        if steps == 0:
            raise ValueError(
                f"{name} must be at most one {each} a physics step, {1.0 / dt:g} Hz, "
                f"got {getattr(self, name)!r}"
            )
        return steps

    def draws(self, dt: float, steps: int) -> int:
        """Return the rows of noise for `steps` steps of `dt` [s], one row per frame or sample."""
        name, each = self.rate
        count = math.ceil(steps / self.frame_steps(dt))
        if count > NOISE_ROWS:
            raise ValueError(
                f"{name} must be at most {NOISE_ROWS} {each}s a control period, "
                f"got {getattr(self, name)!r} Hz in {steps * dt:g} s"
            )
        return count

    def friction(self, line: BaseLine) -> Array:
        """Return the friction that the sensor assumes for all elements of a line.

        If a coefficient of the sensor is None, the line's coefficient is used.
        """
        assumed = line.friction.copy()
        for k, name in enumerate(FRICTIONS):
            if getattr(self, name) is not None:
                assumed[:, :, k] = getattr(self, name)
        return assumed

    @staticmethod
    @kernel_function
    def read(numbers: Array, state: EnvState) -> None:
        """Write the estimated pose and velocity to `state.sensed`."""
        for k in range(SIZE):
            state.sensed[k] = state.sensor_state[k]


@kernel_function
def begin(params: Array, first: int, state: EnvState) -> None:
    """Set estimate and covariance to the prior at entry. `params[first:]` holds `Entry.params`."""
    enter(params, first, state)
    estimate = state.sensor_state
    estimate[ph.AX] = 0.0
    estimate[ph.AY] = 0.0
    for k in range(SIZE * SIZE):
        estimate[COVARIANCE + k] = 0.0
    for k in range(SIZE):
        entry = (0 if k < 2 else 1) if k < 3 else (2 if k < 5 else 3)
        estimate[COVARIANCE + (SIZE + 1) * k] = params[first + entry] ** 2


@kernel_function
def _damp(body: Body, estimate: Array, scratch: Scratch, contacts: ph.Contacts, dt: float) -> None:
    """Write the matrix (M + dt S)^-1 M, which damps velocity errors in a step.

    The matrix is written to `estimate[DECAY:]`. M is the mass matrix divided by the mass. S is the
    derivative of friction with respect to velocity, divided by the mass. On an idle rotor, only
    slip along the axis counts. S is large for contacts that hardly slip.
    """
    table = scratch.table
    xx, xy, yy, xt, yt, tt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(contacts.total):
        kind = scratch.marks[ph.KIND + i]
        if kind == ph.SUPPORT:
            continue
        ux, uy = table[ph.AXIS_X + i], table[ph.AXIS_Y + i]
        lever = uy * table[ph.ARM_X + i] - ux * table[ph.ARM_Y + i]
        slip = (
            ux * estimate[ph.VX]
            + uy * estimate[ph.VY]
            + lever * estimate[ph.OMEGA]
            - table[ph.DRIVE_ALONG + i]
        ) / STICTION_SPEED
        shrunk = 1.0 + slip * slip
        side = table[ph.ARM_X + i]  # lever of a driven module's friction along y
        if kind == ph.DRIVEN:
            aside = estimate[ph.VY] + side * estimate[ph.OMEGA] - table[ph.DRIVE_ACROSS + i]
            shrunk += aside * aside / (STICTION_SPEED * STICTION_SPEED)
        most = dt * table[ph.MU_ALONG + i] * table[ph.NORMAL + i]
        slope = most / (STICTION_SPEED * shrunk * shrunk)
        xx += slope * ux * ux
        xy += slope * ux * uy
        yy += slope * uy * uy
        xt += slope * ux * lever
        yt += slope * uy * lever
        tt += slope * lever * lever
        if kind == ph.DRIVEN:
            yy += slope
            yt += slope * side
            tt += slope * side * side
    xx += 1.0
    yy += 1.0
    tt += body.gyration
    c_xx = yy * tt - yt * yt
    c_xy = xt * yt - xy * tt
    c_xt = xy * yt - xt * yy
    c_yy = xx * tt - xt * xt
    c_yt = xy * xt - xx * yt
    c_tt = xx * yy - xy * xy
    per_determinant = 1.0 / (xx * c_xx + xy * c_xy + xt * c_xt)
    estimate[DECAY] = c_xx * per_determinant
    estimate[DECAY + 1] = c_xy * per_determinant
    estimate[DECAY + 2] = c_xt * per_determinant * body.gyration
    estimate[DECAY + 3] = c_xy * per_determinant
    estimate[DECAY + 4] = c_yy * per_determinant
    estimate[DECAY + 5] = c_yt * per_determinant * body.gyration
    estimate[DECAY + 6] = c_xt * per_determinant
    estimate[DECAY + 7] = c_yt * per_determinant
    estimate[DECAY + 8] = c_tt * per_determinant * body.gyration


@kernel_function
def _widen(estimate: Array, dt: float, density: float, turn_density: float) -> None:
    """Propagate the covariance over a step. Velocity errors are damped as in `_damp`.

    The process noise is `density` [m^2/s^3] in x and y, and `turn_density` [rad^2/s^3].
    """
    half = COVARIANCE + 3  # the column of the first velocity
    low = COVARIANCE + 3 * SIZE  # the row of the first velocity
    for i in range(3):
        for j in range(3):
            estimate[COVARIANCE + SIZE * i + j] += dt * (
                estimate[half + SIZE * i + j]
                + estimate[half + SIZE * j + i]
                + dt * estimate[low + SIZE * i + 3 + j]
            )
    for i in range(3):
        row = half + SIZE * i
        vx = estimate[row] + dt * estimate[low + SIZE * i + 3]
        vy = estimate[row + 1] + dt * estimate[low + SIZE * i + 4]
        omega = estimate[row + 2] + dt * estimate[low + SIZE * i + 5]
        for j in range(3):
            decay = DECAY + 3 * j
            mixed = vx * estimate[decay] + vy * estimate[decay + 1] + omega * estimate[decay + 2]
            estimate[row + j] = mixed
            estimate[low + SIZE * j + i] = mixed
    for _ in range(2):  # D V, transposed, twice: D V D^T
        for i in range(3):  # a column at a time
            column = low + 3 + i
            vx, vy, omega = estimate[column], estimate[column + SIZE], estimate[column + 2 * SIZE]
            for j in range(3):
                decay = DECAY + 3 * j
                estimate[column + SIZE * j] = (
                    vx * estimate[decay] + vy * estimate[decay + 1] + omega * estimate[decay + 2]
                )
        for i in range(3):
            for j in range(i):
                upper, lower = low + SIZE * j + 3 + i, low + SIZE * i + 3 + j
                estimate[upper], estimate[lower] = estimate[lower], estimate[upper]
    estimate[low + 3] += density * dt
    estimate[low + SIZE + 4] += density * dt
    estimate[low + 2 * SIZE + 5] += turn_density * dt


@kernel_function
def predict(params: Array, first: int, state: EnvState, physics: Physics) -> None:
    """Predict an estimate over one step by the physics.

    The prediction uses the true axes, equal stiffness, nominal friction and a centred load. Off the
    surface, the estimated velocity does not change. The process noise is in `params[first:]`.
    """
    estimate = state.sensor_state
    vx, vy, omega = estimate[ph.VX], estimate[ph.VY], estimate[ph.OMEGA]
    move(state, physics, 1.0, assumed_body(state, 0.0, 0.0))
    widen_by_doubt(params, first, estimate, physics.dt, vx, vy, omega)


@inlined
def assumed_body(state: EnvState, com_x: float, com_y: float) -> Body:
    """Return the parcel with its centre of mass at (com_x, com_y) [m] relative to the centroid."""
    return Body(
        state.edges,
        state.body[ph.RADIUS],
        com_x,
        com_y,
        state.body[ph.COM_HEIGHT],
        state.body[ph.GYRATION],
    )


@kernel_function
def move(state: EnvState, physics: Physics, factor: float, body: Body) -> ph.Contacts:
    """Move the estimate of the centre of mass over one step; return the step's contacts.

    `factor` [-] multiplies the rotors' friction along their axes, and `body` is the assumed parcel.
    Also write how much the step damps velocity errors (see `_damp`).
    """
    estimate, dt = state.sensor_state, physics.dt
    grid = Grid(
        state.axis,
        state.direction,
        state.drive,
        state.rotor,
        physics.stiffness,
        physics.friction,
        state.elements.x0,
        state.elements.y0,
        state.elements.pitch_x,
        state.elements.pitch_y,
        factor,
        1.0,
        1.0,
        state.surface[GRAVITY_X],
        state.surface[GRAVITY_Y],
        state.surface[GRAVITY_NORMAL],
    )
    report, contacts = step_implicit(grid, body, estimate, physics.scratch, dt)
    if report >= OFF_SURFACE:
        estimate[ph.X] += dt * estimate[ph.VX]
        estimate[ph.Y] += dt * estimate[ph.VY]
        estimate[ph.THETA] += dt * estimate[ph.OMEGA]
    _damp(body, estimate, physics.scratch, contacts, dt)
    return contacts


@kernel_function
def widen_by_doubt(
    params: Array, first: int, estimate: Array, dt: float, vx: float, vy: float, omega: float
) -> None:
    """Propagate the covariance over a step, and add process noise from `params[first:]`.

    The step begins at a velocity (vx, vy, omega).
    """
    doubt = params[first + FRICTION_ERROR] ** 2 * FRICTION_ERROR_TIME / (dt * dt)
    _widen(
        estimate,
        dt,
        params[first + DENSITY]
        + doubt * ((estimate[ph.VX] - vx) ** 2 + (estimate[ph.VY] - vy) ** 2),
        params[first + TURN_DENSITY] + doubt * (estimate[ph.OMEGA] - omega) ** 2,
    )


@kernel_function
def measure(estimate: Array, by_x: float, by_y: float, by_theta: float, lead: float) -> float:
    """Return the variance of a measured number that depends on the pose `lead` seconds ago.

    `by_x`, `by_y` and `by_theta` are the number's derivatives by x, y and theta of this pose. Also
    write the number's covariance with the state to `estimate[GAIN:]`, where `correct` reads it.
    """
    for i in range(SIZE):
        row = COVARIANCE + SIZE * i
        estimate[GAIN + i] = (
            by_x * (estimate[row] - lead * estimate[row + 3])
            + by_y * (estimate[row + 1] - lead * estimate[row + 4])
            + by_theta * (estimate[row + 2] - lead * estimate[row + 5])
        )
    return (
        by_x * (estimate[GAIN] - lead * estimate[GAIN + 3])
        + by_y * (estimate[GAIN + 1] - lead * estimate[GAIN + 4])
        + by_theta * (estimate[GAIN + 2] - lead * estimate[GAIN + 5])
    )


@kernel_function
def correct(estimate: Array, shift: float, shrink: float) -> None:
    """Correct the estimate with the gain g, the vector that `measure` has stored.

    Add `shift` * g to the estimate. Subtract `shrink` * g g^T from the estimate's covariance.
    """
    for i in range(SIZE):
        estimate[i] += shift * estimate[GAIN + i]
        for j in range(SIZE):
            estimate[COVARIANCE + SIZE * i + j] -= shrink * estimate[GAIN + i] * estimate[GAIN + j]


CONSTANT = LAST  # first column of the constants' estimates
CROSS = CONSTANT + LEARNED  # first column of their covariances with the state, 6 x 3
DOUBT = CROSS + SIZE * LEARNED  # first column of their own covariance, 3 x 3
PULL = DOUBT + LEARNED * LEARNED  # first column of a correction's memory
EFFECT = PULL + LEARNED  # first column of a prediction's memory, velocities by constants, 3 x 3
LEARNING_LAST = EFFECT + 3 * LEARNED

# Prior of the constants in a sensor's params from some column on.
FRICTION_SPREAD, LOAD_SPREAD = range(2)

LEAST_FACTOR, MOST_FACTOR = 0.25, 4.0  # [-] limits of the estimate
FARTHEST_LOAD = 0.5  # [-] maximum offset of the load relative to the half length
THINNEST = 1e-6  # [m^2] minimum squared extent of the contacts in any direction


@kernel_function
def begin_learning(params: Array, first: int, state: EnvState) -> None:
    """Set the estimate: nominal friction, a centred load, and spreads from `params[first:]`."""
    estimate = state.sensor_state
    estimate[CONSTANT] = 1.0
    for k in range(CONSTANT + 1, LEARNING_LAST):
        estimate[k] = 0.0
    for k in range(LEARNED):
        spread = params[first + (FRICTION_SPREAD if k == 0 else LOAD_SPREAD)]
        estimate[DOUBT + (LEARNED + 1) * k] = spread * spread


@kernel_function
def predict_learning(params: Array, first: int, state: EnvState, physics: Physics) -> None:
    """Predict one step with the estimated constants. Update the covariances of the estimate."""
    estimate, scratch, dt = state.sensor_state, physics.scratch, physics.dt
    vx, vy, omega = estimate[ph.VX], estimate[ph.VY], estimate[ph.OMEGA]
    body = assumed_body(state, estimate[CONSTANT + 1], estimate[CONSTANT + 2])
    _to_load(estimate, 1.0)
    contacts = move(state, physics, estimate[CONSTANT], body)
    weight = state.surface[GRAVITY_NORMAL]
    _effect(body, weight, estimate, scratch, contacts, estimate[ph.OMEGA] - omega)
    _to_load(estimate, -1.0)
    widen_by_doubt(params, first, estimate, dt, vx, vy, omega)
    _widen_by_constants(estimate, dt)


@kernel_function
def _to_load(estimate: Array, way: float) -> None:
    """Refer the state to the assumed centre of mass (`way` is 1) or the centroid (`way` is -1)."""
    cosine, sine = math.cos(estimate[ph.THETA]), math.sin(estimate[ph.THETA])
    arm_x = way * (cosine * estimate[CONSTANT + 1] - sine * estimate[CONSTANT + 2])
    arm_y = way * (sine * estimate[CONSTANT + 1] + cosine * estimate[CONSTANT + 2])
    estimate[ph.X] += arm_x
    estimate[ph.Y] += arm_y
    estimate[ph.VX] -= estimate[ph.OMEGA] * arm_y
    estimate[ph.VY] += estimate[ph.OMEGA] * arm_x


@kernel_function
def _effect(
    body: Body, weight: float, estimate: Array, scratch: Scratch, contacts: ph.Contacts, turn: float
) -> None:
    """Write the derivatives of the new velocities by each constant to `estimate[EFFECT:]`.

    The constants are a friction factor and the load's position. The new velocities are the
    velocities after a step.

    Args:
        weight: [m/s^2] total load of the contacts, divided by the parcel's mass.
        estimate: state of the centre of mass at the step's end.
        turn: [rad/s] change of the turning speed in the step.
    """
    table = scratch.table
    friction_gradient(scratch, contacts, estimate[ph.VX], estimate[ph.VY], estimate[ph.OMEGA])
    drag_x, drag_y, drag_turn, all_x, all_y = 0.0, 0.0, 0.0, 0.0, 0.0
    count, mean_x, mean_y = 0, 0.0, 0.0
    for i in range(contacts.total):
        if scratch.marks[ph.KIND + i] != ph.SUPPORT:
            drag_x += table[ph.FORCE_X + i]
            drag_y += table[ph.FORCE_Y + i]
            drag_turn += table[ph.TORQUE + i]
        all_x += table[ph.FORCE_X + i]
        all_y += table[ph.FORCE_Y + i]
        if table[ph.NORMAL + i] > 0.0:
            count += 1
            mean_x += table[ph.ARM_X + i]
            mean_y += table[ph.ARM_Y + i]
    mean_x /= max(1, count)
    mean_y /= max(1, count)
    xx, xy, yy = THINNEST, 0.0, THINNEST
    for i in range(contacts.total):
        if table[ph.NORMAL + i] > 0.0:
            x, y = table[ph.ARM_X + i] - mean_x, table[ph.ARM_Y + i] - mean_y
            xx += x * x
            xy += x * y
            yy += y * y
    per_determinant = weight / (xx * yy - xy * xy)
    # [1/s] and [rad/(m s)] by a metre of the load in x, and in y
    vx_x, vx_y, vy_x, vy_y, turn_x, turn_y = 0.0, 0.0, 0.0, 0.0, -all_y, all_x
    for i in range(contacts.total):
        if table[ph.NORMAL + i] > 0.0:
            x, y = table[ph.ARM_X + i] - mean_x, table[ph.ARM_Y + i] - mean_y
            per_normal = per_determinant / table[ph.NORMAL + i]
            by_x = (yy * x - xy * y) * per_normal
            by_y = (xx * y - xy * x) * per_normal
            vx_x += table[ph.FORCE_X + i] * by_x
            vx_y += table[ph.FORCE_X + i] * by_y
            vy_x += table[ph.FORCE_Y + i] * by_x
            vy_y += table[ph.FORCE_Y + i] * by_y
            turn_x += table[ph.TORQUE + i] * by_x
            turn_y += table[ph.TORQUE + i] * by_y
    per_gyration = 1.0 / body.gyration
    cosine, sine = math.cos(estimate[ph.THETA]), math.sin(estimate[ph.THETA])
    per_factor = 1.0 / estimate[CONSTANT]
    estimate[EFFECT] = -drag_x * per_factor
    estimate[EFFECT + 3] = -drag_y * per_factor
    estimate[EFFECT + 6] = -drag_turn * per_gyration * per_factor
    # The centroid moves with the load, plus the turning of their distance.
    _write_load(estimate, EFFECT + 1, -vx_x, turn - vx_y, cosine, sine)
    _write_load(estimate, EFFECT + 4, -turn - vy_x, -vy_y, cosine, sine)
    _write_load(estimate, EFFECT + 7, -turn_x * per_gyration, -turn_y * per_gyration, cosine, sine)


@kernel_function
def _write_load(
    estimate: Array, place: int, by_x: float, by_y: float, cosine: float, sine: float
) -> None:
    """Write a velocity's derivatives with respect to the load's x and y in the base's frame.

    The two derivatives are written to `estimate[place:]`. `by_x` and `by_y` are the derivatives
    with respect to x and y in the world's frame. `cosine` and `sine` belong to the base's angle.
    """
    estimate[place] = by_x * cosine + by_y * sine
    estimate[place + 1] = by_y * cosine - by_x * sine


@kernel_function
def _widen_by_constants(estimate: Array, dt: float) -> None:
    """Propagate over a step the covariances between the state and the constants.

    Also add the effect of the constants' errors to the state's covariance.
    """
    half = CROSS + 3 * LEARNED  # the row of the first velocity
    for j in range(LEARNED):
        for i in range(3):
            estimate[CROSS + LEARNED * i + j] += dt * estimate[half + LEARNED * i + j]
        vx, vy, omega = (
            estimate[half + j],
            estimate[half + LEARNED + j],
            estimate[half + 2 * LEARNED + j],
        )
        x, y, turn = estimate[EFFECT + j], estimate[EFFECT + 3 + j], estimate[EFFECT + 6 + j]
        for i in range(3):
            a, b, c = (
                estimate[DECAY + 3 * i],
                estimate[DECAY + 3 * i + 1],
                estimate[DECAY + 3 * i + 2],
            )
            estimate[half + LEARNED * i + j] = a * vx + b * vy + c * omega
            estimate[EFFECT + 3 * i + j] = a * x + b * y + c * turn
    for i in range(3):
        for row in range(SIZE):
            owed = 0.0
            for j in range(LEARNED):
                owed += estimate[CROSS + LEARNED * row + j] * estimate[EFFECT + 3 * i + j]
            estimate[COVARIANCE + SIZE * row + 3 + i] += owed
            estimate[COVARIANCE + SIZE * (3 + i) + row] += owed
    for i in range(3):
        for j in range(LEARNED):
            owed = 0.0
            for k in range(LEARNED):
                owed += estimate[EFFECT + 3 * i + k] * estimate[DOUBT + LEARNED * k + j]
            for k in range(3):
                share = owed * estimate[EFFECT + 3 * k + j]
                estimate[COVARIANCE + SIZE * (3 + i) + 3 + k] += share
            estimate[half + LEARNED * i + j] += owed


@kernel_function
def measure_constants(estimate: Array, k: int, lead: float) -> None:
    """Write the covariances of the constants with one coordinate of a past pose.

    The coordinate has the index `k`. The pose is `lead` [s] old. `estimate[PULL:]` gets the result.
    """
    row, rate = CROSS + LEARNED * k, CROSS + LEARNED * (3 + k)
    for j in range(LEARNED):
        estimate[PULL + j] = estimate[row + j] - lead * estimate[rate + j]


@kernel_function
def correct_constants(state: EnvState, shift: float, shrink: float) -> None:
    """Add `shift` times the gain `estimate[PULL:]` to the constants, within the constants' bounds.

    A product of two gains, times `shrink`, is subtracted from each covariance between constants,
    and from each covariance between a constant and the motion.
    """
    estimate = state.sensor_state
    for j in range(LEARNED):
        estimate[CONSTANT + j] += shift * estimate[PULL + j]
        for i in range(SIZE):
            estimate[CROSS + LEARNED * i + j] -= shrink * estimate[GAIN + i] * estimate[PULL + j]
        for k in range(LEARNED):
            estimate[DOUBT + LEARNED * j + k] -= shrink * estimate[PULL + j] * estimate[PULL + k]
    farthest = FARTHEST_LOAD * state.body[ph.HALF_LENGTH]
    estimate[CONSTANT] = bounded(estimate[CONSTANT], LEAST_FACTOR, MOST_FACTOR)
    for j in range(1, LEARNED):
        estimate[CONSTANT + j] = bounded(estimate[CONSTANT + j], -farthest, farthest)
