"""Camera: noisy, delayed frames of the pose, and a Kalman filter with a physical model."""

import math
from dataclasses import dataclass, field

from surface_gym import checks
from surface_gym.compiler.jit import kernel_function
from surface_gym.physics.types import Array
from surface_gym.sensors import kalman
from surface_gym.sensors.base import LEARNED, Entry, Physics, Singles
from surface_gym.state import EnvState

FRAMES = 16  # maximum frames in transit
MOST_LATE = 8  # maximum delay in frames, with any rounding

# Columns of the params; the Entry comes last.
(
    EVERY,  # physics steps between frames
    LAG,  # physics steps from a frame to its arrival
    POSITION_NOISE,
    ANGLE_NOISE,
    DROP,
    MODEL,  # process noise of the observer
) = range(6)
ENTRY = MODEL + kalman.MODEL_SIZE

# A frame in transit has a physics step (0: none) and an innovation: its pose minus the estimate
# at that step. FRAMES of them follow the observer's numbers.
TAKEN, SURPRISE, FRAME_SIZE = 0, 1, 4
SHARPEST = 1e-9  # [m] and [rad] minimum standard deviation of a frame


@dataclass(frozen=True)
class Camera(kalman.Observer):
    """A sensor of the pose in noisy, delayed frames, with a Kalman filter.

    Frames are taken at physics steps, so a frame period is a whole number of steps. The filter
    gets a frame after the time `latency`, rounded up to whole steps. The angle is continuous, and
    does not jump at pi.

    The Kalman filter's model is the physics with the true axes, nominal friction and a centred
    load. Friction damps the filter's uncertainty. A frame is compared with the estimate at the time
    of the frame. `entry` describes the first estimate and its uncertainty.

    `friction_error` describes the deviation from nominal friction. `acceleration_density` and
    `turn_density` describe all other errors of the model, e.g. off-centre and uneven loads.
    """

    frame_rate: float = 50.0  # [Hz]
    latency: float | None = None  # [s] from a frame to its use; None: one frame period
    position_noise: float = 0.001  # [m] standard deviation of x and y
    angle_noise: float = math.radians(0.5)  # [rad] standard deviation
    drop: float = 0.0  # [-] probability of a frame to be lost
    mu_max: float | None = None  # [-] friction in the filter's model; None: the line's
    mu_min: float | None = None  # [-]
    mu_support: float | None = None  # [-]
    friction_error: float = 0.05  # [-] relative error of accelerations by friction
    acceleration_density: float = 0.0003  # [m^2/s^3] other errors of the model, in x and y
    turn_density: float = 0.03  # [rad^2/s^3] other errors of the model in turning
    entry: Entry = field(default_factory=Entry)  # prior of a parcel at its entry

    rate = ("frame_rate", "frame")
    sensor_size = kalman.LAST + FRAMES * FRAME_SIZE

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.positive("frame_rate", self.frame_rate, *checks.FRAME_RATE)
        checks.not_negative("position_noise", self.position_noise, checks.POSITION_ERROR)
        checks.angle("angle_noise", self.angle_noise, 0.0, checks.ANGLE_ERROR)
        if self.latency is not None:
            checks.within("latency", self.latency, 0.0, MOST_LATE / self.frame_rate)

    def numbers(self, dt: float) -> tuple[float, ...]:
        every = self.frame_steps(dt)
        lag = every if self.latency is None else math.ceil(self.latency / dt - 1e-9)
        return (
            every, lag, self.position_noise, self.angle_noise, self.drop, self.acceleration_density,
            self.turn_density, self.friction_error, *self.entry.params,
        )  # fmt: skip

    @staticmethod
    @kernel_function
    def begin(numbers: Array, state: EnvState) -> None:
        """Reset the filter, and drop frames in transit."""
        kalman.begin(numbers, ENTRY, state)
        for k in range(FRAMES):
            state.sensor_state[kalman.LAST + FRAME_SIZE * k + TAKEN] = 0.0

    @staticmethod
    @kernel_function
    def update(numbers: Array, state: EnvState, physics: Physics) -> None:
        """Predict over a physics step. Take a frame when due. Correct when a frame arrives."""
        kalman.predict(numbers, MODEL, state, physics)
        place = watch(numbers, state, kalman.LAST)
        if place > 0:
            _use(numbers, state, place, physics.dt)


