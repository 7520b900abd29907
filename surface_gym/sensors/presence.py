"""Presence: each module's own on/off sensor, and an observer that makes a pose of the pattern."""

import math
from dataclasses import dataclass, field

from surface_gym import checks
from surface_gym.dynamics.compiled import lane_function
from surface_gym.dynamics.contacts import EDGE_TOLERANCE
from surface_gym.dynamics.types import OMEGA, RADIUS, THETA, VX, VY, Array, X, Y
from surface_gym.lanes.lane import Lane
from surface_gym.lanes.memory import NOISE_ROWS
from surface_gym.sensors import observer
from surface_gym.sensors.entry import Entry
from surface_gym.sensors.observer import LAST, MODEL_SIZE, Observer, correct, measure
from surface_gym.sensors.outline import covered_columns, outside
from surface_gym.sensors.sensor import Physics

# Columns of the settings; the Entry comes last.
(
    EVERY,  # physics steps from sample to sample
    DROP,
    TOLERANCE,
    MODEL,  # what the observer doubts
) = range(4)
ENTRY = MODEL + MODEL_SIZE
# Numbers kept after the observer's: the base's pose at the last sample, and its step.
# The pattern of that sample is worked out again from the pose, instead of kept module by module.
SAMPLED, STEP = LAST, LAST + 3


@dataclass(frozen=True)
class Presence(Observer):
    """Sees which rotors the parcel covers, by an on/off sensor in each module; supports have none.

    An observer makes pose and velocity of it. It moves its estimate by the same physics, with the
    axes as they are and with nominal friction, the load over the base's centroid; and its
    uncertainty as friction damps it. A module that switches says that the perimeter passed its
    centre since the last sample; one whose state contradicts the estimate, that the perimeter lies
    on its other side: each is one equation, as a Kalman filter takes it. Of a start, `entry` is
    known.

    Raises:
        ValueError: a rate, density or tolerance that is not positive, a negative friction
            coefficient, or a `drop` outside [0, 1).
    """

    sample_rate: float = 200.0  # [Hz] of all sensors together; at most one sample a physics step
    drop: float = 0.0  # [-] probability of a sample to be lost
    mu_max: float | None = None  # [-] friction the observer assumes; None: the plant's own
    mu_min: float | None = None  # [-]
    mu_support: float | None = None  # [-]
    friction_error: float = 0.0  # [-] share by which what friction does may be off
    acceleration_density: float = 0.1  # [m^2/s^3] of the physics' error, in x and in y
    turn_density: float = 5.0  # [rad^2/s^3] of the physics' error in turning
    tolerance: float = 0.001  # [m] of where a sensor switches
    entry: Entry = field(default_factory=Entry)  # what is known of a parcel as it enters

    kept = STEP + 1

    def __post_init__(self) -> None:
        for name in ("sample_rate", "acceleration_density", "turn_density", "tolerance"):
            checks.positive(name, getattr(self, name))
        checks.not_negative("friction_error", self.friction_error)
        self._check_friction()
        if checks.within("drop", self.drop, 0.0, 1.0) == 1.0:
            raise ValueError(f"drop must be less than 1, got {self.drop!r}")
        if not isinstance(self.entry, Entry):
            raise ValueError(f"entry must be an Entry, got {self.entry!r}")

    def sample_steps(self, dt: float) -> int:
        """Physics steps of `dt` [s] from sample to sample.

        Raises:
            ValueError: samples come faster than physics steps.
        """
        steps = round(1.0 / (self.sample_rate * dt))
        if steps == 0:
            raise ValueError(
                f"sample_rate must be at most one sample a physics step, {1.0 / dt:g} Hz, "
                f"got {self.sample_rate!r}"
            )
        return steps

    def numbers(self, dt: float) -> tuple[float, ...]:
        """The settings as compiled code reads them, for physics steps of `dt` [s]."""
        return (
            self.sample_steps(dt),
            self.drop,
            self.tolerance,
            self.acceleration_density,
            self.turn_density,
            self.friction_error,
            *self.entry.settings,
        )

    def draws(self, dt: float, steps: int) -> int:
        """One row of noise a sample.

        Raises:
            ValueError: a control period has more samples than noise is drawn ahead for.
        """
        samples = math.ceil(steps / self.sample_steps(dt))
        if samples > NOISE_ROWS:
            raise ValueError(
                f"sample_rate must be at most {NOISE_ROWS} samples a control period, "
                f"got {self.sample_rate!r} Hz in {steps * dt:g} s"
            )
        return samples

    @staticmethod
    @lane_function
    def begin(numbers: Array, lane: Lane) -> None:
        """Set the observer, and read the sensors for the first time."""
        observer.begin(numbers, ENTRY, lane)
        _keep_sample(lane, 0)

    @staticmethod
    @lane_function
    def look(numbers: Array, lane: Lane, physics: Physics) -> None:
        """Move the estimate over a physics step, and correct it by a sample if one is due."""
        observer.predict(numbers, MODEL, lane, physics)
        if lane.steps % int(numbers[EVERY]) != 0:
            return
        row = lane.noise_row[0]
        lane.noise_row[0] = row + 1
        if lane.noise[row, 3] < numbers[DROP]:
            return
        interval = physics.dt * (lane.steps - lane.kept[STEP])
        _take_switches(numbers, lane, lane.kept[SAMPLED : SAMPLED + 3], interval)
        _take_contradictions(numbers, lane)
        _keep_sample(lane, lane.steps)


@lane_function
def _keep_sample(lane: Lane, step: int) -> None:
    for k in range(3):
        lane.kept[SAMPLED + k] = lane.truth[k]
    lane.kept[STEP] = step


