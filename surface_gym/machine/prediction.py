"""Predictions of logged runs by the package's physics, for many surfaces in one compiled call.
A run's window is the rows and columns that its parcel may reach. Only axes in the window turn.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from surface_gym.actions import angle_after
from surface_gym.compiler.jit import compiled, inlined
from surface_gym.layouts import ROLLING
from surface_gym.machine.log import LoggedRun, LoggedSurface
from surface_gym.parcel import filled_up
from surface_gym.physics import types as ph
from surface_gym.physics.contacts import bounded, find_contacts, invalidate_contacts
from surface_gym.physics.step import OFF_SURFACE, axis_direction, find_support, step_implicit
from surface_gym.physics.types import Array, Body, Booleans, Grid, Integers, Scratch, make_scratch
from surface_gym.state import Geometry

# Columns of a prediction's values: the surface and the load, then the parcel at its first picture.
(
    MU_MAX,  # [-] friction along an axis
    MU_MIN,  # [-] across it
    MU_SUPPORT,  # [-] of a support
    TILT,  # [rad] downhill towards +x
    QUARTER_TURN,  # [s] time in which an axis turns by 90 deg
    DEAD_TIME,  # [s] from a command to the start of the turn
    LATENCY,  # [s] from the exposure of a picture to its stated time
    COM_X,  # [m] centre of mass from the base's centroid, in the base's frame
    COM_Y,  # [m]
    ENTRY,  # first of x, y, theta, vx, vy, omega of the base's centroid
) = range(10)
VALUES = ENTRY + 6
MARGIN = 0.3  # [m] around the pictures' path, within which axes turn in predictions
SOON = 1e-9  # [s] shortest time between the ends of steps
SAME_LOAD = 1e-3  # [m/s^2] change of acceleration by which loads stay as they are
MOST_INT = 2**63 - 1
HALVINGS = 10  # of a step, to find when contacts change


class PackedRuns(NamedTuple):
    """Logged runs, joined into common arrays. Times are [s] since the first picture of a run."""

    first_frame: Integers  # (runs + 1,)
    time: Array  # (frames,) [s]
    first_command: Integers  # (runs + 1,)
    sent: Array  # (commands,) [s]
    target: Array  # (commands, rows, columns) [rad]
    rotor: Booleans  # (runs, rows, columns)
    edges: Array  # (runs, edges, 3)
    body: Array  # (runs, 7) as in `Bodies.body`
    # (runs, 4) first row, last, first column and last of the elements that the parcel may reach
    window: Integers


class PredictedAxes(NamedTuple):
    """Axes of a surface during a prediction."""

    came: Array  # (rows, columns) [rad] where each was at the latest command
    target: Array  # (rows, columns) [rad]
    direction: Array  # (rows * columns, 2) cosine and sine


class Memory(NamedTuple):
    """Arrays that predictions on one surface reuse."""

    geometry: Geometry
    axes: PredictedAxes
    axis: ph.Places  # (rows, columns) index of each axis in `direction`
    drive: Array  # (rows * columns, 3) zeros, since modules are idle
    ones: Array  # (rows, columns)
    friction: Array  # (rows, columns, 3) ones; predictions multiply them
    state: Array  # (STATE_SIZE,)
    before: Array  # (STATE_SIZE,) at the start of a step
    scratch: Scratch


def _window(surface: LoggedSurface, run: LoggedRun) -> tuple[int, ...]:
    """Return the window of a run: first row, last row, first column and last column."""
    reach = run.parcel.base.reach + MARGIN
    found: list[int] = []
    for axis, count in ((1, surface.rows), (0, surface.columns)):
        ends = np.array([run.poses[:, axis].min() - reach, run.poses[:, axis].max() + reach])
        places = (ends - surface.origin[axis]) / surface.pitch[axis]
        found += np.clip([math.floor(places[0]), math.ceil(places[1])], 0, count - 1).tolist()
    return tuple(found)


def pack_runs(surface: LoggedSurface, runs: Sequence[LoggedRun]) -> PackedRuns:
    """Convert logged runs to arrays for `predict_runs`."""
    sides = max(4, *(len(run.parcel.body.edges) for run in runs))
    edges = [filled_up(run.parcel.body.edges, run.parcel.corners, sides)[0] for run in runs]
    return PackedRuns(
        first_frame=np.cumsum([0, *(len(run.taken) for run in runs)]),
        time=np.concatenate([run.taken - run.taken[0] for run in runs]),
        first_command=np.cumsum([0, *(len(run.sent) for run in runs)]),
        sent=np.concatenate([run.sent - run.taken[0] for run in runs]),
        target=np.concatenate([run.axes for run in runs]),
        rotor=np.stack([run.rotor for run in runs]),
        edges=np.stack(edges),
        body=np.stack([run.parcel.row for run in runs]),
        window=np.array([_window(surface, run) for run in runs]),
    )


def make_memory(surface: LoggedSurface) -> Memory:
    """Allocate the arrays for predictions on a surface."""
    shape = (surface.rows, surface.columns)
    axis = np.arange(surface.rows * surface.columns, dtype=np.int32).reshape(shape)
    return Memory(
        geometry=Geometry(*surface.origin, *surface.pitch, 0.0),
        axes=PredictedAxes(np.empty(shape), np.empty(shape), np.empty((axis.size, 2))),
        axis=axis,
        drive=np.zeros((axis.size, 3)),
        ones=np.ones(shape),
        friction=np.ones((*shape, 3)),
        state=np.zeros(ph.STATE_SIZE),
        before=np.zeros(ph.STATE_SIZE),
        scratch=make_scratch(),
    )


@inlined
def _point(axes: PredictedAxes, row: int, column: int, turned: float) -> None:
    """Write an axis's direction after a turn of `turned` [rad]. The axis stops at its target."""
    k = row * axes.came.shape[1] + column
    cosine, sine = axis_direction(
        angle_after(axes.came[row, column], axes.target[row, column], turned)
    )
    axes.direction[k, 0] = cosine
    axes.direction[k, 1] = sine


