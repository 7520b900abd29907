"""Slow and Stop by choosing, every period, the way to brake that comes out right."""

from abc import abstractmethod

import numpy as np

from surface_gym.settings import Settings
from surface_gym.tasks.line import BRAKING, ROLLING_LOSS

from ..sight import LineSight, line_sight
from .brake_model import BrakeModel
from .columns import FULL, HALF, ROLL, SHARES, ColumnAxes, Levels
from .lane_rule import Booleans, Commands, LaneRule, Memory, Numbers, Observations

HELD = ROLLING_LOSS + (BRAKING - ROLLING_LOSS) * SHARES[HALF]  # [m/s^2] every column braking half

# Of Slow; found by trying, on other starts than any reported.
SHORT = 20.0  # [-] an m/s short, which nothing gives back, is as bad as so many in excess
TRIM_TIME = 1.2  # [s] to go at the asked speed when half braking should be over


def ways_to_brake(columns: int) -> Levels:
    """(ways, columns) the level of each column in turn, the rearmost first; rolling is the first.

    The front or the rear of them brakes, fully or half, and the others roll: a column that is
    about to come under the parcel or to leave it brakes for a part of the period.
    """
    first = np.arange(columns)[:, np.newaxis]
    place = np.arange(columns)
    parts = np.concatenate([place >= first, place <= first[:-1]])
    levels = np.concatenate([HALF * parts, FULL * parts])
    return np.concatenate([np.zeros((1, columns), dtype=np.int64), levels])


class BrakingRule(LaneRule):
    """Predicts each way to brake for a period and takes the one that ends nearest to the goal."""

    def __init__(self, settings: Settings, task: str) -> None:
        super().__init__(settings, (task,), ("modules",))
        self._model = BrakeModel(settings)
        self._commands = ColumnAxes(settings)
        self._columns = self._kind.columns

    @abstractmethod
    def _regret(self, see: LineSight, place: Numbers, speed: Numbers) -> Numbers:
        """(lanes, ways) how far from the goal each way leads, by where a period of it ends."""

    def _decide(
        self, observations: Observations, memory: Memory | None, fresh: Booleans
    ) -> tuple[Commands, Memory | None]:
        del memory, fresh
        see = line_sight(self._settings, observations)
        levels = self._levels(see)
        place, speed = self._model.after_a_period(
            see.into_zone, see.vx, see.half_length, SHARES[levels]
        )
        best = self._regret(see, place, speed).argmin(axis=1)
        return self._commands(levels[np.arange(len(best)), best]), None

    def _levels(self, see: LineSight) -> Levels:
        """(lanes, ways, columns) of the zone's columns, in each way to brake."""
        ahead = np.maximum(0.0, see.vx) * self._settings.control_period
        pitch = see.pitch[0]
        reached = np.ceil((2.0 * see.half_length + ahead) / pitch).astype(np.int64) + 1
        ways = ways_to_brake(int(reached.max()))
        rearmost = np.floor((see.into_zone - see.half_length) / pitch).astype(np.int64)
        place = np.arange(self._columns) - rearmost[:, np.newaxis]
        near = (place >= 0) & (place < reached[:, np.newaxis])
        levels = ways[:, np.where(near, place, 0)].swapaxes(0, 1)
        return np.where(near[:, np.newaxis, :], levels, ROLL)


class SlowingRule(BrakingRule):
    """Slow: roll, then brake as much as leaves no speed short of the asked ratio.

    It brakes late, since a slow parcel takes long, yet so that it rolls on for a while at the
    speed it should leave with: that is when the last hundredths are taken.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, "slow")

    def _regret(self, see: LineSight, place: Numbers, speed: Numbers) -> Numbers:
        end = see.pitch[0] * self._columns + see.reach
        to_go = np.maximum(0.0, end[:, np.newaxis] - place)
        asked = (see.ratio * see.entry_speed)[:, np.newaxis]
        excess = speed - np.sqrt(asked**2 + 2.0 * ROLLING_LOSS * to_go)
        regret = np.where(excess < 0.0, -SHORT * excess, excess)
        # Rolling comes first among the ways to brake.
        over = to_go[:, 0] - (speed[:, 0] ** 2 - asked[:, 0] ** 2) / (2.0 * HELD)
        regret[over > TRIM_TIME * asked[:, 0], 0] = 0.0
        return regret


class StoppingRule(BrakingRule):
    """Stop: brake so that going on at half braking comes to rest at the asked x.

    Half braking leaves room to correct to either side, and is the same whichever columns bear.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, "stop")

    def _regret(self, see: LineSight, place: Numbers, speed: Numbers) -> Numbers:
        asked = (see.into_zone + see.to_go)[:, np.newaxis]
        return np.abs(place + speed**2 / (2.0 * HELD) - asked)
