"""Lines sized for a parcel, and runs over these lines by threads or a cluster.

A run ends when the parcel has left the line, passed the zone or stopped, or after 20 s. The motion
equals the implicit method of `simulate` to the bit. Results do not depend on the workers.
"""

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from queue import SimpleQueue
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from surface_gym import checks, state as st
from surface_gym.compiler.jit import compiled, inlined
from surface_gym.executors import Cluster
from surface_gym.layouts import ROLLING, lead_in_under, rows_under
from surface_gym.parallel import Workers, check_count, map_jobs, without_report
from surface_gym.parcel import Parcel, make_bodies
from surface_gym.physics import step as stepping, types as ph
from surface_gym.physics.collision import read_body
from surface_gym.physics.contacts import invalidate_contacts
from surface_gym.physics.types import Array, Bodies, Booleans, Grid, Integers, Places, Scratch
from surface_gym.simulation import base_motion
from surface_gym.surface import ElementGrid, Surface

RUN_OUT = 1.0  # [m] of rolling columns behind the zone, beyond the base's length


@dataclass(frozen=True)
class DesignLine(ElementGrid):
    """A line of rotors among supports: a lead-in, a zone whose axes are designed, and a run-out.

    In the lead-in and the run-out, axes are at 90 deg. Supports on both sides carry a parcel that
    leaves the line. The first column is at x = half a pitch, the first row at y = half a pitch.
    """

    rows: int  # rows of rotors
    columns: int  # of the zone
    lead_in: int  # columns before the zone
    run_out: int  # columns behind the zone
    beside: int  # rows of supports on each side
    pitch: float | tuple[float, float] = 0.1  # [m] between neighbours: one, or in x and in y
    mu_max: float = 0.5  # [-] friction along a rotor's axis
    mu_min: float = 0.01  # [-] friction across it
    mu_support: float = 0.005  # [-] friction of a support

    def __post_init__(self) -> None:
        count = (checks.integer, 1, checks.ELEMENTS)
        friction = (checks.not_negative, checks.FRICTION)
        checks.settle(
            self,
            **dict.fromkeys(("rows", "columns", "lead_in", "run_out", "beside"), count),
            pitch=checks.pitch,
            **dict.fromkeys(("mu_max", "mu_min", "mu_support"), friction),
        )
        checks.rolling(self.mu_max, self.mu_min)
        if math.prod(self.shape) > checks.ELEMENTS:
            raise ValueError(
                f"rows times columns must be at most {checks.ELEMENTS:_}, got {self.shape}"
            )

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of the whole surface."""
        return self.rows + 2 * self.beside, self.lead_in + self.columns + self.run_out

    @property
    def line_y(self) -> float:
        """The y coordinate [m] of the line's middle."""
        return 0.5 * self.pitch_y * self.shape[0]

    @property
    def zone_x(self) -> tuple[float, float]:
        """The x [m] of the zone's start and end, half a pitch beyond the first and last columns."""
        first = self.pitch_x * self.lead_in
        return first, first + self.pitch_x * self.columns

    @property
    def zone(self) -> tuple[slice, slice]:
        """Slices of the surface's rows and columns that form the zone."""
        return (
            slice(self.beside, self.beside + self.rows),
            slice(self.lead_in, self.lead_in + self.columns),
        )

    @cached_property
    def rotor(self) -> Booleans:
        """Mask (rows, columns) of the rotors; all other elements are supports."""
        rotor = np.zeros(self.shape, dtype=np.bool_)
        rotor[self.beside : self.beside + self.rows] = True
        return rotor

    def axes(self, zone_axis: Array) -> Array:
        """Return the axes (..., rows, columns) [rad] of the whole surface from the zone's axes."""
        axis = np.full((*zone_axis.shape[:-2], *self.shape), ROLLING)
        axis[(..., *self.zone)] = zone_axis
        return axis

    def surface(self, zone_axis: Array, tilt: float = 0.0) -> Surface:
        """Build the surface for `simulate` from zone axes (rows, columns) [rad] and a tilt."""
        axis = checks.array("zone_axis", zone_axis, (self.rows, self.columns))
        origin = (0.5 * self.pitch_x, 0.5 * self.pitch_y)
        return Surface(
            self.axes(axis), self.rotor, self.pitch, origin,
            self.mu_max, self.mu_min, self.mu_support, tilt,
        )  # fmt: skip

    def start(self, parcel: Parcel) -> tuple[float, float, float]:
        """Return the pose (x, y, theta) [m, m, rad] of a parcel whose rear is at x = 0."""
        return (parcel.rear, self.line_y - parcel.base.centroid[1], 0.0)


