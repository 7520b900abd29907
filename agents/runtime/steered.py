"""Streams of a machine: modules that turn to given axes, and the sensor of a tracker."""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from surface_gym.compiler.jit import kernel_function
from surface_gym.config import EnvConfig
from surface_gym.flow import claims, kernel
from surface_gym.flow.batch import StreamBatch, stream_functions
from surface_gym.layouts import ROLLING
from surface_gym.parcel import Disc, Parcel
from surface_gym.physics.types import STATE_SIZE, Array
from surface_gym.sensors import Camera, kalman
from surface_gym.sensors.base import Physics
from surface_gym.sensors.camera import ENTRY, EVERY, MODEL
from surface_gym.state import EnvState

from .estimator import device_camera, machine_axis_speed
from .protocol import Angles

SYMMETRIES = 12  # maximum number of turns that leave a base unchanged


@dataclass(frozen=True)
class Detector(Camera):
    """The sensor of a tracked stream: it predicts each parcel's covariance beside the physics."""

    sensor_size = kalman.LAST

    @staticmethod
    @kernel_function
    def begin(numbers: Array, state: EnvState) -> None:
        """Set the entry's covariance; the estimate is the state of the physics."""
        state.noise_row[0] = 0
        kalman.begin(numbers, ENTRY, state)

    @staticmethod
    @kernel_function
    def update(numbers: Array, state: EnvState, physics: Physics) -> None:
        """Predict the covariance over a physics step, unless the frame period is 0."""
        if numbers[EVERY] > 0.0:
            for k in range(STATE_SIZE):
                state.sensor_state[k] = state.com[k]
            kalman.predict(numbers, MODEL, state, physics)

    @staticmethod
    @kernel_function
    def read(numbers: Array, state: EnvState) -> None:
        """Write the physics' pose and velocity."""
        for k in range(kalman.SIZE):
            state.sensed[k] = state.truth[k]


class SteeredBatch(StreamBatch):
    """Streams whose modules turn to `surfaces.target` instead of obeying commands.

    Only the gate obeys its command. Axes take time to turn.
    """

    def make_kernel(self) -> Any:
        functions = stream_functions(self.config)
        return kernel.make_stream_kernel(functions._replace(part_of=claims.part_of_none))

    def steer(self, i: int, angles: Angles | float) -> None:
        """Set the targets (rows, columns) [rad] of a zone's modules that are not stuck."""
        first_row, rows, first, columns = self.bodies.zone[0]
        zone = np.s_[first_row : first_row + rows, first : first + columns]
        obeys = self.streams.obeys[i if len(self.streams.obeys) > 1 else 0][zone]
        target = self.surfaces.target[i][zone]
        target[:] = np.where(obeys, angles, target)

    def take(self, parcel: Parcel) -> int:
        """Return the body table's row of a parcel, used once more."""
        return self._pool.take(parcel)

    def give_back(self, rows: list[int]) -> None:
        """Give back rows of the body table, one use each."""
        self._pool.give_back(rows)

    def parcel_of(self, row: int) -> Parcel:
        """Return the parcel of a row of the body table."""
        return self._pool.parcel(row)

    def straighten(self) -> None:
        """Set all axes to the conveyor's."""
        for angles in (self.surfaces.angle, self.surfaces.target, self.streams.commanded):
            angles[:] = ROLLING


def steered_config(config: EnvConfig, **changed: Any) -> EnvConfig:
    """Return the configuration of a `SteeredBatch` for a machine of a policy's stream.

    Raises:
        ValueError: modules are driven, or the take-away stops at times that no message tells.
    """
    speed = machine_axis_speed(config)
    demand = getattr(config.stream_task, "demand", None)
    if demand is not None:
        raise ValueError(f"demand must be None in real time, got {demand!r}")
    camera = device_camera(config.sensors)
    # The model of an adaptive camera expects less error, since it learns friction and load.
    detector = Detector(
        latency=camera.latency, position_noise=camera.position_noise, entry=camera.entry,
        angle_noise=camera.angle_noise, drop=camera.drop, frame_rate=camera.frame_rate,
        friction_error=camera.friction_error,
    )  # fmt: skip
    actuators = replace(config.actuators, axis_speed=speed)
    return replace(config, sensors=detector, **{"actuators": actuators, **changed})


@lru_cache(maxsize=512)
def unchanged_turn(parcel: Parcel) -> float:
    """Return the smallest turn [rad] that leaves a parcel's base unchanged; 0 for a disc."""
    base = parcel.base
    if isinstance(base, Disc):
        return 0.0
    corners = (base.outline - np.array(base.centroid)) @ np.array([1.0, 1.0j])
    for count in range(SYMMETRIES, 1, -1):
        turned = corners * np.exp(2j * math.pi / count)
        if np.abs(turned[:, np.newaxis] - corners).min(axis=1).max() < 1e-3 * base.reach:
            return math.tau / count
    return math.tau
