"""Scenes and pictures of a batch's environments. Importing this file imports pygame."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym.config import EnvConfig
from surface_gym.core.batch import BaseBatch
from surface_gym.flow.arrivals import HOUR
from surface_gym.flow.exits import EDGE, START
from surface_gym.flow.state import BETWEEN, ENTERED, NOBODY, TOUCHES, WRONG
from surface_gym.physics.step import tilt_of_gravity
from surface_gym.physics.types import RADIUS, VX, Array, Integers
from surface_gym.rendering import (
    ExitMark,
    InletMark,
    Painter,
    Scene,
    SceneParcel,
    Traffic,
    side_by_side,
)
from surface_gym.state import GRAVITY_COLUMNS, RUNNING, EnvState

Picture = NDArray[np.uint8]  # (height, width, 3)

TRAIL = 0.6  # [m] length of the trail of a stream's parcel
GLIDE = 0.5  # [s] time for which a departed parcel is drawn
FLASH = 0.1  # [s] time for which a touch is drawn
RATE_OVER = 30.0  # [s] period of the displayed rate
SOONEST_RATE = 5.0  # [s] minimum period of the displayed rate
TILE_TEXT = 1.5  # size of texts in a tile, which is scaled down
APART = 1e-9  # [m, rad] minimum difference of a drawn sensed pose from the true pose
_DISC = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)


class Renderer:
    """Renderer of the environments of a batch. It records the parcels' paths for the pictures."""

    def __init__(self, batch: BaseBatch) -> None:
        self._batch = batch
        self._histories: dict[int, _ParcelHistory | _StreamHistory] = {}
        self._painter: Painter | None = None
        self._tile_painter: Painter | None = None

    def record(self, env_index: int, begins: bool) -> None:
        """Record an environment at its start (if `begins`) or after a control period."""
        if env_index not in self._histories:
            history = _StreamHistory if hasattr(self._batch, "streams") else _ParcelHistory
            self._histories[env_index] = history(self._batch, env_index)
        self._histories[env_index].record(begins)

    def scene(self, env_index: int = 0, title: str | None = None) -> Scene:
        """Return the current scene of an environment; the default title is the task's name."""
        return self._histories[env_index].scene(title)

    def draw(self, env_index: int = 0) -> Picture:
        """Draw one environment, with readings above and a legend below."""
        if self._painter is None:
            self._painter = Painter()
        return self._painter.draw(self.scene(env_index))

    def draw_all(self) -> Picture:
        """Draw all recorded environments side by side, with their times."""
        if self._tile_painter is None:
            self._tile_painter = Painter(text=TILE_TEXT)
        return side_by_side(
            [
                self._tile_painter.draw(
                    replace(each.scene(f"env {i}  {each.clock:.2f} s"), readings=())
                )
                for i, each in sorted(self._histories.items())
            ]
        )


class _ParcelHistory:
    """The trail of an environment's only parcel."""

    def __init__(self, batch: Any, env_index: int) -> None:
        self._batch = batch
        self._index = env_index
        self._trail: list[Array] = []

    @property
    def clock(self) -> float:
        """Time [s] since the episode began."""
        return float(self._batch.parcels.clock[self._index])

    def record(self, begins: bool) -> None:
        if begins:
            self._trail.clear()
        self._trail.append(self._batch.parcels.truth[self._index, :2].copy())

    def scene(self, title: str | None = None) -> Scene:
        batch, i = self._batch, self._index
        view, line, task = batch.view(i), batch.config.chosen_line, batch.task
        truth, outcome = view.truth, int(batch.parcels.outcome[i])
        readings: list[tuple[str, str]] = [
            ("time", f"{self.clock:.2f} s"),
            ("speed", f"{np.hypot(truth[3], truth[4]):.2f} m/s"),
            ("heading", f"{np.degrees(truth[2]):+.1f}\N{DEGREE SIGN}"),
            *task.readings(view),
        ]
        if outcome != RUNNING:
            readings.append(("end", batch.outcomes[outcome]))
        tilt, direction = tilt_of_gravity(*batch.surfaces.conditions[i, GRAVITY_COLUMNS].tolist())
        return Scene(
            axis=batch.axes(i),
            drive=batch.surface_velocity(i),
            rotor=view.rotor,
            parcels=(_parcel(view, trail=np.array(self._trail).reshape(-1, 2)),),
            goal=task.goal(view),
            pitch=line.pitch,
            origin=line.origin,
            zone=tuple(view.zone.tolist()),
            tilt=tilt,
            tilt_direction=direction,
            title=type(task).__name__ if title is None else title,
            readings=tuple(readings),
        )