@kernel_function
def watch(numbers: Array, state: EnvState, first: int) -> int:
    """Take a frame if a frame is due. Return the place of an arriving frame, or 0 without a frame.

    A place is the index in the sensor state where a frame begins. Frames begin at index `first`.
    """
    every = int(numbers[EVERY])
    if state.steps % every == 0:
        _take(numbers, state, first)
    taken = state.steps - int(numbers[LAG])
    if taken > 0 and taken % every == 0:
        place = _place(first, taken // every)
        if state.sensor_state[place + TAKEN] > 0.0:
            return place
    return 0


@kernel_function
def _place(first: int, number: int) -> int:
    """Return the index in the sensor state at which frame `number` begins.

    The list of frames begins at the index `first`.
    """
    return first + FRAME_SIZE * (number % FRAMES)


@kernel_function
def _take(numbers: Array, state: EnvState, first: int) -> None:
    """Take a frame, or drop it at random. Frames begin at index `first` of the sensor state."""
    row = state.noise_row[0]
    state.noise_row[0] = row + 1
    noise = state.noise[row]
    place = _place(first, state.steps // int(numbers[EVERY]))
    state.sensor_state[place + TAKEN] = 0.0 if noise[3] < numbers[DROP] else float(state.steps)
    for k in range(3):
        spread = numbers[POSITION_NOISE] if k < 2 else numbers[ANGLE_NOISE]
        seen = state.truth[k] + spread * noise[k]
        state.sensor_state[place + SURPRISE + k] = seen - state.sensor_state[k]


@kernel_function
def shift_frames(state: EnvState, first: int, shift: float, dt: float) -> None:
    """Update the innovations of all frames after a correction of the estimate.

    The correction has changed the estimate by `shift` times the gain that `kalman.measure` stored.
    An innovation is the difference between a frame and the estimate at the frame's time. The frames
    are in the sensor state from `first` on. A step lasts `dt` [s].
    """
    gain = state.sensor_state[kalman.GAIN :]
    for number in range(FRAMES):
        place = _place(first, number)
        lead = age(state, place, dt)
        for k in range(3):
            state.sensor_state[place + SURPRISE + k] -= shift * (gain[k] - lead * gain[3 + k])


@kernel_function
def _use(numbers: Array, state: EnvState, place: int, dt: float) -> None:
    """Correct the coordinates of the estimate one by one, from the frame at index `place`."""
    lead = age(state, place, dt)
    for k in range(3):
        shift, shrink = weigh(numbers, state, place, k, lead)
        kalman.correct(state.sensor_state, shift, shrink)
        shift_frames(state, kalman.LAST, shift, dt)


@kernel_function
def age(state: EnvState, place: int, dt: float) -> float:
    """Return the age [s] of the frame at index `place` in the sensor state."""
    return dt * (state.steps - state.sensor_state[place + TAKEN])


@kernel_function
def weigh(numbers: Array, state: EnvState, place: int, k: int, lead: float) -> tuple[float, float]:
    """Return the arguments `shift` and `shrink` of `kalman.correct`, for coordinate `k` of a frame.

    The sensor state holds the frame from the index `place` on. The frame is `lead` seconds old.
    """
    noise = max(SHARPEST, numbers[POSITION_NOISE] if k < 2 else numbers[ANGLE_NOISE])
    by_x, by_y = 1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0
    variance = kalman.measure(state.sensor_state, by_x, by_y, 1.0 if k == 2 else 0.0, lead)
    per_surprise = 1.0 / (variance + noise * noise)
    return state.sensor_state[place + SURPRISE + k] * per_surprise, per_surprise


SPREADS = ENTRY + 4  # first column of its own parameters, after the Camera's


@dataclass(frozen=True)
class AdaptiveCamera(Camera):
    """A `Camera` that also estimates friction (a factor of mu_max) and the load's position.

    Friction and load position are constant while a parcel is on the surface. Their prior standard
    deviations are fields. The filter learns from braking and turning that differ from the
    prediction; see `surface_gym.sensors.kalman`. `observe=("load",)` adds the estimates to the
    observation.
    """

    # [m^2/s^3] smaller than a Camera's, since the load is estimated
    acceleration_density: float = 0.0001
    turn_density: float = 0.01  # [rad^2/s^3]
    friction_spread: float = 0.1  # [-] prior standard deviation of the factor of mu_max
    # [m] prior standard deviation of the load from the centroid, in x and y
    load_spread: float = 0.015

    sensor_size = kalman.LEARNING_LAST + FRAMES * FRAME_SIZE

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.positive("friction_spread", self.friction_spread, *checks.LEARNED_SPREAD)
        checks.positive("load_spread", self.load_spread, *checks.LEARNED_SPREAD)

    @property
    def learned_spreads(self) -> tuple[float, float]:
        return self.friction_spread, self.load_spread

    def numbers(self, dt: float) -> tuple[float, ...]:
        return (*super().numbers(dt), self.friction_spread, self.load_spread)

    @staticmethod
    @kernel_function
    def begin(numbers: Array, state: EnvState) -> None:
        """Reset the filter, and drop frames in transit."""
        kalman.begin(numbers, ENTRY, state)
        kalman.begin_learning(numbers, SPREADS, state)
        for k in range(FRAMES):
            state.sensor_state[kalman.LEARNING_LAST + FRAME_SIZE * k + TAKEN] = 0.0

    @staticmethod
    @kernel_function
    def update(numbers: Array, state: EnvState, physics: Physics) -> None:
        """Predict. Take a frame if a frame is due. If a frame arrives, correct all estimates."""
        kalman.predict_learning(numbers, MODEL, state, physics)
        place = watch(numbers, state, kalman.LEARNING_LAST)
        if place > 0:
            _use_adaptive(numbers, state, place, physics.dt)

    @staticmethod
    @kernel_function
    def show_load(numbers: Array, state: EnvState, see: Singles, mirror: float) -> None:
        """Write `LOAD_FEATURES` to the array `see`: estimates and relative standard deviations."""
        estimate = state.sensor_state
        for j in range(LEARNED):
            spread = numbers[SPREADS + min(j, 1)]
            apart = estimate[kalman.CONSTANT + j] - (1.0 if j == 0 else 0.0)
            see[j] = (mirror if j == 2 else 1.0) * apart / spread
            doubt = max(0.0, estimate[kalman.DOUBT + (LEARNED + 1) * j]) ** 0.5 / spread
            see[LEARNED + j] = min(1.0, doubt)


@kernel_function
def _use_adaptive(numbers: Array, state: EnvState, place: int, dt: float) -> None:
    """Correct all estimates by the frame at index `place`, one coordinate of the pose at a time."""
    lead = age(state, place, dt)
    for k in range(3):
        shift, shrink = weigh(numbers, state, place, k, lead)
        kalman.measure_constants(state.sensor_state, k, lead)
        kalman.correct(state.sensor_state, shift, shrink)
        kalman.correct_constants(state, shift, shrink)
        shift_frames(state, kalman.LEARNING_LAST, shift, dt)
