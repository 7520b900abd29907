"""The tracker of a stream: it estimates parcels' states from pictures without parcels' numbers.

The tracker has two streams of the package, as `StateEstimator` has two environments: SEEN at the
time of the latest picture, and NOW at the time of the decision. In both streams, modules turn to
the axes that were sent, and parcels move and push each other by the physics.

A picture does not say which parcel is which. The tracker assigns the picture's poses to the
predicted parcels, and corrects the parcels' states. Each parcel has a covariance as in
`surface_gym.sensors.kalman`. A `ParcelEntry` announces a parcel. The parcel departs by the task's
rules, or if no picture shows it for long.

The observation is a table with a row for each parcel. A row is empty in at least one observation
before another parcel uses it.
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from surface_gym import checks, state as st
from surface_gym.actions import ActionKind
from surface_gym.compiler.jit import compile_for, compiled
from surface_gym.config import EnvConfig
from surface_gym.core.kernel import EnvParams
from surface_gym.flow import claims, kernel, state as fs
from surface_gym.flow.batch import stream_functions
from surface_gym.flow.entry import count_due, occupy, put
from surface_gym.flow.stream import Stream
from surface_gym.machine.messages import MAX_LATE, Angles, Detections, ParcelEntry
from surface_gym.physics.types import RADIUS, Array, Booleans, Integers
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import kalman
from surface_gym.sensors.camera import EVERY
from surface_gym.state import Timing

from .estimator import (
    NOW,
    SEEN,
    Estimator,
    Resolver,
    machine_axis_speed,
    within_right_angles,
    zone_angles,
)
from .worlds import SteeredBatch, steered_config, unchanged_turn

SIZE = kalman.SIZE
COVARIANCE = slice(kalman.COVARIANCE, kalman.COVARIANCE + SIZE * SIZE)
LONGEST_STEP = 0.01  # [s] of the physics: longer than the package's, to save time
GATE = 30.0  # [-] maximum squared distance of a pose from a prediction, in standard deviations
# Doubt that a picture without a parcel adds to its pose and velocity, since a push may be wrong.
UNSEEN = np.array([0.004, 0.004, 0.02, 0.05, 0.05, 0.3])  # [m, m, rad, m/s, m/s, rad/s]
RESCUED = np.array([0.01, 0.01, 0.05, 0.5, 0.5, 2.0])  # of a parcel that was found again
FOUND_WITHIN = 0.3  # [m] from a lost parcel's prediction
STEADY = 0.1  # [m] maximum motion of an unexplained pose between two pictures
TOGETHER = 0.06  # [m] of a pose from the middle of two parcels that it shows as one
LOST_AFTER = 3  # pictures without a parcel after which it may be elsewhere
GONE_AFTER = 50  # pictures without a parcel after which it is no longer on the line
MOST_ARRIVALS = 512  # parcels that are remembered
MOST_ENTERING = 64  # parcels that wait for a row
UNKNOWN_TURN = 1e3  # [rad] standard deviation of a disc's angle


@dataclass
class _Birth:
    """A parcel that is about to enter."""

    at: float  # [s]
    column: int  # its arrival
    slot: int  # its row; NOBODY: none is free


class StreamTracker(Estimator):
    """Estimator of a stream's state, at the latest picture (SEEN) and at the decision (NOW).

    Args:
        config: configuration of the policy's environment, with a Camera or exact sensors.

    Raises:
        ValueError: a machine with this configuration cannot be tracked; see `steered_config`.
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__()
        even = Actuators(axis_speed=machine_axis_speed(config))
        self.config = steered_config(config, actuators=even, randomisation=Randomisation())
        self._axis_speed = even.axis_speed
        _, rows, _, columns = self.config.site.zone
        self.shape = (int(rows), int(columns))
        task = self.config.stream_task
        self._rows, self._slots = task.rows, task.max_parcels
        sensor: Any = self.config.sensors
        spread = (sensor.position_noise, sensor.position_noise, sensor.angle_noise)
        self._noise = np.diag(np.maximum(spread, 1e-4)) ** 2
        self.entered: float | None = None  # [s] time of the first message
        self._begin(0.0)
        self._compile()
        self.clear()

    def _compile(self) -> None:
        """Compile all functions in advance."""
        batch = self._batch
        self._step = compile_for(batch.make_kernel(), *batch.arguments)
        self._enter = compile_for(
            make_enter(stream_functions(self.config)), *batch.arguments[:-3], SEEN, 0, 0
        )

    def _begin(self, at: float) -> None:
        """Begin without parcels at the time `at` [s]."""
        self._batch = batch = SteeredBatch(self.config, 2, compiles=False)
        batch.straighten()
        offered = within_right_angles(batch.params.acting.orientations)
        self._params = batch.params._replace(
            acting=batch.params.acting._replace(orientations=offered)
        )
        self._stream_params = batch.stream_params._replace(duration=math.inf, patience=math.inf)
        self._surfaces, self._parcels = batch.surfaces, batch.parcels
        self._streams = batch.streams
        self._columns: dict[int, int] = {}  # arrival of each parcel by its number
        self._forgotten = 0  # number of arrivals that are no longer remembered
        self._births: list[_Birth] = []
        self._period = np.full(self._slots, math.pi)  # [rad] turn that leaves a base unchanged
        self._missed = np.zeros(self._slots, dtype=np.int64)  # pictures without each parcel
        self._is_clear = np.ones(self._slots, dtype=np.bool_)  # rows observed empty since their use
        self._hidden = np.zeros(self._slots, dtype=np.bool_)  # rows observed empty, but still used
        self._strays = np.zeros((0, 3))  # unexplained poses of the latest picture
        # Poses of the latest picture that were assigned, by the arrival; discs have no angle.
        self._seen: dict[int, Array] = {}
        self._commands.clear()
        self._at = self._begun = at
        self.entered = at

    def clear(self) -> None:
        """Forget all parcels."""
        self.entered = None

    def depart(self, number: int) -> bool:
        """Forget a departed parcel that still waits here. Return False, as parcels may remain."""
        column, streams = self._columns.get(number), self._streams
        entering = [birth.column for birth in self._births]
        if column is None or column in entering or not math.isnan(streams.entered[SEEN, column]):
            return False
        streams.entered[SEEN, column] = streams.clock[SEEN]
        streams.tally[SEEN, fs.ENTERED] += 1
        self._let_go(column)
        return False

    def enter(self, entered: ParcelEntry) -> None:
        """Add a parcel that is waiting at the gate, or a parcel that is entering.

        Raises:
            ValueError: another parcel has the same number, the parcel does not suit the stream, or
                there are too many parcels.
        """
        if self.entered is None:
            self._begin(entered.at)
        if len(self._births) >= MOST_ENTERING:
            raise ValueError(f"entered must be at most {MOST_ENTERING} without a row, got more")
        pose = checks.pose("pose", entered.pose, (3,))
        velocity = checks.velocity("velocity", entered.velocity, (3,))
        column = self._columns.get(entered.number)
        if column is None:
            column = self._add(entered)
        elif entered.waits or not math.isnan(self._streams.entered[SEEN, column]):
            raise ValueError(f"number must be a new one of each parcel, got {entered.number} twice")
        self._streams.start[:, column] = (*pose, *velocity, 0.0, 0.0)
        if not entered.waits:
            self._births.append(_Birth(entered.at, column, fs.NOBODY))
            self._births.sort(key=lambda birth: birth.at)

    def _add(self, entered: ParcelEntry) -> int:
        """Add a parcel to the arrays of arrivals; return the parcel's column in these arrays."""
        exits, inlets = len(self.config.exits), len(self.config.inlets)
        goal = checks.array("goal", entered.goal, (3,))
        most = np.array([exits - 1, inlets - 1, checks.EPISODE])
        if (goal < 0.0).any() or (goal > most).any() or (goal % 1.0).any():
            raise ValueError(
                f"goal must be indices of one of {exits} exits and {inlets} inlets, and a place in "
                f"the order, got {entered.goal}"
            )
        parcel = replace(entered.parcel, com_offset=(0.0, 0.0))  # the load's position is unknown
        self.config.stream_task.check_stream(Stream(parcels=(parcel,)), self.config)
        if self._streams.arrivals[SEEN] >= MOST_ARRIVALS:
            self._forget()
        batch, column = self._batch, int(self._streams.arrivals[SEEN])
        order = int(goal[2]) - self._forgotten if self.config.stream_task.in_order else column
        if not 0 <= order < column + MOST_ARRIVALS:
            raise ValueError(f"goal must have a place in the order to come, got {entered.goal}")
        room = max(column, order) + 1
        batch.streams = self._streams = streams = fs.with_room(self._streams, room)
        streams.body[:, column] = batch.take(parcel)
        streams.exit[:, column], streams.inlet[:, column] = int(goal[0]), int(goal[1])
        streams.order[:, column] = order
        # Without a gate, the stream would let in whatever is due.
        gated = self.config.stream_task.gate
        streams.time[:, column] = entered.at - self._begun if gated else np.inf
        for name, value in (("entered", np.nan), ("departed", np.nan), ("past", False)):
            getattr(streams, name)[:, column] = value
        streams.arrivals[:] = column + 1
        self._columns[entered.number] = column
        return column

    def _forget(self) -> None:
        """Forget departed parcels from the oldest on. Raise ValueError if the oldest is present."""
        streams = self._streams
        departed = np.append(~np.isnan(streams.departed[SEEN]), False)
        count = int(min(departed.argmin(), streams.next_place[SEEN]))
        if count == 0:
            raise ValueError(f"entered must be at most {MOST_ARRIVALS} parcels at once, got more")
        self._batch.give_back(streams.body[SEEN, :count].tolist())
        for name in fs.ARRIVALS:
            values = getattr(streams, name)
            values[:, :-count] = values[:, count:].copy()
        for name in ("order", "number", "arrivals", "coming", "due", "next_place"):
            values = getattr(streams, name)
            np.maximum(values - count, fs.NOBODY if name == "number" else 0, out=values)
        streams.tally[:, fs.ENTERED] -= count
        kept = {number: each - count for number, each in self._columns.items()}
        self._columns = {number: each for number, each in kept.items() if each >= 0}
        for birth in self._births:
            birth.column -= count
        self._forgotten += count

    def correct(self, picture: Detections) -> bool:
        """Correct the estimates by a picture. Return whether the picture was used.

        A picture is used only if it is newer than the latest used picture.
        """
        poses = checks.pose("poses", np.reshape(picture.poses, (-1, 3)), (None, 3))
        if self.entered is None:
            self._begin(picture.taken_at)
        self._settle_births()
        if not self._see(picture.taken_at, looks=True):
            return False
        self._births = [each for each in self._births if each.at >= self._at or each.slot < 0]
        self._assign(poses)
        return True

    def _settle_births(self) -> None:
        """Give each entering parcel a free row.

        If an entry is earlier than the latest picture (SEEN), move the entry to the picture's time.
        """
        for birth in self._births:
            if birth.at < self._at:
                start = self._streams.start[:, birth.column]
                start[:, :3] += (self._at - birth.at) * start[:, 3:6]
                birth.at = self._at
            free = np.flatnonzero(self._is_clear & ~self._streams.present[SEEN, : self._slots])
            if birth.slot < 0 and len(free):
                birth.slot = int(free[0])
                parcel = self._batch.parcel_of(int(self._streams.body[SEEN, birth.column]))
                self._is_clear[birth.slot], self._missed[birth.slot] = False, 0
                self._hidden[birth.slot] = False
                self._period[birth.slot] = unchanged_turn(parcel)

    def _assign(self, poses: Array) -> None:
        """Assign poses (poses, 3) to the parcels of SEEN, and correct the parcels' states."""
        streams, parcels = self._streams, self._parcels
        states = parcels.state[: self._slots]
        is_broken = ~np.isfinite(states[:, :SIZE]).all(axis=1)
        self._drop(np.flatnonzero(streams.present[SEEN, : self._slots] & is_broken))
        rows = np.flatnonzero(streams.present[SEEN, : self._slots])
        is_merged, merged = self._find_merged(rows, poses)
        poses = poses[~is_merged]
        spread = parcels.sensor_state[rows, COVARIANCE].reshape(-1, SIZE, SIZE)
        gap = poses - states[rows, np.newaxis, :3]
        period, is_disc = self._period[rows, np.newaxis], self._period[rows] == 0.0
        period[is_disc] = math.tau
        gap[..., 2] -= period * np.round(gap[..., 2] / period)
        gap[is_disc, :, 2] = 0.0
        doubt = spread[:, :3, :3] + self._noise
        doubt[is_disc, 2, 2] += UNKNOWN_TURN**2
        inverse = np.linalg.inv(doubt)
        away = np.einsum("nmi,nij,nmj->nm", gap, inverse, gap)
        size = np.linalg.slogdet(doubt)[1]
        cost = np.minimum(away + (size - size.min(initial=0.0))[:, np.newaxis] - GATE, 0.0)
        one, other = linear_sum_assignment(cost)
        good = cost[one, other] < 0.0
        one, other = one[good], other[good]
        measured = states[rows[one], :3] + gap[one, other]
        arrivals = streams.number[SEEN, rows[one]].tolist()
        kept = zip(arrivals, measured, is_disc[one], strict=True)
        self._seen = {arrival: pose for arrival, pose, disc in kept if not disc}
        if len(one):
            gain = spread[one, :, :3] @ inverse[one]
            states[rows[one], :SIZE] += np.einsum("nij,nj->ni", gain, gap[one, other])
            smaller = spread[one] - gain @ spread[one, :3, :]
            smaller = 0.5 * (smaller + smaller.transpose(0, 2, 1))
            parcels.sensor_state[rows[one], COVARIANCE] = smaller.reshape(-1, SIZE * SIZE)
        unseen, strays = np.delete(rows, one), np.delete(poses, other, axis=0)
        unseen = unseen[~np.isin(unseen, merged)]
        self._missed[rows[one]] = 0
        self._missed[unseen] += 1
        self._widen(unseen, UNSEEN**2)
        self._find_again(unseen, strays)

    def _widen(self, rows: Integers, variance: Array) -> None:
        """Add variances (6,) to the covariances of some rows."""
        diagonal = kalman.COVARIANCE + (SIZE + 1) * np.arange(SIZE)
        self._parcels.sensor_state[rows[:, np.newaxis], diagonal] += variance

    def _find_again(self, unseen: Integers, strays: Array) -> None:
        """Move each lost parcel to a pose in `strays` that is near the parcel.

        A stray is a pose that fits no parcel. A parcel is lost if `LOST_AFTER` pictures did not
        show the parcel. The new pose must also be near a stray of the previous picture. Drop
        parcels that were unseen for `GONE_AFTER` pictures.

        Args:
            unseen: rows of the parcels that the latest picture does not show.
            strays: (poses, 3) [m, m, rad] strays of the latest picture.
        """
        states = self._parcels.state
        before, self._strays = self._strays, strays
        apart = np.linalg.norm(strays[:, np.newaxis, :2] - before[:, :2], axis=2)
        strays = strays[apart.min(axis=1, initial=math.inf) < STEADY]
        lost = unseen[self._missed[unseen] >= LOST_AFTER]
        away = np.linalg.norm(strays[:, :2] - states[lost, np.newaxis, :2], axis=2)
        one, other = linear_sum_assignment(np.minimum(away - FOUND_WITHIN, 0.0))
        for row, pose, far in zip(lost[one], strays[other], away[one, other], strict=True):
            if far < FOUND_WITHIN:
                period = self._period[row] or math.tau
                turn = pose[2] - states[row, 2]
                states[row, :2] = pose[:2]
                states[row, 2] += turn - period * round(turn / period)
                self._parcels.sensor_state[row, COVARIANCE] = np.diag(RESCUED**2).ravel()
                self._missed[row] = 0
        self._drop(lost[self._missed[lost] >= GONE_AFTER])

    def _drop(self, rows: Integers) -> None:
        """Forget the parcels in some rows."""
        number = self._streams.number[SEEN]
        for row in rows:
            self._let_go(int(number[row]))
            self._streams.present[SEEN, row], number[row] = False, fs.NOBODY

    def _let_go(self, column: int) -> None:
        """Note an unseen departure. `column` is the departed parcel's column in `_streams`."""
        streams = self._streams
        streams.departed[SEEN, column] = streams.clock[SEEN]
        streams.past[SEEN, streams.order[SEEN, column]] = True
        place = streams.next_place
        while place[SEEN] < streams.arrivals[SEEN] and streams.past[SEEN, place[SEEN]]:
            place[SEEN] += 1

    def _find_merged(self, rows: Integers, poses: Array) -> tuple[Booleans, Integers]:
        """Find poses that show two touching parcels as one parcel.

        Returns:
            A mask (poses,) of these poses, and the rows of the parcels that these poses show.
        """
        centre = self._parcels.state[rows, :2]
        radius = self._batch.bodies.body[self._parcels.body[rows], RADIUS]
        one, other = np.triu_indices(len(rows), 1)
        apart = np.linalg.norm(centre[one] - centre[other], axis=1)
        near = apart < radius[one] + radius[other]
        one, other = one[near], other[near]
        middle = 0.5 * (centre[one] + centre[other])
        away = np.linalg.norm(poses[:, np.newaxis, :2] - middle, axis=2) < TOGETHER
        alone = np.linalg.norm(poses[:, np.newaxis, :2] - centre, axis=2) > TOGETHER
        away &= alone.all(axis=1)[:, np.newaxis]
        seen = away.any(axis=0)
        return away.any(axis=1), rows[np.concatenate([one[seen], other[seen]])]

    def observe(self, now: float) -> NDArray[np.float32]:
        """Return a copy of the task's table (rows, features) at `now` [s]."""
        self._settle_births()
        slots, streams = slice(0, self._slots), self._streams
        self._copy_to_now()
        seen = streams.present[SEEN, slots]
        streams.present[NOW, slots] &= ~self._hidden
        self._advance(NOW, self._at, min(now, self._at + MAX_LATE), looks=False)
        self._run(NOW, 0.001, 0)
        shown = streams.present[NOW, slots]
        # A parcel that has departed by the prediction stays hidden in later observations.
        self._hidden = seen & ~shown
        awaited = [each.slot for each in self._births if each.slot >= 0]
        cleared = ~seen & ~shown
        cleared[awaited] = False
        self._is_clear |= cleared
        table = self._parcels.observation.reshape(2, self._rows, -1)[NOW]
        return np.array(table)

    def _copy_to_now(self) -> None:
        for name, values in self._parcels._asdict().items():
            if name not in ("noise", "sensor_state") and values.size:
                values[self._rows :] = values[: self._rows]
        for values in self._streams:
            if len(values) == 2:
                values[NOW] = values[SEEN]
        for values in (self._surfaces.angle, self._surfaces.target, self._surfaces.direction):
            values[NOW] = values[SEEN]

    @property
    def _number_of(self) -> dict[int, int]:
        """Each parcel's number in messages, by the parcel's column in the arrays of arrivals."""
        return {column: number for number, column in self._columns.items()}

    @property
    def numbers(self) -> Integers:
        """Parcel numbers (slots,) of the last observation's rows. Empty rows have NOBODY."""
        number_of = self._number_of
        shown = self._streams.present[NOW, : self._slots]
        columns = np.where(shown, self._streams.number[NOW, : self._slots], fs.NOBODY)
        return np.array([number_of.get(each, fs.NOBODY) for each in columns.tolist()])

    @property
    def tracked(self) -> dict[int, Array]:
        """Poses (3,) [m, m, rad] in the latest picture, by the parcel's number.

        Discs are omitted, because they show no angle. If a base looks the same after a turn, e.g.
        a square after 90 deg, the angle nearest to the prediction is chosen.
        """
        number_of = self._number_of
        return {number_of[each]: pose for each, pose in self._seen.items() if each in number_of}

    @property
    def estimates(self) -> Array:
        """Poses and velocities (slots, 6) [m, m, rad, m/s, m/s, rad/s] at the time NOW."""
        return self._parcels.sensed[self._rows :][: self._slots].copy()

    def _make_obey(self, kind: ActionKind) -> Any:
        del kind  # of the configuration
        return make_obey(stream_functions(self.config))

    def _arguments(self, command: NDArray[Any]) -> tuple[Any, ...]:
        surfaces = self._surfaces._replace(command=command)
        return self._params, self._stream_params, surfaces, *self._arrays[3:]

    def resolve(self, resolver: Resolver | None, command: NDArray[Any]) -> Angles:
        """Return the zone's angles. Without a resolver, obeying modules turn to `command[0]`."""
        if resolver is not None:
            return super().resolve(resolver, command)
        self._batch.steer(NOW, float(command[0]))
        return self._zone_angles(self._surfaces.target[NOW])

    def _zone_angles(self, whole: NDArray[np.float64]) -> Angles:
        return zone_angles(whole, self._batch.bodies.zone[0], self.shape)

    def _move_on(self, i: int, begun: float, until: float, looks: bool) -> None:
        """Simulate stream `i` from `begun` to `until` [s]. Parcels enter at their entry times."""
        del looks
        for birth in self._births:
            if birth.slot >= 0 and begun <= birth.at < until:
                self._move_by(i, begun, birth.at)
                begun = birth.at
                self._enter(*self._arrays, i, birth.slot, birth.column)
        self._move_by(i, begun, until)

    def _move_by(self, i: int, begun: float, until: float) -> None:
        """Simulate stream i in equal steps, from the time `begun` [s] to the time `until` [s]."""
        steps = math.ceil((until - begun) / LONGEST_STEP - 1e-6)
        if steps > 0:
            self._streams.clock[i] = begun - self._begun
            self._run(i, (until - begun) / steps, steps)

    @property
    def _arrays(self) -> tuple[Any, ...]:
        return self._params, self._stream_params, *self._batch.arguments[2:-3]

    def _run(self, i: int, length: float, steps: int) -> None:
        """Run physics steps of a length [s] in stream i. In SEEN, also predict covariances."""
        acting = self._params.acting._replace(turn=self._axis_speed * length)
        sensor = self._params.sensor.copy()
        sensor[EVERY] = 1.0 if i == SEEN else 0.0
        params = self._params._replace(timing=Timing(length, steps), acting=acting, sensor=sensor)
        scratches = self._batch.arguments[-3:-1]
        self._step(params, *self._arrays[1:], *scratches, np.array([i]))


