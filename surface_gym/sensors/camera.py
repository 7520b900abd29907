"""Camera: late and noisy frames of the pose, and a Kalman filter that knows the physics."""

import math
from dataclasses import dataclass, field

from surface_gym import checks
from surface_gym.compiler.jit import kernel_function
from surface_gym.physics.types import Array
from surface_gym.sensors import kalman
from surface_gym.sensors.base import LEARNED, Entry, Physics, Singles
from surface_gym.state import EnvState

FRAMES = 16  # that can be under way at a time
MOST_LATE = 8  # frames, however the periods are rounded

# Columns of the params; the Entry comes last.
(
    EVERY,  # physics steps from frame to frame
    LAG,  # physics steps from a frame to its arrival
    POSITION_NOISE,
    ANGLE_NOISE,
    DROP,
    MODEL,  # what the observer doubts
) = range(6)
ENTRY = MODEL + kalman.MODEL_SIZE

# A frame under way, of FRAMES that follow the observer's numbers: the physics step it was taken at,
# 0 for none; then by how much its pose differs from what is estimated of that step.
TAKEN, SURPRISE, FRAME_SIZE = 0, 1, 4
SHARPEST = 1e-9  # [m] and [rad] no frame is trusted further


@dataclass(frozen=True)
class Camera(kalman.Observer):
    """A sensor of the pose in frames, each with noise and latency, with a Kalman filter behind.

    Frames fall on physics steps: a frame period is rounded to whole ones, and a frame can be used
    from the first step on that ends no sooner than `latency` after it. The angle is continuous: a
    turn beyond pi does not jump.

    The estimate is a Kalman filter's whose model is the physics itself: it moves on with the axes
    as they are, nominal friction and the load over the base's centroid, its uncertainty damped as
    friction damps it. A frame is compared with what was estimated of the time it was taken at. A
    start is known as `entry` says.

    `friction_error` stands for friction that is not nominal, the densities for what else the
    physics leaves out: loads off centre, elements that bear unequally.
    """

    frame_rate: float = 50.0  # [Hz]
    latency: float | None = None  # [s] from a frame to its use; None: one frame period
    position_noise: float = 0.001  # [m] standard deviation in x and in y
    angle_noise: float = math.radians(0.5)  # [rad] standard deviation
    drop: float = 0.0  # [-] probability of a frame to be lost
    mu_max: float | None = None  # [-] friction the filter assumes; None: the line's own
    mu_min: float | None = None  # [-]
    mu_support: float | None = None  # [-]
    friction_error: float = 0.05  # [-] share by which what friction does may be off
    acceleration_density: float = 0.0003  # [m^2/s^3] of the physics' other error, in x and in y
    turn_density: float = 0.03  # [rad^2/s^3] of the physics' other error in turning
    entry: Entry = field(default_factory=Entry)  # what is known of a parcel as it enters

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
        """Return the parameters as compiled code reads them, for physics steps of `dt` [s]."""
        every = self.frame_steps(dt)
        lag = every if self.latency is None else math.ceil(self.latency / dt - 1e-9)
        return (
            every, lag, self.position_noise, self.angle_noise, self.drop, self.acceleration_density,
            self.turn_density, self.friction_error, *self.entry.params,
        )  # fmt: skip

    @staticmethod
    @kernel_function
    def begin(numbers: Array, state: EnvState) -> None:
        """Reset the filter; frames from before never arrive."""
        kalman.begin(numbers, ENTRY, state)
        for k in range(FRAMES):
            state.sensor_state[kalman.LAST + FRAME_SIZE * k + TAKEN] = 0.0

    @staticmethod
    @kernel_function
    def update(numbers: Array, state: EnvState, physics: Physics) -> None:
        """Predict over a physics step, take a frame if due, and correct with an arriving frame."""
        kalman.predict(numbers, MODEL, state, physics)
        place = watch(numbers, state, kalman.LAST)
        if place > 0:
            _use(numbers, state, place, physics.dt)