@inlined
def _point_all(axes: PredictedAxes, window: Integers, turned: float) -> None:
    """Write the directions of all axes in the window after a turn of `turned` [rad]."""
    for row in range(window[0], window[1] + 1):
        for column in range(window[2], window[3] + 1):
            _point(axes, row, column, turned)


@inlined
def _point_near(
    axes: PredictedAxes,
    window: Integers,
    geometry: Geometry,
    state: Array,
    reach: float,
    turned: float,
) -> None:
    """Write the directions that axes near the parcel have after turning by `turned` [rad].

    Axes near the parcel are in the window, and at most `reach` [m] away from the parcel's centre of
    mass along x and along y.
    """
    low = bounded((state[ph.Y] - reach - geometry.y0) / geometry.pitch_y, 0.0, 1e6)
    high = bounded((state[ph.Y] + reach - geometry.y0) / geometry.pitch_y, 0.0, 1e6)
    left = bounded((state[ph.X] - reach - geometry.x0) / geometry.pitch_x, 0.0, 1e6)
    right = bounded((state[ph.X] + reach - geometry.x0) / geometry.pitch_x, 0.0, 1e6)
    for row in range(max(window[0], int(low)), min(window[1], int(high) + 1) + 1):
        for column in range(max(window[2], int(left)), min(window[3], int(right) + 1) + 1):
            _point(axes, row, column, turned)


@inlined
def _place(state: Array, values: Array) -> None:
    """Write the motion of the centre of mass to `state`. `values` has the centroid's motion."""
    cosine, sine = math.cos(values[ENTRY + 2]), math.sin(values[ENTRY + 2])
    arm_x = cosine * values[COM_X] - sine * values[COM_Y]
    arm_y = sine * values[COM_X] + cosine * values[COM_Y]
    spin = values[ENTRY + 5]
    state[ph.X] = values[ENTRY] + arm_x
    state[ph.Y] = values[ENTRY + 1] + arm_y
    state[ph.THETA] = values[ENTRY + 2]
    state[ph.VX] = values[ENTRY + 3] - spin * arm_y
    state[ph.VY] = values[ENTRY + 4] + spin * arm_x
    state[ph.OMEGA] = spin
    state[ph.AX] = 0.0
    state[ph.AY] = 0.0


@inlined
def _write_pose(pose: Array, state: Array, values: Array) -> None:
    """Write the centroid's pose (3,) to `pose`. The array `state` describes the centre of mass."""
    cosine, sine = math.cos(state[ph.THETA]), math.sin(state[ph.THETA])
    pose[0] = state[ph.X] - cosine * values[COM_X] + sine * values[COM_Y]
    pose[1] = state[ph.Y] - sine * values[COM_X] - cosine * values[COM_Y]
    pose[2] = state[ph.THETA]


