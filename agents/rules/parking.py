"""Rule of Park: plan to rest at the goal by a beam search over a simple model, in every period.
A node is a state of the parcel in the search. An option is an orientation for the modules ahead of
the parcel's centre, and one for the modules behind it.

In the model, the base is a rectangle or an oval, its weight is spread linearly, and axes take time
to turn. Friction and load are the sensor's estimates. The rule takes the first option of the best
plan, and plans again in the next period.
"""

import math
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from surface_gym.compiler.jit import compiled, inlined, linked
from surface_gym.config import EnvConfig
from surface_gym.physics.types import GRAVITY
from surface_gym.tasks import base
from surface_gym.tasks.park import ARM, ENTRY_X, SPIN_BRAKING, SUCCESS_DISTANCE

from ..base import Integers, Numbers, Singles
from ..planning.planner import ALIKE
from .base import FULL, ROLL, ColumnAxes, Commands, CompiledRule, FixedRule, Observations, rule
from .braking import COM_HEIGHT, ON_EDGE, RECTANGLE, find_power
from .decoding import ParkReading, Sight, add, look_at_park, see_park

WIDTH = 16  # nodes kept per period
HORIZON = 70  # [control periods] depth of the search
STEPS = 4  # steps of the model per period
QUADRANTS = 4
LONG_TURN = 2.0  # [rad] axes that turn by more in a step of the model obey at once
REACH = 3  # modules on each side of the nearest one that may be under the base
SLOWEST = 1e-3  # [m/s] slower parcels rest
UNKNOWN = 1e9  # cost of no plan
NEVER = 1e18  # cost of a node that must not be chosen

# Columns of a node: its motion relative to the goal, then the axes of its quadrants.
LEFT_X, LEFT_Y, LEFT_THETA, VX, VY, OMEGA, AXES = range(7)
NODE = AXES + QUADRANTS


class CostWeights(NamedTuple):
    """Parameters of a node's cost [m]. They were not tuned on the starts of reported results."""

    short: float = 0.15  # [-] per metre short of the goal after full braking
    past: float = 10.0  # [-] per metre past it
    angle: float = 0.3  # [m/rad] per angle after full braking
    lack: float = 6.0  # [s^2/m] per missing energy
    braking: float = 0.9  # [-] deceleration in any direction, relative to full braking
    turn_loss: float = 5.0  # [m/s^2] energy lost by a radian, times the half length
    reserve: float = 0.15  # [m^2/s^2] energy for the last corrections
    enough: float = 0.3  # [-] error of a plan relative to the allowed error that ends the search
    caution: float = 0.9  # [-] planned friction, relative to the estimate; less leaves corrections


WEIGHTS = CostWeights()


class ParkingModel(NamedTuple):
    """Parameters of the model."""

    angles: Numbers  # (choices,) [rad] orientations
    options: Integers  # (options, quadrants) choices
    period: float  # [s]
    turn: float  # [rad] turn of an axis in a step


class ParkingScratch(NamedTuple):
    """Scratch arrays that a search overwrites."""

    x: Numbers  # (modules,) [m] under the base, from its centre
    y: Numbers  # (modules,) [m]
    load: Numbers  # (modules,) [-] share of the weight at constant speed
    shift_x: Numbers  # (modules,) [1/m] change of this share as the weight moves along x
    shift_y: Numbers  # (modules,) [1/m] the same along y
    quadrant: Integers  # (modules,)
    by_x: Numbers  # (modules,) [m/s] loss of speed in a step
    by_y: Numbers  # (modules,) [m/s]
    by_arm: Numbers  # (modules,) [m^2/s]
    axes: Numbers  # (quadrants, 2) cosine and sine
    node: Numbers  # (WIDTH, NODE) nodes of a period
    first: Integers  # (2 WIDTH,) first option of each node's plan, then of each next node's plan
    tried: Numbers  # (WIDTH * options, NODE) nodes of the next period
    cost: Numbers  # (WIDTH * options,) their costs


class ParkingMemory(NamedTuple):
    """Memory of the rule."""

    angle: Numbers  # (num_envs, quadrants) [rad] axes


class ParkingBody(NamedTuple):
    """Properties of the parcel in the rule's model."""

    power: float  # [-] exponent of the oval that stands for the base; 0: a rectangle
    gyration: float  # [m^2] inertia / mass
    goal_x: float  # [m] x at rest of the centre of mass, from the goal
    goal_y: float  # [m]


