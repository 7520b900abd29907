"""Results of simulations: motion, contacts, friction forces and energy, and their files."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks, files
from surface_gym.parcel import Base, Disc, Parcel, Polygon, Rectangle
from surface_gym.physics import rollout, types as ph
from surface_gym.physics.references import find_support, support_load_by
from surface_gym.physics.types import Array, Integers, Scratch
from surface_gym.surface import Surface

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from surface_gym.recording import Recording


@dataclass(frozen=True, eq=False)
class Run:
    """The inputs and states of a simulation, from which every step can be repeated."""

    surface: Surface
    parcel: Parcel
    dt: float  # [s] length of a step; the last may be shorter
    method: str  # "implicit" or "explicit"
    normal_forces: str  # solver of Eq. (1): "dual", "osqp" or "scipy"
    # (T, 8) the centre of mass's x, y [m], theta [rad], vx, vy [m/s], omega [rad/s], and the
    # acceleration ax, ay [m/s^2] of the step that led here
    states: Array

    def lengths(self, time: Array) -> Array:
        """Compute the length (T,) [s] of the step that ends at each row. The first row gets 0."""
        length = np.full(len(time), self.dt)
        if time[-1] != self.dt * (len(time) - 1):
            length[-1] = time[-1] - time[-2]
        length[0] = 0.0
        return length

    def leads(self, time: Array) -> Array:
        """Return how long [s] (T,) after the start of each step the contacts are computed."""
        return (0.5 if self.method == "implicit" else 0.0) * self.lengths(time)


@dataclass(frozen=True, eq=False)
class ContactRecord:
    """Contacts of a run, one row per contact and step. Rows are in the order of steps and elements.

    Friction is the force on the parcel. For a rotor, "along" is the direction (cos, sin) of
    `Surface.axis`, and "across" is 90 deg anti-clockwise from "along". For a support or a driven
    module, "along" is x and "across" is y. An implicit step computes friction at the velocity after
    the step. An explicit step computes friction at the velocity before the step.

    If a parcel stands, the explicit method scales the forces along the axes by a rule of the paper.
    The record holds the scaled forces. If friction across the axes and on supports exceeds gravity
    along x, the rule keeps the parcel at rest, but the recorded forces do not balance along x.
    """

    step: NDArray[np.int64]  # (rows,) step of the contact: the row of the trajectory after it
    time: NDArray[np.float64]  # (rows,) [s] end of the step
    element: NDArray[np.int64]  # (rows, 2) row and column in the surface's grid
    place: NDArray[np.float64]  # (rows, 2) [m] the element's centre, x and y
    rotor: NDArray[np.bool_]  # (rows,) whether it is a rotor, else a support
    normal: NDArray[np.float64]  # (rows,) [N]
    along: NDArray[np.float64]  # (rows,) [N] friction along the rotor's axis; x for a support
    across: NDArray[np.float64]  # (rows,) [N] friction across the axis; y for a support
    force: NDArray[np.float64]  # (rows, 2) [N] the same friction in x and y
    # (rows, 2) [m/s] velocity of the base over the element's surface after the step, along and
    # across
    slip: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.step)

    def of_step(self, step: int) -> "ContactRecord":
        """Return the contacts of a step. Step k leads to row k of the trajectory."""
        checks.integer("step", step, least=1)
        first, end = np.searchsorted(self.step, (step, step + 1)).tolist()
        if first == end:
            known = f"between {self.step[0]} and {self.step[-1]}" if len(self) else "in the record"
            raise ValueError(f"step must be {known}, got {step!r}")
        return ContactRecord(*(getattr(self, field.name)[first:end] for field in fields(self)))


@dataclass(frozen=True, eq=False)
class Energy:
    """Energy of a parcel after each step. Dissipation and motors' work are sums since the start.

    The power of friction in a step uses the mean of the velocities before and after the step.
    """

    kinetic: NDArray[np.float64]  # (T,) [J] of translation and rotation
    potential: NDArray[np.float64]  # (T,) [J] on the tilted surface, relative to the start
    along: NDArray[np.float64]  # (T,) [J] cumulated dissipation by rotors along their axes
    across: NDArray[np.float64]  # (T,) [J] cumulated dissipation by rotors across their axes
    supports: NDArray[np.float64]  # (T,) [J] cumulated dissipation by supports
    driven: NDArray[np.float64]  # (T,) [J] cumulated dissipation over driven modules
    drives: NDArray[np.float64]  # (T,) [J] cumulated work of the driven modules' motors

    @property
    def dissipated(self) -> NDArray[np.float64]:
        """Sum (T,) [J] of all dissipation by friction since the start."""
        return self.along + self.across + self.supports + self.driven

    @property
    def balance(self) -> NDArray[np.float64]:
        """Energy (T,) [J] gained by integration errors since the start. Exact motion gains none.

        An implicit step gains only the solver's error, near round-off. An explicit step gains an
        error that vanishes with the step length. If the parcel stands, an explicit step also gains
        the work of the paper's rules for a standing parcel.
        """
        gained = self.kinetic - self.kinetic[0] + self.potential
        return gained + self.dissipated - self.drives


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Motion of a parcel. Row 0 is the start, and each step adds a row.

    Contacts, acceleration and energy are computed on request by repeating the steps. Only a
    trajectory from `surface_gym.simulate` has the `run` that is needed to repeat the steps.

    >>> import surface_gym as sg
    >>> box = sg.Parcel(sg.Rectangle(0.25, 0.25), mass=10.0)
    >>> run = sg.simulate(sg.layouts.sorting(), box, (0.125, 1.0, 0.0), (1.5, 0.0, 0.0))
    >>> contacts = run.contacts.of_step(10)
    >>> contacts.element.tolist()  # row and column of the elements under the box
    [[9, 1], [9, 2], [10, 1], [10, 2]]
    >>> float(contacts.normal.sum().round(3))  # [N] m g
    98.1
    >>> float(run.energy.dissipated[-1].round(1))  # [J] by friction
    6.9
    """

    time: NDArray[np.float64]  # (T,) [s]
    pose: NDArray[np.float64]  # (T, 3) [m, m, rad] x, y, theta of the base's frame
    velocity: NDArray[np.float64]  # (T, 3) [m/s, m/s, rad/s] of the base's frame
    # (T,) whether the step before the row has no exact normal forces: fewer than three contacts,
    # collinear contacts, or a load point outside their hull. A real parcel tips there. The
    # simulation uses the forces closest to balance, and gives a `TippingWarning`.
    tipping: NDArray[np.bool_]
    # "duration"; "left the surface"; "nothing bears it": no element below; "stopped": by the
    # paper's rule, explicit method only
    end: str
    # inputs and states for repeating the steps; None if not made by `surface_gym.simulate`
    run: Run | None = None

    @cached_property
    def contacts(self) -> ContactRecord:
        """Contacts and friction forces of each step."""
        return _compute_contacts(self._known_run("contacts"), self.time)

    @cached_property
    def acceleration(self) -> NDArray[np.float64]:
        """Acceleration (T, 3) [m/s^2, m/s^2, rad/s^2] of the centre of mass in each step.

        The acceleration times mass or moment of inertia is the sum of gravity and friction. Row 0
        is zero, because no step precedes row 0. The first step's normal forces use this zero.
        """
        run = self._known_run("acceleration")
        turning = np.zeros(len(self.time))
        turning[1:] = np.diff(run.states[:, ph.OMEGA]) / run.lengths(self.time)[1:]
        return np.column_stack([run.states[:, ph.AX : ph.AY + 1], turning])

    @cached_property
    def energy(self) -> Energy:
        """Kinetic and potential energy, dissipation by friction, and the work of drives."""
        return _compute_energy(self._known_run("energy"), self.time, self.contacts)

    def plot(self, path: str | PathLike[str] | None = None) -> "Figure":
        """Draw the path over the surface, and the velocity over time.

        The left panel shows the surface from above: rotors as strokes along their axes, supports as
        dots, the path of the base's origin, and the base's outline at some instants. If `run` is
        None, the left panel shows only the path. If the argument `path` names a file, the
        matplotlib figure is written to this file.
        """
        try:
            from surface_gym.trajectory_plot import draw_trajectory
        except ModuleNotFoundError as error:
            raise ImportError(
                f"a plot needs matplotlib ({error}): pip install 'surface_gym[tools]'"
            ) from None
        figure = draw_trajectory(self)
        if path is not None:
            figure.savefig(path, dpi=160)
        return figure

    @property
    def recording(self) -> "Recording":
        """Recording of the motion and its forces, for a replay."""
        from surface_gym.recorder import record_trajectory

        return record_trajectory(self)

    def save_html(self, path: str | PathLike[str]) -> None:
        """Write a page, as a file ending in .html, that replays the trajectory and its forces."""
        from surface_gym.player import replay

        replay(self).save(path)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the trajectory to an .npz file, replacing any file that exists.

        The file holds all fields including `run`. User-defined bases are not supported. A SHA-256
        checksum in the file shows damage. The checksum does not prove who wrote the file.
        """
        file = checks.path("path", path, SUFFIX)
        _check_end(self.end)
        parts: dict[str, Any] = {name: np.asarray(getattr(self, name)) for name in MOTION}
        if self.run is not None:
            parts |= _run_parts(self.run)
        for name, most in _sizes(len(self.time)).items():
            if name in parts and parts[name].nbytes > most:
                raise ValueError(
                    f"{name} must be of at most {most} bytes to be saved, got {parts[name].nbytes}"
                )
        with file.open("w+b") as packed:
            files.write_arrays(packed, parts, compressed=True)

    @staticmethod
    def load(path: str | PathLike[str]) -> "Trajectory":
        """Read a file written by `save`. The result equals the saved trajectory to the bit.

        The file is read as numbers and text; nothing in it is executed. Arrays that are too large
        are not unpacked. An invalid file raises a ValueError that names the problem.
        """
        file = checks.path("path", path, SUFFIX)
        try:
            return Trajectory(**_read_arrays(file))
        except ValueError as error:
            raise ValueError(
                f"path must lead to a trajectory that was saved, got {str(path)!r}: "
                f"{files.describe_damage(error)}"
            ) from None

    def _known_run(self, asked: str) -> Run:
        if self.run is None:
            raise ValueError(
                f"{asked} needs a trajectory with a run, as from surface_gym.simulate; "
                "got one whose run is None"
            )
        return self.run


def repeat(run: Run, time: Array) -> tuple[rollout.RecordedSteps, rollout.ContactForces]:
    """Repeat each step of a run from the state before the step. Step k ends at `time[k]` [s]."""
    grid, body = run.surface.grid, run.parcel.body
    scratch = ph.make_scratch()
    count = np.zeros(len(time), dtype=np.int64)
    first = np.zeros(len(time) + 1, dtype=np.int64)
    steps = rollout.RecordedSteps(run.states, run.lengths(time), run.leads(time), first)
    rollout.count_contacts(grid, body, steps, scratch, count)
    if not count[1:].all():
        step = 1 + int(np.argmin(count[1:]))
        raise ValueError(f"states must be over elements in every step, got none in step {step}")
    first[1:] = np.cumsum(count)
    total = int(first[-1])
    observed = rollout.ContactForces(
        run.states.copy(),
        np.zeros((total, 2), dtype=np.int64),
        np.zeros(total),
        np.zeros((total, 2)),
    )
    if run.normal_forces == "dual":
        rollout.support_loads(grid, body, steps, scratch, observed)
    else:
        _load_by_reference(run, steps, scratch, observed)
    if run.method == "implicit":
        rollout.repeat_implicit(grid, body, steps, scratch, observed)
    else:
        level = grid._replace(gravity_x=0.0, gravity_y=0.0)
        rollout.repeat_explicit(grid, level, body, steps, scratch, observed)
    return steps, observed


def _load_by_reference(
    run: Run, steps: rollout.RecordedSteps, scratch: Scratch, observed: rollout.ContactForces
) -> None:
    """Write the normal forces of all steps to `observed`. The solver is OSQP or SciPy."""
    grid, body = run.surface.grid, run.parcel.body
    for k in range(1, len(run.states)):
        state, first = run.states[k - 1], steps.first[k]
        count = find_support(grid, body, state, scratch, float(steps.lead[k])).total
        support_load_by(run.normal_forces, grid, body, state, scratch, count)
        observed.normal[first : first + count] = ph.table_row(scratch, ph.NORMAL, count)


def _compute_contacts(run: Run, time: Array) -> ContactRecord:
    """Compute the contacts of a run by repeating its steps."""
    steps, observed = repeat(run, time)
    surface, mass = run.surface, run.parcel.mass
    row, column = observed.element.T
    step = np.repeat(np.arange(len(time)), np.diff(steps.first))
    place = np.column_stack([surface.x[column], surface.y[row]])
    force = mass * observed.force
    along, across = _along_and_across(surface, observed.element, force)
    slide = _slip_velocity(run, time, step, place, run.states[:, ph.VX : ph.OMEGA + 1])
    slide -= _drive_velocity(surface, observed.element)
    return ContactRecord(
        step=step,
        time=time[step],
        element=observed.element,
        place=place,
        rotor=surface.rotor[row, column],
        normal=mass * observed.normal,
        along=along,
        across=across,
        force=force,
        slip=np.column_stack(_along_and_across(surface, observed.element, slide)),
    )


def _along_and_across(surface: Surface, element: Integers, vector: Array) -> tuple[Array, Array]:
    """Return the components of vectors (contacts, 2) along and across the elements' axes.

    `element` (contacts, 2) holds the row and the column of each element. For a support or a driven
    module, the components are x and y.
    """
    grid = surface.grid
    row, column = element.T
    cosine, sine = grid.direction[grid.axis[row, column]].T  # of a driven module: 1 and 0
    cosine = np.where(grid.rotor[row, column], cosine, 1.0)
    sine = np.where(grid.rotor[row, column], sine, 0.0)
    x, y = vector.T
    return cosine * x + sine * y, cosine * y - sine * x


def _slip_velocity(run: Run, time: Array, step: Integers, place: Array, velocity: Array) -> Array:
    """Compute the velocity (contacts, 2) [m/s] of the base's point above each contact's element.

    Contact k occurs in step `step[k]`. Its element is at `place[k]` (2,) [m]. `velocity` (T, 3) is
    the velocity of the centre of mass. Steps end at `time` (T,) [s].
    """
    before = run.states[step - 1]
    lead = run.leads(time)[step, np.newaxis]
    arm = place - (before[:, ph.X : ph.THETA] + lead * before[:, ph.VX : ph.OMEGA])
    vx, vy, omega = velocity[step].T
    return np.column_stack([vx - omega * arm[:, 1], vy + omega * arm[:, 0]])


def _drive_velocity(surface: Surface, element: Integers) -> Array:
    """Return the velocity (rows, 2) [m/s] of each element's surface. Undriven surfaces have 0."""
    if surface.surface_velocity is None:
        return np.zeros(element.shape)
    row, column = element.T
    return np.nan_to_num(surface.surface_velocity[row, column])


