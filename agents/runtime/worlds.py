"""Simulated machines: a surface, its parcels and a camera, simulated up to the caller's time.

`SimulatedMachine` has one parcel at a time. `SimulatedStream` has a stream of parcels. Its camera
reports poses without the parcels' numbers, and its modules turn to given axes (`SteeredBatch`).
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

import surface_gym as sg
from surface_gym import actions, checks
from surface_gym.compiler.jit import kernel_function
from surface_gym.config import EnvConfig
from surface_gym.core.batch import Batch
from surface_gym.flow import claims, kernel, state as fs
from surface_gym.flow.batch import StreamBatch, stream_functions
from surface_gym.layouts import ROLLING
from surface_gym.machine import messages as ms
from surface_gym.parcel import Disc, Parcel
from surface_gym.physics.step import tilt_of_gravity
from surface_gym.physics.types import STATE_SIZE, Array
from surface_gym.sensors import Camera, kalman
from surface_gym.sensors.base import Physics
from surface_gym.sensors.camera import ENTRY, EVERY, MODEL
from surface_gym.state import GRAVITY_COLUMNS, RUNNING, EnvState

from .config import WorldOptions
from .estimator import device_camera, machine_axis_speed, zone_angles
from .protocol import AxisLimits

ONLY = np.zeros(1, dtype=np.int64)  # index of the only environment
SHUT = (math.inf, math.inf)
TOUCHING = 0.02  # [s] parcels that pushed each other this long ago still touch
MERGED_FOR = 0.2  # [s] for which two touching parcels are seen as one
SYMMETRIES = 12  # maximum number of turns that leave a base unchanged

Timed = tuple[float, ms.Message]  # the time [s] at which a message is due


class SimulatedWorld(ABC):
    """Base class of simulated machines.

    The physics is at most one step ahead of the caller's clock, so commanded axes never turn early.
    Pictures are reported after the camera's latency.
    """

    shape: tuple[int, int]  # (rows, columns) of the widest zone
    has_gate = False  # whether `open_gate` has an effect
    _batch: Any

    def __init__(
        self, env_config: EnvConfig, seed: int, begun: float, options: WorldOptions
    ) -> None:
        camera, self.dt = device_camera(env_config.sensors), env_config.timing.dt
        self._camera, self._every = camera, camera.frame_steps(self.dt)
        delays = (options.late, camera.latency, self._every * self.dt)
        self._latency = next(each for each in delays if each is not None)
        entry = camera.entry
        self._entry_spread = np.array(
            [entry.position] * 2 + [entry.angle] + [entry.speed] * 2 + [entry.turning]
        )
        self._spread = np.array([camera.position_noise] * 2 + [camera.angle_noise])
        self._generator, self._noise = map(
            np.random.default_rng, np.random.SeedSequence(seed).spawn(2)
        )
        self._options = options
        self._now = begun
        self._step = 0

    @property
    def now(self) -> float:
        """Time [s] of the physics."""
        return self._now

    def stand_still(self, seconds: float) -> None:
        """Add `seconds` [s] to the time of the physics. Nothing moves in this time."""
        self._now += seconds

    def greet(self) -> Sequence[ms.Message]:
        """Return the messages for a new controller."""
        return ()

    def open_gate(self, begin: float, end: float) -> None:
        """Let one parcel enter between `begin` and `end` [s], as soon as there is room."""
        raise ValueError(f"gate must be of a stream, got times {begin:g} to {end:g} s")

    def set_axes(self, command: int, angles: ms.Angles) -> ms.AxesAcknowledgement:
        """Obey the command with the number `command`: turn axes to angles (rows, columns) [rad].

        Invalid angles have no effect; the returned acknowledgement says why angles are invalid.
        """
        fault = AxisLimits(self.shape, None).fault(angles)
        if not fault:
            self._steer(angles)
        return ms.AxesAcknowledgement(command, self._now, fault)

    def advance(self, until: float) -> list[Timed]:
        """Simulate until a time [s]; return messages, each with the time [s] to send it."""
        messages: list[Timed] = []
        while self._now <= until:
            messages += self._move()
            self._now += self.dt
            self._step += 1
            messages += [(self._now, each) for each in self._report()]
            if self._step % self._every == 0:
                picture = self._take_picture()
                if picture is not None:
                    messages.append((self._now + self._latency, picture))
            messages += [(self._now, each) for each in self._end()]
        return messages

    def _measured(self, start: Array) -> tuple[ms.Triple, ms.Triple]:
        """Return an entry's pose and velocity with errors of measurement; `start` (6,) is exact."""
        known = start + self._entry_spread * self._noise.standard_normal(6)
        return ms.triple(known[:3]), ms.triple(known[3:])

    @abstractmethod
    def _steer(self, angles: ms.Angles) -> None:
        """Turn the axes to the angles (rows, columns) [rad]. The caller has checked the angles."""

    @abstractmethod
    def _move(self) -> list[Timed]:
        """Do a step of the physics. Return messages about events before the step, e.g. an entry."""

    def _report(self) -> list[ms.Message]:
        """Return messages about the last step. The machine sends these messages without delay."""
        return []

    @abstractmethod
    def _take_picture(self) -> ms.Frame | ms.Detections | None:
        """Return a picture, or None if the picture is lost."""

    @abstractmethod
    def _end(self) -> list[ms.Message]:
        """End the episode if it is over; return messages about its parcels."""


