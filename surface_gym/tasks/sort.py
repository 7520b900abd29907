"""Sort: leave the line on the asked side, quickly."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from surface_gym import checks
from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import GRAVITY
from surface_gym.lanes.memory import (
    COLUMNS,
    FIRST_COLUMN,
    HALF_LENGTH,
    OFF_SURFACE,
    PASSED,
    ROWS,
    RUNNING,
    STALLED,
    SUCCESS,
    WRONG_SIDE,
    Geometry,
    Lanes,
)
from surface_gym.lanes.views import reach_along
from surface_gym.layouts import LINE_Y
from surface_gym.parcel import Parcel
from surface_gym.plant import Line
from surface_gym.tasks.task import Feature, Start, parcel_option, parcels_to_draw

SIDE = 0  # column of `Lanes.goal`: +1 for y > 0, -1 for y < 0, 0 for straight through
REACH = 0  # column of `Lanes.memory`: [m] the lateral reach at the last decision

# The reward, term by term.
TERMS = ("reach", "time", "success", "haste", "failure")
REACH_REWARD = 2.0  # per metre of lateral reach gained
REACH_ENOUGH = 0.6  # [m] reach beyond this earns nothing more
PASSING_REACH = 0.3  # [-] of x counts as reach where straight through is asked
TIME_REWARD = -0.3  # per second
SUCCESS_REWARD = 1.0
HASTE_REWARD = 4.0  # at success, times 1 s over the time it took
FAILURE_REWARD = -1.0

# A parcel rolling along 45 deg axes loses speed at mu_min g / sqrt(2) along x and along y.
ROLLING_LOSS = 0.01 * GRAVITY / math.sqrt(2.0)  # [m/s^2]
STALL_SPEED = 1e-3  # [m/s] slower than this, friction has won on a flat surface
HORIZON = 4.0  # [s] scale of the time observed

FEATURES = (
    Feature("lateral offset", -10.0, 10.0, "from the line's middle towards the asked side / 0.3 m"),
    Feature("sine of theta", -1.0, 1.0, "positive if turned towards the asked side"),
    Feature("cosine of theta", -1.0, 1.0, ""),
    Feature("forward speed", -10.0, 10.0, "vx / 1 m/s - 1"),
    Feature("lateral speed", -20.0, 20.0, "towards the asked side / 0.5 m/s"),
    Feature("turning speed", -50.0, 50.0, "positive towards the asked side / 3 rad/s"),
    Feature(
        "size", -10.0, 100.0, "(half length - 0.175 m) / 0.05 m: -1 for the S-box, 1 for the B"
    ),
    Feature("clearance", -20.0, 20.0, "between the base and the line's rotors / 0.2 m"),
    Feature("sine of phase x", -1.0, 1.0, "of the position within a pitch"),
    Feature("cosine of phase x", -1.0, 1.0, ""),
    Feature("sine of phase y", -1.0, 1.0, "towards the asked side"),
    Feature("cosine of phase y", -1.0, 1.0, ""),
    Feature("time", 0.0, 1000.0, "since the start / 4 s"),
    Feature("distance into zone", -20.0, 20.0, "of the parcel's rear / 0.5 m"),
    Feature("side", -1.0, 1.0, "asked: 1 for y > 0, -1 for y < 0, 0 for neither"),
)


@dataclass(frozen=True)
class Sort:
    """Sort the parcel off the line to one side, quickly.

    A parcel enters a line of rotors amid supports and is to leave it towards y > 0 or y < 0; asked
    for neither, it is to roll through the zone and stay on the line.

    The surface is under-actuated: a module brakes along its axis and lets roll across it, but never
    pushes. Axes at -45 deg turn part of the speed towards y > 0, at +45 deg towards y < 0, and
    friction spends it all the while: a slow parcel stalls before it is off the line.

    ### Start

    The rear at x = 0, on the line's middle, theta 0, no other speed than vx. Entry speed: from the
    band `slow_speeds` with the probability `slow_share`, else from `speeds`, uniform in it. Parcel
    and side, +1 (y > 0) or -1 (y < 0): equal odds. Side 0, straight through, is only an option.

    ### Goal and end

    "success": no rotor is under the base any more, and its centre is on the asked side of the
    line's middle. For side 0: the rear is past the zone's end, with a rotor still under the base.
    Each failure ends the episode as `terminated`:

    - "wrong side": off the rotors, but not on the asked side (for side 0: off them at all);
    - "passed the zone": the rear is past the zone's end (sides +1 and -1);
    - "stalled": no point of the base moves faster than 1 mm/s;
    - "off the surface": the centre of mass passes the edge of the surface.

    Running out of time is `truncated`, and is not a failure of the reward.

    ### Reward

    | term | scale | meaning |
    | --- | --- | --- |
    | `reach` | 2 a metre | gain of lateral reach: the offset to the asked side and what the present \
