"""Where the energy of a parcel goes."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surface_gym.physics.types import OMEGA, VX, Array, X
from surface_gym.record.contacts import ContactRecord, along_and_across, slip_over
from surface_gym.record.repeating import Run


@dataclass(frozen=True, eq=False)
class Energy:
    """The energy of a parcel, one row a step, and what friction took of it since the start.

    The power of friction in a step is taken with the mean of the velocities at its ends.
    """

    kinetic: NDArray[np.float64]  # (T,) [J] of the centre of mass and of the turning about it
    potential: NDArray[np.float64]  # (T,) [J] of the tilted surface, against the start
    along: NDArray[np.float64]  # (T,) [J] dissipated by rotors along their axes, cumulated
    across: NDArray[np.float64]  # (T,) [J] by rotors across their axes, cumulated
    supports: NDArray[np.float64]  # (T,) [J] by supports, cumulated

    @property
    def dissipated(self) -> NDArray[np.float64]:
        """(T,) [J] by all friction since the start."""
        return self.along + self.across + self.supports

    @property
    def balance(self) -> NDArray[np.float64]:
        """(T,) [J] that the integration has gained since the start, against Newton's laws.

        The implicit step leaves what its solver does, near round-off; the explicit one leaves an
        error that goes to zero with the step, and what its rules for a parcel that stands do.
        """
        return self.kinetic - self.kinetic[0] + self.potential + self.dissipated


def energy_of(run: Run, time: Array, contacts: ContactRecord) -> Energy:
    """The energy of a run, from its states (T, 8) and contacts; time is (T,) [s]."""
    surface, parcel = run.surface, run.parcel
    velocity = run.states[:, VX : OMEGA + 1]
    mean = np.zeros_like(velocity)
    mean[1:] = 0.5 * (velocity[1:] + velocity[:-1])
    slide = slip_over(run, time, contacts.step, contacts.place, mean)
    slip_along, slip_across = along_and_across(surface, contacts.element, slide)
    power_along, power_across = -contacts.along * slip_along, -contacts.across * slip_across
    rotor = contacts.rotor
    vx, vy, omega = velocity.T
    turning = parcel.body.gyration * omega**2
    pull = parcel.mass * surface.grid.gravity_along
    lengths = run.lengths(time)

    def cumulated(power: Array) -> Array:
        by_step = np.bincount(contacts.step, weights=power, minlength=len(time))
        return np.cumsum(lengths * by_step)

    return Energy(
        kinetic=0.5 * parcel.mass * (vx**2 + vy**2 + turning),
        potential=pull * (run.states[0, X] - run.states[:, X]),
        along=cumulated(np.where(rotor, power_along, 0.0)),
        across=cumulated(np.where(rotor, power_across, 0.0)),
        supports=cumulated(np.where(rotor, 0.0, power_along + power_across)),
    )