@inlined
def _make_grid(memory: Memory, rotor: Booleans, values: Array) -> Grid:
    geometry = memory.geometry
    return Grid(
        memory.axis, memory.axes.direction, memory.drive, rotor, memory.ones, memory.friction,
        geometry.x0, geometry.y0, geometry.pitch_x, geometry.pitch_y,
        values[MU_MAX], values[MU_MIN], values[MU_SUPPORT],
        ph.GRAVITY * math.sin(values[TILT]), 0.0, ph.GRAVITY * math.cos(values[TILT]),
    )  # fmt: skip


@inlined
def _contact_set(scratch: Scratch) -> int:
    """Return a hash of the set of elements under the parcel. The hash is at least 0."""
    marks, found = scratch.marks, 0
    for k in range(marks[ph.SPANS]):
        found = 31 * found + marks[ph.SPAN_ROW + k]
        found = 31 * found + marks[ph.SPAN_FIRST + k]
        found = 31 * found + marks[ph.SPAN_LAST + k]
    return found & MOST_INT


@inlined
def _turn(memory: Memory, window: Integers, state: Array, reach: float, turned: float) -> bool:
    """Write the axes' directions after a turn of `turned` [rad]; return whether axes still turn.

    While axes turn, only directions of axes within `reach` [m] of the parcel are written. When all
    axes have stopped, the directions of all axes in the window are written.
    """
    if turned < 0.5 * math.pi:
        _point_near(memory.axes, window, memory.geometry, state, reach, turned)
    else:
        _point_all(memory.axes, window, turned)
    invalidate_contacts(memory.scratch)
    return turned < 0.5 * math.pi


@inlined
def _step(
    grid: Grid, body: Body, memory: Memory, window: Integers, reach: float, length: float,
    speed: float, turned: float,
) -> tuple[bool, int]:  # fmt: skip
    """Move the parcel by one step of `length` [s]. For the other arguments see `_advance`.

    If the acceleration changes, the step is repeated with the loads for the new acceleration.

    Returns:
        Whether axes still turn, and the hash of contacts after the step. The hash is -1 if the
        parcel is off the surface.
    """
    state, before, scratch = memory.state, memory.before, memory.scratch
    goes_on = speed > 0.0
    if goes_on:  # the direction in the middle of the step
        goes_on = _turn(memory, window, state, reach, turned + 0.5 * speed * length)
    for j in range(ph.STATE_SIZE):
        before[j] = state[j]
    report, _ = step_implicit(grid, body, state, scratch, length)
    if report >= OFF_SURFACE:
        return goes_on, -1
    if abs(state[ph.AX] - before[ph.AX]) + abs(state[ph.AY] - before[ph.AY]) > SAME_LOAD:
        for j in range(ph.AX):
            state[j] = before[j]
        step_implicit(grid, body, state, scratch, length)
    find_support(grid, body, state, scratch, 0.0)
    return goes_on, _contact_set(scratch)


@inlined
def _time_of_change(grid: Grid, body: Body, memory: Memory, length: float, held: int) -> float:
    """Return the time [s] from the start of the last step to the change of contacts.

    `length` [s] is the step's duration. `held` is the hash of the contacts before the change.
    """
    state, before = memory.state, memory.before
    earliest, latest = 0.0, length
    for _ in range(HALVINGS):
        time = 0.5 * (earliest + latest)
        late = 0.5 * time * time / length  # the step's acceleration is constant
        x = before[ph.X] + time * before[ph.VX] + late * (state[ph.VX] - before[ph.VX])
        y = before[ph.Y] + time * before[ph.VY] + late * (state[ph.VY] - before[ph.VY])
        turn = time * before[ph.OMEGA] + late * (state[ph.OMEGA] - before[ph.OMEGA])
        find_contacts(grid, body, x, y, before[ph.THETA] + turn, memory.scratch)
        if _contact_set(memory.scratch) == held:
            earliest = time
        else:
            latest = time
    return latest


