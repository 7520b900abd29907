"""Camera: late and noisy frames of the pose, and a Kalman filter that makes velocities of them."""

import math
from dataclasses import dataclass, field

import numpy as np

from surface_gym import checks
from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import Array
from surface_gym.lanes.memory import FRAMES, NOISE_ROWS, Lanes
from surface_gym.sensors.entry import ENTRY_SIZE, Entry, enter
from surface_gym.sensors.sensor import Sensing

CAMERA = 1
MOST_LATE = 8  # frames; `Lanes.frames` holds them however the periods are rounded

# Columns of the settings; the Entry comes last.
(
    EVERY,  # physics steps from frame to frame
    LAG,  # physics steps from a frame to its arrival
    POSITION_NOISE,
    ANGLE_NOISE,
    DROP,
    ACCELERATION,
    TURN_ACCELERATION,
    ENTRY,
) = range(8)

# Columns of `Lanes.filter` after the estimate: the covariance of position and velocity, which x
# and y share, that of angle and turning speed, and the step of the frame they stand for.
POSITION_COVARIANCE, ANGLE_COVARIANCE, STEP = 6, 9, 12
# Columns of `Lanes.frames`: whether the frame was taken; the pose follows.
TAKEN = 0


@dataclass(frozen=True)
class Camera:
    """Sees the pose of the base's centroid in frames, each with noise and some time after it.

    Frames fall on physics steps: a frame period is rounded to whole ones, and a frame can be used
    from the first step on that ends no sooner than `latency` after it. The angle is continuous:
    a turn beyond pi does not jump.

    The estimate is a Kalman filter's: each coordinate moves at a constant velocity that white
    acceleration disturbs. It knows when a frame was taken and predicts from the last one that
    arrived to the time of the decision. A start is known as `entry` says.

    The densities stand for accelerations anywhere within mu_max g = 4.9 m/s^2 that change every
    40 ms: about (mu_max g)^2 / 3 x 40 ms. Turning has that at a radius of 0.1 m.

    Raises:
        ValueError: a rate or density that is not positive, a negative latency or one of more than
            8 frames, negative noise, or a `drop` outside [0, 1).
    """

    frame_rate: float = 50.0  # [Hz]
    latency: float | None = None  # [s] from a frame to its use; None: one frame period
    position_noise: float = 0.001  # [m] standard deviation in x and in y
    angle_noise: float = math.radians(0.5)  # [rad] standard deviation
    drop: float = 0.0  # [-] probability of a frame to be lost
    acceleration_density: float = 0.3  # [m^2/s^3] of the white acceleration, in x and in y
    turn_density: float = 30.0  # [rad^2/s^3] of the white angular acceleration
    entry: Entry = field(default_factory=Entry)  # what is known of a parcel as it enters

    def __post_init__(self) -> None:
        for name in ("frame_rate", "acceleration_density", "turn_density"):
            checks.positive(name, getattr(self, name))
        for name in ("position_noise", "angle_noise"):
            checks.not_negative(name, getattr(self, name))
        if checks.within("drop", self.drop, 0.0, 1.0) == 1.0:
            raise ValueError(f"drop must be less than 1, got {self.drop!r}")
        if self.latency is not None:
            checks.within("latency", self.latency, 0.0, MOST_LATE / self.frame_rate)
        if not isinstance(self.entry, Entry):
            raise ValueError(f"entry must be an Entry, got {self.entry!r}")

    def frame_steps(self, dt: float) -> int:
        """Physics steps of `dt` [s] from frame to frame.

        Raises:
            ValueError: frames come faster than physics steps.
        """
        steps = round(1.0 / (self.frame_rate * dt))
        if steps == 0:
            raise ValueError(
                f"frame_rate must be at most one frame a physics step, {1.0 / dt:g} Hz, "
                f"got {self.frame_rate!r}"
            )
        return steps

    def sensing(self, dt: float) -> Sensing:
        """The sensor as compiled code reads it, for physics steps of `dt` [s]."""
        every = self.frame_steps(dt)
        lag = every if self.latency is None else math.ceil(self.latency / dt - 1e-9)
        settings = np.zeros(ENTRY + ENTRY_SIZE)
        settings[:ENTRY] = (
            every,
            lag,
            self.position_noise,
            self.angle_noise,
            self.drop,
            self.acceleration_density,
            self.turn_density,
        )
        settings[ENTRY:] = self.entry.settings
        return Sensing(CAMERA, settings)

    def draws(self, dt: float, steps: int) -> int:
        """One row of noise a frame.

        Raises:
            ValueError: a control period has more frames than noise is drawn ahead for.
        """
        frames = math.ceil(steps / self.frame_steps(dt))
        if frames > NOISE_ROWS:
            raise ValueError(
                f"frame_rate must be at most {NOISE_ROWS} frames a control period, "
                f"got {self.frame_rate!r} Hz in {steps * dt:g} s"
            )
        return frames


