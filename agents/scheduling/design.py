"""The engineer's question: which line, and how many actuators, carry a rate of parcels.

The rate of a line is predicted from its maneuvers. The shortest one that carries what is asked for
is then run, as the comparison runs it, with a parcel always at the gate.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import HOUR, Steady
from surface_gym.flow.exits import PITCH, Exits, flow_line
from surface_gym.flow.state import CORRECT, JAM, TURNS, WRONG, compute_statistics
from surface_gym.flow.stream import Stream
from surface_gym.parallel import Workers, map_jobs, without_report
from surface_gym.randomisation import Actuators
from surface_gym.state import RUNNING

from ..base import Numbers
from .bounds import entrance_bound
from .maneuvers import ColumnGroups, Library, make_library
from .scheduler import CLEARANCES, Scheduler, begin_streams, make_scheduler, predict_rate
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
STUCK = (0.0, 0.01, 0.02, 0.05, 0.1)  # [-] share of the modules that fail
LONGEST = 6.0  # [m] of a line
ROTOR_ROWS = 4
WIDEST = 20  # columns of one zone, at most
IN_SERIES = (3, 4, 6, 8)  # columns of each zone in series
BEST = 2  # of these widths that are tried on longer lines
COARSE = 1.25  # [-] between the lengths that are tried first
LEAD_IN = 5  # columns, at least
QUEUE = 4  # waiting parcels that the scheduler knows
LOOK_EVERY = 5  # control periods between looks at the axes
# As the comparison has them, so that rates agree.
SEED, REPLICATIONS, SECONDS, WARM_UP = 20_261_121, 30, 30.0, 8.0

Clearance = tuple[float, float]
OnProgress = Callable[[int, int], None]


@dataclass(frozen=True)
class FlowCase:
    """What a line is to carry."""

    rate: float  # [parcels/h]
    mix: tuple[tuple[Any, float], ...] = (("S", 1.0),)  # parcels and their odds
    exits: str | Exits = "sides"
    speed: float | tuple[float, float] = 1.5  # [m/s], or least and greatest
    longest: float = LONGEST  # [m] line that is tried

    def __post_init__(self) -> None:
        checks.positive("rate", self.rate, *checks.RATE)
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
                f"rate must be at most {most:.0f} parcels/h, more than which cannot even enter a "
                f"line one after the other, got {self.rate:g}"
            )

    @property
    def stream(self) -> Stream:
        return Stream(Steady(self.rate), parcels=self.mix, speeds=self.speed)

    @cached_property
    def lead_in(self) -> int:
        """Columns that stay at 90 deg: as many as the longest parcel is long."""
        longest = max(np.ptp(parcel.base.outline[:, 0]) for parcel in self.stream.kinds)
        return max(LEAD_IN, math.ceil(longest / PITCH - 1e-9))

    @cached_property
    def columns(self) -> range:
        """Columns of the lines that are tried, lead-in included."""
        least = self.lead_in + 1
        if isinstance(self.exits, Exits):  # each beside the rotors
            least = max(least, *(math.floor(x.first / PITCH) + 1 for x in self.exits if x.side))
        return range(least, max(least, round(self.longest / PITCH)) + 1)

    def config(
        self, columns: int, orientations: Sequence[float] = FOUR, by_parcel: bool = True
    ) -> EnvConfig:
        """Configure a line of so many columns, with a parcel always at its gate."""
        low, length = np.min(self.speed), PITCH * columns
        shortest = min(np.ptp(parcel.base.outline[:, 0]) for parcel in self.stream.kinds)
        config = EnvConfig(
            "flow",
            stream=self.stream,
            exits=self.exits,
            line=flow_line(length, ROTOR_ROWS, self.lead_in),
            actions="parcels" if by_parcel else "modules",
            orientations=tuple(np.radians(orientations)),
            gate=True,
            queue=QUEUE,
            max_parcels=max(24, math.ceil(length / shortest)),
            duration=SECONDS - WARM_UP + max(WARM_UP, 1.2 * length / float(low)),
        )
        bound = entrance_bound(config, self.odds(config))
        return config.replace(stream=self.stream.with_rate(bound))

    def odds(self, config: EnvConfig) -> Numbers:
        """List the odds of each parcel, speed and exit, as `list_asked` does."""
        parcels = np.array([odds for _, odds in self.stream.parcels])
        exits = np.ones(len(config.exits))
        speeds = np.ones(len(list_asked(config)) // (len(parcels) * len(exits)))
        if len(speeds) > 1:
            speeds[[0, -1]] = 0.5
        return np.einsum("i,j,k", parcels, speeds, exits).ravel()


class Layout(NamedTuple):
    """A line and its actuators."""

    columns: int  # lead-in included
    groups: ColumnGroups | None  # None: every module by itself


@dataclass(frozen=True)
class Run:
    """Deliveries of a line with always a parcel at the gate."""

    rate: float  # [parcels/h] that left by their own exit
    margin: float  # [parcels/h] half of its 95 % interval
    share_right: float  # [-] of deliveries
    touches_per_1000: float  # [-] deliveries
    jams: int  # episodes that ended in one
    turns_per_parcel: float  # of all axes
    turns_per_hour: float  # [1/h] of one axis, mean
    share_at: tuple[float, ...]  # [-] of the time, axes stand at each orientation


def measure(config: EnvConfig, scheduler: Scheduler, stuck: float = 0.0) -> Run:
    """Run a scheduler, with a share of the modules stuck at 90 deg that it does not know."""
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
        right = found.delivered * (1.0 - found.missort_rate) if found.delivered else 0.0
        touches += found.touches_per_1000 * found.delivered / 1000.0 if found.delivered else 0.0
        each.append(HOUR * right / counted)
    delivered = streams.tally[:, [CORRECT, WRONG]].sum()
    return Run(
        rate=float(np.mean(each)),
        margin=float(2.05 * np.std(each, ddof=1) / math.sqrt(REPLICATIONS)),
        share_right=sum(each) * counted / HOUR / max(1, delivered),
        touches_per_1000=1000.0 * touches / max(1, delivered),
        jams=int((streams.outcome == JAM).sum()),
        turns_per_parcel=float(streams.tally[:, TURNS].sum() / max(1, delivered)),
        turns_per_hour=float(np.nanmean(turns)),
        share_at=tuple((at / at.sum()).tolist()),
    )


@dataclass(frozen=True)
class Found:
    """The shortest line of some hardware that carries the rate, or else the best one."""

    hardware: str
    orientations: tuple[float, ...]  # [deg]
    carries: bool
    length: float  # [m] of the line
    zone: int  # columns that an actuator turns; 0: it turns one module
    actuators: int
    predicted: float  # [parcels/h]
    run: Run
    curve: tuple[tuple[float, float], ...]  # [m] of a line, and [parcels/h] that it carries
    stuck: tuple[Run, ...] = ()  # a run for each share in STUCK, or none

    @property
    def left(self) -> tuple[float, ...]:
        """[-] of the rate that is left at each share in STUCK."""
        return tuple(run.rate / self.run.rate for run in self.stuck)


class Search:
    """Searches the shortest line of some hardware."""

    def __init__(self, case: FlowCase, hardware: str) -> None:
        self.case, self.hardware = case, hardware
        self._libraries: dict[tuple[Layout, Clearance], Library | None] = {}
        self._rates: dict[tuple[Layout, Clearance, int], float] = {}
        self._schedulers: dict[tuple[Layout, int], Scheduler | None] = {}
        self._runs: dict[tuple[Layout, int], Run] = {}
        self._ratio = 1.0  # of the rate without touches to that of the least clearance

    def config(self, layout: Layout, choices: int = len(SIX)) -> EnvConfig:
        return self.case.config(layout.columns, SIX[:choices], layout.groups is None)

    def library(self, layout: Layout, clearance: Clearance, choices: int) -> Library | None:
        """Make the library of the first orientations; None where it leads some parcel wrong."""
        slack, margin = clearance
        key = layout, clearance
        if key not in self._libraries:
            other = self._libraries.get((layout, CLEARANCES[0]))
            if other is None:
                config = self.config(layout)
                other = make_library(config, layout.groups, margin=margin, slack=slack)
            else:
                other = other.with_clearance(margin, slack)
            self._libraries[key] = other if other.right.all() else None
        library = self._libraries[key]
        if library is None:
            return None
        kept = library.maneuvers.choice < choices
        if len(np.unique(library.maneuvers.kind[kept])) < len(library.right):
            return None
        gaps = library.gaps[np.ix_(kept, kept)]
        return replace(library, maneuvers=library.maneuvers.pick(kept), gaps=gaps, runs=())

    def rate(self, layout: Layout, choices: int, clearance: Clearance = CLEARANCES[0]) -> float:
        """Predict what a line carries [parcels/h]; 0 where it leads some parcel wrong."""
        library = self.library(layout, clearance, choices)
        if library is None:
            return 0.0
        key = layout, clearance, len(library.gaps)
        if key not in self._rates:
            self._rates[key] = self.predict(layout, library)
        return self._rates[key]

    def predict(self, layout: Layout, library: Library) -> float:
        """Predict what a library carries [parcels/h]."""
        if not np.isfinite(library.gaps).all():
            return 0.0
        return predict_rate(library, self.case.odds(self.config(layout)), depth=QUEUE)

    @cached_property
    def families(self) -> list[list[Layout]]:
        """Layouts; those of a family carry about the more, the longer they are."""
        lines, lead_in = self.case.columns, self.case.lead_in
        if self.hardware in (COLUMNS, MODULES):
            groups = ColumnGroups() if self.hardware == COLUMNS else None
            return [[Layout(columns, groups) for columns in lines]]

        def zones(width: int, count: int, exclusive: bool = False) -> Layout:
            columns = max(lines[0], lead_in + width * count)
            return Layout(columns, ColumnGroups(width, count, exclusive))

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

    def coarse(self, family: Sequence[Layout]) -> Iterator[int]:
        """List the places in a family that are tried first."""
        last = 0.0
        for k, layout in enumerate(family):
            dense = layout.groups is not None and layout.groups.count == 1
            if dense or layout.columns >= COARSE * last or k == len(family) - 1:
                last = layout.columns
                yield k

    def shortest(self, family: Sequence[Layout], choices: int, below: float) -> Layout | None:
        """Find the first of a family that carries the rate without touches, and is short enough."""
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

    def _may_carry(self, layout: Layout, choices: int) -> bool:
        return self.rate(layout, choices) * self._ratio >= self.case.rate

    def carries(self, layout: Layout, choices: int) -> bool:
        """Return whether a line is predicted to carry the rate without touches."""
        scheduler = self.scheduler(layout, choices)
        if scheduler is None:
            return False
        predicted = self.predict(layout, scheduler.library)
        self._ratio = predicted / self.rate(layout, choices)
        return predicted >= self.case.rate

    def scheduler(self, layout: Layout, choices: int) -> Scheduler | None:
        """Make the scheduler that the comparison has, if no two of its parcels touch."""
        choices = self._used(layout, choices)
        key = layout, choices
        if key not in self._schedulers:
            config = self.config(layout, choices)
            self._schedulers[key] = make_scheduler(config, layout.groups)
        return self._schedulers[key]

    def run(self, layout: Layout, choices: int) -> Run:
        """Run the scheduler of a line, which it must have."""
        choices = self._used(layout, choices)
        key = layout, choices
        if key not in self._runs:
            scheduler = self._schedulers[key]
            assert scheduler is not None
            self._runs[key] = measure(self.config(layout, choices), scheduler)
        return self._runs[key]

    def _used(self, layout: Layout, choices: int) -> int:
        """Count the orientations that make a difference to a line, of the first ones."""
        few, all_ = (self.library(layout, CLEARANCES[0], count) for count in (len(FOUR), choices))
        same = few is not None and all_ is not None and len(few.gaps) == len(all_.gaps)
        return len(FOUR) if same else choices

    def find(self, choices: int) -> tuple[Layout, Found] | None:
        """Find the shortest line that carries the rate, else the best; None: none leads right."""
        self._ratio = 1.0
        layout: Layout | None = None
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
        return layout, Found(
            self.hardware, SIX[:choices], predicted >= self.case.rate,
            round(PITCH * layout.columns, 9), 0 if groups is None else groups.columns,
            own * ROTOR_ROWS if groups is None else groups.count or own, predicted,
            self.run(layout, choices),
            self._curve(tried, choices, (scheduler.library.slack, scheduler.library.margin)),
        )  # fmt: skip

    def _curve(
        self, tried: Sequence[Layout], choices: int, clearance: Clearance
    ) -> tuple[tuple[float, float], ...]:
        """Predict the rate by length; what a shorter line carries, a longer one does."""
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

    def run_stuck(self, layout: Layout, choices: int) -> tuple[Run, ...]:
        """Run the scheduler of a line at each share in STUCK."""
        scheduler = self.scheduler(layout, choices)
        assert scheduler is not None
        config = self.config(layout, self._used(layout, choices))
        first = self.run(layout, choices)
        return first, *(measure(config, scheduler, share) for share in STUCK[1:])


def find_lines(case: FlowCase, hardware: str) -> tuple[Found, ...]:
    """Find the line with four orientations and with six; the shorter also with stuck modules."""
    search = Search(case, hardware)
    found = [best for each in (FOUR, SIX) if (best := search.find(len(each))) is not None]
    rows = [row for _, row in found]
    able = [k for k, row in enumerate(rows) if row.carries]
    if able:
        k = min(able, key=lambda k: rows[k].length)
        stuck = search.run_stuck(found[k][0], len(rows[k].orientations))
        rows[k] = replace(rows[k], stuck=stuck)
    return tuple(rows)


def design_flow(
    case: FlowCase, workers: Workers = 1, on_progress: OnProgress = lambda *_: None
) -> tuple[Found, ...]:
    """Find the shortest line of every hardware."""
    order = (MODULES, COLUMNS, SERIES, FOLLOWED, ARRANGED)  # the slowest first
    jobs = [partial(without_report, partial(find_lines, case, hardware)) for hardware in order]
    found: dict[str, tuple[Found, ...]] = {}
    for index, rows in map_jobs(jobs, workers):
        found[order[index]] = rows
        on_progress(len(found), len(order))
    return tuple(row for hardware in HARDWARE for row in found[hardware])
