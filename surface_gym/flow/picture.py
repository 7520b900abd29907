"""From a flow's surface to the scene that is drawn; imports drawing, so import it to draw."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surface_gym.flow.arrivals import HOUR
from surface_gym.flow.batch import FlowBatch
from surface_gym.flow.exits import Exit
from surface_gym.flow.memory import BETWEEN, NOBODY, TOUCHES, WRONG
from surface_gym.flow.settings import FlowSettings
from surface_gym.physics.types import VX
from surface_gym.picture import outline_of
from surface_gym.rendering import ExitMark, FlowPainter, FlowParcel, FlowScene
from surface_gym.state import RUNNING, axis_angles

Numbers = NDArray[np.float64]

TRAIL = 0.6  # [m] shown of the way of a parcel's centre
GLIDE = 0.5  # [s] for which a parcel that has left is shown
FLASH = 0.1  # [s] for which a touch is shown
RATE_OVER = 30.0  # [s] of the past whose parcels make the rate
SOONEST_RATE = 5.0  # [s] of the past without which there is none
APART = 1e-9  # [m, rad] beyond which a sensed pose is another than the true one


@dataclass(frozen=True, eq=False)
class _Departed:
    """A parcel that has left, as it did."""

    parcel: FlowParcel
    velocity: Numbers  # (3,) [m/s, m/s, rad/s]
    left: float  # [s] when

    def at(self, clock: float) -> FlowParcel:
        """The parcel gone on as it left: what takes it over is not modelled."""
        since = np.linspace(0.0, clock - self.left, 11)[1:, np.newaxis]
        way = np.array(self.parcel.pose) + since * self.velocity
        trail = _latest([*self.parcel.trail, *way[:, :2]])
        return replace(self.parcel, pose=tuple(way[-1].tolist()), trail=np.array(trail))


class Album:
    """The pictures of one surface of a batch: what it shows now, and where parcels came from.

    Parcels that have left are drawn for a moment more, under the others.

    Args:
        batch: the surfaces.
        lane: which.
    """

    def __init__(self, batch: FlowBatch, lane: int) -> None:
        self._batch = batch
        self._lane = lane
        self._exits = exit_marks(batch.settings)
        self._labels = _labels(batch.settings.exits.names)
        self._trails: dict[int, list[Numbers]] = {}  # by number of arrival, (2,) [m], oldest first
        self._departed: list[_Departed] = []
        self._painter: FlowPainter | None = None

    def record(self, begins: bool) -> None:
        """Keep where the parcels are, after an episode began or went on by a control period."""
        flows, lane = self._batch.streams, self._lane
        if begins:
            self._trails.clear()
            self._departed.clear()
        clock = float(flows.clock[lane])
        self._departed = [each for each in self._departed if clock - each.left <= GLIDE]
        trails, self._trails = self._trails, {}
        for place in range(self._batch.places):
            number = int(flows.number[lane, place])
            if number == NOBODY:
                continue
            truth = self._batch.parcels.truth[lane * self._batch.rows + place]
            self._trails[number] = _latest([*trails.get(number, []), truth[:2].copy()])
            if not flows.present[lane, place]:  # it has left since the last decision
                gone = replace(self._parcel(place), sensed_pose=None)
                left = float(flows.left[lane, number])
                self._departed.append(_Departed(gone, truth[VX:].copy(), left))

    def scene(self, title: str = "Flow") -> FlowScene:
        """What a picture of now shows."""
        batch, lane, settings = self._batch, self._lane, self._batch.settings
        flows, plant = batch.streams, settings.chosen_plant
        places = np.nonzero(flows.present[lane])[0]
        count = int(flows.arrivals[lane])
        taken, asked = flows.taken[lane, :count], flows.exit[lane, :count]
        right = taken[taken == asked]
        departed = tuple(each.at(float(flows.clock[lane])) for each in self._departed)
        return FlowScene(
            axis=axis_angles(batch.surfaces, slice(lane, lane + 1))[0],
            rotor=settings.rotor,
            exits=self._exits,
            delivered=tuple(np.bincount(right, minlength=len(self._exits)).tolist()),
            parcels=departed + tuple(self._parcel(place) for place in places.tolist()),
            missorted=int(flows.tally[lane, WRONG]),
            waiting=int(flows.due[lane] - flows.coming[lane]),
            touching=self._touching(places, len(departed)),
            pitch=plant.pitch,
            origin=plant.origin,
            zone=settings.zone,
            tilt=settings.tilt,
            title=title,
            readings=self._readings(),
        )

    def draw(self) -> NDArray[np.uint8]:
        """The picture (height, width, 3) of now."""
        if self._painter is None:
            self._painter = FlowPainter()
        return self._painter.draw(self.scene())

    def _parcel(self, place: int) -> FlowParcel:
        batch, lane = self._batch, self._lane
        view = batch.view(lane, place)
        truth, sensed = view.truth[:VX], view.sensed[:VX]
        number = int(batch.streams.number[lane, place])
        asked = int(batch.streams.exit[lane, number])
        return FlowParcel(
            outline=outline_of(view),
            pose=tuple(truth.tolist()),
            exit=asked,
            trail=np.array(self._trails.get(number, [])).reshape(-1, 2),
            sensed_pose=tuple(sensed.tolist()) if np.abs(truth - sensed).max() > APART else None,
            label=self._labels[asked],
        )

    def _touching(self, places: NDArray[np.int64], first: int) -> tuple[tuple[int, int], ...]:
        """Pairs among the parcels of these places, counted from a first, that touched lately."""
        flows, lane = self._batch.streams, self._lane
        since = flows.steps[lane] - flows.touched_at[lane][np.ix_(places, places)]
        lately = since * self._batch.rules.timing.dt <= FLASH + 1e-9
        pairs = first + np.argwhere(np.triu(lately, 1))
        return tuple((one, other) for one, other in pairs.tolist())

    def _readings(self) -> tuple[tuple[str, str], ...]:
        batch, lane = self._batch, self._lane
        flows = batch.streams
        rate = self._rate()
        readings = [
            ("time", f"{flows.clock[lane]:.1f} s"),
            ("parcels an hour", "\N{EN DASH}" if math.isnan(rate) else f"{round(rate, -1):.0f}"),
            ("touches", str(int(flows.tally[lane, TOUCHES]))),
        ]
        if flows.outcome[lane] != RUNNING:
            readings.append(("end", batch.outcomes[flows.outcome[lane]]))
        return tuple(readings)

    def _rate(self) -> float:
        """[1/h] parcels that left by their own exits lately; nan while there is too little of it.

        Lately is never before the first one left: until then the line was filling.
        """
        flows, lane = self._batch.streams, self._lane
        gone = flows.taken[lane] >= BETWEEN
        left, clock = flows.left[lane, gone], float(flows.clock[lane])
        since = max(clock - RATE_OVER, float(left.min(initial=math.inf)))
        if clock - since < SOONEST_RATE:
            return math.nan
        right = flows.taken[lane, gone] == flows.exit[lane, gone]
        return HOUR * int((right & (left > since)).sum()) / (clock - since)


def exit_marks(settings: FlowSettings) -> tuple[ExitMark, ...]:
    """The exits as they are drawn: chutes beside the rotors, straight on past them.

    Raises:
        ValueError: a chute lies past the rotors altogether.
    """
    return tuple(_mark(each, settings) for each in settings.exits)


def _mark(each: Exit, settings: FlowSettings) -> ExitMark:
    plant = settings.chosen_plant
    rotors_end, end = settings.rotors_end, plant.column_edge(plant.columns)
    if each.side == 0:
        # Where nothing of the surface comes after the rotors, parcels leave over the last column.
        return ExitMark(each.name, 0, min(rotors_end, end - plant.pitch_x), end)
    first, last = max(each.first, settings.entry_x), min(each.last, rotors_end)
    return ExitMark(each.name, each.side, first, last)


def _labels(names: tuple[str, ...]) -> tuple[str, ...]:
    """The exits' names for parcels: their words' first letters, where these tell them apart."""
    letters = tuple("".join(word[0] for word in name.split()).upper() for name in names)
    return letters if len(set(letters)) == len(letters) else names


def _latest(points: list[Numbers]) -> list[Numbers]:
    """The last of some points (2,) [m], as far back as the trail goes."""
    steps = np.hypot(*np.diff(points, axis=0).T)
    back = np.cumsum(steps[::-1])  # from the latest to each before it
    return points[-1 - int(np.searchsorted(back, TRAIL, side="right")) :]
