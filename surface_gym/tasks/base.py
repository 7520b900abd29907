"""The base class of tasks, and common parts of tasks on a line: entry, features, exit, failures."""

import math
from dataclasses import dataclass, field, fields, replace
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks, state as st
from surface_gym.canvas import Canvas, draw_line
from surface_gym.compiler.jit import kernel_function
from surface_gym.lines import BaseLine, Line
from surface_gym.parcel import Parcel
from surface_gym.physics.types import GRAVITY, HALF_LENGTH, OMEGA, THETA, VX, VY, X, Y
from surface_gym.state import EnvState
from surface_gym.tasks.benchmark import Benchmark, default_benchmark
from surface_gym.tasks.features import Feature, columns, show, show_within
from surface_gym.tasks.planning import ObservationTable, PlanCost, decode_line, line_start
from surface_gym.tasks.start import Draw, Numbers, Parcels, Start, parcels_to_draw


def failures(outcomes: tuple[str, ...]) -> range:
    """Return the outcome numbers of a task's failures, in the order of the names `outcomes`."""
    return range(st.FIRST_FAILURE, st.FIRST_FAILURE + len(outcomes))


@dataclass(frozen=True)
class Task:
    """The base class of tasks: starts, observation, reward, and the end of an episode.

    A task is one class. Its fields are its parameters. Its class variables describe observation,
    reward and starts. Its static methods are `kernel_function`s, compiled into every batch of the
    task. A subclass inherits everything that it does not replace.

    The compiled functions read and write an `EnvState`:

    - `begin(state)`, at a start: set `state.memory` and `state.metrics`.
    - `is_done(state) -> bool`, after every physics step: whether the episode ends in the middle of
      a control period. The default function returns whether no rotor is under the parcel.
    - `outcome(state) -> int`, after a control period: return RUNNING, SUCCESS or a failure, and
      write `state.metrics`.
    - `reward(state, outcome)`, after `outcome`: write all of `state.terms`.
    - `observe(state)`, at a start and after every control period: write all features into
      `state.observation`, from `state.sensed`.
    - `mirror(state) -> float`: return -1 if the observation is mirrored in y, else 1. The value
      -1 also mirrors the features of modules.
    - `draw_goal(state, canvas)`, if the observation is a picture: draw the goal by `draw_line`.

    The compiled functions cannot read the task's fields. A start must write the parameters that
    these functions need into the goal, `state.goal`.

    Tasks with `goal_features` may be goal environments: see `achieved`, `asked` and `reached`.

    Three ordinary methods serve rules and planners. `decode` turns observations into SI units,
    `decode_start` turns an observation into a start, and `cost` returns a planner's cost.
    """

    parcels: Any = field(default=("S", "B"), kw_only=True)  # parcels to draw from
    # [m] lateral distance of the entry from the line's middle; the side is drawn with equal odds
    entry_offset: float = field(default=0.0, kw_only=True)
    # [rad] angle of the parcel at the entry, turned towards the same side as `entry_offset`
    entry_turn: float = field(default=0.0, kw_only=True)
    # number of control periods after which an episode is truncated; None: the task's own limit
    time_limit: int | None = field(default=None, kw_only=True)

    line: ClassVar[BaseLine] = Line()
    features: ClassVar[tuple[Feature, ...]]
    terms: ClassVar[tuple[str, ...]]  # names of reward terms, in the order of `state.terms`
    outcomes: ClassVar[tuple[str, ...]]  # names of the failures
    metrics: ClassVar[tuple[str, ...]] = ()  # numbers in `info`, in the order of `state.metrics`
    options: ClassVar[tuple[str, ...]] = ()  # names of reset options
    # fields with two rising numbers: their limits, and a hint for an error
    ranges: ClassVar[dict[str, tuple[Any, ...]]] = {}
    draws: ClassVar[int] = 0  # uniform random numbers per start
    goals: ClassVar[int] = 0  # size of `state.goal`
    memories: ClassVar[int] = 0  # size of `state.memory`
    has_path: ClassVar[bool] = False  # whether its starts have a path
    # whether an episode ends when the parcel's rear leaves the zone
    leaves_zone: ClassVar[bool] = False
    # whether goals at y < 0 are observed in a mirror, so that actions must be mirrored too
    mirrored: ClassVar[bool] = False
    goal_features: ClassVar[tuple[str, ...]] = ()  # features that depend on the goal, see `GoalEnv`
    is_stream: ClassVar[bool] = False  # whether it is a `StreamTask`
    batch: ClassVar[str] = "surface_gym.core.batch:Batch"  # "module:Class" of its batch
    periods: ClassVar[int] = 100  # control periods after which an episode is truncated

    def __post_init__(self) -> None:
        for name in ("features", "terms", "outcomes"):
            if not isinstance(getattr(self, name, None), tuple):
                raise ValueError(
                    f"{type(self).__name__}.{name} must be a tuple, as Task says, "
                    f"got {getattr(self, name, None)!r}"
                )
        checks.set_fields(self, parcels=parcels_to_draw(self.parcels))
        checks.settle(self, **{name: (rising, *limits) for name, limits in self.ranges.items()})
        checks.number("entry_offset", self.entry_offset)
        checks.angle("entry_turn", self.entry_turn)
        if self.time_limit is not None:
            checks.set_fields(self, periods=checks.integer("time_limit", self.time_limit, least=1))

    @property
    def name(self) -> str:
        """Name of the task's class in lower case, e.g. "sort"."""
        return type(self).__name__.lower()

    def start(self, draw: Draw) -> Start:
        """Draw starts. `draw` has the random numbers and the options of `reset`."""
        del draw
        raise ValueError(f"{type(self).__name__}.start must be a method, as Task says, got none")

    @property
    def rows(self) -> int:
        """Number of parcels per environment, each with a row in the state arrays."""
        return 1

    @property
    def parcel_terms(self) -> tuple[str, ...]:
        """Names of the reward terms of a parcel."""
        return self.terms

    def training_tasks(self) -> "tuple[Task, ...]":
        """Return the tasks on which agents train for this task. The default is this task alone."""
        return (self,)

    def with_parcels(self, parcels: tuple[Parcel, ...]) -> "Task":
        """Return a copy with `parcels`, or this task if its own parcels are not the default."""
        default = next(each.default for each in fields(self) if each.name == "parcels")
        is_default = self.parcels == parcels_to_draw(default)
        return replace(self, parcels=parcels) if is_default else self

    def count_periods(self, control_period: float) -> int:
        """Return an episode's maximum number of control periods of length `control_period` [s]."""
        del control_period
        return self.periods

    def noise_rows(self, used: int) -> int:
        """Return how many rows of sensor noise a parcel needs per control period.

        `used` is the maximum number of rows that the sensor itself uses in a control period.
        """
        return used

    def action_kind(self, config: Any) -> Any:
        """Return the task's own kind of action, or None to let the configuration choose."""
        del config

    def check(self, config: Any) -> None:
        """Raise a ValueError if an environment's configuration does not suit the task."""
        randomisation = config.randomisation
        for parcel in self.parcels:
            try:
                config.chosen_line.site(randomisation.largest(parcel.base), config.zone)
                randomisation.least(parcel.base)
            except ValueError as error:
                raise ValueError(
                    f"size must leave room for every parcel, got {randomisation.size!r}: {error}"
                ) from None

    def displaced_start(self, draw: Draw) -> Start:
        """Draw starts by calling the method `start`, then displace and turn each start at random.

        Either add `entry_offset` to y and `entry_turn` to theta, or subtract these two numbers.
        """
        start = self.start(draw)
        if (self.entry_offset, self.entry_turn) == (0.0, 0.0):
            return start
        # Low digits of a random number determine the side.
        side = np.where(draw.numbers[0] * 1e6 % 1.0 < 0.5, 1.0, -1.0)
        x, y, theta = start.pose
        y, theta = np.add(y, self.entry_offset * side), np.add(theta, self.entry_turn * side)
        return start._replace(pose=(x, y, theta))

    def check_goal(self, goal: Numbers) -> None:
        """Raise a ValueError if a goal (goals,) from a machine is not allowed in the task."""
        checks.limited("goal", goal, checks.FARTHEST)

    def achieved(self, state: EnvState) -> tuple[float, ...]:
        """Return the sensed values (quantities,) that `GoalEnv` compares with the goal."""
        del state
        raise ValueError(f"{type(self).__name__}.achieved must be a method, as Task says, got none")

    def asked(self, state: EnvState) -> tuple[float, ...]:
        """Return the goal's values (quantities,), in the order of the result of `achieved`."""
        del state
        raise ValueError(f"{type(self).__name__}.asked must be a method, as Task says, got none")

    def reached(self, achieved: Numbers, asked: Numbers) -> NDArray[np.bool_]:
        """Return whether `achieved` (..., quantities) fulfils the goals `asked`, shape (...)."""
        del achieved, asked
        raise ValueError(f"{type(self).__name__}.reached must be a method, as Task says, got none")

    def benchmark(self) -> Benchmark:
        """Return the starts that `evaluate.py` compares, and the columns of its table."""
        return default_benchmark(self)

    def path_metrics(
        self, path: Numbers, parcel: Parcel, line: BaseLine, zone: tuple[int, int] | None
    ) -> dict[str, float]:
        """Return additional metrics of an episode by name.

        `path` (times, 3) [m, m, rad] are the true poses. `zone` is the zone's first and last
        column. If `zone` is None, `line` defines the zone for the parcel.
        """
        del path, parcel, line, zone
        return {}

    def readings(self, state: EnvState) -> list[tuple[str, str]]:
        """Return texts to display, as pairs of a name and a value, e.g. ("to go", "12.0 mm")."""
        del state
        return []

    def goal(self, state: EnvState) -> Any:
        """Return the goal to draw, e.g. a `StopLine` of `surface_gym.rendering`, or None."""
        del state

    def decode(self, seen: ObservationTable) -> Any:
        """Decode observations into SI units for rules. The default suits tasks on a line."""
        return decode_line(seen)

    def decode_start(self, seen: ObservationTable) -> Start:
        """Decode a first observation into a start. The default suits line tasks without a goal."""
        if self.goals > 0:
            raise ValueError(
                f"{type(self).__name__}.decode_start must be a method, as Task says, got none"
            )
        return line_start(seen, decode_line(seen), self.parcels, ())

    def cost(self) -> PlanCost:
        """Return the cost that planners minimise."""
        raise ValueError(f"{type(self).__name__}.cost must be a method, as Task says, got none")

    @staticmethod
    @kernel_function
    def begin(state: EnvState) -> None:
        """Do nothing."""

    @staticmethod
    @kernel_function
    def is_done(state: EnvState) -> bool:
        """Return whether no rotor is under the parcel."""
        return not state.on_rotors

    @staticmethod
    @kernel_function
    def mirror(state: EnvState) -> float:
        """Return 1: the observation is not mirrored."""
        return 1.0

    @staticmethod
    @kernel_function
    def draw_goal(state: EnvState, canvas: Canvas) -> None:
        """Draw nothing."""


