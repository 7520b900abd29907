"""A camera whose filter learns the friction and the load of the parcel that it sees."""

from dataclasses import dataclass

from surface_gym import bounds, checks
from surface_gym.dynamics.compiled import lane_function
from surface_gym.dynamics.types import Array
from surface_gym.lanes.lane import Lane
from surface_gym.sensors import observer
from surface_gym.sensors.camera import (
    ENTRY,
    FRAME_SIZE,
    FRAMES,
    MODEL,
    TAKEN,
    Camera,
    age,
    shift_frames,
    watch,
    weigh,
)
from surface_gym.sensors.learning import (
    CONSTANT,
    DOUBT,
    LEARNING_LAST,
    begin_learning,
    correct_constants,
    measure_constants,
    predict_learning,
)
from surface_gym.sensors.observer import correct
from surface_gym.sensors.sensor import LEARNED, Physics

SPREADS = ENTRY + 4  # columns of the settings, after those of a Camera


@dataclass(frozen=True)
class LearningCamera(Camera):
    """A `Camera` that estimates more than pose and velocity: the factor by which mu_max differs
    from what it assumes, and where over the base the centre of mass lies.

    Both are constant while a parcel is on the surface, and known at a start to the spreads given.
    A parcel that is braked harder than was reckoned, or that turns where it should not, tells of
    them; see `surface_gym.sensors.learning`. The argument `observe=("load",)` shows them.

    Raises:
        ValueError: as a Camera, or a spread that is not positive.
    """

    acceleration_density: float = 0.0001  # [m^2/s^3] less than a Camera's: the load is known of
    turn_density: float = 0.01  # [rad^2/s^3]
    friction_spread: float = 0.1  # [-] standard deviation of the factor of mu_max from 1
    load_spread: float = 0.015  # [m] of the centre of mass from the base's centroid, in x and in y

    kept = LEARNING_LAST + FRAMES * FRAME_SIZE

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.positive("friction_spread", self.friction_spread, *bounds.LEARNED_SPREAD)
        checks.positive("load_spread", self.load_spread, *bounds.LEARNED_SPREAD)

    def numbers(self, dt: float) -> tuple[float, ...]:
        """The settings as compiled code reads them, for physics steps of `dt` [s]."""
        return (*super().numbers(dt), self.friction_spread, self.load_spread)

    @staticmethod
    @lane_function
    def begin(numbers: Array, lane: Lane) -> None:
        """Set the filter; frames from before never arrive."""
        observer.begin(numbers, ENTRY, lane)
        begin_learning(numbers, SPREADS, lane)
        for k in range(FRAMES):
            lane.kept[LEARNING_LAST + FRAME_SIZE * k + TAKEN] = 0.0

    @staticmethod
    @lane_function
    def look(numbers: Array, lane: Lane, physics: Physics) -> None:
        """As a Camera does."""
        predict_learning(numbers, MODEL, lane, physics)
        place = watch(numbers, lane, LEARNING_LAST)
        if place > 0:
            _use(numbers, lane, place, physics.dt)

    @staticmethod
    @lane_function
    def learned(numbers: Array, lane: Lane, first: int, mirror: float) -> None:
        """Show what was learned, and how much of the doubt about it is left."""
        kept, see = lane.kept, lane.observation
        for j in range(LEARNED):
            spread = numbers[SPREADS + min(j, 1)]
            apart = kept[CONSTANT + j] - (1.0 if j == 0 else 0.0)
            see[first + j] = (mirror if j == 2 else 1.0) * apart / spread
            left = max(0.0, kept[DOUBT + (LEARNED + 1) * j]) ** 0.5 / spread
            see[first + LEARNED + j] = min(1.0, left)


@lane_function
def _use(numbers: Array, lane: Lane, place: int, dt: float) -> None:
    """Correct the estimate by what a frame shows, a coordinate at a time."""
    lead = age(lane, place, dt)
    for k in range(3):
        shift, shrink = weigh(numbers, lane, place, k, lead)
        measure_constants(lane.kept, k, lead)
        correct(lane.kept, shift, shrink)
        correct_constants(lane, shift, shrink)
        shift_frames(lane, LEARNING_LAST, shift, dt)
