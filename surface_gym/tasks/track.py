"""Track: follow a path y(x) at an asked speed, on a tilted field."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import GRAVITY, Array
from surface_gym.lanes.memory import (
    FIGURES,
    GRAVITY_ALONG,
    HALF_LENGTH,
    OFF_PATH,
    OFF_SURFACE,
    PATH_POINTS,
    RUNNING,
    STALLED,
    SUCCESS,
    Geometry,
    Lanes,
)
from surface_gym.parcel import Parcel
from surface_gym.plant import PITCH, Field
from surface_gym.tasks.paths import DRAWS, KINDS, path_option, random_path, sample
from surface_gym.tasks.task import Feature, Start, parcel_option, parcels_to_draw, rising

SPEED, FIRST_X, STEP_X = range(3)  # columns of `Lanes.goal`: [m/s] asked, [m] x of `Lanes.path`
LAST_X, SQUARED_ERROR, SQUARED_SPEED_ERROR = range(3)  # columns of `Lanes.memory`: sums over time
RMS_ERROR, SPEED_ERROR, CROSS_ERROR = range(FIGURES, FIGURES + 3)  # [m], [m/s], [m]

FARTHEST = 0.15  # [m] off the path an episode goes on
STALL_SPEED = 0.05  # [m/s] slower than this is a failure: a stop is no way to follow
STEEPEST = 3.0  # [-] slope of a path
HIGHEST_TILT = math.radians(30.0)  # [rad]

# The reward, term by term. All but the last two are paid a metre of x, so that time earns nothing.
TERMS = ("distance", "precision", "cross_error", "speed_error", "success", "failure")
DISTANCE_REWARD = 0.3
PRECISION_REWARD = 1.0  # on the path, falling with the error by
PRECISION_SCALE = 0.005  # [m] a factor e
CROSS_REWARD = -8.0  # a metre of error
SPEED_REWARD = -2.0  # per m/s of error
SUCCESS_REWARD = 2.0
FAILURE_REWARD = -2.0

AHEAD = (0.0, 0.1, 0.2, 0.35)  # [m] where the path's slope is seen
_AHEAD_1, _AHEAD_2, _AHEAD_3 = AHEAD[1:]

FEATURES = (
    Feature("cross error", -200.0, 200.0, "across the path / 0.05 m"),
    Feature("fine cross error", -1.0, 1.0, "hyperbolic tangent of the cross error / 0.005 m"),
    Feature("speed error", -100.0, 100.0, "along the path / 0.2 m/s"),
    Feature("lateral speed", -200.0, 200.0, "across the path / 0.1 m/s"),
    Feature("asked speed", -1.0, 5.0, "/ 1 m/s - 0.8"),
    *(Feature(f"slope {ahead:g} m ahead", -STEEPEST, STEEPEST, "dy/dx") for ahead in AHEAD),
    Feature("tilt", 0.0, 5.0, "sine of the tilt / 0.2"),
    Feature("sine of theta", -1.0, 1.0, ""),
    Feature("cosine of theta", -1.0, 1.0, ""),
    Feature("turning speed", -50.0, 50.0, "omega / 3 rad/s"),
    Feature(
        "size", -10.0, 100.0, "(half length - 0.175 m) / 0.05 m: -1 for the S-box, 1 for the B"
    ),
    Feature("sine of phase x", -1.0, 1.0, "of the position within a pitch"),
    Feature("cosine of phase x", -1.0, 1.0, ""),
    Feature("sine of phase y", -1.0, 1.0, ""),
    Feature("cosine of phase y", -1.0, 1.0, ""),
)


@dataclass(frozen=True)
class Track:
    """Follow a path with the centre of the base, at an asked speed, on a field tilted downhill.

    A field of rotors everywhere, tilted downhill towards +x; the path is a curve y(x) across it.

    The surface is under-actuated: a module brakes along its axis and lets roll across it, but never
    pushes. Gravity alone drives the parcel, and only downhill: to go across, its speed has to be
    turned, and at little tilt there is none to waste.

    ### Start

    The centre on the path's first point, at the asked speed along the path, theta 0. Asked speed:
    uniform in `speeds`; tilt: uniform in `tilts`. Parcel and kind of path: equal odds. The path, by
    `surface_gym.tasks.paths.random_path`, from x = 0.4 m to 5.6 m: a sine wave, a change of lanes,
    a polyline or a cubic spline. The option `path` takes one of the classes of that module, or
    points (n, 2) [m] of a polyline; its slope may be 3 at most.

    ### Goal and end

    "success": the centre is past the path's last x. Each failure ends the episode as `terminated`:

    - "off the path": the centre is 0.15 m or more off the path, square to it;
    - "stalled": slower than 0.05 m/s;
    - "off the surface": the centre of mass passes the edge of the surface.

    Running out of time is `truncated`.

    ### Reward

    All but the last two are paid a metre of x gained, so that time earns nothing.

    | term | scale | meaning |
    | --- | --- | --- |
    | `distance` | 0.3 a metre | x gained |
    | `precision` | 1 a metre | times exp(-abs(`cross_error`) / 5 mm) |
    | `cross_error` | -8 a metre and metre | times abs(`cross_error`) |
    | `speed_error` | -2 a metre and m/s | times how far the speed along the path is off the \
