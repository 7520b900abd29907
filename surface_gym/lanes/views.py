"""A lane as the physics sees it: views into the batch, no copies."""

from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import Array, Body, Grid
from surface_gym.lanes.memory import (
    ACROSS_FACTOR,
    ALONG_FACTOR,
    COM_HEIGHT,
    COM_X,
    COM_Y,
    GRAVITY_ALONG,
    GRAVITY_NORMAL,
    GYRATION,
    RADIUS,
    SUPPORT_FACTOR,
    Geometry,
    Lanes,
    Sites,
)


@inlined
def grid_of(lanes: Lanes, sites: Sites, lane: int, elements: Geometry, friction: Array) -> Grid:
    """The surface of a lane, of elements with the friction (rows, columns, 3)."""
    return Grid(
        lanes.axis[lane],
        lanes.direction[lane if lanes.direction.shape[0] > 1 else 0],
        sites.rotor[lanes.site[lane]],
        lanes.stiffness[lane if lanes.stiffness.shape[0] > 1 else 0],
        friction,
        elements.x0,
        elements.y0,
        elements.pitch_x,
        elements.pitch_y,
        lanes.surface[lane, ALONG_FACTOR],
        lanes.surface[lane, ACROSS_FACTOR],
        lanes.surface[lane, SUPPORT_FACTOR],
        lanes.surface[lane, GRAVITY_ALONG],
        lanes.surface[lane, GRAVITY_NORMAL],
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
