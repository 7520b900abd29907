"""What every kind of sensor has in common."""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

from surface_gym.dynamics.compiled import lane_function
from surface_gym.dynamics.types import Array, Scratch
from surface_gym.lanes.lane import Lane
from surface_gym.plants import Plant

LEARNED = 3  # constants a sensor may learn: the factor of mu_max [-], x and y of the load [m]


class Physics(NamedTuple):
    """What a sensor that predicts may predict by."""

    friction: Array  # (rows, columns, 3) [-] as the sensor assumes it
    stiffness: Array  # (rows, columns) [-] all the same
    scratch: Scratch  # the sensor's own
    dt: float  # [s] physics step


@dataclass(frozen=True)
class Sensor:
    """What a controller gets to see of the parcel.

    A sensor is one class. Its fields are its settings. Its static methods, each a `lane_function`,
    are compiled into every batch that uses it, and write `lane.sensed`, which is all that a task
    observes. They are handed the settings as the array that `numbers` makes of them:

    - `begin(numbers, lane)`, at a start: set `lane.kept`.
    - `look(numbers, lane, physics)`, after every physics step, where the sensor `watches`.
    - `learned(numbers, lane, first, mirror)`, where `observe` asks for "load": write LEARNED
      estimates and then LEARNED doubts into `lane.observation` from `first` on.
    - `estimate(numbers, lane)`, when a controller asks: write pose and velocity into `lane.sensed`.

    Before each, `lane.truth` holds the true pose and velocity of the base's centroid. Noise comes
    from `lane.noise`, a row at a time, of which `lane.noise_row[0]` is the next.
    """

    kept: ClassVar[int] = 0  # numbers of `lane.kept`
    watches: ClassVar[bool] = False  # it looks between decisions

    def numbers(self, dt: float) -> tuple[float, ...]:
        """The settings as compiled code reads them, for physics steps of `dt` [s]."""
        del dt
        return ()

    def draws(self, dt: float, steps: int) -> int:
        """Rows of noise that a start or `steps` physics steps of `dt` [s] use at most."""
        del dt, steps
        return 0

    def friction(self, plant: Plant) -> Array:
        """(rows, columns, 3) [-] friction that `look` may predict by."""
        return plant.friction

    @staticmethod
    @lane_function
    def begin(numbers: Array, lane: Lane) -> None:
        """Nothing to remember."""

    @staticmethod
    @lane_function
    def look(numbers: Array, lane: Lane, physics: Physics) -> None:
        """Nothing to look at."""

    @staticmethod
    @lane_function
    def learned(numbers: Array, lane: Lane, first: int, mirror: float) -> None:
        """Nothing is learned: what is nominal stands, in all doubt."""
        for k in range(LEARNED):
            lane.observation[first + k] = 0.0
            lane.observation[first + LEARNED + k] = 1.0
