"""The result of a simulation: motion, and on request contacts, friction forces and energy."""

import csv
from dataclasses import dataclass, fields
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.parcel import Parcel
from surface_gym.physics import rollout
from surface_gym.physics import types as ph
from surface_gym.physics.references import find_support
from surface_gym.physics.rollout import ContactForces, RecordedSteps
from surface_gym.physics.types import Array, Integers, Scratch
from surface_gym.surface import Surface

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CONTACT_COLUMNS = (
    *("step", "time [s]", "row", "column", "x [m]", "y [m]", "rotor", "normal [N]"),
    *("along [N]", "across [N]", "force x [N]", "force y [N]"),
    *("slip along [m/s]", "slip across [m/s]"),
)


@dataclass(frozen=True, eq=False)
class Run:
    """The inputs and states of a simulation, from which each of its steps can be repeated."""

    surface: Surface
    parcel: Parcel
    dt: float  # [s] of a step; the last may be shorter
    method: str  # "implicit" or "explicit"
    normal_forces: str  # "dual", "osqp" or "scipy": what solved Eq. (1)
    # (T, 8) the centre of mass's x, y [m], theta [rad], vx, vy [m/s], omega [rad/s], and the
    # acceleration ax, ay [m/s^2] of the step that led here
    states: Array

    def lengths(self, time: Array) -> Array:
        """Compute the length (T,) [s] of the step that led to each row, 0 for the start."""
        length = np.full(len(time), self.dt)
        if time[-1] != self.dt * (len(time) - 1):
            length[-1] = time[-1] - time[-2]
        length[0] = 0.0
        return length

    def leads(self, time: Array) -> Array:
        """Compute the time (T,) [s] from each step's start to the pose whose contacts bear it."""
        return (0.5 if self.method == "implicit" else 0.0) * self.lengths(time)


@dataclass(frozen=True, eq=False)
class ContactRecord:
    """Contacts of a run, one row per contact and step, in the order of steps and of the grid.

    Friction is what acts on the parcel. A rotor has its axis (cos, sin) of `Surface.axis`, and
    across it is a quarter turn anti-clockwise of that; along a support is along x, and across it
    along y. The implicit step takes friction at the velocity that it ends with, the explicit one at
    the velocity that it starts from. Where the paper's rule for a parcel that stands scales the
    forces along the axes, they are those scaled; where all other friction is more than gravity
    even so, that rule holds the parcel against it, and the forces do not add up along x.
    """

    step: NDArray[np.int64]  # (rows,) that the contact bore: the row of the trajectory it led to
    time: NDArray[np.float64]  # (rows,) [s] the step's end
    element: NDArray[np.int64]  # (rows, 2) row and column in the surface's grid
    place: NDArray[np.float64]  # (rows, 2) [m] the element's centre, x and y
    rotor: NDArray[np.bool_]  # (rows,) whether it is a rotor, else a support
    normal: NDArray[np.float64]  # (rows,) [N]
    along: NDArray[np.float64]  # (rows,) [N] friction along the rotor's axis; a support's, in x
    across: NDArray[np.float64]  # (rows,) [N] friction across it; a support's, in y
    force: NDArray[np.float64]  # (rows, 2) [N] the same friction in x and y
    # (rows, 2) [m/s] velocity of the base over the element at the step's end, along and across
    slip: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.step)

    def of_step(self, step: int) -> "ContactRecord":
        """Select the contacts of one step, which led to that row of the trajectory."""
        checks.integer("step", step, least=1)
        first, end = np.searchsorted(self.step, (step, step + 1)).tolist()
        if first == end:
            known = f"between {self.step[0]} and {self.step[-1]}" if len(self) else "in the record"
            raise ValueError(f"step must be {known}, got {step!r}")
        return ContactRecord(*(getattr(self, field.name)[first:end] for field in fields(self)))

    def save(self, path: str | PathLike[str]) -> None:
        """Write the record as comma-separated values (UTF-8), a row a contact, units in the header.

        Args:
            path: of the file, which must end in .csv; one that is there is replaced.

        Raises:
            ValueError: the path ends otherwise.
            OSError: the file cannot be written.
        """
        file = Path(path)
        if file.suffix != ".csv":
            raise ValueError(f"path must end in .csv, got {str(path)!r}")
        each = (getattr(self, field.name) for field in fields(self))
        values = [column.tolist() for array in each for column in np.atleast_2d(array.T)]
        values[CONTACT_COLUMNS.index("rotor")] = self.rotor.astype(int).tolist()
        with file.open("w", encoding="utf-8", newline="") as stream:
            rows = csv.writer(stream, lineterminator="\n")
            rows.writerow(CONTACT_COLUMNS)
            rows.writerows(zip(*values, strict=True))