def rising(name: str, value: Any, low: float, high: float, hint: str = "") -> tuple[float, float]:
    """Return (first, last) if low <= first <= last <= high, else raise an error with `hint`."""
    first, last = checks.array(name, value, (2,)).tolist()
    if not low <= first <= last <= high:
        raise ValueError(
            f"{name} must be two rising numbers between {low:g} and {high:g}, got {value!r}"
            + (f"; {hint}" if hint else "")
        )
    return first, last


BRAKING = 0.5 * GRAVITY  # [m/s^2] mu_max g of Table 1: every axis at 0 deg under a parcel
ROLLING_LOSS = 0.01 * GRAVITY  # [m/s^2] mu_min g of Table 1: every axis at 90 deg
STALL_SPEED = 1e-3  # [m/s] slower parcels count as stalled on a level surface

# Common failures of tasks on a line; further failures follow.
LINE_OUTCOMES = ("off the surface", "off the line", "stalled")
OFF_SURFACE, OFF_LINE, STALLED = failures(LINE_OUTCOMES)

# Common features of a parcel.
OFFSET = Feature("lateral offset", -10.0, 10.0, "y from the line's middle", "m", 0.3)
DIRECTION = (Feature("sine of theta", -1.0, 1.0), Feature("cosine of theta", -1.0, 1.0))
FORWARD_SPEED = Feature("forward speed", -10.0, 10.0, "vx", "m/s", 1.0, 1.0)
LATERAL_SPEED = Feature("lateral speed", -20.0, 20.0, "vy", "m/s", 0.5)
TURNING_SPEED = Feature("turning speed", -50.0, 50.0, "omega", "rad/s", 3.0)
SIZE = Feature("size", -10.0, 100.0, "half of the length; observed: -1 for the S-box, 1 for the B-box", "m", 0.05, 0.175)  # fmt: skip
LENGTH = replace(SIZE, name="length", meaning="half of the length")
WIDTH = replace(SIZE, name="width", meaning="half of the width")
PHASE = tuple(
    Feature(f"{part} of phase {axis}", -1.0, 1.0, "place of the centre within a module, as an angle: one module is 360 deg")
    for axis in ("x", "y")
    for part in ("sine", "cosine")
)  # fmt: skip
PARCEL_FEATURES = (
    OFFSET, *DIRECTION, FORWARD_SPEED, LATERAL_SPEED, TURNING_SPEED, SIZE, *PHASE,
    Feature("front in zone", -20.0, 20.0, "x of the parcel's front minus x of the zone's start", "m", 0.5),
    Feature("rear to go", -20.0, 20.0, "x of the zone's end minus x of the parcel's rear", "m", 0.5),
)  # fmt: skip
COLUMN = columns(PARCEL_FEATURES)


