"""Sort: leave the line quickly on the goal side."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from surface_gym import checks, state as st
from surface_gym.canvas import Canvas, draw_line
from surface_gym.compiler.jit import kernel_function
from surface_gym.layouts import ROLLING
from surface_gym.lines import BaseLine
from surface_gym.parcel import Parcel
from surface_gym.physics.types import GRAVITY, THETA, VX, VY, X, Y
from surface_gym.state import EnvState, ParcelState
from surface_gym.tasks import base, planning
from surface_gym.tasks.base import STALL_SPEED, Task, entry, failures
from surface_gym.tasks.benchmark import PARCELS, Benchmark, Numbers, ResultColumn, SpeedGrid
from surface_gym.tasks.features import Feature, columns, show
from surface_gym.tasks.start import Draw, Start, between

SIDE = 0  # index in the goal: +1 for y > 0, -1 for y < 0, 0 for straight ahead
REACH = 0  # index in the memory: [m] lateral reach at the last decision

OUTCOMES = ("wrong side", "passed the zone", "stalled", "off the surface")
WRONG_SIDE, PASSED, STALLED, OFF_SURFACE = failures(OUTCOMES)

# The reward, term by term.
TERMS: tuple[str, ...] = ("reach", "time", "success", "haste", "failure")
REACH_REWARD = 2.0  # per metre of lateral reach gained
REACH_ENOUGH = 0.6  # [m] maximum rewarded reach
PASSING_REACH = 0.3  # [-] share of x that counts as reach for side 0
TIME_REWARD = -0.3  # per second
SUCCESS_REWARD = 1.0
HASTE_REWARD = 4.0  # at success, times 1 s / duration
FAILURE_REWARD = -1.0

# A parcel rolling along 45 deg axes loses speed at mu_min g / sqrt(2) along x and along y.
ROLLING_LOSS = 0.01 * GRAVITY / math.sqrt(2.0)  # [m/s^2]
HORIZON = 4.0  # [s] scale of the observed time
SIDE_WIDTH = 0.1  # [m] of the goal side in a picture

TOWARDS = "towards the asked side"
# Features of a parcel, mirrored so that the asked side is y > 0.
SIDE_FEATURES = (
    replace(base.OFFSET, meaning=f"y from the line's middle, {TOWARDS}"),
    replace(base.DIRECTION[0], meaning=f"positive if turned {TOWARDS}"), base.DIRECTION[1],
    base.FORWARD_SPEED, replace(base.LATERAL_SPEED, meaning=f"vy {TOWARDS}"),
    replace(base.TURNING_SPEED, meaning=f"omega, positive {TOWARDS}"), base.SIZE,
    Feature("clearance", -20.0, 20.0, "distance in y by which the whole base is past the outermost rotors on the asked side; otherwise negative", "m", 0.2),
    *(replace(each, meaning=f"{each.meaning}; y counts {TOWARDS}") for each in base.PHASE),
)  # fmt: skip
FEATURES = (
    *SIDE_FEATURES,
    Feature("time", 0.0, 1000.0, "time since the start", "s", HORIZON),
    Feature(
        "distance into zone", -20.0, 20.0, "x of the rear minus x of the zone's start", "m", 0.5
    ),
    Feature("side", -1.0, 1.0, "asked side: 1 for y > 0, -1 for y < 0, 0 for straight ahead"),
)
COLUMN = columns(FEATURES)


@dataclass(frozen=True)
class Sort(Task):
    """Sort the parcel off the line to one side, quickly.

    A parcel enters a line of rotors among supports. It must leave the line towards the asked side:
    y > 0 (side 1) or y < 0 (side -1). With side 0, it must roll straight through the zone. Axes at
    -45 deg turn part of the speed towards y > 0, axes at 45 deg towards y < 0. Friction brakes the
    parcel meanwhile, so a slow parcel stalls on the line.

    **Start.** The rear is at x = 0, on the line's middle, with theta 0 and speed along x only. With probability
    `slow_share` the entry speed is uniform in `slow_speeds`, otherwise in `speeds`. Parcels are by default S- and
    B-boxes at equal odds. Sides 1 and -1 have equal odds. Side 0 is never drawn; only the option `side` asks for
    it.

    **Goal and end.** A parcel has left the line when no rotor is under its base. "success" with side 1 or -1: the
    parcel has left the line, and its centre is on the asked side of the line's middle. "success" with side 0: its
    rear has passed the zone's end, and it has not left the line. If it leaves the line in any other way, the
    outcome is "wrong side". If its rear passes the zone's end with side 1 or -1, the outcome is "passed the zone".
    Other [failures](../environments/environment.md#end) are "stalled" and "off the surface".

    ### Reward

    | term | scale | meaning |
    | --- | --- | --- |
    | `reach` | 2 per metre | increase of the reach. With side 1 or -1, the reach is the distance from the line's \
middle towards the asked side, plus the distance in y that the parcel would still roll over axes at 45 deg; a reach \
of more than 0.6 m counts as 0.6 m. With side 0, the reach is 0.3 x minus the distance from the line's middle |
    | `time` | -0.3 per second | elapsed time |
    | `success` | 1 | once, at success |
    | `haste` | 4 s / time | once, at success; `time` is the time since the start |
    | `failure` | -1 | once, at any failure |

    ### Example

        >>> import gymnasium as gym, surface_gym
        >>> env = gym.make("SmartSurface/Sort-v0", actions="halves")
        >>> observation, info = env.reset(options={"speed": 1.5, "parcel": "S", "side": 1})
        >>> observation, reward, terminated, truncated, info = env.step(15)  # all axes at 90 deg
        >>> info["outcome"], info["pose"][:2].round(3).tolist()
        ('running', [0.185, 1.0])
    """

    slow_share: float = 0.5  # [-] share of starts with `slow_speeds`, at which sorting is hard
    speeds: tuple[float, float] = (0.3, 2.7)  # [m/s] entry speed of all other starts
    slow_speeds: tuple[float, float] = (0.3, 1.1)  # [m/s] entry speed of the share `slow_share`

    features = FEATURES
    terms = TERMS
    outcomes = OUTCOMES
    mirrored = True
    options = ("speed", "parcel", "side")
    ranges = {"speeds": (0.0, 5.0), "slow_speeds": (0.0, 5.0)}
    draws = 4
    goals = 1
    memories = 1
    periods = 100

    def __post_init__(self) -> None:
        super().__post_init__()
        checks.within("slow_share", self.slow_share, 0.0, 1.0)
        for name in self.ranges:
            low, high = getattr(self, name)
            if low == 0.0:
                raise ValueError(f"{name} must be two rising positive speeds, got {(low, high)}")

    def start(self, draw: Draw) -> Start:
        """Draw the entry speed from `slow_speeds` or `speeds`. Draw parcel and side at equal odds.

        Side 0, straight ahead, is never drawn. Only an option of `reset` can set it.
        """
        band, pace, size, way = draw.numbers
        slow, any_speed = between(*self.slow_speeds, pace), between(*self.speeds, pace)
        speed = draw.within("speed", np.where(band < self.slow_share, slow, any_speed), 0.0, 5.0)
        parcel = draw.parcel(self.parcels, size)
        side = draw.one_of("side", np.where(way < 0.5, 1.0, -1.0), (1, -1, 0))
        return Start(parcel, entry(draw, parcel), (speed, 0.0, 0.0), (side,))

    def check_goal(self, goal: planning.Numbers) -> None:
        checks.one_of("goal", float(goal[SIDE]), (1.0, -1.0, 0.0))

    def benchmark(self) -> Benchmark:
        """Return starts for every speed, side and box, and the columns of the results table."""
        grid = SpeedGrid(np.arange(30, 271, 2) / 100.0)
        return Benchmark(
            self,
            (*(column for parcel in PARCELS for column in _box_columns(grid, parcel)), *_COLUMNS),
            grid.starts,
            "entry speeds 0.30 to 2.70 m/s in steps of 0.02 m/s, both sides, both boxes",
            {"speed": 0.6, "parcel": "S", "side": 1},
            "the S-box at 0.6 m/s, to y > 0",
            grid=grid,
        )

    def path_metrics(
        self, path: Numbers, parcel: Parcel, line: BaseLine, zone: tuple[int, int] | None
    ) -> dict[str, float]:
        """Return the metric `columns`: how many zone columns the front of the parcel reached."""
        base = parcel.base
        _, (_, _, first, _) = line.site(base, zone)
        x, _, theta = path.T
        from_centre = base.outline - base.centroid
        reach = (from_centre @ np.array([np.cos(theta), -np.sin(theta)])).max(axis=0)
        return {"columns": math.floor((x + reach).max() / line.pitch_x + 0.5) - first}

    def readings(self, state: EnvState) -> list[tuple[str, str]]:
        sides = {1: "y > 0", -1: "y < 0", 0: "straight on"}
        return [("sort to", sides[int(state.goal[SIDE])])]

    def goal(self, state: EnvState) -> Any:
        from surface_gym.rendering import ExitSide

        return ExitSide(int(state.goal[SIDE]))

    def decode_start(self, seen: planning.ObservationTable) -> Start:
        """Decode the first observation into a start. The start's goal is the goal side."""
        line = planning.decode_line(seen)
        return planning.line_start(seen, line, self.parcels, (float(line.side[0]),))

    def cost(self) -> planning.PlanCost:
        return planning.PlanCost(
            _time_to_leave,
            planning.time_cost,
            planning.FAILED,
            self.periods,
            self.periods,
            event=_event,
        )

    @staticmethod
    @kernel_function
    def mirror(state: EnvState) -> float:
        """Return -1 if the goal side is y < 0, because then the observation is mirrored; else 1."""
        return mirror_of(state)

    @staticmethod
    @kernel_function
    def begin(state: EnvState) -> None:
        """Store the reach [m], see `lateral_reach`. The reward counts the reach's increase."""
        state.memory[REACH] = _score(state)

    @staticmethod
    @kernel_function
    def outcome(state: EnvState) -> int:
        """Compute the outcome from the parcel's true pose and velocity."""
        truth = state.truth
        side = state.goal[SIDE]
        if not state.on_surface:
            return OFF_SURFACE
        if not state.on_rotors:
            towards = side * (truth[Y] - state.elements.line_y)
            return st.SUCCESS if towards > 0.0 else WRONG_SIDE
        if truth[X] - st.reach_along(state, truth[THETA], -1.0, 0.0) > st.zone_end(state):
            return st.SUCCESS if side == 0.0 else PASSED
        stalls = st.is_slower(state, STALL_SPEED) and not st.is_driven(state)
        return STALLED if stalls else st.RUNNING

    @staticmethod
    @kernel_function
    def reward(state: EnvState, outcome: int) -> None:
        """Write the terms for progress to the goal, time, success, quick success and failure."""
        reach = _score(state)
        terms = state.terms
        terms[0] = REACH_REWARD * (reach - state.memory[REACH])
        terms[1] = TIME_REWARD * state.period
        terms[2] = SUCCESS_REWARD if outcome == st.SUCCESS else 0.0
        terms[3] = HASTE_REWARD / state.clock if outcome == st.SUCCESS else 0.0
        terms[4] = FAILURE_REWARD if outcome > st.SUCCESS else 0.0
        state.memory[REACH] = reach

    @staticmethod
    @kernel_function
    def observe(state: EnvState) -> None:
        """Write the observation; mirror it if the goal side is y < 0."""
        side = mirror_of(state)
        offset = base.show_on_line(state, COLUMN, side)
        theta, see = state.sensed[THETA], state.observation
        half_line = 0.5 * state.elements.pitch_y * (state.zone[st.ROWS] - 1)
        rear = state.sensed[X] - st.reach_along(state, theta, -1.0, 0.0)
        clearance = offset - st.reach_along(state, theta, 0.0, -side) - half_line
        show(see, COLUMN.clearance, clearance)
        show(see, COLUMN.time, state.clock)
        show(see, COLUMN.distance_into_zone, rear - st.zone_start(state))
        show(see, COLUMN.side, state.goal[SIDE])

    @staticmethod
    @kernel_function
    def draw_goal(state: EnvState, canvas: Canvas) -> None:
        """Draw the zone's edge on the goal side. If the goal side is 0, draw the zone's end."""
        start, end, y = st.zone_start(state), st.zone_end(state), state.elements.line_y
        half = 0.5 * state.elements.pitch_y * state.zone[st.ROWS]
        if state.goal[SIDE] == 0.0:
            draw_line(canvas, (end, y - half), (end, y + half), SIDE_WIDTH)
        else:
            y += state.goal[SIDE] * (half + 0.5 * SIDE_WIDTH)
            draw_line(canvas, (start, y), (end, y), SIDE_WIDTH)


@kernel_function
def mirror_of(state: EnvState) -> float:
    """Return -1 if the observation is mirrored, i.e. if the goal side is y < 0; else return 1."""
    return -1.0 if state.goal[SIDE] < 0.0 else 1.0


@kernel_function
def lateral_reach(y: float, vx: float, vy: float) -> float:
    """Return the lateral offset [m] that a parcel can reach by rolling over axes at 45 deg.

    The parcel has the offset `y` [m] towards the goal side, and the velocity (`vx`, `vy`) [m/s].
    """
    speed = max(0.0, 0.5 * (vx + vy) if vx > vy else vy)
    return y + speed * speed / (2.0 * ROLLING_LOSS)


@kernel_function
def _score(state: EnvState) -> float:
    side = state.goal[SIDE]
    truth = state.truth
    offset = truth[Y] - state.elements.line_y
    if side == 0.0:
        return PASSING_REACH * truth[X] - abs(offset)
    return min(REACH_ENOUGH, lateral_reach(side * offset, truth[VX], side * truth[VY]))


def _time_to_leave(nodes: planning.Nodes) -> Numbers:
    """Compute the time [s] (nodes,) in which axes at 45 deg would lead the parcel off the line.

    If the parcel would stop on the line, a cost for the missing energy is added. For the exit
    straight ahead, the result is the distance [m] from the line's middle minus a tenth of x [m].
    """
    _, y, _, vx, vy, _ = nodes.parcels.truth.T
    turning, loss = nodes.braking / math.sqrt(2.0), nodes.rolling_loss / math.sqrt(2.0)
    side = nodes.parcels.goal[:, SIDE]
    if side[0] == 0.0:
        return planning.off_line(nodes) - 0.1 * nodes.parcels.truth[:, 0]
    vy = side * vy
    half_line = 0.5 * nodes.line.pitch_y * (nodes.zone[1] - 1)
    left = nodes.reach(0.0, -side[0]) + half_line - side * (y - nodes.line.line_y)
    left = np.maximum(0.0, left)
    kept = np.maximum(0.0, np.where(vx > vy, 0.5 * (vx + vy), vy))
    vy = np.clip(vy, 0.0, kept)
    turned_after = (kept - vy) / turning
    while_turning = 0.5 * (kept + vy) * turned_after
    at_once = (np.sqrt(vy**2 + 2.0 * turning * left) - vy) / turning
    square = kept**2 - 2.0 * loss * np.maximum(0.0, left - while_turning)
    later = turned_after + (kept - np.sqrt(np.maximum(0.0, square))) / loss
    return np.where(left < while_turning, at_once, later) + planning.FAILED * np.maximum(
        0.0, -square
    )


def _event(parcels: ParcelState) -> tuple[float, float] | None:
    """Return two successive angles [rad] of all axes, or None if the goal side is 0.

    At the first angle, the parcel rolls ahead. At the second angle, the axes lead the parcel to the
    goal side. The planner searches for the time of the change.
    """
    side = float(parcels.goal[0, SIDE])
    return None if side == 0.0 else (ROLLING, -side * math.pi / 4.0)


def _box_columns(grid: SpeedGrid, parcel: str) -> tuple[ResultColumn, ...]:
    return (
        ResultColumn(
            f"minimum_speed_{parcel}",
            f"minimum {parcel} [m/s]",
            f"entry speed from which on every start of every seed is sorted, {parcel}-box",
            lambda runs, _: grid.minimum_speed(runs, parcel),
            every_start=True,
        ),
        ResultColumn(
            f"success_{parcel}",
            f"success {parcel}",
            f"share of the {parcel}-box's starts",
            lambda runs, _: grid.success_rate(runs, parcel),
            ".3f",
            every_start=True,
        ),
        ResultColumn(
            f"time_{parcel}",
            f"time {parcel}",
            "greatest time to sort over the fixed layout's, at the speeds that one sorts at",
            lambda runs, fixed: grid.worst_time(runs, fixed, parcel),
            ".3f",
            every_start=True,
        ),
    )


_COLUMNS = (
    ResultColumn(
        "columns",
        "columns",
        "of the zone that a parcel sorted touched, on average",
        lambda runs, _: (
            float(runs.metric("columns")[runs.success].mean()) if runs.success.any() else math.nan
        ),
        ".1f",
    ),
    ResultColumn(
        "parcels_an_hour",
        "parcels/h",
        "an hour's parcels, each alone on the surface, by the mean time of those sorted",
        lambda runs, _: (
            3600.0 / float(runs.time[runs.success].mean()) if runs.success.any() else math.nan
        ),
        ".0f",
    ),
)
