"""Recorders of an environment's episodes and of trajectories. They also record forces."""

import math
from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import gymnasium as gym
import numpy as np

from surface_gym import state as st
from surface_gym.core.batch import BaseBatch
from surface_gym.flow.state import NOBODY
from surface_gym.physics import collision, rollout, types as ph, world_forces
from surface_gym.physics.types import Array, Integers
from surface_gym.recording import Mark, RecordedParcel, Recording, index_axes, index_drives
from surface_gym.surface import Surface

if TYPE_CHECKING:
    from surface_gym.rendering import Scene, SceneParcel
    from surface_gym.trajectory import Trajectory

BESIDE = 0.5  # [m] margin beside the rotors; also the drawn length of a stream's exits
AHEAD = 3.0  # [pitch] margin before and after the surface of a stream
PERIOD = 0.01  # [s] between the frames of a trajectory


class RecordReplay(gym.Wrapper):
    """Record the episodes of an environment, and write a replay page for each episode.

    Use it like Gymnasium's `RecordVideo`. Pages are smaller than videos, and contain all numbers.

    Args:
        env: a `SmartSurfaceEnv`, wrapped or not.
        folder: folder for the pages; None writes no pages. `recording` holds the latest episode.
        episode_trigger: function of an episode's number, 0, 1, ...; True records the episode.
            The default records all episodes.
        name_prefix: prefix of the pages' file names.

    >>> import gymnasium as gym, surface_gym
    >>> env = surface_gym.RecordReplay(gym.make("SmartSurface/Sort-v0", actions="halves"))
    >>> _ = env.reset(seed=0, options={"speed": 1.5, "parcel": "S", "side": 1})
    >>> over = False
    >>> while not over:
    ...     _, _, terminated, truncated, _ = env.step(10)
    ...     over = terminated or truncated
    >>> env.recording.outcome, len(env.recording)
    ('success', 14)
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        folder: str | PathLike[str] | None = None,
        episode_trigger: Callable[[int], bool] | None = None,
        name_prefix: str = "replay",
    ) -> None:
        super().__init__(env)
        batch = getattr(env.unwrapped, "batch", None)
        if not isinstance(batch, BaseBatch):
            raise ValueError(f"env must be an environment of a surface, got {env!r}")
        self._batch = batch
        self._folder = None if folder is None else Path(folder)
        self._trigger = episode_trigger
        self._name = name_prefix
        self._episode = -1
        self._recorder: _Recorder | None = None

    @property
    def recording(self) -> Recording:
        """The latest recorded episode, up to its current step."""
        if self._recorder is None:
            raise ValueError("recording must be asked for after reset, of an episode recorded")
        return self._recorder.recording()

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environment, and start a new recording."""
        self._finish()
        observation, info = self.env.reset(seed=seed, options=options)
        self._episode += 1
        self._records = self._trigger is None or bool(self._trigger(self._episode))
        if self._records:
            self._recorder = _Recorder(self._batch)
            self._recorder.record(0.0, info, begins=True)
        return observation, info

    def step(self, action: Any) -> tuple[Any, Any, bool, bool, dict[str, Any]]:
        """Step the environment, and record a frame."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if self._recorder is not None and self._records:
            self._recorder.record(float(reward), info, begins=False)
            if terminated or truncated:
                self._finish()
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        """Write the page of an unfinished episode, and close the environment."""
        self._finish()
        super().close()

    _records = False  # whether the current episode is recorded

    def _finish(self) -> None:
        if self._records and self._folder is not None:
            from surface_gym.player import replay

            replay(self.recording).save(self._folder / f"{self._name}-episode-{self._episode}.html")
        self._records = False


class FrameForces(NamedTuple):
    """Forces on the parcels in one frame of a recording."""

    bearer: Integers  # (contacts,) row of each contact's parcel
    # (contacts, 4) row times columns plus column of the element, then [N] normal force, and
    # friction on the parcel in x and y
    contacts: Array
    pair: Integers  # (pushes, 2) rows of parcels that push each other
    pushes: Array  # (pushes, 4) [m] point of action in x and y, and [N] force on the second

    def renumbered(self, places: Integers) -> "FrameForces":
        """Move the forces in row k to row `places[k]`. If `places[k]` < 0, drop these forces."""
        bearer, pair = places[self.bearer], places[self.pair]
        borne, pushing = bearer >= 0, (pair >= 0).all(axis=1)
        return FrameForces(bearer[borne], self.contacts[borne], pair[pushing], self.pushes[pushing])


def join_frames(frames: Sequence[FrameForces]) -> dict[str, Any]:
    """Concatenate the forces of all frames. Return the result as fields of `Recording`, by name."""
    return {
        "first_contact": np.cumsum([0, *(len(each.contacts) for each in frames)]),
        "contacts": np.concatenate([each.contacts for each in frames]),
        "bearer": np.concatenate([each.bearer for each in frames]),
        "first_push": np.cumsum([0, *(len(each.pushes) for each in frames)]),
        "pushes": np.concatenate([np.column_stack([each.pair, each.pushes]) for each in frames]),
    }


class ParcelForces:
    """Forces on the only parcel of a batch with one environment."""

    def __init__(self, batch: BaseBatch) -> None:
        self._batch: Any = batch
        self._scratch = ph.make_scratch()

    def compute(self) -> FrameForces:
        """Compute the forces of the next step."""
        batch, params = self._batch, self._batch.params
        row = int(batch.parcels.body[0])
        grid = st.read_grid.py_func(
            batch.surfaces, batch.bodies, 0, row, params.elements, params.friction
        )
        body = st.read_body.py_func(batch.bodies, row)
        states = np.stack([batch.parcels.state[0]] * 2)
        lengths = np.array([0.0, params.timing.dt])
        steps = rollout.RecordedSteps(states, lengths, 0.5 * lengths, np.zeros(3, dtype=np.int64))
        count = np.zeros(2, dtype=np.int64)
        rollout.count_contacts(grid, body, steps, self._scratch, count)
        total = int(count[1])
        contacts = np.zeros((total, 4))
        if total:
            steps.first[2] = total
            observed = rollout.ContactForces(
                states.copy(), np.zeros((total, 2), dtype=np.int64), np.zeros(total),
                np.zeros((total, 2)),
            )  # fmt: skip
            rollout.support_loads(grid, body, steps, self._scratch, observed)
            rollout.repeat_implicit(grid, body, steps, self._scratch, observed)
            mass = batch.parcel(0).mass
            contacts[:, 0] = observed.element @ (grid.axis.shape[1], 1)
            contacts[:, 1] = mass * observed.normal
            contacts[:, 2:] = mass * observed.force
        return FrameForces(
            np.zeros(total, dtype=np.int64), contacts, np.zeros((0, 2), dtype=np.int64),
            np.zeros((0, 4)),
        )  # fmt: skip


class StreamForces:
    """Forces on the parcels of a stream, from elements and from other parcels.

    The forces name a parcel by its row in the state arrays. A parcel keeps its row while the parcel
    is on the line.
    """

    def __init__(self, batch: BaseBatch) -> None:
        self._batch: Any = batch
        self._scratch = collision.make_world_scratch(self._batch.rows)
        self._forces = world_forces.make_world_forces(self._batch.rows)

    def compute(self) -> FrameForces:
        """Compute the forces of the next step."""
        batch, params, forces = self._batch, self._batch.params, self._forces
        bodies, parcels = batch.bodies, batch.parcels
        grid = st.read_grid.py_func(batch.surfaces, bodies, 0, 0, params.elements, params.friction)
        world = collision.World(
            parcels.state.copy(), batch.streams.present[0].copy(), parcels.body,
            ph.Bodies(bodies.body, bodies.edges, bodies.corners),
        )  # fmt: skip
        self._scratch.marks[:, ph.SPANS] = -1  # the axes have turned
        touching, dt = batch.stream_params.touching, params.timing.dt
        pushes = world_forces.observe_world(grid, world, touching, self._scratch, dt, forces)
        total = int(forces.first[-1])
        element = forces.element[:total] @ (grid.axis.shape[1], 1)
        return FrameForces(
            np.repeat(np.arange(batch.rows), np.diff(forces.first)),
            np.column_stack([element, forces.below[:total]]),
            forces.pair[:pushes].copy(),
            forces.push[:pushes].copy(),
        )


class _Rows:
    """Poses and velocities of one parcel while it is present."""

    def __init__(self, drawn: "SceneParcel", first: int) -> None:
        self.drawn = drawn
        self.first = first
        self.truth: list[Array] = []  # (6,) pose and velocity

    def recorded(self) -> RecordedParcel:
        truth, drawn = np.array(self.truth), self.drawn
        return RecordedParcel(
            drawn.outline, self.first, truth[:, :3], truth[:, 3:], drawn.label, drawn.colour_index
        )


class _Recorder:
    """Recorder of a batch with one environment. The recorder adds a frame per control period."""

    def __init__(self, batch: BaseBatch) -> None:
        from surface_gym.scenes import Renderer

        self._batch: Any = batch
        self._is_stream = hasattr(batch, "streams")
        self._renderer = Renderer(batch)
        self._parcels: dict[int, _Rows] = {}  # by arrival number
        self._time: list[float] = []
        self._axes: list[Array] = []
        self._velocities: list[Array] = []  # of driven modules
        kind = StreamForces if self._is_stream else ParcelForces
        self._force_source = kind(batch)
        self._forces: list[FrameForces] = []  # rows are indices of recorded parcels
        self._delivered: list[tuple[int, ...]] = []
        self._metrics: list[dict[str, float]] = []

    def record(self, reward: float, info: dict[str, Any], begins: bool) -> None:
        """Record the current state as a frame. `begins` is true at the start of an episode."""
        self._renderer.record(0, begins)
        self._outcome = str(info.get("outcome", ""))
        self._time.append(float(info["time"]))
        self._axes.append(self._batch.axes(0))
        if (velocity := self._batch.surface_velocity(0)) is not None:
            self._velocities.append(velocity)
        self._metrics.append({"reward": reward, **_numbers(info)})
        if self._is_stream:
            self._record_stream()
        else:
            self._record_parcel()

    def _record_parcel(self) -> None:
        if not self._parcels:
            self._scene = self._renderer.scene()
            self._parcels[0] = _Rows(self._scene.parcels[0], 0)
        self._parcels[0].truth.append(self._batch.parcels.truth[0].copy())
        self._forces.append(self._force_source.compute())

    def _record_stream(self) -> None:
        batch, streams, frame = self._batch, self._batch.streams, len(self._time) - 1
        numbers = streams.number[0, : batch.task.max_parcels]
        there = np.flatnonzero(numbers != NOBODY)
        if frame == 0 or any(int(number) not in self._parcels for number in numbers[there]):
            self._scene = self._renderer.scene()
            present = np.flatnonzero(streams.present[0])
            shown = self._scene.parcels[len(self._scene.parcels) - len(present) :]
            for slot, drawn in zip(present.tolist(), shown, strict=True):
                number = int(streams.number[0, slot])
                self._parcels.setdefault(number, _Rows(drawn, frame))
        for slot in there.tolist():
            # None: it came and departed between frames
            rows = self._parcels.get(int(numbers[slot]))
            if rows is not None:
                rows.truth.append(batch.parcels.truth[slot].copy())
        index = {number: k for k, number in enumerate(self._parcels)}
        places = np.array([index.get(int(number), NOBODY) for number in streams.number[0]])
        self._forces.append(self._force_source.compute().renumbered(places))
        taken = streams.taken[0, : streams.arrivals[0]]
        correct = streams.correct[0, : streams.arrivals[0]]
        exits = len(batch.config.exits)
        self._delivered.append(tuple(np.bincount(taken[correct], minlength=exits).tolist()))

    def recording(self) -> Recording:
        """Return the recorded frames as a `Recording`."""
        scene, axes = self._scene, np.array(self._axes)
        angles, axis = index_axes(axes)
        driven: dict[str, Any] = {}
        if self._velocities:
            driven["velocities"], driven["drive"] = index_drives(np.array(self._velocities))
        names = dict.fromkeys(name for each in self._metrics for name in each)
        return Recording(
            title=scene.title,
            control_period=self._batch.config.control_period,
            time=np.array(self._time),
            rotor=scene.rotor,
            angles=angles,
            axis=axis,
            pitch=scene.pitches,
            origin=scene.origin,
            obeys=None if scene.zone is None else scene.obeys,
            view=_view(scene, self._is_stream),
            marks=make_marks(scene),
            parcels=tuple(rows.recorded() for rows in self._parcels.values()),
            heading=getattr(scene.goal, "angle", None),
            **join_frames(self._forces),
            delivered=np.array(self._delivered, dtype=np.float64).reshape(
                len(self._delivered), -1 if self._delivered else 0
            ),
            metrics={
                name: np.array([each.get(name, math.nan) for each in self._metrics])
                for name in names
            },
            outcome=self._outcome,
            **driven,
        )


def record_trajectory(trajectory: "Trajectory") -> Recording:
    """Record a trajectory with its forces, about one frame per `PERIOD`."""
    run = trajectory.run
    if run is None:
        raise ValueError(
            "trajectory must have a run, as from surface_gym.simulate; got one whose run is None"
        )
    time, surface, contacts = trajectory.time, run.surface, trajectory.contacts
    rows = np.unique(np.searchsorted(time, np.arange(0.0, time[-1], PERIOD)))
    rows = np.union1d(rows[rows < len(time)], [len(time) - 1])
    angles, axis = index_axes(surface.axis)
    driven: dict[str, Any] = {}
    if surface.surface_velocity is not None:
        driven["velocities"], drive = index_drives(surface.surface_velocity)
        driven["drive"] = np.broadcast_to(drive, (len(rows), *drive.shape))
    first, last = (np.searchsorted(contacts.step, rows, side=side) for side in ("left", "right"))
    chosen = np.concatenate([np.arange(a, b) for a, b in zip(first, last, strict=True)])
    each = contacts.element @ (surface.columns, 1)
    whole = np.column_stack([each, contacts.normal, contacts.force])
    parcel = RecordedParcel(
        run.parcel.base.outline, 0, trajectory.pose[rows], trajectory.velocity[rows]
    )
    return Recording(
        title="Trajectory",
        control_period=PERIOD,
        time=time[rows],
        rotor=surface.rotor,
        angles=angles,
        axis=np.broadcast_to(axis, (len(rows), *axis.shape)),
        pitch=(surface.pitch_x, surface.pitch_y),
        origin=surface.origin,
        view=_view_of(surface, parcel.pose[:, 1]),
        parcels=(parcel,),
        first_contact=np.append(0, np.cumsum(last - first)),
        contacts=whole[chosen],
        metrics={"tipping": trajectory.tipping[rows].astype(np.float64)},
        outcome=trajectory.end,
        **driven,
    )


def _view_of(surface: Surface, way: Array) -> tuple[float, float, float, float]:
    """Return the view of a replay: the smallest x and y, and the largest x and y [m].

    In x, the view spans the surface. In y, the view spans the rotors and the path, plus a margin.
    `way` (T,) [m] is the path's y.
    """
    (x, y), (across, up) = surface.origin, (surface.pitch_x, surface.pitch_y)
    rows = np.append(np.flatnonzero(surface.rotor.any(axis=1)), np.rint((way - y) / up))
    low = max(-0.5, float(rows.min()) - 0.5 - BESIDE / up)
    high = min(surface.rows - 0.5, float(rows.max()) + 0.5 + BESIDE / up)
    return x - 0.5 * across, y + low * up, x + (surface.columns - 0.5) * across, y + high * up


def _numbers(info: dict[str, Any]) -> dict[str, float]:
    """Select an info's numbers without time and outcome. `Recording` has fields for these two."""
    return {
        name: float(value)
        for name, value in info.items()
        if isinstance(value, (bool, int, float, np.number)) and name not in ("time", "outcome")
    }


