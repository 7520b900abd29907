"""Presence: each module's own on/off sensor, and an observer that makes a pose of the pattern."""

import math
from dataclasses import dataclass, field

from surface_gym import bounds, checks
from surface_gym.dynamics.compiled import lane_function
from surface_gym.dynamics.types import Array
from surface_gym.lanes.lane import Lane
from surface_gym.lanes.memory import NOISE_ROWS
from surface_gym.sensors import observer
from surface_gym.sensors.agreement import agree
from surface_gym.sensors.entry import Entry
from surface_gym.sensors.observer import LAST, MODEL_SIZE, Observer
from surface_gym.sensors.possible import keep_possible, most_energy
from surface_gym.sensors.sensor import Physics
from surface_gym.sensors.switches import is_any_pressed, take_contradictions, take_switches

# Columns of the settings; the Entry comes last.
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
    """Sees which rotors the parcel covers, by an on/off sensor in each module; supports have none.

    An observer makes pose and velocity of it. It moves its estimate by the same physics, with the
    axes as they are and with nominal friction, the load over the base's centroid; and its
    uncertainty as friction damps it. A module that switches says that the perimeter passed its
    centre since the last sample; one whose state contradicts the estimate, that the perimeter lies
    on its other side: each is one equation, as a Kalman filter takes it. Of a start, `entry` is
    known.

    Where that leaves the estimate in contradiction, it is moved, least, until it agrees with every
    module; where it cannot be, it is looked for around the pressed ones. It stays over the surface,
    and no faster than a parcel of that entry can be.

    What to expect, by `python -m benchmarks.observer`, over all tasks, 37 controllers and both
    boxes, at a pitch of 100 mm: where the world is as assumed, half of the errors in position are
    up to 1.3 mm and 99.9 % below 21 mm. With a load off centre by up to half the way to the edge
    99.9 % are below 70 mm, the worst is 122 mm; with friction 0.8 or 1.2 of the assumed 46 mm and
    79 mm. With everything wrong at once, single errors of some 0.3 m remain: of parcels that leave
    a line, with a rotor or two pressed, or none, which say little. Headings may then err by any
    angle, and a square's slip by a quarter turn.

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

    kept = ENERGY + 1

    def __post_init__(self) -> None:
        checks.positive("sample_rate", self.sample_rate, *bounds.FRAME_RATE)
        checks.positive("tolerance", self.tolerance, *bounds.TOLERANCE)
        for name in ("acceleration_density", "turn_density"):
            checks.positive(name, getattr(self, name), *bounds.DENSITY)
        checks.not_negative("friction_error", self.friction_error, bounds.FRICTION_ERROR)
        checks.assumed_friction(self.mu_max, self.mu_min, self.mu_support)
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
        lane.kept[ENERGY] = most_energy(lane)
        _keep_sample(lane, 0)

    @staticmethod
    @lane_function
    def look(numbers: Array, lane: Lane, physics: Physics) -> None:
        """Move the estimate over a physics step, and correct it by a sample if one is due."""
        observer.predict(numbers, MODEL, lane, physics)
        keep_possible(lane, lane.kept[ENERGY])
        if lane.steps % int(numbers[EVERY]) != 0:
            return
        row = lane.noise_row[0]
        lane.noise_row[0] = row + 1
        if lane.noise[row, 3] < numbers[DROP]:
            return
        interval = physics.dt * (lane.steps - lane.kept[STEP])
        tolerance = numbers[TOLERANCE]
        take_switches(lane, lane.kept[SAMPLED : SAMPLED + 3], interval, tolerance)
        # Where no switch is pressed it is not known where the parcel has left the rotors to.
        if is_any_pressed(lane) and take_contradictions(lane, tolerance) > 0.0:
            agree(lane, tolerance)
        keep_possible(lane, lane.kept[ENERGY])
        _keep_sample(lane, lane.steps)


@lane_function
def _keep_sample(lane: Lane, step: int) -> None:
    for k in range(3):
        lane.kept[SAMPLED + k] = lane.truth[k]
    lane.kept[STEP] = step
