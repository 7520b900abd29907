"""Slow and Stop by choosing, every period, the braking that ends nearest to the goal."""

import math
from abc import abstractmethod
from dataclasses import dataclass, replace

import numpy as np

import surface_gym as sg
from surface_gym import checks
from surface_gym.config import EnvConfig
from surface_gym.physics.types import GRAVITY
from surface_gym.tasks.base import BRAKING, ROLLING_LOSS
from surface_gym.tasks.planning import LineObservation

from ..base import Booleans, Numbers
from . import base
from .base import BaseRule, ColumnAxes, Decision, Levels, Memory, Observations

MOST_AFTER = 24  # steps that axes are followed for after a period
COM_HEIGHT = 0.1  # [m] of the centre of mass: Table 1
SUPPORT_LOSS = 0.005 * GRAVITY  # [m/s^2] mu_support g of Table 1
ON_EDGE = 1e-6  # [m] an element so near the outline bears: observations are single precision
RECTANGLE = 0.999  # [-] of its rectangle that a base fills at least which is one
# Exponents of the ovals |x / a|^p + |y / b|^p = 1 that others are taken for; how much they fill.
POWERS = np.geomspace(1.2, 60.0, 200)
FILLS = np.array([math.gamma(1.0 + 1.0 / p) ** 2 / math.gamma(1.0 + 2.0 / p) for p in POWERS])


@dataclass(frozen=True, eq=False)
class ContactSpan:
    """Rows of elements under a parcel, rotors or supports, each as far as the base covers it."""

    place: Numbers  # (num_envs,) [m] x of the base's centroid past the zone's first edge
    middle: Numbers  # (num_envs,) [m] from the centroid to the middle of the base's length
    load: Numbers  # (num_envs,) [m] from the centroid to the load, along x
    half_length: Numbers  # (num_envs,) [m]
    row_reach: Numbers  # (num_envs, rows) [m] covered of a row to either side of `middle`; -1: none
    rotor: Booleans  # (num_envs, rows) the row is of rotors

    @property
    def rotor_share(self) -> Numbers:
        """(num_envs,) [-] of the elements under the parcel that are rotors, on average."""
        covered = np.maximum(0.0, self.row_reach)
        return (covered * self.rotor).sum(axis=1) / np.maximum(covered.sum(axis=1), ON_EDGE)


