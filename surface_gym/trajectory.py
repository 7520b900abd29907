"""What a simulation gives back."""

from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from surface_gym.physics.types import AX, AY, OMEGA
from surface_gym.record.contacts import ContactRecord, record_contacts
from surface_gym.record.energy import Energy, energy_of
from surface_gym.record.repeating import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A parcel's motion, one row a step, the start first.

    What bore the parcel, its acceleration and its energy are found out when they are asked for, by
    doing the steps once more: only `surface_gym.simulate` leaves behind what that takes.

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
    # how it came about; None where that is not `surface_gym.simulate`, or not known any more
    run: Run | None = None

    @cached_property
    def contacts(self) -> ContactRecord:
        """What bore the parcel in each step, with which forces.

        Raises:
            ValueError: the trajectory has no `run`, or one from a file whose states leave the
                elements.
        """
        return record_contacts(self._known_run("contacts"), self.time)

    @cached_property
    def acceleration(self) -> NDArray[np.float64]:
        """(T, 3) [m/s^2, m/s^2, rad/s^2] of the centre of mass, in the step that led to each row.

        Times mass and moment of inertia it is what gravity and friction add up to. The first row,
        which no step led to, is zero, as the normal forces of the first step take it.

        Raises:
            ValueError: the trajectory has no `run`.
        """
        run = self._known_run("acceleration")
        turning = np.zeros(len(self.time))
        turning[1:] = np.diff(run.states[:, OMEGA]) / run.lengths(self.time)[1:]
        return np.column_stack([run.states[:, AX : AY + 1], turning])

    @cached_property
    def energy(self) -> Energy:
        """Kinetic and potential energy, and what friction dissipated.

        Raises:
            ValueError: the trajectory has no `run`.
        """
        return energy_of(self._known_run("energy"), self.time, self.contacts)

    def plot(self, path: str | PathLike[str] | None = None) -> "Figure":
        """Draw the way over the surface, and the velocity over time.

        On the left the surface is seen from above, with rotors as strokes along their axes,
        supports as dots, the way of the base's origin and the base's outline at some instants. A
        trajectory without a `run` shows the way alone.

        Args:
            path: of the file to write the figure to; None: to none.

        Returns:
            The figure, by matplotlib.

        Raises:
            ValueError: the path ends in a suffix that matplotlib does not write.
            OSError: the file cannot be written.
            ImportError: matplotlib is not installed; the message says how to.
        """
        try:
            from surface_gym.record.plot import draw
        except ModuleNotFoundError as error:
            raise ImportError(
                f"a plot needs matplotlib ({error}): pip install 'surface_gym[agents]'"
            ) from None
        figure = draw(self)
        if path is not None:
            figure.savefig(path, dpi=160)
        return figure

    def save(self, path: str | PathLike[str]) -> None:
        """Write the trajectory to a file; one that is there is replaced.

        Args:
            path: of the file. An .npz holds all, the `run` too; a .csv holds the motion, `tipping`
                and `end`, a row a step, with units in the header, and no `run`.

        Raises:
            ValueError: the path ends otherwise, or what is to be saved is not all that the file
                would hold: an .npz has no place for a base of one's own.
            OSError: the file cannot be written.
        """
        from surface_gym.record.files import save

        save(self, path)

    @staticmethod
    def load(path: str | PathLike[str]) -> "Trajectory":
        """Read a trajectory that `save` wrote: the same to the bit.

        Numbers and text are all that is read; nothing in a file is run.

        Args:
            path: of the file, an .npz or a .csv.

        Raises:
            ValueError: the path ends otherwise, or the file does not hold a trajectory; the error
                names what is wrong.
            OSError: there is no such file, or it cannot be read.
        """
        from surface_gym.record.files import load

        return load(path)

    def _known_run(self, asked: str) -> Run:
        if self.run is None:
            raise ValueError(
                f"{asked} must be asked of a trajectory that says how it came about, as those of "
                "surface_gym.simulate do; got one whose run is None"
            )
        return self.run
