"""Orient: leave the zone turned by a goal angle."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from surface_gym import checks, state as st
from surface_gym.canvas import Canvas, draw_line
from surface_gym.compiler.jit import kernel_function
from surface_gym.physics.types import THETA
from surface_gym.state import SUCCESS, EnvState
from surface_gym.tasks import base, planning
from surface_gym.tasks.benchmark import PARCELS, Benchmark, high_column, median_column
from surface_gym.tasks.features import Feature, columns, show, show_bent
from surface_gym.tasks.start import Draw, Start, between

ANGLE = 0  # index in the goal: [rad] goal theta
REMAINING_TURN = 0  # index in the memory: [rad] remaining angle at the last decision
ANGLE_ERROR = 0  # index in the metrics: [rad] theta - goal angle

OUTCOMES = (*base.LINE_OUTCOMES, "missed")
MISSED = base.failures(OUTCOMES)[-1]
SUCCESS_ERROR = math.radians(2.0)  # [rad]
GOAL_LENGTH = 0.6  # [m] length of the goal's line in a picture
EXIT_SPEED = 0.1  # [m/s] exit speed for planners
# [m/s^2] loss of v^2 / 2 per radian, times the half length
TURN_LOSS = 2.5

# The reward, term by term.
TERMS: tuple[str, ...] = ("turn", "precision", "success", "failure")
TURN_REWARD = 1.0  # per radian nearer to the goal angle
PRECISION_REWARD = 1.0  # for leaving at the goal angle, decreasing with the error
PRECISION_SCALE = math.radians(1.0)  # [rad] error that divides the reward by e
SUCCESS_REWARD = 1.0
FAILURE_REWARD = -1.0

FEATURES = (
    *base.PARCEL_FEATURES,
    Feature("asked angle", -4.0, 4.0, "goal angle", "rad"),
    Feature("angle to turn", -1000.0, 1000.0, "goal angle minus theta", "rad", 0.2),
    Feature("angle to turn, near", -1.0, 1.0, "angle to turn on a finer scale", "rad", SUCCESS_ERROR, bent=True),
)  # fmt: skip
COLUMN = columns(FEATURES)


@dataclass(frozen=True)
class Orient(base.Task):
    """Turn the parcel by a goal angle before its rear leaves the zone.

    A parcel enters a line of rotors among supports with theta = 0. It must leave the zone at a goal theta, within 2
    deg. If modules brake only one side of the parcel, the parcel turns. Turning costs speed and
    causes drift; neither can be undone.

    **Start.** The rear is at x = 0, on the line's middle, with theta 0 and speed along x only. The entry speed is
    uniform in `speeds`, and the goal angle is uniform in `angles`. Parcels are by default S- and B-boxes at equal
    odds.

    **Goal and end.** The episode ends when the rear passes the zone's end. If theta is then within
    2 deg of the goal angle, the outcome is "success", otherwise "missed". Theta counts full turns,
    so one turn too much is an error of 360 deg. Other
    [failures](../environments/environment.md#end) are "stalled", "off the line" and
    "off the surface".

    ### Reward

    | term | scale | meaning |
    | --- | --- | --- |
    | `turn` | 1 per radian | decrease of the angle to the goal |
    | `precision` | 1 | once, on leaving: exp(-abs(`angle_error`) / 1 deg) |
    | `success` | 1 | once, at success |
    | `failure` | -1 | once, at any failure |

    `info` has `angle_error` [rad]: current theta - goal angle, with its sign.

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Orient-v0", actions="halves")
        >>> observation, info = env.reset(options={"speed": 1.5, "parcel": "S", "angle": 0.5})
        >>> observation, reward, terminated, truncated, info = env.step(15)  # all axes at 90 deg
        >>> info["outcome"], info["angle_error"]
        ('running', -0.5)
    """

    speeds: tuple[float, float] = (1.3, 1.7)  # [m/s] entry speed
    angles: tuple[float, float] = (-math.pi / 4, math.pi / 4)  # [rad] goal angle

    features = FEATURES
    terms = TERMS
    outcomes = OUTCOMES
    metrics = ("angle_error",)
    options = ("speed", "parcel", "angle")
    ranges = {"speeds": (0.0, 5.0), "angles": (-math.pi, math.pi, checks.DEGREES)}
    draws = 3
    goals = 1
    memories = 1
    leaves_zone = True
    periods = 200

    def start(self, draw: Draw) -> Start:
        """Draw entry speed, parcel and goal angle, all uniform."""
        pace, size, turn = draw.numbers
        speed = draw.within("speed", between(*self.speeds, pace), 0.0, 5.0)
        parcel = draw.parcel(self.parcels, size)
        angle = draw.angle("angle", between(*self.angles, turn), -math.pi, math.pi)
        return Start(parcel, base.entry(draw, parcel), (speed, 0.0, 0.0), (angle,))

    def check_goal(self, goal: planning.Numbers) -> None:
        checks.within("goal", goal[ANGLE], -math.pi, math.pi)

    def decode_start(self, seen: planning.ObservationTable) -> Start:
        """Decode the first observation into a start, whose goal is the goal angle [rad]."""
        line = planning.decode_line(seen)
        return planning.line_start(seen, line, self.parcels, (float(line.angle[0]),))

    def cost(self) -> planning.PlanCost:
        return planning.PlanCost(
            _angle_to_turn, planning.error_cost, 1e-3, self.periods, self.periods, caution=-1.0
        )

    def benchmark(self) -> Benchmark:
        """Return starts with all combinations of 41 speeds, six goal angles and two boxes."""
        degrees = 180.0 / math.pi
        return Benchmark(
            self,
            (
                median_column(
                    "angle_error", "error median [deg]", "of the angle on leaving", scale=degrees
                ),
                high_column("angle_error", "error 90 % [deg]", scale=degrees),
            ),
            tuple(
                {"speed": speed, "angle": math.radians(angle), "parcel": parcel}
                for parcel in PARCELS
                for speed in np.linspace(1.3, 1.7, 41).tolist()
                for angle in (-45.0, -30.0, -15.0, 15.0, 30.0, 45.0)
            ),
            "by 15, 30 and 45 deg to either side, entry speeds 1.3 to 1.7 m/s, both boxes",
            {"speed": 1.5, "parcel": "B", "angle": 0.5236},
            "the B-box at 1.5 m/s, by 30 deg",
            "angle_error",
        )

    def readings(self, state: EnvState) -> list[tuple[str, str]]:
        return [("asked", f"{math.degrees(state.goal[ANGLE]):+.1f}\N{DEGREE SIGN}")]

    def goal(self, state: EnvState) -> Any:
        from surface_gym.rendering import Heading

        return Heading(float(state.goal[ANGLE]))

    @staticmethod
    @kernel_function
    def begin(state: EnvState) -> None:
        """Write the metric `angle_error`, and store the remaining angle for the reward."""
        state.metrics[ANGLE_ERROR] = state.truth[THETA] - state.goal[ANGLE]
        state.memory[REMAINING_TURN] = abs(state.metrics[ANGLE_ERROR])

    is_done = staticmethod(base.over_zone_end)

    @staticmethod
    @kernel_function
    def outcome(state: EnvState) -> int:
        """Return the outcome of the true motion, and write the metric `angle_error`."""
        error = state.truth[THETA] - state.goal[ANGLE]
        state.metrics[ANGLE_ERROR] = error
        return base.leaving(state, abs(error) <= SUCCESS_ERROR, MISSED)

    @staticmethod
    @kernel_function
    def reward(state: EnvState, outcome: int) -> None:
        """Reward turning to the goal angle, and leaving the zone at this angle."""
        left_to_turn = abs(state.metrics[ANGLE_ERROR])
        left = outcome in (SUCCESS, MISSED)
        terms = state.terms
        terms[0] = TURN_REWARD * (state.memory[REMAINING_TURN] - left_to_turn)
        terms[1] = PRECISION_REWARD * math.exp(-left_to_turn / PRECISION_SCALE) if left else 0.0
        terms[2] = SUCCESS_REWARD if outcome == SUCCESS else 0.0
        terms[3] = FAILURE_REWARD if outcome > SUCCESS else 0.0
        state.memory[REMAINING_TURN] = left_to_turn

    @staticmethod
    @kernel_function
    def observe(state: EnvState) -> None:
        """Write the observation from the sensed pose and velocity."""
        base.see_parcel(state)
        left = state.goal[ANGLE] - state.sensed[THETA]
        see = state.observation
        show(see, COLUMN.asked_angle, state.goal[ANGLE])
        show(see, COLUMN.angle_to_turn, left)
        show_bent(see, COLUMN.angle_to_turn_near, left)

    @staticmethod
    @kernel_function
    def draw_goal(state: EnvState, canvas: Canvas) -> None:
        """Draw a line that begins at the zone's end and points along the goal angle."""
        x, y, angle = st.zone_end(state), state.elements.line_y, state.goal[ANGLE]
        tip = x + GOAL_LENGTH * math.cos(angle), y + GOAL_LENGTH * math.sin(angle)
        draw_line(canvas, (x, y), tip, base.MARK_WIDTH)


def _angle_to_turn(nodes: planning.Nodes) -> planning.Numbers:
    """Compute costs [rad] (nodes,) from speed, lateral offset and the angle still to turn."""
    _, _, theta, _, vy, omega = nodes.parcels.truth.T
    vx = nodes.vx
    left = np.abs(nodes.parcels.goal[:, ANGLE] - theta - planning.SETTLING * omega)
    spent = nodes.rolling_loss * planning.way_to_leave(nodes) + TURN_LOSS * nodes.half_length * left
    lack = np.maximum(0.0, np.sqrt(EXIT_SPEED**2 + 2.0 * spent) - vx)
    return left + lack - 0.2 * vx + 0.2 * planning.off_line(nodes) + 0.06 * np.abs(vy)