@kernel_function
def watch(numbers: Array, state: EnvState, first: int) -> int:
    """Take a frame if one is due.

    Return the place of the frame that arrives, the frames lying from `first` on; 0 if none does.
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
    """Return the place of a frame in the sensor state, the frames lying from `first` on."""
    return first + FRAME_SIZE * (number % FRAMES)


@kernel_function
def _take(numbers: Array, state: EnvState, first: int) -> None:
    """Take a frame, or lose it; the frames lie in the sensor state from `first` on."""
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
    """Update the innovations of all frames, from `first` on, for a shift of `shift` x GAIN."""
    gain = state.sensor_state[kalman.GAIN :]
    for number in range(FRAMES):
        place = _place(first, number)
        lead = age(state, place, dt)
        for k in range(3):
            state.sensor_state[place + SURPRISE + k] -= shift * (gain[k] - lead * gain[3 + k])


@kernel_function
def _use(numbers: Array, state: EnvState, place: int, dt: float) -> None:
    """Correct the estimate by a frame, a coordinate at a time."""
    lead = age(state, place, dt)
    for k in range(3):
        shift, shrink = weigh(numbers, state, place, k, lead)
        kalman.correct(state.sensor_state, shift, shrink)
        shift_frames(state, kalman.LAST, shift, dt)


@kernel_function
def age(state: EnvState, place: int, dt: float) -> float:
    """Return the time [s] since the frame at a place of the sensor state was taken."""
    return dt * (state.steps - state.sensor_state[place + TAKEN])


@kernel_function
def weigh(numbers: Array, state: EnvState, place: int, k: int, lead: float) -> tuple[float, float]:
    """Return how much a frame of `lead` seconds ago moves the estimate and shrinks its covariance,
    by coordinate `k` of the pose alone, along what `measure` left.
    """
    noise = max(SHARPEST, numbers[POSITION_NOISE] if k < 2 else numbers[ANGLE_NOISE])
    by_x, by_y = 1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0
    variance = kalman.measure(state.sensor_state, by_x, by_y, 1.0 if k == 2 else 0.0, lead)
    per_surprise = 1.0 / (variance + noise * noise)
    return state.sensor_state[place + SURPRISE + k] * per_surprise, per_surprise


SPREADS = ENTRY + 4  # first column of its own parameters, after the Camera's


@dataclass(frozen=True)
class AdaptiveCamera(Camera):
    """A `Camera` that also estimates the factor by which mu_max differs from its model, and the
    place of the centre of mass over the base.

    Both are constant while a parcel is on the surface, and known at a start to the spreads given. A
    parcel that is braked harder than predicted, or that turns where it should not, shows them; see
    `surface_gym.sensors.kalman`. The argument `observe=("load",)` shows them.
    """

    acceleration_density: float = 0.0001  # [m^2/s^3] less than a Camera's: the load is known of
    turn_density: float = 0.01  # [rad^2/s^3]
    friction_spread: float = 0.1  # [-] standard deviation of the factor of mu_max from 1
    load_spread: float = 0.015  # [m] of the centre of mass from the base's centroid, in x and in y

    sensor_size = kalman.LEARNING_LAST + FRAMES * FRAME_SIZE

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.positive("friction_spread", self.friction_spread, *checks.LEARNED_SPREAD)
        checks.positive("load_spread", self.load_spread, *checks.LEARNED_SPREAD)

    @property
    def learned_spreads(self) -> tuple[float, float]:
        return self.friction_spread, self.load_spread

    def numbers(self, dt: float) -> tuple[float, ...]:
        """Return the parameters as compiled code reads them, for physics steps of `dt` [s]."""
        return (*super().numbers(dt), self.friction_spread, self.load_spread)

    @staticmethod
    @kernel_function
    def begin(numbers: Array, state: EnvState) -> None:
        """Reset the filter; frames from before never arrive."""
        kalman.begin(numbers, ENTRY, state)
        kalman.begin_learning(numbers, SPREADS, state)
        for k in range(FRAMES):
            state.sensor_state[kalman.LEARNING_LAST + FRAME_SIZE * k + TAKEN] = 0.0

    @staticmethod
    @kernel_function
    def update(numbers: Array, state: EnvState, physics: Physics) -> None:
        """Predict, take and correct as a Camera does, the constants included."""
        kalman.predict_learning(numbers, MODEL, state, physics)
        place = watch(numbers, state, kalman.LEARNING_LAST)
        if place > 0:
            _use_adaptive(numbers, state, place, physics.dt)

    @staticmethod
    @kernel_function
    def show_load(numbers: Array, state: EnvState, see: Singles, mirror: float) -> None:
        """Write what was learned, and the share of the doubt that remains, as `LOAD_FEATURES`."""
        estimate = state.sensor_state
        for j in range(LEARNED):
            spread = numbers[SPREADS + min(j, 1)]
            apart = estimate[kalman.CONSTANT + j] - (1.0 if j == 0 else 0.0)
            see[j] = (mirror if j == 2 else 1.0) * apart / spread
            doubt = max(0.0, estimate[kalman.DOUBT + (LEARNED + 1) * j]) ** 0.5 / spread
            see[LEARNED + j] = min(1.0, doubt)


@kernel_function
def _use_adaptive(numbers: Array, state: EnvState, place: int, dt: float) -> None:
    """Correct the estimate and the constants by a frame, a coordinate at a time."""
    lead = age(state, place, dt)
    for k in range(3):
        shift, shrink = weigh(numbers, state, place, k, lead)
        kalman.measure_constants(state.sensor_state, k, lead)
        kalman.correct(state.sensor_state, shift, shrink)
        kalman.correct_constants(state, shift, shrink)
        shift_frames(state, kalman.LEARNING_LAST, shift, dt)