class Point(NamedTuple):
    """A point of the plane."""

    x: float  # [m]
    y: float  # [m]


@inlined
def place_load(seen: ParkReading, turned: float) -> Point:
    """Return the vector [m] from base centre to centre of mass, turned by `turned` [rad]."""
    cosine = seen.cosine * math.cos(turned) - seen.sine * math.sin(turned)
    sine = seen.sine * math.cos(turned) + seen.cosine * math.sin(turned)
    return Point(
        cosine * seen.load_x - sine * seen.load_y, sine * seen.load_x + cosine * seen.load_y
    )


@inlined
def find_body(seen: ParkReading) -> ParkingBody:
    """Return the model of an observed parcel."""
    power = 0.0 if seen.fill > RECTANGLE else find_power(seen.fill)
    squares = seen.half_length * seen.half_length + seen.half_width * seen.half_width
    load = place_load(seen, seen.turn)
    return ParkingBody(power, squares / (3.0 if power == 0.0 else 3.6), load.x, load.y)


@inlined
def is_under(seen: ParkReading, body: ParkingBody, along: float, across: float) -> bool:
    """Return whether a module at (`along`, `across`) [m] in the base's frame is under the base."""
    along = abs(along) / (seen.half_length + ON_EDGE)
    across = abs(across) / (seen.half_width + ON_EDGE)
    if max(along, across) > 1.0:
        return False
    return body.power == 0.0 or along**body.power + across**body.power <= 1.0


