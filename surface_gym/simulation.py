"""`simulate` and `simulate_together`: parcels on one surface, from start to end."""

import math
import threading
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from surface_gym import checks
from surface_gym.parcel import Parcel, make_bodies
from surface_gym.physics import references, rollout, step as stepping, types as ph
from surface_gym.physics.collision import ContactMaterial, World, WorldScratch, make_world_scratch
from surface_gym.physics.signed_distance import CONTACT_DISTANCE
from surface_gym.physics.types import Array, Body, Grid, Scratch
from surface_gym.surface import Surface
from surface_gym.trajectory import Run, Trajectory

METHODS = ("implicit", "explicit")
PIECE = 2000  # steps per call, so that Ctrl-C does not wait long
MAX_STEPS = 100_000_000  # maximum steps of a run, whose trajectory takes 15 GB
NORMAL_FORCES = ("dual", "osqp", "scipy")
# A run depends on tipping steps if they cause at least this share of all change of velocity, and at
# least this speed.
TIPPING_SHARE = 0.1
TIPPING_SPEED = 0.01  # [m/s]
ENDS = {
    stepping.OFF_SURFACE: "left the surface",
    stepping.UNSUPPORTED: "nothing bears it",
    stepping.STOPPED: "stopped",
}


class _Memory(threading.local):
    """Work memory of the physics, called a scratch. Each thread reuses one scratch for all runs."""

    def __init__(self) -> None:
        self._scratch = ph.make_scratch()

    @property
    def scratch(self) -> Scratch:
        """Return this thread's scratch, without contacts of earlier runs."""
        self._scratch.marks[ph.SPANS] = -1
        return self._scratch


_MEMORY = _Memory()


class TippingWarning(UserWarning):
    """Warning that a result depends on steps in which a real parcel would tip."""


