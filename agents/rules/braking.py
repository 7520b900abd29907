"""Slow and Stop by choosing, every period, the braking that ends nearest to the goal."""

import math
from abc import abstractmethod
from dataclasses import dataclass, replace

import numpy as np

from surface_gym.config import EnvConfig
from surface_gym.sensors import Exact
from surface_gym.tasks.line import BRAKING, ROLLING_LOSS
from surface_gym.tasks.planning import LineObservation

from .base import (
    FULL,
    HALF,
    LEANS,
    ROLL,
    BaseRule,
    Booleans,
    ColumnAxes,
    Commands,
    Levels,
    Memory,
    Numbers,
    Observations,
)
from .brake_model import SUPPORT_LOSS, Braked, BrakeModel, ContactSpan, Frictions, contact_span

# Found by trying, on other starts than any reported. What is not as predicted (friction, loads, a
# parcel that drifts onto supports) is made good where braking begins early and gently.
SLOW_GENTLY, STOP_GENTLY = 0.6, 0.3  # [-] of half braking, expected of what is to come
# Of Slow:
SHORT = 3.0  # [-] an m/s short, which nothing gives back, is as bad as so many in excess
CAUTION = 3.0  # [-] standard deviations by which rolling may take more than is estimated
TRIM_TIME = 1.2  # [s] to go at the asked speed when half braking should be over

ESTIMATE_SIZE = 5  # numbers of an estimate: two frictions, their variances and covariance
UNSURE = np.array([0.12, 0.12])  # [-] of braking and of rolling, before anything is seen
LEAST, MOST = 0.4, 1.7  # [-] that an estimate is kept to
# What a period's loss of speed may be seen or predicted wrong by.
SEEN_EXACTLY, SEEN = 2e-4, 0.01  # [m/s] where sensors are exact, and else
PREDICTED = 0.16  # [-] of what braking takes: columns come and go, loads lie off centre


@dataclass(frozen=True, eq=False)
class FrictionEstimate:
    """A Kalman filter of two states, friction along axes and across them, in each environment."""

    noise: float  # [m/s] of a loss that is seen

    @classmethod
    def for_sensors(cls, config: EnvConfig) -> "FrictionEstimate":
        return cls(SEEN_EXACTLY if isinstance(config.sensors, Exact) else SEEN)

    @staticmethod
    def unknown(num_envs: int) -> Memory:
        """(num_envs, ESTIMATE_SIZE) nominal frictions, of which nothing is known yet."""
        return np.tile([1.0, 1.0, *UNSURE**2, 0.0], (num_envs, 1))

    @staticmethod
    def frictions(estimate: Memory) -> Frictions:
        braking, rolling = np.clip(estimate[:, :2], LEAST, MOST).T
        return Frictions(braking, rolling, np.sqrt(np.maximum(0.0, estimate[:, 3])))

    def update(self, estimate: Memory, lost: Numbers, braking: Numbers, rolling: Numbers) -> Memory:
        """Update (num_envs, ESTIMATE_SIZE) by what a period took.

        Args:
            estimate: (num_envs, ESTIMATE_SIZE) before.
            lost: (num_envs,) [m/s] of speed in the period, as seen.
            braking: (num_envs,) [m/s] of it by nominal friction along axes.
            rolling: (num_envs,) [m/s] of it by nominal friction across them.
        """
        along, across, var_along, var_across, both = estimate.T
        with_along = var_along * braking + both * rolling
        with_across = both * braking + var_across * rolling
        doubt = self.noise**2 + (PREDICTED * braking) ** 2
        variance = with_along * braking + with_across * rolling + doubt
        surprise = (lost - along * braking - across * rolling) / variance
        return np.stack(
            [
                along + with_along * surprise,
                across + with_across * surprise,
                var_along - with_along**2 / variance,
                var_across - with_across**2 / variance,
                both - with_along * with_across / variance,
            ],
            axis=-1,
        )


def braking_options(columns: int) -> Levels:
    """List (options, columns) the level of each column, the rearmost first; rolling is the first.

    The front or the rear of them brakes, fully or half, and the others roll: a column that is
    about to come under the parcel or to leave it brakes for a part of the period.
    """
    first = np.arange(columns)[:, np.newaxis]
    place = np.arange(columns)
    parts = np.concatenate([place >= first, place <= first[:-1]])
    levels = np.concatenate([HALF * parts, FULL * parts])
    return np.concatenate([np.zeros((1, columns), dtype=np.int64), levels])


