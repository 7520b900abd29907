"""The configuration of an environment, and its presets."""

import inspect
import math
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from surface_gym import checks
from surface_gym.actions import ANY, ActionKind
from surface_gym.canvas import IMAGE, Image
from surface_gym.feature_groups import AXIS_SIZE, SHOWN_DRIVE, group_features, offered_groups
from surface_gym.lines import BaseLine, Site
from surface_gym.modules import ANGLE, FASTEST, ModuleKind, find_module
from surface_gym.parcel import Parcel, assortment
from surface_gym.physics.types import Array, Integers
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.registration import DEFAULT_TASK, TASKS
from surface_gym.sensors import AdaptiveCamera, Camera, Entry, Exact, Sensor
from surface_gym.sensors.base import Group
from surface_gym.state import Timing
from surface_gym.tasks.base import Task
from surface_gym.tasks.features import Column, Feature, find_columns
from surface_gym.tasks.planning import ObservationTable
from surface_gym.tasks.start import Start

if TYPE_CHECKING:
    from surface_gym.flow.base import StreamTask
    from surface_gym.flow.exits import Entrance, Exits, Inlets


@dataclass(frozen=True)
class Preset:
    """A set of sensors, randomisation and actuators, for an environment's argument `preset`."""

    name: str
    label: str  # label in tables
    meaning: str  # description in a sentence
    sensors: Sensor = Exact()
    randomisation: Randomisation = Randomisation()
    actuators: Actuators = Actuators()
    parcels: tuple[Parcel, ...] = ()  # parcels to draw from; empty: the task's own


SURE = Entry(position=0.0, angle=0.0, speed=0.0, turning=0.0)
LATENCY = 0.08  # [s] two control periods

# Size and seed of the lab preset's parcel assortment.
LAB_PARCELS, LAB_SEED = 128, 20_261_122
QUARTER_TURN = 0.05  # [s] quarter turn of an axis in the lab

_EACH = (
    Preset("exact", "exact", "Sensors show pose and velocity as they are."),
    Preset(
        "camera",
        "camera",
        "A camera's frames, 1 mm and 0.5 deg off and 20 ms late, and a filter; the entry speed is "
        "known to 0.05 m/s.",
        sensors=Camera(),
    ),
    Preset(
        "friction",
        "friction ±20 %",
        "mu_max differs from parcel to parcel by up to 20 %; sensors are exact.",
        randomisation=Randomisation(friction=0.2),
    ),
    Preset(
        "latency",
        "80 ms late",
        "Frames without noise, 80 ms late, with friction that differs by up to 20 % from what the "
        "filter assumes, so that it cannot compensate the delay.",
        sensors=Camera(latency=LATENCY, position_noise=0.0, angle_noise=0.0, entry=SURE),
        randomisation=Randomisation(friction=0.2),
    ),
    Preset(
        "stuck",
        "5 % stuck",
        "Each module is stuck at 90 deg with a probability of 5 %; sensors are exact.",
        actuators=Actuators(stuck_share=0.05),
    ),
    Preset(
        "lab",
        "lab",
        "All at once, mildly: squares, rectangles, discs and polygons of 0.2 to 0.45 m with loads "
        "up to 3 cm off centre, that enter 1 cm and 3 deg off; friction that differs by up to "
        "15 %; axes that take 50 ms for 90 deg, 2 % of the modules stuck; a camera of 50 Hz, "
        "40 ms late, 2 mm and 0.5 deg off.",
        sensors=AdaptiveCamera(
            latency=0.04,
            position_noise=0.002,
            entry=Entry(position=0.005, angle=0.02),
        ),
        randomisation=Randomisation(
            friction=0.15, rolling=0.15, lateral=0.01, heading=math.radians(3.0)
        ),
        actuators=Actuators(axis_speed=0.5 * math.pi / QUARTER_TURN, stuck_share=0.02),
        parcels=assortment(LAB_PARCELS, LAB_SEED),
    ),
)
PRESETS = {preset.name: preset for preset in _EACH}


