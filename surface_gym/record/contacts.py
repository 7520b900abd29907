"""What bore a parcel in each step of a run, and the friction there."""

import csv
from dataclasses import dataclass, fields
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.physics.types import OMEGA, THETA, VX, Array, Integers, X
from surface_gym.record.repeating import Run, repeat
from surface_gym.surface import Surface

COLUMNS = (
    *("step", "time [s]", "row", "column", "x [m]", "y [m]", "rotor", "normal [N]"),
    *("along [N]", "across [N]", "force x [N]", "force y [N]"),
    *("slip along [m/s]", "slip across [m/s]"),
)


@dataclass(frozen=True, eq=False)
class ContactRecord:
    """The contacts of a run, a row a contact and step, step by step and in the order of the grid.

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
        """The contacts that bore one step, which led to that row of the trajectory.

        Raises:
            ValueError: no such step; the first is 1.
        """
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
        values[COLUMNS.index("rotor")] = self.rotor.astype(int).tolist()
        with file.open("w", encoding="utf-8", newline="") as stream:
            rows = csv.writer(stream, lineterminator="\n")
            rows.writerow(COLUMNS)
            rows.writerows(zip(*values, strict=True))


def record_contacts(run: Run, time: Array) -> ContactRecord:
    """The contacts of a run, whose steps are done once more.

    Args:
        run: how the steps were done.
        time: (T,) [s] their ends, the start first.
    """
    steps, observed = repeat(run, time)
    surface, mass = run.surface, run.parcel.mass
    row, column = observed.element.T
    step = np.repeat(np.arange(len(time)), np.diff(steps.first))
    place = np.column_stack([surface.x[column], surface.y[row]])
    force = mass * observed.force
    along, across = along_and_across(surface, observed.element, force)
    slide = slip_over(run, time, step, place, run.states[:, VX : OMEGA + 1])
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
        slip=np.column_stack(along_and_across(surface, observed.element, slide)),
    )


def along_and_across(surface: Surface, element: Integers, vector: Array) -> tuple[Array, Array]:
    """(rows,) and (rows,) of vectors (rows, 2) at elements (rows, 2); x and y on a support."""
    grid = surface.grid
    row, column = element.T
    cosine, sine = grid.direction[grid.axis[row, column]].T
    cosine = np.where(grid.rotor[row, column], cosine, 1.0)
    sine = np.where(grid.rotor[row, column], sine, 0.0)
    x, y = vector.T
    return cosine * x + sine * y, cosine * y - sine * x


def slip_over(run: Run, time: Array, step: Integers, place: Array, velocity: Array) -> Array:
    """(rows, 2) [m/s] velocity of the base over elements, in x and y.

    Args:
        run: how the steps were done.
        time: (T,) [s] their ends, the start first.
        step: (rows,) that each contact bore.
        place: (rows, 2) [m] of the elements.
        velocity: (T, 3) [m/s, m/s, rad/s] of the centre of mass, to be taken for each step.
    """
    before = run.states[step - 1]
    lead = run.leads(time)[step, np.newaxis]
    arm = place - (before[:, X:THETA] + lead * before[:, VX:OMEGA])
    vx, vy, omega = velocity[step].T
    return np.column_stack([vx - omega * arm[:, 1], vy + omega * arm[:, 0]])