def _compute_energy(run: Run, time: Array, contacts: ContactRecord) -> Energy:
    """Compute the energy of a run from its states and contacts. Steps end at `time` (T,) [s]."""
    surface, parcel = run.surface, run.parcel
    velocity = run.states[:, ph.VX : ph.OMEGA + 1]
    mean = np.zeros_like(velocity)
    mean[1:] = 0.5 * (velocity[1:] + velocity[:-1])
    slide = _slip_velocity(run, time, contacts.step, contacts.place, mean)
    drive = _drive_velocity(surface, contacts.element)
    slide -= drive
    slip_along, slip_across = _along_and_across(surface, contacts.element, slide)
    power_along, power_across = -contacts.along * slip_along, -contacts.across * slip_across
    driven = surface.driven[tuple(contacts.element.T)]
    rotor = contacts.rotor & ~driven
    support = ~contacts.rotor
    vx, vy, omega = velocity.T
    turning = parcel.body.gyration * omega**2
    pull_x, pull_y = parcel.mass * surface.grid.gravity_x, parcel.mass * surface.grid.gravity_y
    rise = run.states[0, ph.X : ph.THETA] - run.states[:, ph.X : ph.THETA]
    lengths = run.lengths(time)

    def cumulate(power: Array) -> Array:
        by_step = np.bincount(contacts.step, weights=power, minlength=len(time))
        return np.cumsum(lengths * by_step)

    return Energy(
        kinetic=0.5 * parcel.mass * (vx**2 + vy**2 + turning),
        potential=pull_x * rise[:, 0] + pull_y * rise[:, 1],
        along=cumulate(np.where(rotor, power_along, 0.0)),
        across=cumulate(np.where(rotor, power_across, 0.0)),
        supports=cumulate(np.where(support, power_along + power_across, 0.0)),
        driven=cumulate(np.where(driven, power_along + power_across, 0.0)),
        drives=cumulate((contacts.force * drive).sum(axis=1)),
    )