def known_parcel(parcel: Parcel) -> Parcel:
    """Return a parcel with its mass evenly distributed: devices do not know where the load is."""
    return replace(parcel, com_offset=(0.0, 0.0), inertia=None)


class SimulatedMachine(SimulatedWorld):
    """A simulated machine with one parcel after the other."""

    def __init__(
        self, env_config: EnvConfig, seed: int, begun: float, options: WorldOptions
    ) -> None:
        super().__init__(env_config, seed, begun, options)
        self._limit = env_config.task.periods * env_config.timing.steps
        self._batch = Batch(
            replace(
                env_config,
                actions="modules",
                orientations=actions.ANY,
                control_period=self.dt,
                sensors=sg.sensors.Exact(),
                observe=(),
                observe_axes=False,
                info=(),
            ),
            1,
        )
        self._batch.seed(0, self._generator)
        kind = self._batch.config.action_kind
        self.shape = (kind.rows, kind.columns)
        self._number = -1
        self._present = False
        self._enters = begun + options.pause
        self._command = np.full((1, kind.size), ROLLING)

    def stand_still(self, seconds: float) -> None:
        super().stand_still(seconds)
        self._enters += seconds

    def _steer(self, angles: ms.Angles) -> None:
        self._command[0] = angles.ravel()

    def _move(self) -> list[Timed]:
        messages: list[Timed] = []
        if not self._present and self._now >= self._enters:
            messages.append((self._now, self._enter()))
        if self._present:
            self._batch.step(self._command)
        return messages

    def _enter(self) -> ms.ParcelEntry:
        self._command[:] = ROLLING
        self._batch.reset(ONLY)
        self._present = True
        self._number += 1
        state = self._batch.view(0)
        tilt, direction = tilt_of_gravity(*state.surface[GRAVITY_COLUMNS].tolist())
        return ms.ParcelEntry(
            self._number,
            self._now,
            known_parcel(self._batch.parcel(0)),
            *self._measured(state.truth),
            tuple(state.goal.tolist()),
            tilt,
            state.path.copy() if len(state.path) else None,
            direction,
        )

    def _take_picture(self) -> ms.Frame | None:
        noise, lot = self._noise.standard_normal(3), self._noise.random()
        if lot < self._camera.drop:
            return None
        if not self._present:
            return ms.Frame(self._now)
        pose = self._batch.parcels.truth[0, :3] + self._spread * noise
        axes = None
        if self._options.encoders:
            axes = zone_angles(self._batch.axes(0), self._batch.view(0).zone, self.shape)
        return ms.Frame(self._now, self._number, ms.triple(pose), axes)

    def _end(self) -> list[ms.Message]:
        parcels, task = self._batch.parcels, self._batch.task
        ends = self._batch.outcome[0] != RUNNING
        if not self._present or not (ends or parcels.steps[0] >= self._limit):
            return []
        self._present = False
        self._enters = self._now + self._options.pause
        outcome = self._batch.outcomes[int(parcels.outcome[0])] if ends else "out of time"
        metrics = dict(zip(task.metrics, parcels.metrics[0].tolist(), strict=True))
        return [ms.ParcelDeparture(self._number, outcome, metrics)]


