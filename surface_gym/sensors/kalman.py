"""A Kalman filter on pose and velocity: predicted by the physics, corrected by scalars.

It lies in a lane's `estimate`: first the state as the physics has it, then the covariance.
"""

from dataclasses import dataclass

from surface_gym.lines import BaseLine
from surface_gym.physics.jit import inlined, kernel_function
from surface_gym.physics.step import OFF_SURFACE, step_implicit
from surface_gym.physics.types import (
    ARM_X,
    ARM_Y,
    AX,
    AXIS_X,
    AXIS_Y,
    AY,
    COM_HEIGHT,
    GYRATION,
    MU_ALONG,
    NORMAL,
    OMEGA,
    RADIUS,
    ROTOR,
    STATE_SIZE,
    THETA,
    VX,
    VY,
    Array,
    Body,
    Contacts,
    Grid,
    Scratch,
    X,
    Y,
)
from surface_gym.sensors.base import Physics, Sensor, enter
from surface_gym.state import GRAVITY_ALONG, GRAVITY_NORMAL, EnvState

SIZE = 6  # of pose and velocity
COVARIANCE = STATE_SIZE  # first column; row by row
GAIN = COVARIANCE + SIZE * SIZE  # first column of a correction's own memory
DECAY = GAIN + SIZE  # first column of a prediction's own memory, 3 x 3
LAST = DECAY + 9

# What a prediction doubts, in a sensor's settings from some column on: the densities of the
# physics' error, and the share of an acceleration by friction that it may be off.
DENSITY, TURN_DENSITY, FRICTION_ERROR, MODEL_SIZE = range(4)

FRICTION_ERROR_TIME = 0.04  # [s] for which friction errs alike, a control period
STICTION_SPEED = 0.03  # [m/s] a rotor that slips along its axis by less than this holds the parcel


@dataclass(frozen=True)
class Observer(Sensor):
    """A sensor that estimates pose and velocity by prediction and correction."""

    watches = True

    def friction(self, plant: BaseLine) -> Array:
        """Return the line's friction where a coefficient is None, else the same everywhere."""
        assumed = plant.friction.copy()
        for k, name in enumerate(("mu_max", "mu_min", "mu_support")):
            if getattr(self, name) is not None:
                assumed[:, :, k] = getattr(self, name)
        return assumed

    @staticmethod
    @kernel_function
    def read(numbers: Array, state: EnvState) -> None:
        """Write the estimated pose and velocity."""
        for k in range(SIZE):
            state.sensed[k] = state.sensor_state[k]


@kernel_function
def begin(settings: Array, first: int, state: EnvState) -> None:
    """Set an estimate to its prior at a start, and its covariance to that of the Entry, which is in
    `settings` from `first` on.
    """
    enter(settings, first, state)
    estimate = state.sensor_state
    estimate[AX] = 0.0
    estimate[AY] = 0.0
    for k in range(SIZE * SIZE):
        estimate[COVARIANCE + k] = 0.0
    for k in range(SIZE):
        entry = (0 if k < 2 else 1) if k < 3 else (2 if k < 5 else 3)
        estimate[COVARIANCE + (SIZE + 1) * k] = settings[first + entry] ** 2