@lru_cache(maxsize=16)
def make_enter(functions: kernel.StreamFunctions) -> Any:
    """Make `enter`, which puts an arriving parcel in a row of a stream."""
    task_begin, sensor_begin = functions.begin, functions.begin_sensor

    def enter(
        params: EnvParams,
        stream_params: fs.StreamParams,
        surfaces: st.SurfaceState,
        parcels: st.ParcelState,
        bodies: st.BodyTable,
        streams: fs.StreamState,
        i: int,
        slot: int,
        arrival: int,
    ) -> None:
        view = kernel.view_surface(params, stream_params, surfaces, parcels, bodies, streams, i)
        streams.time[i, arrival] = min(streams.time[i, arrival], streams.clock[i])
        count_due(streams, i)
        put(view, slot, arrival)
        occupy(view, slot, arrival)
        state = fs.view_parcel(view, slot)
        st.read_truth(state)
        state.memory[fs.TOUCHED] = 0.0
        task_begin(state)
        sensor_begin(params.sensor, state)

    return compiled(enter, f"tracker-enter-{functions.label}")


@lru_cache(maxsize=16)
def make_obey(functions: kernel.StreamFunctions) -> Any:
    """Make `obey`, which sets the targets of a stream's axes from the stream's command."""
    f = functions
    obey_command = claims.obeying(f.base_distance, f.part_of, f.commanded, f.actuation.obey)

    def obey(
        params: EnvParams,
        stream_params: fs.StreamParams,
        surfaces: st.SurfaceState,
        parcels: st.ParcelState,
        bodies: st.BodyTable,
        streams: fs.StreamState,
        i: int,
    ) -> None:
        obey_command(
            kernel.view_surface(params, stream_params, surfaces, parcels, bodies, streams, i)
        )

    return compiled(obey, f"tracker-obey-{functions.label}")