@linked
def place_under(
    seen: ParkReading, body: ParkingBody, node: Numbers, sight: Sight, scratch: ParkingScratch
) -> int:
    """Return the number of modules under the base at the parcel state `node` (NODE,).

    Write positions [m] and loads [-] of these modules to `scratch`.
    """
    theta = seen.turn - node[LEFT_THETA]
    cosine = seen.cosine * math.cos(theta) - seen.sine * math.sin(theta)
    sine = seen.sine * math.cos(theta) + seen.cosine * math.sin(theta)
    load_x, load_y = place_load(seen, theta)
    x = seen.x + seen.along + body.goal_x - node[LEFT_X] - load_x  # of the base's centre
    y = seen.y + seen.across + body.goal_y - node[LEFT_Y] - load_y
    x -= sight.pitch_x * math.floor(x / sight.pitch_x + 0.5)
    y -= sight.pitch_y * math.floor(y / sight.pitch_y + 0.5)
    count, columns = 0, sight.x.shape[0]
    sum_x, sum_y, square_x, square_y = 0.0, 0.0, 0.0, 0.0
    for k in range(columns * sight.y.shape[0]):
        arm_x, arm_y = sight.x[k % columns] - x, sight.y[k // columns] - y
        along, across = cosine * arm_x + sine * arm_y, cosine * arm_y - sine * arm_x
        if is_under(seen, body, along, across):
            scratch.x[count], scratch.y[count] = arm_x - load_x, arm_y - load_y
            scratch.quadrant[count] = (2 if arm_x < 0.0 else 0) + (1 if arm_y < 0.0 else 0)
            sum_x, sum_y = sum_x + scratch.x[count], sum_y + scratch.y[count]
            square_x += scratch.x[count] * scratch.x[count]
            square_y += scratch.y[count] * scratch.y[count]
            count += 1
    # Loads increase linearly towards the centre of mass.
    mean_x, mean_y = sum_x / max(1, count), sum_y / max(1, count)
    spread_x = max(1e-4, square_x - mean_x * sum_x)
    spread_y = max(1e-4, square_y - mean_y * sum_y)
    for k in range(count):
        scratch.shift_x[k] = (scratch.x[k] - mean_x) / spread_x
        scratch.shift_y[k] = (scratch.y[k] - mean_y) / spread_y
        more = mean_x * scratch.shift_x[k] + mean_y * scratch.shift_y[k]
        scratch.load[k] = 1.0 / count - more
    return count


@inlined
def turn_axis(angle: float, target: float, turn: float) -> float:
    """Return the angle [rad] of an axis after it turns towards a target by at most `turn` [rad]."""
    apart = target - angle
    apart -= math.pi * math.floor(apart / math.pi + 0.5)
    return angle + min(turn, max(-turn, apart))


@linked
def advance(
    friction: float, gyration: float, node: Numbers, after: Numbers, option: int, count: int,
    model: ParkingModel, scratch: ParkingScratch,
) -> None:  # fmt: skip
    """Predict the node `after`, which follows `node` by one period. Axes turn as `option` says.

    Args:
        friction: [-] friction that the plan assumes, relative to the nominal mu_max.
        gyration: [m^2] inertia / mass.
        node: (NODE,) node before the period. `after` (NODE,) is the node after the period.
        option: row of `model.options`.
        count: number of modules that `place_under` wrote for `node`.
    """
    dt = model.period / STEPS
    vx, vy, omega = node[VX], node[VY], node[OMEGA]
    left_x, left_y, left_theta = node[LEFT_X], node[LEFT_Y], node[LEFT_THETA]
    for q in range(QUADRANTS):
        after[AXES + q] = node[AXES + q]
    # Braking moves the weight ahead. A first step, which is not taken, finds out how far.
    ahead_x, ahead_y = 0.0, 0.0
    for step in range(-1, STEPS):
        if step < 0 or (step > 0 and model.turn < LONG_TURN):
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
            load = scratch.load[k] + ahead_x * scratch.shift_x[k] + ahead_y * scratch.shift_y[k]
            # Friction is proportional up to the speed it removes in a step: it does not overshoot.
            most = dt * friction * base.BRAKING
            taken = min(most, max(-most, slip / (1.0 + arm * arm / gyration)))
            taken *= max(0.0, load)
            scratch.by_x[k], scratch.by_y[k] = taken * cosine, taken * sine
            scratch.by_arm[k] = taken * arm
        lost_x, lost_y = add(scratch.by_x, count), add(scratch.by_y, count)
        ahead_x = COM_HEIGHT / (GRAVITY * dt) * lost_x
        ahead_y = COM_HEIGHT / (GRAVITY * dt) * lost_y
        if step < 0:
            continue
        after_x, after_y = vx - lost_x, vy - lost_y
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
    """Return the error of a node at rest, divided by the allowed error [-]."""
    distance = math.hypot(node[LEFT_X], node[LEFT_Y])
    return max(distance, ARM * abs(node[LEFT_THETA])) / SUCCESS_DISTANCE


@inlined
def rests(seen: ParkReading, node: Numbers) -> bool:
    """Return whether the parcel is at rest in a node (NODE,)."""
    speed = math.hypot(node[VX], node[VY])
    return speed + abs(node[OMEGA]) * seen.half_length < SLOWEST


@inlined
def find_cost(seen: ParkReading, node: Numbers, weights: CostWeights) -> float:
    """Estimate a node's final error [m], plus a cost if the speed is too low to reach the goal."""
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
    """Return whether two nodes (NODE,) differ by at most `alike` (6,) in pose and velocity."""
    same = True
    for k in range(alike.shape[0]):
        same = same and abs(one[k] - other[k]) <= alike[k]
    return same


@linked
def keep(scratch: ParkingScratch, count: int, options: int, depth: int, alike: Numbers) -> int:
    """Copy the best of `count` tried nodes to `scratch.node`; return the number of copied nodes.

    A duplicate of a better node is not copied. `is_alike` decides which nodes are duplicates.

    Args:
        options: number of options tried from each node. The options of a node are in successive
            rows of `scratch.tried`.
        depth: index of the tried control period in the plan, counted from 0.
        alike: (6,) tolerances of `is_alike`.
    """
    kept = 0
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
    seen: ParkReading, body: ParkingBody, sight: Sight, model: ParkingModel, weights: CostWeights,
    alike: Numbers, scratch: ParkingScratch,
) -> int:  # fmt: skip
    """Return the first option of the best plan that begins at the node `scratch.node[0]`.

    The option is a row of `model.options`. `alike` (6,) are the tolerances of `is_alike`.
    """
    options, friction = model.options.shape[0], weights.caution * seen.friction
    kept, best, least = 1, 0, UNKNOWN
    for depth in range(HORIZON):
        for parent in range(kept):
            node = scratch.node[parent]
            under = place_under(seen, body, node, sight, scratch)
            for option in range(options):
                place = parent * options + option
                after = scratch.tried[place]
                advance(friction, body.gyration, node, after, option, under, model, scratch)
                scratch.cost[place] = find_cost(seen, after, weights)
                if rests(seen, after) or depth == HORIZON - 1:
                    scratch.cost[place] = NEVER
                    error = find_error(after)
                    if error < least:
                        least = error
                        best = option if depth == 0 else scratch.first[parent]
        if least <= weights.enough:
            break
        kept = keep(scratch, kept * options, options, depth, alike)
        if kept == 0:
            break
    return best