def line_for(
    parcel: Parcel, columns: int, rows: int | None = None, pitch: float | tuple[float, float] = 0.1,
    mu_max: float = 0.5, mu_min: float = 0.01, mu_support: float = 0.005,
) -> DesignLine:  # fmt: skip
    """Size a line for a parcel. For the study's two boxes, the result is the study's lines.

    `pitch` [m] is one number, or the pitches in x and y. `mu_max` and `mu_min` are the friction of
    rotors along and across their axes, `mu_support` is the friction of supports.

    The default number of rotor rows is the largest even number that fits under the parcel. The
    lead-in is as long as the parcel, so the parcel starts wholly on the lead-in.

    >>> from surface_gym import layouts
    >>> [(line.rows, line.lead_in) for line in (line_for(layouts.box(size), 8) for size in "SB")]
    [(2, 3), (4, 5)]
    """
    pitch = checks.pitch("pitch", pitch)
    pitch_x, pitch_y = pitch if isinstance(pitch, tuple) else (pitch, pitch)
    length, width = np.ptp(parcel.base.outline, axis=0).tolist()
    lead_in = lead_in_under(length, pitch_x)
    reach = 2.0 * parcel.base.reach
    return DesignLine(
        rows=rows_under(width, pitch_y) if rows is None else rows, columns=columns, lead_in=lead_in,
        run_out=lead_in + math.ceil(RUN_OUT / pitch_x), beside=math.ceil(reach / pitch_y) + 2,
        pitch=pitch, mu_max=mu_max, mu_min=mu_min, mu_support=mu_support,
    )  # fmt: skip


OnProgress = Callable[[int, int], None]  # called with the finished and the total work

STEP = 0.005  # [s] default time step of a run
LONGEST = 20.0  # [s] limit of a run
REST_SPEED = 1e-4  # [m/s] slower parcels may be at rest: rolling losses stop them within 1 ms
REST_CHANGE = 1e-3  # [m/s^2] a parcel with a smaller acceleration stays at rest

CHUNK = 32  # runs per task of a thread
MOST_STEPS = 128_000  # maximum steps in a chunk, so that Ctrl-C does not wait long
BUNDLE = 5000  # maximum runs per task of a node: some tenths of a second
LEAST_BUNDLE = 500  # fewer runs are not distributed

# Reasons for the end of a run: no rotor under the parcel, every rotor under it behind the zone, at
# rest, off the surface, out of time.
OUT, PAST, AT_REST, OFF, OUT_OF_TIME = range(5)

# Columns of `RunArrays.number` and of `RunArrays.end`.
LAYOUT, STIFFNESS, PARCEL, EXIT, STEPS = range(5)
REASON, TOUCHED, DONE, TIPPED = range(4)


@dataclass(frozen=True, eq=False)
class RunRequests:
    """Requested runs, one row per run; built by `make_runs`."""

    speed: Array  # (runs,) [m/s] along x at the start
    tilt: Array  # (runs,) [rad]
    layout: Integers  # (runs,) index of the layout
    stiffness: Integers  # (runs,) index of the stiffness map
    parcel: Integers  # (runs,) index of the parcel
    friction: Array  # (runs, 3) [-] factors of mu_max, mu_min and mu_support
    lateral: Array  # (runs,) [m] offset of the start in y
    heading: Array  # (runs,) [rad] of the start
    columns: Integers  # (runs,) columns of the zone, after which a run ends; -1: no end

    def __len__(self) -> int:
        return len(self.speed)