@inlined
def begin(settings: Array, lanes: Lanes, lane: int) -> None:
    """Set the filter at a start; frames from before it never arrive."""
    kept = lanes.filter[lane]
    enter(settings, ENTRY, lanes, lane, kept)
    kept[POSITION_COVARIANCE] = settings[ENTRY] ** 2
    kept[POSITION_COVARIANCE + 1] = 0.0
    kept[POSITION_COVARIANCE + 2] = settings[ENTRY + 2] ** 2
    kept[ANGLE_COVARIANCE] = settings[ENTRY + 1] ** 2
    kept[ANGLE_COVARIANCE + 1] = 0.0
    kept[ANGLE_COVARIANCE + 2] = settings[ENTRY + 3] ** 2
    kept[STEP] = 0.0
    for k in range(FRAMES):
        lanes.frames[lane, k, TAKEN] = 0.0


@inlined
def _take(settings: Array, lanes: Lanes, lane: int, place: int) -> None:
    """Take a frame, or lose it."""
    row = lanes.noise_row[lane]
    lanes.noise_row[lane] = row + 1
    noise = lanes.noise[lane, row]
    frame = lanes.frames[lane, place]
    frame[TAKEN] = 0.0 if noise[3] < settings[DROP] else 1.0
    frame[1] = lanes.truth[lane, 0] + settings[POSITION_NOISE] * noise[0]
    frame[2] = lanes.truth[lane, 1] + settings[POSITION_NOISE] * noise[1]
    frame[3] = lanes.truth[lane, 2] + settings[ANGLE_NOISE] * noise[2]


@inlined
def _gains(
    kept: Array, first: int, density: float, noise: float, time: float
) -> tuple[float, float]:
    """Advance the covariance that starts in column `first` over a time [s] and a measurement.

    Returns:
        What a measurement corrects of the place, and of the velocity, a unit of its surprise.
    """
    place, mixed, velocity = kept[first], kept[first + 1], kept[first + 2]
    place += time * (2.0 * mixed + time * velocity) + density * time**3 / 3.0
    mixed += time * velocity + 0.5 * density * time**2
    velocity += density * time
    per_surprise = 1.0 / (place + noise * noise)
    gain_place = place * per_surprise
    gain_velocity = mixed * per_surprise
    kept[first] = place - gain_place * place
    kept[first + 1] = mixed - gain_place * mixed
    kept[first + 2] = velocity - gain_velocity * mixed
    return gain_place, gain_velocity


@inlined
def _correct(settings: Array, lanes: Lanes, lane: int, frame: Array, step: int, dt: float) -> None:
    """Bring the estimate to the time of a frame, and correct it by what the frame shows."""
    kept = lanes.filter[lane]
    time = dt * (step - kept[STEP])
    kept[STEP] = step
    place, velocity = _gains(
        kept, POSITION_COVARIANCE, settings[ACCELERATION], settings[POSITION_NOISE], time
    )
    turn, turning = _gains(
        kept, ANGLE_COVARIANCE, settings[TURN_ACCELERATION], settings[ANGLE_NOISE], time
    )
    for k in range(3):
        kept[k] += time * kept[3 + k]
        surprise = frame[1 + k] - kept[k]
        kept[k] += (place if k < 2 else turn) * surprise
        kept[3 + k] += (velocity if k < 2 else turning) * surprise


@inlined
def look(settings: Array, lanes: Lanes, lane: int, dt: float) -> None:
    """Take a frame if one is due, and use the one that arrives, which may be the same."""
    every = int(settings[EVERY])
    step = lanes.steps[lane]
    if step % every == 0:
        _take(settings, lanes, lane, (step // every) % FRAMES)
    taken = step - int(settings[LAG])
    if taken > 0 and taken % every == 0:
        frame = lanes.frames[lane, (taken // every) % FRAMES]
        if frame[TAKEN] > 0.0:
            _correct(settings, lanes, lane, frame, taken, dt)


@inlined
def estimate(lanes: Lanes, lane: int, dt: float) -> None:
    """Predict from the last frame that arrived to now, into `lanes.sensed`."""
    kept = lanes.filter[lane]
    lead = dt * (lanes.steps[lane] - kept[STEP])
    for k in range(3):
        lanes.sensed[lane, k] = kept[k] + lead * kept[3 + k]
        lanes.sensed[lane, 3 + k] = kept[3 + k]
