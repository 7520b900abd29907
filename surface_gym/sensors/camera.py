"""Camera: late and noisy frames of the pose, and a Kalman filter that knows the physics."""

import math
from dataclasses import dataclass, field

from surface_gym import bounds, checks
from surface_gym.dynamics.compiled import lane_function
from surface_gym.dynamics.types import Array
from surface_gym.lanes.lane import Lane
from surface_gym.lanes.memory import NOISE_ROWS
from surface_gym.sensors import observer
from surface_gym.sensors.entry import Entry
from surface_gym.sensors.observer import GAIN, LAST, MODEL_SIZE, Observer, correct, measure
from surface_gym.sensors.sensor import Physics

FRAMES = 16  # that can be under way at a time
MOST_LATE = 8  # frames, however the periods are rounded

# Columns of the settings; the Entry comes last.
(
    EVERY,  # physics steps from frame to frame
    LAG,  # physics steps from a frame to its arrival
    POSITION_NOISE,
    ANGLE_NOISE,
    DROP,
    MODEL,  # what the observer doubts
) = range(6)
ENTRY = MODEL + MODEL_SIZE

# A frame under way, of FRAMES that follow the observer's numbers: the physics step it was taken at,
# 0 for none; then by how much its pose differs from what is estimated of that step.
TAKEN, SURPRISE, FRAME_SIZE = 0, 1, 4
SHARPEST = 1e-9  # [m] and [rad] no frame is trusted further


@dataclass(frozen=True)
class Camera(Observer):
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
            8 frames, negative noise or friction, a `drop` outside [0, 1), or a number
            beyond `surface_gym.bounds`.
    """

    frame_rate: float = 50.0  # [Hz]
    latency: float | None = None  # [s] from a frame to its use; None: one frame period
    position_noise: float = 0.001  # [m] standard deviation in x and in y
    angle_noise: float = math.radians(0.5)  # [rad] standard deviation
    drop: float = 0.0  # [-] probability of a frame to be lost
    mu_max: float | None = None  # [-] friction the filter assumes; None: the plant's own
    mu_min: float | None = None  # [-]
    mu_support: float | None = None  # [-]
    friction_error: float = 0.05  # [-] share by which what friction does may be off
    acceleration_density: float = 0.0003  # [m^2/s^3] of the physics' other error, in x and in y
    turn_density: float = 0.03  # [rad^2/s^3] of the physics' other error in turning
    entry: Entry = field(default_factory=Entry)  # what is known of a parcel as it enters

    kept = LAST + FRAMES * FRAME_SIZE

    def __post_init__(self) -> None:
        checks.positive("frame_rate", self.frame_rate, *bounds.FRAME_RATE)
        for name in ("acceleration_density", "turn_density"):
            checks.positive(name, getattr(self, name), *bounds.DENSITY)
        checks.not_negative("position_noise", self.position_noise, bounds.POSITION_ERROR)
        checks.not_negative("angle_noise", self.angle_noise, bounds.ANGLE_ERROR)
        checks.not_negative("friction_error", self.friction_error, bounds.FRICTION_ERROR)
        checks.assumed_friction(self.mu_max, self.mu_min, self.mu_support)
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

    def numbers(self, dt: float) -> tuple[float, ...]:
        """The settings as compiled code reads them, for physics steps of `dt` [s]."""
        every = self.frame_steps(dt)
        lag = every if self.latency is None else math.ceil(self.latency / dt - 1e-9)
        return (
            every,
            lag,
            self.position_noise,
            self.angle_noise,
            self.drop,
            self.acceleration_density,
            self.turn_density,
            self.friction_error,
            *self.entry.settings,
        )

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

    @staticmethod
    @lane_function
    def begin(numbers: Array, lane: Lane) -> None:
        """Set the filter; frames from before never arrive."""
        observer.begin(numbers, ENTRY, lane)
        for k in range(FRAMES):
            lane.kept[LAST + FRAME_SIZE * k + TAKEN] = 0.0

    @staticmethod
    @lane_function
    def look(numbers: Array, lane: Lane, physics: Physics) -> None:
        """Move the estimate over a physics step; take a frame if one is due, and use the one that
        arrives, which may be the same.
        """
        observer.predict(numbers, MODEL, lane, physics)
        place = watch(numbers, lane, LAST)
        if place > 0:
            _use(numbers, lane, place, physics.dt)


@lane_function
def watch(numbers: Array, lane: Lane, first: int) -> int:
    """Take a frame if one is due; where the one lies that arrives, the frames in the memory from
    `first` on, or 0 where none does.
    """
    every = int(numbers[EVERY])
    if lane.steps % every == 0:
        _take(numbers, lane, first)
    taken = lane.steps - int(numbers[LAG])
    if taken > 0 and taken % every == 0:
        place = _place(first, taken // every)
        if lane.kept[place + TAKEN] > 0.0:
            return place
    return 0


@lane_function
def _place(first: int, number: int) -> int:
    """Where a frame lies in the memory, the frames from `first` on."""
    return first + FRAME_SIZE * (number % FRAMES)


@lane_function
def _take(numbers: Array, lane: Lane, first: int) -> None:
    """Take a frame, or lose it; the frames lie in the memory from `first` on."""
    row = lane.noise_row[0]
    lane.noise_row[0] = row + 1
    noise = lane.noise[row]
    place = _place(first, lane.steps // int(numbers[EVERY]))
    lane.kept[place + TAKEN] = 0.0 if noise[3] < numbers[DROP] else float(lane.steps)
    for k in range(3):
        spread = numbers[POSITION_NOISE] if k < 2 else numbers[ANGLE_NOISE]
        seen = lane.truth[k] + spread * noise[k]
        lane.kept[place + SURPRISE + k] = seen - lane.kept[k]


@lane_function
def shift_frames(lane: Lane, first: int, shift: float, dt: float) -> None:
    """Bring the surprises of all frames, from `first` on, up to date with a correction of `shift`
    times GAIN.
    """
    gain = lane.kept[GAIN:]
    for number in range(FRAMES):
        place = _place(first, number)
        lead = age(lane, place, dt)
        for k in range(3):
            lane.kept[place + SURPRISE + k] -= shift * (gain[k] - lead * gain[3 + k])


@lane_function
def _use(numbers: Array, lane: Lane, place: int, dt: float) -> None:
    """Correct the estimate by what a frame shows, a coordinate at a time."""
    lead = age(lane, place, dt)
    for k in range(3):
        shift, shrink = weigh(numbers, lane, place, k, lead)
        correct(lane.kept, shift, shrink)
        shift_frames(lane, LAST, shift, dt)


@lane_function
def age(lane: Lane, place: int, dt: float) -> float:
    """[s] since the frame at a place in the memory was taken."""
    return dt * (lane.steps - lane.kept[place + TAKEN])


@lane_function
def weigh(numbers: Array, lane: Lane, place: int, k: int, lead: float) -> tuple[float, float]:
    """By how much the frame at a place, of `lead` seconds ago, moves the estimate and lessens its
    covariance, by the pose's coordinate `k` alone; along what `measure` leaves.
    """
    noise = max(SHARPEST, numbers[POSITION_NOISE] if k < 2 else numbers[ANGLE_NOISE])
    by_x, by_y = 1.0 if k == 0 else 0.0, 1.0 if k == 1 else 0.0
    variance = measure(lane.kept, by_x, by_y, 1.0 if k == 2 else 0.0, lead)
    per_surprise = 1.0 / (variance + noise * noise)
    return lane.kept[place + SURPRISE + k] * per_surprise, per_surprise
