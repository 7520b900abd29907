"""Track: follow a path y(x) at an asked speed, on a tilted field."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from surface_gym import checks
from surface_gym.canvas import Canvas, draw_line
from surface_gym.compiler.jit import kernel_function
from surface_gym.layouts import LINE_Y
from surface_gym.lines import BaseLine, Field
from surface_gym.parcel import Parcel
from surface_gym.physics.contacts import bounded
from surface_gym.physics.types import GRAVITY, HALF_LENGTH, OMEGA, THETA, VX, VY, Array, X, Y
from surface_gym.state import (
    GRAVITY_X,
    PATH_POINTS,
    RUNNING,
    SUCCESS,
    EnvState,
    is_driven,
    planar_speed,
)
from surface_gym.tasks import paths as shapes
from surface_gym.tasks.base import (
    DIRECTION,
    MARK_WIDTH,
    PHASE,
    SIZE,
    TURNING_SPEED,
    Task,
    draw_speed,
    failures,
)
from surface_gym.tasks.benchmark import Benchmark, median_column
from surface_gym.tasks.features import Feature, columns, show, show_bent
from surface_gym.tasks.planning import FAILED, Nodes, ObservationTable, PlanCost, nearest_parcel
from surface_gym.tasks.start import Draw, Numbers, Start, between

SPEED, FIRST_X, STEP_X = range(3)  # indices in the goal: [m/s] asked speed, [m] x of the path
LAST_X, SQUARED_ERROR, SQUARED_SPEED_ERROR = range(3)  # indices in the memory: sums over time
RMS_ERROR, SPEED_ERROR, CROSS_ERROR = range(3)  # indices in the metrics: [m], [m/s], [m]

OUTCOMES = ("off the path", "stalled", "off the surface")
OFF_PATH, STALLED, OFF_SURFACE = failures(OUTCOMES)

FARTHEST = 0.15  # [m] maximum offset from the path
STALL_SPEED = 0.05  # [m/s] slower parcels count as stalled
STEEPEST = 3.0  # [-] slope of a path
DRAWN_PIECES = 51  # straight pieces of a path in a picture
HIGHEST_TILT = math.radians(30.0)  # [rad]

# The reward, term by term. All but the last two are per metre of x, so that time earns nothing.
TERMS: tuple[str, ...] = (
    "distance",
    "precision",
    "cross_error",
    "speed_error",
    "success",
    "failure",
)
DISTANCE_REWARD = 0.3
PRECISION_REWARD = 1.0  # on the path, decreasing with the error
PRECISION_SCALE = 0.005  # [m] error that divides the reward by e
CROSS_REWARD = -8.0  # per metre of error
SPEED_REWARD = -2.0  # per m/s of error
SUCCESS_REWARD = 2.0
FAILURE_REWARD = -2.0

AHEAD = (0.0, 0.1, 0.2, 0.35)  # [m] distances ahead at which the path's slope is observed

# For planners. A field is periodic, so only the position within a pitch matters: a parcel is put
# beside one module.
PLAN_COLUMN, PLAN_ROW = 10, 10
PLAN_ZONE = (6, 25)  # columns that a search may use from there
PIECE = 0.007  # [m] length along x of a piece of the rebuilt path
BEHIND = 60  # pieces behind the parcel
# Errors of equal cost.
PLAN_CROSS_ERROR = 0.003  # [m] off the path
PLAN_SPEED_ERROR = 0.08  # [m/s] off the asked speed
PLAN_CROSS_SPEED = 0.09  # [m/s] across the path at the horizon

FEATURES = (
    Feature("cross error", -200.0, 200.0, "distance from the path, positive to the left", "m", 0.05),
    Feature("fine cross error", -1.0, 1.0, "cross error on a finer scale", "m", 0.005, bent=True),
    Feature("speed error", -100.0, 100.0, "speed along the path minus the asked speed", "m/s", 0.2),
    Feature("lateral speed", -200.0, 200.0, "speed across the path", "m/s", 0.1),
    Feature("asked speed", -1.0, 5.0, "asked speed along the path", "m/s", 1.0, 0.8),
    *(Feature(f"slope {ahead:g} m ahead", -STEEPEST, STEEPEST, "dy/dx of the path, this far ahead in x") for ahead in AHEAD),
    Feature("tilt", 0.0, 5.0, "sine of the field's tilt", "", 0.2),
    *DIRECTION, TURNING_SPEED, SIZE, *PHASE,
)  # fmt: skip
COLUMN = columns(FEATURES)
SLOPE = COLUMN.slope_0_m_ahead.place  # column of the first slope


@dataclass(frozen=True)
class Track(Task):
    """Lead a parcel along a path at an asked speed, on a field tilted downhill.

    The field has rotors everywhere, and is tilted downhill towards +x. The path is a curve y(x).
    Gravity alone drives the parcel, and only downhill. To move along y, the parcel's velocity must
    turn. A turn costs speed.

    **Start.** The parcel's centre starts on the path's first point, at the asked speed along the
    path. The parcel is not turned (theta is 0). The asked speed is uniform in `speeds`. The tilt is
    uniform in `tilts`. Parcels are by default S- and B-boxes at equal odds. A random path goes from
    x = 0.4 m to 5.6 m. It is a sine wave, a lane change, a polyline or a cubic spline, at equal
    odds. The option `path` takes a path of `surface_gym.tasks.paths`, or points (n, 2) [m] of a
    polyline. The slope dy/dx of a path must be from -3 to 3.

    **Goal and end.** "success": the centre is past the path's last x. Failures are "off the path" (the centre is
    0.15 m or more from the path), "stalled" (the parcel is slower than 0.05 m/s) and "off the surface".

    ### Reward

    The first four terms are paid per metre of x gained, so a slow parcel does not earn more.

    | term | scale | meaning |
    | --- | --- | --- |
    | `distance` | 0.3 per metre | x gained |
    | `precision` | 1 per metre | x gained, times exp(-abs(`cross_error`) / 5 mm) |
    | `cross_error` | -8 per metre | x gained, times abs(`cross_error`) in m |
    | `speed_error` | -2 per metre | x gained, times the absolute difference in m/s between the speed \
