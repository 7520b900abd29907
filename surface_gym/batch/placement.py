"""What a parcel brings to any lane it is placed on."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from surface_gym.dynamics.types import Array, Booleans, Integers
from surface_gym.parcel import Parcel
from surface_gym.plants import Plant
from surface_gym.settings import Settings

NO_EDGE = (0.0, 1.0, 1e9)  # that no point lies beyond, to fill a parcel's edges up


class Placement(NamedTuple):
    """Rows of a lane's memory that follow from the parcel and the plant alone."""

    rotor: Booleans  # (rows, columns)
    obeys: Booleans  # (rows, columns) but for those that are drawn to be stuck
    zone: Integers  # (4,) first row, rows, first column, columns
    body: Array  # (7,) as `Bodies.body`
    edges: Array  # (edges, 3)
    corners: Array  # (corners, 2) [m] from the centroid

    @property
    def sides(self) -> int:
        """Rows that edges and corners take."""
        return max(len(self.edges), len(self.corners))

    def fill(self, sides: int) -> tuple[Array, Array]:
        """Edges (sides, 3) and corners (sides, 2), filled up to that many."""
        edges = np.empty((sides, 3))
        edges[:] = NO_EDGE
        edges[: len(self.edges)] = self.edges
        corners = np.empty((sides, 2))
        corners[:] = self.corners[0]
        corners[: len(self.corners)] = self.corners
        return edges, corners


@lru_cache(maxsize=64)
def placement_of(
    parcel: Parcel,
    plant: Plant,
    zone: tuple[int, int] | None,
    stuck: tuple[tuple[int, int], ...] = (),
) -> Placement:
    """The placement of a parcel on a plant.

    Args:
        parcel: of any base.
        plant: where it runs.
        zone: first and last column that obey; None for the plant's own.
        stuck: (row, column) of modules that do not obey.

    Raises:
        ValueError: the parcel does not fit the plant.
    """
    site = plant.site(parcel.base, zone)
    first_row, rows, first_column, columns = site.zone
    obeys = np.zeros_like(site.rotor)
    obeys[first_row : first_row + rows, first_column : first_column + columns] = True
    for row, column in stuck:
        obeys[row, column] = False
    body = parcel.body
    outline = parcel.base.outline - np.array(parcel.base.centroid)
    half_length = -float(outline[:, 0].min())
    return Placement(
        rotor=site.rotor,
        obeys=obeys & site.rotor,
        zone=np.array(site.zone),
        body=np.array(
            [
                body.radius,
                body.com_x,
                body.com_y,
                body.com_height,
                body.gyration,
                half_length,
                parcel.mass,
            ]
        ),
        edges=body.edges,
        corners=outline if len(body.edges) else np.zeros((1, 2)),
    )


def placement_in(settings: Settings, parcel: Parcel) -> Placement:
    """The placement of a parcel in an environment.

    Raises:
        ValueError: the parcel does not fit the plant.
    """
    stuck = tuple(settings.actuators.stuck)
    return placement_of(parcel, settings.chosen_plant, settings.zone, stuck)
