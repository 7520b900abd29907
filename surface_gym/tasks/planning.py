"""Decoded observations for rules, and costs of nodes (simulated states) for planners."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from surface_gym.lines import BaseLine
from surface_gym.parcel import Parcel
from surface_gym.state import SUCCESS, ParcelState
from surface_gym.tasks.features import Column
from surface_gym.tasks.start import Start

Numbers = NDArray[np.float64]


def square_reach(half_length: Numbers | float, theta: Numbers) -> Numbers:
    """Compute how far [m] a square extends from its centre along x or y.

    The square is turned by `theta` [rad]. `half_length` [m] is half of a side's length.
    """
    return half_length * (np.abs(np.cos(theta)) + np.abs(np.sin(theta)))


@dataclass(frozen=True, eq=False)
class ObservationTable:
    """Observations of some environments, read by feature name, in SI units."""

    shown: Numbers  # (num_envs, features)
    columns: Mapping[str, Column]  # by the features' names
    line: BaseLine
    zone: tuple[int, int] | None  # first and last column that obey; None: the line's
    parcel: Parcel | None = None  # if its outline is known; None: a square of the observed size

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def __getitem__(self, name: str) -> Numbers:
        if name not in self.columns:
            raise ValueError(f"features must contain {name!r}, got {', '.join(self.columns)}")
        return self.columns[name].of(self.shown)

    def get(self, name: str, absent: float = 0.0) -> Numbers:
        """Return a feature's values (num_envs,), or `absent` if the feature is not observed."""
        return self[name] if name in self else np.full(len(self.shown), absent)

    @property
    def theta(self) -> Numbers:
        """(num_envs,) [rad] observed theta."""
        return np.arctan2(self["sine of theta"], self["cosine of theta"])

    def in_pitch(self, axis: str, pitch: float) -> Numbers:
        """Return a parcel's x or y [m] (num_envs,) relative to the module nearest to its centre."""
        phase = np.arctan2(self[f"sine of phase {axis}"], self[f"cosine of phase {axis}"])
        return pitch * phase / (2.0 * math.pi)

    def reach(self, half_length: Numbers, theta: Numbers, ahead: float) -> Numbers:
        """Return how far [m] (num_envs,) the base extends along x from its centre.

        `ahead` is 1 for the extent ahead of the centre, -1 for the extent behind it. If the parcel
        is not known, the base is assumed to be a square with sides of twice `half_length` [m].
        """
        if self.parcel is None:
            return square_reach(half_length, theta)
        x, y = (self.parcel.base.outline - self.parcel.base.centroid).T
        turned = np.cos(theta)[:, np.newaxis] * x - np.sin(theta)[:, np.newaxis] * y
        farthest: Numbers = (ahead * turned).max(axis=1)
        return farthest


@dataclass(frozen=True, eq=False)
class LineObservation:
    """Decoded observations of parcels on a line. Each array has the shape (num_envs,)."""

    into_zone: Numbers  # [m] x of the base's centre past the zone's first edge
    to_end: Numbers  # [m] from the base's rear to the zone's end; NaN if not observed
    offset: Numbers  # [m] y of the base's centre from the line's middle
    theta: Numbers  # [rad]
    vx: Numbers  # [m/s]
    vy: Numbers  # [m/s]
    omega: Numbers  # [rad/s]
    half_length: Numbers  # [m] half length of the base, modelled as a square
    pitch: tuple[float, float]  # [m] of the line, in x and in y
    side: Numbers  # goal side: +1 for y > 0, -1 for y < 0, 0 for straight ahead or none
    ratio: Numbers  # [-] goal ratio of exit and entry speed; else 0
    entry_speed: Numbers  # [m/s] entry speed if there is a goal ratio; else 0
    to_go: Numbers  # [m] distance to the goal x; else 0
    angle: Numbers  # [rad] goal theta; else 0

    @property
    def velocity(self) -> tuple[Numbers, Numbers]:
        """(num_envs,) [m/s] vx and vy."""
        return self.vx, self.vy

    @property
    def reach(self) -> Numbers:
        """Half the extent [m] (num_envs,) of the base along x. The extent along y is equal."""
        return square_reach(self.half_length, self.theta)

    @property
    def wholly_in_zone(self) -> NDArray[np.bool_]:
        """(num_envs,) whether no module before the zone carries the parcel."""
        return self.into_zone - self.reach > -self.pitch[0] / 2.0


def decode_line(seen: ObservationTable) -> LineObservation:
    """Decode observations that have the features of `tasks.base` or of Sort."""
    side = seen.get("side")
    # The observation of a parcel with goal y < 0 is mirrored.
    mirror = np.where(side < 0.0, -1.0, 1.0)
    theta = mirror * seen.theta
    half_length = seen["size"]
    if "distance into zone" in seen:
        into_zone = seen["distance into zone"] + seen.reach(half_length, theta, -1.0)
    else:
        into_zone = seen["front in zone"] - seen.reach(half_length, theta, 1.0)
    ratio = seen.get("asked ratio")
    return LineObservation(
        into_zone=into_zone,
        to_end=seen.get("rear to go", math.nan),
        offset=mirror * seen["lateral offset"],
        theta=theta,
        vx=seen["forward speed"],
        vy=mirror * seen["lateral speed"],
        omega=mirror * seen["turning speed"],
        half_length=half_length,
        pitch=(seen.line.pitch_x, seen.line.pitch_y),
        side=side,
        ratio=ratio,
        entry_speed=np.where(ratio > 0.0, seen.get("entry speed"), 0.0),
        to_go=seen.get("to go"),
        angle=seen.get("asked angle"),
    )


