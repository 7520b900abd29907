"""What an environment is made with, checked once for both faces."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces

from surface_gym import checks
from surface_gym.actions import ActionKind
from surface_gym.actuators import Actuators
from surface_gym.batch.batch import Batch
from surface_gym.batch.commands import Acting
from surface_gym.lanes.memory import Timing
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import KINDS as SENSORS
from surface_gym.sensors import Exact, Sensors
from surface_gym.tasks import TASKS
from surface_gym.tasks.task import Feature, Task

ORIENTATIONS = (0.0, math.pi / 4, -math.pi / 4, math.pi / 2)  # [rad] the paper's Figure 2b
LONGEST_STEP = 0.005  # [s]


@dataclass(frozen=True)
class Settings:
    """Arguments of an environment.

    Raises:
        ValueError: an argument is not allowed; the message names it, what came and what may come.
    """

    task: str | Task = "sort"  # its name, or one with parameters of its own
    actions: str = "modules"  # kind of action
    sensors: Sensors = Exact()  # what a controller gets to see
    control_period: float = 0.04  # [s] between decisions
    zone: tuple[int, int] | None = None  # first and last column that obey; None: the plant's own
    orientations: tuple[float, ...] = ORIENTATIONS  # [rad] axis angles on offer
    actuators: Actuators = Actuators()
    randomisation: Randomisation = Randomisation()

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        if isinstance(self.task, str):
            set_field(self, "task", TASKS[checks.one_of("task", self.task, TASKS)]())
        for name, kinds in (
            ("task", tuple(TASKS.values())),
            ("sensors", SENSORS),
            ("actuators", (Actuators,)),
            ("randomisation", (Randomisation,)),
        ):
            if not isinstance(getattr(self, name), kinds):
                allowed = ", ".join(kind.__name__ for kind in kinds)
                raise ValueError(f"{name} must be a {allowed}, got {getattr(self, name)!r}")
        angles = checks.array("orientations", self.orientations, (None,))
        if len(angles) < 2:
            raise ValueError(f"orientations must be at least 2, got {self.orientations!r}")
        set_field(self, "orientations", tuple(angles.tolist()))
        set_field(self, "control_period", checks.positive("control_period", self.control_period))
        self._check_places()
        self._check_size()
        _ = self.action_kind

    def _check_places(self) -> None:
        """The zone and the stuck modules lie on the surface."""
        plant = self.chosen_task.plant
        if self.zone is not None:
            if not isinstance(self.zone, (tuple, list)) or len(self.zone) != 2:
                raise ValueError(f"zone must be two columns, first and last, got {self.zone!r}")
            first = checks.integer("zone", self.zone[0], least=0)
            last = checks.integer("zone", self.zone[1], least=first)
            if last >= plant.columns:
                most = plant.columns - 1
                raise ValueError(f"zone must lie in the columns 0 to {most}, got {self.zone!r}")
            object.__setattr__(self, "zone", (first, last))
        for row, column in self.actuators.stuck:
            if row >= plant.rows or column >= plant.columns:
                raise ValueError(
                    f"stuck must lie in {plant.rows} rows and {plant.columns} columns, "
                    f"got {(row, column)}"
                )

    def _check_size(self) -> None:
        """Every parcel the task draws fits the plant at the largest size it may have."""
        for parcel in self.chosen_task.parcels:
            try:
                self.chosen_task.plant.site(self.randomisation.largest(parcel.base), self.zone)
            except ValueError as error:
                raise ValueError(
                    f"size must leave room for every parcel, got {self.randomisation.size!r}: "
                    f"{error}"
                ) from None

    @property
    def task_name(self) -> str:
        """The task's name, whatever its parameters."""
        return next(name for name, kind in TASKS.items() if isinstance(self.task, kind))

    @property
    def chosen_task(self) -> Task:
        """The task itself."""
        assert not isinstance(self.task, str)
        return self.task

    @property
    def action_kind(self) -> ActionKind:
        """What an action is."""
        plant = self.chosen_task.plant
        columns = plant.zone_columns if self.zone is None else self.zone[1] - self.zone[0] + 1
        return ActionKind(self.actions, len(self.orientations), plant.zone_rows, columns)

    @property
    def timing(self) -> Timing:
        """The control period in equal physics steps of at most 5 ms."""
        steps = math.ceil(self.control_period / LONGEST_STEP - 1e-9)
        return Timing(self.control_period / steps, steps)

    @property
    def features(self) -> tuple[Feature, ...]:
        """What one lane observes."""
        kind = self.action_kind
        window = tuple(
            Feature(f"occupied {row}, {column}", 0.0, 1.0, "a module that obeys, under the parcel")
            for row, column in np.ndindex(*kind.shape)
        )
        return self.chosen_task.features + (window if kind.window_size else ())

    def observation_space(self) -> spaces.Box:
        """The space of one lane's observation."""
        return spaces.Box(
            np.array([feature.low for feature in self.features], dtype=np.float32),
            np.array([feature.high for feature in self.features], dtype=np.float32),
        )

    def action_space(self) -> spaces.Space[Any]:
        """The space of one lane's action."""
        return self.action_kind.space()

    def make_batch(self, lanes: int, threads: int = 1) -> Batch:
        """A batch of lanes with these settings, moved on a number of threads."""
        angles = np.array(self.orientations)
        kind, timing = self.action_kind, self.timing
        acting = Acting(
            kind.number,
            kind.rows,
            np.stack([angles, np.cos(angles), np.sin(angles)], axis=-1),
            self.actuators.axis_speed * timing.dt,
        )
        return Batch(
            self.chosen_task,
            acting,
            kind.size,
            kind.window_size,
            lanes,
            timing,
            self.zone,
            self.sensors,
            self.actuators,
            self.randomisation,
            threads,
        )
