"""Stop: come to rest with the centre at a goal x."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym.canvas import Canvas, draw_line
from surface_gym.compiler.jit import kernel_function
from surface_gym.physics.types import VX, X
from surface_gym.state import RUNNING, SUCCESS, EnvState, is_driven, is_slower
from surface_gym.tasks import base, planning
from surface_gym.tasks.benchmark import Benchmark, high_column, median_column
from surface_gym.tasks.features import Feature, columns, show, show_bent
from surface_gym.tasks.start import Draw, Numbers, Start, between

POSITION = 0  # index in the goal: [m] goal x of the centre
SHORTFALL = 0  # index in the memory: [m] shortfall at the last decision
STOP_ERROR = 0  # index in the metrics: [m] x of the centre - goal x

OUTCOMES = (*base.LINE_OUTCOMES, "missed", "passed the asked x")
MISSED, OVERSHOT = base.failures(OUTCOMES)[-2:]
SUCCESS_ERROR = 0.005  # [m]
GOAL_REACH = 0.5  # [m] half length of the goal's line in a picture
CAUTION = 0.5  # [-] safety margin of planners, relative to the time of a quarter turn

# The reward, term by term.
TERMS: tuple[str, ...] = ("approach", "precision", "success", "failure")
APPROACH_REWARD = 1.0  # per metre nearer
PRECISION_REWARD = 1.0  # for stopping at the goal x, decreasing with the error
PRECISION_SCALE = 0.002  # [m] error that divides the reward by e
SUCCESS_REWARD = 1.0
FAILURE_REWARD = -1.0

FEATURES = (
    *base.PARCEL_FEATURES,
    Feature("to go", -20.0, 20.0, "goal x minus x of the centre", "m", 0.5),
    Feature("to go, near", -1.0, 1.0, "distance on a finer scale", "m", 0.05, bent=True),
    Feature("to go, nearest", -1.0, 1.0, "distance on the finest scale", "m", 0.01, bent=True),
    Feature(
        "excess of speed",
        -50.0,
        50.0,
        "vx minus the highest speed from which full braking still stops the parcel at the goal x",
        "m/s",
        0.2,
    ),
)
COLUMN = columns(FEATURES)
GOAL_FEATURES = tuple(each.name for each in FEATURES[len(base.PARCEL_FEATURES) :])


@dataclass(frozen=True)
class Stop(base.Task):
    """Stop the parcel with its centre at a goal x.

    A parcel enters a line of rotors among supports. It must stop at a goal position, within 5 mm. A
    parcel that stops short stays there, and a parcel past the goal cannot return. The last
    millimetres depend on the modules under the base.

    **Start.** The parcel's rear is at x = 0, on the line's middle. Theta is 0, and the velocity is
    along x. The entry speed is uniform in `speeds`. Parcels are by default S- and B-boxes at equal
    odds. The goal x is uniform between the nearest and the farthest stop. The nearest stop is the
    place where a parcel comes to rest if full braking (0.5 g) begins as soon as the whole base is
    in the zone. The farthest stop is the last place with the whole base in the zone, but at most
    0.8 of the distance that the parcel can roll. If a short zone has the farthest stop before the
    nearest stop, the goal is the farthest stop.

    **Goal and end.** The parcel is at rest when no point of the base moves faster than 1 mm/s.
    "success": the parcel is at rest, with its centre within 5 mm of the goal x. If the parcel is at
    rest elsewhere, the outcome is "missed". If a moving parcel is more than 5 mm past the goal x,
    the outcome is "passed the asked x". Other [failures](../environments/environment.md#end) are
    "off the line" and "off the surface".

    ### Reward

    | term | scale | meaning |
    | --- | --- | --- |
    | `approach` | 1 per metre | decrease of the distance to the goal x |
    | `precision` | 1 | once, at rest: exp(-abs(`stop_error`) / 2 mm) |
    | `success` | 1 | once, at success |
    | `failure` | -1 | once, at any failure |

    `info` has the signed error `stop_error` [m]: current x of the centre - goal x.

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Stop-v0", actions="halves")
        >>> observation, info = env.reset(options={"speed": 1.0, "parcel": "S", "position": 1.0})
        >>> observation, reward, terminated, truncated, info = env.step(15)  # all axes at 90 deg
        >>> info["outcome"], round(info["stop_error"], 3)
        ('running', -0.835)
    """

    speeds: tuple[float, float] = (0.5, 2.7)  # [m/s] entry speed

    features = FEATURES
    goal_features = GOAL_FEATURES
    terms = TERMS
    outcomes = OUTCOMES
    metrics = ("stop_error",)
    options = ("speed", "parcel", "position")
    ranges = {"speeds": (0.0, 5.0)}
    draws = 3
    goals = 1
    memories = 1
    periods = 150

    def start(self, draw: Draw) -> Start:
        """Draw entry speed, parcel and goal x, all uniform. The class describes their ranges."""
        pace, size, share = draw.numbers
        speed = draw.within("speed", between(*self.speeds, pace), 0.0, 5.0)
        parcel = draw.parcel(self.parcels, size)
        half_length = parcel.rear
        zone_start, zone_end = parcel.of(lambda each: base.zone_span(draw.line, each, draw.zone)).T
        rolled = half_length + 0.8 * speed**2 / (2.0 * base.ROLLING_LOSS)
        last = np.minimum(zone_end - half_length, rolled)
        first = np.minimum(zone_start + half_length + speed**2 / (2.0 * base.BRAKING), last)
        position = draw.within("position", between(first, last, share), 0.0, draw.line.length)
        return Start(parcel, base.entry(draw, parcel), (speed, 0.0, 0.0), (position,))

    def achieved(self, state: EnvState) -> tuple[float, ...]:
        """Return the centre's sensed x [m], and the sensed speed of the fastest point [m/s]."""
        return state.sensed[X], base.sensed_speed(state)

    def asked(self, state: EnvState) -> tuple[float, ...]:
        return state.goal[POSITION], 0.0

    def reached(self, achieved: Numbers, asked: Numbers) -> NDArray[np.bool_]:
        off, speed = np.moveaxis(achieved - asked, -1, 0)
        return np.asarray((np.abs(off) <= SUCCESS_ERROR) & (speed < base.STALL_SPEED))

    def decode_start(self, seen: planning.ObservationTable) -> Start:
        """Decode the first observation into a start. The start's `goal` is (goal x [m],)."""
        line = planning.decode_line(seen)
        start = planning.line_start(seen, line, self.parcels, ())
        return start._replace(goal=(np.add(start.pose[0], line.to_go[0]),))

    def cost(self) -> planning.PlanCost:
        return planning.PlanCost(
            _short_of_goal, planning.error_cost, 2e-5, self.periods, self.periods, caution=-1.0
        )

    def benchmark(self) -> Benchmark:
        """Return random starts, and the table columns that show the error of the final x."""
        return Benchmark(
            self,
            (
                median_column("stop_error", "error median [mm]", "of the place of rest", scale=1e3),
                high_column("stop_error", "error 90 % [mm]", scale=1e3),
            ),
            example={"speed": 1.2, "parcel": "S", "position": 1.2},
            example_description="the S-box at 1.2 m/s, at x = 1.2 m",
            error="stop_error",
        )

    def readings(self, state: EnvState) -> list[tuple[str, str]]:
        return [("to go", f"{-1e3 * state.metrics[STOP_ERROR]:.1f} mm")]

    def goal(self, state: EnvState) -> Any:
        from surface_gym.rendering import StopLine

        return StopLine(float(state.goal[POSITION]))

    @staticmethod
    @kernel_function
    def begin(state: EnvState) -> None:
        """Write the metric `stop_error`, and store the distance to the goal x for the reward."""
        state.metrics[STOP_ERROR] = state.truth[X] - state.goal[POSITION]
        state.memory[SHORTFALL] = abs(state.metrics[STOP_ERROR])

    @staticmethod
    @kernel_function
    def outcome(state: EnvState) -> int:
        """Compute the outcome from the true motion, and write the metric `stop_error`."""
        error = state.truth[X] - state.goal[POSITION]
        state.metrics[STOP_ERROR] = error
        outcome = base.failure(state)
        if is_driven(state):  # a parcel at rest may move again, and back
            rests = outcome == RUNNING and is_slower(state, base.STALL_SPEED)
            if rests and abs(error) <= SUCCESS_ERROR:
                outcome = SUCCESS
        elif outcome == base.STALLED:
            outcome = SUCCESS if abs(error) <= SUCCESS_ERROR else MISSED
        elif outcome == RUNNING and error > SUCCESS_ERROR:
            outcome = OVERSHOT
        return outcome

    @staticmethod
    @kernel_function
    def reward(state: EnvState, outcome: int) -> None:
        """Reward a shorter distance to the goal x, and a stop at the goal x."""
        shortfall = abs(state.metrics[STOP_ERROR])
        rests = outcome in (SUCCESS, MISSED)
        terms = state.terms
        terms[0] = APPROACH_REWARD * (state.memory[SHORTFALL] - shortfall)
        terms[1] = PRECISION_REWARD * math.exp(-shortfall / PRECISION_SCALE) if rests else 0.0
        terms[2] = SUCCESS_REWARD if outcome == SUCCESS else 0.0
        terms[3] = FAILURE_REWARD if outcome > SUCCESS else 0.0
        state.memory[SHORTFALL] = shortfall

    @staticmethod
    @kernel_function
    def observe(state: EnvState) -> None:
        """Write the observation from the sensed pose and velocity."""
        base.see_parcel(state)
        to_go = state.goal[POSITION] - state.sensed[X]
        excess = state.sensed[VX] - math.sqrt(2.0 * base.BRAKING * max(0.0, to_go))
        see = state.observation
        show(see, COLUMN.to_go, to_go)
        show_bent(see, COLUMN.to_go_near, to_go)
        show_bent(see, COLUMN.to_go_nearest, to_go)
        show(see, COLUMN.excess_of_speed, excess)

    @staticmethod
    @kernel_function
    def draw_goal(state: EnvState, canvas: Canvas) -> None:
        """Draw a line across the surface at the goal x."""
        x, y = state.goal[POSITION], state.elements.line_y
        draw_line(canvas, (x, y - GOAL_REACH), (x, y + GOAL_REACH), base.MARK_WIDTH)


def _short_of_goal(nodes: planning.Nodes) -> planning.Numbers:
    """Return costs (nodes,). The cost is low if full braking would stop the parcel at the goal x.

    Deviations from straight motion add a cost. If axes are slow, too little speed also adds a cost.
    """
    to_go = nodes.parcels.goal[:, POSITION] - nodes.parcels.truth[:, 0]
    short = to_go - nodes.braking_distance
    if nodes.quarter_turn == 0.0:
        return _weigh(short) + 0.1 * planning.askew(nodes)
    # Turning axes push sideways, which reduces braking. Their braking before they roll again may be
    # too strong.
    short -= CAUTION * nodes.quarter_turn * nodes.parcels.truth[:, 3]
    rolled = nodes.vx**2 / (2.0 * nodes.rolling_loss)
    lack = np.maximum(0.0, to_go - rolled)
    return _weigh(short) + 10.0 * lack + 0.3 * planning.askew(nodes)


def _weigh(short: planning.Numbers) -> planning.Numbers:
    """Return the cost of a stop at x = goal - `short` [m]. Past the goal, the cost is tenfold."""
    return np.where(short < 0.0, -10.0 * short, short)