def contact_span(config: EnvConfig, seen: LineObservation) -> ContactSpan:
    """Estimate the contact span of parcels on a line; a base that is no rectangle is taken for an
    oval that fills as much.
    """
    line = config.chosen_line
    end = line.pitch_x * config.action_kind.columns
    rear = end - seen.rear_to_go
    # The size shown is the way from the rear to the centroid, straight on.
    place = rear + seen.reach
    half_length = np.maximum(0.5 * (seen.front_in_zone - rear), 0.5 * line.pitch_x)
    rows = config.action_kind.rows + 2
    y = line.pitch_y * (np.arange(rows) - (rows - 1) / 2.0) - seen.offset[:, np.newaxis]
    aside = np.abs(y) / (seen.half_width[:, np.newaxis] + ON_EDGE)
    power = np.interp(seen.fill, FILLS, POWERS)[:, np.newaxis]
    part = np.maximum(0.0, 1.0 - np.minimum(aside, 1.0) ** power) ** (1.0 / power)
    part = np.where(seen.fill[:, np.newaxis] > RECTANGLE, 1.0, part)
    row_reach = np.where(aside <= 1.0, part * half_length[:, np.newaxis] + ON_EDGE, -1.0)
    # Of a line, as many rows are of rotors as lie under the width.
    half_rows = np.full(len(y), config.action_kind.rows // 2)
    if isinstance(line, sg.lines.Line):
        under = np.floor((seen.half_width + ON_EDGE) / line.pitch_y).astype(np.int64)
        half_rows = np.clip(under, 1, half_rows)
    from_middle = np.abs(np.arange(rows) - (rows - 1) / 2.0)
    return ContactSpan(
        place=place,
        middle=0.5 * (rear + seen.front_in_zone) - place,
        load=seen.load_ahead,
        half_length=half_length,
        row_reach=row_reach,
        rotor=from_middle < half_rows[:, np.newaxis],
    )


@dataclass(frozen=True, eq=False)
class Braked:
    """State after a period and what its axes bring after it, and what took the speed in it; all
    (num_envs, options).
    """

    place: Numbers  # [m] of the centroid past the zone's first edge, once all axes have turned
    speed: Numbers  # [m/s] then
    braking: Numbers  # [m/s] that friction along the axes takes where it is nominal
    rolling: Numbers  # [m/s] that friction across them and on supports takes where it is nominal


@dataclass(frozen=True, eq=False)
class Frictions:
    """Friction as estimated, in parts of the nominal; (num_envs,) each."""

    braking: Numbers  # [-] along axes
    rolling: Numbers  # [-] across them, and on supports
    doubt: Numbers  # [-] standard deviation of `rolling`


class BrakeModel:
    """Predicts braking: the parcel's weight is shared by what is under it.

    Args:
        then: [rad] off 90 deg, to which all axes turn after the period: half braking at most.
    """

    def __init__(self, config: EnvConfig, then: float) -> None:
        self._then = then
        self._timing = config.timing
        self._columns = config.action_kind.columns
        self._pitch = config.chosen_line.pitch_x
        self._turn = config.actuators.axis_speed * config.timing.dt  # [rad] a step
        self._tail = 0  # steps in which axes turn after the period
        if self._turn != math.inf:
            self._tail = min(MOST_AFTER, math.ceil(0.25 * math.pi / self._turn))

    def predict(
        self,
        span: ContactSpan,
        speed: Numbers,
        frictions: Frictions,
        lean: Numbers,
        target: Numbers,
    ) -> Braked:
        """Predict the state a control period on.

        Args:
            lean: (num_envs, columns) [rad] of each column's axes off 90 deg now.
            target: (num_envs, options, columns) [rad] to which they turn.
        """
        dt, steps = self._timing.dt, self._timing.steps
        place, half_length = span.place, span.half_length
        longest = 2.0 * half_length.max() + max(0.0, speed.max()) * dt * (steps + self._tail)
        first = np.floor((place + span.middle - half_length) / self._pitch).astype(np.int64)
        near = first[:, np.newaxis] + np.arange(math.ceil(longest / self._pitch) + 2)
        inside = (near >= 0) & (near < self._columns)
        column = np.clip(near, 0, self._columns - 1)
        start = np.where(inside, np.take_along_axis(lean, column, 1), 0.0)[:, np.newaxis, :]
        wide = np.broadcast_to(column[:, np.newaxis, :], (*target.shape[:2], near.shape[1]))
        to_turn = np.where(inside[:, np.newaxis], np.take_along_axis(target, wide, 2), 0.0) - start
        centre = self._pitch * (near + 0.5)[:, np.newaxis, :]
        middle, load = span.middle[:, np.newaxis], span.load[:, np.newaxis, np.newaxis]
        along, across = (part[:, np.newaxis] for part in (frictions.braking, frictions.rolling))
        x = np.repeat(place[:, np.newaxis], target.shape[1], axis=1)
        v = np.repeat(speed[:, np.newaxis], target.shape[1], axis=1)
        braking, rolling, loss = np.zeros_like(v), np.zeros_like(v), np.zeros_like(v)
        leant = start + to_turn
        turned = 0.0
        sine, cosine = np.sin(leant), np.cos(leant)
        for step in range(steps + self._tail):
            if step == steps:
                start, turned = leant, 0.0
                to_turn = np.where(inside[:, np.newaxis], self._then, 0.0) - start
            if self._tail:
                turned += self._turn
                leant = start + np.clip(to_turn, -turned, turned)
                sine, cosine = np.sin(leant), np.cos(leant)
            arm = centre - (x + 0.5 * dt * v)[:, :, np.newaxis]
            elements, rotors = _count_under(span, arm - middle[..., np.newaxis])
            per_rotor = _share_load(arm - load, elements, loss)
            per_element = per_rotor * elements
            per_rotor = per_rotor * rotors
            brake = BRAKING * (per_rotor * sine).sum(axis=-1)
            roll = ROLLING_LOSS * (per_rotor * cosine).sum(axis=-1)
            roll += SUPPORT_LOSS * (per_element - per_rotor).sum(axis=-1)
            loss = along * brake + across * roll
            slower = np.maximum(0.0, v - dt * loss)
            x += 0.5 * dt * (v + slower)
            v = slower
            if step < steps:
                braking += dt * brake
                rolling += dt * roll
        return Braked(x, v, braking, rolling)

    def lean_after(self, lean: Numbers, target: Numbers) -> Numbers:
        """Predict (num_envs, columns) [rad] off 90 deg a period on, turning to `target`."""
        most = self._turn * self._timing.steps
        return lean + np.clip(target - lean, -most, most)


def _count_under(span: ContactSpan, arm: Numbers) -> tuple[Numbers, Numbers]:
    """Count (num_envs, options, columns) the elements and the rotors of each column that bear."""
    far = np.abs(arm)
    elements, rotors = np.zeros_like(arm), np.zeros_like(arm)
    reach, rotor = span.row_reach, span.rotor
    for row in range(reach.shape[1]):
        covered = far <= reach[:, row, np.newaxis, np.newaxis]
        elements += covered
        rotors += covered & rotor[:, row, np.newaxis, np.newaxis]
    return elements, rotors


def _share_load(arm: Numbers, elements: Numbers, before: Numbers) -> Numbers:
    """Share the weight among the elements of each column (num_envs, options, columns) [-], as
    Eq. (1) does, cut off at nothing.

    Args:
        arm: (num_envs, options, columns) [m] of each column from the load.
        elements: (num_envs, options, columns) of each column that bear.
        before: (num_envs, options) [m/s^2] the deceleration of the last step, by which the load
            leans.
    """
    count = np.maximum(1.0, elements.sum(axis=-1))
    mean = (elements * arm).sum(axis=-1) / count
    apart = arm - mean[..., np.newaxis]
    spread = np.maximum((elements * apart**2).sum(axis=-1), 1e-9)
    slope = (before * COM_HEIGHT / GRAVITY - mean) / spread
    load = np.maximum(0.0, 1.0 / count[..., np.newaxis] + apart * slope[..., np.newaxis])
    load = np.where(elements > 0.0, load, 0.0)
    weight = np.maximum((load * elements).sum(axis=-1), 1e-9)
    return load / weight[..., np.newaxis]


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
        return cls(SEEN_EXACTLY if isinstance(config.sensors, sg.sensors.Exact) else SEEN)

    @staticmethod
    def unknown(num_envs: int) -> Numbers:
        """(num_envs, ESTIMATE_SIZE) nominal frictions, of which nothing is known yet."""
        return np.tile([1.0, 1.0, *UNSURE**2, 0.0], (num_envs, 1))

    @staticmethod
    def frictions(estimate: Numbers) -> Frictions:
        braking, rolling = np.clip(estimate[:, :2], LEAST, MOST).T
        return Frictions(braking, rolling, np.sqrt(np.maximum(0.0, estimate[:, 3])))

    def update(
        self, estimate: Numbers, lost: Numbers, braking: Numbers, rolling: Numbers
    ) -> Numbers:
        """Update (num_envs, ESTIMATE_SIZE) by what a period took.

        Args:
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
    levels = np.concatenate([base.HALF * parts, base.FULL * parts])
    return np.concatenate([np.zeros((1, columns), dtype=np.int64), levels])


class BrakingRule(BaseRule):
    """Predicts each option of braking for a period and takes the one that ends nearest to the goal.

    It remembers how far each column's axes have turned, and estimates how much friction acts,
    beside what the sensors have learned of it and of the load.
    """

    def __init__(self, config: EnvConfig, task: str, then: int) -> None:
        super().__init__(config, (task,), ("modules",))
        self._model = BrakeModel(config, base.LEANS[then])
        self._estimate = FrictionEstimate.for_sensors(config)
        self._commands = ColumnAxes(config)
        self._columns = self._kind.columns
        self._gently = then == base.ROLL  # after full braking, axes would take too long to roll
        self._at_once = config.actuators.axis_speed == math.inf

    @abstractmethod
    def _regret(
        self, seen: LineObservation, span: ContactSpan, frictions: Frictions, after: Braked
    ) -> Numbers:
        """Compute (num_envs, options) how far from the goal each option leads."""

    def _decide(self, observations: Observations, memory: Memory, fresh: Booleans) -> Decision:
        seen = self._config.decode(observations)
        lean, estimate = self._recall(seen, memory, fresh)
        estimated = self._estimate.frictions(estimate)
        frictions = replace(estimated, braking=estimated.braking * seen.friction)
        span = contact_span(self._config, seen)
        levels = self._levels(seen, span, lean)
        after = self._model.predict(span, seen.vx, frictions, lean, base.LEANS[levels])
        best = self._regret(seen, span, frictions, after).argmin(axis=1)
        each = np.arange(len(best))
        chosen = levels[each, best]
        parts = (seen.vx, seen.friction * after.braking[each, best], after.rolling[each, best])
        memory = np.column_stack(
            [self._model.lean_after(lean, base.LEANS[chosen]), estimate, *parts]
        )
        return self._commands(chosen), memory

    def _recall(
        self, seen: LineObservation, memory: Memory, fresh: Booleans
    ) -> tuple[Numbers, Numbers]:
        """Recall (num_envs, columns) [rad] each column's axes off 90 deg, and the estimate of
        friction, updated.
        """
        num_envs = len(seen.vx)
        lean, estimate = np.zeros((num_envs, self._columns)), self._estimate.unknown(num_envs)
        if memory is not None:
            checks.alike("state", memory, np.column_stack([lean, estimate, lean[:, :3]]))
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
        levels = np.where(near[:, np.newaxis, :], levels, base.ROLL)
        if self._at_once:
            return levels
        # On its way from 90 to 0 deg an axis pushes to one side, all of them to the same: a column
        # brakes half before it brakes fully, and so does it before it rolls again.
        between = ((lean < base.LEANS[base.HALF] - 1e-6) | self._gently)[:, np.newaxis]
        levels = np.where(between & (levels == base.FULL), base.HALF, levels)
        steep = (lean > base.LEANS[base.HALF] + 1e-6)[:, np.newaxis]
        return np.where(steep & (levels == base.ROLL), base.HALF, levels)


class SlowingRule(BrakingRule):
    """Slow: roll, then brake as much as leaves no speed short of the asked ratio.

    It brakes late, since a slow parcel takes long, yet so that it rolls on for a while at the
    speed it should leave with: that is when the last hundredths are taken.
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, "slow", base.ROLL)

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
        super().__init__(config, "stop", base.HALF)

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
    lean = base.LEANS[base.HALF]
    rolling = frictions.rolling * (ROLLING_LOSS * share + supports)
    slope = ROLLING_LOSS * math.cos(lean) * share + supports
    held = frictions.braking * BRAKING * math.sin(lean) * share + frictions.rolling * slope
    return held, rolling
