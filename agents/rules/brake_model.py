"""How much a period of braking takes: the line's physics in one dimension."""

import math
from dataclasses import dataclass

import numpy as np

from surface_gym.physics.types import GRAVITY
from surface_gym.settings import Settings
from surface_gym.tasks.line import BRAKING, ROLLING_LOSS

from .footing import Footing
from .lane_rule import Numbers

MOST_AFTER = 24  # steps that axes are followed for after a period
COM_HEIGHT = 0.1  # [m] of the centre of mass: Table 1
SUPPORT_LOSS = 0.005 * GRAVITY  # [m/s^2] mu_support g of Table 1


@dataclass(frozen=True, eq=False)
class Braked:
    """How a period ends, with what its axes bring after it, and what took the speed in it; all
    (lanes, ways).
    """

    place: Numbers  # [m] of the centroid past the zone's first edge, once all axes have turned
    speed: Numbers  # [m/s] then
    braking: Numbers  # [m/s] that friction along the axes takes where it is nominal
    rolling: Numbers  # [m/s] that friction across them and on supports takes where it is nominal


@dataclass(frozen=True, eq=False)
class Frictions:
    """Friction as it shows, in parts of the nominal; (lanes,) each."""

    braking: Numbers  # [-] along axes
    rolling: Numbers  # [-] across them, and on supports
    doubt: Numbers  # [-] standard deviation of `rolling`


class BrakeModel:
    """A parcel that moves straight along the line, its weight shared by what is under it.

    Args:
        settings: whose control period, zone and axes are meant.
        then: [rad] off 90 deg, to which all axes turn after the period: half braking at most.
    """

    def __init__(self, settings: Settings, then: float) -> None:
        self._then = then
        self._timing = settings.timing
        self._columns = settings.action_kind.columns
        self._pitch = settings.chosen_plant.pitch_x
        self._turn = settings.actuators.axis_speed * settings.timing.dt  # [rad] a step
        self._tail = 0  # steps in which axes turn after the period
        if self._turn != math.inf:
            self._tail = min(MOST_AFTER, math.ceil(0.25 * math.pi / self._turn))

    def after_a_period(
        self,
        footing: Footing,
        speed: Numbers,
        frictions: Frictions,
        lean: Numbers,
        target: Numbers,
    ) -> Braked:
        """A period on.

        Args:
            footing: the parcels as they lie now.
            speed: (lanes,) [m/s] now.
            frictions: that act on them.
            lean: (lanes, columns) [rad] of each column's axes off 90 deg now.
            target: (lanes, ways, columns) [rad] to which they turn.
        """
        dt, steps = self._timing.dt, self._timing.steps
        place, half_length = footing.place, footing.half_length
        longest = 2.0 * half_length.max() + max(0.0, speed.max()) * dt * (steps + self._tail)
        first = np.floor((place + footing.middle - half_length) / self._pitch).astype(np.int64)
        near = first[:, np.newaxis] + np.arange(math.ceil(longest / self._pitch) + 2)
        inside = (near >= 0) & (near < self._columns)
        column = np.clip(near, 0, self._columns - 1)
        start = np.where(inside, np.take_along_axis(lean, column, 1), 0.0)[:, np.newaxis, :]
        wide = np.broadcast_to(column[:, np.newaxis, :], (*target.shape[:2], near.shape[1]))
        to_turn = np.where(inside[:, np.newaxis], np.take_along_axis(target, wide, 2), 0.0) - start
        centre = self._pitch * (near + 0.5)[:, np.newaxis, :]
        middle, load = footing.middle[:, np.newaxis], footing.load[:, np.newaxis, np.newaxis]
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
            elements, rotors = _under(footing, arm - middle[..., np.newaxis])
            per_rotor = _loads(arm - load, elements, loss)
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
        """(lanes, columns) [rad] off 90 deg a period on, of axes that turn to `target`, alike."""
        most = self._turn * self._timing.steps
        return lean + np.clip(target - lean, -most, most)


def _under(footing: Footing, arm: Numbers) -> tuple[Numbers, Numbers]:
    """(lanes, ways, columns) elements and rotors of each column that bear.

    Args:
        footing: what lies where.
        arm: (lanes, ways, columns) [m] of each column from the middle of the base's length.
    """
    far = np.abs(arm)
    elements, rotors = np.zeros_like(arm), np.zeros_like(arm)
    reach, rotor = footing.row_reach, footing.rotor
    for row in range(reach.shape[1]):
        covered = far <= reach[:, row, np.newaxis, np.newaxis]
        elements += covered
        rotors += covered & rotor[:, row, np.newaxis, np.newaxis]
    return elements, rotors


def _loads(arm: Numbers, elements: Numbers, before: Numbers) -> Numbers:
    """(lanes, ways, columns) [-] share of the weight that each element of a column bears.

    It is shared as Eq. (1) has it, cut off at nothing.

    Args:
        arm: (lanes, ways, columns) [m] of each column from the load.
        elements: (lanes, ways, columns) of each column that bear.
        before: (lanes, ways) [m/s^2] the deceleration of the last step, which the load leans by.
    """
    count = np.maximum(1.0, elements.sum(axis=-1))
    mean = (elements * arm).sum(axis=-1) / count
    apart = arm - mean[..., np.newaxis]
    spread = np.maximum((elements * apart**2).sum(axis=-1), 1e-9)
    slope = (before * COM_HEIGHT / GRAVITY - mean) / spread
    load = np.maximum(0.0, 1.0 / count[..., np.newaxis] + apart * slope[..., np.newaxis])
    load = np.where(elements > 0.0, load, 0.0)
    weight = np.maximum((load * elements).sum(axis=-1), 1e-9)
    shared: Numbers = load / weight[..., np.newaxis]
    return shared