def _edges(scene: "Scene") -> tuple[float, float, float, float]:
    """Compute the smallest x and y and the largest x and y [m] of a surface."""
    (x, y), (across, up) = scene.origin, scene.pitches
    return (
        x - 0.5 * across, y - 0.5 * up,
        x + (scene.columns - 0.5) * across, y + (scene.rows - 0.5) * up,
    )  # fmt: skip


def _rotor_edges(scene: "Scene") -> tuple[float, float]:
    """Compute the smallest and the largest y [m] of the rotor rows."""
    rows = np.flatnonzero(scene.rotor.any(axis=1))
    low, up = _edges(scene)[1], scene.pitches[1]
    if len(rows) == 0:
        return low, low + scene.rows * up
    return low + float(rows[0]) * up, low + float(rows[-1] + 1) * up


def _view(scene: "Scene", is_stream: bool) -> tuple[float, float, float, float]:
    """Return the view of a replay: the smallest x and y, and the largest x and y [m].

    The view contains the rotors with a margin in y. For a stream, there is also a margin in x.
    """
    left, least, right, most = _edges(scene)
    low, high = _rotor_edges(scene)
    ahead = AHEAD * scene.pitches[0] if is_stream else 0.0
    return left - ahead, max(least, low - BESIDE), right + ahead, min(most, high + BESIDE)