LONGEST_STEP = 0.005  # [s]
MOST_DRAWN = 4096  # rows and columns of a surface in an image
INFOS = ("axes", "normal_forces", "energy", "load", "turns")  # optional entries of `info`
SENSORS = "a Sensor: Exact(), Camera(), AdaptiveCamera(), Presence() of surface_gym.sensors"
REWARD = "reward_"  # prefix of reward terms, since a term may be "success" too


class ModuleChoices(spaces.MultiDiscrete):
    """Action space with several parts. Policies read the environment's `config` from the space.

    Args:
        nvec: (parts,) number of values that each part of the action can have.
    """

    def __init__(self, nvec: NDArray[np.int64], config: "EnvConfig") -> None:
        super().__init__(nvec)
        self.config = config


@dataclass(frozen=True, init=False)
class EnvConfig:
    """Arguments of an environment: keywords of `gym.make` and of both environment classes.

    Args:
        task: a task's name, or a task with its own parameters.
        preset: a `Preset`, or its name, e.g. "lab". A preset sets sensors, actuators and
            randomisation. Except in streams, a preset also replaces the task's default parcels.
        arguments: the fields below, and any field of the task, e.g. `stream` of Flow.

    Raises:
        ValueError: an argument is not allowed, or a number is out of bounds; the message names the
            argument, its value and the allowed values.
        TypeError: neither the environment nor the task has an argument of that name.
    """

    task: Task  # a task's name, or a task with its own parameters; set by the id
    actions: str = "modules"  # kind of action
    # `Exact()`, `Camera(...)`, `AdaptiveCamera(...)` or `Presence(...)` of `surface_gym.sensors`
    sensors: Sensor = Exact()
    # [s] time between decisions; physics steps divide it equally and take at most 5 ms each
    control_period: float = 0.04
    # first and last column whose modules obey; None: all columns after the lead-in
    zone: tuple[int, int] | None = None
    # [rad] at least two axis angles, or "any"; None: the line's angles (0, pi/4, -pi/4, pi/2)
    orientations: tuple[float, ...] | str | None = None
    actuators: Actuators = Actuators()  # speed and limits of axes, stuck modules, load limit, wear
    # kind of module: "idle", "steered", "omni", "belt", "popup", or one of `surface_gym.modules`
    modules: str | ModuleKind = "idle"
    # spreads of friction, mass, size, load and start
    randomisation: Randomisation = Randomisation()
    # a `Line`, `Field` or `Pattern` of `surface_gym.lines`; None: the task's own
    line: BaseLine | None = None
    observe_axes: bool = False  # whether the observation shows the modules' axes
    # optional entries of `info`: "axes", "normal_forces", "energy", "load", "turns"
    info: tuple[str, ...] = ()
    # optional groups of observed features: "parcel", "rotors", "load", and the sensors' groups;
    # "image" or an `Image(...)`: a picture instead of all features
    observe: tuple[str, ...] | str | Image = ()

    def __init__(
        self,
        task: str | Task = DEFAULT_TASK,
        *,
        preset: str | Preset | None = None,
        **arguments: Any,
    ) -> None:
        own = {
            each.name: arguments.pop(each.name, each.default)
            for each in fields(self)
            if each.name != "task"
        }
        checks.set_fields(self, task=_make_task(task, arguments), **own)
        if preset is not None:
            self._apply(preset)
        self._check()

    def replace(self, **changes: Any) -> "EnvConfig":
        """Return a copy with changed arguments. The names of the task's fields are allowed, too."""
        own = {name: changes.pop(name, value) for name, value in self.arguments().items()}
        return EnvConfig(**own, **changes)

    def arguments(self) -> dict[str, Any]:
        """Return the fields as keyword arguments that make the same environment."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def _apply(self, preset: str | Preset) -> None:
        """Apply a preset. If the user chose no parcels for the task, use the preset's parcels."""
        if not isinstance(preset, Preset):
            preset = PRESETS[checks.one_of("preset", preset, PRESETS)]
        defaults = {each.name: each.default for each in fields(self)}
        for name in ("sensors", "actuators", "randomisation"):
            if getattr(self, name) != defaults[name]:
                raise ValueError(
                    f"preset must not be given beside {name}, which it sets, "
                    f"got {preset.name!r} and {getattr(self, name)!r}"
                )
            checks.set_fields(self, **{name: getattr(preset, name)})
        if preset.parcels:
            checks.set_fields(self, task=self.task.with_parcels(preset.parcels))

    def _check(self) -> None:
        checks.instance(
            f"line of {type(self.task).__name__}", self.task.line, BaseLine, "a BaseLine"
        )
        for name, kind, allowed in (
            ("sensors", Sensor, SENSORS),
            ("actuators", Actuators, "Actuators"),
            ("randomisation", Randomisation, "a Randomisation"),
            ("line", BaseLine | None, "a BaseLine"),
        ):
            checks.instance(name, getattr(self, name), kind, allowed)
        if isinstance(self.orientations, str):
            checks.one_of("orientations", self.orientations, (ANY,))
        elif self.orientations is not None:
            checks.settle(self, orientations=checks.orientations)
        self._check_modules()
        checks.settle(self, control_period=(checks.positive, *checks.CONTROL_PERIOD))
        checks.one_of("observe_axes", self.observe_axes, (False, True))
        checks.some_of("info", self.info, INFOS)
        checks.set_fields(self, observe=self._checked_observe())
        self._check_places()
        self.task.check(self)
        _ = self.action_kind, self.draws

    def _checked_observe(self) -> tuple[str, ...] | Image:
        """Return the checked `observe`: an `Image`, or names of groups in the order of `groups`."""
        asked, groups = self.observe, tuple(self.groups)
        if isinstance(asked, (str, type)):
            allowed = f"{IMAGE!r}, an Image, or some of {groups}"
            asked = Image() if asked == IMAGE else checks.instance("observe", asked, Image, allowed)
        if not isinstance(asked, Image):
            if isinstance(asked, (tuple, list)) and {IMAGE, Image} & {
                each if isinstance(each, str) else type(each) for each in asked
            }:
                raise ValueError(f"observe must have no groups beside an image, got {asked!r}")
            asked = checks.some_of("observe", asked, groups)
            find_columns((*self.task.features, *group_features(asked, self.groups)))
            return tuple(name for name in groups if name in asked)
        if self.observe_axes:
            raise ValueError("observe_axes must be False with an image, which shows axes, got True")
        line = self.chosen_line
        if max(line.rows, line.columns) > MOST_DRAWN:
            raise ValueError(
                f"line must have at most {MOST_DRAWN} rows and columns for an image, "
                f"got {line.rows} and {line.columns}"
            )
        return asked

    def _check_modules(self) -> None:
        """Raise a ValueError if orientations or limited actuators are given for driven modules."""
        if self.module_kind.drives and self.orientations is not None:
            raise ValueError(
                "orientations must not be given beside driven modules, whose headings they are, "
                f"got {self.orientations!r} and {self.modules!r}"
            )
        if self.module_kind.drives and self.actuators.has_limits:
            raise ValueError(
                "actuators must have turns_loaded=True, step=0 and backlash=0 with driven modules, "
                f"got {self.actuators!r} and {self.modules!r}"
            )

    def _check_places(self) -> None:
        """Raise a ValueError if the zone, a stuck module or a start may lie off the surface."""
        line = self.chosen_line
        if self.zone is not None:
            if not isinstance(self.zone, (tuple, list)) or len(self.zone) != 2:
                raise ValueError(f"zone must be two columns, first and last, got {self.zone!r}")
            first = checks.integer("zone", self.zone[0], least=0)
            last = checks.integer("zone", self.zone[1], least=0)
            if last < first:
                raise ValueError(
                    f"zone must be its first column and then its last, got {self.zone!r}: "
                    f"the first, {first}, is after the last, {last}"
                )
            if last >= line.columns:
                most = line.columns - 1
                raise ValueError(f"zone must lie in the columns 0 to {most}, got {self.zone!r}")
            checks.set_fields(self, zone=(first, last))
        for row, column in self.actuators.stuck:
            if row >= line.rows or column >= line.columns:
                raise ValueError(
                    f"stuck must lie in {line.rows} rows and {line.columns} columns, "
                    f"got {(row, column)}"
                )
        lateral, most_lateral = self.randomisation.lateral, 0.25 * line.width
        if lateral > most_lateral:
            raise ValueError(
                f"lateral must be at most a quarter of the surface's width, {most_lateral:g} m, "
                f"got {lateral!r}"
            )
        if self.zone is not None and self.task.leaves_zone:
            self._check_way_out(self.zone[1])

    def _check_way_out(self, last: int) -> None:
        """Raise a ValueError if a parcel may leave the surface before it leaves the zone.

        A parcel leaves the surface when its centre passes the edge. It leaves the zone when its
        rear passes the zone's last column, `last`.
        """
        line = self.chosen_line
        _, end, _, _ = line.extent
        longest = max(parcel.rear + parcel.base.centroid[0] for parcel in self.task.parcels)
        most = last
        while most >= 0 and line.column_edge(most + 1) + longest > end + 1e-9:
            most -= 1
        if most < last:
            raise ValueError(
                f"zone must end at column {most} or before, so that every parcel leaves it before "
                f"its centre leaves the surface, got {self.zone!r}"
            )

    @property
    def task_name(self) -> str:
        """Name under which the task's class or a base class is registered, else `task.name`."""
        kinds = ((kind.__name__.lower(), kind) for kind in type(self.task).__mro__)
        return next((name for name, kind in kinds if TASKS.get(name) is kind), self.task.name)

    @property
    def chosen_line(self) -> BaseLine:
        """The line of the environment. The default is the line of the task."""
        return self.task.line if self.line is None else self.line

    @property
    def chosen_orientations(self) -> tuple[float, ...]:
        """Axis angle [rad] of each choice. Driven modules may have equal angles in several choices.

        If `orientations` is None or "any", idle modules have the angles of the line.
        """
        if self.module_kind.drives:
            return tuple(self.modes[:-1, ANGLE].tolist())
        return self._orientations

    @property
    def _orientations(self) -> tuple[float, ...]:
        if self.orientations is None or isinstance(self.orientations, str):
            return self.chosen_line.orientations
        return self.orientations

    @property
    def module_kind(self) -> ModuleKind:
        """The kind of module."""
        return find_module(self.modules)

    @property
    def modes(self) -> Array:
        """Modes (choices + 1, 4) of the choices. The last row applies if there is no command."""
        return self.module_kind.modes(self._orientations)

    @property
    def images(self) -> Integers:
        """Indices (choices,). Entry k is the index of the choice that mirrors choice k in y."""
        return self.module_kind.images(self._orientations)

    @property
    def action_kind(self) -> ActionKind:
        """The kind of action, which converts actions to commands."""
        own: ActionKind | None = self.task.action_kind(self)
        if own is not None:
            return own
        line = self.chosen_line
        columns = line.zone_columns if self.zone is None else self.zone[1] - self.zone[0] + 1
        return ActionKind(self.actions, self.choices, line.zone_rows, columns)

    @property
    def choices(self) -> int:
        """Number of orientations or modes of a module, or 0 if any angle may be chosen."""
        return 0 if self.orientations == ANY else len(self.chosen_orientations)

    @property
    def timing(self) -> Timing:
        """Length and number of the physics steps in a control period. A step lasts at most 5 ms."""
        steps = math.ceil(self.control_period / LONGEST_STEP - 1e-9)
        return Timing(self.control_period / steps, steps)

    @property
    def periods(self) -> int:
        """Maximum number of control periods of an episode."""
        return self.task.count_periods(self.control_period)

    @property
    def rows(self) -> int:
        """Number of rows per environment in parcel arrays. Without a stream, the number is 1."""
        return self.task.rows

    @property
    def meters(self) -> bool:
        """Whether the work of drives and the heat of friction are summed during an episode."""
        return "energy" in self.info

    @property
    def weighs(self) -> bool:
        """Whether the load of each element is computed before each physics step."""
        waits, limit = not self.actuators.turns_loaded, self.actuators.load_limit
        return waits or limit != math.inf or "load" in self.info

    @property
    def has_extras(self) -> bool:
        """Whether `info` has more entries than the task's own entries, e.g. the energy."""
        return bool(self.info) or self.actuators.load_limit != math.inf

    @property
    def draws(self) -> int:
        """Maximum number of rows of random sensor noise for one parcel in a control period."""
        return self.task.noise_rows(self.sensors.draws(self.timing.dt, self.timing.steps))

    @property
    def groups(self) -> dict[str, Group]:
        """Optional groups of features for `observe`, by name."""
        return offered_groups(self.sensors)

    @property
    def image(self) -> Image | None:
        """The observed picture, or None if features are observed."""
        return self.observe if isinstance(self.observe, Image) else None

    @property
    def observed_groups(self) -> tuple[str, ...]:
        """Names of the observed groups of features."""
        return self.observe if isinstance(self.observe, tuple) else ()

    @property
    def features(self) -> tuple[Feature, ...]:
        """Features of a parcel's observation, computed even if an image is observed instead."""
        kind = self.action_kind
        window = tuple(
            Feature(f"occupied {row}, {column}", 0.0, 1.0, "a module that obeys, under the parcel")
            for row, column in np.ndindex(*kind.shape)
        )
        features = self.task.features + (window if kind.window_size else ())
        axes = self._axis_features() if self.observe_axes else ()
        return features + axes + group_features(self.observed_groups, self.groups)

    def _axis_features(self) -> tuple[Feature, ...]:
        """Features of axes: cosine and sine of twice the angle, since half a turn changes nothing.

        If the modules are driven, the features are the velocities of their surfaces instead.
        """
        kind = self.action_kind
        window = kind.shape if kind.name == "window" else (kind.rows, kind.columns)
        if self.module_kind.drives:
            most = FASTEST / SHOWN_DRIVE
            return tuple(
                Feature(
                    f"{part} of module {row}, {column}", -most, most,
                    "of its surface; 0: no driven module", "m/s", SHOWN_DRIVE,
                )
                for row, column in np.ndindex(*window)
                for part in ("vx", "vy")[:AXIS_SIZE]
            )  # fmt: skip
        return tuple(
            Feature(f"{part} of axis {row}, {column}", -1.0, 1.0, "of twice its angle; 0: no rotor")
            for row, column in np.ndindex(*window)
            for part in ("cosine", "sine")[:AXIS_SIZE]
        )

    @cached_property
    def columns(self) -> dict[str, Column]:
        """Column and scale of each feature in an observation. The keys are the features' names."""
        return find_columns(self.features)

    def row_space(self) -> spaces.Box:
        """Return the space of one parcel's observation."""
        return spaces.Box(
            np.array([feature.low for feature in self.features], dtype=np.float32),
            np.array([feature.high for feature in self.features], dtype=np.float32),
        )

    def decode(self, observations: ArrayLike) -> Any:
        """Convert observations (num_envs, features) to the task's quantities in SI units."""
        return self.task.decode(self.observed(observations))

    def decode_start(self, observation: ArrayLike) -> Start:
        """Convert an observation (features,) to the start of an episode in SI units."""
        return self.task.decode_start(self.observed(observation))

    def observed(self, observations: ArrayLike) -> ObservationTable:
        """Return observations (num_envs, features) as a table in SI units."""
        if self.image is not None:
            raise ValueError(f"observe must be of features to be decoded, got {self.image!r}")
        return ObservationTable(
            np.atleast_2d(np.asarray(observations, dtype=np.float64)),
            self.columns,
            self.chosen_line,
            self.zone,
        )

    def observation_space(self) -> spaces.Box:
        """Return the space of a picture, or of features. In streams, each parcel has a row."""
        if self.image is not None:
            return spaces.Box(0, 255, self.image.shape, np.uint8)
        row = self.row_space()
        if not self.task.is_stream:
            return row
        rows = (self.rows, 1)
        return spaces.Box(np.tile(row.low, rows), np.tile(row.high, rows))

    def action_space(self) -> spaces.Space[Any]:
        """Return the action space, which is a `ModuleChoices` if an action has several choices."""
        space = self.action_kind.space()
        if isinstance(space, spaces.MultiDiscrete):
            return ModuleChoices(space.nvec, self)
        return space

    # Only for tasks on a stream of parcels.

    @property
    def stream_task(self) -> "StreamTask":
        """The task on a stream of parcels."""
        if not self.task.is_stream:
            raise ValueError(f"task must be one on a stream of parcels, got {self.task!r}")
        return cast("StreamTask", self.task)

    @cached_property
    def site(self) -> Site:
        """The rotors and the zone, the same for every parcel of a stream."""
        return self.chosen_line.site(self.stream_task.parcels[0].base, self.zone)

    @property
    def entry_x(self) -> float:
        """The x [m] of the line's first edge, where the rear of an entering parcel is."""
        return self.chosen_line.column_edge(0)

    @cached_property
    def rotors(self) -> tuple[int, int, int, int]:
        """First row, number of rows, first column and number of columns of the area with rotors."""
        rows, columns = (np.nonzero(self.site.rotor.any(axis=axis))[0] for axis in (1, 0))
        return (
            int(rows[0]), int(rows[-1] - rows[0]) + 1,
            int(columns[0]), int(columns[-1] - columns[0]) + 1,
        )  # fmt: skip

    @property
    def rotors_end(self) -> float:
        """Position x [m] of the rotors' end, half a pitch past the last column with a rotor."""
        _, _, first_column, columns = self.rotors
        return self.chosen_line.column_edge(first_column + columns)

    @property
    def inlets(self) -> "Inlets":
        """Inlets of the stream's parcels."""
        return self.stream_task.inlets

    @cached_property
    def entrances(self) -> "tuple[Entrance, ...]":
        """The inlets with their positions on the surface."""
        return self.stream_task.find_entrances(self)

    @cached_property
    def exits(self) -> "Exits":
        """The exits. A set such as "chutes" is scaled to the line's length up to the last rotor."""
        return self.stream_task.find_exits(self)