class BrakingRule(BaseRule):
    """Predicts each option of braking for a period and takes the one that ends nearest to the goal.

    It remembers how far each column's axes have turned, and estimates how much friction acts,
    beside what the sensors have learned of it and of the load.
    """

    def __init__(self, config: EnvConfig, task: str, then: int) -> None:
        super().__init__(config, (task,), ("modules",))
        self._model = BrakeModel(config, LEANS[then])
        self._estimate = FrictionEstimate.for_sensors(config)
        self._commands = ColumnAxes(config)
        self._columns = self._kind.columns
        self._gently = then == ROLL  # after full braking, axes would take too long to roll
        self._at_once = config.actuators.axis_speed == math.inf

    @abstractmethod
    def _regret(
        self, seen: LineObservation, span: ContactSpan, frictions: Frictions, after: Braked
    ) -> Numbers:
        """Compute (num_envs, options) how far from the goal each option leads."""

    def _decide(
        self, observations: Observations, memory: Memory | None, fresh: Booleans
    ) -> tuple[Commands, Memory | None]:
        seen = self._config.decode(observations)
        lean, estimate = self._recall(seen, memory, fresh)
        estimated = self._estimate.frictions(estimate)
        frictions = replace(estimated, braking=estimated.braking * seen.friction)
        span = contact_span(self._config, seen)
        levels = self._levels(seen, span, lean)
        after = self._model.predict(span, seen.vx, frictions, lean, LEANS[levels])
        best = self._regret(seen, span, frictions, after).argmin(axis=1)
        each = np.arange(len(best))
        chosen = levels[each, best]
        parts = (seen.vx, seen.friction * after.braking[each, best], after.rolling[each, best])
        memory = np.column_stack([self._model.lean_after(lean, LEANS[chosen]), estimate, *parts])
        return self._commands(chosen), memory

    def _recall(
        self, seen: LineObservation, memory: Memory | None, fresh: Booleans
    ) -> tuple[Numbers, Memory]:
        """Recall (num_envs, columns) [rad] each column's axes off 90 deg, and the estimate of
        friction, updated.
        """
        num_envs = len(seen.vx)
        lean, estimate = np.zeros((num_envs, self._columns)), self._estimate.unknown(num_envs)
        if memory is not None:
            on = ~fresh
            lean[on] = memory[on, : self._columns]
            estimate[on] = memory[on, self._columns : -3]
            speed, braking, rolling = memory[on, -3:].T
            lost = speed - seen.vx[on]
            estimate[on] = self._estimate.update(estimate[on], lost, braking, rolling)
        return lean, estimate

    def _levels(self, seen: LineObservation, span: ContactSpan, lean: Numbers) -> Levels:
        """List (num_envs, options, columns) the zone's columns, in each option of braking."""
        ahead = np.maximum(0.0, seen.vx) * self._config.control_period
        pitch = seen.pitch[0]
        reached = np.ceil((2.0 * span.half_length + ahead) / pitch).astype(np.int64) + 1
        options = braking_options(int(reached.max()))
        rear = span.place + span.middle - span.half_length
        place = np.arange(self._columns) - np.floor(rear / pitch).astype(np.int64)[:, np.newaxis]
        near = (place >= 0) & (place < reached[:, np.newaxis])
        levels = options[:, np.where(near, place, 0)].swapaxes(0, 1)
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

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, "slow", ROLL)

    def _regret(
        self, seen: LineObservation, span: ContactSpan, frictions: Frictions, after: Braked
    ) -> Numbers:
        held, rolled = decelerations(span.rotor_share, frictions)
        rolled = rolled * (1.0 + CAUTION * frictions.doubt)
        end = (span.place + seen.rear_to_go)[:, np.newaxis]
        to_go = np.maximum(0.0, end - after.place)
        asked = (seen.ratio * seen.entry_speed)[:, np.newaxis]
        excess = after.speed - np.sqrt(asked**2 + 2.0 * rolled[:, np.newaxis] * to_go)
        regret = np.where(excess < 0.0, -SHORT * excess, excess)
        # Rolling comes first among the options.
        braked = 2.0 * SLOW_GENTLY * held
        over = to_go[:, 0] - (after.speed[:, 0] ** 2 - asked[:, 0] ** 2) / braked
        regret[over > TRIM_TIME * asked[:, 0], 0] = 0.0
        return regret


class StoppingRule(BrakingRule):
    """Stop: brake so that going on at a part of half braking comes to rest at the asked x.

    That leaves room to correct to either side, most of it where braking turns out weak.
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, "stop", HALF)

    def _regret(
        self, seen: LineObservation, span: ContactSpan, frictions: Frictions, after: Braked
    ) -> Numbers:
        held = STOP_GENTLY * decelerations(span.rotor_share, frictions)[0]
        asked = (span.place + seen.to_go)[:, np.newaxis]
        return np.abs(after.place + after.speed**2 / (2.0 * held[:, np.newaxis]) - asked)


def decelerations(share: Numbers, frictions: Frictions) -> tuple[Numbers, Numbers]:
    """Compute the deceleration (num_envs,) [m/s^2] where every column brakes half, and where all
    roll.

    Args:
        share: (num_envs,) [-] of the elements under the parcel that are rotors.
    """
    supports = SUPPORT_LOSS * (1.0 - share)
    lean = LEANS[HALF]
    rolling = frictions.rolling * (ROLLING_LOSS * share + supports)
    slope = ROLLING_LOSS * math.cos(lean) * share + supports
    held = frictions.braking * BRAKING * math.sin(lean) * share + frictions.rolling * slope
    return held, rolling