asked one |
    | `success` | 2 | once, at success |
    | `failure` | -2 | once, at any failure |

    ### Info

    - `rms_error` [m]: root mean square of the error across the path over the time so far.
    - `speed_error` [m/s]: that of the speed along the path against the asked one.
    - `cross_error` [m]: the present error across the path, positive to its left.

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Track-v0", actions="window")
        >>> start = {"path": [(0.5, 1.0), (5.0, 1.0)], "speed": 0.8, "tilt": 0.1, "parcel": "S"}
        >>> observation, info = env.reset(options=start)
        >>> info["pose"].tolist(), info["velocity"].tolist(), info["rms_error"]
        ([0.5, 1.0, 0.0], [0.8, 0.0, 0.0], 0.0)

    ### Version history

    - `v0`: first version.
    """

    speeds: tuple[float, float] = (0.6, 1.0)  # [m/s] asked
    tilts: tuple[float, float] = (0.0, math.radians(15.0))  # [rad]
    kinds: tuple[str, ...] = KINDS  # of paths to draw
    parcels: tuple[str | Parcel, ...] = ("S", "B")  # to draw from

    number = 3
    plant = Field()
    features = FEATURES
    terms = TERMS
    figures = ("rms_error", "speed_error", "cross_error")
    options = ("speed", "parcel", "path", "tilt")

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        set_field(self, "speeds", rising("speeds", self.speeds, 0.0, 5.0))
        set_field(self, "tilts", rising("tilts", self.tilts, 0.0, HIGHEST_TILT))
        if not self.kinds:
            raise ValueError(f"kinds must be at least one, got {self.kinds!r}")
        for kind in self.kinds:
            checks.one_of("kinds", kind, KINDS)
        set_field(self, "parcels", parcels_to_draw(self.parcels))

    def start(
        self,
        rng: np.random.Generator,
        options: dict[str, Any],
        zone: tuple[int, int] | None,
    ) -> Start:
        """Asked speed and tilt: uniform. Parcel, kind of path: equal odds; the path by
        `paths.random_path`. The centre starts on the path at the asked speed along it, theta at 0.
        """
        del zone
        numbers = rng.random(4 + DRAWS)
        pace, slant, size, which = numbers[:4].tolist()
        speed = self.speeds[0] + (self.speeds[1] - self.speeds[0]) * pace
        tilt = self.tilts[0] + (self.tilts[1] - self.tilts[0]) * slant
        parcel = parcel_option(self.parcels[int(size * len(self.parcels))])
        if "speed" in options:
            speed = checks.within("speed", options["speed"], 0.1, 5.0)
        if "tilt" in options:
            tilt = checks.within("tilt", options["tilt"], 0.0, HIGHEST_TILT)
        if "parcel" in options:
            parcel = parcel_option(options["parcel"])
        if "path" in options:
            path = path_option(options["path"])
        else:
            path = random_path(self.kinds[int(which * len(self.kinds))], numbers[4:])
        y = sample(path, PATH_POINTS)
        step = (path.end - path.start) / (PATH_POINTS - 1)
        self._check_path(path.start, path.end, y, step)
        slope = (y[1] - y[0]) / step
        vx = speed / math.sqrt(1.0 + slope * slope)
        x0, y0 = parcel.base.centroid
        pose = (path.start - x0, float(y[0]) - y0, 0.0)
        goal = (speed, path.start, step)
        return Start(parcel, pose, (vx, slope * vx, 0.0), goal, tilt, y)

    def _check_path(self, start: float, end: float, y: NDArray[np.float64], step: float) -> None:
        length, width = PITCH * self.plant.columns, PITCH * self.plant.rows
        if start < 0.0 or end > length or y.min() < 0.0 or y.max() > width:
            raise ValueError(
                f"path must lie in x from 0 to {length:g} m and in y from 0 to {width:g} m, "
                f"got x from {start:g} to {end:g} and y from {y.min():g} to {y.max():g}"
            )
        steepest = np.abs(np.diff(y)).max() / step
        if steepest > STEEPEST:
            raise ValueError(f"path must have slopes of at most {STEEPEST:g}, got {steepest:g}")

    def readings(self, lanes: Lanes, lane: int) -> list[tuple[str, str]]:
        """The error across the path, its root mean square so far, and the asked speed."""
        memory = lanes.memory[lane]
        return [
            ("off path", f"{1e3 * memory[CROSS_ERROR]:+.1f} mm"),
            ("rms", f"{1e3 * memory[RMS_ERROR]:.1f} mm"),
            ("asked", f"{lanes.goal[lane, SPEED]:.2f} m/s"),
        ]

    def goal(self, lanes: Lanes, lane: int) -> Any:
        """The path."""
        from surface_gym.rendering import Path

        first, step = lanes.goal[lane, FIRST_X], lanes.goal[lane, STEP_X]
        x = first + step * np.arange(PATH_POINTS)
        return Path(np.stack([x, lanes.path[lane]], axis=-1))


@inlined
def _path_at(lanes: Lanes, lane: int, x: float) -> tuple[float, float]:
    """[m] y of the path at x, and its slope there; it goes on straight beyond its ends."""
    step = lanes.goal[lane, STEP_X]
    along = (x - lanes.goal[lane, FIRST_X]) / step
    i = int(min(max(along, 0.0), PATH_POINTS - 2.0))
    y = lanes.path[lane, i]
    rise = lanes.path[lane, i + 1] - y
    return y + (along - i) * rise, rise / step


@inlined
def _errors(lanes: Lanes, lane: int, pose_and_velocity: Array) -> tuple[float, float, float]:
    """[m] off the path, [m/s] over the asked speed along it, [m/s] across it; to its left."""
    y, slope = _path_at(lanes, lane, pose_and_velocity[0])
    cosine = 1.0 / math.sqrt(1.0 + slope * slope)
    vx, vy = pose_and_velocity[3], pose_and_velocity[4]
    along = (vx + slope * vy) * cosine - lanes.goal[lane, SPEED]
    return (pose_and_velocity[1] - y) * cosine, along, (vy - slope * vx) * cosine


@inlined
def begin(lanes: Lanes, lane: int) -> None:
    """Set the task's memory at a start."""
    memory = lanes.memory[lane]
    memory[LAST_X] = lanes.truth[lane, 0]
    memory[SQUARED_ERROR] = 0.0
    memory[SQUARED_SPEED_ERROR] = 0.0
    memory[RMS_ERROR] = 0.0
    memory[SPEED_ERROR] = 0.0
    memory[CROSS_ERROR], _, _ = _errors(lanes, lane, lanes.truth[lane])


