"""What is otherwise than as trained, said in data, and the environments it makes."""

from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from surface_gym.conditions import CONDITIONS, Condition
from surface_gym.lines import BaseLine, Line
from surface_gym.settings import Settings
from surface_gym.tasks import Task
from surface_gym.tasks.base import Draw, Numbers, Start

from ...zones import time_for, with_zone
from ..contenders import Contender
from ..trials import Trial

EXACT = CONDITIONS["exact"]


@dataclass(frozen=True)
class Change:
    """What differs from a contender's own environment; by default nothing."""

    condition: Condition = EXACT  # sensors, randomisation, actuators and parcels
    control_period: float | None = None  # [s] between decisions; None: the contender's own
    # Of the line that obey; None: its own. An episode may last the longer where there are more.
    zone_columns: int | None = None
    drag: float = 1.0  # [-] factor of mu_max, which no controller is told
    rolling: float = 1.0  # [-] factor of mu_min and of mu_support, likewise
    aside: float = 0.0  # [m] from where parcels enter, to either side
    turned: float = 0.0  # [rad] from how they enter, to the same side


class Situation(NamedTuple):
    """An environment, and what a controller is told of it."""

    told: Settings
    true: Settings


def situation(contender: Contender, trial: Trial, change: Change) -> Situation:
    """The environment of a contender on a task under a change."""
    period = change.control_period or contender.control_period
    plant = trial.task.plant
    slower = contender.control_period / period
    if change.zone_columns is not None:
        assert isinstance(plant, Line)
        slower *= time_for(plant, change.zone_columns)
        plant = with_zone(plant, change.zone_columns)
    altered = replace(trial, task=_altered(trial.task, slower, change))
    settings = contender.settings(altered, change.condition)
    told = replace(settings, control_period=period, plant=plant)
    return Situation(told, replace(told, plant=_with_friction(plant, change)))


def _with_friction(plant: BaseLine, change: Change) -> BaseLine:
    return replace(
        plant,
        mu_max=np.multiply(plant.mu_max, change.drag),
        mu_min=np.multiply(plant.mu_min, change.rolling),
        mu_support=np.multiply(plant.mu_support, change.rolling),
    )


def _altered(task: Task, slower: float, change: Change) -> Task:
    """The same task: its limit, in periods, times `slower`, and its parcels entering otherwise.

    A task says both in its class; what is compiled of it is the class's own.
    """
    if (slower, change.aside, change.turned) == (1.0, 0.0, 0.0):
        return task
    kind = type(task)

    def start(self: Task, draw: Draw) -> Start:
        begun = kind.start(self, draw)
        side = _sides(draw)
        x, y, theta = begun.pose
        y, theta = np.add(y, change.aside * side), np.add(theta, change.turned * side)
        return begun._replace(pose=(x, y, theta))

    altered = type(
        kind.__name__, (kind,), {"periods": round(kind.periods * slower), "start": start}
    )
    same: Task = altered(**{each.name: getattr(task, each.name) for each in fields(task)})
    return same


def _sides(draw: Draw) -> Numbers:
    """(starts,) 1 or -1, equal odds, by digits of a number drawn that hardly count."""
    return np.where(draw.numbers[0] * 1e6 % 1.0 < 0.5, 1.0, -1.0)