@contextmanager
def expect_tipping() -> Iterator[None]:
    """Ignore every `TippingWarning` in a `with` block or a decorated function."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TippingWarning)
        yield


def simulate(
    surface: Surface,
    parcel: Parcel,
    pose: ArrayLike,
    velocity: ArrayLike = (0.0, 0.0, 0.0),
    duration: float = 1.0,
    dt: float = 0.005,
    method: Literal["implicit", "explicit"] = "implicit",
    normal_forces: Literal["dual", "osqp", "scipy"] = "dual",
) -> Trajectory:
    """Simulate a parcel on a surface with fixed axes.

    Args:
        pose: (x, y, theta) [m, m, rad] of the base's frame at the start.
        velocity: (vx, vy, omega) [m/s, m/s, rad/s] of the base's frame at the start.
        duration: [s] simulated time; the last step is shortened if necessary.
        dt: [s] step.
        method: "implicit" (a step solves a convex problem) or "explicit" (the loop of the paper's
            Figure 5). The loop has the paper's rules for stopping and reverse motion. The loop is
            valid only for motion towards +x.
        normal_forces: solver of Eq. (1): "dual", or the references "osqp" and "scipy".

    Returns:
        The trajectory. It ends early if the paper's rule stops the parcel, if the centre of mass
        passes the edge of the surface, or if no element is under the base.

    Raises:
        ValueError: an argument is not allowed, or a number is outside the limits of
            `surface_gym.checks`. Other causes are a start off the surface or over no element, and a
            step that moves a point of the parcel by more than a pitch. With the explicit method on
            a level surface without driven modules, motion not towards +x is also a cause.

    Warns:
        TippingWarning: at least a tenth of the change of velocity occurs in steps in which Eq. (1)
            has no solution (`Trajectory.tipping`).

    >>> import surface_gym as sg
    >>> parcel = sg.Parcel(sg.Rectangle(0.25, 0.25))
    >>> trajectory = sg.simulate(sg.layouts.sorting(), parcel, (0.125, 1.0, 0.0), (1.5, 0.0, 0.0))
    >>> trajectory.pose[-1].round(2)  # sorted to y < 0
    array([ 0.97,  0.49, -0.23])
    """
    checks.instance("surface", surface, Surface, "a Surface")
    checks.instance("parcel", parcel, Parcel, "a Parcel")
    start = start_state(
        parcel, checks.pose("pose", pose, (3,)), checks.velocity("velocity", velocity, (3,))
    )
    time, dt = _checked_times(duration, dt)
    checks.one_of("method", method, METHODS)
    checks.one_of("normal_forces", normal_forces, NORMAL_FORCES)
    if method == "explicit":
        _check_explicit(surface)
    grid, body = surface.grid, parcel.body
    scratch = _MEMORY.scratch
    wanted = _missing_support(surface, parcel, start, scratch)
    if wanted:
        raise ValueError(f"pose must be {wanted}, got {tuple(np.asarray(pose).tolist())}")
    if (
        method == "explicit"
        and surface.tilt == 0.0
        and not surface.driven.any()
        and start[ph.VX] <= 0.0
        and start[ph.VX :].any()
    ):
        raise ValueError(
            "velocity must be towards +x for the explicit method on a level surface, "
            f"got {tuple(np.asarray(velocity).tolist())}"
        )

    states = np.zeros((len(time), ph.STATE_SIZE))
    states[0] = start
    reports = np.zeros(len(time), dtype=np.int64)
    _run(grid, body, states, reports, scratch, time, dt, method, normal_forces)
    trajectory = make_trajectory(
        surface, parcel, time, dt, states, reports, (method, normal_forces)
    )
    _warn_of_tipping(body, states, trajectory.tipping)
    return trajectory


def _check_explicit(surface: Surface) -> None:
    """Raise a ValueError for a slope on which the explicit method (Figure 5b) is invalid."""
    if surface.tilt < 0.0:
        raise ValueError(f"tilt must be at least 0 for the explicit method, got {surface.tilt!r}")
    if surface.tilt_direction != 0.0:
        raise ValueError(
            "tilt_direction must be 0, towards +x, for the explicit method, "
            f"got {surface.tilt_direction!r}"
        )


def _warn_of_tipping(body: Body, states: Array, tipping: NDArray[np.bool_]) -> None:
    """Warn the caller of `simulate` if much of the change of velocity happens in tipping steps.

    The array `tipping` (T,) marks tipping steps, in which Eq. (1) has no solution. Each row of
    `states` is a state of the centre of mass.
    """
    if not tipping.any():
        return
    velocity = states[: len(tipping), ph.VX : ph.OMEGA + 1] * [1.0, 1.0, math.sqrt(body.gyration)]
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=1)
    tipped = change[tipping[1:]].sum()
    if tipped >= max(TIPPING_SPEED, TIPPING_SHARE * change.sum()):
        warnings.warn(
            f"the parcel would tip in {tipping.sum()} of {len(change)} steps, with "
            f"{tipped / change.sum():.0%} of all change of its velocity: Eq. (1) has no solution "
            "there, and the forces nearest to balance decide where it goes (Trajectory.tipping)",
            TippingWarning,
            stacklevel=3,
        )


def _missing_support(surface: Surface, parcel: Parcel, start: Array, scratch: Scratch) -> str:
    """Return "" if an element carries the parcel at `start`, else where the parcel must start."""
    surface.check_capacity(parcel.base, (surface.columns, surface.rows))
    if references.find_support(surface.grid, parcel.body, start, scratch, 0.0).total > 0:
        return ""
    over = references.explain_unsupported(surface.grid, start, 0.0) == stepping.UNSUPPORTED
    return "over an element" if over else "on the surface"


def check_steps(parcel: Parcel, pitch: float, states: Array, dt: float) -> None:
    """Raise a ValueError if a step moves a point of the parcel's base by more than a pitch [m].

    `states` (T, STATE_SIZE) hold the state at the start and after each step of `dt` [s].
    """
    pose = states[:, ph.X : ph.THETA + 1]
    moved = np.abs(pose[1:] - pose[:-1])
    farthest = np.hypot(moved[:, 0], moved[:, 1]) + moved[:, 2] * parcel.body.radius
    if not farthest.max(initial=0.0) <= pitch:  # also false for NaN
        raise ValueError(
            f"dt must be so short that no step moves the parcel past a pitch, {pitch:g} m, "
            f"got {dt!r}, which moved it by {farthest.max():g} m"
        )


def _checked_times(duration: float, dt: float) -> tuple[NDArray[np.float64], float]:
    """Return the times [s] at the start and after every step, and the length [s] of a step.

    `duration` and `dt` are in [s]. Raise a ValueError if they are not allowed. A last step shorter
    than 1e-6 dt is omitted.
    """
    duration = checks.positive("duration", duration, *checks.DURATION)
    dt = checks.positive("dt", dt, *checks.STEP)
    if duration / dt > MAX_STEPS:
        raise ValueError(f"dt must be at least duration / {MAX_STEPS:_}, got {dt!r}")
    whole = math.floor(duration / dt + 1e-6)
    time: Array = dt * np.arange(whole + 1, dtype=np.float64)
    return np.append(time, duration) if duration - time[-1] > 1e-6 * dt else time, dt


_STILL = np.zeros(ph.STATE_SIZE - ph.AX)  # acceleration of a parcel that begins to move


def start_state(parcel: Parcel, pose: Array, velocity: Array) -> Array:
    """Return the state (STATE_SIZE,) of the centre of mass for a pose and velocity of the base."""
    if parcel.centre_of_mass == (0.0, 0.0):
        return np.concatenate([pose, velocity, _STILL])
    centre = np.array([parcel.centre_of_mass])
    return stepping.com_states(centre, pose[np.newaxis], velocity[np.newaxis])[0]


def base_motion(parcel: Parcel, states: Array) -> tuple[Array, Array]:
    """Return pose and velocity (T, 3) of the base's frame. `states` describe the centre of mass."""
    pose, velocity = states[:, ph.X : ph.THETA + 1].copy(), states[:, ph.VX : ph.OMEGA + 1].copy()
    com_x, com_y = parcel.centre_of_mass
    if (com_x, com_y) != (0.0, 0.0):
        cosine, sine = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        arm_x, arm_y = cosine * com_x - sine * com_y, sine * com_x + cosine * com_y
        pose[:, 0] -= arm_x
        pose[:, 1] -= arm_y
        velocity[:, 0] += velocity[:, 2] * arm_y
        velocity[:, 1] -= velocity[:, 2] * arm_x
    return pose, velocity


