"""Design of a line for a given throughput: its length and its number of actuators.

Hardware is the way in which actuators turn modules. A line carries the rate if its throughput is
at least the required rate. Parcels wait at a gate before the line.

The throughput of a line is predicted from its maneuvers. The shortest sufficient line is then
simulated with a parcel always at the gate. It can be compared with lines of driven modules.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import HOUR, Steady
from surface_gym.flow.exits import PITCH, Exits, flow_line
from surface_gym.flow.state import CORRECT, JAM, TURNS, WRONG, compute_statistics
from surface_gym.flow.stream import Stream
from surface_gym.modules import DrivenModule
from surface_gym.randomisation import Actuators
from surface_gym.registration import DEFAULT_STREAM
from surface_gym.state import RUNNING

from ..base import Numbers
from .driven import STREAM_KINDS
from .maneuvers import ColumnGroups, Library, make_library
from .scheduler import (
    CLEARANCES,
    Scheduler,
    begin_streams,
    entrance_bound,
    make_scheduler,
    predict_rate,
)
from .trajectories import list_asked

ARRANGED, FOLLOWED, SERIES, COLUMNS, MODULES = HARDWARE = (
    "one zone, arranged anew",
    "one zone, exits follow",
    "zones in series",
    "one actuator a column",
    "every module by itself",
)
FOUR = (0.0, 45.0, -45.0, 90.0)  # [deg] orientations
SIX = (*FOUR, 80.0, -80.0)
STUCK = (0.0, 0.01, 0.02, 0.05, 0.1)  # [-] shares of failed modules
LONGEST = 6.0  # [m] maximum length of a line
ROTOR_ROWS = 4
WIDEST = 20  # maximum columns of one zone
IN_SERIES = (3, 4, 6, 8)  # columns per zone in series
BEST = 2  # number of widths that are tried on longer lines
COARSE = 1.25  # [-] ratio between the lengths of the first pass
LEAD_IN = 5  # minimum columns
QUEUE = 4  # number of waiting parcels visible to the scheduler
LOOK_EVERY = 5  # control periods between samples of the axes
# Equal to the comparison's values, so that rates agree.
SEED, REPLICATIONS, SECONDS, WARM_UP = 20_261_121, 30, 30.0, 8.0

Clearance = tuple[float, float]


@dataclass(frozen=True)
class FlowCase:
    """Requirements on a line."""

    rate: float  # [parcels/h]
    mix: tuple[tuple[Any, float], ...] = (("S", 1.0),)  # parcels with their odds
    exits: str | Exits = "sides"
    speed: float | tuple[float, float] = 1.5  # [m/s] one speed, or the smallest and the largest
    longest: float = LONGEST  # [m] longest line to try
    turn_energy: float = 0.0  # [J] energy of a turn of an actuator, by its data sheet
    turn_life: float = math.inf  # turns of an actuator until it fails, by its data sheet
    driven: bool = False  # whether lines of driven modules are found, too

    def __post_init__(self) -> None:
        checks.positive("rate", self.rate, *checks.RATE)
        Actuators(turn_energy=self.turn_energy, turn_life=self.turn_life)
        checks.positive("longest", self.longest, PITCH * (LEAD_IN + 1), 50.0)
        if PITCH * self.columns[0] > self.longest + 1e-9:
            raise ValueError(
                f"longest must be at least {PITCH * self.columns[0]:g} m, where every exit begins "
                f"beside the rotors, got {self.longest!r}"
            )
        config = self.config(self.columns[-1])
        most = entrance_bound(config, self.odds(config))
        if self.rate > most:
            raise ValueError(
                f"rate must be at most {most:.0f} parcels/h, the entry limit of a line, "
                f"got {self.rate:g}"
            )

    @property
    def stream(self) -> Stream:
        return Stream(Steady(self.rate), parcels=self.mix, speeds=self.speed)

    @cached_property
    def lead_in(self) -> int:
        """Number of columns at 90 deg before the zone; no parcel is longer than these columns."""
        longest = max(np.ptp(parcel.base.outline[:, 0]) for parcel in self.stream.kinds)
        return max(LEAD_IN, math.ceil(longest / PITCH - 1e-9))

    @cached_property
    def columns(self) -> range:
        """Numbers of columns to try. A number counts the columns of the lead-in, too."""
        least = self.lead_in + 1
        if isinstance(self.exits, Exits):  # every exit is beside the rotors
            least = max(least, *(math.floor(x.first / PITCH) + 1 for x in self.exits if x.side))
        return range(least, max(least, round(self.longest / PITCH)) + 1)

    def make_module(self, kind: str) -> DrivenModule:
        """Make driven modules for the stream's highest speed, with unlimited acceleration."""
        return STREAM_KINDS[kind](speed=float(np.max(self.speed)), acceleration=math.inf)

    def config(
        self, columns: int, orientations: Sequence[float] = FOUR, by_parcel: bool = True,
        module: DrivenModule | None = None,
    ) -> EnvConfig:  # fmt: skip
        """Configure a line of `columns` columns. A parcel always waits at the line's gate.

        If `module` is None, the line has idle rotors with `orientations` [deg]. If `by_parcel` is
        true, actions are "parcels", otherwise "modules".
        """
        given: dict[str, Any] = {"orientations": tuple(np.radians(orientations))}
        if module is not None:
            given = {"modules": module, "info": ("energy",)}
        low, length = np.min(self.speed), PITCH * columns
        shortest = min(np.ptp(parcel.base.outline[:, 0]) for parcel in self.stream.kinds)
        config = EnvConfig(
            DEFAULT_STREAM,
            stream=self.stream,
            exits=self.exits,
            line=flow_line(length, ROTOR_ROWS, self.lead_in),
            actions="parcels" if by_parcel else "modules",
            gate=True,
            queue=QUEUE,
            max_parcels=max(24, math.ceil(length / shortest)),
            duration=SECONDS - WARM_UP + max(WARM_UP, 1.2 * length / float(low)),
            **given,
        )
        bound = entrance_bound(config, self.odds(config))
        return config.replace(stream=self.stream.with_rate(bound))

    def odds(self, config: EnvConfig) -> Numbers:
        """Return relative frequencies of combinations (parcel, speed, exit) from `list_asked`."""
        parcels = np.array([odds for _, odds in self.stream.parcels])
        exits = np.ones(len(config.exits))
        speeds = np.ones(len(list_asked(config)) // (len(parcels) * len(exits)))
        if len(speeds) > 1:
            speeds[[0, -1]] = 0.5
        return np.einsum("i,j,k", parcels, speeds, exits).ravel()


class LineLayout(NamedTuple):
    """A line and its actuators."""

    columns: int  # including the lead-in
    groups: ColumnGroups | None  # None: one actuator per module


@dataclass(frozen=True)
class LineMeasurement:
    """Measured numbers of a line. During the measurement, parcels always wait at the gate."""

    rate: float  # [parcels/h] correct deliveries
    margin: float  # [parcels/h] half width of the 95 % confidence interval
    share_correct: float  # [-] share of correct deliveries
    touches_per_1000: float  # [-] touches per 1000 deliveries
    jams: int  # episodes that ended in a jam
    turns_per_parcel: float  # turns of all axes per parcel
    turns_per_hour: float  # [1/h] turns per axis
    share_at: tuple[float, ...]  # [-] share of time at each orientation
    energy: float = 0.0  # [J] that drives draw per parcel


def measure(config: EnvConfig, scheduler: Scheduler, stuck: float = 0.0) -> LineMeasurement:
    """Measure a scheduler on a line with a share of modules stuck at 90 deg.

    The scheduler does not know about stuck modules.
    """
    failing = config.replace(actuators=Actuators(stuck_share=stuck))
    batch = begin_streams(failing, REPLICATIONS, SEED)
    streams, state = batch.streams, None
    angles = np.array(config.chosen_orientations)
    at = np.zeros(len(angles))
    actions, period = config.action_kind, 0
    while (batch.outcome == RUNNING).any():
        action, state = scheduler.predict(batch.observation, state)
        batch.step(actions.commands(action, REPLICATIONS))
        period += 1
        if period % LOOK_EVERY:
            continue
        stands = streams.commanded[np.broadcast_to(streams.obeys, streams.commanded.shape)]
        at += (np.abs(stands[:, np.newaxis] - angles) < 1e-6).sum(axis=0)
    duration = config.stream_task.duration
    counted = SECONDS - WARM_UP
    each, delivered, touches, turns = [], 0, 0.0, []
    for k in range(REPLICATIONS):
        jammed = bool(streams.outcome[k] == JAM)
        obeying = int(streams.obeys[k % len(streams.obeys)].sum())
        found = compute_statistics(streams, k, jammed, obeying, duration - counted)
        delivered += found.delivered
        turns.append(found.turns_per_hour)
        correct = found.delivered * (1.0 - found.missort_rate) if found.delivered else 0.0
        touches += found.touches_per_1000 * found.delivered / 1000.0 if found.delivered else 0.0
        each.append(HOUR * correct / counted)
    departed = streams.tally[:, [CORRECT, WRONG]].sum()
    drawn = float(batch.infos()["drawn_energy"].sum()) if config.meters else 0.0
    return LineMeasurement(
        rate=float(np.mean(each)),
        margin=float(2.05 * np.std(each, ddof=1) / math.sqrt(REPLICATIONS)),
        share_correct=sum(each) * counted / HOUR / max(1, delivered),
        touches_per_1000=1000.0 * touches / max(1, delivered),
        jams=int((streams.outcome == JAM).sum()),
        turns_per_parcel=float(streams.tally[:, TURNS].sum() / max(1, departed)),
        turns_per_hour=float(np.nanmean(turns)),
        share_at=tuple((at / at.sum()).tolist()),
        energy=drawn / max(1, departed),
    )


@dataclass(frozen=True)
class LineDesign:
    """For one kind of hardware, the shortest line for a rate, or the line with the highest rate."""

    hardware: str
    orientations: tuple[float, ...]  # [deg]
    carries: bool
    length: float  # [m] length of the line
    zone: int  # columns per actuator; 0: one module per actuator
    actuators: int
    predicted: float  # [parcels/h]
    run: LineMeasurement
    curve: tuple[tuple[float, float], ...]  # length [m] and throughput [parcels/h] of lines
    stuck: tuple[LineMeasurement, ...] = ()  # one measurement for each share in STUCK, or empty
    motors: tuple[int, int] = (0, 1)  # of an actuator: drives, and axes

    @property
    def remaining(self) -> tuple[float, ...]:
        """[-] rate of the line with stuck modules, divided by its rate without stuck modules.

        There is one ratio for each share of stuck modules in `STUCK`.
        """
        return tuple(run.rate / self.run.rate for run in self.stuck)

    @property
    def motor_count(self) -> int:
        return self.actuators * sum(self.motors)

    def energy(self, turn_energy: float) -> float:
        """Return the energy [J] of drives and axes per parcel. A turn needs `turn_energy` [J]."""
        turns = self.run.turns_per_parcel / (ROTOR_ROWS * self.zone or 1)
        return self.run.energy + self.motors[1] * turn_energy * turns


class Search:
    """Search for the shortest line with one kind of hardware.

    The methods' argument `choices` is a line's number of orientations. The line has the first
    `choices` orientations of the tuple `SIX`. Driven modules always have all their modes. A
    clearance is a pair (slack [-], margin [m]); see `make_library`.
    """

    def __init__(self, case: FlowCase, hardware: str) -> None:
        self.case, self.hardware = case, hardware
        self._libraries: dict[tuple[LineLayout, Clearance], Library | None] = {}
        self._rates: dict[tuple[LineLayout, Clearance, int], float] = {}
        self._schedulers: dict[tuple[LineLayout, int], Scheduler | None] = {}
        self._runs: dict[tuple[LineLayout, int], LineMeasurement] = {}
        self.module = case.make_module(hardware) if hardware in STREAM_KINDS else None
        self._ratio = 1.0  # a scheduler's rate divided by the rate with the smallest clearance

    def config(self, layout: LineLayout, choices: int = len(SIX)) -> EnvConfig:
        by_parcel = layout.groups is None
        return self.case.config(layout.columns, SIX[:choices], by_parcel, self.module)

    def library(self, layout: LineLayout, clearance: Clearance, choices: int) -> Library | None:
        """Return maneuvers at a clearance (slack, margin), or None if a parcel misses its exit."""
        slack, margin = clearance
        key = layout, clearance
        if key not in self._libraries:
            other = self._libraries.get((layout, CLEARANCES[0]))
            if other is None:
                config = self.config(layout)
                other = make_library(config, layout.groups, margin=margin, slack=slack)
            else:
                other = other.with_clearance(margin, slack)
            self._libraries[key] = other if other.correct.all() else None
        library = self._libraries[key]
        if library is None:
            return None
        kept = library.maneuvers.choice < choices
        if len(np.unique(library.maneuvers.kind[kept])) < len(library.correct):
            return None
        gaps = library.gaps[np.ix_(kept, kept)]
        return replace(library, maneuvers=library.maneuvers.pick(kept), gaps=gaps, runs=())

    def rate(self, layout: LineLayout, choices: int, clearance: Clearance = CLEARANCES[0]) -> float:
        """Predict a layout's throughput [parcels/h], or return 0 if some parcel misses its exit."""
        library = self.library(layout, clearance, choices)
        if library is None:
            return 0.0
        key = layout, clearance, len(library.gaps)
        if key not in self._rates:
            self._rates[key] = self.predict(layout, library)
        return self._rates[key]

    def predict(self, layout: LineLayout, library: Library) -> float:
        """Predict the throughput [parcels/h] of a layout from the maneuvers and gaps in `library`.

        If any gap is infinite, the throughput is 0.
        """
        if not np.isfinite(library.gaps).all():
            return 0.0
        return predict_rate(library, self.case.odds(self.config(layout)), depth=QUEUE)

    @cached_property
    def families(self) -> list[list[LineLayout]]:
        """Return lists (families) of layouts. In a family, throughput mostly grows with length."""
        lines, lead_in = self.case.columns, self.case.lead_in
        if self.hardware in (COLUMNS, MODULES, *STREAM_KINDS):
            groups = None if self.hardware == MODULES else ColumnGroups()
            return [[LineLayout(columns, groups) for columns in lines]]

        def zones(width: int, count: int, exclusive: bool = False) -> LineLayout:
            columns = max(lines[0], lead_in + width * count)
            return LineLayout(columns, ColumnGroups(width, count, exclusive))

        room = lines[-1] - lead_in
        if self.hardware != SERIES:
            exclusive = self.hardware == ARRANGED
            return [[zones(width, 1, exclusive) for width in range(1, min(WIDEST, room) + 1)]]
        widths = [width for width in IN_SERIES if 2 * width <= room]
        widths.sort(key=lambda width: -self.rate(zones(width, 2), len(FOUR)))
        return [
            [zones(width, count) for count in range(2, room // width + 1)]
            for width in widths[:BEST]
        ]

    def coarse(self, family: Sequence[LineLayout]) -> Iterator[int]:
        """Yield indices into `family` for a first pass. Skip most layouts of similar length."""
        last = 0.0
        for k, layout in enumerate(family):
            dense = layout.groups is not None and layout.groups.count == 1
            if dense or layout.columns >= COARSE * last or k == len(family) - 1:
                last = layout.columns
                yield k

    def shortest(
        self, family: Sequence[LineLayout], choices: int, below: float
    ) -> LineLayout | None:
        """Return the first layout with `columns` < `below` that carries the rate, or None."""
        before = -1
        for k in self.coarse(family):
            if self._may_carry(family[k], choices):
                for layout in family[before + 1 : k + 1]:
                    if layout.columns >= below:
                        return None
                    if self._may_carry(layout, choices) and self.carries(layout, choices):
                        return layout
            before = k
        return None

    def _may_carry(self, layout: LineLayout, choices: int) -> bool:
        return self.rate(layout, choices) * self._ratio >= self.case.rate

    def carries(self, layout: LineLayout, choices: int) -> bool:
        """Predict whether a line with its scheduler carries the rate that the case requires."""
        scheduler = self.scheduler(layout, choices)
        if scheduler is None:
            return False
        predicted = self.predict(layout, scheduler.library)
        self._ratio = predicted / self.rate(layout, choices)
        return predicted >= self.case.rate

    def scheduler(self, layout: LineLayout, choices: int) -> Scheduler | None:
        """Make or reuse the scheduler of a layout. Return None if `make_scheduler` returns None."""
        choices = self._used(layout, choices)
        key = layout, choices
        if key not in self._schedulers:
            config = self.config(layout, choices)
            self._schedulers[key] = make_scheduler(config, layout.groups)
        return self._schedulers[key]

    def run(self, layout: LineLayout, choices: int) -> LineMeasurement:
        """Measure a line. Call the method `scheduler` first, with the same arguments."""
        choices = self._used(layout, choices)
        key = layout, choices
        if key not in self._runs:
            scheduler = self._schedulers[key]
            assert scheduler is not None
            self._runs[key] = measure(self.config(layout, choices), scheduler)
        return self._runs[key]

    def _used(self, layout: LineLayout, choices: int) -> int:
        """Return `choices` if more than four orientations add maneuvers, else return 4."""
        if self.module is not None:
            return choices
        few, all_ = (self.library(layout, CLEARANCES[0], count) for count in (len(FOUR), choices))
        same = few is not None and all_ is not None and len(few.gaps) == len(all_.gaps)
        return len(FOUR) if same else choices

    def find(self, choices: int) -> tuple[LineLayout, LineDesign] | None:
        """Find the shortest line that carries `case.rate`, or else the line with the highest rate.

        Return None if no line has a scheduler, e.g. if some parcel misses its exit on every line.
        """
        self._ratio = 1.0
        layout: LineLayout | None = None
        for family in self.families:
            below = math.inf if layout is None else layout.columns
            layout = self.shortest(family, choices, below) or layout
        tried = [family[k] for family in self.families for k in self.coarse(family)]
        if layout is None:
            rates = {each: self.rate(each, choices) for each in tried}
            some = sorted((each for each in tried if rates[each] > 0.0), key=lambda x: -rates[x])
            able = (each for each in some[:BEST] if self.scheduler(each, choices) is not None)
            layout = next(able, None)
        scheduler = None if layout is None else self.scheduler(layout, choices)
        if layout is None or scheduler is None:
            return None
        groups, own = layout.groups, layout.columns - self.case.lead_in
        predicted = self.predict(layout, scheduler.library)
        headings = SIX[:choices] if self.module is None else self.module.headings
        return layout, LineDesign(
            self.hardware, tuple(headings), predicted >= self.case.rate,
            round(PITCH * layout.columns, 9), 0 if groups is None else groups.columns,
            own * ROTOR_ROWS if groups is None else groups.count or own, predicted,
            self.run(layout, choices),
            self._curve(tried, choices, (scheduler.library.slack, scheduler.library.margin)),
            motors=(0, 1) if self.module is None else self.module.motors,
        )  # fmt: skip

    def _curve(
        self, tried: Sequence[LineLayout], choices: int, clearance: Clearance
    ) -> tuple[tuple[float, float], ...]:
        """Return lengths [m] and predicted rates [parcels/h] of layouts, by increasing length.

        A longer line gets at least the rate of a shorter line. The rate of a layout without a
        scheduler is predicted at the clearance `clearance`.
        """
        best, found = 0.0, []
        verified = {layout for layout, _ in self._schedulers}
        for layout in sorted({*tried, *verified}, key=lambda each: each.columns):
            made = self._schedulers.get((layout, self._used(layout, choices)))
            if made is not None:
                best = max(best, self.predict(layout, made.library))
            else:
                best = max(best, self.rate(layout, choices, clearance))
            if best > 0.0:
                found.append((round(PITCH * layout.columns, 9), best))
        end = round(PITCH * self.case.columns[-1], 9)
        return tuple(found if found[-1][0] == end else [*found, (end, best)])

    def run_stuck(self, layout: LineLayout, choices: int) -> tuple[LineMeasurement, ...]:
        """Measure the scheduler of `layout` at each share of stuck modules in `STUCK`."""
        scheduler = self.scheduler(layout, choices)
        assert scheduler is not None
        config = self.config(layout, self._used(layout, choices))
        first = self.run(layout, choices)
        return first, *(measure(config, scheduler, share) for share in STUCK[1:])


def find_lines(case: FlowCase, hardware: str) -> tuple[LineDesign, ...]:
    """Find the best line with four orientations, and the best line with six orientations.

    `hardware` is a name in `HARDWARE` or `STREAM_KINDS`. For driven modules, find only one line.
    If lines reach the required rate, the shortest of these lines is also run with stuck modules.
    """
    search = Search(case, hardware)
    if search.module is not None:
        best = search.find(search.config(LineLayout(case.columns[-1], None)).choices)
        return () if best is None else (best[1],)
    found = [best for each in (FOUR, SIX) if (best := search.find(len(each))) is not None]
    rows = [row for _, row in found]
    able = [k for k, row in enumerate(rows) if row.carries]
    if able:
        k = min(able, key=lambda k: rows[k].length)
        stuck = search.run_stuck(found[k][0], len(rows[k].orientations))
        rows[k] = replace(rows[k], stuck=stuck)
    return tuple(rows)
