"""Slow and Stop by choosing, every period, the way to brake that comes out right."""

import math
from abc import abstractmethod
from dataclasses import replace

import numpy as np

from surface_gym.settings import Settings
from surface_gym.tasks.line import BRAKING, ROLLING_LOSS

from ..sight import LineSight, line_sight
from .brake_model import SUPPORT_LOSS, Braked, BrakeModel, Frictions
from .columns import FULL, HALF, LEANS, ROLL, ColumnAxes, Levels
from .footing import Footing, footing
from .friction_estimate import FrictionEstimate
from .lane_rule import Booleans, Commands, LaneRule, Memory, Numbers, Observations

# Found by trying, on other starts than any reported. What is not as reckoned (friction, loads, a
# parcel that drifts onto supports) is made good where braking begins early and gently.
SLOW_GENTLY, STOP_GENTLY = 0.6, 0.3  # [-] of half braking, reckoned with for what is to come
# Of Slow:
SHORT = 3.0  # [-] an m/s short, which nothing gives back, is as bad as so many in excess
CAUTION = 3.0  # [-] standard deviations by which rolling may take more than is estimated
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
    """Predicts each way to brake for a period and takes the one that ends nearest to the goal.

    It remembers how far each column's axes have turned, and learns how much friction acts, beside
    what the sensors have learned of it and of the load.
    """

    def __init__(self, settings: Settings, task: str, then: int) -> None:
        super().__init__(settings, (task,), ("modules",))
        self._model = BrakeModel(settings, LEANS[then])
        self._estimate = FrictionEstimate.of(settings)
        self._commands = ColumnAxes(settings)
        self._columns = self._kind.columns
        self._gently = then == ROLL  # after full braking, axes would take too long to roll
        self._at_once = settings.actuators.axis_speed == math.inf

    @abstractmethod
    def _regret(
        self, see: LineSight, under: Footing, frictions: Frictions, after: Braked
    ) -> Numbers:
        """(lanes, ways) how far from the goal each way leads, by how a period of it ends."""

    def _decide(
        self, observations: Observations, memory: Memory | None, fresh: Booleans
    ) -> tuple[Commands, Memory | None]:
        see = line_sight(self._settings, observations)
        lean, estimate = self._recall(see, memory, fresh)
        learnt = self._estimate.frictions(estimate)
        frictions = replace(learnt, braking=learnt.braking * see.friction)
        under = footing(self._settings, see)
        levels = self._levels(see, under, lean)
        after = self._model.after_a_period(under, see.vx, frictions, lean, LEANS[levels])
        best = self._regret(see, under, frictions, after).argmin(axis=1)
        lanes = np.arange(len(best))
        chosen = levels[lanes, best]
        parts = (see.vx, see.friction * after.braking[lanes, best], after.rolling[lanes, best])
        memory = np.column_stack([self._model.lean_after(lean, LEANS[chosen]), estimate, *parts])
        return self._commands(chosen), memory

    def _recall(
        self, see: LineSight, memory: Memory | None, fresh: Booleans
    ) -> tuple[Numbers, Memory]:
        """(lanes, columns) [rad] each column's axes off 90 deg, and the estimate of friction."""
        lean, estimate = np.zeros((len(see.vx), self._columns)), self._estimate.unknown(len(see.vx))
        if memory is not None:
            on = ~fresh
            lean[on] = memory[on, : self._columns]
            estimate[on] = memory[on, self._columns : -3]
            speed, braking, rolling = memory[on, -3:].T
            estimate[on] = self._estimate.learnt(estimate[on], speed - see.vx[on], braking, rolling)
        return lean, estimate

    def _levels(self, see: LineSight, under: Footing, lean: Numbers) -> Levels:
        """(lanes, ways, columns) of the zone's columns, in each way to brake."""
        ahead = np.maximum(0.0, see.vx) * self._settings.control_period
        pitch = see.pitch[0]
        reached = np.ceil((2.0 * under.half_length + ahead) / pitch).astype(np.int64) + 1
        ways = ways_to_brake(int(reached.max()))
        rear = under.place + under.middle - under.half_length
        place = np.arange(self._columns) - np.floor(rear / pitch).astype(np.int64)[:, np.newaxis]
        near = (place >= 0) & (place < reached[:, np.newaxis])
        levels = ways[:, np.where(near, place, 0)].swapaxes(0, 1)
        levels = np.where(near[:, np.newaxis, :], levels, ROLL)
        if self._at_once:
            return levels
        # On its way from 90 to 0 deg an axis pushes to one side, all of them to the same: a column
        # brakes half before it brakes fully, and so does it before it rolls again.
        between = ((lean < LEANS[HALF] - 1e-6) | self._gently)[:, np.newaxis]
        levels = np.where(between & (levels == FULL), HALF, levels)
        steep = (lean > LEANS[HALF] + 1e-6)[:, np.newaxis]
        return np.where(steep & (levels == ROLL), HALF, levels)


class SlowingRule(BrakingRule):
    """Slow: roll, then brake as much as leaves no speed short of the asked ratio.

    It brakes late, since a slow parcel takes long, yet so that it rolls on for a while at the
    speed it should leave with: that is when the last hundredths are taken.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, "slow", ROLL)

    def _regret(
        self, see: LineSight, under: Footing, frictions: Frictions, after: Braked
    ) -> Numbers:
        held, rolled = deceleration(under.rotor_share, frictions)
        rolled = rolled * (1.0 + CAUTION * frictions.doubt)
        end = (under.place + see.rear_to_go)[:, np.newaxis]
        to_go = np.maximum(0.0, end - after.place)
        asked = (see.ratio * see.entry_speed)[:, np.newaxis]
        excess = after.speed - np.sqrt(asked**2 + 2.0 * rolled[:, np.newaxis] * to_go)
        regret = np.where(excess < 0.0, -SHORT * excess, excess)
        # Rolling comes first among the ways to brake.
        braked = 2.0 * SLOW_GENTLY * held
        over = to_go[:, 0] - (after.speed[:, 0] ** 2 - asked[:, 0] ** 2) / braked
        regret[over > TRIM_TIME * asked[:, 0], 0] = 0.0
        return regret


class StoppingRule(BrakingRule):
    """Stop: brake so that going on at a part of half braking comes to rest at the asked x.

    That leaves room to correct to either side, most of it where braking turns out weak.
    """

    def __init__(self, settings: Settings) -> None:
        super().__init__(settings, "stop", HALF)

    def _regret(
        self, see: LineSight, under: Footing, frictions: Frictions, after: Braked
    ) -> Numbers:
        held = STOP_GENTLY * deceleration(under.rotor_share, frictions)[0]
        asked = (under.place + see.to_go)[:, np.newaxis]
        return np.abs(after.place + after.speed**2 / (2.0 * held[:, np.newaxis]) - asked)


def deceleration(share: Numbers, frictions: Frictions) -> tuple[Numbers, Numbers]:
    """(lanes,) [m/s^2] where every column brakes half, and where all roll.

    Args:
        share: (lanes,) [-] of the elements under the parcel that are rotors.
        frictions: that act on them.
    """
    supports = SUPPORT_LOSS * (1.0 - share)
    lean = LEANS[HALF]
    rolling = frictions.rolling * (ROLLING_LOSS * share + supports)
    slope = ROLLING_LOSS * math.cos(lean) * share + supports
    held = frictions.braking * BRAKING * math.sin(lean) * share + frictions.rolling * slope
    return held, rolling