@inlined
def begin(seen: ParkReading, body: ParkingBody, node: Numbers) -> None:
    """Write the observed motion of the centre of mass into a node (NODE,); keep the node's axes."""
    load = place_load(seen, 0.0)
    node[LEFT_X] = seen.along + body.goal_x - load.x
    node[LEFT_Y] = seen.across + body.goal_y - load.y
    node[LEFT_THETA] = seen.turn
    node[VX], node[VY] = seen.vx - seen.omega * load.y, seen.vy + seen.omega * load.x
    node[OMEGA] = seen.omega


@compiled
def park(
    observations: Singles, sight: Sight, model: ParkingModel, weights: CostWeights, alike: Numbers,
    scratch: ParkingScratch, angle: Numbers, commands: Integers,
) -> None:  # fmt: skip
    """Write the first option of each environment's best plan to `commands` (num_envs, quadrants).

    `angle` (num_envs, quadrants) [rad] holds the expected angles of axes. The angles are updated.
    """
    for i in range(observations.shape[0]):
        seen = see_park(observations[i], sight)
        body, node = find_body(seen), scratch.node[0]
        begin(seen, body, node)
        for q in range(QUADRANTS):
            node[AXES + q] = angle[i, q]
        best = plan(seen, body, sight, model, weights, alike, scratch)
        for q in range(QUADRANTS):
            commands[i, q] = model.options[best, q]
            target = model.angles[model.options[best, q]]
            angle[i, q] = turn_axis(angle[i, q], target, STEPS * model.turn)


@rule("fixed layout", "park", actions="modules")
class ParkingLayout(FixedRule):
    """Columns at 90 deg, then columns at 0 deg that stop a box at the goal x."""

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, ("park",), ("modules",))
        self._columns = ColumnAxes(config)

    def _layout(self, observations: Observations) -> Commands:
        seen, line = self._config.decode(observations), self._config.chosen_line
        half, goal_x = seen["size"], ENTRY_X + seen["to go along"]
        # Braking increases while the base enters the columns.
        full = 0.5 * seen["forward speed"] ** 2 / base.BRAKING  # [m] of full braking
        entered = np.where(full > half, full + half, np.sqrt(4.0 * half * full))
        zone = self._config.zone or (0, line.columns - 1)
        centres = line.pitch_x * (np.arange(zone[0], zone[1] + 1) + 0.5)
        brakes = centres > (goal_x + half - entered)[:, np.newaxis]
        return self._columns(np.where(brakes, FULL, ROLL))


@rule("parking rule", "park", actions="quadrants", observe=("parcel", "load"))
class ParkingRule(CompiledRule):
    """Rule of Park: a beam search over a simple model, repeated in every period."""

    kernel = staticmethod(park)

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config, ("park",), ("quadrants",))
        self._sight = look_at_park(config, REACH)
        angles = np.array(config.chosen_orientations)
        self._rolling = float(angles[self._axes[0]])
        options = np.array([(a, a, b, b) for a, b in product(range(len(angles)), repeat=2)])
        period = config.control_period
        turn = min(math.pi, config.actuators.axis_speed * period / STEPS)
        self._model = ParkingModel(angles, options, period, turn)
        size = len(self._sight.x) * len(self._sight.y)
        x, y, load, shift_x, shift_y, by_x, by_y, by_arm = np.zeros((8, size))
        tried = WIDTH * len(options)
        self._scratch = ParkingScratch(
            x, y, load, shift_x, shift_y, np.zeros(size, dtype=np.int64), by_x, by_y, by_arm,
            np.zeros((QUADRANTS, 2)), np.zeros((WIDTH, NODE)),
            np.zeros(2 * WIDTH, dtype=np.int64), np.zeros((tried, NODE)), np.zeros(tried),
        )  # fmt: skip

    def make_memory(self, num_envs: int) -> ParkingMemory:
        return ParkingMemory(np.full((num_envs, QUADRANTS), self._rolling))

    def arguments(self, observations: Observations, memory: Any, commands: Commands) -> Any:
        return (
            observations, self._sight, self._model, WEIGHTS, ALIKE, self._scratch,
            memory.angle, commands,
        )  # fmt: skip