@inlined
def judge(lanes: Lanes, lane: int, period: float, on_surface: bool) -> None:
    """Write reward terms and outcome after a control period, from the true state."""
    truth = lanes.truth[lane]
    memory = lanes.memory[lane]
    error, speed_error, _ = _errors(lanes, lane, truth)
    speed = math.sqrt(truth[3] * truth[3] + truth[4] * truth[4])
    path_end = lanes.goal[lane, FIRST_X] + (PATH_POINTS - 1) * lanes.goal[lane, STEP_X]
    outcome = RUNNING
    if not on_surface:
        outcome = OFF_SURFACE
    elif abs(error) >= FARTHEST:
        outcome = OFF_PATH
    elif truth[0] > path_end:
        outcome = SUCCESS
    elif speed < STALL_SPEED:
        outcome = STALLED
    if period > 0.0:
        memory[SQUARED_ERROR] += error * error * period
        memory[SQUARED_SPEED_ERROR] += speed_error * speed_error * period
        memory[RMS_ERROR] = math.sqrt(memory[SQUARED_ERROR] / lanes.clock[lane])
        memory[SPEED_ERROR] = math.sqrt(memory[SQUARED_SPEED_ERROR] / lanes.clock[lane])
    memory[CROSS_ERROR] = error
    distance = max(0.0, truth[0] - memory[LAST_X])
    memory[LAST_X] = truth[0]
    terms = lanes.terms[lane]
    terms[0] = DISTANCE_REWARD * distance
    terms[1] = PRECISION_REWARD * distance * math.exp(-abs(error) / PRECISION_SCALE)
    terms[2] = CROSS_REWARD * distance * abs(error)
    terms[3] = SPEED_REWARD * distance * abs(speed_error)
    terms[4] = SUCCESS_REWARD if outcome == SUCCESS else 0.0
    terms[5] = FAILURE_REWARD if outcome > SUCCESS else 0.0
    lanes.outcome[lane] = outcome


@inlined
def observe(lanes: Lanes, lane: int, geometry: Geometry) -> None:
    """Write the observation from what the sensors say."""
    sensed = lanes.sensed[lane]
    x, y, theta = sensed[0], sensed[1], sensed[2]
    error, speed_error, across = _errors(lanes, lane, sensed)
    turn = 2.0 * math.pi / geometry.pitch
    tilt = lanes.surface[lane, GRAVITY_ALONG] / GRAVITY
    see = lanes.observation[lane]
    see[0] = error / 0.05
    see[1] = math.tanh(error / 0.005)
    see[2] = speed_error / 0.2
    see[3] = across / 0.1
    see[4] = lanes.goal[lane, SPEED] - 0.8
    _, see[5] = _path_at(lanes, lane, x)
    _, see[6] = _path_at(lanes, lane, x + _AHEAD_1)
    _, see[7] = _path_at(lanes, lane, x + _AHEAD_2)
    _, see[8] = _path_at(lanes, lane, x + _AHEAD_3)
    see[9] = tilt / 0.2
    see[10] = math.sin(theta)
    see[11] = math.cos(theta)
    see[12] = sensed[5] / 3.0
    see[13] = (lanes.body[lane, HALF_LENGTH] - 0.175) / 0.05
    see[14] = math.sin(turn * (x - geometry.x0))
    see[15] = math.cos(turn * (x - geometry.x0))
    see[16] = math.sin(turn * (y - geometry.y0))
    see[17] = math.cos(turn * (y - geometry.y0))
