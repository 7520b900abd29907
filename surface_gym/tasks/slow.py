"""Slow: leave the zone at an asked ratio of the entry speed."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from surface_gym import checks
from surface_gym.dynamics.compiled import inlined
from surface_gym.lanes.memory import FIGURES, MISSED, SUCCESS, Geometry, Lanes
from surface_gym.parcel import Parcel
from surface_gym.plant import Line
from surface_gym.tasks.line import (
    PARCEL_FEATURES,
    ROLLING_LOSS,
    entry,
    failure,
    rear_to_go,
    see_parcel,
    zone_of,
)
from surface_gym.tasks.task import Feature, Start, parcel_option, parcels_to_draw, rising

RATIO, ENTRY_SPEED = range(2)  # columns of `Lanes.goal`: [-] asked, [m/s]
EXCESS = 0  # column of `Lanes.memory`: [-] the excess of speed at the last decision
RATIO_ERROR = FIGURES  # column of `Lanes.memory`: [-] speed / entry speed - asked ratio

SUCCESS_ERROR = 0.01  # [-] of the ratio

# The reward, term by term.
TERMS = ("excess", "precision", "success", "failure")
EXCESS_REWARD = 1.0  # per ratio by which the excess of speed shrinks
PRECISION_REWARD = 1.0  # for leaving at the asked ratio, falling with the error by
PRECISION_SCALE = 0.01  # [-] a factor e
SUCCESS_REWARD = 1.0
FAILURE_REWARD = -1.0

FEATURES = (
    *PARCEL_FEATURES,
    Feature("entry speed", -2.0, 5.0, "/ 1 m/s - 1.5"),
    Feature("asked ratio", 0.0, 1.0, ""),
    Feature(
        "excess of speed", -50.0, 50.0, "over what would roll out at the asked ratio / 0.2 m/s"
    ),
    Feature("fine excess", -1.0, 1.0, "hyperbolic tangent of the excess / 0.02 m/s"),
)


@dataclass(frozen=True)
class Slow:
    """Slow the parcel down to a ratio of its entry speed by the time its rear leaves the zone.

    A parcel enters a line of rotors amid supports; the zone's modules are to take just so much of
    its speed that it leaves them at the asked share of what it came with.

    The surface is under-actuated: a module brakes along its axis and lets roll across it, but never
    pushes. Speed once taken never comes back, a parcel held unevenly turns or drifts off the line,
    and how hard it is braked jumps as its edges cross the modules' centres.

    ### Start

    The rear at x = 0, on the line's middle, theta 0, no other speed than vx. Entry speed: uniform
    in `speeds`. Parcel: equal odds. Asked ratio: uniform in `ratios`, though at most 0.98 of the
    ratio that rolling all the way would leave, below which a slow parcel falls by itself.

    ### Goal and end

    The episode ends with the physics step that takes the rear past the zone's end. "success":
    speed / entry speed is then within 0.01 of the asked ratio. Each failure ends the episode as
    `terminated`:

    - "missed": left the zone at another ratio;
    - "stalled": no point of the base moves faster than 1 mm/s before that;
    - "off the line": no rotor is under the base any more;
    - "off the surface": the centre of mass passes the edge of the surface.

    Running out of time is `truncated`.

    ### Reward

    | term | scale | meaning |
    | --- | --- | --- |
    | `excess` | 1 per ratio | by which the excess shrank: how far the speed is, either way, from \