Parts = dict[str, NDArray[Any]]
Fields = dict[str, Any]  # fields of a dataclass

SUFFIX = ".npz"
MOTION = ("time", "pose", "velocity", "tipping", "end")
SURFACE = ("axis", "rotor", "pitch", "origin", "mu_max", "mu_min", "mu_support", "tilt")
PARCEL = ("mass", "com_height", "com_offset")
RUN = ("dt", "method", "normal_forces", "states")
MAY_BE_NONE = ("stiffness", "surface_velocity", "inertia")  # left out of a file if None
ADDED = ("tilt_direction",)  # fields of `Surface` that older files lack; they get the default
ALL = (*SURFACE, *PARCEL, *RUN, "base", "base_lengths")
ROWS = 4_000_000  # maximum rows in an .npz file: an hour in steps of 1 ms

# A base's name and its lengths [m]: length and width, radius, or vertices (vertices, 2).
BASES: dict[str, Callable[[Array], Base]] = {
    "rectangle": lambda lengths: Rectangle(*lengths.tolist()),
    "disc": lambda lengths: Disc(*lengths.tolist()),
    "polygon": lambda lengths: Polygon(lengths),
}


def _check_end(end: str) -> None:
    if not isinstance(end, str) or not end.isprintable() or not end.strip():
        raise ValueError(f"end must be one line of text, got {end!r:.60}")


