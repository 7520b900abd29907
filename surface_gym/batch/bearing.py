"""Which element bears how much of a parcel: normal forces as the lanes stand."""

from surface_gym.batch.kernels import Rules
from surface_gym.dynamics.compiled import compiled
from surface_gym.dynamics.contacts import forget_contacts
from surface_gym.dynamics.indexing import bounded
from surface_gym.dynamics.step import bear_load, find_support
from surface_gym.dynamics.types import ARM_X, ARM_Y, NORMAL, Array, Scratch, X, Y
from surface_gym.lanes.memory import Lanes, Sites, Surfaces
from surface_gym.lanes.views import body_of, grid_of


@compiled
def bear_lanes(
    rules: Rules, surfaces: Surfaces, lanes: Lanes, sites: Sites, scratch: Scratch, loads: Array
) -> None:
    """Write the normal force over the mass [m/s^2] of each element into `loads` (lanes, rows,
    columns); 0 where none is.
    """
    table = scratch.table
    elements = rules.elements
    for i in range(lanes.clock.shape[0]):
        for row in range(loads.shape[1]):
            for column in range(loads.shape[2]):
                loads[i, row, column] = 0.0
        site = lanes.site[i]
        grid = grid_of(surfaces, sites, i, site, elements, rules.friction)
        body = body_of(sites, site)
        state = lanes.state[i]
        forget_contacts(scratch)
        contacts = find_support(grid, body, state, scratch, 0.0)
        if contacts.total == 0:
            continue
        bear_load(grid, body, state, scratch, contacts)
        for k in range(contacts.total):
            along = (state[X] + table[ARM_X + k] - elements.x0) / elements.pitch_x
            across = (state[Y] + table[ARM_Y + k] - elements.y0) / elements.pitch_y
            column = round(bounded(along, 0.0, loads.shape[2] - 1))
            row = round(bounded(across, 0.0, loads.shape[1] - 1))
            loads[i, int(row), int(column)] = table[NORMAL + k]
