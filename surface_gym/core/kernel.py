"""The compiled kernel: one control period of an environment.

It applies the command, turns the axes, steps the physics, and calls sensor and task. It only
contains the functions of the batch's task, sensor and kind of action.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

from surface_gym import state as st
from surface_gym.actions import ActionParams, window_corner
from surface_gym.compiler.jit import compiled, inlined
from surface_gym.physics import types as ph
from surface_gym.physics.contacts import invalidate_contacts
from surface_gym.physics.friction import friction_work
from surface_gym.physics.step import OFF_SURFACE, find_support, step_implicit, support_load
from surface_gym.physics.types import MASS, OMEGA, VX, VY, Array, Contacts, Integers, Scratch
from surface_gym.sensors.base import Physics, Singles
from surface_gym.state import BodyTable, EnvState, Geometry, ParcelState, SurfaceState, Timing

Function = Callable[..., Any]


class Actuation(NamedTuple):
    """Compiled functions that set and turn the axes."""

    obey: Function  # applies a part of the command to an axis
    turn: Function  # turns all axes in a physics step
    straighten: Function  # sets all axes to the conveyor's
    turns: bool  # whether axes take time


class ShownGroup(NamedTuple):
    """An optional group of features."""

    show: Function
    size: int  # numbers it writes
    by_sensor: bool  # whether `show` gets the sensor's numbers, else the actions' parameters


class KernelFunctions(NamedTuple):
    """Functions of a kernel."""

    label: str  # name of the kernel's files in the cache
    begin: Function
    is_done: Function
    outcome: Function
    reward: Function
    observe: Function
    mirror: Function
    begin_sensor: Function
    update_sensor: Function
    read_sensor: Function
    watches: bool
    meters: bool  # whether energies are summed
    weighs: bool  # whether loads are computed
    part_of: Function
    actuation: Actuation
    show_modules: Function  # writes features after the task's
    show_axes: Function
    groups: tuple[ShownGroup, ...]  # writes the last features


class EnvParams(NamedTuple):
    """Parameters that all environments of a batch share."""

    elements: Geometry
    timing: Timing
    acting: ActionParams
    friction: Array  # (rows, columns, 3) [-] friction of the elements
    assumed: Array  # (rows, columns, 3) [-] friction in the sensor's model
    stiffness: Array  # (rows, columns) [-] stiffness in the sensor's model
    sensor: Array  # parameters of the sensor
    features: int  # number of the task's features
    axes_from: int  # first index of the axes' features
    outcomes: int  # number of outcomes


@lru_cache(maxsize=64)
def obeying(part_of: Function, obey: Function) -> Any:
    """Build `obey_command(params, surfaces, state, i, mirror)`, which sets the zone's axes.

    A command is an array of numbers. A module obeys at most one number. `part_of` returns the index
    of this number, or a negative index if there is no number. `obey` sets a module by the number.
    """

    @inlined
    def obey_command(
        params: EnvParams, surfaces: SurfaceState, state: EnvState, i: int, mirror: float
    ) -> None:
        corner = window_corner(state, mirror)
        zone = state.zone
        for row in range(zone[st.FIRST_ROW], zone[st.FIRST_ROW] + zone[st.ROWS]):
            for column in range(zone[st.FIRST_COLUMN], zone[st.FIRST_COLUMN] + zone[st.COLUMNS]):
                part = part_of(params.acting, state, corner, row, column)
                if part >= 0 and state.obeys[row, column]:
                    obey(params.acting, surfaces, i, row, column, part)

    return obey_command


def _showing(group: ShownGroup) -> Any:
    """Build `show_group(params, state, see, mirror)`, which writes a group of features."""
    show = group.show
    if group.by_sensor:

        @inlined
        def show_group(params: EnvParams, state: EnvState, see: Singles, mirror: float) -> None:
            show(params.sensor, state, see, mirror)

    else:

        @inlined
        def show_group(params: EnvParams, state: EnvState, see: Singles, mirror: float) -> None:
            show(params.acting, state, see, mirror)

    return show_group


def _showing_all(groups: tuple[ShownGroup, ...]) -> Any:
    """Build `show_groups(params, state, first, mirror) -> int`.

    `show_groups` writes the groups' features into the observation from index `first` on, and
    returns the index after the last feature.
    """
    if not groups:

        @inlined
        def show_none(params: EnvParams, state: EnvState, first: int, mirror: float) -> int:
            return first

        return show_none

    show_before, show, size = _showing_all(groups[:-1]), _showing(groups[-1]), groups[-1].size

    @inlined
    def show_groups(params: EnvParams, state: EnvState, first: int, mirror: float) -> int:
        place = show_before(params, state, first, mirror)
        show(params, state, state.observation[place : place + size], mirror)
        return place + size

    return show_groups


@lru_cache(maxsize=256)
def showing(functions: KernelFunctions) -> Any:
    """Build `show_more(params, state, mirror)`, which writes all features except the task's."""
    show_modules, show_axes = functions.show_modules, functions.show_axes
    show_groups = _showing_all(functions.groups)
    size = sum(group.size for group in functions.groups)

    @inlined
    def show_more(params: EnvParams, state: EnvState, mirror: float) -> None:
        show_modules(params.acting, state, params.features, mirror)
        show_axes(params.acting, state, params.axes_from, mirror)
        show_groups(params, state, state.observation.shape[0] - size, mirror)

    return show_more


