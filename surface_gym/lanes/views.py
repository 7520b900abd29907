"""A lane as the physics sees it: views into the batch, no copies."""

from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import COM_HEIGHT, COM_X, COM_Y, GYRATION, RADIUS, Array, Body, Grid
from surface_gym.lanes.memory import (
    ACROSS_FACTOR,
    ALONG_FACTOR,
    GRAVITY_ALONG,
    GRAVITY_NORMAL,
    SUPPORT_FACTOR,
    Geometry,
    Sites,
    Surfaces,
)


@inlined
def grid_of(
    surfaces: Surfaces, sites: Sites, surface: int, site: int, elements: Geometry, friction: Array
) -> Grid:
    """A surface as the parcel of a site finds it; its elements have the friction
    (rows, columns, 3).
    """
    conditions = surfaces.conditions[surface]
    return Grid(
        surfaces.axis[surface],
        surfaces.direction[surface if surfaces.direction.shape[0] > 1 else 0],
        sites.rotor[site if sites.rotor.shape[0] > 1 else 0],
        surfaces.stiffness[surface if surfaces.stiffness.shape[0] > 1 else 0],
        friction,
        elements.x0,
        elements.y0,
        elements.pitch_x,
        elements.pitch_y,
        conditions[ALONG_FACTOR],
        conditions[ACROSS_FACTOR],
        conditions[SUPPORT_FACTOR],
        conditions[GRAVITY_ALONG],
        conditions[GRAVITY_NORMAL],
    )


@inlined
def body_of(sites: Sites, site: int) -> Body:
    """The parcel of a site."""
    return Body(
        sites.edges[site],
        sites.body[site, RADIUS],
        sites.body[site, COM_X],
        sites.body[site, COM_Y],
        sites.body[site, COM_HEIGHT],
        sites.body[site, GYRATION],
    )
