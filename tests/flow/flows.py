"""Flows for the tests: short lines, dense streams, and parcels set down by hand."""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import ArrayLike

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.env import SmartSurfaceEnv
from surface_gym.flow.arrivals import Arrival, Poisson, Trace
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.exits import flow_line
from surface_gym.flow.state import ENTERED, INLET
from surface_gym.flow.stream import Stream
from surface_gym.physics.step import com_states
from surface_gym.physics.types import THETA, Array, X, Y
from surface_gym.sensors import Camera, Presence
from tests import environments as te
from tests.environments import FLOW

BRAKE, PLUS_45, MINUS_45, ROLL = range(4)  # choices of the default orientations
MIRRORED = np.array([BRAKE, MINUS_45, PLUS_45, ROLL])  # the choice that each is in a mirror

SHORT = flow_line(2.0)  # 20 columns of rotors, the first 5 of them a lead-in
BOX, LARGE_BOX = sg.layouts.box("S"), sg.layouts.box("B")
# As many as can enter, and more: some wait, and where axes brake some collide.
DENSE = Stream(Poisson(5000.0, 0.15), parcels=("S", "B"), speeds=(1.0, 2.0))

# Each kind of action and of sensor, choices and angles, axes that turn at once and in time. Each
# compiles code of its own, which takes twenty seconds; the last is only tried at night.
KINDS: dict[str, dict[str, Any]] = {
    "modules, exact": {"actions": "modules"},
    "parcels, exact": {"actions": "parcels"},
    "parcels, presence, any angle": {
        "actions": "parcels", "sensors": Presence(), "orientations": "any",
    },
    "parcels, camera, all varies": {
        "actions": "parcels", "sensors": Camera(), **te.EVERYTHING_VARIES,
    },
    "modules, presence, any angle": {
        "actions": "modules", "sensors": Presence(), "orientations": "any",
    },
}  # fmt: skip
every_kind = pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS)


def trace(*arrivals: tuple[float, str], parcel: sg.Parcel = BOX, speed: float = 1.5) -> Stream:
    """A stream of equal parcels: when each comes [s], and the exit it is to leave by."""
    return Stream(Trace(tuple(Arrival(time, parcel, speed, name) for time, name in arrivals)))


def bare(**settings: Any) -> SmartSurfaceEnv:
    """A short flow with a dense stream, without Gymnasium's wrappers."""
    settings = {"stream": DENSE, "duration": 2.0, "line": SHORT, **settings}
    return gym.make(FLOW, disable_env_checker=True, **settings).unwrapped


def same_choice(env: SmartSurfaceEnv, choice: int) -> Any:
    """The action that says one choice for every part."""
    return np.full(env.action_space.shape, choice)


def pair(**settings: Any) -> tuple[SmartSurfaceEnv, SmartSurfaceEnv]:
    """Two equal flows that have begun, for parcels."""
    return te.pair(bare, **{"actions": "parcels", **settings})


def command(batch: StreamBatch, choice: int) -> Array:
    return np.full((1, batch.config.action_kind.size), choice)


Step = tuple[np.ndarray, float, bool, bool, dict[str, Any]]


def steps(env: SmartSurfaceEnv, seed: int, hold: int = 5) -> Iterator[Step]:
    """Every step of an episode of random actions, each held for some periods."""
    env.action_space.seed(seed)
    env.reset(seed=seed)
    over = False
    number = 0
    while not over:
        if number % hold == 0:
            action = env.action_space.sample()
        step = env.step(action)
        over = step[2] or step[3]
        number += 1
        yield step


def play(env: SmartSurfaceEnv, choice: int, seed: int = 0) -> list[Step]:
    """Every step of an episode in which all modules are set to one choice."""
    env.reset(seed=seed)
    played: list[Step] = []
    while not played or not (played[-1][2] or played[-1][3]):
        played.append(env.step(same_choice(env, choice)))
    return played


def batch_with(stream: Stream, **settings: Any) -> StreamBatch:
    """A batch of one surface that has begun."""
    return te.begun(EnvConfig("flow", stream=stream, **{"line": SHORT, **settings}))


def set_down(batch: StreamBatch, poses: ArrayLike, velocities: ArrayLike | None = None) -> None:
    """Put the first arrivals down on the surface of a batch of one, wherever they have entered.

    Args:
        batch: whose arrivals are boxes, at least as many; the first may have entered.
        poses: (parcels, 3) [m, m, rad].
        velocities: (parcels, 3) [m/s, m/s, rad/s]; None: at rest.
    """
    given = np.asarray(poses, dtype=np.float64)
    moving = np.zeros_like(given) if velocities is None else np.asarray(velocities, dtype=float)
    streams, parcels, count = batch.streams, batch.parcels, len(given)
    parcels.state[:count] = com_states(np.zeros((count, 2)), given, moving)
    parcels.sensed[:count, :3] = given
    parcels.sensed[:count, 3:] = moving
    parcels.body[:count] = streams.body[0, :count]
    asked = streams.exit[0, :count]
    parcels.goal[:count, :INLET] = np.column_stack([asked, batch.stream_params.exits[asked]])
    for values in (parcels.memory, parcels.clock, parcels.steps):
        values[:count] = 0
    streams.number[0, :count] = np.arange(count)
    streams.present[0, :count] = True
    streams.entered[0, :count] = streams.clock[0]
    streams.coming[0] = count
    streams.due[0] = max(count, streams.due[0])
    streams.tally[0, ENTERED] = count


def surface_of(settings: EnvConfig, angle: float) -> sg.Surface:
    """The surface with the axes of all that obeys at an angle [rad], for `simulate`."""
    first_row, rows, first, columns = settings.site.zone
    axis = np.full(settings.site.rotor.shape, math.pi / 2)
    axis[first_row : first_row + rows, first : first + columns] = angle
    level = settings.chosen_line.surface(axis, settings.site.rotor)
    task = settings.stream_task
    return dataclasses.replace(level, tilt=task.tilt, tilt_direction=task.tilt_direction)


def box_of(parcel: sg.Parcel, pose: ArrayLike) -> tuple[float, float, float, float]:
    """[m] least and greatest x, least and greatest y of a base whose centroid has a pose."""
    pose = np.asarray(pose)
    cosine, sine = np.cos(pose[THETA]), np.sin(pose[THETA])
    outline = parcel.base.outline - np.array(parcel.base.centroid)
    corners = outline @ np.array([[cosine, sine], [-sine, cosine]])
    low, high = corners.min(axis=0), corners.max(axis=0)
    return pose[X] + low[0], pose[X] + high[0], pose[Y] + low[1], pose[Y] + high[1]


def truths(batch: StreamBatch) -> dict[int, Array]:
    """Pose and velocity of who is there, by the number of arrival."""
    places, numbers = np.flatnonzero(batch.streams.present[0]), batch.streams.number[0]
    return {int(numbers[place]): batch.parcels.truth[place].copy() for place in places}