def _check_time(time: Array) -> Array:
    rows = _checked_rows("time", time, (None,))
    if len(rows) == 0 or rows[0] != 0.0 or (np.diff(rows) <= 0.0).any():
        raise ValueError("time must begin at 0 and rise")
    return rows


def _checked_rows(name: str, value: NDArray[Any], shape: tuple[int | None, ...]) -> Array:
    """Return a copy of a float64 array; raise an error for a wrong type, shape or number.

    All numbers must be finite. A None in `shape` allows any length.
    """
    if value.dtype != np.float64:
        raise ValueError(f"{name} must be of float64, got {value.dtype}")
    return checks.array(name, value, shape).copy()


def _sizes(rows: int) -> dict[str, int]:
    """Return the maximum size [bytes] of each array in an .npz file with `rows` rows."""
    sizes = dict.fromkeys((*MOTION, *ALL, *MAY_BE_NONE, *ADDED), 8 * checks.ELEMENTS)
    each = dict.fromkeys(("pose", "velocity", "tipping", "states"), 8 * ph.STATE_SIZE * rows)
    return sizes | each | {"time": 8 * ROWS}


def _read_arrays(file: Path) -> Fields:
    """Read the fields of a trajectory from an .npz file, and check them."""
    with files.ArrayFile(file) as archive:
        _check_missing([name for name in MOTION if name not in archive])
        # Read the time first: its number of rows bounds the other arrays before they are unpacked.
        time = _check_time(archive.read("time", 8 * ROWS))
        rows = len(time)
        sizes = _sizes(rows)
        parts = {name: archive.read(name, sizes[name]) for name in sizes if name in archive}
    motion = {name: _checked_rows(name, parts[name], (rows, 3)) for name in ("pose", "velocity")}
    tipping, end = parts["tipping"], parts["end"].item() if parts["end"].ndim == 0 else ""
    if tipping.dtype != np.bool_ or tipping.shape != time.shape:
        raise ValueError(
            f"tipping must be booleans of the shape {time.shape}, "
            f"got {tipping.dtype} of {tipping.shape}"
        )
    _check_end(end)
    run = _read_run(parts, rows)
    return {"time": time, **motion, "tipping": tipping, "end": end, "run": run}


