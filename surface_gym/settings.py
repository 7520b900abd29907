"""What an environment is made with, checked once for both faces."""

import math
from dataclasses import InitVar, dataclass, fields, replace
from typing import Any

import numpy as np
from gymnasium import spaces

from surface_gym import checks
from surface_gym.conditions import CONDITIONS, Condition
from surface_gym.core.actions import ANY, AXIS_SIZE, GROUPS, ActionKind, group_features
from surface_gym.lines import BaseLine
from surface_gym.randomisation import Actuators, Randomisation
from surface_gym.sensors import Exact, Sensor
from surface_gym.state import Timing
from surface_gym.tasks import TASKS, Task
from surface_gym.tasks.base import Feature, draws_default_parcels

LONGEST_STEP = 0.005  # [s]
INFOS = ("axes", "normal_forces")  # that `info` carries on request


@dataclass(frozen=True)
class Settings:
    """Arguments of an environment.

    Raises:
        ValueError: an argument is not allowed, or a number is beyond `surface_gym.checks`; the
            message names it, what came and what may come.
    """

    task: str | Task = "sort"  # its name, or one with parameters of its own
    actions: str = "modules"  # kind of action
    sensors: Sensor = Exact()  # what a controller gets to see
    control_period: float = 0.04  # [s] between decisions
    zone: tuple[int, int] | None = None  # first and last column that obey; None: the plant's own
    # [rad] axis angles on offer; None: the plant's; "any": an action says angles
    orientations: tuple[float, ...] | str | None = None
    actuators: Actuators = Actuators()
    randomisation: Randomisation = Randomisation()
    plant: BaseLine | None = None  # where it happens; None: the task's own
    observe_axes: bool = False  # the observation shows the modules' axes
    info: tuple[str, ...] = ()  # what `info` carries beside the rest
    observe: tuple[str, ...] = ()  # groups of features that the observation shows beside the rest
    condition: InitVar[str | Condition | None] = None  # sets sensors, actuators, randomisation

    def __post_init__(self, condition: str | Condition | None) -> None:
        set_field = object.__setattr__
        if isinstance(self.task, str):
            set_field(self, "task", TASKS[checks.one_of("task", self.task, TASKS)]())
        if condition is not None:
            self._meet(condition)
        check_kinds(
            self,
            (
                ("task", Task, f"one of {', '.join(TASKS)} or a Task"),
                ("sensors", Sensor, "a Sensor"),
                ("actuators", Actuators, "Actuators"),
                ("randomisation", Randomisation, "a Randomisation"),
                ("plant", BaseLine | None, "a Plant"),
            ),
        )
        if isinstance(self.orientations, str):
            checks.one_of("orientations", self.orientations, (ANY,))
        elif self.orientations is not None:
            angles = checks.orientations("orientations", self.orientations)
            set_field(self, "orientations", angles)
        period = checks.positive("control_period", self.control_period, *checks.CONTROL_PERIOD)
        set_field(self, "control_period", period)
        checks.one_of("observe_axes", self.observe_axes, (False, True))
        for name, allowed in (("info", INFOS), ("observe", tuple(GROUPS))):
            checks.some_of(name, getattr(self, name), allowed)
        set_field(self, "observe", tuple(name for name in GROUPS if name in self.observe))
        self._check_places()
        self._check_size()
        _ = self.action_kind

    def _meet(self, condition: str | Condition) -> None:
        """Take over what a condition sets; a task of parcels of its own keeps them."""
        if not isinstance(condition, Condition):
            condition = CONDITIONS[checks.one_of("condition", condition, CONDITIONS)]
        defaults = {field.name: field.default for field in fields(self)}
        for name in ("sensors", "actuators", "randomisation"):
            if getattr(self, name) != defaults[name]:
                raise ValueError(
                    f"condition must not be given beside {name}, which it sets, "
                    f"got {condition.name!r} and {getattr(self, name)!r}"
                )
            object.__setattr__(self, name, getattr(condition, name))
        task = self.task
        if condition.parcels and isinstance(task, Task) and draws_default_parcels(task):
            object.__setattr__(self, "task", replace(task, parcels=condition.parcels))

    def _check_places(self) -> None:
        """The zone and the stuck modules lie on the surface."""
        plant = self.chosen_plant
        if self.zone is not None:
            if not isinstance(self.zone, (tuple, list)) or len(self.zone) != 2:
                raise ValueError(f"zone must be two columns, first and last, got {self.zone!r}")
            first = checks.integer("zone", self.zone[0], least=0)
            last = checks.integer("zone", self.zone[1], least=first)
            if last >= plant.columns:
                most = plant.columns - 1
                raise ValueError(f"zone must lie in the columns 0 to {most}, got {self.zone!r}")
            object.__setattr__(self, "zone", (first, last))
        check_stuck(self.actuators, plant)
        self.randomisation.check_room(plant.width)
        if self.zone is not None and self.chosen_task.leaves_zone:
            self._check_way_out(self.zone[1])

    def _check_way_out(self, last: int) -> None:
        """Raise a ValueError where the rear of a parcel cannot leave a zone that ends with a column
        before its centre leaves the surface.
        """
        plant = self.chosen_plant
        _, end, _, _ = plant.extent
        longest = max(parcel.rear + parcel.base.centroid[0] for parcel in self.chosen_task.parcels)
        most = last
        while most >= 0 and plant.column_edge(most + 1) + longest > end + 1e-9:
            most -= 1
        if most < last:
            raise ValueError(
                f"zone must end at column {most} or before, so that every parcel leaves it before "
                f"its centre leaves the surface, got {self.zone!r}"
            )

    def _check_size(self) -> None:
        """Every parcel the task draws fits the plant at the largest size it may have."""
        for parcel in self.chosen_task.parcels:
            try:
                self.chosen_plant.site(self.randomisation.largest(parcel.base), self.zone)
                self.randomisation.least(parcel.base)
            except ValueError as error:
                raise ValueError(
                    f"size must leave room for every parcel, got {self.randomisation.size!r}: "
                    f"{error}"
                ) from None

    @property
    def chosen_task(self) -> Task:
        """The task itself."""
        assert not isinstance(self.task, str)
        return self.task

    @property
    def task_name(self) -> str:
        """The name of the package's task that it is or inherits from; else its own."""
        kinds = (name for name, kind in TASKS.items() if isinstance(self.task, kind))
        return next(kinds, self.chosen_task.name)

    @property
    def chosen_plant(self) -> BaseLine:
        """Where it happens."""
        return self.chosen_task.plant if self.plant is None else self.plant

    @property
    def chosen_orientations(self) -> tuple[float, ...]:
        """[rad] axis angles on offer; where any angle is, the plant's."""
        if self.orientations is None or isinstance(self.orientations, str):
            return self.chosen_plant.orientations
        return self.orientations

    @property
    def action_kind(self) -> ActionKind:
        """What an action is."""
        plant = self.chosen_plant
        columns = plant.zone_columns if self.zone is None else self.zone[1] - self.zone[0] + 1
        choices = 0 if self.orientations == ANY else len(self.chosen_orientations)
        return ActionKind(self.actions, choices, plant.zone_rows, columns)

    @property
    def timing(self) -> Timing:
        """The control period in equal physics steps of at most 5 ms."""
        return timing_of(self.control_period)

    @property
    def draws(self) -> int:
        """Rows of noise that the sensors use at most in a control period."""
        return self.sensors.draws(self.timing.dt, self.timing.steps)

    @property
    def features(self) -> tuple[Feature, ...]:
        """What one lane observes."""
        kind = self.action_kind
        window = tuple(
            Feature(f"occupied {row}, {column}", 0.0, 1.0, "a module that obeys, under the parcel")
            for row, column in np.ndindex(*kind.shape)
        )
        features = self.chosen_task.features + (window if kind.window_size else ())
        axes = self._axis_features() if self.observe_axes else ()
        return features + axes + group_features(self.observe)

    def _axis_features(self) -> tuple[Feature, ...]:
        """An axis is the same turned by pi: it is shown by twice its angle."""
        kind = self.action_kind
        window = kind.shape if kind.name == "window" else (kind.rows, kind.columns)
        return tuple(
            Feature(f"{part} of axis {row}, {column}", -1.0, 1.0, "of twice its angle; 0: no rotor")
            for row, column in np.ndindex(*window)
            for part in ("cosine", "sine")[:AXIS_SIZE]
        )

    def observation_space(self) -> spaces.Box:
        """The space of one lane's observation."""
        return spaces.Box(
            np.array([feature.low for feature in self.features], dtype=np.float32),
            np.array([feature.high for feature in self.features], dtype=np.float32),
        )

    def action_space(self) -> spaces.Space[Any]:
        """The space of one lane's action."""
        return self.action_kind.space()


def check_kinds(settings: Any, kinds: tuple[tuple[str, Any, str], ...]) -> None:
    """Raise a ValueError where a field, of some by name, is not of its kind, which is told."""
    for name, kind, told in kinds:
        if not isinstance(getattr(settings, name), kind):
            raise ValueError(f"{name} must be {told}, got {getattr(settings, name)!r}")


def check_stuck(actuators: Actuators, plant: BaseLine) -> None:
    """Raise a ValueError where a module that is stuck is none of the plant's."""
    for row, column in actuators.stuck:
        if row >= plant.rows or column >= plant.columns:
            raise ValueError(
                f"stuck must lie in {plant.rows} rows and {plant.columns} columns, "
                f"got {(row, column)}"
            )


def timing_of(control_period: float) -> Timing:
    """A control period [s] in equal physics steps of at most 5 ms."""
    steps = math.ceil(control_period / LONGEST_STEP - 1e-9)
    return Timing(control_period / steps, steps)
