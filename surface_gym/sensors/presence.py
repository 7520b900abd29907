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
    """Return the maximum energy [m^2/s^2], vx^2 + vy^2 + (gyration radius x omega)^2.

    Modules brake and do not push. So the energy is at most the entry's energy in
    `state.sensor_state` plus the potential energy of the whole surface.
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
    """Move the estimate back over the surface, and limit its energy [m^2/s^2]."""
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
    """Limit a coordinate to [low, high]."""
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
    """An on/off switch in each rotor module, which senses whether the parcel covers it.

    An observer estimates pose and velocity from the switches. It predicts by the same physics with
    the true axes, nominal friction and a centred load, and propagates its uncertainty. A switching
    module means that the perimeter passed the module's centre since the last sample. If a switch
    contradicts the estimate, the perimeter is on the other side of the module. Each switching or
    contradicting module gives one equation for a Kalman filter. `entry` describes the prior at the
    start.

    If contradictions remain, the estimate is moved as little as possible until it agrees with every
    module. If that fails, a search around the pressed modules restarts it. The estimate stays over
    the surface, and within the speed that the entry allows.

    Accuracy over all tasks, 37 controllers and both boxes at a pitch of 100 mm: with correct
    assumptions, the median position error is 1.3 mm, and 99.9 % are below 21 mm. With the load off
    centre by up to half the way to the edge, 99.9 % are below 70 mm, and the maximum is 122 mm.
    With friction of 0.8 or 1.2 times the assumed value, the numbers are 46 mm and 79 mm. With all
    of these errors, single errors of about 0.3 m remain for parcels that leave a line with two or
    fewer pressed rotors. Headings may then have any error, and may be off by a quarter turn for
    squares.
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
        """Return the parameters for compiled code, for physics steps of `dt` [s]."""
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