def _check_missing(missing: list[str]) -> None:
    if missing:
        raise ValueError(f"it lacks {', '.join(missing)}")


def _run_parts(run: Run) -> Parts:
    """Convert a run to named arrays."""
    surface, parcel = run.surface, run.parcel
    for name, part, kind in (("surface", surface, Surface), ("parcel", parcel, Parcel)):
        if type(part) is not kind:
            raise ValueError(
                f"{name} must be a {kind.__name__}, not a user-defined class, to be saved, "
                f"got a {type(part).__name__}"
            )
    base, lengths = _base_parts(parcel.base)
    parts = {name: getattr(surface, name) for name in (*SURFACE, *ADDED)}
    parts |= {name: getattr(parcel, name) for name in PARCEL}
    parts |= {name: getattr(run, name) for name in RUN} | {"base": base, "base_lengths": lengths}
    parts |= {name: getattr(surface, name) for name in ("stiffness", "surface_velocity")}
    parts["inertia"] = parcel.inertia
    return {name: np.asarray(value) for name, value in parts.items() if value is not None}


def _base_parts(base: Base) -> tuple[str, Array]:
    if type(base) is Rectangle:
        return "rectangle", np.array([base.length, base.width])
    if type(base) is Disc:
        return "disc", np.array([base.radius])
    if type(base) is Polygon:
        return "polygon", base.vertices
    raise ValueError(f"base must be a Rectangle, a Disc or a Polygon to be saved, got {base!r}")


