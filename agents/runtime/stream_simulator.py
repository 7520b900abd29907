"""A simulated machine of a stream: its camera reports poses without identity."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import surface_gym as sg
from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.flow import state as fs
from surface_gym.physics.types import Array
from surface_gym.sensors.camera import EVERY
from surface_gym.state import RUNNING

from . import controller, protocol as wire
from .config import WorldOptions
from .estimator import device_camera
from .steered import SteeredBatch, steered_config, unchanged_turn

ONLY = np.zeros(1, dtype=np.int64)  # index of the only surface
SHUT = (math.inf, math.inf)
TOUCHING = 0.02  # [s] parcels that pushed each other this long ago still touch
MERGED_FOR = 0.2  # [s] for which two touching parcels are seen as one


class SimulatedStream:
    """A surface with a stream of parcels and a camera, driven by the caller's clock.

    As in `SimulatedMachine`, the physics is at most one step ahead of the caller's clock.
    """

    def __init__(
        self, env_config: EnvConfig, seed: int, begun: float, options: WorldOptions
    ) -> None:
        self._camera = device_camera(env_config.sensors)
        self.dt = env_config.timing.dt
        self._every = self._camera.frame_steps(self.dt)
        delays = (options.late, self._camera.latency, self._every * self.dt)
        self._latency = next(each for each in delays if each is not None)
        task = replace(env_config.stream_task, duration=min(options.shift, checks.EPISODE))
        config = replace(env_config, task=task)
        self._batch = SteeredBatch(steered_config(config, control_period=self.dt), 1)
        self._batch.params.sensor[EVERY] = 0.0  # it estimates nothing
        _, rows, _, columns = config.site.zone
        self.shape = (int(rows), int(columns))
        self._limits = controller.AxisLimits(self.shape, None)
        generator, self._noise = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(2))
        self._batch.seed(0, generator)
        self._options, self._seed = options, seed
        self._now = begun
        self._step = 0
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
    def now(self) -> float:
        """Time [s] of the physics."""
        return self._now

    @property
    def streams(self) -> fs.StreamState:
        """The true stream."""
        return self._batch.streams

    @property
    def poses(self) -> tuple[NDArray[np.int64], Array]:
        """Numbers (parcels,) and true poses (parcels, 3) of the parcels on the surface."""
        rows = np.flatnonzero(self.streams.present[0])
        return self._first + self.streams.number[0, rows], self._batch.parcels.truth[rows, :3]

    def stand_still(self, seconds: float) -> None:
        """Let time [s] pass without motion, after the physics fell too far behind the clock."""
        self._now += seconds
        self._begun += seconds

    def set_axes(self, command: int, angles: wire.Angles) -> wire.AxesAcknowledgement:
        fault = self._limits.fault(angles)
        if not fault:
            self._batch.steer(0, angles)
        return wire.AxesAcknowledgement(command, self._now, fault)

    def open_gate(self, begin: float, end: float) -> None:
        """Let one parcel in between two times [s], as soon as there is room."""
        self._opens = (begin, end)

    def advance(self, until: float) -> list[tuple[float, wire.Message]]:
        """Simulate until a time [s]; return messages with the time [s] at which each is due."""
        messages: list[tuple[float, wire.Message]] = []
        while self._now <= until:
            begin, end = self._opens
            if self._batch.config.stream_task.gate:
                self._command[0, -1] = begin - 1e-9 <= self._now + self.dt <= end + 1e-9
            self._batch.step(self._command)
            self._now += self.dt
            self._step += 1
            messages += [(self._now, each) for each in self._report()]
            if self._step % self._every == 0:
                picture = wire.Detections(self._now, self._detect())
                messages.append((self._now + self._latency, picture))
            if self._batch.outcome[0] != RUNNING:
                for number in self.poses[0].tolist():
                    messages.append((self._now, wire.ParcelDeparture(number, "jam")))
                self._reset()
        return messages

    def _report(self) -> list[wire.Message]:
        """Return messages of the parcels that came to the gate, entered or departed in a step."""
        streams = self.streams
        messages = self._waiting(self._due)
        self._due = int(streams.due[0])
        arrivals = np.where(streams.present[0], streams.number[0], fs.NOBODY)
        for row in np.flatnonzero(self._arrivals != arrivals).tolist():
            if (gone := self._arrivals[row]) != fs.NOBODY:
                outcome = "success" if streams.correct[0, gone] else "wrong"
                messages.append(wire.ParcelDeparture(self._first + int(gone), outcome))
            if (come := int(arrivals[row])) != fs.NOBODY:
                self._opens = SHUT
                messages.append(self._entry(come, self._now, self._batch.parcels.truth[row]))
        self._arrivals = arrivals
        return messages

    def _waiting(self, first: int) -> list[wire.Message]:
        """Return the entries of parcels at the gate, from an arrival on."""
        streams, messages = self.streams, list[wire.Message]()
        if self._batch.config.stream_task.gate:
            for arrival in range(first, int(streams.due[0])):
                start = streams.start[0, arrival, :6].copy()
                cosine, sine = math.cos(start[2]), math.sin(start[2])
                x, y = self._parcel(arrival).com_offset
                start[:2] -= cosine * x - sine * y, sine * x + cosine * y
                at = self._begun + float(streams.time[0, arrival])
                messages.append(self._entry(arrival, at, start, waits=True))
        return messages

    def greet(self) -> list[wire.Message]:
        """Return entries of the parcels that wait or are on the surface, for a new controller."""
        rows = np.flatnonzero(self.streams.present[0])
        truth = self._batch.parcels.truth
        return self._waiting(int(self.streams.coming[0])) + [
            self._entry(int(self.streams.number[0, row]), self._now, truth[row]) for row in rows
        ]

    def _entry(
        self, arrival: int, at: float, start: Array, waits: bool = False
    ) -> wire.ParcelEntry:
        """Return an entry with a pose and velocity `start` (6,), as far as they are known."""
        streams, entry = self.streams, self._camera.entry
        spread = [entry.position] * 2 + [entry.angle] + [entry.speed] * 2 + [entry.turning]
        known = start + np.array(spread) * self._noise.standard_normal(6)
        order = self._first + int(streams.order[0, arrival])
        goal = (streams.exit[0, arrival], streams.inlet[0, arrival], order)
        parcel = replace(self._parcel(arrival), com_offset=(0.0, 0.0), inertia=None)
        return wire.ParcelEntry(
            self._first + arrival, at, parcel, wire.triple(known[:3]), wire.triple(known[3:]),
            tuple(map(float, goal)), waits=waits,
        )  # fmt: skip

    def _parcel(self, arrival: int) -> sg.Parcel:
        return self._batch.parcel_of(int(self.streams.body[0, arrival]))

    def _are_merged(self, one: int, other: int) -> bool:
        """Return whether the camera takes two touching parcels for one, for a while."""
        pair = self.streams.number[0, [one, other]].tolist()
        draw = np.random.default_rng((self._seed, *pair, int(self._now / MERGED_FOR)))
        return bool(draw.random() < self._options.merged)

    def _detect(self) -> tuple[wire.Triple, ...]:
        """Return the poses that the camera finds: some are lost, false, or of two parcels."""
        rows, rng, options = np.flatnonzero(self.streams.present[0]), self._noise, self._options
        truth = self._batch.parcels.truth[rows, :3]
        spread = [self._camera.position_noise] * 2 + [self._camera.angle_noise]
        poses = truth + np.array(spread) * rng.standard_normal(truth.shape)
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
            place = rng.uniform((low, right, -math.pi), (high, left, math.pi))
            found.append(place)
        return tuple(wire.triple(found[k]) for k in rng.permutation(len(found)))