@lane_function
def _take_switch(
    lane: Lane,
    x: float,
    y: float,
    covered: bool,
    interval: float,
    tolerance: float,
    switches: int,
) -> None:
    """The perimeter passed the module at (x, y) within the last `interval` [s], as did others."""
    kept = lane.kept
    lead = 0.5 * interval
    theta = kept[THETA] - lead * kept[OMEGA]
    dx = x - kept[X] + lead * kept[VX]
    dy = y - kept[Y] + lead * kept[VY]
    # The module's velocity as the base sees it, turned to point outwards: it tells which edge
    # passed.
    outwards = -1.0 if covered else 1.0
    ux = outwards * (-kept[VX] + kept[OMEGA] * dy)
    uy = outwards * (-kept[VY] - kept[OMEGA] * dx)
    distance, nx, ny = outside(lane, dx, dy, math.cos(theta), math.sin(theta), ux, uy)
    lever = nx * dy - ny * dx
    speed = nx * kept[VX] + ny * kept[VY] - lever * kept[OMEGA]
    variance = measure(kept, -nx, -ny, lever, lead)
    when = speed * interval
    unsure = switches * (when * when / 12.0 + tolerance * tolerance)
    gain = 1.0 / (variance + unsure)
    correct(kept, -distance * gain, gain)


@lane_function
def _take_contradiction(lane: Lane, x: float, y: float, covered: bool, tolerance: float) -> None:
    """The perimeter lies on the other side of the module at (x, y) than the estimate has it.

    It may lie anywhere there, so that the estimate is moved but gets no surer.
    """
    kept = lane.kept
    dx = x - kept[X]
    dy = y - kept[Y]
    cosine, sine = math.cos(kept[THETA]), math.sin(kept[THETA])
    distance, nx, ny = outside(lane, dx, dy, cosine, sine, 0.0, 0.0)
    if (distance if covered else -distance) <= tolerance:
        return
    variance = measure(kept, -nx, -ny, nx * dy - ny * dx, 0.0)
    correct(kept, -distance / (variance + tolerance * tolerance), 0.0)


@lane_function
def _covered(
    lane: Lane, row: int, pose: Array, other: Array
) -> tuple[int, int, int, int, int, int]:
    """Columns of a row that a base covers in one pose and in another.

    Returns:
        First and last column of the first pose, of the second, and of both together.
    """
    first, last = covered_columns(lane, row, pose[0], pose[1], math.cos(pose[2]), math.sin(pose[2]))
    was_first, was_last = covered_columns(
        lane, row, other[0], other[1], math.cos(other[2]), math.sin(other[2])
    )
    return first, last, was_first, was_last, min(first, was_first), max(last, was_last)


@lane_function
def _rows(lane: Lane, y: float, other_y: float) -> tuple[int, int]:
    """First and last row that a base can cover from either of two places."""
    reach = lane.body[RADIUS] + EDGE_TOLERANCE
    low = math.ceil((min(y, other_y) - reach - lane.elements.y0) / lane.elements.pitch_y)
    high = math.floor((max(y, other_y) + reach - lane.elements.y0) / lane.elements.pitch_y)
    return max(0, int(low)), min(lane.rotor.shape[0] - 1, int(high))


@lane_function
def _count_switches(lane: Lane, sampled: Array) -> int:
    """How many modules switched since the last sample, which the pose `sampled` (3,) gave."""
    truth = lane.truth
    first_row, last_row = _rows(lane, truth[1], sampled[1])
    switches = 0
    for row in range(first_row, last_row + 1):
        first, last, was_first, was_last, low, high = _covered(lane, row, truth, sampled)
        for column in range(low, high + 1):
            differ = (first <= column <= last) != (was_first <= column <= was_last)
            switches += lane.rotor[row, column] and differ
    return switches


@lane_function
def _take_switches(numbers: Array, lane: Lane, sampled: Array, interval: float) -> None:
    """Correct the estimate by every module that switched within the last `interval` [s].

    Switches of one sample share the error of the estimate they are judged by: together they weigh
    as one.
    """
    truth = lane.truth
    switches = _count_switches(lane, sampled)
    if switches == 0:
        return
    first_row, last_row = _rows(lane, truth[1], sampled[1])
    for row in range(first_row, last_row + 1):
        y = lane.elements.y0 + lane.elements.pitch_y * row
        first, last, was_first, was_last, low, high = _covered(lane, row, truth, sampled)
        for column in range(low, high + 1):
            covered = first <= column <= last
            if lane.rotor[row, column] and covered != (was_first <= column <= was_last):
                x = lane.elements.x0 + lane.elements.pitch_x * column
                _take_switch(lane, x, y, covered, interval, numbers[TOLERANCE], switches)


@lane_function
def _take_contradictions(numbers: Array, lane: Lane) -> None:
    """Correct the estimate by every module that it has covered and the sensor has not, or the
    other way about.
    """
    truth = lane.truth
    estimate = lane.kept
    first_row, last_row = _rows(lane, truth[1], estimate[Y])
    for row in range(first_row, last_row + 1):
        y = lane.elements.y0 + lane.elements.pitch_y * row
        first, last, has_first, has_last, low, high = _covered(lane, row, truth, estimate)
        for column in range(low, high + 1):
            covered = first <= column <= last
            if lane.rotor[row, column] and covered != (has_first <= column <= has_last):
                x = lane.elements.x0 + lane.elements.pitch_x * column
                _take_contradiction(lane, x, y, covered, numbers[TOLERANCE])