along the path and the asked speed |
    | `success` | 2 | once, at success |
    | `failure` | -2 | once, at any failure |

    `info` has `cross_error` [m], the distance from the path, positive to the left. `rms_error` [m] is the root mean
    square of `cross_error` since the start. `speed_error` [m/s] is the root mean square of the true speed error
    (feature 2).

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Track-v0", actions="window")
        >>> start = {"path": [(0.5, 1.0), (5.0, 1.0)], "speed": 0.8, "tilt": 0.1, "parcel": "S"}
        >>> observation, info = env.reset(options=start)
        >>> info["pose"].tolist(), info["velocity"].tolist(), info["rms_error"]
        ([0.5, 1.0, 0.0], [0.8, 0.0, 0.0], 0.0)
    """

    speeds: tuple[float, float] = (0.6, 1.0)  # [m/s] asked speed
    tilts: tuple[float, float] = (0.0, math.radians(15.0))  # [rad] tilt of the field
    kinds: tuple[str, ...] = shapes.KINDS  # kinds of paths to draw

    line = Field()
    features = FEATURES
    terms = TERMS
    outcomes = OUTCOMES
    metrics = ("rms_error", "speed_error", "cross_error")
    options = ("speed", "parcel", "path", "tilt")
    ranges = {"speeds": (0.0, 5.0), "tilts": (0.0, HIGHEST_TILT, checks.DEGREES)}
    draws = 4 + shapes.DRAWS
    goals = 3
    memories = 3
    has_path = True
    periods = 300

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.kinds:
            raise ValueError(f"kinds must be at least one, got {self.kinds!r}")
        for kind in self.kinds:
            checks.one_of("kinds", kind, shapes.KINDS)

    def training_tasks(self) -> tuple[Task, ...]:
        """Return the task on fields with a tilt of 10 to 15 deg.

        On flatter fields, a parcel that is kept on its path loses speed, in spite of gravity.
        """
        return (replace(self, tilts=(math.radians(10.0), math.radians(15.0))),)

    def start(self, draw: Draw) -> Start:
        """Draw the asked speed, the tilt, the parcel and the kind of path, all uniformly.

        The parcel's centre starts on the path with theta 0, and moves along the path at the asked
        speed.
        """
        pace, slant, size, which = draw.numbers[:4]
        speed = draw.within("speed", between(*self.speeds, pace), 0.1, 5.0)
        tilt = draw.angle("tilt", between(*self.tilts, slant), 0.0, HIGHEST_TILT)
        parcel = draw.parcel(self.parcels, size)
        x, y = self._paths(draw, which)
        first, step = x[:, 0], (x[:, -1] - x[:, 0]) / (PATH_POINTS - 1)
        _check_paths(first, step, y, draw.line)
        slope = (y[:, 1] - y[:, 0]) / step
        vx = speed / np.sqrt(1.0 + slope * slope)
        x0, y0 = parcel.of(lambda each: each.base.centroid).T
        pose = (first - x0, y[:, 0] - y0, 0.0)
        return Start(parcel, pose, (vx, slope * vx, 0.0), (speed, first, step), tilt, y)

    def check_goal(self, goal: Numbers) -> None:
        checks.not_negative("goal[0]", goal[SPEED], checks.SPEED)
        checks.coordinate("goal[1]", goal[FIRST_X])
        checks.positive("goal[2]", goal[STEP_X], *checks.LENGTH)

    def _paths(self, draw: Draw, which: Numbers) -> tuple[Numbers, Numbers]:
        """Return x and y [m] (starts, PATH_POINTS) of the starts' paths.

        `which` (starts,) are numbers in [0, 1) that choose the kinds of random paths. Random paths
        are moved onto the line, and cut at the line's end. Paths from options stay as they are.
        """
        given = {start: shapes.path_option(value) for start, value in draw.given("path")}
        kinds = [self.kinds[k] for k in (which * len(self.kinds)).astype(int)]
        begin, last, _, _ = draw.line.extent
        laid = begin, draw.line.line_y - LINE_Y, last - shapes.START
        points = []
        for k, (kind, numbers) in enumerate(zip(kinds, draw.numbers[4:].T, strict=True)):
            path = given.get(k) or shapes.random_path(kind, numbers)
            ahead, aside, end = (0.0, 0.0, path.end) if k in given else laid
            x = np.linspace(path.start + ahead, min(path.end + ahead, end), PATH_POINTS)
            points.append((x, path.y(x - ahead) + aside))
        return np.array([x for x, _ in points]), np.array([y for _, y in points])

    def decode(self, seen: ObservationTable) -> "PathObservation":
        return PathObservation(
            cross_error=seen["cross error"],
            speed_error=seen["speed error"],
            cross_speed=seen["lateral speed"],
            asked_speed=seen["asked speed"],
            slope=np.stack([seen[f"slope {ahead:g} m ahead"] for ahead in AHEAD], axis=-1),
            tilt=np.arcsin(seen["tilt"]),
            theta=seen.theta,
            omega=seen["turning speed"],
            half_length=seen["size"],
            x_in_pitch=seen.in_pitch("x", seen.line.pitch_x),
            y_in_pitch=seen.in_pitch("y", seen.line.pitch_y),
        )

    def decode_start(self, seen: ObservationTable) -> Start:
        """Decode the first observation into a start. Unobserved parts of the path are straight."""
        shown, line = self.decode(seen), seen.line
        x = line.origin[0] + line.pitch_x * PLAN_COLUMN + float(shown.x_in_pitch[0])
        y = line.origin[1] + line.pitch_y * PLAN_ROW + float(shown.y_in_pitch[0])
        # The centre is at the middle of a piece.
        from_centre = PIECE * (np.arange(PATH_POINTS) - BEHIND - 0.5)
        slope = np.interp(from_centre[:-1] + 0.5 * PIECE, AHEAD, shown.slope[0])
        path = np.concatenate([[0.0], np.cumsum(PIECE * slope)])
        aside = float(shown.cross_error[0]) * math.sqrt(1.0 + float(shown.slope[0, 0]) ** 2)
        path += (y - aside) - 0.5 * (path[BEHIND] + path[BEHIND + 1])
        return shown.start(self.parcels, (x, y), (x + float(from_centre[0]), PIECE), path)

    def cost(self) -> PlanCost:
        return PlanCost(
            _mean_squares, _mean_squares, 0.0, horizon=8, follow=2, share=4, zone=PLAN_ZONE
        )

    def benchmark(self) -> Benchmark:
        """Return random starts. The default task has sine paths and tilts of 10 to 15 deg."""
        of_rms = median_column(
            "rms_error", "rms error [mm]", "off the path, median over starts", ".1f", 1e3
        )
        of_speed = median_column(
            "speed_error", "speed error [m/s]", "rms over an episode, median over starts", ".3f"
        )
        found = Benchmark(
            self,
            (of_rms, of_speed),
            example={"speed": 0.8, "parcel": "S", "tilt": 0.21},
            example_description="the S-box on a sine, at 12 deg of tilt",
            error="rms_error",
        )
        if self != Track():
            return found
        return replace(
            found,
            task=Track(tilts=(math.radians(10.0), math.radians(15.0)), kinds=("sine",)),
            description="drawn on sines, tilts 10 to 15 deg",
        )

    def readings(self, state: EnvState) -> list[tuple[str, str]]:
        return [
            ("off path", f"{1e3 * state.metrics[CROSS_ERROR]:+.1f} mm"),
            ("rms", f"{1e3 * state.metrics[RMS_ERROR]:.1f} mm"),
            ("asked", f"{state.goal[SPEED]:.2f} m/s"),
        ]

    def goal(self, state: EnvState) -> Any:
        from surface_gym.rendering import Path

        x = state.goal[FIRST_X] + state.goal[STEP_X] * np.arange(PATH_POINTS)
        return Path(np.stack([x, state.path], axis=-1))

    @staticmethod
    @kernel_function
    def begin(state: EnvState) -> None:
        """Set the sums of squared errors to 0, and write the metrics."""
        state.memory[LAST_X] = state.truth[X]
        state.memory[SQUARED_ERROR] = 0.0
        state.memory[SQUARED_SPEED_ERROR] = 0.0
        state.metrics[RMS_ERROR] = 0.0
        state.metrics[SPEED_ERROR] = 0.0
        state.metrics[CROSS_ERROR], _, _ = _errors(state, state.truth)

    @staticmethod
    @kernel_function
    def is_done(state: EnvState) -> bool:
        """Return False: an episode never ends in the middle of a control period."""
        return False

    @staticmethod
    @kernel_function
    def outcome(state: EnvState) -> int:
        """Return the outcome of the true motion. Update the sums of errors and the metrics."""
        memory = state.memory
        error, speed_error, _ = _errors(state, state.truth)
        if state.period > 0.0:
            memory[SQUARED_ERROR] += error * error * state.period
            memory[SQUARED_SPEED_ERROR] += speed_error * speed_error * state.period
            state.metrics[RMS_ERROR] = math.sqrt(memory[SQUARED_ERROR] / state.clock)
            state.metrics[SPEED_ERROR] = math.sqrt(memory[SQUARED_SPEED_ERROR] / state.clock)
        state.metrics[CROSS_ERROR] = error
        if not state.on_surface:
            return OFF_SURFACE
        if abs(error) >= FARTHEST:
            return OFF_PATH
        if state.truth[X] > state.goal[FIRST_X] + (PATH_POINTS - 1) * state.goal[STEP_X]:
            return SUCCESS
        stalls = planar_speed(state.truth) < STALL_SPEED and not is_driven(state)
        return STALLED if stalls else RUNNING

    @staticmethod
    @kernel_function
    def reward(state: EnvState, outcome: int) -> None:
        """Reward every metre gained in x. Smaller errors of place and speed earn more."""
        error, speed_error, _ = _errors(state, state.truth)
        distance = max(0.0, state.truth[X] - state.memory[LAST_X])
        state.memory[LAST_X] = state.truth[X]
        terms = state.terms
        terms[0] = DISTANCE_REWARD * distance
        terms[1] = PRECISION_REWARD * distance * math.exp(-abs(error) / PRECISION_SCALE)
        terms[2] = CROSS_REWARD * distance * abs(error)
        terms[3] = SPEED_REWARD * distance * abs(speed_error)
        terms[4] = SUCCESS_REWARD if outcome == SUCCESS else 0.0
        terms[5] = FAILURE_REWARD if outcome > SUCCESS else 0.0

    @staticmethod
    @kernel_function
    def observe(state: EnvState) -> None:
        """Write the observation from the sensed pose and velocity."""
        sensed = state.sensed
        x, y, theta = sensed[X], sensed[Y], sensed[THETA]
        error, speed_error, across = _errors(state, sensed)
        turn_x = 2.0 * math.pi / state.elements.pitch_x
        turn_y = 2.0 * math.pi / state.elements.pitch_y
        see = state.observation
        show(see, COLUMN.cross_error, error)
        show_bent(see, COLUMN.fine_cross_error, error)
        show(see, COLUMN.speed_error, speed_error)
        show(see, COLUMN.lateral_speed, across)
        show(see, COLUMN.asked_speed, state.goal[SPEED])
        for k in range(len(AHEAD)):
            _, see[SLOPE + k] = _path_at(state, x + AHEAD[k])
        show(see, COLUMN.tilt, state.surface[GRAVITY_X] / GRAVITY)
        show(see, COLUMN.sine_of_theta, math.sin(theta))
        show(see, COLUMN.cosine_of_theta, math.cos(theta))
        show(see, COLUMN.turning_speed, sensed[OMEGA])
        show(see, COLUMN.size, state.body[HALF_LENGTH])
        show(see, COLUMN.sine_of_phase_x, math.sin(turn_x * (x - state.elements.x0)))
        show(see, COLUMN.cosine_of_phase_x, math.cos(turn_x * (x - state.elements.x0)))
        show(see, COLUMN.sine_of_phase_y, math.sin(turn_y * (y - state.elements.y0)))
        show(see, COLUMN.cosine_of_phase_y, math.cos(turn_y * (y - state.elements.y0)))

    @staticmethod
    @kernel_function
    def draw_goal(state: EnvState, canvas: Canvas) -> None:
        """Draw the path. At the path's end, a line along y has the length 0.4 s * asked speed."""
        x, y = state.goal[FIRST_X], state.path[0]
        last = PATH_POINTS - 1
        for k in range(1, DRAWN_PIECES + 1):
            point = k * last // DRAWN_PIECES
            next_x, next_y = state.goal[FIRST_X] + point * state.goal[STEP_X], state.path[point]
            draw_line(canvas, (x, y), (next_x, next_y), MARK_WIDTH)
            x, y = next_x, next_y
        draw_speed(canvas, x, y, state.goal[SPEED])


