"""Orient: leave the zone turned by an asked angle."""

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
    entry,
    failure,
    rear_to_go,
    see_parcel,
)
from surface_gym.tasks.task import Feature, Start, parcel_option, parcels_to_draw, rising

ANGLE = 0  # column of `Lanes.goal`: [rad] asked theta
LEFT_TO_TURN = 0  # column of `Lanes.memory`: [rad] at the last decision
ANGLE_ERROR = FIGURES  # column of `Lanes.memory`: [rad] theta - the asked angle

SUCCESS_ERROR = math.radians(2.0)  # [rad]

# The reward, term by term.
TERMS = ("turn", "precision", "success", "failure")
TURN_REWARD = 1.0  # per radian nearer to the asked angle
PRECISION_REWARD = 1.0  # for leaving at the asked angle, falling with the error by
PRECISION_SCALE = math.radians(1.0)  # [rad] a factor e
SUCCESS_REWARD = 1.0
FAILURE_REWARD = -1.0

FEATURES = (
    *PARCEL_FEATURES,
    Feature("asked angle", -4.0, 4.0, "/ 1 rad"),
    Feature("angle to turn", -1000.0, 1000.0, "asked angle - theta / 0.2 rad"),
    Feature("angle to turn, near", -1.0, 1.0, "hyperbolic tangent of asked angle - theta / 2 deg"),
)


@dataclass(frozen=True)
class Orient:
    """Turn the parcel by an asked angle by the time its rear leaves the zone.

    A parcel enters a line of rotors amid supports at theta = 0 and is to leave the zone at an asked
    theta, to 2 deg.

    The surface is under-actuated: a module brakes along its axis and lets roll across it, but never
    pushes. What turns the parcel is the difference between modules left and right of its centre,
    and what that costs in speed, and in drift to the side, is gone. Turned, it covers other modules
    than before.

    ### Start

    The rear at x = 0, on the line's middle, theta 0, no other speed than vx. Entry speed: uniform
    in `speeds`. Asked angle: uniform in `angles`. Parcel: equal odds.

    ### Goal and end

    The episode ends with the physics step that takes the rearmost point of the base past the zone's
    end. "success": theta is then within 2 deg of the asked angle; a full turn counts as one. Each
    failure ends the episode as `terminated`:

    - "missed": left the zone at another angle;
    - "stalled": no point of the base moves faster than 1 mm/s before that;
    - "off the line": no rotor is under the base any more;
    - "off the surface": the centre of mass passes the edge of the surface.

    Running out of time is `truncated`.

    ### Reward

    | term | scale | meaning |
    | --- | --- | --- |
    | `turn` | 1 a radian | by which theta came nearer to the asked angle |
    | `precision` | 1 | once, on leaving: exp(-abs(`angle_error`) / 1 deg) |
    | `success` | 1 | once, at success |
    | `failure` | -1 | once, at any failure |

    ### Info

    - `angle_error` [rad]: theta - the asked angle, at present; signed.

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Orient-v0", actions="halves")
        >>> observation, info = env.reset(options={"speed": 1.5, "parcel": "S", "angle": 0.5})
        >>> observation, reward, terminated, truncated, info = env.step(15)  # all axes at 90 deg
        >>> info["outcome"], info["angle_error"]
        ('running', -0.5)

    ### Version history

    - `v0`: first version.
    """

    speeds: tuple[float, float] = (1.3, 1.7)  # [m/s] entry speed
    angles: tuple[float, float] = (-math.pi / 4, math.pi / 4)  # [rad] asked
    parcels: tuple[str | Parcel, ...] = ("S", "B")  # to draw from

    number = 4
    plant = Line()
    features = FEATURES
    terms = TERMS
    figures = ("angle_error",)
    options = ("speed", "parcel", "angle")

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "speeds", rising("speeds", self.speeds, 0.0, 5.0))
        set_field(self, "angles", rising("angles", self.angles, -math.pi, math.pi))
        set_field(self, "parcels", parcels_to_draw(self.parcels))

    def start(
        self,
        rng: np.random.Generator,
        options: dict[str, Any],
        zone: tuple[int, int] | None,
    ) -> Start:
        """Entry speed, parcel and asked angle: uniform."""
        del zone
        pace, size, turn = rng.random(3).tolist()
        speed = self.speeds[0] + (self.speeds[1] - self.speeds[0]) * pace
        parcel = parcel_option(self.parcels[int(size * len(self.parcels))])
        angle = self.angles[0] + (self.angles[1] - self.angles[0]) * turn
        if "speed" in options:
            speed = checks.within("speed", options["speed"], 0.0, 5.0)
        if "parcel" in options:
            parcel = parcel_option(options["parcel"])
        if "angle" in options:
            angle = checks.within("angle", options["angle"], -math.pi, math.pi)
        return Start(parcel, entry(parcel), (speed, 0.0, 0.0), (angle,))

    def readings(self, lanes: Lanes, lane: int) -> list[tuple[str, str]]:
        """The asked angle."""
        return [("asked", f"{math.degrees(lanes.goal[lane, ANGLE]):+.1f}\N{DEGREE SIGN}")]

    def goal(self, lanes: Lanes, lane: int) -> Any:
        """The heading."""
        from surface_gym.rendering import Heading

        return Heading(float(lanes.goal[lane, ANGLE]))


@inlined
def _angle_error(lanes: Lanes, lane: int) -> float:
    return lanes.truth[lane, 2] - lanes.goal[lane, ANGLE]


@inlined
def begin(lanes: Lanes, lane: int) -> None:
    """Set the task's memory at a start."""
    lanes.memory[lane, ANGLE_ERROR] = _angle_error(lanes, lane)
    lanes.memory[lane, LEFT_TO_TURN] = abs(lanes.memory[lane, ANGLE_ERROR])


@inlined
def judge(lanes: Lanes, lane: int, geometry: Geometry, on_rotors: bool, on_surface: bool) -> None:
    """Write reward terms and outcome after a control period, from the true state."""
    truth = lanes.truth[lane]
    error = _angle_error(lanes, lane)
    outcome = failure(lanes, lane, on_rotors, on_surface)
    left = rear_to_go(lanes, lane, geometry, truth[0], truth[2]) < 0.0
    left = left and on_rotors and on_surface
    if left:
        outcome = SUCCESS if abs(error) <= SUCCESS_ERROR else MISSED
    terms = lanes.terms[lane]
    terms[0] = TURN_REWARD * (lanes.memory[lane, LEFT_TO_TURN] - abs(error))
    terms[1] = PRECISION_REWARD * math.exp(-abs(error) / PRECISION_SCALE) if left else 0.0
    terms[2] = SUCCESS_REWARD if outcome == SUCCESS else 0.0
    terms[3] = FAILURE_REWARD if outcome > SUCCESS else 0.0
    lanes.memory[lane, LEFT_TO_TURN] = abs(error)
    lanes.memory[lane, ANGLE_ERROR] = error
    lanes.outcome[lane] = outcome


@inlined
def observe(lanes: Lanes, lane: int, geometry: Geometry) -> None:
    """Write the observation from what the sensors say."""
    see_parcel(lanes, lane, geometry)
    left = lanes.goal[lane, ANGLE] - lanes.sensed[lane, 2]
    see = lanes.observation[lane]
    see[13] = lanes.goal[lane, ANGLE]
    see[14] = left / 0.2
    see[15] = math.tanh(left / SUCCESS_ERROR)
