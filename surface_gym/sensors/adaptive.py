"""The augmented Kalman filter of `AdaptiveCamera`: friction and load estimated beside the motion.

The observer's state goes on by three constants: the factor of mu_max, and the place of the centre
of mass in the base's frame. How each changes a step's velocities follows from the step's own
contacts: friction grows with the factor, and a load that lies elsewhere leans on other elements
(Eq. 1).
"""

import math

from surface_gym.physics.contacts import bounded
from surface_gym.physics.friction import friction_gradient
from surface_gym.physics.jit import kernel_function
from surface_gym.physics.types import (
    ARM_X,
    ARM_Y,
    FORCE_X,
    FORCE_Y,
    HALF_LENGTH,
    NORMAL,
    OMEGA,
    ROTOR,
    THETA,
    TORQUE,
    VX,
    VY,
    Array,
    Body,
    Contacts,
    Scratch,
    X,
    Y,
)
from surface_gym.sensors.base import LEARNED, Physics
from surface_gym.sensors.kalman import (
    COVARIANCE,
    DECAY,
    GAIN,
    LAST,
    SIZE,
    assumed_body,
    move,
    widen_by_doubt,
)
from surface_gym.state import GRAVITY_NORMAL, EnvState

CONSTANT = LAST  # first column of their estimates
CROSS = CONSTANT + LEARNED  # of their covariances with the state, 6 x 3
DOUBT = CROSS + SIZE * LEARNED  # of their own covariance, 3 x 3
PULL = DOUBT + LEARNED * LEARNED  # of a correction's own memory
EFFECT = PULL + LEARNED  # of a prediction's own memory, velocities by constants, 3 x 3
LEARNING_LAST = EFFECT + 3 * LEARNED

# What is known of the constants before, in a sensor's settings from some column on.
FRICTION_SPREAD, LOAD_SPREAD = range(2)

LEAST_FACTOR, MOST_FACTOR = 0.25, 4.0  # [-] no estimate goes beyond
FARTHEST_LOAD = 0.5  # [-] of the half length
THINNEST = 1e-6  # [m^2] squared extent of the contacts in any direction, at least


@kernel_function
def begin_learning(settings: Array, first: int, state: EnvState) -> None:
    """Begin with nominal friction, a centred load, and variances in `settings` from `first` on."""
    estimate = state.sensor_state
    estimate[CONSTANT] = 1.0
    for k in range(CONSTANT + 1, LEARNING_LAST):
        estimate[k] = 0.0
    for k in range(LEARNED):
        spread = settings[first + (FRICTION_SPREAD if k == 0 else LOAD_SPREAD)]
        estimate[DOUBT + (LEARNED + 1) * k] = spread * spread


@kernel_function
def predict_learning(settings: Array, first: int, state: EnvState, physics: Physics) -> None:
    """Predict as `kalman.predict` does, by the estimated constants, and carry on their effect."""
    estimate, scratch, dt = state.sensor_state, physics.scratch, physics.dt
    vx, vy, omega = estimate[VX], estimate[VY], estimate[OMEGA]
    body = assumed_body(state, estimate[CONSTANT + 1], estimate[CONSTANT + 2])
    _to_load(estimate, 1.0)
    contacts = move(state, physics, estimate[CONSTANT], body)
    weight = state.surface[GRAVITY_NORMAL]
    _effect(body, weight, estimate, scratch, contacts, estimate[OMEGA] - omega)
    _to_load(estimate, -1.0)
    widen_by_doubt(settings, first, estimate, dt, vx, vy, omega)
    _widen_by_constants(estimate, dt)


@kernel_function
def _to_load(estimate: Array, way: float) -> None:
    """Turn the state of the base's centroid into that of the centre of mass; `way` -1 turns it
    back.
    """
    cosine, sine = math.cos(estimate[THETA]), math.sin(estimate[THETA])
    arm_x = way * (cosine * estimate[CONSTANT + 1] - sine * estimate[CONSTANT + 2])
    arm_y = way * (sine * estimate[CONSTANT + 1] + cosine * estimate[CONSTANT + 2])
    estimate[X] += arm_x
    estimate[Y] += arm_y
    estimate[VX] -= estimate[OMEGA] * arm_y
    estimate[VY] += estimate[OMEGA] * arm_x


