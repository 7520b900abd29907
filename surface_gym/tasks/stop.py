"""Stop: come to rest with the centre at an asked x."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from surface_gym import checks
from surface_gym.dynamics.compiled import inlined
from surface_gym.lanes.memory import (
    FIGURES,
    MISSED,
    OVERSHOT,
    RUNNING,
    STALLED,
    SUCCESS,
    Geometry,
    Lanes,
)
from surface_gym.parcel import Parcel
from surface_gym.plant import PITCH, Line
from surface_gym.tasks.line import (
    BRAKING,
    PARCEL_FEATURES,
    ROLLING_LOSS,
    entry,
    failure,
    see_parcel,
    zone_of,
)
from surface_gym.tasks.task import Feature, Start, parcel_option, parcels_to_draw, rising

POSITION = 0  # column of `Lanes.goal`: [m] asked x of the centre
SHORTFALL = 0  # column of `Lanes.memory`: [m] at the last decision
STOP_ERROR = FIGURES  # column of `Lanes.memory`: [m] x of the centre - the asked one

SUCCESS_ERROR = 0.005  # [m]

# The reward, term by term.
TERMS = ("approach", "precision", "success", "failure")
APPROACH_REWARD = 1.0  # per metre nearer
PRECISION_REWARD = 1.0  # for resting at the asked x, falling with the error by
PRECISION_SCALE = 0.002  # [m] a factor e
SUCCESS_REWARD = 1.0
FAILURE_REWARD = -1.0

FEATURES = (
    *PARCEL_FEATURES,
    Feature("to go", -20.0, 20.0, "to the asked x / 0.5 m"),
    Feature("to go, near", -1.0, 1.0, "hyperbolic tangent of the way to the asked x / 0.05 m"),
    Feature("to go, nearest", -1.0, 1.0, "hyperbolic tangent of the way to the asked x / 0.01 m"),
    Feature("excess of speed", -50.0, 50.0, "over what full braking ends at the asked x / 0.2 m/s"),
)


@dataclass(frozen=True)
class Stop:
    """Bring the parcel to rest with its centre at an asked x.

    A parcel enters a line of rotors amid supports and is to come to rest at a place, to 5 mm.

    The surface is under-actuated: a module brakes along its axis and lets roll across it, but never
    pushes. A parcel that has stopped short stays there, one that is past cannot be fetched back,
    and the last millimetres hang on which modules the base still covers.

    ### Start

    The rear at x = 0, on the line's middle, theta 0, no other speed than vx. Entry speed: uniform
    in `speeds`. Parcel: equal odds. Asked x: uniform over what can be reached for sure, from where
    a parcel rests that brakes fully (0.5 g) once it is wholly in the zone, to where it is wholly in
    the zone for the last time or has rolled 0.8 of the way it can. Where the first lies beyond the
    second, as in a short zone, it is the second.

    ### Goal and end

    The parcel rests when no point of the base moves faster than 1 mm/s. "success": it rests with
    its centre within 5 mm of the asked x. Each failure ends the episode as `terminated`:

    - "missed": it rests elsewhere;
    - "passed the asked x": its centre moves on more than 5 mm past it;
    - "off the line": no rotor is under the base any more;
    - "off the surface": the centre of mass passes the edge of the surface.

    Running out of time is `truncated`.

    ### Reward

    | term | scale | meaning |
    | --- | --- | --- |
    | `approach` | 1 a metre | by which the centre came nearer to the asked x |
    | `precision` | 1 | once, at rest: exp(-abs(`stop_error`) / 2 mm) |
    | `success` | 1 | once, at success |
    | `failure` | -1 | once, at any failure |

    ### Info

    - `stop_error` [m]: x of the centre - the asked one, at present; signed.

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Stop-v0", actions="halves")
        >>> observation, info = env.reset(options={"speed": 1.0, "parcel": "S", "position": 1.0})
        >>> observation, reward, terminated, truncated, info = env.step(15)  # all axes at 90 deg
        >>> info["outcome"], round(info["stop_error"], 3)
        ('running', -0.835)

    ### Version history

    - `v0`: first version.
    """

    speeds: tuple[float, float] = (0.5, 2.7)  # [m/s] entry speed
    parcels: tuple[str | Parcel, ...] = ("S", "B")  # to draw from

    number = 2
    plant = Line()
    features = FEATURES
    terms = TERMS
    figures = ("stop_error",)
    options = ("speed", "parcel", "position")

    def __post_init__(self) -> None:
        object.__setattr__(self, "speeds", rising("speeds", self.speeds, 0.0, 5.0))
        object.__setattr__(self, "parcels", parcels_to_draw(self.parcels))

    def start(
        self,
        rng: np.random.Generator,
        options: dict[str, Any],
        zone: tuple[int, int] | None,
    ) -> Start:
        """Entry speed and parcel: uniform. Asked x: uniform over what can be reached for sure.

        That is from where a parcel rests that brakes fully once it is wholly in the zone, to where
        it is wholly in the zone for the last time, or has rolled 0.8 of the way it can. Where the
        first lies beyond the second, as in a short zone, it is the second.
        """
        pace, size, share = rng.random(3).tolist()
        speed = self.speeds[0] + (self.speeds[1] - self.speeds[0]) * pace
        parcel = parcel_option(self.parcels[int(size * len(self.parcels))])
        if "speed" in options:
            speed = checks.within("speed", options["speed"], 0.0, 5.0)
        if "parcel" in options:
            parcel = parcel_option(options["parcel"])
        half_length = parcel.rear
        if "position" in options:
            surface_end = PITCH * self.plant.columns
            position = checks.within("position", options["position"], 0.0, surface_end)
        else:
            zone_start, zone_end = zone_of(self.plant, parcel, zone)
            rolled = half_length + 0.8 * speed**2 / (2.0 * ROLLING_LOSS)
            last = min(zone_end - half_length, rolled)
            first = min(zone_start + half_length + speed**2 / (2.0 * BRAKING), last)
            position = first + (last - first) * share
        return Start(parcel, entry(parcel), (speed, 0.0, 0.0), (position,))

    def readings(self, lanes: Lanes, lane: int) -> list[tuple[str, str]]:
        """The way to go."""
        return [("to go", f"{-1e3 * lanes.memory[lane, STOP_ERROR]:.1f} mm")]

    def goal(self, lanes: Lanes, lane: int) -> Any:
        """The line to stop at."""
        from surface_gym.rendering import StopLine

        return StopLine(float(lanes.goal[lane, POSITION]))


@inlined
def _score(lanes: Lanes, lane: int) -> float:
    return abs(lanes.goal[lane, POSITION] - lanes.truth[lane, 0])


@inlined
def begin(lanes: Lanes, lane: int) -> None:
    """Set the task's memory at a start."""
    lanes.memory[lane, SHORTFALL] = _score(lanes, lane)
    lanes.memory[lane, STOP_ERROR] = lanes.truth[lane, 0] - lanes.goal[lane, POSITION]