speed would still cover coasting at 45 deg; beyond 0.6 m no more. For side 0, 0.3 x less the \
distance from the line's middle takes its place |
    | `time` | -0.3 a second | time that passed |
    | `success` | 1 | once, at success |
    | `haste` | 4 | once, at success, times 1 s over the time it took |
    | `failure` | -1 | once, at any failure |

    ### Info

    The task adds no figure of its own to what every environment reports.

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Sort-v0", actions="halves")
        >>> observation, info = env.reset(options={"speed": 1.5, "parcel": "S", "side": 1})
        >>> observation, reward, terminated, truncated, info = env.step(15)  # all axes at 90 deg
        >>> info["outcome"], info["pose"].round(3).tolist()
        ('running', [0.185, 1.0, 0.0])

    ### Version history

    - `v0`: first version.
    """

    slow_share: float = 0.5  # [-] of starts drawn from the low band, where sorting is hard
    speeds: tuple[float, float] = (0.3, 2.7)  # [m/s] entry speed
    slow_speeds: tuple[float, float] = (0.3, 1.1)  # [m/s] the low band
    parcels: tuple[str | Parcel, ...] = ("S", "B")  # to draw from

    number = 0
    plant = Line()
    features = FEATURES
    terms = TERMS
    figures = ()
    options = ("speed", "parcel", "side")

    def __post_init__(self) -> None:
        checks.within("slow_share", self.slow_share, 0.0, 1.0)
        for name in ("speeds", "slow_speeds"):
            low, high = checks.array(name, getattr(self, name), (2,))
            if not 0.0 < low <= high:
                raise ValueError(f"{name} must be two rising positive speeds, got {(low, high)}")
        object.__setattr__(self, "parcels", parcels_to_draw(self.parcels))

    def start(
        self,
        rng: np.random.Generator,
        options: dict[str, Any],
        zone: tuple[int, int] | None,
    ) -> Start:
        """Entry speed: a band by `slow_share`, uniform in it. Parcel and side: equal odds.

        Straight through, side 0, is only an option.
        """
        del zone
        band, where, size, way = rng.random(4).tolist()
        low, high = self.slow_speeds if band < self.slow_share else self.speeds
        speed = low + (high - low) * where
        parcel = parcel_option(self.parcels[int(size * len(self.parcels))])
        side = 1 if way < 0.5 else -1
        if "speed" in options:
            speed = checks.within("speed", options["speed"], 0.0, 5.0)
        if "parcel" in options:
            parcel = parcel_option(options["parcel"])
        if "side" in options:
            side = checks.one_of("side", options["side"], (1, -1, 0))
        return Start(parcel, (parcel.rear, LINE_Y, 0.0), (speed, 0.0, 0.0), (float(side),))

    def readings(self, lanes: Lanes, lane: int) -> list[tuple[str, str]]:
        """The asked side."""
        sides = {1: "y > 0", -1: "y < 0", 0: "straight on"}
        return [("sort to", sides[int(lanes.goal[lane, SIDE])])]

    def goal(self, lanes: Lanes, lane: int) -> Any:
        """The exit side."""
        from surface_gym.rendering import ExitSide

        return ExitSide(int(lanes.goal[lane, SIDE]))


@inlined
def mirror_of(lanes: Lanes, lane: int) -> float:
    """-1 where y is mirrored, so that what is seen is always a sort to y > 0, else 1."""
    return -1.0 if lanes.goal[lane, SIDE] < 0.0 else 1.0


@inlined
def _lateral_reach(y: float, vx: float, vy: float) -> float:
    """[m] lateral offset the parcel can still get to, coasting: the offset, plus what the speed
    it would keep on 45 deg axes covers against the rolling loss.
    """
    speed = max(0.0, 0.5 * (vx + vy) if vx > vy else vy)
    return y + speed * speed / (2.0 * ROLLING_LOSS)


@inlined
def _score(lanes: Lanes, lane: int, geometry: Geometry) -> float:
    side = lanes.goal[lane, SIDE]
    truth = lanes.truth[lane]
    if side == 0.0:
        return PASSING_REACH * truth[0] - abs(truth[1] - geometry.line_y)
    y = side * (truth[1] - geometry.line_y)
    return min(REACH_ENOUGH, _lateral_reach(y, truth[3], side * truth[4]))


@inlined
def begin(lanes: Lanes, lane: int, geometry: Geometry) -> None:
    """Set the task's memory at a start."""
    lanes.memory[lane, REACH] = _score(lanes, lane, geometry)