def _check_paths(first: Numbers, step: Numbers, y: Numbers, line: BaseLine) -> None:
    """Raise a ValueError if a path leaves the line's surface or is too steep.

    `first` (paths,) [m] is the x of the first point, and `step` (paths,) [m] is the distance in x
    to the next point. `y` (paths, PATH_POINTS) [m] is the y of all points.
    """
    last = first + (PATH_POINTS - 1) * step
    low, high = y.min(axis=1), y.max(axis=1)
    left, right, bottom, top = line.extent
    outside = (first < left) | (last > right + 1e-12 * line.length)
    for k in np.nonzero(outside | (low < bottom) | (high > top))[0]:
        raise ValueError(
            f"path must lie in x from {left:g} to {right:g} m and in y from {bottom:g} to {top:g} "
            f"m, got x from {first[k]:g} to {last[k]:g} and y from {low[k]:g} to {high[k]:g}"
        )
    steepest = (np.abs(np.diff(y, axis=1)).max(axis=1) / step).max()
    if steepest > STEEPEST:
        raise ValueError(f"path must have slopes of at most {STEEPEST:g}, got {steepest:g}")


@kernel_function
def _path_at(state: EnvState, x: float) -> tuple[float, float]:
    """Return y [m] and slope [-] of the path at `x` [m]. Beyond its ends, the path is straight."""
    step = state.goal[STEP_X]
    along = (x - state.goal[FIRST_X]) / step
    i = int(bounded(along, 0.0, PATH_POINTS - 2.0))
    y = state.path[i]
    rise = state.path[i + 1] - y
    return y + (along - i) * rise, rise / step


