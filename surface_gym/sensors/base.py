"""The base class of sensors, the exact sensor, and the prior of a parcel's state at its entry."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.compiler.jit import kernel_function
from surface_gym.lines import BaseLine
from surface_gym.physics.types import Array, Scratch
from surface_gym.state import EnvState
from surface_gym.tasks.features import Feature

Singles = NDArray[np.float32]

LEARNED = 3  # estimated constants: the factor of mu_max [-], x and y of the load [m]


class Physics(NamedTuple):
    """Physical model of a sensor's predictions."""

    friction: Array  # (rows, columns, 3) [-] assumed friction
    stiffness: Array  # (rows, columns) [-] equal stiffness
    scratch: Scratch  # scratch of the sensor
    dt: float  # [s] physics step


class Group(NamedTuple):
    """A group of features that an environment's argument `observe` adds to the observation."""

    features: tuple[Feature, ...]
    # kernel function `show(numbers, state, see, mirror)`, which writes the features into `see`
    show: Callable[..., None]


LOAD_FEATURES = (
    Feature("friction learned", -100.0, 100.0, "(factor of mu_max - 1) / prior deviation"),
    Feature("load learned, x", -100.0, 100.0, "position in the base / prior deviation"),
    Feature("load learned, y", -100.0, 100.0, "position in the base / prior deviation"),
    Feature("doubt of friction", 0.0, 1.0, "standard deviation / prior deviation"),
    Feature("doubt of load, x", 0.0, 1.0, "standard deviation / prior deviation"),
    Feature("doubt of load, y", 0.0, 1.0, "standard deviation / prior deviation"),
)


@dataclass(frozen=True)
class Sensor:
    """The base class of sensors, which report the motion of the parcel to a controller.

    A sensor is one class, whose fields are its parameters. Its static methods are
    `kernel_function`s, compiled into every batch with this sensor. The methods write
    `state.sensed`, which a task observes. Their argument `numbers` is an array of the parameters,
    made by the method `numbers`:

    - `begin(numbers, state)`, at a start: set `state.sensor_state`.
    - `update(numbers, state, physics)`, after every physics step, if the class defines it.
    - `read(numbers, state)`, when a controller reads the sensor: write pose and velocity into
      `state.sensed`.

    A sensor may report other quantities, in groups of features. The property `groups` returns these
    groups by name, so that the argument `observe` of an environment can select them. The function
    of a selected group is called after `read`:

    - `show(numbers, state, see, mirror)`: write the group's features into `see`. `mirror` is -1 if
      the task mirrors y, else 1.

    At every call, `state.truth` holds the true pose and velocity of the base's centroid. Noise
    comes from rows of `state.noise`; `state.noise_row[0]` is the index of the next row.
    """

    sensor_size: ClassVar[int] = 0  # size of `state.sensor_state`

    @property
    def watches(self) -> bool:
        """Whether a kernel calls `update`. A class that does not define `update` needs no call."""
        return type(self).update is not Sensor.update

    def numbers(self, dt: float) -> tuple[float, ...]:
        """Return the parameters for compiled code. A physics step lasts `dt` [s]."""
        del dt
        return ()

    def draws(self, dt: float, steps: int) -> int:
        """Return how many noise rows are enough for a start, and for `steps` steps of `dt` [s]."""
        del dt, steps
        return 0

    @property
    def learned_spreads(self) -> tuple[float, float]:
        """Return prior standard deviations of the friction factor [-] and the load's position [m].

        If the sensor does not estimate friction and load, the two deviations are 0.
        """
        return 0.0, 0.0

    @property
    def groups(self) -> Mapping[str, Group]:
        """Return the sensor's groups of features for the argument `observe`, by name."""
        return {"load": Group(LOAD_FEATURES, self.show_load)}

    def friction(self, line: BaseLine) -> Array:
        """Return mu_max, mu_min and mu_support (rows, columns, 3) [-] that `update` assumes."""
        return line.friction

    @staticmethod
    @kernel_function
    def begin(numbers: Array, state: EnvState) -> None:
        """Do nothing."""

    @staticmethod
    @kernel_function
    def update(numbers: Array, state: EnvState, physics: Physics) -> None:
        """Do nothing."""

    @staticmethod
    @kernel_function
    def show_load(numbers: Array, state: EnvState, see: Singles, mirror: float) -> None:
        """Write the prior of friction and load as `LOAD_FEATURES`. The sensor estimates neither."""
        for k in range(LEARNED):
            see[k] = 0.0
            see[LEARNED + k] = 1.0


ENTRY_ROWS = 2  # rows of noise at a start


@dataclass(frozen=True)
class Entry:
    """Prior of pose and velocity of a parcel at its entry.

    The conveyor before the surface has a known speed, and its guides align the parcel. So the first
    estimate is the true state plus Gaussian errors. The fields are the errors' standard deviations.
    """

    position: float = 0.002  # [m] x and y
    angle: float = 0.01  # [rad]
    speed: float = 0.05  # [m/s] vx and vy
    turning: float = 0.1  # [rad/s]

    def __post_init__(self) -> None:
        for name, most in (
            ("position", checks.POSITION_ERROR),
            ("speed", checks.SPEED),
            ("turning", checks.SPIN),
        ):
            checks.not_negative(name, getattr(self, name), most)
        checks.angle("angle", self.angle, 0.0, checks.ANGLE_ERROR)

    @property
    def params(self) -> tuple[float, float, float, float]:
        """Return the prior for compiled code."""
        return (self.position, self.angle, self.speed, self.turning)


@kernel_function
def enter(params: Array, first: int, state: EnvState) -> None:
    """Write the prior of pose and velocity into the first 6 entries of `state.sensor_state`.

    `params[first:]` holds `Entry.params`.
    """
    row = state.noise_row[0]
    state.noise_row[0] = row + ENTRY_ROWS
    for k in range(3):
        pose_error = params[first] if k < 2 else params[first + 1]
        velocity_error = params[first + 2] if k < 2 else params[first + 3]
        state.sensor_state[k] = state.truth[k] + pose_error * state.noise[row, k]
        state.sensor_state[3 + k] = state.truth[3 + k] + velocity_error * state.noise[row + 1, k]


@dataclass(frozen=True)
class Exact(Sensor):
    """A sensor that reports exact pose and velocity of the base's centroid without delay."""

    @staticmethod
    @kernel_function
    def read(numbers: Array, state: EnvState) -> None:
        """Write the true pose and velocity."""
        for k in range(6):
            state.sensed[k] = state.truth[k]