MARK_WIDTH = 0.05  # [m] of a goal in a picture
SPEED_LENGTH = 0.4  # [m per m/s] of the line that shows an asked speed


def zone_span(line: BaseLine, parcel: Parcel, zone: tuple[int, int] | None) -> tuple[float, float]:
    """Return x [m] of the start and the end of the zone.

    `zone` is the zone's first and last column. If `zone` is None, the line sets the zone for the
    parcel.
    """
    _, _, first, columns = line.site(parcel.base, zone).zone
    start = line.column_edge(first)
    return start, start + line.pitch_x * columns


def entry(draw: Draw, parcels: Parcels) -> tuple[Numbers, float, float]:
    """Return the entry pose [m, m, rad] of parcels on the line of `draw`.

    The rear is at the line's smallest x. The origin of the parcel's frame is on the line's middle.
    """
    return (draw.line.column_edge(0) + parcels.rear, draw.line.line_y, 0.0)


def sensed_speed(state: EnvState) -> float:
    """Return the sensed speed [m/s] of the base's fastest point, by the formula of `is_slower`."""
    return st.planar_speed(state.sensed) + abs(state.sensed[OMEGA]) * state.body[HALF_LENGTH]


@kernel_function
def draw_speed(canvas: Canvas, x: float, y: float, speed: float) -> None:
    """Draw a goal speed [m/s] as a line parallel to the y axis, with its middle at (x, y) [m]."""
    half = 0.5 * SPEED_LENGTH * speed
    draw_line(canvas, (x, y - half), (x, y + half), MARK_WIDTH)


