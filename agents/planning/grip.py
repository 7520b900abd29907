"""How hard full braking is along a line: less where supports or stuck modules bear a share."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surface_gym.lines import BaseLine
from surface_gym.physics.types import RADIUS
from surface_gym.state import BodyTable

Booleans = NDArray[np.bool_]
Numbers = NDArray[np.float64]

PIECE = 0.005  # [m] along the line
ON_EDGE = 1e-9  # [m] round-off, by which a point on an edge may lie beyond it


@dataclass(frozen=True, eq=False)
class Grip:
    """What a parcel that runs straight along the line's middle is braked by at most."""

    x: Numbers  # (places,) [m] of its centre, rising
    braking: Numbers  # (places,) [m/s^2]
    spent: Numbers  # (places,) [m^2/s^2] what of half the speed's square braking takes up to there

    def braking_at(self, x: Numbers) -> Numbers:
        """(lanes,) [m/s^2] at some places (lanes,) [m]."""
        return np.interp(x, self.x, self.braking)

    def braking_way(self, x: Numbers, speed: Numbers) -> Numbers:
        """(lanes,) [m] that full braking takes from places (lanes,) [m] on, to end speeds [m/s]."""
        spent = np.interp(x, self.x, self.spent) + 0.5 * speed**2
        ends = np.interp(spent, self.spent, self.x)
        # Past the last place there is nothing to brake.
        beyond = np.maximum(0.0, spent - self.spent[-1])
        return np.maximum(0.0, ends - x) + 1e3 * beyond


def grip_of(
    sites: BodyTable, site: int, plant: BaseLine, braking: float, rolling_loss: float
) -> Grip:
    """The grip on the parcel of a site, every element under it bearing as much.

    Args:
        sites: parcels as they run on the plant.
        site: whose.
        plant: where it runs.
        braking: [m/s^2] where rotors bear it all, all axes at 0 deg.
        rolling_loss: [m/s^2] of axes at 90 deg.
    """
    x = np.arange(plant.column_edge(0), plant.column_edge(plant.columns), PIECE)
    row, column = np.indices((plant.rows, plant.columns)).reshape(2, -1)
    arm_x = plant.origin[0] + plant.pitch_x * column - x[:, np.newaxis]
    arm_y = plant.origin[1] + plant.pitch_y * row - plant.line_y
    under = is_under(sites, site, arm_x, np.broadcast_to(arm_y, arm_x.shape))
    obeying = (under & sites.obeys[site].ravel()).sum(axis=1)
    share = obeying / np.maximum(1, under.sum(axis=1))
    # Nowhere nothing, so that what is spent rises.
    each = np.maximum(rolling_loss, share * braking)
    spent = np.concatenate([[0.0], np.cumsum(0.5 * (each[1:] + each[:-1]) * PIECE)])
    return Grip(x, each, spent)


def is_under(sites: BodyTable, site: int, ahead: Numbers, left: Numbers) -> Booleans:
    """Whether points, of any shape, are under the base of the parcel of a site.

    Args:
        sites: parcels.
        site: whose.
        ahead: [m] of the base's centroid, in its own frame.
        left: [m].
    """
    under: Booleans = np.hypot(ahead, left) <= sites.body[site, RADIUS] + ON_EDGE
    for normal_x, normal_y, distance in sites.edges[site]:
        under &= normal_x * ahead + normal_y * left <= distance + ON_EDGE
    return under