@kernel_function
def _effect(
    body: Body, weight: float, estimate: Array, scratch: Scratch, contacts: Contacts, turn: float
) -> None:
    """Write the derivatives of a step's velocities by each constant into `estimate` from EFFECT on.

    Args:
        body: the parcel.
        weight: [m/s^2] what the contacts bear.
        estimate: state of the centre of mass at the step's end.
        scratch: of the step.
        contacts: of the step.
        turn: [rad/s] by which the step changed the speed of turning.
    """
    table = scratch.table
    friction_gradient(scratch, contacts, estimate[VX], estimate[VY], estimate[OMEGA])
    drag_x, drag_y, drag_turn, all_x, all_y = 0.0, 0.0, 0.0, 0.0, 0.0
    count, mean_x, mean_y = 0, 0.0, 0.0
    for i in range(contacts.total):
        if scratch.marks[ROTOR + i]:
            drag_x += table[FORCE_X + i]
            drag_y += table[FORCE_Y + i]
            drag_turn += table[TORQUE + i]
        all_x += table[FORCE_X + i]
        all_y += table[FORCE_Y + i]
        if table[NORMAL + i] > 0.0:
            count += 1
            mean_x += table[ARM_X + i]
            mean_y += table[ARM_Y + i]
    mean_x /= max(1, count)
    mean_y /= max(1, count)
    xx, xy, yy = THINNEST, 0.0, THINNEST
    for i in range(contacts.total):
        if table[NORMAL + i] > 0.0:
            x, y = table[ARM_X + i] - mean_x, table[ARM_Y + i] - mean_y
            xx += x * x
            xy += x * y
            yy += y * y
    per_determinant = weight / (xx * yy - xy * xy)
    # [1/s] and [rad/(m s)] by a metre of the load in x, and in y
    vx_x, vx_y, vy_x, vy_y, turn_x, turn_y = 0.0, 0.0, 0.0, 0.0, -all_y, all_x
    for i in range(contacts.total):
        if table[NORMAL + i] > 0.0:
            x, y = table[ARM_X + i] - mean_x, table[ARM_Y + i] - mean_y
            per_normal = per_determinant / table[NORMAL + i]
            by_x = (yy * x - xy * y) * per_normal
            by_y = (xx * y - xy * x) * per_normal
            vx_x += table[FORCE_X + i] * by_x
            vx_y += table[FORCE_X + i] * by_y
            vy_x += table[FORCE_Y + i] * by_x
            vy_y += table[FORCE_Y + i] * by_y
            turn_x += table[TORQUE + i] * by_x
            turn_y += table[TORQUE + i] * by_y
    per_gyration = 1.0 / body.gyration
    cosine, sine = math.cos(estimate[THETA]), math.sin(estimate[THETA])
    per_factor = 1.0 / estimate[CONSTANT]
    estimate[EFFECT] = -drag_x * per_factor
    estimate[EFFECT + 3] = -drag_y * per_factor
    estimate[EFFECT + 6] = -drag_turn * per_gyration * per_factor
    # The centroid moves as the load does, turned by their distance.
    _write_load(estimate, EFFECT + 1, -vx_x, turn - vx_y, cosine, sine)
    _write_load(estimate, EFFECT + 4, -turn - vy_x, -vy_y, cosine, sine)
    _write_load(estimate, EFFECT + 7, -turn_x * per_gyration, -turn_y * per_gyration, cosine, sine)


@kernel_function
def _write_load(
    estimate: Array, place: int, by_x: float, by_y: float, cosine: float, sine: float
) -> None:
    """Write a derivative by the load's place in the world as those by its place in the base."""
    estimate[place] = by_x * cosine + by_y * sine
    estimate[place + 1] = by_y * cosine - by_x * sine


@kernel_function
def _widen_by_constants(estimate: Array, dt: float) -> None:
    """Carry the constants' covariances over a step, and widen the state's by what they add."""
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
    """Write the constants' covariance with the pose's coordinate `k` of `lead` seconds ago into
    `estimate` from PULL on.
    """
    row, rate = CROSS + LEARNED * k, CROSS + LEARNED * (3 + k)
    for j in range(LEARNED):
        estimate[PULL + j] = estimate[row + j] - lead * estimate[rate + j]


@kernel_function
def correct_constants(state: EnvState, shift: float, shrink: float) -> None:
    """Move the constants by `shift` and shrink their covariances by `shrink`, along the
    measurement.
    """
    estimate = state.sensor_state
    for j in range(LEARNED):
        estimate[CONSTANT + j] += shift * estimate[PULL + j]
        for i in range(SIZE):
            estimate[CROSS + LEARNED * i + j] -= shrink * estimate[GAIN + i] * estimate[PULL + j]
        for k in range(LEARNED):
            estimate[DOUBT + LEARNED * j + k] -= shrink * estimate[PULL + j] * estimate[PULL + k]
    farthest = FARTHEST_LOAD * state.body[HALF_LENGTH]
    estimate[CONSTANT] = bounded(estimate[CONSTANT], LEAST_FACTOR, MOST_FACTOR)
    for j in range(1, LEARNED):
        estimate[CONSTANT + j] = bounded(estimate[CONSTANT + j], -farthest, farthest)