@dataclass(frozen=True, eq=False)
class _Departure:
    """A departed parcel."""

    parcel: SceneParcel
    velocity: Array  # (3,) [m/s, m/s, rad/s]
    departed: float  # [s] time of departure

    def at(self, clock: float) -> SceneParcel:
        """Return the parcel at a later time [s]; the parcel keeps the velocity of its departure."""
        since = np.linspace(0.0, clock - self.departed, 11)[1:, np.newaxis]
        way = np.array(self.parcel.pose) + since * self.velocity
        trail = _latest([*self.parcel.trail, *way[:, :2]])
        return replace(self.parcel, pose=tuple(way[-1].tolist()), trail=np.array(trail))


class _StreamHistory:
    """The trails of a stream's parcels.

    After its departure, a parcel is drawn for `GLIDE` seconds more, under the other parcels.
    """

    def __init__(self, batch: Any, env_index: int) -> None:
        self._batch = batch
        self._index = env_index
        self._exits = exit_marks(batch.config)
        self._inlets = inlet_marks(batch.config)
        self._labels = _labels(batch.config.exits.names)
        # by arrival number: (2,) [m] positions, oldest first
        self._trails: dict[int, list[Array]] = {}
        self._departed: list[_Departure] = []

    @property
    def clock(self) -> float:
        """Time [s] since the episode began."""
        return float(self._batch.streams.clock[self._index])

    def record(self, begins: bool) -> None:
        streams, i, clock = self._batch.streams, self._index, self.clock
        if begins:
            self._trails.clear()
            self._departed.clear()
        self._departed = [each for each in self._departed if clock - each.departed <= GLIDE]
        trails, self._trails = self._trails, {}
        for slot in range(self._batch.task.max_parcels):
            number = int(streams.number[i, slot])
            if number == NOBODY:
                continue
            truth = self._batch.view(i, slot).truth
            self._trails[number] = _latest([*trails.get(number, []), truth[:2].copy()])
            if not streams.present[i, slot]:  # it departed after the last decision
                wrong = self._takes_away and not streams.correct[i, number]
                gone = replace(self._parcel(slot), sensed_pose=None, wrong=bool(wrong))
                departed = float(streams.departed[i, number])
                self._departed.append(_Departure(gone, truth[VX:].copy(), departed))

    def scene(self, title: str | None = None) -> Scene:
        batch, i, streams = self._batch, self._index, self._batch.streams
        config, line = batch.config, batch.config.chosen_line
        slots = np.nonzero(streams.present[i])[0]
        count = int(streams.arrivals[i])
        taken = streams.taken[i, :count]
        delivered = np.bincount(taken[streams.correct[i, :count]], minlength=len(self._exits))
        waits = np.isnan(streams.entered[i, : streams.due[i]])
        queues = np.bincount(
            streams.inlet[i, : streams.due[i]][waits], minlength=len(self._inlets)
        ).tolist()
        departed = tuple(each.at(self.clock) for each in self._departed)
        return Scene(
            axis=batch.axes(i),
            drive=batch.surface_velocity(i),
            rotor=config.site.rotor,
            parcels=departed + tuple(self._parcel(slot) for slot in slots.tolist()),
            traffic=Traffic(
                self._exits,
                tuple(delivered.tolist()),
                missorted=int(streams.tally[i, WRONG]),
                waiting=int(streams.due[i] - streams.tally[i, ENTERED]),
                inlets=self._inlets,
                queues=tuple(queues) if self._inlets else (),
                runs=batch.task.is_running(streams.memory[i]),
            ),
            touching=self._touching(slots, len(departed)),
            pitch=line.pitch,
            origin=line.origin,
            zone=config.site.zone,
            tilt=batch.task.tilt,
            tilt_direction=batch.task.tilt_direction,
            title=type(batch.task).__name__ if title is None else title,
            readings=self._readings(),
        )

    @property
    def _takes_away(self) -> bool:
        """Whether a take-away conveyor follows all exits."""
        return bool(self._batch.task.takes_away)

    def _parcel(self, slot: int) -> SceneParcel:
        """Return the parcel in the row `slot` of the stream's arrays, in the colour of its exit.

        If a take-away conveyor follows the exits, the colour shows the parcel's order or inlet.
        """
        streams, i, task = self._batch.streams, self._index, self._batch.task
        number = int(streams.number[i, slot])
        asked, order = int(streams.exit[i, number]), int(streams.order[i, number])
        trail = np.array(self._trails.get(number, [])).reshape(-1, 2)
        drawn = _parcel(self._batch.view(i, slot), trail)
        if not self._takes_away:
            return replace(drawn, exit=asked, label=self._labels[asked])
        if task.in_order:
            return replace(drawn, group=order // task.stream.window, label=str(order))
        return replace(drawn, group=int(streams.inlet[i, number]))

    def _touching(self, slots: Integers, first: int) -> tuple[tuple[int, int], ...]:
        """Return pairs of parcels that touched recently, as indices into the scene's parcels.

        The parcel in the row `slots[k]` of the state arrays has the index `first` + k.
        """
        streams, i = self._batch.streams, self._index
        since = streams.steps[i] - streams.touched_at[i][np.ix_(slots, slots)]
        lately = since * self._batch.params.timing.dt <= FLASH + 1e-9
        pairs = first + np.argwhere(np.triu(lately, 1))
        return tuple((one, other) for one, other in pairs.tolist())

    def _readings(self) -> tuple[tuple[str, str], ...]:
        streams, i, rate = self._batch.streams, self._index, self._rate()
        readings = [
            ("time", f"{self.clock:.1f} s"),
            ("parcels an hour", "\N{EN DASH}" if math.isnan(rate) else f"{round(rate, -1):.0f}"),
            ("touches", str(int(streams.tally[i, TOUCHES]))),
        ]
        if streams.outcome[i] != RUNNING:
            readings.append(("end", self._batch.outcomes[streams.outcome[i]]))
        return tuple(readings)

    def _rate(self) -> float:
        """Compute the rate of correct departures [parcels/h] in the last `RATE_OVER` seconds.

        The time before the first departure does not count, because the line is filling. If less
        than `SOONEST_RATE` seconds count, return NaN.
        """
        streams, i = self._batch.streams, self._index
        gone = streams.taken[i] >= BETWEEN
        departed = streams.departed[i, gone]
        since = max(self.clock - RATE_OVER, float(departed.min(initial=math.inf)))
        if self.clock - since < SOONEST_RATE:
            return math.nan
        correct = streams.correct[i, gone]
        return HOUR * int((correct & (departed > since)).sum()) / (self.clock - since)


def exit_marks(config: EnvConfig) -> tuple[ExitMark, ...]:
    """Return marks for a stream's exits. An exit lies beside the rotors or straight ahead."""
    line, rotors_end = config.chosen_line, config.rotors_end
    first_row, rows, _, _ = config.rotors
    low = line.origin[1] + line.pitch_y * (first_row - 0.5)
    high = line.origin[1] + line.pitch_y * (first_row + rows - 0.5)
    end = line.column_edge(line.columns)
    marks = []
    for each in config.exits:
        span = None
        if each.side == 0:  # over the last column, if nothing follows the rotors
            first, last = min(rotors_end, end - line.pitch_x), end
            if math.isfinite(each.first) or math.isfinite(each.last):
                span = (max(low, line.line_y + each.first), min(high, line.line_y + each.last))
        else:
            first, last = max(each.first, config.entry_x), min(each.last, rotors_end)
        marks.append(ExitMark(each.name, each.side, first, last, span))
    return tuple(marks)


def inlet_marks(config: EnvConfig) -> tuple[InletMark, ...]:
    """Return a mark for each inlet of a stream, or () if parcels enter over the whole edge."""
    if config.inlets == EDGE:
        return ()
    marks = []
    for inlet, entrance in zip(config.inlets, config.entrances, strict=True):
        middle = entrance.y if inlet.side == START else entrance.x
        first, last = middle - 0.5 * entrance.width, middle + 0.5 * entrance.width
        marks.append(InletMark(inlet.name, inlet.side, first, last))
    return tuple(marks)


def _parcel(view: EnvState, trail: Array) -> SceneParcel:
    """Return the parcel of `view` to draw; `trail` (points, 2) [m] is the parcel's recent path."""
    true, sensed = view.truth[:VX], view.sensed[:VX]
    apart = np.abs(true - sensed).max() > APART
    return SceneParcel(
        outline=_outline(view),
        pose=tuple(true.tolist()),
        trail=trail,
        sensed_pose=tuple(sensed.tolist()) if apart else None,
    )


def _outline(view: EnvState) -> Array:
    """Return the base's outline (points, 2) [m], relative to the base's centroid."""
    corners = view.corners
    if np.abs(corners).max() > 0.0:
        keep = np.ones(len(corners), dtype=bool)
        keep[1:] = (corners[1:] != corners[0]).any(axis=1)
        return corners[keep]
    return view.body[RADIUS] * np.stack([np.cos(_DISC), np.sin(_DISC)], axis=-1)


def _labels(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return a label per exit: the name's initials, or the name if some exits share initials."""
    initials = tuple("".join(word[0] for word in name.split()).upper() for name in names)
    return initials if len(set(initials)) == len(initials) else names


def _latest(points: list[Array]) -> list[Array]:
    """Return the end of a path as points (2,) [m]. The end is at most `TRAIL` [m] long."""
    steps = np.hypot(*np.diff(points, axis=0).T)
    back = np.cumsum(steps[::-1])  # distances from the latest point
    return points[-1 - int(np.searchsorted(back, TRAIL, side="right")) :]
