"""Rule of Park: plan to rest at the goal by a beam search over a simple model, in every period.

The model loads all modules under a square base equally. Axes turn in time, and friction is what the
sensor has estimated. The first action of the best plan is taken, and the rest planned again.
"""

import math
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from surface_gym.compiler.jit import compiled, inlined, linked
from surface_gym.config import EnvConfig
from surface_gym.tasks import base
from surface_gym.tasks.park import ARM, SPIN_BRAKING, SUCCESS_DISTANCE

from ..base import Integers, Numbers, Singles
from .base import Commands, CompiledRule, Observations, rule
from .decoding import ParkReading, Sight, add, look_at_park, see_park

WIDTH = 8  # nodes kept per period
HORIZON = 70  # [control periods] depth of the search
STEPS = 4  # steps of the model per period
QUADRANTS = 4
REACH = 3  # modules on each side of the nearest one that may be under the base
SLOWEST = 1e-3  # [m/s] slower parcels rest
ENOUGH = 0.3  # [-] error of a plan relative to the allowed error at which the search ends
UNKNOWN = 1e9  # cost of no plan
NEVER = 1e18  # cost of what is not to be chosen
# Nodes that differ by less are duplicates.
ALIKE = np.array([0.004, 0.004, 0.02, 0.01, 0.01, 0.1])  # [m, m, rad, m/s, m/s, rad/s]

# Columns of a node: its motion relative to the goal, then the axes of its quadrants.
LEFT_X, LEFT_Y, LEFT_THETA, VX, VY, OMEGA, AXES = range(7)
NODE = AXES + QUADRANTS


class Weights(NamedTuple):
    """Parameters of the cost of a node that still moves [m], tuned on other starts."""

    short: float = 0.15  # [-] per metre short of the goal after full braking
    past: float = 10.0  # [-] per metre past it
    angle: float = 0.3  # [m/rad] per angle after full braking
    lack: float = 3.0  # [s^2/m] per missing energy
    braking: float = 0.9  # [-] deceleration in any direction, relative to full braking
    turn_loss: float = 5.0  # [m/s^2] energy lost by a radian, times the half length
    reserve: float = 0.05  # [m^2/s^2] energy for the last corrections


class ParkingModel(NamedTuple):
    """Parameters of the model."""

    angles: Numbers  # (choices,) [rad] orientations
    options: Integers  # (options, quadrants) choices
    period: float  # [s]
    turn: float  # [rad] turn of an axis in a step


class ParkingScratch(NamedTuple):
    """Arrays of a search; their previous content is unused."""

    x: Numbers  # (modules,) [m] under the base, from its centre
    y: Numbers  # (modules,) [m]
    quadrant: Integers  # (modules,)
    by_x: Numbers  # (modules,) [m/s] loss of speed in a step
    by_y: Numbers  # (modules,) [m/s]
    by_arm: Numbers  # (modules,) [m^2/s]
    axes: Numbers  # (quadrants, 2) cosine and sine
    node: Numbers  # (WIDTH, NODE) nodes of a period
    first: Integers  # (WIDTH,) option by which a node's plan begins
    tried: Numbers  # (WIDTH * options, NODE) nodes of the next period
    cost: Numbers  # (WIDTH * options,) their costs


class ParkingMemory(NamedTuple):
    """Memory of the rule."""

    angle: Numbers  # (num_envs, quadrants) [rad] axes