@inlined
def begin_period(parcels: ParcelState, i: int) -> None:
    """Clear environment i's results of the last control period."""
    parcels.fault[i] = st.NO_FAULT
    parcels.period[i] = 0.0
    parcels.on_rotors[i] = True
    parcels.on_surface[i] = True


@inlined
def add_energy(
    parcels: ParcelState,
    i: int,
    mass: float,
    dt: float,
    scratch: Scratch,
    contacts: Contacts,
    vx: float,
    vy: float,
    omega: float,
) -> None:
    """Add the energies [J] of a step of `dt` [s] to `parcels.energy[i]`.

    Entry PEAK of `parcels.energy[i]` is the largest acceleration [m/s^2] so far. `vx`, `vy` and
    `omega` are the velocity before the step. `scratch` and `contacts` hold the step's contacts.
    """
    after = parcels.state[i]
    work, heat, drawn = friction_work(
        scratch,
        contacts,
        0.5 * (vx + after[VX]),
        0.5 * (vy + after[VY]),
        0.5 * (omega + after[OMEGA]),
    )
    parcels.energy[i, st.WORK] += mass * work
    parcels.energy[i, st.HEAT] += mass * heat
    parcels.energy[i, st.DRAWN] += mass * drawn
    rate = math.sqrt((after[VX] - vx) ** 2 + (after[VY] - vy) ** 2) / dt
    parcels.energy[i, st.PEAK] = max(parcels.energy[i, st.PEAK], rate)


@inlined
def clear_loads(load: Array, entries: int) -> None:
    """Set the first `entries` entries of each element in `load` (rows, columns, 2) to 0."""
    for row in range(load.shape[0]):
        for column in range(load.shape[1]):
            for k in range(entries):
                load[row, column, k] = 0.0


@inlined
def add_loads(
    grid: ph.Grid, body: ph.Body, com: Array, mass: float, scratch: Scratch, load: Array
) -> None:
    """Write a parcel's normal forces [N] into `load` (rows, columns, 2).

    Entry NOW of the last dimension gets the force on each element under the parcel. Entry PEAK_LOAD
    keeps each module's largest force so far. `com` (STATE_SIZE,) is the state of the parcel's
    centre of mass.
    """
    contacts = find_support(grid, body, com, scratch, 0.0)
    if contacts.total == 0:
        return
    support_load(grid, body, com, scratch, contacts)
    marks, k = scratch.marks, 0
    for span in range(marks[ph.SPANS]):
        row = marks[ph.SPAN_ROW + span]
        for column in range(marks[ph.SPAN_FIRST + span], marks[ph.SPAN_LAST + span] + 1):
            force = mass * scratch.table[ph.NORMAL + k]
            load[row, column, st.NOW] = force
            if grid.rotor[row, column]:
                load[row, column, st.PEAK_LOAD] = max(load[row, column, st.PEAK_LOAD], force)
            k += 1