@inlined
def judge(
    lanes: Lanes, lane: int, geometry: Geometry, period: float, on_rotors: bool, on_surface: bool
) -> None:
    """Write reward terms and outcome after a control period, from the true state."""
    truth = lanes.truth[lane]
    theta = truth[2]
    zone_end = geometry.x0 + geometry.pitch * (
        lanes.zone[lane, FIRST_COLUMN] + lanes.zone[lane, COLUMNS] - 0.5
    )
    speed = math.sqrt(truth[3] * truth[3] + truth[4] * truth[4])
    side = lanes.goal[lane, SIDE]
    outcome = RUNNING
    if not on_surface:
        outcome = OFF_SURFACE
    elif not on_rotors:
        towards = side * (truth[1] - geometry.line_y)
        outcome = SUCCESS if towards > 0.0 else WRONG_SIDE
    elif truth[0] - reach_along(lanes, lane, theta, -1.0, 0.0) > zone_end:
        outcome = SUCCESS if side == 0.0 else PASSED
    elif speed + abs(truth[5]) * lanes.body[lane, HALF_LENGTH] < STALL_SPEED:
        outcome = STALLED
    reach = _score(lanes, lane, geometry)
    terms = lanes.terms[lane]
    terms[0] = REACH_REWARD * (reach - lanes.memory[lane, REACH])
    terms[1] = TIME_REWARD * period
    terms[2] = SUCCESS_REWARD if outcome == SUCCESS else 0.0
    terms[3] = HASTE_REWARD / lanes.clock[lane] if outcome == SUCCESS else 0.0
    terms[4] = FAILURE_REWARD if outcome > SUCCESS else 0.0
    lanes.memory[lane, REACH] = reach
    lanes.outcome[lane] = outcome


@inlined
def observe(lanes: Lanes, lane: int, geometry: Geometry) -> None:
    """Write the observation from what the sensors say, mirrored so that the goal is y > 0."""
    side = mirror_of(lanes, lane)
    sensed = lanes.sensed[lane]
    x, y, theta = sensed[0], sensed[1], sensed[2]
    vx, vy, omega = sensed[3], sensed[4], sensed[5]
    offset = side * (y - geometry.line_y)
    turn = 2.0 * math.pi / geometry.pitch
    half_line = 0.5 * geometry.pitch * (lanes.zone[lane, ROWS] - 1)
    zone_start = geometry.x0 + geometry.pitch * (lanes.zone[lane, FIRST_COLUMN] - 0.5)
    rear = x - reach_along(lanes, lane, theta, -1.0, 0.0)
    see = lanes.observation[lane]
    see[0] = offset / 0.3
    see[1] = side * math.sin(theta)
    see[2] = math.cos(theta)
    see[3] = vx - 1.0
    see[4] = side * vy / 0.5
    see[5] = side * omega / 3.0
    see[6] = (lanes.body[lane, HALF_LENGTH] - 0.175) / 0.05
    see[7] = (offset - reach_along(lanes, lane, theta, 0.0, -side) - half_line) / 0.2
    see[8] = math.sin(turn * (x - geometry.x0))
    see[9] = math.cos(turn * (x - geometry.x0))
    see[10] = math.sin(turn * offset)
    see[11] = math.cos(turn * offset)
    see[12] = lanes.clock[lane] / HORIZON
    see[13] = (rear - zone_start) / 0.5
    see[14] = lanes.goal[lane, SIDE]
