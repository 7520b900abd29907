"""Which compiled functions a batch is built from: its task's, its sensor's, its actions'."""

import math
from typing import Any

from numba.core.dispatcher import Dispatcher

from surface_gym.actions.commands import (
    aim_at_angle,
    aim_at_choice,
    leave_axes,
    set_angle,
    set_choice,
    straighten_angles,
    straighten_choices,
    straighten_targets,
    turn_axes,
)
from surface_gym.actions.more import shown
from surface_gym.actions.showing import (
    show_nothing,
    show_occupancy,
    show_window_axes,
    show_zone_axes,
)
from surface_gym.batch.kernels import Actuation, Function, Functions
from surface_gym.sensors.sensor import Sensor
from surface_gym.settings import Settings
from surface_gym.tasks.task import Task


def functions_of(settings: Settings) -> Functions:
    """What the kernel of an environment is built from.

    Raises:
        ValueError: a task or a sensor lacks one of its compiled functions.
    """
    task, sensor, kind = settings.chosen_task, settings.sensors, settings.action_kind
    begin_sensor, look, estimate = sensor_functions_of(sensor)
    window = kind.name == "window"
    show_axes = show_window_axes if window else show_zone_axes
    return Functions(
        label=f"{type(task).__name__}-{type(sensor).__name__}-{kind.name}",
        begin=_function(task, "begin", Task),
        over=_function(task, "over", Task),
        judge=_function(task, "judge", Task),
        reward=_function(task, "reward", Task),
        observe=_function(task, "observe", Task),
        mirror=_function(task, "mirror", Task),
        begin_sensor=begin_sensor,
        look=look,
        estimate=estimate,
        watches=sensor.watches,
        part_of=kind.part_of,
        actuation=actuation_of(kind.continuous, settings.actuators.axis_speed != math.inf),
        show_modules=show_occupancy if window else show_nothing,
        show_axes=show_axes if settings.observe_axes else show_nothing,
        learned=_function(sensor, "learned", Sensor),
        more=shown(settings.observe),
    )


def actuation_of(any_angle: bool, turning: bool) -> Actuation:
    """How axes obey: set at any angle or to one of those on offer, at once or turning."""
    if turning:
        aim = aim_at_angle if any_angle else aim_at_choice
        return Actuation(aim, turn_axes, straighten_targets, turns=True)
    if any_angle:
        return Actuation(set_angle, leave_axes, straighten_angles, turns=False)
    return Actuation(set_choice, leave_axes, straighten_choices, turns=False)


def sensor_functions_of(sensor: Sensor) -> tuple[Function, Function, Function]:
    """A sensor's `begin`, `look` and `estimate`.

    Raises:
        ValueError: it lacks one of them.
    """
    begin, look, estimate = (
        _function(sensor, name, Sensor) for name in ("begin", "look", "estimate")
    )
    return begin, look, estimate


def _function(owner: Any, name: str, kind: type[Any]) -> Function:
    function: Function | None = getattr(owner, name, None)
    if not isinstance(function, Dispatcher):
        raise ValueError(
            f"{type(owner).__name__}.{name} must be a static method and a lane_function, as "
            f"{kind.__name__} says, got {function!r}"
        )
    return function
