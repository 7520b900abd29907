"""What a parcel brings to any lane it is placed on."""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from surface_gym import plant
from surface_gym.dynamics.types import Array
from surface_gym.lanes.memory import Booleans
from surface_gym.parcel import Parcel
from surface_gym.plant import Plant

NO_EDGE = (0.0, 1.0, 1e9)  # that no point lies beyond, to fill a parcel's edges up


class Placement(NamedTuple):
    """Rows of a lane's memory that follow from the parcel and the plant alone."""

    rotor: Booleans  # (rows, columns)
    obeys: Booleans  # (rows, columns) if nothing is stuck
    zone: tuple[int, int, int, int]  # first row, rows, first column, columns
    body: Array  # (6,) as `Lanes.body`
    edges: Array  # (edges, 3)
    corners: Array  # (corners, 2) [m] from the centroid
    contacts: int  # most elements that can lie under the base


@lru_cache(maxsize=64)
def placement_of(parcel: Parcel, site_plan: Plant, zone: tuple[int, int] | None) -> Placement:
    """The placement of a parcel on a plant; `zone` holds the first and last column that obey."""
    site = site_plan.site(parcel.base, zone)
    first_row, rows, first_column, columns = site.zone
    obeys = np.zeros_like(site.rotor)
    obeys[first_row : first_row + rows, first_column : first_column + columns] = True
    body = parcel.body
    outline = parcel.base.outline - np.array(parcel.base.centroid)
    half_length = -float(outline[:, 0].min())
    return Placement(
        rotor=site.rotor,
        obeys=obeys & site.rotor,
        zone=site.zone,
        body=np.array(
            [body.radius, body.com_x, body.com_y, body.com_height, body.gyration, half_length]
        ),
        edges=body.edges,
        corners=outline if len(body.edges) else np.zeros((1, 2)),
        contacts=(math.floor(2.0 * body.radius / plant.PITCH) + 2) ** 2,
    )
