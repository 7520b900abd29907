"""An observer's estimate of state and covariance: predicted by the physics, corrected by a scalar.

It lies in a lane's `kept`: first the state as the physics has it, then the covariance.
"""

from dataclasses import dataclass

from surface_gym.dynamics.compiled import inlined, lane_function
from surface_gym.dynamics.step import OFF_SURFACE, step_implicit
from surface_gym.dynamics.types import (
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
from surface_gym.lanes.lane import Lane
from surface_gym.lanes.memory import GRAVITY_ALONG, GRAVITY_NORMAL
from surface_gym.plants import Plant
from surface_gym.sensors.entry import enter
from surface_gym.sensors.sensor import Physics, Sensor

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
    """A sensor that makes pose and velocity of what it sees by predicting it."""

    watches = True

    def friction(self, plant: Plant) -> Array:
        """The plant's where a coefficient is None; else one that is the same everywhere."""
        assumed = plant.friction.copy()
        for k, name in enumerate(("mu_max", "mu_min", "mu_support")):
            if getattr(self, name) is not None:
                assumed[:, :, k] = getattr(self, name)
        return assumed

    @staticmethod
    @lane_function
    def estimate(numbers: Array, lane: Lane) -> None:
        """Show what is estimated of pose and velocity."""
        for k in range(SIZE):
            lane.sensed[k] = lane.kept[k]


@lane_function
def begin(settings: Array, first: int, lane: Lane) -> None:
    """Set a lane's estimate at a start to what is known of it, its covariance to that of the Entry,
    which is in `settings` from `first` on.
    """
    enter(settings, first, lane)
    kept = lane.kept
    kept[AX] = 0.0
    kept[AY] = 0.0
    for k in range(SIZE * SIZE):
        kept[COVARIANCE + k] = 0.0
    for k in range(SIZE):
        entry = (0 if k < 2 else 1) if k < 3 else (2 if k < 5 else 3)
        kept[COVARIANCE + (SIZE + 1) * k] = settings[first + entry] ** 2


@lane_function
def _damp(body: Body, kept: Array, scratch: Scratch, contacts: Contacts, dt: float) -> None:
    """Write how a step damps errors in velocity, (M + dt S)^-1 M, into `kept` from DECAY on.

    S is the friction's slope over the slip along each rotor's axis: steep where it holds.
    """
    table = scratch.table
    xx, xy, yy, xt, yt, tt = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(contacts.total):
        if not scratch.marks[ROTOR + i]:
            continue
        ux, uy = table[AXIS_X + i], table[AXIS_Y + i]
        lever = uy * table[ARM_X + i] - ux * table[ARM_Y + i]
        slip = (ux * kept[VX] + uy * kept[VY] + lever * kept[OMEGA]) / STICTION_SPEED
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
    kept[DECAY] = c_xx * per_determinant
    kept[DECAY + 1] = c_xy * per_determinant
    kept[DECAY + 2] = c_xt * per_determinant * body.gyration
    kept[DECAY + 3] = c_xy * per_determinant
    kept[DECAY + 4] = c_yy * per_determinant
    kept[DECAY + 5] = c_yt * per_determinant * body.gyration
    kept[DECAY + 6] = c_xt * per_determinant
    kept[DECAY + 7] = c_yt * per_determinant
    kept[DECAY + 8] = c_tt * per_determinant * body.gyration


@lane_function
def _widen(kept: Array, dt: float, density: float, turn_density: float) -> None:
    """Carry the covariance over a step, the velocity's errors damped as `_damp` wrote."""
    half = COVARIANCE + 3  # the column of the first velocity
    low = COVARIANCE + 3 * SIZE  # the row of the first velocity
    for i in range(3):
        for j in range(3):
            kept[COVARIANCE + SIZE * i + j] += dt * (
                kept[half + SIZE * i + j]
                + kept[half + SIZE * j + i]
                + dt * kept[low + SIZE * i + 3 + j]
            )
    for i in range(3):
        row = half + SIZE * i
        vx = kept[row] + dt * kept[low + SIZE * i + 3]
        vy = kept[row + 1] + dt * kept[low + SIZE * i + 4]
        omega = kept[row + 2] + dt * kept[low + SIZE * i + 5]
        for j in range(3):
            decay = DECAY + 3 * j
            mixed = vx * kept[decay] + vy * kept[decay + 1] + omega * kept[decay + 2]
            kept[row + j] = mixed
            kept[low + SIZE * j + i] = mixed
    for _ in range(2):  # D V, transposed, twice: D V D^T
        for i in range(3):  # a column at a time
            column = low + 3 + i
            vx, vy, omega = kept[column], kept[column + SIZE], kept[column + 2 * SIZE]
            for j in range(3):
                decay = DECAY + 3 * j
                kept[column + SIZE * j] = (
                    vx * kept[decay] + vy * kept[decay + 1] + omega * kept[decay + 2]
                )
        for i in range(3):
            for j in range(i):
                upper, lower = low + SIZE * j + 3 + i, low + SIZE * i + 3 + j
                kept[upper], kept[lower] = kept[lower], kept[upper]
    kept[low + 3] += density * dt
    kept[low + SIZE + 4] += density * dt
    kept[low + 2 * SIZE + 5] += turn_density * dt


@lane_function
def predict(settings: Array, first: int, lane: Lane, physics: Physics) -> None:
    """Move a lane's estimate over one step by the physics, the axes as they are, the stiffness of
    all elements the same, friction nominal and the load over the base's centroid.

    What is doubted is in `settings` from `first` on. Off the surface the estimate moves on at its
    velocity.
    """
    kept = lane.kept
    vx, vy, omega = kept[VX], kept[VY], kept[OMEGA]
    move(lane, physics, 1.0, assumed_body(lane, 0.0, 0.0))
    widen_by_doubt(settings, first, kept, physics.dt, vx, vy, omega)


@inlined
def assumed_body(lane: Lane, com_x: float, com_y: float) -> Body:
    """A lane's parcel, its centre of mass assumed to be at a place [m] from the centroid."""
    return Body(
        lane.edges,
        lane.body[RADIUS],
        com_x,
        com_y,
        lane.body[COM_HEIGHT],
        lane.body[GYRATION],
    )


@lane_function
def move(lane: Lane, physics: Physics, factor: float, body: Body) -> Contacts:
    """Move the state in `lane.kept`, the centre of mass's, over one step, and write how that damps
    errors; the step's contacts.

    Args:
        lane: whose axes stand as they are.
        physics: as the sensor assumes it.
        factor: [-] by which the rotors' friction along their axes is multiplied.
        body: the parcel as it is assumed to be.
    """
    kept, dt = lane.kept, physics.dt
    grid = Grid(
        lane.axis,
        lane.direction,
        lane.rotor,
        physics.stiffness,
        physics.friction,
        lane.elements.x0,
        lane.elements.y0,
        lane.elements.pitch_x,
        lane.elements.pitch_y,
        factor,
        1.0,
        1.0,
        lane.surface[GRAVITY_ALONG],
        lane.surface[GRAVITY_NORMAL],
    )
    report, contacts = step_implicit(grid, body, kept, physics.scratch, dt)
    if report >= OFF_SURFACE:
        kept[X] += dt * kept[VX]
        kept[Y] += dt * kept[VY]
        kept[THETA] += dt * kept[OMEGA]
    _damp(body, kept, physics.scratch, contacts, dt)
    return contacts


@lane_function
def widen_by_doubt(
    settings: Array, first: int, kept: Array, dt: float, vx: float, vy: float, omega: float
) -> None:
    """Carry the covariance over a step that began at a velocity (vx, vy, omega), and widen it by
    what is doubted, in `settings` from `first` on.
    """
    doubt = settings[first + FRICTION_ERROR] ** 2 * FRICTION_ERROR_TIME / (dt * dt)
    _widen(
        kept,
        dt,
        settings[first + DENSITY] + doubt * ((kept[VX] - vx) ** 2 + (kept[VY] - vy) ** 2),
        settings[first + TURN_DENSITY] + doubt * (kept[OMEGA] - omega) ** 2,
    )


@lane_function
def measure(kept: Array, by_x: float, by_y: float, by_theta: float, lead: float) -> float:
    """Variance of a function of the pose `lead` seconds ago, given by its derivatives.

    Its covariance with the state is left in `kept` from GAIN on, for `correct`.
    """
    for i in range(SIZE):
        row = COVARIANCE + SIZE * i
        kept[GAIN + i] = (
            by_x * (kept[row] - lead * kept[row + 3])
            + by_y * (kept[row + 1] - lead * kept[row + 4])
            + by_theta * (kept[row + 2] - lead * kept[row + 5])
        )
    return (
        by_x * (kept[GAIN] - lead * kept[GAIN + 3])
        + by_y * (kept[GAIN + 1] - lead * kept[GAIN + 4])
        + by_theta * (kept[GAIN + 2] - lead * kept[GAIN + 5])
    )


@lane_function
def correct(kept: Array, shift: float, shrink: float) -> None:
    """Move the estimate by `shift`, and lessen its covariance by `shrink`, along what `measure`
    left: both a unit of it.
    """
    for i in range(SIZE):
        kept[i] += shift * kept[GAIN + i]
        for j in range(SIZE):
            kept[COVARIANCE + SIZE * i + j] -= shrink * kept[GAIN + i] * kept[GAIN + j]