def nearest_parcel(parcels: tuple[Parcel, ...], half_length: float) -> Parcel:
    """Return the parcel whose distance from centroid to rear is closest to `half_length` [m]."""
    return min(parcels, key=lambda parcel: abs(parcel.rear + parcel.base.centroid[0] - half_length))


def line_start(
    seen: ObservationTable,
    line: LineObservation,
    parcels: tuple[Parcel, ...],
    goal: tuple[float, ...],
) -> Start:
    """Build a start from a goal, and from row 0 of the decoded observations `seen` and `line`.

    The parcel is `seen.parcel`. If `seen.parcel` is None, the start gets the parcel of `parcels`
    whose size is closest to the observed size.
    """
    base_line = seen.line
    parcel = seen.parcel or nearest_parcel(parcels, float(line.half_length[0]))
    first_column = base_line.site(parcel.base, seen.zone).zone[2]
    return Start(
        parcel,
        (
            base_line.column_edge(first_column) + float(line.into_zone[0]),
            base_line.line_y + float(line.offset[0]),
            float(line.theta[0]),
        ),
        (float(line.vx[0]), float(line.vy[0]), float(line.omega[0])),
        goal,
    )


# Tuned by experiments.
FAILED = 1e3  # cost of a failure, higher than any success
SETTLING = 0.05  # [s] assumed duration of a turning speed until it is corrected


class Nodes(Protocol):
    """Nodes of a search: simulated states, and properties that all nodes share."""

    @property
    def parcels(self) -> ParcelState:
        """State arrays with one row per node."""

    @property
    def line(self) -> BaseLine:
        """The line or field."""

    @property
    def zone(self) -> tuple[int, int, int, int]:
        """First row, number of rows, first column and number of columns of the zone."""

    @property
    def half_length(self) -> float:
        """[m] half length of the base."""

    @property
    def braking(self) -> float:
        """[m/s^2] deceleration over axes at 0 deg."""

    @property
    def rolling_loss(self) -> float:
        """[m/s^2] deceleration over axes at 90 deg."""

    @property
    def quarter_turn(self) -> float:
        """Time [s] in which an axis turns by 90 deg; 0 if axes turn at once."""

    @property
    def vx(self) -> Numbers:
        """(nodes,) [m/s] speed along x after all axes have turned to 90 deg."""

    @property
    def braking_distance(self) -> Numbers:
        """(nodes,) [m] stopping distance along x if all axes turn to 0 deg now."""

    def reach(self, x: float, y: float) -> Numbers:
        """(nodes,) [m] how far the base extends from its centre in a direction (x, y)."""


@dataclass(frozen=True)
class PlanCost:
    """Functions for the costs of nodes in a planner's search, and limits of the search."""

    running: Callable[[Nodes], Numbers]  # cost of running nodes
    final: Callable[[Nodes], Numbers]  # cost of nodes that have ended, or are at the horizon
    enough: float  # final cost at which the search ends
    horizon: int  # [control periods] search depth
    follow: int  # maximum followed periods of a plan
    share: int = 1  # a search gets 1 / share of the planner's budget
    # Two axis angles [rad] of all modules, or None. The search tries every time of a single change
    # from the first to the second.
    event: Callable[[ParcelState], tuple[float, float] | None] = lambda _: None
    zone: tuple[int, int] | None = None  # columns required by a search; None: the environment's
    # [-] which error of friction cannot be undone: 1 if a plan assumes too little and loses speed,
    # -1 if it assumes too much and brakes too late, 0 if neither is worse
    caution: float = 0.0


def way_to_leave(nodes: Nodes) -> Numbers:
    """Compute distances (nodes,) [m] from parcels' rears to the zone's end, or 0 past the end."""
    _, _, first, columns = nodes.zone
    end = nodes.line.column_edge(first + columns)
    return np.maximum(0.0, end - nodes.parcels.truth[:, 0] + nodes.reach(-1.0, 0.0))


def off_line(nodes: Nodes) -> Numbers:
    """Compute the lateral distance [m] (nodes,) of the parcel's centre from the line's middle."""
    return np.abs(nodes.parcels.truth[:, 1] - nodes.line.line_y)


def askew(nodes: Nodes) -> Numbers:
    """Compute a cost (nodes,) of deviations from straight motion along the line's middle."""
    _, _, theta, _, vy, omega = nodes.parcels.truth.T
    return off_line(nodes) + np.abs(vy) + np.abs(theta) + SETTLING * np.abs(omega)


def failure_cost(nodes: Nodes) -> Numbers:
    """Compute the cost (nodes,) of the outcome: 0 for a success, else `FAILED`."""
    return np.where(nodes.parcels.outcome == SUCCESS, 0.0, FAILED)


def time_cost(nodes: Nodes) -> Numbers:
    """Compute the time [s] (nodes,) since the start. For a node without success, add `FAILED`."""
    return failure_cost(nodes) + nodes.parcels.clock


def error_cost(nodes: Nodes) -> Numbers:
    """Compute the absolute value (nodes,) of the task's first metric; add `FAILED` for failures."""
    return failure_cost(nodes) + np.abs(nodes.parcels.metrics[:, 0])
