"""Presence: on/off sensors under the base, an observer, and physical bounds on its estimate."""

import math
from dataclasses import dataclass, field

from surface_gym import checks
from surface_gym.compiler.jit import kernel_function
from surface_gym.physics.types import GYRATION, OMEGA, RADIUS, THETA, VX, VY, Array, X, Y
from surface_gym.sensors import kalman
from surface_gym.sensors.base import Entry, Physics
from surface_gym.sensors.kalman import COVARIANCE, LAST, MODEL_SIZE, SIZE, Observer
from surface_gym.sensors.switches import agree, mean_of_pressed, take_contradictions, take_switches
from surface_gym.state import GRAVITY_X, GRAVITY_Y, EnvState

SURE = 3.0  # standard deviations of an entry that count
# [-] of the energy that a load over the centroid has at most: over one off centre the centroid is
# faster than the load, and parcels push each other.
MARGIN = 4.0
# No parcel of any task is faster, and every observation has room for as much.
FASTEST = 9.0  # [m/s]
FASTEST_TURN = 100.0  # [rad/s]
MOST_TURN = 32.0 * math.pi  # [rad] of theta; whole turns beyond are not counted


@kernel_function
def most_energy(state: EnvState) -> float:
    """Return the most energy [m^2/s^2] of a parcel, vx^2 + vy^2 + (gyration radius x omega)^2.

    Modules brake and do not push, so that no energy comes on top of that of the entry, which
    `state.sensor_state` holds, and of the way down the whole surface.
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
    """Bring the estimate back over the surface, and slow it down to an energy [m^2/s^2]."""
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
    """Bring a coordinate back into [low, high]."""
    if estimate[k] < low:
        estimate[k] = low
    elif estimate[k] > high:
        estimate[k] = high


# Columns of the params; the Entry comes last.
(
    EVERY,  # physics steps from sample to sample
    DROP,
    TOLERANCE,
    MODEL,  # what the observer doubts
) = range(4)
ENTRY = MODEL + MODEL_SIZE
# Numbers kept after the observer's: the base's pose at the last sample, and its step; and what
# energy the parcel can have at most. The pattern of that sample is worked out again from the pose,
# instead of kept module by module.
SAMPLED, STEP, ENERGY = LAST, LAST + 3, LAST + 4


@dataclass(frozen=True)
class Presence(Observer):
    """A sensor of which rotors the parcel covers, by an on/off switch in each module; supports have
    none.

    An observer makes pose and velocity of it. It moves its estimate by the same physics, with the
    axes as they are and with nominal friction, the load over the base's centroid; and its
    uncertainty as friction damps it. A module that switches says that the perimeter passed its
    centre since the last sample; one whose state contradicts the estimate, that the perimeter lies
    on its other side: each is one equation, as a Kalman filter takes it. Of a start, `entry` is
    known.

    Where that leaves the estimate in contradiction, it is moved, least, until it agrees with every
    module; where it cannot be, it is looked for around the pressed ones. It stays over the surface,
    and no faster than a parcel of that entry can be.

    What to expect, over all tasks, 37 controllers and both boxes, at a pitch of 100 mm: where the
    world is as assumed, half of the errors in position are up to 1.3 mm and 99.9 % below 21 mm.
    With a load off centre by up to half the way to the edge 99.9 % are below 70 mm, the worst is
    122 mm; with friction 0.8 or 1.2 of the assumed 46 mm and 79 mm. With everything wrong at once,
    single errors of some 0.3 m remain: of parcels that leave a line, with a rotor or two pressed,
    or none, which say little. Headings may then err by any angle, and a square's slip by a quarter
    turn.
    """

    sample_rate: float = 200.0  # [Hz] of all sensors together; at most one sample a physics step
    drop: float = 0.0  # [-] probability of a sample to be lost
    mu_max: float | None = None  # [-] friction the observer assumes; None: the line's own
    mu_min: float | None = None  # [-]
    mu_support: float | None = None  # [-]
    friction_error: float = 0.0  # [-] share by which what friction does may be off
    acceleration_density: float = 0.1  # [m^2/s^3] of the physics' error, in x and in y
    turn_density: float = 5.0  # [rad^2/s^3] of the physics' error in turning
    tolerance: float = 0.001  # [m] of where a sensor switches
    entry: Entry = field(default_factory=Entry)  # what is known of a parcel as it enters

    rate = ("sample_rate", "sample")
    sensor_size = ENERGY + 1

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.positive("sample_rate", self.sample_rate, *checks.FRAME_RATE)
        checks.positive("tolerance", self.tolerance, *checks.TOLERANCE)

    def numbers(self, dt: float) -> tuple[float, ...]:
        """Return the parameters as compiled code reads them, for physics steps of `dt` [s]."""
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
        """Predict over a physics step, and correct by a sample if one is due."""
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
        # Where no switch is pressed it is not known where the parcel has left the rotors to.
        if mean_of_pressed(state)[0] > 0 and take_contradictions(state, tolerance) > 0.0:
            agree(state, tolerance)
        keep_possible(state, state.sensor_state[ENERGY])
        _keep_sample(state, state.steps)


@kernel_function
def _keep_sample(state: EnvState, step: int) -> None:
    for k in range(3):
        state.sensor_state[SAMPLED + k] = state.truth[k]
    state.sensor_state[STEP] = step