def _run(
    grid: Grid, body: Body, states: Array, reports: NDArray[np.int64], scratch: Scratch,
    time: Array, dt: float, method: str, normal_forces: str,
) -> None:  # fmt: skip
    """Do the steps of a run. Fill `states` and `reports` from row 1 on.

    The report of a step says whether this step ends the run. `method` is "implicit" or "explicit".
    `normal_forces` names the solver of Eq. (1). The solver "dual" is compiled; all other solvers
    are references.
    """
    run = rollout.run_implicit if method == "implicit" else rollout.run_explicit
    piece = PIECE if normal_forces == "dual" else 1
    for first, last, step in _stretches(time, dt):
        for k in range(first, last + 1, piece):
            rows = slice(k - 1, min(k + piece, last + 1))
            if normal_forces == "dual":
                run(grid, body, states[rows], reports[rows], scratch, step)
            else:
                states[k] = states[k - 1]
                reports[k] = _reference_step(
                    grid, body, states[k], scratch, step, method, normal_forces
                )
            if reports[rows].max() >= stepping.OFF_SURFACE:
                return


def _reference_step(
    grid: Grid, body: Body, state: Array, scratch: Scratch, dt: float, method: str,
    normal_forces: str,
) -> int:  # fmt: skip
    """Return the report after one step by `method` and the reference solver `normal_forces`."""
    explicit = method == "explicit"
    stands = explicit and state[ph.VX] <= 0.0 and grid.gravity_x == 0.0
    if stands and not stepping.is_driven.py_func(grid):
        return stepping.STOPPED
    lead = 0.0 if explicit else 0.5 * dt
    contacts = references.find_support(grid, body, state, scratch, lead)
    count = contacts.total
    if count == 0:
        return int(references.explain_unsupported(grid, state, lead))
    degenerate = references.support_load_by(normal_forces, grid, body, state, scratch, count)
    advance = references.advance_explicit if explicit else references.advance_implicit
    advance(grid, body, state, scratch, contacts, dt)
    return stepping.TIPPING if degenerate else stepping.BALANCED


