"""A batch of lanes: starts are placed on it, commands move it."""

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from surface_gym import plant
from surface_gym.batch.period import advance_lanes, begin_lane
from surface_gym.dynamics.types import GRAVITY, Array
from surface_gym.lanes.memory import Integers, Lanes, Timing, make_batch_scratch, make_lanes
from surface_gym.layouts import ROLLING
from surface_gym.parcel import Parcel
from surface_gym.simulation import start_state
from surface_gym.surface import Surface
from surface_gym.tasks.task import Start, Task

_NO_EDGE = (0.0, 1.0, 1e9)  # that no point lies beyond, to fill a parcel's edges up
_CONVEYOR = (math.cos(ROLLING), math.sin(ROLLING))


@dataclass(frozen=True, eq=False)
class _Placement:
    """What a parcel brings to any lane it is placed on."""

    rotor: NDArray[np.bool_]  # (rows, columns)
    zone: tuple[int, int, int, int]  # first row, rows, first column, columns
    body: Array  # (6,) as `Lanes.body`
    edges: Array  # (edges, 3)
    corners: Array  # (corners, 2) [m] from the centroid
    contacts: int  # most elements that can lie under the base


@lru_cache(maxsize=64)
def _placement(parcel: Parcel, zone: tuple[int, int] | None) -> _Placement:
    line = plant.line_for(parcel.base, zone)
    body = parcel.body
    outline = parcel.base.outline - np.array(parcel.base.centroid)
    half_length = -float(outline[:, 0].min())
    return _Placement(
        rotor=line.rotor,
        zone=line.zone,
        body=np.array(
            [body.radius, body.com_x, body.com_y, body.com_height, body.gyration, half_length]
        ),
        edges=body.edges,
        corners=outline if len(body.edges) else np.zeros((1, 2)),
        contacts=(math.floor(2.0 * body.radius / plant.PITCH) + 2) ** 2,
    )


class Batch:
    """Lanes of one task, one kind of action and one control period.

    Args:
        task: what is asked.
        action: number of the kind of action, of `batch.commands`.
        command_size: numbers in a command of that kind.
        orientations: (choices,) [rad] axis angles on offer.
        lanes: their number.
        timing: how a control period is cut into steps.
        zone: first and last column that obey; None for those after the lead-in.
    """

    def __init__(
        self,
        task: Task,
        action: int,
        command_size: int,
        orientations: Array,
        lanes: int,
        timing: Timing,
        zone: tuple[int, int] | None,
    ) -> None:
        self.task = task
        self.geometry = plant.geometry()
        self._action = action
        self._timing = timing
        self._zone = zone
        self._directions = np.stack([np.cos(orientations), np.sin(orientations)], axis=-1)
        self._command_size = command_size
        self._make(lanes, edges=4, contacts=64)
        nominal = Surface(axis=np.zeros((1, 1)), rotor=np.ones((1, 1), dtype=bool))
        self._surface = (nominal.mu_max, nominal.mu_min, nominal.mu_support, 0.0, GRAVITY)

    def _make(self, lanes: int, edges: int, contacts: int) -> None:
        self.lanes: Lanes = make_lanes(
            lanes,
            plant.ROWS,
            plant.COLUMNS,
            edges,
            self._command_size,
            len(self.task.features),
            len(self.task.terms),
        )
        self._scratch = make_batch_scratch(1, contacts, edges)

    def _make_room(self, placement: _Placement) -> None:
        """Widen the memory for a base of more edges or contacts than any before it."""
        edges = max(self.lanes.edges.shape[1], len(placement.edges), len(placement.corners))
        contacts = max(self._scratch.normal.shape[1], placement.contacts)
        if edges == self.lanes.edges.shape[1] and contacts == self._scratch.normal.shape[1]:
            return
        old = self.lanes
        self._make(len(old.clock), edges, contacts)
        more = edges - old.edges.shape[1]
        wide = {
            "edges": np.concatenate([old.edges, np.tile(_NO_EDGE, (len(old.clock), more, 1))], 1),
            "corners": np.concatenate([old.corners, np.repeat(old.corners[:, :1], more, 1)], 1),
        }
        self.lanes = old._replace(**wide)

    def place(self, lane: int, start: Start) -> None:
        """Put a start on a lane: every axis at 90 deg, as the conveyor's."""
        placement = _placement(start.parcel, self._zone)
        self._make_room(placement)
        lanes = self.lanes
        lanes.state[lane] = start_state(
            start.parcel, np.array(start.pose), np.array(start.velocity)
        )
        lanes.axis[lane] = _CONVEYOR
        lanes.rotor[lane] = placement.rotor
        lanes.surface[lane] = self._surface
        lanes.body[lane] = placement.body
        lanes.edges[lane] = _NO_EDGE
        lanes.edges[lane, : len(placement.edges)] = placement.edges
        lanes.corners[lane] = placement.corners[0]
        lanes.corners[lane, : len(placement.corners)] = placement.corners
        lanes.zone[lane] = placement.zone
        lanes.goal[lane, : len(start.goal)] = start.goal
        begin_lane(self.task.number, lanes, lane, self.geometry)

    def advance(self, commands: Integers) -> None:
        """Move every lane that has not ended over one control period."""
        self.lanes.command[:] = commands
        advance_lanes(
            self.task.number,
            self._action,
            self.lanes,
            0,
            len(self.lanes.clock),
            self.geometry,
            self._timing,
            self._directions,
            self._scratch,
            0,
        )