@kernel_function
def _errors(state: EnvState, motion: Array) -> tuple[float, float, float]:
    """Return the cross error [m], the speed error [m/s] and the cross speed [m/s] of a motion.

    The cross error is the distance from the path, positive left of the path. The speed error is the
    speed along the path minus the asked speed. The cross speed is the speed across the path,
    positive towards the left side. `motion` (6,) is a pose and a velocity.
    """
    y, slope = _path_at(state, motion[X])
    cosine = 1.0 / math.sqrt(1.0 + slope * slope)
    along = (motion[VX] + slope * motion[VY]) * cosine - state.goal[SPEED]
    return (motion[Y] - y) * cosine, along, (motion[VY] - slope * motion[VX]) * cosine


@dataclass(frozen=True, eq=False)
class PathObservation:
    """Decoded observations of parcels that follow paths.

    An array has the shape (num_envs,), unless its comment states another shape.
    """

    cross_error: Numbers  # [m] perpendicular distance from the path, positive to its left
    speed_error: Numbers  # [m/s] excess over the asked speed, along the path
    cross_speed: Numbers  # [m/s] speed perpendicular to the path, positive to its left
    asked_speed: Numbers  # [m/s]
    slope: Numbers  # (num_envs, 4) dy/dx of the path at `AHEAD` [m] from the centre
    tilt: Numbers  # [rad]
    theta: Numbers  # [rad]
    omega: Numbers  # [rad/s]
    half_length: Numbers  # [m] half length of the base, a square
    x_in_pitch: Numbers  # [m] centre past the nearest module's, from -pitch/2 to pitch/2
    y_in_pitch: Numbers  # [m]

    @property
    def velocity(self) -> tuple[Numbers, Numbers]:
        """Velocity components vx and vy [m/s]. The two arrays have the shape (num_envs,)."""
        along = self.asked_speed + self.speed_error
        cosine = 1.0 / np.sqrt(1.0 + self.slope[:, 0] ** 2)
        sine = self.slope[:, 0] * cosine
        return along * cosine - self.cross_speed * sine, along * sine + self.cross_speed * cosine

    def start(
        self,
        parcels: tuple[Parcel, ...],
        place: tuple[float, float],
        grid: tuple[float, float],
        path: Numbers,
    ) -> Start:
        """Make a start at `place` (x, y) [m] from the observation of the first environment.

        The start gets the parcel of `parcels` whose size is closest to the observed size. `grid` is
        the path's first x and step in x [m]; `path` (PATH_POINTS,) [m] is the path's y.
        """
        vx, vy = (float(each[0]) for each in self.velocity)
        parcel = nearest_parcel(parcels, float(self.half_length[0]))
        pose, velocity = (*place, float(self.theta[0])), (vx, vy, float(self.omega[0]))
        goal = (float(self.asked_speed[0]), *grid)
        return Start(parcel, pose, velocity, goal, float(self.tilt[0]), path)