@dataclass(frozen=True)
class Detector(Camera):
    """A stream's camera. The camera also predicts the covariance of each parcel's state."""

    sensor_size = kalman.LAST

    @staticmethod
    @kernel_function
    def begin(numbers: Array, state: EnvState) -> None:
        """Set the covariance to the prior at entry. The physics' state serves as the estimate."""
        state.noise_row[0] = 0
        kalman.begin(numbers, ENTRY, state)

    @staticmethod
    @kernel_function
    def update(numbers: Array, state: EnvState, physics: Physics) -> None:
        """Predict the covariance after a physics step. If the frame period is 0, do nothing."""
        if numbers[EVERY] > 0.0:
            for k in range(STATE_SIZE):
                state.sensor_state[k] = state.com[k]
            kalman.predict(numbers, MODEL, state, physics)

    @staticmethod
    @kernel_function
    def read(numbers: Array, state: EnvState) -> None:
        """Copy pose and velocity from `state.truth` (the physics) to `state.sensed`."""
        for k in range(kalman.SIZE):
            state.sensed[k] = state.truth[k]


class SteeredBatch(StreamBatch):
    """Streams whose modules turn to the angles in `surfaces.target`, not to commanded angles.

    Only the gate, where parcels wait to enter, obeys commands. Axes take time to turn.
    """

    def make_kernel(self) -> Any:
        functions = stream_functions(self.config)
        return kernel.make_stream_kernel(functions._replace(part_of=claims.part_of_none))

    def steer(self, i: int, angles: ms.Angles | float) -> None:
        """Set the target angles [rad] of the zone's modules, but not of stuck modules.

        Args:
            angles: (rows, columns) of the zone, or one angle for all.
        """
        first_row, rows, first, columns = self.bodies.zone[0]
        zone = np.s_[first_row : first_row + rows, first : first + columns]
        obeys = self.streams.obeys[i if len(self.streams.obeys) > 1 else 0][zone]
        target = self.surfaces.target[i][zone]
        target[:] = np.where(obeys, angles, target)

    def take(self, parcel: Parcel) -> int:
        """Return the body table's row of a parcel, and count one more use of the row."""
        return self._pool.take(parcel)

    def give_back(self, rows: list[int]) -> None:
        """Remove one user from a row of the body table, for each row index in `rows`."""
        self._pool.give_back(rows)

    def parcel_of(self, row: int) -> Parcel:
        """Return the parcel of a row of the body table."""
        return self._pool.parcel(row)

    def straighten(self) -> None:
        """Set all axes to 90 deg, at which parcels roll on."""
        for angles in (self.surfaces.angle, self.surfaces.target, self.streams.commanded):
            angles[:] = ROLLING


