"""Starts as a task gives them, checked and laid out: one row a start."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from surface_gym import bounds
from surface_gym.dynamics.states import each, states_of
from surface_gym.dynamics.types import (
    GRAVITY,
    Array,
    Integers,
)
from surface_gym.lanes.memory import GRAVITY_ALONG, GRAVITY_NORMAL, PATH_POINTS
from surface_gym.parcel import Parcel
from surface_gym.settings import Settings
from surface_gym.tasks.start import Draw, Parcels, Start
from surface_gym.tasks.task import Task


class Rows(NamedTuple):
    """What starts put into the rows of their lanes."""

    site: Integers  # (starts,)
    state: Array  # (starts, STATE_SIZE)
    conditions: Array  # (starts, 5)
    goal: Array  # (starts, goals)


def starts_of(settings: Settings, numbers: Array, options: Sequence[Mapping[str, Any]]) -> Start:
    """What the task of an environment makes of numbers (starts, draws) and the options of each, or
    an error that names the task.
    """
    task = settings.chosen_task
    start = task.start(Draw(numbers, options, settings.chosen_plant, settings.zone))
    if not isinstance(start, Start):
        raise ValueError(f"{type(task).__name__}.start must give a Start, got {start!r}")
    return start


def rows_of(task: Task, start: Start, parcels: Parcels, sites: Integers) -> Rows:
    """Rows of starts of these parcels, whose sites are (starts,)."""
    count = len(sites)
    pose = _columns(task, "pose", start.pose, 3, count)
    _check_physical(task, "pose", pose, (bounds.FARTHEST, bounds.FARTHEST, bounds.TURNED))
    velocity = _columns(task, "velocity", start.velocity, 3, count)
    _check_physical(task, "velocity", velocity, (bounds.SPEED, bounds.SPEED, bounds.SPIN))
    conditions = np.ones((count, 5))
    conditions[:, GRAVITY_ALONG] = GRAVITY * each(math.sin, start.tilt)
    conditions[:, GRAVITY_NORMAL] = GRAVITY * each(math.cos, start.tilt)
    goal = _columns(task, "goal", start.goal, task.goals, count)
    state = states_of(parcels.of(lambda parcel: parcel.centre_of_mass), pose, velocity)
    return Rows(sites, state, conditions, goal)


def _columns(task: Task, name: str, values: Sequence[Any], wanted: int, count: int) -> Array:
    """(count, wanted) of a start's numbers, or arrays (count,), of that name; or an error."""
    told = f"{type(task).__name__}.start must give a {name} of"
    if len(values) != wanted:
        raise ValueError(f"{told} {wanted} numbers, got {len(values)}")
    columns = np.empty((count, wanted))
    for k, value in enumerate(values):
        try:
            columns[:, k] = value
        except (TypeError, ValueError):
            raise ValueError(f"{told} numbers or arrays ({count},), got {value!r}") from None
    if not np.isfinite(columns).all():
        raise ValueError(f"{told} finite numbers, got {tuple(values)!r}")
    return columns


def _check_physical(task: Task, name: str, columns: Array, most: tuple[float, ...]) -> None:
    """Raise a ValueError for starts whose numbers (count, 3) are farther from 0 than `most`."""
    if (np.abs(columns) > most).any():
        raise ValueError(
            f"{type(task).__name__}.start must give a {name} of numbers up to {most}, "
            f"got {tuple(columns[(np.abs(columns) > most).any(axis=1)][0].tolist())}"
        )


def path_of(task: Task, start: Start, count: int) -> Array:
    """(PATH_POINTS,) or (count, PATH_POINTS) of a start, or an error."""
    path = start.path
    if path is None or path.shape not in ((PATH_POINTS,), (count, PATH_POINTS)):
        raise ValueError(
            f"{type(task).__name__}.start must give a path of {PATH_POINTS} points, "
            f"got {None if path is None else path.shape}"
        )
    return path


def parcels_of(parcel: Parcel | Parcels, count: int) -> Parcels:
    """One parcel for all, as one each."""
    if isinstance(parcel, Parcels):
        return parcel
    return Parcels((parcel,), np.zeros(count, dtype=np.int64))