@dataclass(frozen=True, eq=False)
class Energy:
    """Energy of a parcel, one row per step, and its dissipation by friction since the start.

    The power of friction in a step is taken with the mean of the velocities at its ends.
    """

    kinetic: NDArray[np.float64]  # (T,) [J] of the centre of mass and of the turning about it
    potential: NDArray[np.float64]  # (T,) [J] of the tilted surface, against the start
    along: NDArray[np.float64]  # (T,) [J] dissipated by rotors along their axes, cumulated
    across: NDArray[np.float64]  # (T,) [J] by rotors across their axes, cumulated
    supports: NDArray[np.float64]  # (T,) [J] by supports, cumulated

    @property
    def dissipated(self) -> NDArray[np.float64]:
        """Sum (T,) [J] of all dissipation by friction since the start."""
        return self.along + self.across + self.supports

    @property
    def balance(self) -> NDArray[np.float64]:
        """Energy (T,) [J] gained by integration errors since the start, zero by Newton's laws.

        The implicit step leaves the error of its solver, near round-off; the explicit one leaves an
        error that goes to zero with the step, and the work of its rules for a parcel that stands.
        """
        return self.kinetic - self.kinetic[0] + self.potential + self.dissipated


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Motion of a parcel, one row per step, the start first.

    Contacts, acceleration and energy are computed on request by repeating the steps: only the
    trajectories of `surface_gym.simulate` keep the `run` for that.

    >>> import surface_gym as sg
    >>> box = sg.Parcel(sg.Rectangle(0.25, 0.25), mass=10.0)
    >>> run = sg.simulate(sg.layouts.sorting(), box, (0.125, 1.0, 0.0), (1.5, 0.0, 0.0))
    >>> contacts = run.contacts.of_step(10)
    >>> contacts.element.tolist()  # row and column of those that bore the box in step 10
    [[9, 1], [9, 2], [10, 1], [10, 2]]
    >>> float(contacts.normal.sum().round(3))  # [N] m g
    98.1
    >>> float(run.energy.dissipated[-1].round(1))  # [J] by friction
    6.9
    """

    time: NDArray[np.float64]  # (T,) [s]
    pose: NDArray[np.float64]  # (T, 3) [m, m, rad] x, y, theta of the base's frame
    velocity: NDArray[np.float64]  # (T, 3) [m/s, m/s, rad/s] of that frame
    # (T,) the step that led here had no exact normal forces: fewer than three contacts, collinear,
    # or the load point outside their hull. A real parcel tips there.
    tipping: NDArray[np.bool_]
    # "duration"; "left the surface"; "nothing bears it", between the elements; "stopped", by the
    # paper's rule, explicit only
    end: str
    # inputs and states for repeating the steps; None if not made by `surface_gym.simulate`
    run: Run | None = None

    @cached_property
    def contacts(self) -> ContactRecord:
        """Contacts and friction forces of each step."""
        return _compute_contacts(self._known_run("contacts"), self.time)

    @cached_property
    def acceleration(self) -> NDArray[np.float64]:
        """Acceleration (T, 3) [m/s^2, m/s^2, rad/s^2] of the centre of mass in the step to a row.

        Times mass and moment of inertia it is the sum of gravity and friction. The first row, which
        no step led to, is zero: the normal forces of the first step assume so.
        """
        run = self._known_run("acceleration")
        turning = np.zeros(len(self.time))
        turning[1:] = np.diff(run.states[:, ph.OMEGA]) / run.lengths(self.time)[1:]
        return np.column_stack([run.states[:, ph.AX : ph.AY + 1], turning])

    @cached_property
    def energy(self) -> Energy:
        """Kinetic and potential energy, and dissipation by friction."""
        return _compute_energy(self._known_run("energy"), self.time, self.contacts)

    def plot(self, path: str | PathLike[str] | None = None) -> "Figure":
        """Draw the path over the surface, and the velocity over time.

        On the left the surface is seen from above, with rotors as strokes along their axes,
        supports as dots, the path of the base's origin and the base's outline at some instants. A
        trajectory without a `run` shows the path alone.

        Args:
            path: of the file to write the figure to, if any.

        Returns:
            The figure, by matplotlib.

        Raises:
            ValueError: the path ends in a suffix that matplotlib does not write.
            OSError: the file cannot be written.
            ImportError: matplotlib is not installed; the message says how to.
        """
        try:
            from surface_gym.trajectory_plot import draw_trajectory
        except ModuleNotFoundError as error:
            raise ImportError(
                f"a plot needs matplotlib ({error}): pip install 'surface_gym[agents]'"
            ) from None
        figure = draw_trajectory(self)
        if path is not None:
            figure.savefig(path, dpi=160)
        return figure

    def save(self, path: str | PathLike[str]) -> None:
        """Write the trajectory to a file, replacing any file that exists.

        Args:
            path: of the file. An .npz holds all, including the `run`; a .csv holds the motion,
                `tipping` and `end`, one row per step, with units in the header, and no `run`.

        Raises:
            ValueError: the path ends otherwise, or the file cannot hold all of the trajectory: an
                .npz has no room for a user-defined base.
            OSError: the file cannot be written.
        """
        from surface_gym.trajectory_files import save_trajectory

        save_trajectory(self, path)

    @staticmethod
    def load(path: str | PathLike[str]) -> "Trajectory":
        """Read a trajectory that `save` wrote, the same to the bit.

        Only numbers and text are read; nothing in a file is executed.

        Args:
            path: of the file, an .npz or a .csv.

        Raises:
            ValueError: the path ends otherwise, or the file does not hold a trajectory; the error
                names what is wrong.
            OSError: there is no such file, or it cannot be read.
        """
        from surface_gym.trajectory_files import load_fields

        motion, run = load_fields(path)
        return Trajectory(**motion, run=None if run is None else Run(**run))

    def _known_run(self, asked: str) -> Run:
        if self.run is None:
            raise ValueError(
                f"{asked} must be asked of a trajectory with a run, as those of "
                "surface_gym.simulate have; got one whose run is None"
            )
        return self.run


def repeat(run: Run, time: Array) -> tuple[RecordedSteps, ContactForces]:
    """Repeat each step of a run from the state recorded before it.

    Args:
        run: whose steps to repeat.
        time: (T,) [s] their ends, the start first.
    """
    grid, body = run.surface.grid, run.parcel.body
    scratch = ph.make_scratch()
    count = np.zeros(len(time), dtype=np.int64)
    first = np.zeros(len(time) + 1, dtype=np.int64)
    steps = RecordedSteps(run.states, run.lengths(time), run.leads(time), first)
    rollout.count_contacts(grid, body, steps, scratch, count)
    if not count[1:].all():
        step = 1 + int(np.argmin(count[1:]))
        raise ValueError(f"states must be over elements in every step, got none in step {step}")
    first[1:] = np.cumsum(count)
    total = int(first[-1])
    observed = ContactForces(
        run.states.copy(),
        np.zeros((total, 2), dtype=np.int64),
        np.zeros(total),
        np.zeros((total, 2)),
    )
    if run.normal_forces == "dual":
        rollout.support_loads(grid, body, steps, scratch, observed)
    else:
        _bear_by_reference(run, steps, scratch, observed)
    if run.method == "implicit":
        rollout.repeat_implicit(grid, body, steps, scratch, observed)
    else:
        level = grid._replace(gravity_along=0.0)
        rollout.repeat_explicit(grid, level, body, steps, scratch, observed)
    return steps, observed


def _bear_by_reference(
    run: Run, steps: RecordedSteps, scratch: Scratch, observed: ContactForces
) -> None:
    """Write the normal forces of all steps as computed by OSQP or SciPy."""
    from surface_gym.physics.references import support_load_by

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
    """Split vectors (rows, 2) at elements (rows, 2) by the rotors' axes; x and y on a support."""
    grid = surface.grid
    row, column = element.T
    cosine, sine = grid.direction[grid.axis[row, column]].T
    cosine = np.where(grid.rotor[row, column], cosine, 1.0)
    sine = np.where(grid.rotor[row, column], sine, 0.0)
    x, y = vector.T
    return cosine * x + sine * y, cosine * y - sine * x


