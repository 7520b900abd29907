"""The base class of tasks on streams of parcels, their actions, and shared features."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.actions import ANY, ActionKind
from surface_gym.compiler.jit import inlined
from surface_gym.flow import state as fs
from surface_gym.flow.entry import bars
from surface_gym.flow.exits import (
    EDGE,
    Entrance,
    Exits,
    exits_option,
    find_entrance,
    flow_line,
    inlets_option,
)
from surface_gym.flow.stream import LAWS, Stream
from surface_gym.lines import BaseLine
from surface_gym.parcel import Parcel
from surface_gym.physics.collision import ContactMaterial
from surface_gym.physics.types import THETA, Array, X, Y
from surface_gym.sensors.base import ENTRY_ROWS
from surface_gym.state import NOISE_ROWS, EnvState, reach_along
from surface_gym.tasks.base import Task
from surface_gym.tasks.benchmark import default_stream_benchmark
from surface_gym.tasks.features import Feature
from surface_gym.tasks.sort import HORIZON

# Arguments of tasks for one parcel without a meaning for streams, and what streams have instead.
OF_ONE_PARCEL = {
    "entry_offset": "`aside` of the stream",
    "entry_turn": "`turned` of the stream",
    "time_limit": "`duration`",
}
HALVES = 2  # parts of a parcel's command: the modules ahead of its centre and behind it


@dataclass(frozen=True)
class StreamActions(ActionKind):
    """Actions of a stream: one choice per module, or two per parcel (front and rear half).

    If the entry has a gate, one more number says when the gate opens.
    """

    # ways to open the gate: 0 keeps it closed for the control period, k opens it for one parcel
    # from the k-th physics step; no ways: there is no gate
    gates: int = 0

    @cached_property
    def parts(self) -> ActionKind:
        """Kind of action for the modules or parcels, without the additional number for the gate."""
        return ActionKind(self.name, self.choices, self.rows, self.columns)

    @cached_property
    def size(self) -> int:
        return self.parts.size + (1 if self.gates else 0)

    def space(self) -> spaces.Space[Any]:
        if not self.gates:
            return self.parts.space()
        return spaces.MultiDiscrete([self.choices] * self.parts.size + [self.gates])

    def commands(self, actions: Any, num_envs: int | None) -> NDArray[Any]:
        """Convert actions (num_envs, size) to commands (num_envs, size).

        If `num_envs` is None, `actions` is the action (size,) of one environment, and the result
        has one row.
        """
        if not self.gates:
            return self.parts.commands(actions, num_envs)
        try:
            given = np.asarray(actions)
        except ValueError:  # parts of different lengths
            raise ValueError(f"action must be an array, got {actions!r}") from None
        each = "" if num_envs is None else " in each environment"
        if given.shape != ((self.size,) if num_envs is None else (num_envs, self.size)):
            raise ValueError(f"action must have the shape {(self.size,)}{each}, got {given.shape}")
        gate = given[..., -1]
        choices = self.parts.commands(given[..., :-1], num_envs)
        if ((gate < 0) | (gate >= self.gates)).any():
            raise ValueError(
                f"action must say between 0 and {self.gates - 1} of the gate, got {gate.tolist()}"
            )
        return np.concatenate([choices, gate.reshape(-1, 1)], axis=1)


ACTIONS = ("modules", "parcels")
MOST_PARCELS = 256
MOST_WAITING = 64  # maximum waiting parcels in the observation
LEVELLING = 0.01  # [rad] slope that balances rolling losses: tan(tilt) = mu_min
STEEPEST = math.radians(15.0)

STREAM = (
    "a Stream of surface_gym.flow.stream, as Stream(Poisson(rate=900.0), speeds=1.5), whose "
    f"arrivals are {LAWS}"
)

ROUND_OFF = 1e-6  # [m]
SURFACE_TERMS = ("waiting", "jam")  # reward terms of the surface as a whole


@dataclass(frozen=True)
class StreamTask(Task):
    """The base class of tasks on a stream of parcels. A surface leads many parcels to their exits.

    Parcels enter, move, touch each other and depart without code of the task. Touches, waiting and
    jams are counted. A task is one class that defines the observation, the reward and the correct
    departures. The class has the class variables of `Task`. The variable `features` describes one
    parcel. The variable `terms` ends in `SURFACE_TERMS`, the costs of waiting and of jams. Their
    rates are `waiting_reward` and `jam_reward`. The fields of the class are the task's parameters.
    Compiled functions read the result of `numbers()` from `surface.params.numbers`.

    The compiled functions read and write the `EnvState` of one parcel. Only `reward` and `observe`
    have no default:

    - `begin(state)`, when a parcel enters: set the entries of `state.memory` from OWN_MEMORY on.
    - `reward(state, outcome)`, after a control period: write `state.terms`, except the
      SURFACE_TERMS. The outcome is RUNNING, DEPARTED_CORRECT or DEPARTED_WRONG;
      `state.memory[TOUCHED]` is the number of new touches.
    - `observe(state, waits)`: write the features from `state.sensed`. For a waiting parcel,
      `state.sensed` is its state at its entry.
    - `observe_neighbour(state, other, gap, ahead)`, after `observe`: write features of `other`, the
      next parcel behind (first call) or ahead (second call), at a distance of `gap` [m] along x.
    - `observe_no_neighbour(state, ahead)`: called instead if no parcel is behind or ahead.

    Other functions also get the surface as a `SurfaceView`: `surface.params`, the `clock` [s], and
    the task's memory of the surface (surface_memories,) and of every exit (exits, exit_memories):

    - `deliver(surface, state, taken, results) -> bool`, when a parcel departs: return whether the
      departure is correct. The default: a departure by the parcel's own exit is correct. The
      function may change `surface.exits[taken]`. It writes the statistics named by the class
      variable `results`.
    - `inform(surface, state)`, before a parcel is observed: write numbers of the surface and its
      exits for `observe` into `state.goal`, from GOALS on.
    - `advance(surface, dt)`, after every physics step of `dt` [s]: change `surface.memory`.
    - `may_jam(surface) -> bool`: whether standing parcels may be a jam. The default is True.
    - `has_room(surface, state, other) -> bool`: whether the parcel `other` leaves room for a parcel
      to enter at the pose in `state.truth`. The default requires
      that the two parcels are at least `entry_gap` apart along x or along y.
    - `has_departed(surface, state) -> bool`, after every physics step: whether a parcel has
      departed. The default: a parcel has departed if no rotor is under the parcel.
    - `exit_taken(surface, state) -> int`, after a departure: the index of the exit, or BETWEEN if
      no exit is there. The default uses the side and the position of the departure.
    - `base_distance(state, x, y) -> float`: the distance [m] from a parcel's base to a module in
      the parcel's bounding box. The module obeys the nearest parcel. The default is 0.

    A parcel's goal, `state.goal`, holds EXIT (index of its exit), SIDE, FIRST and LAST (side and
    span of this exit), INLET (index of its inlet) and ORDER (place in the order of departure).
    """

    parcels: Any = field(default=(), init=False, repr=False)  # the stream's parcels
    stream: Stream = Stream()  # arrivals, parcels, speeds and destinations
    exits: Any = "chutes"  # "chutes", "sides", or `Exits`
    inlets: Any = EDGE  # `Inlets`: where parcels enter the surface
    duration: float = 60.0  # [s] duration of an episode
    max_parcels: int = 24  # maximum parcels on the line
    # [rad] tilt of the line; the default balances rolling losses. On a level line of 6 m, a parcel
    # with 1 m/s would not reach the end.
    tilt: float = LEVELLING
    tilt_direction: float = 0.0  # [rad] downhill direction, anti-clockwise from +x
    restitution: float = 0.0  # [-] restitution of touching sides
    side_friction: float = 0.3  # [-] friction between touching sides
    gate: bool = False  # whether the action opens the gate for the next parcel
    queue: int = 1  # number of waiting parcels in the observation, if there is a gate
    entry_gap: float = 0.02  # [m] clearance ahead of an entering parcel
    ahead: float = 0.1  # [s] a module may obey a parcel this long before the parcel arrives
    patience: float = 2.0  # [s] time without motion that counts as a jam

    is_stream = True
    batch = "surface_gym.flow.batch:StreamBatch"
    in_order: ClassVar[bool] = False  # whether parcels must depart in an order
    takes_away: ClassVar[bool] = False  # whether a conveyor takes parcels away
    line = flow_line()
    waiting_reward: ClassVar[float] = -0.1  # per second and waiting parcel
    jam_reward: ClassVar[float] = -10.0  # once, when a jam is detected
    # weights of a parcel's reward terms in learning, by name; the default is 1
    learning_weights: ClassVar[Mapping[str, float]] = MappingProxyType({})
    outcomes = ("jam",)
    options = ("stream",)
    goals = fs.GOALS
    memories = 1
    statistics: ClassVar[type[Any]] = fs.FlowStatistics  # statistics of an episode
    exit_memories: ClassVar[int] = 0  # size of the task's memory per exit
    results: ClassVar[tuple[str, ...]] = ()  # names of the numbers that `deliver` writes

    def __post_init__(self) -> None:
        checks.instance("stream", self.stream, Stream, STREAM)
        checks.set_fields(self, parcels=self.stream.kinds, inlets=inlets_option(self.inlets))
        super().__post_init__()
        for name, of_streams in OF_ONE_PARCEL.items():
            if (value := getattr(self, name)) not in (None, 0.0):
                raise ValueError(
                    f"{name} must be left out for streams (they have {of_streams}), got {value!r}"
                )
        checks.settle(
            self,
            duration=(checks.positive, 0.0, checks.EPISODE),
            patience=(checks.positive, *checks.PATIENCE),
            side_friction=(checks.not_negative, checks.FRICTION),
            entry_gap=(checks.not_negative, checks.LENGTH[1]),
            ahead=(checks.not_negative, checks.AHEAD),
            tilt=(checks.angle, -STEEPEST, STEEPEST),
            tilt_direction=checks.angle,
            restitution=(checks.within, 0.0, 1.0),
        )
        checks.one_of("gate", self.gate, (False, True))
        if checks.integer("queue", self.queue, 1, MOST_WAITING) > 1 and not self.gate:
            raise ValueError(f"queue must be 1 without a gate, got {self.queue}")
        if checks.integer("max_parcels", self.max_parcels, least=1) > MOST_PARCELS:
            raise ValueError(f"max_parcels must be at most {MOST_PARCELS}, got {self.max_parcels}")

    @staticmethod
    @inlined
    def base_distance(state: EnvState, x: float, y: float) -> float:
        """Return 0, the default distance [m] from a parcel's base to a module.

        The default treats a parcel's whole bounding box as the parcel's base.
        """
        return 0.0

    @staticmethod
    @inlined
    def has_room(surface: fs.SurfaceView, state: EnvState, other: EnvState) -> bool:
        """Return whether parcel `state` has room to enter beside parcel `other` (see `bars`)."""
        return not bars(other, state, surface.params.entry_gap)

    @staticmethod
    @inlined
    def has_departed(surface: fs.SurfaceView, state: EnvState) -> bool:
        """Return whether no rotor is under the parcel."""
        return not state.on_rotors

    @staticmethod
    @inlined
    def exit_taken(surface: fs.SurfaceView, state: EnvState) -> int:
        """Return the index of the exit by which a parcel departed, or BETWEEN if there is no exit.

        The parcel departed straight ahead if its rear is past the last column of rotors, or if its
        centre is past the end of the rotors. Otherwise the parcel departed to the side of the
        line where the parcel's centre lies.
        """
        truth, params = state.truth, surface.params
        last_column = params.rotors_end - 0.5 * state.elements.pitch_x - ROUND_OFF
        rear = truth[X] - reach_along(state, truth[THETA], -1.0, 0.0)
        straight = rear > last_column or truth[X] > params.rotors_end
        towards = 1.0 if truth[Y] > state.elements.line_y else -1.0
        side = 0.0 if straight else towards
        where = truth[Y] - state.elements.line_y if straight else truth[X]
        for k in range(params.exits.shape[0]):
            if params.exits[k, 0] == side and params.exits[k, 1] <= where < params.exits[k, 2]:
                return k
        return fs.BETWEEN

    @staticmethod
    @inlined
    def deliver(surface: fs.SurfaceView, state: EnvState, taken: int, results: Array) -> bool:
        """Return whether the parcel's own exit has the index `taken`. `results` is not changed."""
        return taken == int(state.goal[fs.EXIT])

    @staticmethod
    @inlined
    def advance(surface: fs.SurfaceView, dt: float) -> None:
        """Do not change the numbers that the task stores for the surface."""

    @staticmethod
    @inlined
    def may_jam(surface: fs.SurfaceView) -> bool:
        """Return True: standing parcels may be a jam."""
        return True

    @staticmethod
    @inlined
    def inform(surface: fs.SurfaceView, state: EnvState) -> None:
        """Write no features of the surface."""

    @staticmethod
    @inlined
    def observe_neighbour(state: EnvState, other: EnvState, gap: float, ahead: bool) -> None:
        """Write no features of neighbours."""

    @staticmethod
    @inlined
    def observe_no_neighbour(state: EnvState, ahead: bool) -> None:
        """Do nothing. A task that observes neighbours replaces this method."""

    def numbers(self) -> tuple[float, ...]:
        """Return the parameters that the task's compiled functions read."""
        return ()

    @property
    def surface_memories(self) -> int:
        """Size of the task's memory per surface."""
        return 0

    def draw_memory(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw the initial values (surface_memories,) of the numbers stored per surface."""
        del rng
        return np.zeros(self.surface_memories)

    def is_running(self, memory: Array) -> bool | None:
        """Read from `memory` whether the take-away (the conveyor after the surface) runs.

        Return None if the task has no take-away.
        """
        del memory
        return None

    def benchmark(self) -> Any:
        """Return the streams for comparing controllers, and the columns of the results table."""
        return default_stream_benchmark(self)

    def rate_bound(self, config: Any) -> float:
        """Return an upper limit of any controller's rate [parcels/h]. NaN means no known limit."""
        del config
        return math.nan

    def compute_statistics(
        self, streams: fs.StreamState, surface: int, jammed: bool, obeying: int
    ) -> Any:
        """Compute a surface's statistics up to now: see `flow.state.compute_statistics`."""
        return fs.compute_statistics(streams, surface, jammed, obeying)

    @property
    def parcel_terms(self) -> tuple[str, ...]:
        return self.terms[: -len(SURFACE_TERMS)]

    @property
    def rows(self) -> int:
        """Number of rows in the observation, for parcels on the line and parcels at a gate."""
        return self.max_parcels + (self.queue if self.gate else 0)

    @property
    def touching(self) -> ContactMaterial:
        """Contact material of the parcels' sides."""
        return ContactMaterial(self.restitution, self.side_friction)

    def find_entrances(self, config: Any) -> tuple[Entrance, ...]:
        """Return the positions of the inlets on an environment's surface."""
        line, rotors = config.chosen_line, config.rotors
        return tuple(find_entrance(each, line, rotors) for each in self.inlets)

    def find_exits(self, config: Any) -> Exits:
        """Return the exits of an environment.

        A set of exits with a name, e.g. "chutes", is scaled to the length of the line up to the
        last rotor.
        """
        return exits_option(self.exits, config.rotors_end - config.entry_x)

    def action_kind(self, config: Any) -> StreamActions:
        """Return the kind of action: one choice per module, or two per parcel."""
        _, rows, _, columns = config.site.zone
        if config.actions == "parcels":
            rows, columns = self.max_parcels, HALVES
        gates = 1 + config.timing.steps if self.gate else 0
        return StreamActions("modules", config.choices, rows, columns, gates)

    def with_parcels(self, parcels: tuple[Parcel, ...]) -> "StreamTask":
        """Return the same task, since its parcels come from the stream."""
        del parcels
        return self

    def count_periods(self, control_period: float) -> int:
        return math.ceil(self.duration / control_period - 1e-9)

    def noise_rows(self, used: int) -> int:
        """Return the number of rows of noise for each parcel in a control period.

        The number is the sum of the sensor's rows `used` and the rows `ENTRY_ROWS` of an entry. If
        `used` is 0, there is no noise, and the number is 0.
        """
        if used > NOISE_ROWS - ENTRY_ROWS:
            raise ValueError(
                f"sensors must use at most {NOISE_ROWS - ENTRY_ROWS} rows of noise in a control "
                f"period, got {used}"
            )
        return used + ENTRY_ROWS if used else 0

    def check(self, config: Any) -> None:
        """Raise a ValueError if an environment's configuration does not suit the task."""
        for name, only in (("observe", ()), ("observe_axes", False)):
            given = getattr(config, name)
            if given != only:
                raise ValueError(f"{name} must be {only!r} for a stream of parcels, got {given!r}")
        checks.some_of("info", config.info, ("axes", "energy", "load", "turns"))
        checks.one_of("actions", config.actions, ACTIONS)
        if self.duration < config.control_period:
            raise ValueError(
                f"duration must be at least a control period, {config.control_period:g} s, "
                f"got {self.duration!r}"
            )
        if self.gate and len(self.inlets) > 1:
            raise ValueError(f"gate must be False with several inlets, got {len(self.inlets)}")
        _ = config.entrances
        if self.gate and config.orientations == ANY:
            raise ValueError("gate must be False where orientations are 'any', got True")
        if not config.site.rotor.any():
            raise ValueError("line must have a rotor, got none")
        if self.entry_gap > config.chosen_line.length:
            raise ValueError(
                f"entry_gap must be at most the line's length, {config.chosen_line.length:g} m, "
                f"got {self.entry_gap!r}"
            )
        _, _, low, high = config.chosen_line.extent
        middle = config.chosen_line.line_y
        for each in () if isinstance(self.exits, str) else config.exits:
            if not each.side and not (each.first < high - middle and each.last > low - middle):
                raise ValueError(
                    f"exits straight on must lie across the end, from {low - middle:g} to "
                    f"{high - middle:g} m, got {each.name!r} from {each.first:g} to {each.last:g} m"
                )
            on_line = each.first < config.rotors_end and each.last > config.entry_x
            if each.side and not on_line:
                raise ValueError(
                    f"exits must lie beside the rotors, from {config.entry_x:g} to "
                    f"{config.rotors_end:g} m, got {each.name!r} from {each.first:g} to "
                    f"{each.last:g} m"
                )
        self.check_stream(self.stream, config)

    def check_stream(self, stream: Any, config: Any) -> None:
        """Raise a ValueError if a stream is invalid, or does not suit the exits or the line."""
        checks.instance("stream", stream, Stream, STREAM)
        stream.check(config.exits, config.inlets)
        line: BaseLine = config.chosen_line
        for parcel in stream.kinds:
            largest = config.randomisation.largest(parcel.base)
            site = line.site(largest, config.zone)
            if (site.rotor != config.site.rotor).any() or site.zone != config.site.zone:
                raise ValueError(
                    f"line must have the same rotors and zone for every parcel of the stream, "
                    f"as flow_line() has, got {type(line).__name__}"
                )
            length, width = np.ptp(largest.outline, axis=0)
            if length > line.length or width > line.width:
                raise ValueError(
                    f"parcels must be at most as long and wide as the line, {line.length:g} m x "
                    f"{line.width:g} m, got {length:g} m x {width:g} m"
                )
            # A smaller parcel would fit between rotors, and seem to have departed.
            least = config.randomisation.least(parcel.base)
            length, width = np.ptp(least.outline, axis=0)
            if length < line.pitch_x or width < line.pitch_y:
                raise ValueError(
                    f"parcels must be at least a pitch long and wide, {line.pitch_x:g} m x "
                    f"{line.pitch_y:g} m, got {length:g} m x {width:g} m"
                )


# Features shared by tasks.
FAR = 4.0  # [m] maximum distance of a neighbour, also shown without a neighbour
GAP = Feature(
    "gap", -20.0, 20.0,
    f"clear distance along x to the next parcel, called neighbour; {FAR:g} m if there is none",
    "m", 0.5,
)  # fmt: skip
SPEED = Feature("speed", -20.0, 20.0, "vx of the neighbour minus vx of the parcel", "m/s", 0.5)
ASIDE = Feature("offset", -20.0, 20.0, "y of the neighbour minus y of the parcel", "m", 0.3)
TIME = Feature(
    "time", -1000.0, 1000.0,
    "time since the parcel's entry; for a waiting parcel: its waiting time, negative", "s", HORIZON,
)  # fmt: skip
PRESENT = Feature("present", 0.0, 1.0, "1 if the row has a parcel; a free row has only zeros")
WAITS = Feature("waits", 0.0, 1.0, "1 if the parcel waits to enter, 0 if it is on the surface")


def both_ways(features: tuple[Feature, ...]) -> tuple[Feature, ...]:
    """Return the features twice: for the neighbour ahead, then for the neighbour behind."""
    ways = ("ahead", "behind")
    return tuple(replace(each, name=f"{each.name} {way}") for way in ways for each in features)