def make_marks(scene: "Scene") -> tuple[Mark, ...]:
    """Return marks for the zone and the goal, and for the exits and inlets of a stream."""
    from surface_gym import rendering

    left, least, right, _ = _edges(scene)
    low, high = _rotor_edges(scene)
    across, up = scene.pitches
    first, last = left, right
    marks = []
    if scene.zone is not None:
        row, rows, column, columns = scene.zone
        first, last = left + column * across, left + (column + columns) * across
        begin = least + row * up
        marks.append(Mark("zone", _area(first, begin, last, begin + rows * up)))
    goal = scene.goal
    if isinstance(goal, (rendering.ExitSide, rendering.ExitSpeed)):
        side = getattr(goal, "side", 0)
        label = f"{goal.speed:.2f} m/s" if isinstance(goal, rendering.ExitSpeed) else "exit"
        if side == 0:
            area = _area(last, low, last + 3.0 * across, high)
        else:
            y = high if side > 0 else low - 3.0 * up
            area = _area(first, y, last, y + 3.0 * up)
        marks.append(Mark("exit", area, label))
    elif isinstance(goal, rendering.StopLine):
        ends = np.array([[goal.x, low - 1.5 * up], [goal.x, high + 1.5 * up]])
        marks.append(Mark("line", ends, f"stop at {goal.x:.2f} m"))
    elif isinstance(goal, rendering.Path):
        marks.append(Mark("path", goal.points))
    if scene.traffic is not None:
        marks += _stream_marks(scene, scene.traffic)
    return tuple(marks)


def _stream_marks(scene: "Scene", traffic: Any) -> list[Mark]:
    left, least, right, most = _view(scene, True)
    low, high = _rotor_edges(scene)

    def beside(mark: Any) -> Array:
        ends = (high, most) if mark.side > 0 else (least, low)
        return _area(mark.first, ends[0], mark.last, ends[1])

    marks = []
    for index, inlet in enumerate(traffic.inlets):
        ahead = inlet.side == 0
        area = _area(left, inlet.first, _edges(scene)[0], inlet.last) if ahead else beside(inlet)
        marks.append(Mark("inlet", area, inlet.name, index))
    for index, mark in enumerate(scene.exits):
        begin, end = mark.span or (low, high)
        area = _area(mark.first, begin, right, end) if mark.side == 0 else beside(mark)
        colour = index if traffic.runs is None else "runs"
        marks.append(Mark("exit", area, mark.name, colour))
    return marks


def _area(left: float, low: float, right: float, high: float) -> Array:
    return np.array([[left, low], [right, low], [right, high], [left, high]])