@inlined
def judge(lanes: Lanes, lane: int, on_rotors: bool, on_surface: bool) -> None:
    """Write reward terms and outcome after a control period, from the true state."""
    error = lanes.truth[lane, 0] - lanes.goal[lane, POSITION]
    outcome = failure(lanes, lane, on_rotors, on_surface)
    if outcome == STALLED:
        outcome = SUCCESS if abs(error) <= SUCCESS_ERROR else MISSED
    elif outcome == RUNNING and error > SUCCESS_ERROR:
        outcome = OVERSHOT
    shortfall = _score(lanes, lane)
    rests = outcome in (SUCCESS, MISSED)
    terms = lanes.terms[lane]
    terms[0] = APPROACH_REWARD * (lanes.memory[lane, SHORTFALL] - shortfall)
    terms[1] = PRECISION_REWARD * math.exp(-abs(error) / PRECISION_SCALE) if rests else 0.0
    terms[2] = SUCCESS_REWARD if outcome == SUCCESS else 0.0
    terms[3] = FAILURE_REWARD if outcome > SUCCESS else 0.0
    lanes.memory[lane, SHORTFALL] = shortfall
    lanes.memory[lane, STOP_ERROR] = error
    lanes.outcome[lane] = outcome


@inlined
def observe(lanes: Lanes, lane: int, geometry: Geometry) -> None:
    """Write the observation from what the sensors say."""
    see_parcel(lanes, lane, geometry)
    sensed = lanes.sensed[lane]
    to_go = lanes.goal[lane, POSITION] - sensed[0]
    excess = sensed[3] - math.sqrt(2.0 * BRAKING * max(0.0, to_go))
    see = lanes.observation[lane]
    see[13] = to_go / 0.5
    see[14] = math.tanh(to_go / 0.05)
    see[15] = math.tanh(to_go / 0.01)
    see[16] = excess / 0.2