def _make_task(task: str | Task, arguments: dict[str, Any]) -> Task:
    """Make a task by its name, or copy a task, and set the fields in `arguments`.

    If a field is unknown, raise a TypeError that lists the known fields.
    """
    if isinstance(task, str):
        kind = TASKS.find(task)
    else:
        kind = type(checks.instance("task", task, Task, f"one of {', '.join(TASKS)} or a Task"))
    known = [each.name for each in fields(kind) if each.init]
    for name in arguments:
        if name not in known:
            raise TypeError(
                f"unexpected keyword argument {name!r}: an environment has "
                f"{', '.join(each.name for each in fields(EnvConfig))} and preset, "
                f"and its task {kind.__name__} has {', '.join(known)}"
            )
    if isinstance(task, str):
        return kind(**arguments)
    return replace(task, **arguments) if arguments else task


def with_arguments(function: Callable[..., Any]) -> Callable[..., Any]:
    """Show the arguments of `EnvConfig` in the signature of a function with `**kwargs`."""
    signature = inspect.signature(function)
    named = [each for each in signature.parameters.values() if each.kind != each.VAR_KEYWORD]
    defaults = {each.name: each.default for each in fields(EnvConfig)}
    defaults |= {"task": DEFAULT_TASK, "preset": None}
    more = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default)
        for name, default in defaults.items()
        if name not in signature.parameters
    ]
    vars(function)["__signature__"] = signature.replace(parameters=[*named, *more])
    return function
