"""Functions, parameters and memory that a batch is assembled from, by its configuration."""

import math
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

from surface_gym.config import EnvConfig
from surface_gym.core.actions import (
    CONVEYOR,
    Acting,
    aim_at_angle,
    aim_at_choice,
    leave_axes,
    set_angle,
    set_choice,
    show_nothing,
    show_occupancy,
    show_window_axes,
    show_zone_axes,
    shown,
    straighten_angles,
    straighten_choices,
    straighten_targets,
    turn_axes,
)
from surface_gym.core.kernel import Actuation, EnvParams, Function, KernelFunctions
from surface_gym.flow.task import StreamTask
from surface_gym.physics.step import axis_directions
from surface_gym.sensors.base import Sensor
from surface_gym.state import (
    COMMON_OUTCOMES,
    ParcelState,
    Sizes,
    SurfaceState,
    make_parcels,
    make_surfaces,
)
from surface_gym.tasks.base import Task


def task_functions(config: EnvConfig) -> KernelFunctions:
    """Collect the functions that the kernel of one parcel is built from.

    Raises:
        ValueError: a task or a sensor lacks one of its compiled functions.
    """
    task, sensor, kind = config.task, config.sensors, config.action_kind
    begin_sensor, update, read = sensor_functions(sensor)
    window = kind.name == "window"
    show_axes = show_window_axes if window else show_zone_axes
    return KernelFunctions(
        label=f"{type(task).__name__}-{type(sensor).__name__}-{kind.name}",
        begin=compiled_function(task, "begin", Task),
        is_done=compiled_function(task, "is_done", Task),
        outcome=compiled_function(task, "outcome", Task),
        reward=compiled_function(task, "reward", Task),
        observe=compiled_function(task, "observe", Task),
        mirror=compiled_function(task, "mirror", Task),
        begin_sensor=begin_sensor,
        update_sensor=update,
        read_sensor=read,
        watches=sensor.watches,
        part_of=kind.part_of,
        actuation=choose_actuation(kind.continuous, config.actuators.axis_speed != math.inf),
        show_modules=show_occupancy if window else show_nothing,
        show_axes=show_axes if config.observe_axes else show_nothing,
        learned=compiled_function(sensor, "learned", Sensor),
        more=shown(config.observe),
    )


def choose_actuation(any_angle: bool, turning: bool) -> Actuation:
    """Choose how axes obey: at any angle or one of those on offer, at once or by turning."""
    if turning:
        aim = aim_at_angle if any_angle else aim_at_choice
        return Actuation(aim, turn_axes, straighten_targets, turns=True)
    if any_angle:
        return Actuation(set_angle, leave_axes, straighten_angles, turns=False)
    return Actuation(set_choice, leave_axes, straighten_choices, turns=False)


def sensor_functions(sensor: Sensor) -> tuple[Function, Function, Function]:
    """Collect a sensor's `begin`, `update` and `read`.

    Raises:
        ValueError: it lacks one of them.
    """
    begin, update, read = (
        compiled_function(sensor, name, Sensor) for name in ("begin", "update", "read")
    )
    return begin, update, read


def compiled_function(owner: Any, name: str, kind: type[Any]) -> Function:
    """Get a compiled function of a task or a sensor, or raise an error that names it."""
    function: Function | None = getattr(owner, name, None)
    if not isinstance(function, Dispatcher):
        raise ValueError(
            f"{type(owner).__name__}.{name} must be a static method and a kernel_function, as "
            f"{kind.__name__} says, got {function!r}"
        )
    return function


def make_rules(config: EnvConfig) -> EnvParams:
    """Collect the numbers that all environments of a batch have in common."""
    line, timing, kind = config.chosen_line, config.timing, config.action_kind
    features = len(config.task.features)
    return EnvParams(
        elements=line.geometry,
        timing=timing,
        acting=Acting(
            kind.rows,
            np.array(config.chosen_orientations),
            config.actuators.axis_speed * timing.dt,
        ),
        friction=line.friction.copy(),
        assumed=config.sensors.friction(line).copy(),
        stiffness=np.ones((line.rows, line.columns)),
        sensor=np.array(config.sensors.numbers(timing.dt), dtype=np.float64),
        features=features,
        axes_from=features + kind.window_size,
        outcomes=len(COMMON_OUTCOMES) + len(config.task.outcomes),
    )


def make_state(config: EnvConfig, num_envs: int) -> tuple[SurfaceState, ParcelState]:
    """Make the memory of surfaces and parcels, every axis the conveyor's."""
    task, line, kind = config.task, config.chosen_line, config.action_kind
    stream = isinstance(task, StreamTask)
    sizes = Sizes(
        num_envs=num_envs,
        rows=line.rows,
        columns=line.columns,
        command=kind.size,
        choices=kind.choices,
        observation=len(config.features),
        terms=len(task.parcel_terms if stream else task.terms),
        goals=task.goals,
        memories=task.memories,
        metrics=len(task.metrics),
        sensor_state=config.sensors.sensor_size,
        path=task.has_path,
        noise=config.draws > 0,
        turning=config.actuators.axis_speed != math.inf,
        stiffness=config.randomisation.stiffness > 0.0,
        max_parcels=task.rows if stream else 1,
    )
    surfaces = make_surfaces(sizes)
    surfaces.direction[:] = CONVEYOR
    if sizes.choices and not sizes.turning:  # axes count the orientations on offer
        angles = np.array(config.chosen_orientations)
        surfaces.direction[0, :-1] = axis_directions(angles)
        surfaces.axis[:] = len(angles)
    return surfaces, make_parcels(sizes)
