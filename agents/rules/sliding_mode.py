"""Sliding mode along a path: a surface to slide on, and the mix of axes that leads to it."""

import numpy as np

from surface_gym.settings import Settings
from surface_gym.tasks.track import AHEAD

from ..sight import PathSight, path_sight
from .axes import axes_of
from .lane_rule import (
    Booleans,
    Commands,
    LaneRule,
    Memory,
    Numbers,
    Observations,
)
from .modules import Motion, window_places
from .sliding_square import SlidingSquare

PARTS = 6  # that the modules are shared in
# A lattice that spreads any share of the modules evenly: powers of the plastic number's inverse.
SPREAD = (0.7548776662466927, 0.5698402909980532)
STEPS = 4  # that a period is predicted in

# Found by trying, on other starts than any reported. So steep, that most of a distance to the
# surface is the error across the path a period on.
SLOPE = 60.0  # [1/s] of the surface: speed across the path per error across it
SPEED_WEIGHT = 24.0  # [-] of the squared speed error, against the squared distance to the surface
TURN_WEIGHT = 1.5  # [-] of the squared speed of turning, at the base's edge
STRAIGHTENING = 4.0  # [1/s] turning speed back to theta = 0 per angle off it


def mixes(parts: int) -> Commands:
    """(mixes, 3) parts that roll, lead to a side and brake, in every way that adds up."""
    side, brake = np.indices((parts + 1, parts + 1)).reshape(2, -1)
    whole = side + brake <= parts
    return np.stack([parts - side - brake, side, brake], axis=-1)[whole]


def ways_to_lead(settings: Settings) -> Commands:
    """(ways, modules) choices of a window's modules: mixes to either side, spread in two ways."""
    axes = axes_of(settings)
    rows, columns = settings.action_kind.shape
    row, column = np.indices((rows, columns))
    order = np.modf(SPREAD[0] * row + SPREAD[1] * column)[0]
    spreads = np.stack([order.ravel(), order[::-1].ravel()])  # and its mirror image
    rolls, leads, _ = mixes(PARTS).T / PARTS
    first = rolls[:, np.newaxis, np.newaxis] > spreads + 1e-9
    second = (rolls + leads)[:, np.newaxis, np.newaxis] > spreads + 1e-9
    ways = [
        np.select([first, second], [axes.roll, side], axes.brake).reshape(-1, rows * columns)
        for side in (axes.left, axes.right)
    ]
    return np.unique(np.concatenate(ways), axis=0)


class SlidingMode(LaneRule):
    """Track: sliding along s = speed across the path + SLOPE x error across it = 0.

    Every period it takes the mix of axes that should bring the parcel nearest to that surface,
    with the asked speed along the path and without turning. Every heading but 0 and 45 deg takes
    a mix, since there is no axis that rolls along it.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, ("track",), ("window",))
        self._ways = ways_to_lead(settings)
        self._angles = np.array(settings.chosen_orientations)[self._ways]
        self._period = settings.control_period

    def _decide(
        self, observations: Observations, memory: Memory | None, fresh: Booleans
    ) -> tuple[Commands, Memory | None]:
        del memory, fresh
        see = path_sight(self._settings, observations)
        vx, vy = see.velocity
        motion = Motion(vx, vy, see.omega)
        places = window_places(see, self._kind)
        body = SlidingSquare(places, see.half_length, see.tilt)
        after = body.after(motion, self._angles, self._period, STEPS)
        best = self._regret(see, vx, after).argmin(axis=1)
        return self._ways[best], None

    def _regret(self, see: PathSight, vx: Numbers, after: Motion) -> Numbers:
        """(lanes, ways) squared speeds off the surface, the asked speed and no turning."""
        # The path's heading where the parcel will be.
        ahead = np.clip(vx * self._period / AHEAD[1], 0.0, 1.0)
        slope = see.slope[:, 0] + ahead * (see.slope[:, 1] - see.slope[:, 0])
        cosine = (1.0 / np.sqrt(1.0 + slope**2))[:, np.newaxis]
        sine = slope[:, np.newaxis] * cosine
        along = cosine * after.vx + sine * after.vy
        across = cosine * after.vy - sine * after.vx
        mean = 0.5 * (see.cross_speed[:, np.newaxis] + across)
        off = across + SLOPE * (see.cross_error[:, np.newaxis] + self._period * mean)
        late = along - see.asked_speed[:, np.newaxis]
        turn = after.omega + STRAIGHTENING * (see.theta[:, np.newaxis] + self._period * after.omega)
        edge = see.half_length[:, np.newaxis] * turn
        return off**2 + SPEED_WEIGHT * late**2 + TURN_WEIGHT * edge**2