def _slip_velocity(run: Run, time: Array, step: Integers, place: Array, velocity: Array) -> Array:
    """Compute the velocity (rows, 2) [m/s] of the base over elements, in x and y.

    Args:
        run: whose steps to repeat.
        time: (T,) [s] their ends, the start first.
        step: (rows,) that each contact bore.
        place: (rows, 2) [m] of the elements.
        velocity: (T, 3) [m/s, m/s, rad/s] of the centre of mass, to be taken for each step.
    """
    before = run.states[step - 1]
    lead = run.leads(time)[step, np.newaxis]
    arm = place - (before[:, ph.X : ph.THETA] + lead * before[:, ph.VX : ph.OMEGA])
    vx, vy, omega = velocity[step].T
    return np.column_stack([vx - omega * arm[:, 1], vy + omega * arm[:, 0]])


def _compute_energy(run: Run, time: Array, contacts: ContactRecord) -> Energy:
    """Compute the energy of a run from its states (T, 8) and contacts; time is (T,) [s]."""
    surface, parcel = run.surface, run.parcel
    velocity = run.states[:, ph.VX : ph.OMEGA + 1]
    mean = np.zeros_like(velocity)
    mean[1:] = 0.5 * (velocity[1:] + velocity[:-1])
    slide = _slip_velocity(run, time, contacts.step, contacts.place, mean)
    slip_along, slip_across = _along_and_across(surface, contacts.element, slide)
    power_along, power_across = -contacts.along * slip_along, -contacts.across * slip_across
    rotor = contacts.rotor
    vx, vy, omega = velocity.T
    turning = parcel.body.gyration * omega**2
    pull = parcel.mass * surface.grid.gravity_along
    lengths = run.lengths(time)

    def cumulate(power: Array) -> Array:
        by_step = np.bincount(contacts.step, weights=power, minlength=len(time))
        return np.cumsum(lengths * by_step)

    return Energy(
        kinetic=0.5 * parcel.mass * (vx**2 + vy**2 + turning),
        potential=pull * (run.states[0, ph.X] - run.states[:, ph.X]),
        along=cumulate(np.where(rotor, power_along, 0.0)),
        across=cumulate(np.where(rotor, power_across, 0.0)),
        supports=cumulate(np.where(rotor, 0.0, power_along + power_across)),
    )