def _mean_squares(nodes: Nodes) -> Numbers:
    """Compute the costs (nodes,) of nodes from squared errors; a failure adds `FAILED` squared.

    The cost is the sum of the mean squared cross error, the mean squared speed error and the
    squared cross speed at the node. Before squaring, the three quantities are divided by
    `PLAN_CROSS_ERROR`, `PLAN_SPEED_ERROR` and `PLAN_CROSS_SPEED`. Cross means across the path.
    """
    parcels = nodes.parcels
    since = np.maximum(parcels.clock, 1e-9)
    off = parcels.memory[:, SQUARED_ERROR] / since / PLAN_CROSS_ERROR**2
    pace = parcels.memory[:, SQUARED_SPEED_ERROR] / since / PLAN_SPEED_ERROR**2
    lost = np.where(parcels.outcome > SUCCESS, FAILED**2, 0.0)
    x, _, _, vx, vy, _ = parcels.truth.T
    # All nodes of a search have the same path.
    first, step = parcels.goal[0, FIRST_X], parcels.goal[0, STEP_X]
    piece = np.clip((x - first) / step, 0.0, PATH_POINTS - 2.0).astype(np.int64)
    slope = np.diff(parcels.path[0])[piece] / step
    across: Numbers = (vy - slope * vx) / np.sqrt(1.0 + slope**2)
    return off + pace + (across / PLAN_CROSS_SPEED) ** 2 + lost