def _running(functions: KernelFunctions) -> Any:
    """Build `run(params, surfaces, parcels, bodies, scratch, sensor's scratch, i)`.

    The function `run` steps the physics for a control period, and returns the `EnvState`. If the
    parcel is off the surface or the task is done, `run` ends the period early.
    """
    task_is_done, sensor_update = functions.is_done, functions.update_sensor
    watches, turn, turns = functions.watches, functions.actuation.turn, functions.actuation.turns
    meters, weighs = functions.meters, functions.weighs

    @inlined
    def run(
        params: EnvParams,
        surfaces: SurfaceState,
        parcels: ParcelState,
        bodies: BodyTable,
        scratch: Scratch,
        sensor_scratch: Scratch,
        i: int,
    ) -> EnvState:
        dt = params.timing.dt
        physics = Physics(params.assumed, params.stiffness, sensor_scratch, dt)
        state = st.env_state(surfaces, parcels, bodies, i, i, params.elements)
        row = parcels.body[i]
        grid = st.read_grid(surfaces, bodies, i, row, params.elements, params.friction)
        body = st.read_body(bodies, row)
        start = parcels.clock[i]
        invalidate_contacts(scratch)
        invalidate_contacts(sensor_scratch)
        for _ in range(params.timing.steps):
            if weighs:
                clear_loads(surfaces.load[i], 1)
                add_loads(grid, body, state.com, state.body[MASS], scratch, surfaces.load[i])
            if turns and turn(params.acting, surfaces, i, state.zone):
                invalidate_contacts(scratch)
                invalidate_contacts(sensor_scratch)
            vx, vy, omega = state.com[VX], state.com[VY], state.com[OMEGA]
            report, contacts = step_implicit(grid, body, state.com, scratch, dt)
            on_surface = report < OFF_SURFACE
            if meters and on_surface:
                add_energy(parcels, i, state.body[MASS], dt, scratch, contacts, vx, vy, omega)
            parcels.on_surface[i] = on_surface
            if on_surface:
                parcels.clock[i] += dt
                parcels.steps[i] += 1
                parcels.period[i] = parcels.clock[i] - start
                parcels.on_rotors[i] = contacts.total > contacts.supports
            state = st.env_state(surfaces, parcels, bodies, i, i, params.elements)
            if not on_surface:
                break
            if watches:
                st.read_truth(state)
                sensor_update(params.sensor, state, physics)
            if task_is_done(state):
                break
        return state

    return run


def _ending(functions: KernelFunctions) -> Any:
    """Build `end(params, parcels, state, i)`, which writes a period's outcome and reward."""
    task_outcome, task_reward = functions.outcome, functions.reward

    @inlined
    def end(params: EnvParams, parcels: ParcelState, state: EnvState, i: int) -> None:
        st.read_truth(state)
        outcome = task_outcome(state)
        task_reward(state, outcome)
        parcels.outcome[i] = outcome
        reward = 0.0
        for k in range(state.terms.shape[0]):
            reward += state.terms[k]
        parcels.reward[i] = reward
        if not math.isfinite(reward):
            parcels.fault[i] = st.BAD_REWARD
        if not 0 <= outcome < params.outcomes or outcome == st.OUT_OF_TIME:
            parcels.fault[i] = st.UNKNOWN_OUTCOME

    return end


@lru_cache(maxsize=256)
def make_kernel(functions: KernelFunctions) -> Any:
    """Build `step_envs(params, surfaces, parcels, bodies, scratch, sensor_scratch, chosen)`.

    `chosen` (count,) holds indices of environments. If a chosen environment has the outcome
    STARTING, the kernel begins an episode. If the outcome is RUNNING, the kernel does one control
    period. The kernel returns the number of environments with a fault.
    """
    task_begin, task_observe, task_mirror = functions.begin, functions.observe, functions.mirror
    sensor_begin, sensor_read = functions.begin_sensor, functions.read_sensor
    straighten = functions.actuation.straighten
    obey_command = obeying(functions.part_of, functions.actuation.obey)
    run, end, show_more = _running(functions), _ending(functions), showing(functions)
    weighs = functions.weighs

    def step_envs(
        params: EnvParams,
        surfaces: SurfaceState,
        parcels: ParcelState,
        bodies: BodyTable,
        scratch: Scratch,
        sensor_scratch: Scratch,
        chosen: Integers,
    ) -> int:
        faults = 0
        for i in chosen:
            begins = parcels.outcome[i] == st.STARTING
            if not begins and parcels.outcome[i] != st.RUNNING:
                continue
            begin_period(parcels, i)
            if begins:
                straighten(params.acting, surfaces, i)
                parcels.clock[i] = 0.0
                parcels.steps[i] = 0
                parcels.outcome[i] = st.RUNNING
                parcels.reward[i] = 0.0
                for k in range(parcels.energy.shape[1]):
                    parcels.energy[i, k] = 0.0
                if weighs:
                    clear_loads(surfaces.load[i], 2)
            state = st.env_state(surfaces, parcels, bodies, i, i, params.elements)
            mirror = task_mirror(state)
            if begins:
                for k in range(state.terms.shape[0]):
                    state.terms[k] = 0.0
                st.read_truth(state)
                sensor_begin(params.sensor, state)
                task_begin(state)
            else:
                obey_command(params, surfaces, state, i, mirror)
                state = run(params, surfaces, parcels, bodies, scratch, sensor_scratch, i)
                end(params, parcels, state, i)
            sensor_read(params.sensor, state)
            task_observe(state)
            show_more(params, state, mirror)
            for k in range(state.observation.shape[0]):
                if not math.isfinite(state.observation[k]):
                    parcels.fault[i] = st.BAD_OBSERVATION
            faults += parcels.fault[i] != st.NO_FAULT
        return faults

    return compiled(step_envs, functions.label)
