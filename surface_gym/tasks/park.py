"""Park: come to rest at a goal pose."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.canvas import Canvas, draw_line
from surface_gym.compiler.jit import kernel_function
from surface_gym.lines import Field
from surface_gym.physics.types import HALF_LENGTH, OMEGA, THETA, VX, VY, X, Y
from surface_gym.state import RUNNING, SUCCESS, EnvState, is_driven, is_slower, planar_speed
from surface_gym.tasks import base, planning
from surface_gym.tasks.benchmark import Benchmark, high_column, median_column
from surface_gym.tasks.features import Feature, columns, show, show_bent
from surface_gym.tasks.start import Draw, Numbers, Start, between

GOAL_X, GOAL_Y, GOAL_THETA = range(3)  # indices in the goal: [m], [m], [rad] of the centre
REMAINING = 0  # index in the memory: [m] remaining way at the last decision
DISTANCE, ANGLE_ERROR = range(2)  # indices in the metrics: [m] to the goal, [rad] theta - goal

OUTCOMES = ("off the surface", "off the line", "missed")
OFF_SURFACE, OFF_LINE, MISSED = base.failures(OUTCOMES)
SUCCESS_DISTANCE = 0.005  # [m]
SUCCESS_ANGLE = math.radians(2.0)  # [rad]
ARM = SUCCESS_DISTANCE / SUCCESS_ANGLE  # [m] an angle error times this counts as a distance
ENTRY_X = 0.4  # [m] of the centre
MOST_AHEAD, MOST_ASIDE = 1.4, 0.6  # [m] limits of goals from the entry
SPIN_BRAKING = 2.2  # [m rad/s^2] angular deceleration by 90 deg, times the half length

# The reward, term by term.
TERMS: tuple[str, ...] = ("approach", "precision", "success", "failure")
APPROACH_REWARD = 1.0  # per metre nearer
PRECISION_REWARD = 2.0  # for resting at the goal, decreasing with the error
PRECISION_SCALE = 0.01  # [m] error that divides the reward by e
SUCCESS_REWARD = 2.0
FAILURE_REWARD = -1.0

FEATURES = (
    base.OFFSET, *base.DIRECTION, base.FORWARD_SPEED, base.LATERAL_SPEED, base.TURNING_SPEED,
    base.SIZE, *base.PHASE,
    Feature("to go along", -20.0, 20.0, "x of the goal minus x of the centre", "m", 0.5),
    Feature("to go along, near", -1.0, 1.0, "distance to go along on a finer scale", "m", 0.05, bent=True),
    Feature("to go along, nearest", -1.0, 1.0, "distance to go along on the finest scale", "m", 0.01, bent=True),
    Feature("to go across", -20.0, 20.0, "y of the goal minus y of the centre", "m", 0.2),
    Feature("to go across, near", -1.0, 1.0, "distance to go across on a finer scale", "m", 0.05, bent=True),
    Feature("to go across, nearest", -1.0, 1.0, "distance to go across on the finest scale", "m", 0.01, bent=True),
    Feature("angle to turn", -1000.0, 1000.0, "goal theta minus theta", "rad", 0.3),
    Feature("angle to turn, near", -1.0, 1.0, "angle to turn on a finer scale", "rad", SUCCESS_ANGLE, bent=True),
    Feature("short along", -100.0, 100.0, "x of the goal minus x of the place where full braking (0.5 g) stops the centre", "m", 0.2),
    Feature("short along, near", -1.0, 1.0, "short along on a finer scale", "m", 0.03, bent=True),
    Feature("short across", -100.0, 100.0, "y of the goal minus y of the place where full braking (0.5 g) stops the centre", "m", 0.2),
    Feature("short across, near", -1.0, 1.0, "short across on a finer scale", "m", 0.03, bent=True),
    Feature("short of the angle", -1000.0, 1000.0, "goal theta minus the theta that the parcel has after full braking", "rad", 0.3),
)  # fmt: skip
COLUMN = columns(FEATURES)
GOAL_FEATURES = tuple(each.name for each in FEATURES[COLUMN.to_go_along.place :])


@dataclass(frozen=True)
class Park(base.Task):
    """Come to rest at a goal pose: x, y and theta.

    A parcel enters a level field of rotors. It must stop within 5 mm and 2 deg of a goal pose. The
    entry speed is the parcel's only energy. Moving aside, turning and braking use this energy, so a
    parcel that stops before the goal cannot move on. A parcel rolls freely only in the directions
    0, 45, -45 and 90 deg. In all other directions, the axes brake the parcel.

    **Start.** The centre is 0.4 m past the field's first edge, on the field's middle, with theta 0
    and speed along x only. The entry speed is uniform in `speeds`. The default parcels are S- and
    B-boxes at equal odds. The goal is uniform: its x and y relative to the start are in
    `ahead` and `aside`, and its theta is in `angles`. A planner with the true model reached all 40
    random goals (`python -m benchmarks.park`). Slow parcels and goals far ahead or aside may have
    no solution.

    **Goal and end.** The parcel is at rest when no point of the base moves faster than 1 mm/s.
    "success": the parcel is at rest, with its centre within 5 mm and its theta within 2 deg of the
    goal. Theta counts full turns, so one turn too much is an error of 360 deg. If the
    parcel is at rest elsewhere, the outcome is "missed". Other
    [failures](../environments/environment.md#end) are "off the line" and "off the surface".

    ### Reward

    | term | scale | meaning |
    | --- | --- | --- |
    | `approach` | 1 per metre | decrease of the remaining way |
    | `precision` | 2 | once, at rest: exp(-remaining way / 10 mm) |
    | `success` | 2 | once, at success |
    | `failure` | -1 | once, at any failure |

    The remaining way is the root of distance^2 + angle error^2, where an angle error of 2 deg
    counts as 5 mm. `info` has `distance` [m] from the centre to the goal, and `angle_error` [rad]:
    current theta - goal theta, with its sign. `surface_gym.goal_env.GoalEnv` makes a goal
    environment with a sparse reward, for [HER](../comparison.md#park).

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Park-v0", actions="halves")
        >>> start = {"speed": 1.5, "parcel": "S", "ahead": 0.7, "aside": 0.1, "angle": 0.3}
        >>> observation, info = env.reset(options=start)
        >>> observation, reward, terminated, truncated, info = env.step(15)  # all axes at 90 deg
        >>> info["outcome"], round(info["distance"], 3), info["angle_error"]
        ('running', 0.648, -0.3)
    """

    speeds: tuple[float, float] = (1.2, 1.6)  # [m/s] entry speed
    ahead: tuple[float, float] = (0.5, 0.9)  # [m] x of the goal from the entry
    aside: tuple[float, float] = (-0.2, 0.2)  # [m] y of the goal from the entry
    angles: tuple[float, float] = (-math.pi / 6, math.pi / 6)  # [rad] goal theta

    line = Field(rows=16, columns=20)
    features = FEATURES
    goal_features = GOAL_FEATURES
    terms = TERMS
    outcomes = OUTCOMES
    metrics = ("distance", "angle_error")
    options = ("speed", "parcel", "ahead", "aside", "angle")
    ranges = {
        "speeds": (0.0, 5.0),
        "ahead": (0.0, MOST_AHEAD),
        "aside": (-MOST_ASIDE, MOST_ASIDE),
        "angles": (-math.pi, math.pi, checks.DEGREES),
    }
    draws = 5
    goals = 3
    memories = 1
    periods = 150

    def start(self, draw: Draw) -> Start:
        """Draw entry speed, parcel and goal pose from uniform distributions."""
        pace, size, way, side, turn = draw.numbers
        speed = draw.within("speed", between(*self.speeds, pace), 0.0, 5.0)
        parcel = draw.parcel(self.parcels, size)
        ahead = draw.within("ahead", between(*self.ahead, way), 0.0, MOST_AHEAD)
        aside = draw.within("aside", between(*self.aside, side), -MOST_ASIDE, MOST_ASIDE)
        angle = draw.angle("angle", between(*self.angles, turn), -math.pi, math.pi)
        x, y = draw.line.column_edge(0) + ENTRY_X, draw.line.line_y
        centre_x, centre_y = parcel.of(lambda each: each.base.centroid).T
        pose = (x - centre_x, y - centre_y, 0.0)
        return Start(parcel, pose, (speed, 0.0, 0.0), (x + ahead, y + aside, angle))

    def decode(self, seen: planning.ObservationTable) -> planning.ObservationTable:
        """Return the observations unchanged; rules read features from them by name."""
        return seen

    def decode_start(self, seen: planning.ObservationTable) -> Start:
        """Decode the first observation into a start near the entry.

        The observation shows x only relative to the nearest module. All modules of the field are
        alike, so the start is at the module nearest to the entry.
        """
        line, column = seen.line, round(ENTRY_X / seen.line.pitch_x)
        x = line.origin[0] + line.pitch_x * column + float(seen.in_pitch("x", line.pitch_x)[0])
        pose = (x, line.line_y + float(seen["lateral offset"][0]), float(seen.theta[0]))
        vx, vy, omega = (
            float(seen[f"{way} speed"][0]) for way in ("forward", "lateral", "turning")
        )
        to_go = (seen[name][0] for name in ("to go along", "to go across", "angle to turn"))
        goal = tuple(float(at + left) for at, left in zip(pose, to_go, strict=True))
        parcel = planning.nearest_parcel(self.parcels, float(seen["size"][0]))
        return Start(parcel, pose, (vx, vy, omega), goal)

    def check_goal(self, goal: Numbers) -> None:
        super().check_goal(goal[:GOAL_THETA])
        checks.within("goal[2]", goal[GOAL_THETA], -math.pi, math.pi)

    def achieved(self, state: EnvState) -> tuple[float, ...]:
        """Return the sensed pose [m, m, rad], and the sensed speed of the fastest point [m/s]."""
        x, y, theta = state.sensed[X], state.sensed[Y], state.sensed[THETA]
        return x, y, theta, base.sensed_speed(state)

    def asked(self, state: EnvState) -> tuple[float, ...]:
        return (*state.goal, 0.0)

    def reached(self, achieved: Numbers, asked: Numbers) -> NDArray[np.bool_]:
        x, y, theta, speed = np.moveaxis(achieved - asked, -1, 0)
        near = np.hypot(x, y) <= SUCCESS_DISTANCE
        return np.asarray(near & (np.abs(theta) <= SUCCESS_ANGLE) & (speed < base.STALL_SPEED))

    def cost(self) -> planning.PlanCost:
        return planning.PlanCost(
            _running_cost, _final_cost, 0.5, self.periods, self.periods, caution=-1.0
        )

    def benchmark(self) -> Benchmark:
        """Return random starts, and result columns for the errors in position and angle."""
        degrees = 180.0 / math.pi
        return Benchmark(
            self,
            (
                median_column("distance", "distance median [mm]", "from the goal", ".1f", 1e3),
                high_column("distance", "distance 90 % [mm]", ".1f", 1e3),
                median_column("angle_error", "angle median [deg]", "off the goal", scale=degrees),
                high_column("angle_error", "angle 90 % [deg]", scale=degrees),
            ),
            example={"speed": 1.5, "parcel": "S", "ahead": 0.7, "aside": 0.1, "angle": 0.3},
            example_description="the S-box at 1.5 m/s, 0.7 m ahead, 0.1 m aside, turned by 17 deg",
            error="distance",
        )

    def readings(self, state: EnvState) -> list[tuple[str, str]]:
        distance, angle = state.metrics
        return [
            ("to go", f"{1e3 * distance:.1f} mm"),
            ("to turn", f"{-math.degrees(angle):+.1f}\N{DEGREE SIGN}"),
        ]

    def goal(self, state: EnvState) -> Any:
        """Return a short straight path that ends at the goal, along the goal's theta."""
        from surface_gym.rendering import Path

        x, y, theta = state.goal
        length = 2.0 * state.body[HALF_LENGTH]
        return Path([(x - length * math.cos(theta), y - length * math.sin(theta)), (x, y)])

    @staticmethod
    @kernel_function
    def begin(state: EnvState) -> None:
        """Write the metrics, and store the remaining way (see `_remaining`) for the reward."""
        _measure(state)
        state.memory[REMAINING] = _remaining(state)

    @staticmethod
    @kernel_function
    def outcome(state: EnvState) -> int:
        """Compute the outcome from the true motion, and write the metrics."""
        _measure(state)
        if not state.on_surface:
            return OFF_SURFACE
        if not state.on_rotors:
            return OFF_LINE
        if not is_slower(state, base.STALL_SPEED):
            return RUNNING
        metrics = state.metrics
        if metrics[DISTANCE] <= SUCCESS_DISTANCE and abs(metrics[ANGLE_ERROR]) <= SUCCESS_ANGLE:
            return SUCCESS
        return RUNNING if is_driven(state) else MISSED  # driven modules may move it again

    @staticmethod
    @kernel_function
    def reward(state: EnvState, outcome: int) -> None:
        """Reward approach to the goal pose, and a stop near the goal pose. Penalise failures."""
        remaining = _remaining(state)
        rests = outcome in (SUCCESS, MISSED)
        terms = state.terms
        terms[0] = APPROACH_REWARD * (state.memory[REMAINING] - remaining)
        terms[1] = PRECISION_REWARD * math.exp(-remaining / PRECISION_SCALE) if rests else 0.0
        terms[2] = SUCCESS_REWARD if outcome == SUCCESS else 0.0
        terms[3] = FAILURE_REWARD if outcome > SUCCESS else 0.0
        state.memory[REMAINING] = remaining

    @staticmethod
    @kernel_function
    def observe(state: EnvState) -> None:
        """Write the observation from the sensed pose and velocity."""
        sensed, see, goal = state.sensed, state.observation, state.goal
        base.show_on_line(state, COLUMN, 1.0)
        along, across = goal[GOAL_X] - sensed[X], goal[GOAL_Y] - sensed[Y]
        angle = goal[GOAL_THETA] - sensed[THETA]
        show(see, COLUMN.to_go_along, along)
        show_bent(see, COLUMN.to_go_along_near, along)
        show_bent(see, COLUMN.to_go_along_nearest, along)
        show(see, COLUMN.to_go_across, across)
        show_bent(see, COLUMN.to_go_across_near, across)
        show_bent(see, COLUMN.to_go_across_nearest, across)
        show(see, COLUMN.angle_to_turn, angle)
        show_bent(see, COLUMN.angle_to_turn_near, angle)
        braked = planar_speed(sensed) / (2.0 * base.BRAKING)
        spun = abs(sensed[OMEGA]) * state.body[HALF_LENGTH] / (2.0 * SPIN_BRAKING)
        along -= braked * sensed[VX]
        across -= braked * sensed[VY]
        show(see, COLUMN.short_along, along)
        show_bent(see, COLUMN.short_along_near, along)
        show(see, COLUMN.short_across, across)
        show_bent(see, COLUMN.short_across_near, across)
        show(see, COLUMN.short_of_the_angle, angle - spun * sensed[OMEGA])

    @staticmethod
    @kernel_function
    def draw_goal(state: EnvState, canvas: Canvas) -> None:
        """Draw a line that ends at the goal, along the goal's theta."""
        x, y, theta = state.goal[GOAL_X], state.goal[GOAL_Y], state.goal[GOAL_THETA]
        length = 2.0 * state.body[HALF_LENGTH]
        tail = x - length * math.cos(theta), y - length * math.sin(theta)
        draw_line(canvas, tail, (x, y), base.MARK_WIDTH)


@kernel_function
def _measure(state: EnvState) -> None:
    """Write two metrics: the distance to the goal's position, and the error of the angle."""
    truth, goal, metrics = state.truth, state.goal, state.metrics
    metrics[DISTANCE] = math.hypot(goal[GOAL_X] - truth[X], goal[GOAL_Y] - truth[Y])
    metrics[ANGLE_ERROR] = truth[THETA] - goal[GOAL_THETA]


@kernel_function
def _remaining(state: EnvState) -> float:
    """Return the remaining way: hypot(distance, angle error) [m], where 2 deg count as 5 mm."""
    return math.hypot(state.metrics[DISTANCE], ARM * state.metrics[ANGLE_ERROR])


# Costs for planners [m], tuned by experiments.
SHORT_COST, PAST_COST = 0.15, 10.0  # per metre short of the goal, or past it, after full braking
ANGLE_COST = 0.3  # per radian
LACK_COST = 3.0  # per missing energy [m^2/s^2]
SHARE_OF_BRAKING = 0.9  # [-] deceleration in any direction, relative to full braking
TURN_LOSS = 5.0  # [m/s^2] loss of v^2 / 2 per radian, times the half length
RESERVE = 0.05  # [m^2/s^2] energy for the last corrections


def _running_cost(nodes: planning.Nodes) -> planning.Numbers:
    """Estimate a cost [m] (nodes,) that has two parts.

    The parts are the error after braking to rest, and the energy that is missing to reach the goal.
    """
    x, y, theta, vx, vy, omega = nodes.parcels.truth.T
    goal_x, goal_y, goal_theta = nodes.parcels.goal.T
    speed = np.hypot(vx, vy)
    heading_x, heading_y = vx / np.maximum(speed, 1e-6), vy / np.maximum(speed, 1e-6)
    to_x, to_y = goal_x - x, goal_y - y
    along = to_x * heading_x + to_y * heading_y
    across = np.abs(to_y * heading_x - to_x * heading_y)
    short = along - speed**2 / (2.0 * SHARE_OF_BRAKING * nodes.braking)
    spun = omega * np.abs(omega) * nodes.half_length / (2.0 * SPIN_BRAKING)
    turn = np.abs(goal_theta - theta - spun)
    distance = np.hypot(to_x, to_y)
    # Braking along one diagonal turns the velocity; this costs a part of the energy.
    slope = np.minimum(1.0, across / np.maximum(along, 0.01))
    needed = (
        nodes.rolling_loss * distance
        + TURN_LOSS * nodes.half_length * turn
        + speed**2 * slope / (1.0 + slope) ** 2
        + RESERVE * np.minimum(1.0, distance / 0.1)
    )
    lack = np.maximum(0.0, needed - 0.5 * speed**2)
    missed = np.where(short > 0.0, SHORT_COST * short, -PAST_COST * short)
    return missed + across + ANGLE_COST * turn + LACK_COST * lack


def _final_cost(nodes: planning.Nodes) -> planning.Numbers:
    """Compute the cost of final nodes, shape (nodes,): the error divided by the allowed error.

    If a node is not a success, `FAILED` is added to its cost.
    """
    distance, angle = nodes.parcels.metrics.T
    error = np.maximum(distance / SUCCESS_DISTANCE, np.abs(angle) / SUCCESS_ANGLE)
    return planning.failure_cost(nodes) + error