def steered_config(config: EnvConfig, **changed: Any) -> EnvConfig:
    """Return the configuration of a `SteeredBatch`, given a policy's environment.

    Raises:
        ValueError: the modules are driven, or the take-away conveyor sometimes stops. Messages do
            not announce stops of the conveyor.
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
    """Return the smallest turn [rad] after which a base looks the same, or 0 for a disc."""
    base = parcel.base
    if isinstance(base, Disc):
        return 0.0
    corners = (base.outline - np.array(base.centroid)) @ np.array([1.0, 1.0j])
    for count in range(SYMMETRIES, 1, -1):
        turned = corners * np.exp(2j * math.pi / count)
        if np.abs(turned[:, np.newaxis] - corners).min(axis=1).max() < 1e-3 * base.reach:
            return math.tau / count
    return math.tau


class SimulatedStream(SimulatedWorld):
    """A simulated machine with a stream; its camera reports poses without parcels' numbers."""

    has_gate = True

    def __init__(
        self, env_config: EnvConfig, seed: int, begun: float, options: WorldOptions
    ) -> None:
        super().__init__(env_config, seed, begun, options)
        task = replace(env_config.stream_task, duration=min(options.shift, checks.EPISODE))
        config = replace(env_config, task=task)
        self._batch = SteeredBatch(steered_config(config, control_period=self.dt), 1)
        self._batch.params.sensor[EVERY] = 0.0  # it estimates nothing
        _, rows, _, columns = config.site.zone
        self.shape = (int(rows), int(columns))
        self._batch.seed(0, self._generator)
        self._seed = seed
        self._opens = SHUT  # [s] from when to when the gate lets one parcel in
        self._command = np.zeros((1, self._batch.config.action_kind.size), dtype=np.int64)
        first_row, rows, first, columns = config.rotors
        line = config.chosen_line
        low = line.origin[1] + line.pitch_y * (first_row - 0.5)
        self._extent = (  # [m] of the rotors in x and y, where poses may be false
            line.column_edge(first), line.column_edge(first + columns), low,
            low + line.pitch_y * rows,
        )  # fmt: skip
        self._first = 0  # number of the episode's first parcel
        self._reset()

    def _reset(self) -> None:
        """Begin an episode on an empty surface."""
        self._first += int(self._batch.streams.due[0])
        self._batch.straighten()
        self._batch.reset(ONLY)
        self._begun, self._due = self._now, 0
        self._arrivals = np.full(self._batch.rows, fs.NOBODY)  # in each row

    @property
    def streams(self) -> fs.StreamState:
        """True state of the stream."""
        return self._batch.streams

    @property
    def poses(self) -> tuple[NDArray[np.int64], Array]:
        """Numbers (parcels,) and true poses (parcels, 3) of the parcels on the surface."""
        rows = np.flatnonzero(self.streams.present[0])
        return self._first + self.streams.number[0, rows], self._batch.parcels.truth[rows, :3]

    def stand_still(self, seconds: float) -> None:
        super().stand_still(seconds)
        self._begun += seconds

    def open_gate(self, begin: float, end: float) -> None:
        self._opens = (begin, end)

    def _steer(self, angles: ms.Angles) -> None:
        self._batch.steer(0, angles)

    def _move(self) -> list[Timed]:
        begin, end = self._opens
        if self._batch.config.stream_task.gate:
            self._command[0, -1] = begin - 1e-9 <= self._now + self.dt <= end + 1e-9
        self._batch.step(self._command)
        return []

    def _end(self) -> list[ms.Message]:
        if self._batch.outcome[0] == RUNNING:
            return []
        jammed: list[ms.Message] = [
            ms.ParcelDeparture(number, "jam") for number in self.poses[0].tolist()
        ]
        self._reset()
        return jammed

    def _report(self) -> list[ms.Message]:
        """Return messages about parcels that reached the gate, entered or departed in this step."""
        streams = self.streams
        messages = self._waiting(self._due)
        self._due = int(streams.due[0])
        arrivals = np.where(streams.present[0], streams.number[0], fs.NOBODY)
        for row in np.flatnonzero(self._arrivals != arrivals).tolist():
            if (gone := self._arrivals[row]) != fs.NOBODY:
                outcome = "success" if streams.correct[0, gone] else "wrong"
                messages.append(ms.ParcelDeparture(self._first + int(gone), outcome))
            if (come := int(arrivals[row])) != fs.NOBODY:
                self._opens = SHUT
                messages.append(self._entry(come, self._now, self._batch.parcels.truth[row]))
        self._arrivals = arrivals
        return messages

    def _waiting(self, first: int) -> list[ms.Message]:
        """Return messages about parcels that wait at the gate, beginning with arrival `first`."""
        streams, messages = self.streams, list[ms.Message]()
        if self._batch.config.stream_task.gate:
            for arrival in range(first, int(streams.due[0])):
                start = streams.start[0, arrival, :6].copy()
                cosine, sine = math.cos(start[2]), math.sin(start[2])
                x, y = self._parcel(arrival).com_offset
                start[:2] -= cosine * x - sine * y, sine * x + cosine * y
                at = self._begun + float(streams.time[0, arrival])
                messages.append(self._entry(arrival, at, start, waits=True))
        return messages

    def greet(self) -> list[ms.Message]:
        """Return messages about all parcels that wait or are on the surface."""
        rows = np.flatnonzero(self.streams.present[0])
        truth = self._batch.parcels.truth
        return self._waiting(int(self.streams.coming[0])) + [
            self._entry(int(self.streams.number[0, row]), self._now, truth[row]) for row in rows
        ]

    def _entry(self, arrival: int, at: float, start: Array, waits: bool = False) -> ms.ParcelEntry:
        """Return the message that parcel `arrival` enters, or waits at the gate if `waits` is true.

        `at` is the time [s]. `start` (6,) is the true pose and velocity. The message contains a
        measured pose and velocity.
        """
        streams, order = self.streams, self._first + int(self.streams.order[0, arrival])
        goal = (streams.exit[0, arrival], streams.inlet[0, arrival], order)
        gravity = self._batch.view(0).surface[GRAVITY_COLUMNS]
        tilt, direction = tilt_of_gravity(*gravity.tolist())
        return ms.ParcelEntry(
            self._first + arrival, at, known_parcel(self._parcel(arrival)), *self._measured(start),
            tuple(map(float, goal)), tilt, None, direction, waits,
        )  # fmt: skip

    def _parcel(self, arrival: int) -> Parcel:
        return self._batch.parcel_of(int(self.streams.body[0, arrival]))

    def _are_merged(self, one: int, other: int) -> bool:
        """Return whether the camera sees touching parcels (rows `one`, `other`) as one parcel."""
        pair = self.streams.number[0, [one, other]].tolist()
        draw = np.random.default_rng((self._seed, *pair, int(self._now / MERGED_FOR)))
        return bool(draw.random() < self._options.merged)

    def _take_picture(self) -> ms.Detections:
        """Detect parcels. Some are missed, some share a pose, and some poses have no parcel."""
        rows, rng, options = np.flatnonzero(self.streams.present[0]), self._noise, self._options
        truth = self._batch.parcels.truth[rows, :3]
        poses = truth + self._spread * rng.standard_normal(truth.shape)
        for k, row in enumerate(rows.tolist()):
            turn = unchanged_turn(self._parcel(int(self.streams.number[0, row]))) or math.tau
            poses[k, 2] -= turn * round(poses[k, 2] / turn)
        is_seen = rng.random(len(rows)) >= max(options.lost, self._camera.drop)
        found = []
        since = self.streams.steps[0] - self.streams.touched_at[0][np.ix_(rows, rows)]
        for one, other in np.argwhere(np.triu(since * self.dt <= TOUCHING, 1)).tolist():
            if is_seen[one] and is_seen[other] and self._are_merged(rows[one], rows[other]):
                is_seen[[one, other]] = False
                found.append(0.5 * (poses[one] + poses[other]))
        found += list(poses[is_seen])
        low, high, right, left = self._extent
        for _ in range(rng.poisson(options.false * len(rows))):
            found.append(rng.uniform((low, right, -math.pi), (high, left, math.pi)))
        return ms.Detections(
            self._now, tuple(ms.triple(found[k]) for k in rng.permutation(len(found)))
        )