@linked
def place_under(seen: ParkReading, node: Numbers, sight: Sight, scratch: ParkingScratch) -> int:
    """Write the modules under a node's base, and return their number."""
    theta = seen.turn - node[LEFT_THETA]
    cosine = seen.cosine * math.cos(theta) - seen.sine * math.sin(theta)
    sine = seen.sine * math.cos(theta) + seen.cosine * math.sin(theta)
    x = seen.x + seen.along - node[LEFT_X]
    y = seen.y + seen.across - node[LEFT_Y]
    x -= sight.pitch_x * math.floor(x / sight.pitch_x + 0.5)
    y -= sight.pitch_y * math.floor(y / sight.pitch_y + 0.5)
    count, columns = 0, sight.x.shape[0]
    for k in range(columns * sight.y.shape[0]):
        arm_x, arm_y = sight.x[k % columns] - x, sight.y[k // columns] - y
        along, across = cosine * arm_x + sine * arm_y, cosine * arm_y - sine * arm_x
        if max(abs(along), abs(across)) <= seen.half_length:
            scratch.x[count], scratch.y[count] = arm_x, arm_y
            scratch.quadrant[count] = (2 if arm_x < 0.0 else 0) + (1 if arm_y < 0.0 else 0)
            count += 1
    return count


@inlined
def turn_axis(angle: float, target: float, turn: float) -> float:
    """Return an axis [rad] on its way to the target after a turn of at most `turn` [rad]."""
    apart = target - angle
    apart -= math.pi * math.floor(apart / math.pi + 0.5)
    return angle + min(turn, max(-turn, apart))


@linked
def advance(
    seen: ParkReading, node: Numbers, after: Numbers, option: int, count: int, model: ParkingModel,
    scratch: ParkingScratch,
) -> None:  # fmt: skip
    """Write the node after a period in which the axes turn to an option."""
    dt = model.period / STEPS
    gyration = 2.0 / 3.0 * (seen.half_length * seen.half_length)  # [m^2] of a square
    share = 1.0 / max(1, count)
    vx, vy, omega = node[VX], node[VY], node[OMEGA]
    left_x, left_y, left_theta = node[LEFT_X], node[LEFT_Y], node[LEFT_THETA]
    for q in range(QUADRANTS):
        after[AXES + q] = node[AXES + q]
    for step in range(STEPS):
        if step == 0 or model.turn < 2.0:  # axes that take longer than a step
            for q in range(QUADRANTS):
                target = model.angles[model.options[option, q]]
                half = turn_axis(after[AXES + q], target, 0.5 * model.turn)
                after[AXES + q] = turn_axis(after[AXES + q], target, model.turn)
                scratch.axes[q, 0], scratch.axes[q, 1] = math.cos(half), math.sin(half)
        for k in range(count):
            q = scratch.quadrant[k]
            cosine, sine = scratch.axes[q, 0], scratch.axes[q, 1]
            arm = scratch.x[k] * sine - scratch.y[k] * cosine
            slip = vx * cosine + vy * sine + omega * arm
            # Friction is proportional up to the speed it removes in a step: it does not overshoot.
            most = dt * seen.friction * base.BRAKING
            taken = share * min(most, max(-most, slip / (1.0 + arm * arm / gyration)))
            scratch.by_x[k], scratch.by_y[k] = taken * cosine, taken * sine
            scratch.by_arm[k] = taken * arm
        after_x, after_y = vx - add(scratch.by_x, count), vy - add(scratch.by_y, count)
        after_omega = omega - add(scratch.by_arm, count) / gyration
        left_x -= 0.5 * dt * (vx + after_x)
        left_y -= 0.5 * dt * (vy + after_y)
        left_theta -= 0.5 * dt * (omega + after_omega)
        # Rolling friction acts against the motion.
        kept = max(0.0, 1.0 - dt * base.ROLLING_LOSS / max(1e-9, math.hypot(after_x, after_y)))
        vx, vy, omega = kept * after_x, kept * after_y, after_omega
    after[LEFT_X], after[LEFT_Y], after[LEFT_THETA] = left_x, left_y, left_theta
    after[VX], after[VY], after[OMEGA] = vx, vy, omega


@inlined
def find_error(node: Numbers) -> float:
    """Return the error of a node at rest relative to the allowed error."""
    distance = math.hypot(node[LEFT_X], node[LEFT_Y])
    return max(distance, ARM * abs(node[LEFT_THETA])) / SUCCESS_DISTANCE


@inlined
def rests(seen: ParkReading, node: Numbers) -> bool:
    """Return whether a node's parcel rests."""
    speed = math.hypot(node[VX], node[VY])
    return speed + abs(node[OMEGA]) * seen.half_length < SLOWEST


@inlined
def find_cost(seen: ParkReading, node: Numbers, weights: Weights) -> float:
    """Estimate the error [m] at rest, and add a cost of missing energy to reach the goal."""
    speed = math.hypot(node[VX], node[VY])
    heading_x, heading_y = node[VX] / max(speed, 1e-6), node[VY] / max(speed, 1e-6)
    along = node[LEFT_X] * heading_x + node[LEFT_Y] * heading_y
    across = abs(node[LEFT_Y] * heading_x - node[LEFT_X] * heading_y)
    energy = 0.5 * speed * speed
    short = along - energy / (weights.braking * seen.friction * base.BRAKING)
    spun = node[OMEGA] * abs(node[OMEGA]) * seen.half_length / (2.0 * SPIN_BRAKING)
    turn = abs(node[LEFT_THETA] - spun)
    distance = math.hypot(node[LEFT_X], node[LEFT_Y])
    # Braking along one diagonal turns the velocity; this costs a part of the energy.
    slope = min(1.0, across / max(along, 0.01))
    needed = (
        base.ROLLING_LOSS * distance
        + weights.turn_loss * seen.half_length * turn
        + 2.0 * energy * slope / ((1.0 + slope) * (1.0 + slope))
        + weights.reserve * min(1.0, distance / 0.1)
    )
    missed = weights.short * short if short > 0.0 else -weights.past * short
    lack = max(0.0, needed - energy)
    return missed + across + weights.angle * turn + weights.lack * lack


@inlined
def is_alike(one: Numbers, other: Numbers, alike: Numbers) -> bool:
    """Return whether two nodes are duplicates."""
    for k in range(alike.shape[0]):
        if abs(one[k] - other[k]) > alike[k]:
            return False
    return True


@linked
def keep(scratch: ParkingScratch, count: int, options: int, depth: int, alike: Numbers) -> int:
    """Keep the best of `count` nodes without duplicates, and return their number."""
    kept = 0
    # First options are read before they are replaced, so they are written into new places.
    while kept < WIDTH:
        best = 0
        for k in range(count):
            if scratch.cost[k] < scratch.cost[best]:
                best = k
        if not scratch.cost[best] < UNKNOWN:
            break
        scratch.cost[best] = NEVER
        is_new = True
        for k in range(kept):
            is_new = is_new and not is_alike(scratch.node[k], scratch.tried[best], alike)
        if is_new:
            for k in range(NODE):
                scratch.node[kept, k] = scratch.tried[best, k]
            scratch.first[WIDTH + kept] = (
                best % options if depth == 0 else scratch.first[best // options]
            )
            kept += 1
    for k in range(kept):
        scratch.first[k] = scratch.first[WIDTH + k]
    return kept


@linked
def plan(
    seen: ParkReading, sight: Sight, model: ParkingModel, weights: Weights, alike: Numbers,
    scratch: ParkingScratch,
) -> int:  # fmt: skip
    """Return the first option of the best plan from the first of the scratch's nodes."""
    options = model.options.shape[0]
    kept, best, least = 1, 0, UNKNOWN
    for depth in range(HORIZON):
        for parent in range(kept):
            node = scratch.node[parent]
            under = place_under(seen, node, sight, scratch)
            for option in range(options):
                place = parent * options + option
                after = scratch.tried[place]
                advance(seen, node, after, option, under, model, scratch)
                scratch.cost[place] = find_cost(seen, after, weights)
                if rests(seen, after) or depth == HORIZON - 1:
                    scratch.cost[place] = NEVER
                    error = find_error(after)
                    if error < least:
                        least = error
                        best = option if depth == 0 else scratch.first[parent]
        if least <= ENOUGH:
            break
        kept = keep(scratch, kept * options, options, depth, alike)
        if kept == 0:
            break
    return best


@compiled
def park(
    observations: Singles, sight: Sight, model: ParkingModel, weights: Weights, alike: Numbers,
    scratch: ParkingScratch, angle: Numbers, commands: Integers,
) -> None:  # fmt: skip
    """Choose the first option of the best plan."""
    for i in range(observations.shape[0]):
        seen = see_park(observations[i], sight)
        node = scratch.node[0]
        node[LEFT_X], node[LEFT_Y], node[LEFT_THETA] = seen.along, seen.across, seen.turn
        node[VX], node[VY], node[OMEGA] = seen.vx, seen.vy, seen.omega
        for q in range(QUADRANTS):
            node[AXES + q] = angle[i, q]
        best = plan(seen, sight, model, weights, alike, scratch)
        for q in range(QUADRANTS):
            commands[i, q] = model.options[best, q]
            target = model.angles[model.options[best, q]]
            angle[i, q] = turn_axis(angle[i, q], target, STEPS * model.turn)


@rule("parking rule", "park", actions="quadrants", observe=("load",))
class ParkingRule(CompiledRule):
    """Rule of Park: a beam search over a simple model, repeated in every period."""

    kernel = staticmethod(park)

    def __init__(self, config: EnvConfig, weights: Weights = Weights()) -> None:
        super().__init__(config, ("park",), ("quadrants",))
        self._sight = look_at_park(config, REACH)
        self._weights = weights
        angles = np.array(config.chosen_orientations)
        self._rolling = float(angles[self._axes[0]])
        options = np.array([(a, a, b, b) for a, b in product(range(len(angles)), repeat=2)])
        period = config.control_period
        turn = min(math.pi, config.actuators.axis_speed * period / STEPS)
        self._model = ParkingModel(angles, options, period, turn)
        size = len(self._sight.x) * len(self._sight.y)
        x, y, by_x, by_y, by_arm = np.zeros((5, size))
        tried = WIDTH * len(options)
        self._scratch = ParkingScratch(
            x, y, np.zeros(size, dtype=np.int64), by_x, by_y, by_arm, np.zeros((QUADRANTS, 2)),
            np.zeros((WIDTH, NODE)), np.zeros(2 * WIDTH, dtype=np.int64),
            np.zeros((tried, NODE)), np.zeros(tried),
        )  # fmt: skip

    def make_memory(self, num_envs: int) -> ParkingMemory:
        return ParkingMemory(np.full((num_envs, QUADRANTS), self._rolling))

    def arguments(self, observations: Observations, memory: Any, commands: Commands) -> Any:
        return (
            observations, self._sight, self._model, self._weights, ALIKE, self._scratch,
            memory.angle, commands,
        )  # fmt: skip