@kernel_function
def _damp(body: Body, estimate: Array, scratch: Scratch, contacts: Contacts, dt: float) -> None:
    """Write how a step damps errors in velocity, (M + dt S)^-1 M, into `estimate` from DECAY on.

    S is the friction's slope over the slip along each rotor's axis: steep where it holds.
    """
    table = scratch.table
    xx, xy, yy, xt, yt, tt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(contacts.total):
        if not scratch.marks[ROTOR + i]:
            continue
        ux, uy = table[AXIS_X + i], table[AXIS_Y + i]
        lever = uy * table[ARM_X + i] - ux * table[ARM_Y + i]
        slip = (ux * estimate[VX] + uy * estimate[VY] + lever * estimate[OMEGA]) / STICTION_SPEED
        shrunk = 1.0 + slip * slip
        most = dt * table[MU_ALONG + i] * table[NORMAL + i]
        slope = most / (STICTION_SPEED * shrunk * shrunk)
        xx += slope * ux * ux
        xy += slope * ux * uy
        yy += slope * uy * uy
        xt += slope * ux * lever
        yt += slope * uy * lever
        tt += slope * lever * lever
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
    """Carry the covariance over a step, the velocity's errors damped as `_damp` wrote."""
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
def predict(settings: Array, first: int, state: EnvState, physics: Physics) -> None:
    """Predict an estimate over one step by the physics: axes as they are, equal stiffness of all
    elements, nominal friction, a centred load.

    What is doubted is in `settings` from `first` on. Off the surface the estimate moves on at its
    velocity.
    """
    estimate = state.sensor_state
    vx, vy, omega = estimate[VX], estimate[VY], estimate[OMEGA]
    move(state, physics, 1.0, assumed_body(state, 0.0, 0.0))
    widen_by_doubt(settings, first, estimate, physics.dt, vx, vy, omega)


@inlined
def assumed_body(state: EnvState, com_x: float, com_y: float) -> Body:
    """Return the parcel with its centre of mass assumed at a place [m] from the centroid."""
    return Body(
        state.edges,
        state.body[RADIUS],
        com_x,
        com_y,
        state.body[COM_HEIGHT],
        state.body[GYRATION],
    )


@kernel_function
def move(state: EnvState, physics: Physics, factor: float, body: Body) -> Contacts:
    """Move the state in `state.sensor_state`, the centre of mass's, over one step; write how that
    damps errors; return the step's contacts.

    Args:
        lane: whose axes stand as they are.
        physics: as the sensor assumes it.
        factor: [-] by which the rotors' friction along their axes is multiplied.
        body: the parcel as it is assumed to be.
    """
    estimate, dt = state.sensor_state, physics.dt
    grid = Grid(
        state.axis,
        state.direction,
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
        state.surface[GRAVITY_ALONG],
        state.surface[GRAVITY_NORMAL],
    )
    report, contacts = step_implicit(grid, body, estimate, physics.scratch, dt)
    if report >= OFF_SURFACE:
        estimate[X] += dt * estimate[VX]
        estimate[Y] += dt * estimate[VY]
        estimate[THETA] += dt * estimate[OMEGA]
    _damp(body, estimate, physics.scratch, contacts, dt)
    return contacts


@kernel_function
def widen_by_doubt(
    settings: Array, first: int, estimate: Array, dt: float, vx: float, vy: float, omega: float
) -> None:
    """Carry the covariance over a step that began at a velocity (vx, vy, omega), and add the
    process noise, in `settings` from `first` on.
    """
    doubt = settings[first + FRICTION_ERROR] ** 2 * FRICTION_ERROR_TIME / (dt * dt)
    _widen(
        estimate,
        dt,
        settings[first + DENSITY] + doubt * ((estimate[VX] - vx) ** 2 + (estimate[VY] - vy) ** 2),
        settings[first + TURN_DENSITY] + doubt * (estimate[OMEGA] - omega) ** 2,
    )


@kernel_function
def measure(estimate: Array, by_x: float, by_y: float, by_theta: float, lead: float) -> float:
    """Return the variance of a function of the pose `lead` seconds ago, given by its derivatives.

    Its covariance with the state is left in `estimate` from GAIN on, for `correct`.
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
    """Move the estimate by `shift` and shrink its covariance by `shrink`, along what `measure`
    left, both per unit.
    """
    for i in range(SIZE):
        estimate[i] += shift * estimate[GAIN + i]
        for j in range(SIZE):
            estimate[COVARIANCE + SIZE * i + j] -= shrink * estimate[GAIN + i] * estimate[GAIN + j]