@kernel_function
def rear_to_go(state: EnvState, x: float, theta: float) -> float:
    """Return the distance [m] to the zone's end from the rear of a parcel at `x` and `theta`."""
    return st.zone_end(state) - x + st.reach_along(state, theta, -1.0, 0.0)


@kernel_function
def over_zone_end(state: EnvState) -> bool:
    """Return whether no rotor is under the parcel, or the parcel's rear is past the zone's end."""
    if not state.on_rotors:
        return True
    if state.com[X] <= st.zone_end(state):
        return False
    st.read_truth(state)
    return rear_to_go(state, state.truth[X], state.truth[THETA]) < 0.0


@kernel_function
def failure(state: EnvState) -> int:
    """Return which failure in `LINE_OUTCOMES` has occurred, or RUNNING without a failure."""
    if not state.on_surface:
        return OFF_SURFACE
    if not state.on_rotors:
        return OFF_LINE
    stalls = st.is_slower(state, STALL_SPEED) and not st.is_driven(state)
    return STALLED if stalls else st.RUNNING


@kernel_function
def leaving(state: EnvState, reached: bool, missed: int) -> int:
    """Return the outcome of a task that ends when the parcel's rear passes the zone's end.

    If the rear is past the zone's end and the parcel is on the rotors and the surface, the outcome
    is SUCCESS if `reached` is true, else `missed`. In all other cases, `failure` gives the outcome.
    """
    truth = state.truth
    if state.on_rotors and state.on_surface and rear_to_go(state, truth[X], truth[THETA]) < 0.0:
        return st.SUCCESS if reached else missed
    return failure(state)


@kernel_function
def show_on_line(state: EnvState, column: Any, mirror: float) -> float:
    """Write the common features of tasks on a line, and return the lateral offset [m].

    `mirror` is 1, or -1 to mirror the features and the offset in y.
    """
    sensed, elements, see = state.sensed, state.elements, state.observation
    offset = mirror * (sensed[Y] - elements.line_y)
    x = 2.0 * math.pi / elements.pitch_x * (sensed[X] - elements.x0)
    y = 2.0 * math.pi / elements.pitch_y * offset
    show_within(see, column.lateral_offset, offset)
    show(see, column.sine_of_theta, mirror * math.sin(sensed[THETA]))
    show(see, column.cosine_of_theta, math.cos(sensed[THETA]))
    show_within(see, column.forward_speed, sensed[VX])
    show_within(see, column.lateral_speed, mirror * sensed[VY])
    show_within(see, column.turning_speed, mirror * sensed[OMEGA])
    show(see, column.size, state.body[HALF_LENGTH])
    show(see, column.sine_of_phase_x, math.sin(x))
    show(see, column.cosine_of_phase_x, math.cos(x))
    show(see, column.sine_of_phase_y, math.sin(y))
    show(see, column.cosine_of_phase_y, math.cos(y))
    return offset


@kernel_function
def see_parcel(state: EnvState) -> None:
    """Write `PARCEL_FEATURES` into the observation, from the sensed pose and velocity."""
    show_on_line(state, COLUMN, 1.0)
    see, x, theta = state.observation, state.sensed[X], state.sensed[THETA]
    front = x + st.reach_along(state, theta, 1.0, 0.0)
    show(see, COLUMN.front_in_zone, front - st.zone_start(state))
    show(see, COLUMN.rear_to_go, rear_to_go(state, x, theta))