@dataclass(frozen=True, eq=False)
class Touches:
    """Touches of pairs of parcels. A row is a touch of two parcels in one step."""

    time: NDArray[np.float64]  # (touches,) [s] end of the step
    pair: NDArray[np.int64]  # (touches, 2) indices of the parcels, in ascending order
    impulse: NDArray[np.float64]  # (touches,) [N s] separating impulse in the step


@dataclass(frozen=True, eq=False)
class Encounter:
    """Result of a simulation of several parcels on one surface."""

    trajectories: tuple[Trajectory, ...]  # one per parcel
    touches: Touches


def simulate_together(
    surface: Surface,
    parcels: Sequence[Parcel],
    poses: ArrayLike,
    velocities: ArrayLike | None = None,
    duration: float = 1.0,
    dt: float = 0.005,
    restitution: float = 0.0,
    side_friction: float = 0.3,
) -> Encounter:
    """Simulate several parcels with collisions on a surface with fixed axes.

    Forces between parcels act at the height of the centre of mass, so they tip no parcel. A parcel
    that touches no other parcel moves exactly as in `simulate` with the implicit method.

    Args:
        poses: (parcels, 3) [m, m, rad] x, y, theta of the bases' frames at the start.
        velocities: (parcels, 3) [m/s, m/s, rad/s] of the bases' frames at the start, 0 by default.
        duration: [s] simulated time; the last step is shortened if necessary.
        dt: [s] step.
        restitution: [-] speed at which parcels separate, divided by the speed at which they meet.
        side_friction: [-] friction coefficient between the sides of two parcels.

    Returns:
        The trajectories and the touches. A trajectory ends early if the parcel's centre of mass
        passes the edge of the surface, or if no element is under the parcel's base. The other
        parcels' trajectories continue.

    Raises:
        ValueError: an argument is not allowed, or a number is outside the limits of
            `surface_gym.checks`. A parcel is not on the surface at the start, is over no element,
            or overlaps another parcel. A step moves a point of a parcel by more than a pitch.

    >>> import surface_gym as sg
    >>> box = sg.layouts.box("S")
    >>> surface = sg.layouts.line([[sg.layouts.ROLLING]])
    >>> encounter = sg.simulate_together(
    ...     surface,
    ...     [box, box],
    ...     poses=[(0.5, 1.0, 0.0), (1.0, 1.0, 0.0)],
    ...     velocities=[(1.0, 0.0, 0.0), (0.0, 0.0, 0.0)],
    ... )
    >>> encounter.touches.time[0].round(2)  # after 0.25 m
    np.float64(0.26)
    >>> ends = [trajectory.pose[-1, 0] for trajectory in encounter.trajectories]
    >>> round(ends[1] - ends[0], 3)  # they go on side by side
    np.float64(0.25)
    """
    world = _make_world(surface, parcels, poses, velocities)
    time, dt = _checked_times(duration, dt)
    touching = ContactMaterial(
        checks.within("restitution", restitution, 0.0, 1.0),
        checks.not_negative("side_friction", side_friction, checks.FRICTION),
    )
    _check_starts(surface, parcels, poses, world)
    records = _run_together(surface.grid, world, touching, time, dt)
    trajectories = tuple(
        make_trajectory(surface, parcel, time, dt, records.state[:, k], records.report[:, k])
        for k, parcel in enumerate(parcels)
    )
    touches = Touches(time[records.step], records.pair, records.impulse)
    return Encounter(trajectories, touches)


def _make_world(
    surface: Surface, parcels: Sequence[Parcel], poses: ArrayLike, velocities: ArrayLike | None
) -> World:
    """Return the parcels' state at the start. Parcels may be off the surface, or overlap.

    `poses` and `velocities` are (parcels, 3). If velocities are None, all parcels are at rest.
    """
    checks.instance("surface", surface, Surface, "a Surface")
    if not isinstance(parcels, Sequence) or not all(isinstance(each, Parcel) for each in parcels):
        raise ValueError(f"parcels must be a sequence of Parcel, got {parcels!r}")
    if len(parcels) == 0:
        raise ValueError("parcels must be at least one, got none")
    count = len(parcels)
    pose = checks.pose("poses", poses, (count, 3))
    given = np.zeros((count, 3)) if velocities is None else velocities
    velocity = checks.velocity("velocities", given, (count, 3))
    bodies = make_bodies(parcels)
    state = np.stack([start_state(*each) for each in zip(parcels, pose, velocity, strict=True)])
    return World(state, np.ones(count, dtype=np.bool_), np.arange(count), bodies)