that which rolling to the zone's end turns into the asked one, over the entry speed |
    | `precision` | 1 | once, on leaving: exp(-abs(`ratio_error`) / 0.01) |
    | `success` | 1 | once, at success |
    | `failure` | -1 | once, at any failure but "missed", so that leaving the zone always pays |

    ### Info

    - `ratio_error` [-]: speed / entry speed - asked ratio, at present; signed.

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Slow-v0", actions="halves")
        >>> observation, info = env.reset(options={"speed": 2.0, "parcel": "S", "ratio": 0.5})
        >>> observation, reward, terminated, truncated, info = env.step(15)  # all axes at 90 deg
        >>> info["outcome"], round(info["ratio_error"], 3)
        ('running', 0.498)

    ### Version history

    - `v0`: first version.
    """

    speeds: tuple[float, float] = (0.9, 2.7)  # [m/s] entry speed
    ratios: tuple[float, float] = (0.15, 0.8)  # [-] exit speed / entry speed
    parcels: tuple[str | Parcel, ...] = ("S", "B")  # to draw from

    number = 1
    plant = Line()
    features = FEATURES
    terms = TERMS
    figures = ("ratio_error",)
    options = ("speed", "parcel", "ratio")

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "speeds", rising("speeds", self.speeds, 0.0, 5.0))
        set_field(self, "ratios", rising("ratios", self.ratios, 0.0, 1.0))
        set_field(self, "parcels", parcels_to_draw(self.parcels))

    def start(
        self,
        rng: np.random.Generator,
        options: dict[str, Any],
        zone: tuple[int, int] | None,
    ) -> Start:
        """Entry speed and parcel: uniform. Asked ratio: uniform, up to what rolling leaves.

        A slow parcel loses more than the highest ratio allows by rolling alone, so that ratios
        are drawn below 0.98 of what it would leave with if it rolled all the way.
        """
        pace, size, share = rng.random(3).tolist()
        speed = self.speeds[0] + (self.speeds[1] - self.speeds[0]) * pace
        parcel = parcel_option(self.parcels[int(size * len(self.parcels))])
        if "speed" in options:
            speed = checks.within("speed", options["speed"], 0.1, 5.0)
        if "parcel" in options:
            parcel = parcel_option(options["parcel"])
        if "ratio" in options:
            ratio = checks.within("ratio", options["ratio"], 0.0, 1.0)
        else:
            way = zone_of(self.plant, parcel, zone)[1]
            rolling = math.sqrt(max(0.0, 1.0 - 2.0 * ROLLING_LOSS * way / speed**2))
            low = self.ratios[0]
            ratio = low + (max(low, min(self.ratios[1], 0.98 * rolling)) - low) * share
        return Start(parcel, entry(parcel), (speed, 0.0, 0.0), (ratio, speed))

    def readings(self, lanes: Lanes, lane: int) -> list[tuple[str, str]]:
        """The present ratio and the asked one."""
        asked, error = lanes.goal[lane, RATIO], lanes.memory[lane, RATIO_ERROR]
        return [("of entry", f"{asked + error:.3f}"), ("asked", f"{asked:.3f}")]

    def goal(self, lanes: Lanes, lane: int) -> Any:
        """The exit speed."""
        from surface_gym.rendering import ExitSpeed

        ratio, speed = lanes.goal[lane, RATIO], lanes.goal[lane, ENTRY_SPEED]
        return ExitSpeed(float(ratio), float(ratio * speed))


@inlined
def _excess(lanes: Lanes, lane: int, to_go: float, vx: float, vy: float) -> float:
    """[m/s] speed over that which, rolling `to_go` metres more, becomes the asked exit speed."""
    asked = lanes.goal[lane, RATIO] * lanes.goal[lane, ENTRY_SPEED]
    needed = math.sqrt(asked * asked + 2.0 * ROLLING_LOSS * max(0.0, to_go))
    return math.sqrt(vx * vx + vy * vy) - needed


@inlined
def _score(lanes: Lanes, lane: int, geometry: Geometry) -> float:
    truth = lanes.truth[lane]
    to_go = rear_to_go(lanes, lane, geometry, truth[0], truth[2])
    excess = _excess(lanes, lane, to_go, truth[3], truth[4])
    return abs(excess) / lanes.goal[lane, ENTRY_SPEED]


@inlined
def _ratio_error(lanes: Lanes, lane: int) -> float:
    truth = lanes.truth[lane]
    speed = math.sqrt(truth[3] * truth[3] + truth[4] * truth[4])
    return speed / lanes.goal[lane, ENTRY_SPEED] - lanes.goal[lane, RATIO]


@inlined
def begin(lanes: Lanes, lane: int, geometry: Geometry) -> None:
    """Set the task's memory at a start."""
    lanes.memory[lane, EXCESS] = _score(lanes, lane, geometry)
    lanes.memory[lane, RATIO_ERROR] = _ratio_error(lanes, lane)


@inlined
def judge(lanes: Lanes, lane: int, geometry: Geometry, on_rotors: bool, on_surface: bool) -> None:
    """Write reward terms and outcome after a control period, from the true state."""
    truth = lanes.truth[lane]
    error = _ratio_error(lanes, lane)
    outcome = failure(lanes, lane, on_rotors, on_surface)
    left = rear_to_go(lanes, lane, geometry, truth[0], truth[2]) < 0.0
    left = left and on_rotors and on_surface
    if left:
        outcome = SUCCESS if abs(error) <= SUCCESS_ERROR else MISSED
    excess = _score(lanes, lane, geometry)
    terms = lanes.terms[lane]
    terms[0] = EXCESS_REWARD * (lanes.memory[lane, EXCESS] - excess)
    terms[1] = PRECISION_REWARD * math.exp(-abs(error) / PRECISION_SCALE) if left else 0.0
    terms[2] = SUCCESS_REWARD if outcome == SUCCESS else 0.0
    terms[3] = FAILURE_REWARD if outcome > SUCCESS and not left else 0.0
    lanes.memory[lane, EXCESS] = excess
    lanes.memory[lane, RATIO_ERROR] = error
    lanes.outcome[lane] = outcome


@inlined
def observe(lanes: Lanes, lane: int, geometry: Geometry) -> None:
    """Write the observation from what the sensors say."""
    see_parcel(lanes, lane, geometry)
    sensed = lanes.sensed[lane]
    to_go = rear_to_go(lanes, lane, geometry, sensed[0], sensed[2])
    excess = _excess(lanes, lane, to_go, sensed[3], sensed[4])
    see = lanes.observation[lane]
    see[13] = lanes.goal[lane, ENTRY_SPEED] - 1.5
    see[14] = lanes.goal[lane, RATIO]
    see[15] = excess / 0.2
    see[16] = math.tanh(excess / 0.02)