def make_runs(
    speed: ArrayLike, tilt: ArrayLike = 0.0, layout: ArrayLike = 0, stiffness: ArrayLike = 0,
    parcel: ArrayLike = 0, friction: ArrayLike = 1.0, lateral: ArrayLike = 0.0,
    heading: ArrayLike = 0.0, columns: ArrayLike = -1,
) -> RunRequests:  # fmt: skip
    """Build runs from arrays (runs,), or from numbers for all runs; `friction` may be (runs, 3)."""
    given = np.broadcast_arrays(speed, tilt, lateral, heading, layout, stiffness, parcel, columns)
    numbers = [np.array(values, dtype=np.float64).reshape(-1) for values in given[:4]]
    whole = [
        np.array(values, dtype=np.float64).reshape(-1).astype(np.int64) for values in given[4:]
    ]
    return RunRequests(
        speed=numbers[0], tilt=numbers[1], lateral=numbers[2], heading=numbers[3], layout=whole[0],
        stiffness=whole[1], parcel=whole[2], columns=whole[3],
        friction=np.broadcast_to(np.asarray(friction, dtype=np.float64), (len(numbers[0]), 3)),
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Ends:
    """Results of runs, one row per run."""

    line: DesignLine
    runs: RunRequests  # requested runs
    reason: Integers  # (runs,) OUT, PAST, ...
    touched: Integers  # (runs,) columns from the zone's first to the last under the parcel
    time: Array  # (runs,) [s] until the end
    pose: Array  # (runs, 3) [m, m, rad] of the base's frame at the end
    velocity: Array  # (runs, 3) [m/s, m/s, rad/s]
    tipping: Array  # (runs,) [-] share of the steps in which a real parcel would tip
    steps: Integers  # (runs,) number of steps
    load: Array  # (runs,) [kg] largest load of a rotor


def split_progress(on_progress: OnProgress, counts: Sequence[int]) -> list[OnProgress]:
    """Return a callback for each part of the work. Parts run one after the other.

    Part k has `counts[k]` runs. A callback reports how many runs of all parts have finished.
    """
    total = sum(counts)

    def part(before: int) -> OnProgress:
        return lambda done, _: on_progress(before + done, total)

    return [part(sum(counts[:k])) for k in range(len(counts))]


def run_all(
    line: DesignLine, layouts: Array, parcels: Sequence[Parcel], runs: RunRequests,
    stiffness: Array | None = None, dt: float = STEP, workers: Workers = 1,
    on_progress: OnProgress = lambda *_: None,
) -> Ends:  # fmt: skip
    """Simulate `runs`. A run has indices into the layouts, the parcels and the stiffness maps.

    Layouts (layouts, rows, columns) [rad] are the axes of the line's zone. Every parcel starts with
    its rear at x = 0. Stiffness (maps, rows, columns) [-] has one number per element of the whole
    surface. If `stiffness` is None, all elements are equally stiff. `dt` is the time step [s].
    `workers` is a number of threads, or a cluster. `on_progress` is called with the finished and
    the total number of runs.
    """
    for parcel in parcels:
        line.check_capacity(parcel.base, line.shape[::-1])
    surfaces = _make_surfaces(line, layouts, stiffness)
    bodies = make_bodies(parcels)
    arrays = _make_arrays(line, parcels, runs, dt)
    if isinstance(workers, Cluster):
        _run_on_nodes(surfaces, bodies, arrays, dt, workers, on_progress)
    else:
        threads = check_count("workers", workers)
        _run_in_threads(surfaces, bodies, arrays, dt, threads, on_progress)
    pose, velocity = arrays.state[:, :3].copy(), arrays.state[:, 3:6].copy()
    for k, parcel in enumerate(parcels):
        if parcel.centre_of_mass != (0.0, 0.0):
            own = runs.parcel == k
            pose[own], velocity[own] = base_motion(parcel, arrays.state[own])
    reason, touched, steps, tipped = arrays.end.T
    return Ends(
        line=line, runs=runs, reason=reason, touched=np.maximum(0, touched - line.lead_in + 1),
        time=dt * steps, pose=pose, velocity=velocity, tipping=tipped / np.maximum(1, steps),
        steps=steps,
        load=np.array([parcel.mass for parcel in parcels])[runs.parcel] * arrays.peak / ph.GRAVITY,
    )  # fmt: skip


class SurfaceSet(NamedTuple):
    """Surfaces that differ in axes and stiffness."""

    axis: Places  # (layouts, rows, columns) index of each rotor's axis in `direction`
    direction: Array  # (directions, 2) cosine and sine
    drive: Array  # (directions, 3) zeros: modules are idle
    rotor: Booleans  # (rows, columns)
    stiffness: Array  # (maps, rows, columns) [-]
    friction: Array  # (rows, columns, 3) [-] as `Grid.friction`
    x0: float  # [m] centre of element [0, 0]
    y0: float  # [m]
    pitch_x: float  # [m]
    pitch_y: float  # [m]


class RunArrays(NamedTuple):
    """Inputs and results of runs for compiled code, one row per run."""

    # (runs, 5) indices of layout, stiffness and parcel; first column behind the zone; most steps
    number: Integers
    conditions: Array  # (runs, 6) as `SurfaceState.conditions`
    state: Array  # (runs, STATE_SIZE) at the start, and in its place at the end
    # (runs, 4) reason of the end; last column with a rotor under it; steps taken, steps tipping
    end: Integers
    peak: Array  # (runs,) [m/s^2] largest force on a rotor, over the parcel's mass


@inlined
def _make_grid(surfaces: SurfaceSet, number: Integers, conditions: Array) -> Grid:
    """Return a run's surface as a `Grid` for the physics.

    `number` is a row of `RunArrays.number`. `conditions` is a row of `RunArrays.conditions`.
    """
    return Grid(
        surfaces.axis[number[LAYOUT]],
        surfaces.direction,
        surfaces.drive,
        surfaces.rotor,
        surfaces.stiffness[number[STIFFNESS]],
        surfaces.friction,
        surfaces.x0,
        surfaces.y0,
        surfaces.pitch_x,
        surfaces.pitch_y,
        conditions[st.ALONG_FACTOR],
        conditions[st.ACROSS_FACTOR],
        conditions[st.SUPPORT_FACTOR],
        conditions[st.GRAVITY_X],
        conditions[st.GRAVITY_Y],
        conditions[st.GRAVITY_NORMAL],
    )


@inlined
def _rotor_span(rotor: Booleans, scratch: Scratch) -> tuple[int, int]:
    """Return the first and last column with a rotor under the parcel, after the last time step.

    If no rotor is under the parcel, the returned first column is greater than the last.
    """
    marks = scratch.marks
    lowest = rotor.shape[1]
    highest = -1
    for k in range(marks[ph.SPANS]):
        row = marks[ph.SPAN_ROW + k]
        first = marks[ph.SPAN_FIRST + k]
        last = marks[ph.SPAN_LAST + k]
        while first <= last and not rotor[row, first]:
            first += 1
        while first <= last and not rotor[row, last]:
            last -= 1
        if first <= last:
            lowest = min(lowest, first)
            highest = max(highest, last)
    return lowest, highest


@compiled
def _run_range(
    surfaces: SurfaceSet,
    bodies: Bodies,
    runs: RunArrays,
    scratch: Scratch,
    dt: float,
    first: int,
    last: int,
) -> None:
    """Simulate the runs from `first` to `last` - 1, and write their results to `runs`."""
    for run in range(first, last):
        number = runs.number[run]
        state = runs.state[run]
        grid = _make_grid(surfaces, number, runs.conditions[run])
        body = read_body(bodies, number[PARCEL])
        radius = bodies.body[number[PARCEL], ph.RADIUS]
        invalidate_contacts(scratch)
        reason = OUT_OF_TIME
        touched = -1
        tipped = 0
        steps = 0
        peak = 0.0
        while steps < number[STEPS]:
            omega = state[ph.OMEGA]
            report, contacts = stepping.step_implicit(grid, body, state, scratch, dt)
            if report >= stepping.OFF_SURFACE:
                reason = OFF
                break
            steps += 1
            tipped += report == stepping.TIPPING
            for k in range(contacts.total):
                if scratch.marks[ph.KIND + k] != ph.SUPPORT:
                    peak = max(peak, scratch.table[ph.NORMAL + k])
            lowest, highest = _rotor_span(surfaces.rotor, scratch)
            if highest < 0:
                reason = OUT
                break
            touched = max(touched, highest)
            if lowest >= number[EXIT]:
                reason = PAST
                break
            speed = abs(state[ph.VX]) + abs(state[ph.VY]) + abs(state[ph.OMEGA]) * radius
            change = (
                abs(state[ph.AX]) + abs(state[ph.AY]) + abs(state[ph.OMEGA] - omega) * radius / dt
            )
            if speed < REST_SPEED and change < REST_CHANGE:
                reason = AT_REST
                break
        runs.end[run, REASON] = reason
        runs.end[run, TOUCHED] = touched
        runs.end[run, DONE] = steps
        runs.end[run, TIPPED] = tipped
        runs.peak[run] = peak


def _make_surfaces(line: DesignLine, layouts: Array, stiffness: Array | None) -> SurfaceSet:
    axes = line.axes(np.asarray(layouts, dtype=np.float64))
    angles, places = np.unique(axes, return_inverse=True)
    mu = np.array((line.mu_max, line.mu_min, line.mu_support))
    return SurfaceSet(
        axis=places.reshape(axes.shape).astype(np.int32),
        direction=stepping.axis_directions(angles), drive=np.zeros((len(angles), 3)),
        rotor=line.rotor.copy(),
        stiffness=np.ones((1, *line.shape)) if stiffness is None else stiffness.astype(float),
        friction=np.broadcast_to(mu, (*line.shape, 3)).copy(), x0=0.5 * line.pitch_x,
        y0=0.5 * line.pitch_y, pitch_x=line.pitch_x, pitch_y=line.pitch_y,
    )  # fmt: skip


def _make_arrays(
    line: DesignLine, parcels: Sequence[Parcel], runs: RunRequests, dt: float
) -> RunArrays:
    count = len(runs)
    number = np.empty((count, 5), dtype=np.int64)
    number[:, LAYOUT] = runs.layout
    number[:, STIFFNESS] = runs.stiffness
    number[:, PARCEL] = runs.parcel
    number[:, EXIT] = np.where(runs.columns < 0, line.shape[1], line.lead_in + runs.columns)
    number[:, STEPS] = round(LONGEST / dt)
    starts = np.array([line.start(parcel) for parcel in parcels])[runs.parcel]
    starts[:, 1] += runs.lateral
    starts[:, 2] += runs.heading
    centres = np.array([parcel.centre_of_mass for parcel in parcels])[runs.parcel]
    velocity = np.zeros((count, 3))
    velocity[:, 0] = runs.speed
    return RunArrays(
        number=number,
        conditions=np.column_stack([runs.friction, *stepping.split_gravity(runs.tilt)]),
        state=stepping.com_states(centres, starts, velocity),
        end=np.zeros((count, 4), dtype=np.int64),
        peak=np.zeros(count),
    )


def _run_in_threads(
    surfaces: SurfaceSet, bodies: Bodies, runs: RunArrays, dt: float, threads: int,
    on_progress: OnProgress,
) -> None:  # fmt: skip
    """Simulate runs by threads, in chunks of at most `CHUNK` runs and `MOST_STEPS` steps in all."""
    count = len(runs.state)
    chunk = max(1, min(CHUNK, MOST_STEPS // int(runs.number[:, STEPS].max(initial=1))))
    spare: SimpleQueue[Scratch] = SimpleQueue()
    for _ in range(threads):
        spare.put(ph.make_scratch())

    def work(first: int) -> int:
        scratch = spare.get()
        last = min(first + chunk, count)
        _run_range(surfaces, bodies, runs, scratch, dt, first, last)
        spare.put(scratch)
        return last

    pool = ThreadPoolExecutor(threads) if threads > 1 and count > CHUNK else None
    try:
        for done in (map if pool is None else pool.map)(work, range(0, count, chunk)):
            on_progress(done, count)
    finally:
        if pool is not None:
            pool.shutdown(cancel_futures=True)


def _run_on_nodes(
    surfaces: SurfaceSet, bodies: Bodies, runs: RunArrays, dt: float, cluster: Cluster,
    on_progress: OnProgress,
) -> None:  # fmt: skip
    count = len(runs.state)
    bundles = max(-(-count // BUNDLE), min(2, count // LEAST_BUNDLE), 1)
    # Neighbouring runs are similar, so a bundle takes every n-th run to balance durations.
    parts = [slice(first, None, bundles) for first in range(bundles)]
    given = [RunArrays._make(array[part] for array in runs) for part in parts]
    jobs = [
        partial(without_report, partial(_run_bundle, surfaces, bodies, part, dt)) for part in given
    ]
    done = 0
    for place, (state, end, peak) in map_jobs(jobs, cluster):
        runs.state[parts[place]] = state
        runs.end[parts[place]] = end
        runs.peak[parts[place]] = peak
        done += len(end)
        on_progress(done, count)


def _run_bundle(
    surfaces: SurfaceSet, bodies: Bodies, runs: RunArrays, dt: float
) -> tuple[Array, Integers, Array]:
    """Simulate runs on a node; return the arrays `state`, `end` and `peak` of `runs`."""
    _run_range(surfaces, bodies, runs, ph.make_scratch(), dt, 0, len(runs.state))
    return runs.state, runs.end, runs.peak
