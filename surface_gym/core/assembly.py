"""Parts of a batch put together: its kernel's functions, its parameters and its threads."""

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numba.core.dispatcher import Dispatcher

from surface_gym import state as st
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
from surface_gym.physics.types import Integers, Scratch, make_scratch
from surface_gym.sensors.base import Sensor
from surface_gym.state import ParcelState, SurfaceState
from surface_gym.tasks.base import Task

FEWEST = 4  # lanes that a thread is worth its while for
LOOK = 20_000  # steps of a parcel that a thread takes in a row: Ctrl-C waits for no more
PARTS = 16  # of a thread's share of the lanes; the last two are taken by whoever is done early


class Workers:
    """One thread or more; results do not depend on their number.

    Args:
        threads: their number.
        steps: of parcels, that a lane takes in a call.
        make: makes the physics' scratch of one.
    """

    def __init__(self, threads: int, steps: int, make: Callable[[], Any] = make_scratch) -> None:
        self._most = max(1, LOOK // steps)  # lanes in a row
        self._pool: ThreadPoolExecutor | None = None
        self._process = os.getpid()
        # Of the physics, and of the sensor.
        self._scratches = [(make(), make_scratch()) for _ in range(threads)]

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_pool": None}

    @property
    def scratches(self) -> tuple[Any, Scratch]:
        """Those of the first thread."""
        return self._scratches[0]

    def run(
        self, threads: int, move: Callable[..., int], arrays: tuple[Any, ...], chosen: Integers
    ) -> int:
        """Call `move(*arrays, scratch, sensor's scratch, chosen)` over the chosen lanes.

        Returns:
            The sum of what it returns.
        """
        if threads == 1:
            return self._in_pieces(move, (*arrays, *self._scratches[0]), chosen)
        if self._pool is None or self._process != os.getpid():  # a fork has none of the threads
            self._pool = ThreadPoolExecutor(len(self._scratches) - 1)
            self._process = os.getpid()
        # A thread has the same lanes each time, which its core has in its memory still.
        cuts = [k * len(chosen) // (PARTS * threads) for k in range(PARTS * threads + 1)]
        firsts = range(0, PARTS * threads, PARTS)
        left = iter(
            [
                chosen[cuts[k] : cuts[k + 1]]
                for first in firsts
                for k in (first + PARTS - 2, first + PARTS - 1)
            ]
        )

        def work(thread: int) -> int:
            scratches = self._scratches[thread]
            own = chosen[cuts[PARTS * thread] : cuts[PARTS * thread + PARTS - 2]]
            given = (*arrays, *scratches)
            done = self._in_pieces(move, given, own)
            return done + sum(self._in_pieces(move, given, part) for part in left)

        others = [self._pool.submit(work, thread) for thread in range(1, threads)]
        return work(0) + sum(other.result() for other in others)

    def _in_pieces(self, move: Callable[..., int], given: tuple[Any, ...], chosen: Integers) -> int:
        """Call `move(*given, chosen)`, some lanes at a time, between which Python sees Ctrl-C."""
        if len(chosen) <= self._most:
            return move(*given, chosen)
        firsts = range(0, len(chosen), self._most)
        return sum(move(*given, chosen[first : first + self._most]) for first in firsts)


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


def make_env_params(config: EnvConfig) -> EnvParams:
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
        outcomes=len(st.COMMON_OUTCOMES) + len(config.task.outcomes),
    )


def make_state(config: EnvConfig, num_envs: int) -> tuple[SurfaceState, ParcelState]:
    """Make the memory of surfaces and parcels, every axis the conveyor's."""
    task, line, kind = config.task, config.chosen_line, config.action_kind
    stream = isinstance(task, StreamTask)
    sizes = st.Sizes(
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
    surfaces = st.make_surfaces(sizes)
    surfaces.direction[:] = CONVEYOR
    if sizes.choices and not sizes.turning:  # axes count the orientations on offer
        angles = np.array(config.chosen_orientations)
        surfaces.direction[0, :-1] = axis_directions(angles)
        surfaces.axis[:] = len(angles)
    return surfaces, st.make_parcels(sizes)
