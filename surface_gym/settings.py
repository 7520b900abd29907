"""What an environment is made with, checked once for both faces."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from gymnasium import spaces

from surface_gym import checks, plant
from surface_gym.actions import ActionKind
from surface_gym.batch.batch import Batch
from surface_gym.lanes.memory import Timing
from surface_gym.tasks import TASKS
from surface_gym.tasks.task import Task

ORIENTATIONS = (0.0, math.pi / 4, -math.pi / 4, math.pi / 2)  # [rad] the paper's Figure 2b
LONGEST_STEP = 0.005  # [s]


@dataclass(frozen=True)
class Settings:
    """Arguments of an environment.

    Raises:
        ValueError: an unknown task or kind of action, fewer than two orientations, a control
            period that is not positive, or a zone outside the surface.
    """

    task: str | Task = "sort"  # its name, or one with parameters of its own
    actions: str = "modules"  # kind of action
    control_period: float = 0.04  # [s] between decisions
    zone: tuple[int, int] | None = None  # first and last column that obey; None: after the lead-in
    orientations: tuple[float, ...] = field(default=ORIENTATIONS)  # [rad] axis angles on offer

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        if isinstance(self.task, str):
            set_field(self, "task", TASKS[checks.one_of("task", self.task, TASKS)]())
        elif not isinstance(self.task, tuple(TASKS.values())):
            raise ValueError(f"task must be one of {', '.join(TASKS)} or a Task, got {self.task!r}")
        angles = checks.array("orientations", np.asarray(self.orientations), (None,))
        if len(angles) < 2:
            raise ValueError(f"orientations must be at least 2, got {self.orientations!r}")
        set_field(self, "orientations", tuple(angles.tolist()))
        set_field(self, "control_period", checks.positive("control_period", self.control_period))
        if self.zone is not None:
            if len(self.zone) != 2:
                raise ValueError(f"zone must be two columns, first and last, got {self.zone!r}")
            first = checks.integer("zone", self.zone[0], least=0)
            last = checks.integer("zone", self.zone[1], least=first)
            if last >= plant.COLUMNS:
                raise ValueError(
                    f"zone must lie within the columns 0 to {plant.COLUMNS - 1}, got {self.zone!r}"
                )
            set_field(self, "zone", (first, last))
        _ = self.action_kind

    @property
    def chosen_task(self) -> Task:
        """The task itself."""
        assert not isinstance(self.task, str)
        return self.task

    @property
    def action_kind(self) -> ActionKind:
        """What an action is."""
        first, last = self.zone if self.zone is not None else (1, plant.ZONE_COLUMNS)
        return ActionKind(self.actions, len(self.orientations), last - first + 1)

    @property
    def timing(self) -> Timing:
        """The control period in equal physics steps of at most 5 ms."""
        steps = math.ceil(self.control_period / LONGEST_STEP - 1e-9)
        return Timing(self.control_period / steps, steps)

    def observation_space(self) -> spaces.Box:
        """The space of one lane's observation."""
        features = self.chosen_task.features
        return spaces.Box(
            np.array([feature.low for feature in features], dtype=np.float32),
            np.array([feature.high for feature in features], dtype=np.float32),
        )

    def action_space(self) -> spaces.Space[Any]:
        """The space of one lane's action."""
        return self.action_kind.space()

    def make_batch(self, lanes: int) -> Batch:
        """A batch of lanes with these settings."""
        return Batch(
            self.chosen_task,
            self.action_kind.number,
            self.action_kind.size,
            np.array(self.orientations),
            lanes,
            self.timing,
            self.zone,
        )
