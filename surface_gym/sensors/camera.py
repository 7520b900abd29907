"""Camera: late and noisy frames of the pose, and a Kalman filter that knows the physics."""

import math
from dataclasses import dataclass, field

import numpy as np

from surface_gym import checks
from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import Array, Scratch
from surface_gym.lanes.memory import FRAMES, NOISE_ROWS, Geometry, Lanes
from surface_gym.sensors import observer
from surface_gym.sensors.entry import ENTRY_SIZE, Entry
from surface_gym.sensors.observer import GAIN, MODEL_SIZE, correct, measure
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
    MODEL,  # of the observer
) = range(6)
ENTRY = MODEL + MODEL_SIZE

# Columns of `Lanes.frames`: the physics step a frame was taken at, 0 for none; then by how much
# its pose differs from what is estimated of that step.
TAKEN, SURPRISE = 0, 1
SHARPEST = 1e-9  # [m] and [rad] no frame is trusted further


@dataclass(frozen=True)
class Camera:
    """Sees the pose of the base's centroid in frames, each with noise and some time after it.

    Frames fall on physics steps: a frame period is rounded to whole ones, and a frame can be used
    from the first step on that ends no sooner than `latency` after it. The angle is continuous:
    a turn beyond pi does not jump.

    The estimate is a Kalman filter's whose model is the physics itself: it moves on with the axes
    as they are, nominal friction and the load over the base's centroid, its uncertainty damped as
    friction damps it. A frame is compared with what was estimated of the time it was taken at. A
    start is known as `entry` says.

    `friction_error` stands for friction that is not nominal, the densities for what else the
    physics leaves out: loads off centre, elements that bear unequally.

    Raises:
        ValueError: a rate or density that is not positive, a negative latency or one of more than
            8 frames, negative noise or friction, or a `drop` outside [0, 1).
    """

    frame_rate: float = 50.0  # [Hz]
    latency: float | None = None  # [s] from a frame to its use; None: one frame period
    position_noise: float = 0.001  # [m] standard deviation in x and in y
    angle_noise: float = math.radians(0.5)  # [rad] standard deviation
    drop: float = 0.0  # [-] probability of a frame to be lost
    mu_max: float = 0.5  # [-] friction the filter assumes, as the surface's
    mu_min: float = 0.01  # [-]
    mu_support: float = 0.005  # [-]
    friction_error: float = 0.05  # [-] share by which what friction does may be off
    acceleration_density: float = 0.0003  # [m^2/s^3] of the physics' other error, in x and in y
    turn_density: float = 0.03  # [rad^2/s^3] of the physics' other error in turning
    entry: Entry = field(default_factory=Entry)  # what is known of a parcel as it enters

    def __post_init__(self) -> None:
        for name in ("frame_rate", "acceleration_density", "turn_density"):
            checks.positive(name, getattr(self, name))
        for name in (
            "position_noise", "angle_noise", "mu_max", "mu_min", "mu_support", "friction_error",
        ):  # fmt: skip
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
            self.mu_max,
            self.mu_min,
            self.mu_support,
            self.acceleration_density,
            self.turn_density,
            self.friction_error,
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
    observer.begin(settings, ENTRY, lanes, lane)
    for k in range(FRAMES):
        lanes.frames[lane, k, TAKEN] = 0.0


@inlined
def _take(settings: Array, lanes: Lanes, lane: int, step: int) -> None:
    """Take a frame, or lose it."""
    row = lanes.noise_row[lane]
    lanes.noise_row[lane] = row + 1
    noise = lanes.noise[lane, row]
    frame = lanes.frames[lane, (step // int(settings[EVERY])) % FRAMES]
    frame[TAKEN] = 0.0 if noise[3] < settings[DROP] else float(step)
    for k in range(3):
        spread = settings[POSITION_NOISE] if k < 2 else settings[ANGLE_NOISE]
        seen = lanes.truth[lane, k] + spread * noise[k]
        frame[SURPRISE + k] = seen - lanes.filter[lane, k]


@inlined
def _shift_frames(lanes: Lanes, lane: int, shift: float, dt: float) -> None:
    """Bring the surprises of all frames up to date with a correction of `shift` times GAIN."""
    gain = lanes.filter[lane, GAIN:]
    for place in range(FRAMES):
        frame = lanes.frames[lane, place]
        lead = dt * (lanes.steps[lane] - frame[TAKEN])
        for k in range(3):
            frame[SURPRISE + k] -= shift * (gain[k] - lead * gain[3 + k])


@inlined
def _use(settings: Array, lanes: Lanes, lane: int, frame: Array, dt: float) -> None:
    """Correct the estimate by what a frame shows, a coordinate at a time."""
    kept = lanes.filter[lane]
    lead = dt * (lanes.steps[lane] - frame[TAKEN])
    for k in range(3):
        noise = max(SHARPEST, settings[POSITION_NOISE] if k < 2 else settings[ANGLE_NOISE])
        by_x, by_y = 1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0
        variance = measure(kept, by_x, by_y, 1.0 if k == 2 else 0.0, lead)
        per_surprise = 1.0 / (variance + noise * noise)
        shift = frame[SURPRISE + k] * per_surprise
        correct(kept, shift, per_surprise)
        _shift_frames(lanes, lane, shift, dt)


@inlined
def look(
    settings: Array, lanes: Lanes, lane: int, geometry: Geometry, scratch: Scratch, dt: float
) -> None:
    """Move the estimate over a physics step; take a frame if one is due, and use the one that
    arrives, which may be the same.
    """
    observer.predict(settings, MODEL, lanes, lane, geometry, scratch, dt)
    every = int(settings[EVERY])
    step = lanes.steps[lane]
    if step % every == 0:
        _take(settings, lanes, lane, step)
    taken = step - int(settings[LAG])
    if taken > 0 and taken % every == 0:
        frame = lanes.frames[lane, (taken // every) % FRAMES]
        if frame[TAKEN] > 0.0:
            _use(settings, lanes, lane, frame, dt)
