"""Parts of a batch: the functions of its kernel, its parameters and its threads."""

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from surface_gym import actions, feature_groups, state as st
from surface_gym.compiler.jit import is_compiled
from surface_gym.config import EnvConfig
from surface_gym.core.kernel import Actuation, EnvParams, KernelFunctions, ShownGroup
from surface_gym.modules import ALONG, ANGLE
from surface_gym.physics import types as ph
from surface_gym.physics.step import axis_directions
from surface_gym.physics.types import Integers, Scratch, make_scratch
from surface_gym.sensors.base import Sensor
from surface_gym.tasks.base import Task

FEWEST = 4  # minimum environments per thread
LOOK = 20_000  # maximum steps of a thread in one call, so that Ctrl-C does not wait long
PARTS = 16  # parts of a thread's share of environments; early threads take some of the last two


class Workers:
    """A pool of threads. Results do not depend on the number of threads."""

    def __init__(self, threads: int, steps: int, make: Callable[[], Any] = make_scratch) -> None:
        self._most = max(1, LOOK // steps)  # environments in a row
        self._pool: ThreadPoolExecutor | None = None
        self._process = os.getpid()
        # Scratches of the physics and of the sensor, per thread.
        self._scratches = [(make(), make_scratch()) for _ in range(threads)]

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_pool": None}

    @property
    def scratches(self) -> tuple[Any, Scratch]:
        """Scratch arrays of the first thread, as a pair (physics' arrays, sensor's arrays)."""
        return self._scratches[0]

    def run(
        self, threads: int, step: Callable[..., int], arrays: tuple[Any, ...], chosen: Integers
    ) -> int:
        """Step the chosen environments (count,) in several threads.

        A thread calls `step(*arrays, scratch, sensor's scratch, some of the environments)` one or
        more times. Return the sum of the numbers that all calls return.
        """
        if threads == 1:
            return self._in_pieces(step, (*arrays, *self._scratches[0]), chosen)
        if self._pool is None or self._process != os.getpid():  # a forked process has no threads
            self._pool = ThreadPoolExecutor(len(self._scratches) - 1)
            self._process = os.getpid()
        # A thread gets the same environments every time, since they are in its core's cache.
        cuts = [k * len(chosen) // (PARTS * threads) for k in range(PARTS * threads + 1)]
        firsts = range(0, PARTS * threads, PARTS)
        remaining = iter(
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
            done = self._in_pieces(step, given, own)
            return done + sum(self._in_pieces(step, given, part) for part in remaining)

        others = [self._pool.submit(work, thread) for thread in range(1, threads)]
        return work(0) + sum(other.result() for other in others)

    def _in_pieces(self, step: Callable[..., int], given: tuple[Any, ...], chosen: Integers) -> int:
        """Call `step(*given, chosen)` for a few environments at a time, so that Ctrl-C works."""
        if len(chosen) <= self._most:
            return step(*given, chosen)
        firsts = range(0, len(chosen), self._most)
        return sum(step(*given, chosen[first : first + self._most]) for first in firsts)


def task_functions(config: EnvConfig) -> KernelFunctions:
    """Collect the functions of task, sensor and kind of action for the kernel of one parcel."""
    task, sensor, kind = config.task, config.sensors, config.action_kind
    window = kind.name == "window"
    show_axes = feature_groups.show_window_axes if window else feature_groups.show_zone_axes
    return KernelFunctions(
        label=f"{type(task).__name__}-{type(sensor).__name__}-{kind.name}",
        **compiled_functions(task, Task, "begin is_done outcome reward observe mirror"),
        **compiled_functions(sensor, Sensor, "begin update read", "_sensor"),
        watches=sensor.watches,
        meters=config.meters,
        weighs=config.weighs,
        part_of=kind.part_of,
        actuation=choose_actuation(config),
        show_modules=feature_groups.show_occupancy if window else feature_groups.show_nothing,
        show_axes=show_axes if config.observe_axes else feature_groups.show_nothing,
        groups=tuple(
            ShownGroup(group.show, len(group.features), name in sensor.groups)
            for name, group in config.groups.items()
            if name in config.observed_groups
        ),
    )


def changes_slowly(config: EnvConfig) -> bool:
    """Return whether modules take time to follow a command."""
    slow_drive = config.module_kind.drives and config.module_kind.acceleration != math.inf
    actuators = config.actuators
    return slow_drive or actuators.axis_speed != math.inf or actuators.has_limits


def choose_actuation(config: EnvConfig) -> Actuation:
    """Return the functions that set the modules.

    The functions depend on the choice that an action makes for a module. The choice is any angle, a
    listed orientation, or a mode of a driven module. The functions also depend on whether modules
    change slowly.
    """
    any_angle, slow = config.action_kind.continuous, changes_slowly(config)
    if slow and config.module_kind.drives:
        return Actuation(
            actions.aim_at_mode, actions.ramp_modules, actions.straighten_modes, turns=True
        )
    if slow:
        aim = actions.aim_at_angle if any_angle else actions.aim_at_choice
        turn = actions.turn_axes
        if config.actuators.has_limits:
            turn = actions.turning_with_limits(config.actuators.turns_loaded)
        return Actuation(aim, turn, actions.straighten_targets, turns=True)
    set_axis, straighten = actions.set_choice, actions.straighten_choices
    if any_angle:
        set_axis, straighten = actions.set_angle, actions.straighten_angles
    return Actuation(set_axis, actions.leave_axes, straighten, turns=False)


def compiled_functions(owner: Any, kind: type[Any], names: str, ending: str = "") -> dict[str, Any]:
    """Return the compiled functions of `owner`, a task or sensor, as a dict.

    `names` are the functions' names, separated by spaces. A key is a name followed by `ending`.
    If a function is not compiled, raise a ValueError whose message names the base class `kind`.
    """
    found = {name + ending: getattr(owner, name, None) for name in names.split()}
    for name, function in found.items():
        if not is_compiled(function):
            raise ValueError(
                f"{type(owner).__name__}.{name.removesuffix(ending)} must be a static method and a "
                f"kernel_function, as {kind.__name__} says, got {function!r}"
            )
    return found


def make_env_params(config: EnvConfig) -> EnvParams:
    """Return the common parameters of a batch's environments."""
    line, timing, kind = config.chosen_line, config.timing, config.action_kind
    features = len(config.task.features)
    return EnvParams(
        elements=line.geometry,
        timing=timing,
        acting=actions.ActionParams(
            kind.rows,
            np.array(config.chosen_orientations),
            config.actuators.axis_speed * timing.dt,
            config.modes,
            config.module_kind.acceleration * timing.dt,
            config.actuators.step,
            0.5 * config.actuators.backlash,
        ),
        friction=line.friction.copy(),
        assumed=config.sensors.friction(line).copy(),
        stiffness=np.ones((line.rows, line.columns)),
        sensor=np.array(config.sensors.numbers(timing.dt), dtype=np.float64),
        features=features,
        axes_from=features + kind.window_size,
        outcomes=len(st.COMMON_OUTCOMES) + len(config.task.outcomes),
    )


def make_state(config: EnvConfig, num_envs: int) -> tuple[st.SurfaceState, st.ParcelState]:
    """Allocate the state arrays; no parcels are present, and all axes are at 90 deg."""
    return _make_surfaces(config, num_envs), _make_parcels(config, num_envs * config.rows)


def _make_surfaces(config: EnvConfig, count: int) -> st.SurfaceState:
    line, kind = config.chosen_line, config.action_kind
    grid = (count, line.rows, line.columns)
    turning = changes_slowly(config)
    # Axes are indices into few directions; with any angle, every axis has its own direction.
    modes = config.modes
    if kind.choices > 0 and not turning:
        axis = np.full(grid, kind.choices, dtype=np.int32)
        direction = axis_directions(modes[:, ANGLE])[np.newaxis]
        drive = modes[np.newaxis, :, ALONG:]
    else:
        own = np.arange(line.rows * line.columns, dtype=np.int32).reshape(grid[1:])
        axis = np.tile(own, (count, 1, 1))
        direction = np.tile(axis_directions(modes[-1:, ANGLE]), (count, own.size, 1))
        # Drives of idle rotors are all zero, and common to all surfaces.
        drive = np.tile(
            modes[-1:, ALONG:], (count if config.module_kind.drives else 1, own.size, 1)
        )
    flag = np.zeros((len(drive), 1, 3))
    flag[..., st.DRIVEN] = config.module_kind.drives
    return st.SurfaceState(
        axis=axis,
        direction=direction,
        drive=np.concatenate([drive, flag], axis=1),
        angle=np.zeros(grid if turning else (count, 1, 1)),
        target=np.zeros(grid if turning else (count, 1, 1)),
        stiffness=np.ones((count if config.randomisation.stiffness > 0.0 else 1, *grid[1:])),
        conditions=np.zeros((count, st.CONDITION_COLUMNS)),
        command=np.zeros((count, kind.size), dtype=np.int64 if kind.choices else np.float64),
        load=np.zeros((*(grid if config.weighs else (1, 1, 1)), 2)),
    )


def _make_parcels(config: EnvConfig, rows: int) -> st.ParcelState:
    task = config.task
    return st.ParcelState(
        state=np.zeros((rows, ph.STATE_SIZE)),
        truth=np.zeros((rows, 6)),
        sensed=np.zeros((rows, 6)),
        clock=np.zeros(rows),
        period=np.zeros(rows),
        steps=np.zeros(rows, dtype=np.int64),
        on_rotors=np.ones(rows, dtype=np.bool_),
        on_surface=np.ones(rows, dtype=np.bool_),
        body=np.zeros(rows, dtype=np.int64),
        goal=np.zeros((rows, task.goals)),
        path=np.zeros((rows, st.PATH_POINTS if task.has_path else 0)),
        memory=np.zeros((rows, task.memories)),
        metrics=np.zeros((rows, len(task.metrics))),
        noise=np.zeros((rows, st.NOISE_ROWS if config.draws > 0 else 0, 4)),
        noise_row=np.zeros((rows, 1), dtype=np.int64),
        sensor_state=np.zeros((rows, config.sensors.sensor_size)),
        observation=np.zeros((rows, len(config.features)), dtype=np.float32),
        terms=np.zeros((rows, len(task.parcel_terms))),
        reward=np.zeros(rows),
        outcome=np.zeros(rows, dtype=np.int64),
        fault=np.zeros(rows, dtype=np.int64),
        energy=np.zeros((rows, len(st.ENERGIES) if config.meters else 0)),
    )
