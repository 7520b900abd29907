"""Orient by choosing, every period, the way to turn that comes out right."""

import numpy as np

from surface_gym.settings import Settings

from ..sight import LineSight, line_sight
from .aims import wholly_in_zone
from .axes import axes_of
from .lane_rule import (
    Booleans,
    Commands,
    LaneRule,
    Memory,
    Numbers,
    Observations,
)
from .modules import Motion, Places, line_places
from .sliding_square import SlidingSquare

STEPS = 4  # that a period is predicted in

# Found by trying, on other starts than any reported.
END_OF_TURN = 2.2  # [m rad/s^2] that 90 deg everywhere slows a turn by, times the half length
SPEED_WORTH = 0.11  # [rad s/m] off the asked angle that a loss of speed is as bad as
DRIFT_WORTH = 0.3  # [rad s/m] off the asked angle that a speed across the line is as bad as
CLOSE_ENOUGH = 0.015  # [rad] off the asked angle, where 0.035 is allowed: as good as on it
WORTH_IT = 0.004  # [rad] by which turning must be better than rolling
# [-] of the half length ahead of and behind the centre, from where on modules turn the parcel.
FROM = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0])


class TurningRule(LaneRule):
    """Orient: 45 deg one way ahead of the centre and the other way behind it turn the parcel, and
    90 deg everywhere ends that. Each period, those modules turn it that should make it come to
    rest nearest to the asked angle, speed and drift counted in.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, ("orient",), ("modules",))
        self._axes = axes_of(settings)
        self._angles = np.array(settings.chosen_orientations)
        self._period = settings.control_period

    def _decide(
        self, observations: Observations, memory: Memory | None, fresh: Booleans
    ) -> tuple[Commands, Memory | None]:
        del memory, fresh
        see = line_sight(self._settings, observations)
        places = line_places(see, self._kind)
        ways = self._ways(see, places)
        body = SlidingSquare(places, see.half_length, np.zeros_like(see.theta))
        motion = Motion(see.vx, see.vy, see.omega)
        after = body.after(motion, self._angles[ways], self._period, STEPS)
        best = self._regret(see, after).argmin(axis=1)
        return ways[np.arange(len(best)), best], None

    def _ways(self, see: LineSight, places: Places) -> Commands:
        """(lanes, ways, modules) choices; rolling is the first."""
        axes = self._axes
        x = places.x[:, np.newaxis]
        inside = wholly_in_zone(see)[:, np.newaxis, np.newaxis]
        start = (FROM * see.half_length[:, np.newaxis])[..., np.newaxis]
        ahead, behind = inside & (x > start), inside & (x < -start)
        ways = [np.full_like(x, axes.roll, dtype=np.int64)]
        for front, rear in ((axes.left, axes.right), (axes.right, axes.left)):
            ways += [
                np.select([ahead, behind], [front, rear], axes.roll),
                np.where(ahead, front, axes.roll),
                np.where(behind, rear, axes.roll),
            ]
        return np.concatenate(ways, axis=1)

    def _regret(self, see: LineSight, after: Motion) -> Numbers:
        """(lanes, ways) [rad] off the asked angle at rest, and what else is as bad."""
        turn = 0.5 * self._period * (see.omega[:, np.newaxis] + after.omega)
        end = after.omega * np.abs(after.omega) * see.half_length[:, np.newaxis]
        left = (see.angle - see.theta)[:, np.newaxis] - turn - end / (2.0 * END_OF_TURN)
        off = np.maximum(0.0, np.abs(left) - CLOSE_ENOUGH)
        regret = off - SPEED_WORTH * after.vx + DRIFT_WORTH * np.abs(after.vy)
        regret[:, 0] -= WORTH_IT
        return regret