def _check_starts(
    surface: Surface, parcels: Sequence[Parcel], poses: ArrayLike, world: World
) -> None:
    """Raise a ValueError if a parcel has no support at the start, or overlaps another parcel."""
    scratch = ph.make_scratch()
    for k, parcel in enumerate(parcels):
        wanted = _missing_support(surface, parcel, world.state[k], scratch)
        if wanted:
            pose = tuple(np.asarray(poses)[k].tolist())
            raise ValueError(f"poses must be {wanted}, got {pose} of parcel {k}")
        for other in range(k):
            width = rollout.distance_between(world, other, k)
            if width < -CONTACT_DISTANCE:
                raise ValueError(
                    f"poses must leave parcels apart, got {other} and {k} that overlap by "
                    f"{-width:g} m"
                )


def _run_together(
    grid: Grid, world: World, touching: ContactMaterial, time: Array, dt: float
) -> rollout.Records:
    """Do all steps, and return records of states and touches. Step k ends at `time[k]` [s]."""
    count = len(world.present)
    scratch = make_world_scratch(count)
    room = 1024 + 2 * len(scratch.pair)
    records = rollout.Records(
        np.zeros((len(time), count, ph.STATE_SIZE)), np.zeros((len(time), count), dtype=np.int64),
        np.zeros(room, dtype=np.int64), np.zeros((room, 2), dtype=np.int64), np.zeros(room),
    )  # fmt: skip
    records.state[0] = world.state
    touches = 0
    for first, last, step in _stretches(time, dt):
        records, touches = run_stretch(
            grid, world, touching, scratch, records, first, last, touches, step
        )
    return records._replace(
        step=records.step[:touches], pair=records.pair[:touches], impulse=records.impulse[:touches]
    )


def run_stretch(
    grid: Grid, world: World, touching: ContactMaterial, scratch: WorldScratch,
    records: rollout.Records, first: int, last: int, touches: int, dt: float,
) -> tuple[rollout.Records, int]:  # fmt: skip
    """Do the steps from `first` to `last`. Return the records and the number of recorded touches.

    `touches` is the number of touches that were recorded before these steps.
    """
    most = max(1, PIECE // len(world.present))
    following = first
    while following <= last:
        end = min(last, following + most - 1)
        following, touches = rollout.run_world(
            grid, world, touching, scratch, records, following, end, touches, dt
        )
        if following <= end:
            records = records._replace(
                step=np.concatenate([records.step, np.zeros_like(records.step)]),
                pair=np.concatenate([records.pair, np.zeros_like(records.pair)]),
                impulse=np.concatenate([records.impulse, np.zeros_like(records.impulse)]),
            )
    return records, touches


def _stretches(time: Array, dt: float) -> list[tuple[int, int, float]]:
    """Return stretches of equal steps, as tuples (first step, last step, step length [s])."""
    last = len(time) - 1
    if time[-1] == dt * last:
        return [(1, last, dt)]
    return [(1, last - 1, dt), (last, last, float(time[-1] - time[-2]))]


def make_trajectory(
    surface: Surface, parcel: Parcel, time: Array, dt: float, states: Array,
    reports: NDArray[np.int64], solved: tuple[str, str] | None = None,
) -> Trajectory:  # fmt: skip
    """Return a parcel's trajectory from the states and reports of its steps.

    The trajectory stops before the first step whose report ends the run.

    Args:
        solved: names of the integration method and of the solver of normal forces. If `solved` is
            None, the run is not repeatable.
    """
    count, end = len(time), "duration"
    if reports.max() >= stepping.OFF_SURFACE:
        count = int((reports >= stepping.OFF_SURFACE).argmax())
        end = ENDS[int(reports[count])]
    done = slice(0, count)
    check_steps(parcel, min(surface.pitch_x, surface.pitch_y), states[done], dt)
    pose, velocity = base_motion(parcel, states[done])
    run = None if solved is None else Run(surface, parcel, dt, *solved, states[done])
    return Trajectory(time[done], pose, velocity, reports[done] == stepping.TIPPING, end, run)