@inlined
def _advance(
    grid: Grid, body: Body, memory: Memory, window: Integers, reach: float, seconds: float,
    dt: float, speed: float, turned: float,
) -> None:  # fmt: skip
    """Move the parcel in `memory` for `seconds` [s], by steps of at most `dt` [s].

    If contacts change in a step, the step is repeated and ends at the change. So predictions are
    continuous functions of the parameters.

    Args:
        reach: [m] distance from the parcel within which turning axes are updated.
        speed: [rad/s] speed of turning axes. If `speed` is 0, no axis turns.
        turned: [rad] angle by which the axes have turned since the latest command.
    """
    left = seconds
    longest = seconds / math.ceil(seconds / dt - 1e-6)
    find_support(grid, body, memory.state, memory.scratch, 0.0)
    held = _contact_set(memory.scratch)
    while left > 1e-12:
        length = min(longest, left)
        now_turned = turned + speed * (seconds - left)
        goes_on, now = _step(grid, body, memory, window, reach, length, speed, now_turned)
        if now >= 0 and now != held:
            change = _time_of_change(grid, body, memory, length, held)
            if change < length:
                length = change
                for j in range(ph.STATE_SIZE):
                    memory.state[j] = memory.before[j]
                goes_on, now = _step(grid, body, memory, window, reach, length, speed, now_turned)
        if now < 0:
            break
        speed = speed if goes_on else 0.0
        left -= length
        held = now


@inlined
def _predict_run(
    runs: PackedRuns, r: int, values: Array, memory: Memory, poses: Array, dt: float
) -> None:
    """Predict the poses (frames, 3) of run `r` at the times of its pictures.

    A parcel that leaves the surface keeps its last pose. `values` (VALUES,) holds the parameters,
    and the parcel's pose and velocity at the first picture. `dt` [s] is the maximum time step.
    """
    row, axes, state, window = runs.body[r], memory.axes, memory.state, runs.window[r]
    grid = _make_grid(memory, runs.rotor[r], values)
    body = Body(
        runs.edges[r], row[ph.RADIUS], values[COM_X], values[COM_Y], row[ph.COM_HEIGHT],
        row[ph.GYRATION],
    )  # fmt: skip
    reach = row[ph.RADIUS] + abs(values[COM_X]) + abs(values[COM_Y])
    speed = 0.5 * math.pi / values[QUARTER_TURN]
    axes.came[:] = ROLLING
    axes.target[:] = ROLLING
    _point_all(axes, window, 0.0)
    invalidate_contacts(memory.scratch)
    _place(state, values)
    _write_pose(poses[0], state, values)
    next_command, last_command = runs.first_command[r], runs.first_command[r + 1]
    since, settled, clock, frame = -math.inf, True, 0.0, 1
    while frame < poses.shape[0]:
        until = runs.time[runs.first_frame[r] + frame]
        begins = math.inf
        if next_command < last_command:
            begins = runs.sent[next_command] + values[LATENCY] + values[DEAD_TIME]
        end = min(until, begins)
        for part in range(1, 3):  # a turn of 45 deg ends, or of 90 deg
            ends = since + 0.5 * part * values[QUARTER_TURN]
            if ends > clock + SOON:
                end = min(end, ends)
                break
        if end > clock:
            turned = 0.0 if settled else min(math.pi, speed * (clock - since))
            rate = 0.0 if settled else speed
            _advance(grid, body, memory, window, reach, end - clock, dt, rate, turned)
            settled |= turned >= 0.5 * math.pi  # all axes have been set to their targets
            clock = end
        if end < min(until, begins):
            continue
        if begins <= until:
            turned = min(math.pi, speed * (begins - since))
            for i in range(window[0], window[1] + 1):
                for j in range(window[2], window[3] + 1):
                    axes.came[i, j] = angle_after(axes.came[i, j], axes.target[i, j], turned)
                    axes.target[i, j] = runs.target[next_command, i, j]
            since, settled = begins, False
            next_command += 1
        else:
            _write_pose(poses[frame], state, values)
            frame += 1


@compiled
def predict_runs(
    runs: PackedRuns, which: Integers, values: Array, first: Integers, memory: Memory, poses: Array,
    dt: float,
) -> None:  # fmt: skip
    """Predict the poses in the pictures of logged runs.

    Args:
        which: (predictions,) index of the run that is predicted.
        values: (predictions, VALUES) the surface's parameters, and the parcel's pose and velocity
            at the first picture.
        first: (predictions + 1,) index of each prediction's first row in `poses`. The last entry is
            the number of rows.
        memory: from `make_memory`.
        poses: (rows, 3) output: poses of the base's centroid.
        dt: [s] maximum time step. A step also ends at each command and at each picture.
    """
    for k in range(which.shape[0]):
        _predict_run(runs, which[k], values[k], memory, poses[first[k] : first[k + 1]], dt)