def _read_run(parts: Parts, rows: int) -> Run | None:
    """Make a run from the named arrays in `parts`, or return None if `parts` holds no run."""
    missing = [name for name in ALL if name not in parts]
    if len(missing) == len(ALL):
        return None
    _check_missing(missing)
    plain: Fields = {
        name: parts[name].item() if parts[name].ndim == 0 else parts[name]
        for name in (*ALL, *MAY_BE_NONE, *ADDED)
        if name in parts
    }
    of_surface = (*SURFACE, "stiffness", "surface_velocity", *ADDED)
    surface = Surface(**{name: plain[name] for name in of_surface if name in plain})
    lengths = checks.array("base_lengths", plain["base_lengths"], parts["base_lengths"].shape)
    make_base = BASES[checks.one_of("base", plain["base"], BASES)]
    try:
        base = make_base(lengths)
    except TypeError:
        raise ValueError(f"base_lengths must fit a {plain['base']}, got {lengths}") from None
    parcel = Parcel(base, **{name: plain[name] for name in PARCEL}, inertia=plain.get("inertia"))
    surface.check_capacity(base, (surface.columns, surface.rows))
    dt = checks.positive("dt", plain["dt"])
    method = checks.one_of("method", plain["method"], ("implicit", "explicit"))
    solver = checks.one_of("normal_forces", plain["normal_forces"], ("dual", "osqp", "scipy"))
    states = _checked_rows("states", parts["states"], (rows, ph.STATE_SIZE))
    return Run(surface, parcel, dt, method, solver, states)
