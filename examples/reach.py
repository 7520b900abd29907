"""A task of your own: reach a point with a heading, on a field of rotors that is tilted downhill.

python train.py --task examples/reach.py:Reach
python evaluate.py --task examples/reach.py:Reach
"""

import math
from dataclasses import dataclass
from typing import Any

import surface_gym.extend as own
from surface_gym.extend import THETA, EnvState, X, Y, kernel_function

GOAL_X, GOAL_Y, HEADING = range(3)  # indices in the goal: [m], [m], [rad]
LEFT = 0  # index in the memory: distance to go [m] at the last decision
NEAR = 0.03  # [m] maximum distance from the point at success
TURNED = math.radians(5.0)  # [rad] maximum difference from the heading at success
ARM = 0.1  # [m] distance that counts as much as 1 rad of difference from the heading

OUTCOMES = ("passed the point", "stalled", "off the surface")
PASSED, STALLED, OFF_SURFACE = own.failures(OUTCOMES)

FEATURES = (  # name, bounds of the shown number, value, unit, and the scale that divides the value
    own.Feature("to go along", -10.0, 10.0, "x to the point", "m"),
    own.Feature("to go across", -20.0, 20.0, "y to the point", "m", 0.2),
    own.Feature("fine to go across", -1.0, 1.0, "the same", "m", 0.03, bent=True),
    own.Feature("angle to turn", -100.0, 100.0, "heading - theta", "rad", 0.3),
    own.Feature("forward speed", -10.0, 10.0, "vx", "m/s"),
    own.Feature("lateral speed", -50.0, 50.0, "vy", "m/s", 0.3),
    own.Feature("turning speed", -50.0, 50.0, "omega", "rad/s", 3.0),
    own.Feature("size", 0.0, 20.0, "half length", "m", 0.2),
)
COLUMN = own.columns(FEATURES)


@dataclass(frozen=True)
class Reach(own.Task):
    """Move the parcel to a point and turn it to a heading; gravity pulls it towards +x."""

    speeds: tuple[float, float] = (0.4, 0.8)  # [m/s] along x at the start
    aside: float = 0.2  # [m] of the point from straight ahead, at most
    headings: tuple[float, float] = (-math.pi / 6, math.pi / 6)  # [rad] asked

    line = own.Field(rows=16, columns=30)
    features = FEATURES
    terms = ("approach", "success", "failure")
    outcomes = OUTCOMES
    metrics = ("miss", "angle_error")  # [m] from the point, [rad] off the heading
    options = ("speed", "parcel", "heading")
    draws, goals, memories = 4, 3, 1
    periods = 150

    def start(self, draw: own.Draw) -> own.Start:
        """Draw speed, heading and the point's y uniformly, and a parcel with equal odds."""
        pace, size, way, turn = draw.numbers
        speed = draw.within("speed", own.between(*self.speeds, pace), 0.1, 3.0)
        heading = draw.within("heading", own.between(*self.headings, turn), -math.pi, math.pi)
        middle = draw.line.line_y
        goal = (2.2, middle + self.aside * (2.0 * way - 1.0), heading)
        parcel = draw.parcel(self.parcels, size)
        return own.Start(
            parcel, (0.4, middle, 0.0), (speed, 0.0, 0.0), goal, tilt=math.radians(12.0)
        )

    def goal(self, state: EnvState) -> Any:
        """Return the goal for pictures: a short line into the point along the heading."""
        from surface_gym.rendering import Path

        x, y, turn = state.goal
        return Path([(x - 0.3 * math.cos(turn), y - 0.3 * math.sin(turn)), (x, y)])

    @staticmethod
    @kernel_function
    def begin(state: EnvState) -> None:
        state.memory[LEFT] = _left(state)

    @staticmethod
    @kernel_function
    def outcome(state: EnvState) -> int:
        truth, goal, metrics = state.truth, state.goal, state.metrics
        metrics[0] = math.hypot(goal[GOAL_X] - truth[X], goal[GOAL_Y] - truth[Y])
        metrics[1] = abs(goal[HEADING] - truth[THETA])
        if not state.on_surface:
            return OFF_SURFACE
        if metrics[0] < NEAR and metrics[1] < TURNED:
            return own.SUCCESS
        if truth[X] > goal[GOAL_X] + NEAR:
            return PASSED
        return STALLED if own.is_slower(state, 0.02) else own.RUNNING

    @staticmethod
    @kernel_function
    def reward(state: EnvState, outcome: int) -> None:
        left = _left(state)
        state.terms[0] = state.memory[LEFT] - left
        state.terms[1] = 3.0 if outcome == own.SUCCESS else 0.0
        state.terms[2] = -1.0 - 5.0 * left if outcome > own.SUCCESS else 0.0
        state.memory[LEFT] = left

    @staticmethod
    @kernel_function
    def observe(state: EnvState) -> None:
        sensed, see = state.sensed, state.observation
        across = state.goal[GOAL_Y] - sensed[Y]
        own.show(see, COLUMN.to_go_along, state.goal[GOAL_X] - sensed[X])
        own.show(see, COLUMN.to_go_across, across)
        own.show_bent(see, COLUMN.fine_to_go_across, across)
        own.show(see, COLUMN.angle_to_turn, state.goal[HEADING] - sensed[THETA])
        own.show(see, COLUMN.forward_speed, sensed[own.VX])
        own.show(see, COLUMN.lateral_speed, sensed[own.VY])
        own.show(see, COLUMN.turning_speed, sensed[own.OMEGA])
        own.show(see, COLUMN.size, state.body[own.HALF_LENGTH])


@kernel_function
def _left(state: EnvState) -> float:
    """Return the distance [m] to the goal; `ARM` converts the angle to turn to a distance."""
    truth, goal = state.truth, state.goal
    turn = ARM * (goal[HEADING] - truth[THETA])
    return math.sqrt((goal[GOAL_X] - truth[X]) ** 2 + (goal[GOAL_Y] - truth[Y]) ** 2 + turn**2)
