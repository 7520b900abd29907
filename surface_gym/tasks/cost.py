"""Costs that planners minimise: a task's own, over the nodes of a search."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from surface_gym.lines import BaseLine
from surface_gym.state import SUCCESS, ParcelState

Numbers = NDArray[np.float64]

# Found by trying.
FAILED = 1e3  # cost of a failure, beyond that of any success
SETTLING = 0.05  # [s] a turning speed goes on for until it is taken back


class Nodes(Protocol):
    """Environments of a simulator that a search branches: their states, and what they share."""

    @property
    def parcels(self) -> ParcelState:
        """State arrays, one row per node."""

    @property
    def plant(self) -> BaseLine:
        """The line or field."""

    @property
    def zone(self) -> tuple[int, int, int, int]:
        """First row, rows, first column and columns that obey."""

    @property
    def half_length(self) -> float:
        """[m] of the base."""

    @property
    def braking(self) -> float:
        """[m/s^2] of a parcel over axes at 0 deg."""

    @property
    def rolling_loss(self) -> float:
        """[m/s^2] of a parcel over axes at 90 deg."""

    @property
    def quarter_turn(self) -> float:
        """[s] that an axis takes to turn by 90 deg; 0: axes obey at once."""

    @property
    def vx(self) -> Numbers:
        """(nodes,) [m/s] speed along x that remains once all axes have turned to 90 deg."""

    @property
    def braking_distance(self) -> Numbers:
        """(nodes,) [m] along x that parcels go on for if all axes turn to 0 deg from now on."""

    def reach(self, x: float, y: float) -> Numbers:
        """(nodes,) [m] reach of the base from its centre in a direction (x, y)."""


@dataclass(frozen=True)
class PlanCost:
    """Costs of a search's nodes, the lower the better, and how far a search goes."""

    running: Callable[[Nodes], Numbers]  # of nodes whose episode goes on
    final: Callable[[Nodes], Numbers]  # of nodes that have ended, or are at the horizon
    enough: float  # final cost at which the search ends
    horizon: int  # control periods looked ahead
    follow: int  # periods of a plan that are followed at most
    share: int = 1  # a search gets 1 / share of the planner's budget
    # Two axis angles [rad] of all modules; every time to change from the first to the second for
    # good is tried. Or None.
    event: Callable[[ParcelState], tuple[float, float] | None] = lambda _: None
    zone: tuple[int, int] | None = None  # columns that a search needs; None: the environment's


def way_to_leave(nodes: Nodes) -> Numbers:
    """Compute the way [m] from the rear to the zone's end, at least 0."""
    _, _, first, columns = nodes.zone
    end = nodes.plant.column_edge(first + columns)
    return np.maximum(0.0, end - nodes.parcels.truth[:, 0] + nodes.reach(-1.0, 0.0))


def off_line(nodes: Nodes) -> Numbers:
    """Compute the distance [m] from the line's middle."""
    return np.abs(nodes.parcels.truth[:, 1] - nodes.plant.line_y)


def askew(nodes: Nodes) -> Numbers:
    """Compute a cost of everything that is not straight along the line."""
    _, _, theta, _, vy, omega = nodes.parcels.truth.T
    return off_line(nodes) + np.abs(vy) + np.abs(theta) + SETTLING * np.abs(omega)


def failure_cost(nodes: Nodes) -> Numbers:
    """Compute the cost of the outcome: 0 for a success."""
    return np.where(nodes.parcels.outcome == SUCCESS, 0.0, FAILED)


def time_cost(nodes: Nodes) -> Numbers:
    """Compute the time [s] until a success; `FAILED` comes on top for anything else."""
    return failure_cost(nodes) + nodes.parcels.clock


def error_cost(nodes: Nodes) -> Numbers:
    """Compute the size of the task's first figure at a success; `FAILED` comes on top else."""
    return failure_cost(nodes) + np.abs(nodes.parcels.metrics[:, 0])
