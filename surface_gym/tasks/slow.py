"""Slow: leave the zone at a goal ratio of the entry speed."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from surface_gym import checks
from surface_gym.canvas import Canvas
from surface_gym.compiler.jit import kernel_function
from surface_gym.physics.types import THETA, VX, VY, X
from surface_gym.state import SUCCESS, EnvState, planar_speed, zone_end
from surface_gym.tasks import base, planning
from surface_gym.tasks.benchmark import Benchmark, high_column, median_column
from surface_gym.tasks.features import Feature, columns, show, show_bent
from surface_gym.tasks.start import Draw, Start, between

RATIO, ENTRY_SPEED = range(2)  # indices in the goal: [-] ratio, [m/s]
ARRIVAL = 3.2  # [s] time limit for planners, out of 4 s
EXCESS = 0  # index in the memory: [-] excess of speed at the last decision
RATIO_ERROR = 0  # index in the metrics: [-] speed / entry speed - goal ratio

OUTCOMES = (*base.LINE_OUTCOMES, "missed")
MISSED = base.failures(OUTCOMES)[-1]
SUCCESS_ERROR = 0.01  # [-] allowed error of the ratio

# The reward, term by term.
TERMS: tuple[str, ...] = ("excess", "precision", "success", "failure")
EXCESS_REWARD = 1.0  # per decrease of the excess of speed, as a ratio
PRECISION_REWARD = 1.0  # for leaving at the goal ratio, decreasing with the error
PRECISION_SCALE = 0.01  # [-] error that divides the reward by e
SUCCESS_REWARD = 1.0
FAILURE_REWARD = -1.0

FEATURES = (
    *base.PARCEL_FEATURES,
    Feature("entry speed", -2.0, 5.0, "vx at the start of the episode", "m/s", 1.0, 1.5),
    Feature("asked ratio", 0.0, 1.0, "the goal ratio"),
    Feature(
        "excess of speed", -50.0, 50.0, "speed minus the right speed: see `excess`", "m/s", 0.2
    ),
    Feature("fine excess", -1.0, 1.0, "excess of speed on a finer scale", "m/s", 0.02, bent=True),
)
COLUMN = columns(FEATURES)


@dataclass(frozen=True)
class Slow(base.Task):
    """Slow the parcel to a ratio of its entry speed before its rear leaves the zone.

    A parcel enters a line of rotors among supports, and the zone's modules brake it. Lost speed
    cannot be recovered. Uneven braking turns the parcel or moves it off the line. The braking force
    jumps when an edge of the parcel crosses a module.

    **Start.** The parcel's rear is at x = 0, on the line's middle. Theta is 0, and the velocity is
    along x. The entry speed is uniform in `speeds`. The goal ratio is uniform in `ratios`. A
    parcel loses speed even if no module brakes it. The goal ratio is at most 0.98 times the ratio
    of an unbraked parcel at the zone's end. Parcels are by default S- and B-boxes at equal odds.

    **Goal and end.** The episode ends when the rear passes the zone's end. If speed / entry speed
    is then within 0.01 of the goal ratio, the outcome is "success", otherwise "missed". Other
    [failures](../environments/environment.md#end) are "stalled", "off the line" and "off the surface".

    ### Reward

    | term | scale | meaning |
    | --- | --- | --- |
    | `excess` | 1 | decrease of the speed error, divided by the entry speed. The speed error is the absolute difference between \
the speed and the right speed. A parcel with the right speed leaves with the goal ratio if nothing brakes it any more |
    | `precision` | 1 | once, on leaving: exp(-abs(`ratio_error`) / 0.01) |
    | `success` | 1 | once, at success |
    | `failure` | -1 | once, at any failure except "missed": it is better to leave the zone at a wrong ratio than not at all |

    `info` has the signed error `ratio_error` [-]: current speed / entry speed - goal ratio.

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Slow-v0", actions="halves")
        >>> observation, info = env.reset(options={"speed": 2.0, "parcel": "S", "ratio": 0.5})
        >>> observation, reward, terminated, truncated, info = env.step(15)  # all axes at 90 deg
        >>> info["outcome"], round(info["ratio_error"], 3)
        ('running', 0.498)
    """

    speeds: tuple[float, float] = (0.9, 2.7)  # [m/s] entry speed
    ratios: tuple[float, float] = (0.15, 0.8)  # [-] exit speed / entry speed

    features = FEATURES
    terms = TERMS
    outcomes = OUTCOMES
    metrics = ("ratio_error",)
    options = ("speed", "parcel", "ratio")
    ranges = {"speeds": (0.0, 5.0), "ratios": (0.0, 1.0)}
    draws = 3
    goals = 2
    memories = 1
    leaves_zone = True
    periods = 100

    def start(self, draw: Draw) -> Start:
        """Draw entry speed, parcel and goal ratio from uniform distributions.

        A rolling parcel keeps a part of its entry speed until the zone's end. The goal ratio is at
        most 0.98 times this part, but never less than the lowest of `ratios`.
        """
        pace, size, share = draw.numbers
        speed = draw.within("speed", between(*self.speeds, pace), 0.1, 5.0)
        parcel = draw.parcel(self.parcels, size)
        way = parcel.of(lambda each: base.zone_span(draw.line, each, draw.zone)[1])
        rolling = np.sqrt(np.maximum(0.0, 1.0 - 2.0 * base.ROLLING_LOSS * way / speed**2))
        low, high = self.ratios
        highest = np.maximum(low, np.minimum(high, 0.98 * rolling))
        ratio = draw.within("ratio", between(low, highest, share), 0.0, 1.0)
        return Start(parcel, base.entry(draw, parcel), (speed, 0.0, 0.0), (ratio, speed))

    def check_goal(self, goal: planning.Numbers) -> None:
        checks.within("goal[0]", goal[RATIO], 0.0, 1.0)
        checks.positive("goal[1]", goal[ENTRY_SPEED], most=checks.SPEED)

    def decode_start(self, seen: planning.ObservationTable) -> Start:
        """Decode the first observation into a start. The goal is (ratio [-], entry speed [m/s])."""
        line = planning.decode_line(seen)
        goal = float(line.ratio[0]), float(line.entry_speed[0])
        return planning.line_start(seen, line, self.parcels, goal)

    def cost(self) -> planning.PlanCost:
        return planning.PlanCost(
            _excess_of_speed, planning.error_cost, 2e-4, self.periods, self.periods, caution=1.0
        )

    def benchmark(self) -> Benchmark:
        """Return random starts, with columns for the error of the ratio."""
        return Benchmark(
            self,
            (
                median_column(
                    "ratio_error", "error median", "of the ratio of exit and entry speed", ".4f"
                ),
                high_column("ratio_error", "error 90 %", ".4f"),
            ),
            example={"speed": 1.8, "parcel": "B", "ratio": 0.4},
            example_description="the B-box at 1.8 m/s, to 0.4 of it",
            error="ratio_error",
        )

    def readings(self, state: EnvState) -> list[tuple[str, str]]:
        asked, error = state.goal[RATIO], state.metrics[RATIO_ERROR]
        return [("of entry", f"{asked + error:.3f}"), ("asked", f"{asked:.3f}")]

    def goal(self, state: EnvState) -> Any:
        from surface_gym.rendering import ExitSpeed

        ratio, speed = state.goal[RATIO], state.goal[ENTRY_SPEED]
        return ExitSpeed(float(ratio), float(ratio * speed))

    @staticmethod
    @kernel_function
    def begin(state: EnvState) -> None:
        """Write the metric `ratio_error`, and store the speed error for the reward."""
        state.memory[EXCESS] = _score(state)
        state.metrics[RATIO_ERROR] = _ratio_error(state)

    is_done = staticmethod(base.over_zone_end)

    @staticmethod
    @kernel_function
    def outcome(state: EnvState) -> int:
        """From the true motion, return the outcome and write the metric `ratio_error`."""
        error = _ratio_error(state)
        state.metrics[RATIO_ERROR] = error
        return base.leaving(state, abs(error) <= SUCCESS_ERROR, MISSED)

    @staticmethod
    @kernel_function
    def reward(state: EnvState, outcome: int) -> None:
        """Reward a decrease of the speed error, and leaving the zone at the goal ratio."""
        error = state.metrics[RATIO_ERROR]
        left = outcome in (SUCCESS, MISSED)
        excess = _score(state)
        terms = state.terms
        terms[0] = EXCESS_REWARD * (state.memory[EXCESS] - excess)
        terms[1] = PRECISION_REWARD * math.exp(-abs(error) / PRECISION_SCALE) if left else 0.0
        terms[2] = SUCCESS_REWARD if outcome == SUCCESS else 0.0
        terms[3] = FAILURE_REWARD if outcome > SUCCESS and not left else 0.0
        state.memory[EXCESS] = excess

    @staticmethod
    @kernel_function
    def observe(state: EnvState) -> None:
        """Write the observation from the sensed pose and velocity."""
        base.see_parcel(state)
        sensed = state.sensed
        to_go = base.rear_to_go(state, sensed[X], sensed[THETA])
        excess = _excess(state, to_go, sensed[VX], sensed[VY])
        see = state.observation
        show(see, COLUMN.entry_speed, state.goal[ENTRY_SPEED])
        show(see, COLUMN.asked_ratio, state.goal[RATIO])
        show(see, COLUMN.excess_of_speed, excess)
        show_bent(see, COLUMN.fine_excess, excess)

    @staticmethod
    @kernel_function
    def draw_goal(state: EnvState, canvas: Canvas) -> None:
        """Draw a line across the zone's end, with a length of 0.4 m per m/s of the goal speed."""
        asked = state.goal[RATIO] * state.goal[ENTRY_SPEED]
        base.draw_speed(canvas, zone_end(state), state.elements.line_y, asked)


@kernel_function
def _excess(state: EnvState, to_go: float, vx: float, vy: float) -> float:
    """Return the speed of the velocity (vx, vy) minus the needed speed [m/s].

    A parcel with the needed speed has the goal speed after it has rolled on for `to_go` [m].
    """
    asked = state.goal[RATIO] * state.goal[ENTRY_SPEED]
    needed = math.sqrt(asked * asked + 2.0 * base.ROLLING_LOSS * max(0.0, to_go))
    return math.sqrt(vx * vx + vy * vy) - needed


@kernel_function
def _score(state: EnvState) -> float:
    truth = state.truth
    to_go = base.rear_to_go(state, truth[X], truth[THETA])
    return abs(_excess(state, to_go, truth[VX], truth[VY])) / state.goal[ENTRY_SPEED]


@kernel_function
def _ratio_error(state: EnvState) -> float:
    return planar_speed(state.truth) / state.goal[ENTRY_SPEED] - state.goal[RATIO]


def _excess_of_speed(nodes: planning.Nodes) -> planning.Numbers:
    """Compute the speed error [m/s] (nodes,), plus costs of a late exit and a crooked motion."""
    parcels, to_go = nodes.parcels, planning.way_to_leave(nodes)
    speed = np.hypot(nodes.vx, parcels.truth[:, 4])
    asked = parcels.goal[:, RATIO] * parcels.goal[:, ENTRY_SPEED]
    excess = speed - np.sqrt(asked**2 + 2.0 * nodes.rolling_loss * to_go)
    late = np.maximum(0.0, parcels.clock + to_go / np.maximum(speed, 1e-3) - ARRIVAL)
    return np.abs(excess) + 2.0 * late + planning.askew(nodes)
