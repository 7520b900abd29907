"""The compiled code of streams: one control period of a surface with all the parcels on it.

Command, axes, entries, physics, exits, sensors, rewards, observation. Only the functions of the
batch's own task, sensor and kind of action are compiled into it.
"""

import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from surface_gym import state as st
from surface_gym.compiler.jit import compiled, inlined
from surface_gym.core.actions import Acting
from surface_gym.core.kernel import Actuation, EnvParams, Function
from surface_gym.flow import state as fs
from surface_gym.flow.entry import (
    changes_within,
    count_due,
    count_slots,
    count_waiting,
    entering,
    leave,
    move_take_away,
    show_waiting,
    takes_away,
)
from surface_gym.flow.state import StreamParams, StreamState
from surface_gym.flow.task import HALVES
from surface_gym.layouts import ROLLING
from surface_gym.physics import types as ph
from surface_gym.physics.collision import World, WorldScratch, invalidate_world
from surface_gym.physics.contact_solver import step_world
from surface_gym.physics.contacts import invalidate_contacts
from surface_gym.physics.step import OFF_SURFACE
from surface_gym.physics.types import Array, Bodies, Integers, Places, Scratch
from surface_gym.sensors.base import Physics
from surface_gym.state import BodyTable, EnvState, ParcelState, SurfaceState
from surface_gym.tasks.base import STALL_SPEED

NEARER = 1e-6  # [s/m^2] of two that a module bears at once, the one with the nearer centre wins
CLOSING = 1.0  # [m/s] at which a base counts as nearing a module that lies outside it


@inlined
def free_modules(owner: Places, soonest: Array, state: EnvState) -> None:
    """Let every module of the zone obey no parcel, so that any may claim it."""
    zone = state.zone
    for row in range(zone[st.FIRST_ROW], zone[st.FIRST_ROW] + zone[st.ROWS]):
        for column in range(zone[st.FIRST_COLUMN], zone[st.FIRST_COLUMN] + zone[st.COLUMNS]):
            owner[row, column] = fs.NOBODY
            soonest[row, column] = np.inf


@inlined
def _until(point: float, low: float, high: float, speed: float) -> float:
    """Return the time [s] until an interval moving at a speed [m/s] holds a point, or infinity."""
    if point > high:
        return (point - high) / speed if speed > 0.0 else np.inf
    if point < low:
        return (low - point) / -speed if speed < 0.0 else np.inf
    return 0.0


@inlined
def _after(point: float, low: float, high: float, speed: float) -> float:
    """[s] until an interval that moves at a speed [m/s] has passed a point; infinite if never."""
    if speed > 0.0:
        return (point - low) / speed
    return (high - point) / -speed if speed < 0.0 else np.inf


def claiming(outside: Function) -> Any:
    """Build `claim_modules`, by the task's `outside(state, x, y)`."""

    @inlined
    def claim_modules(
        owner: Places, soonest: Array, state: EnvState, slot: int, ahead: float
    ) -> None:
        """Let the parcel in a slot claim every module of the zone that bears it, or that it will be
        the first to bear on within `ahead` seconds, by its box as it is sensed and moves on.
        """
        sensed = state.sensed
        theta = sensed[ph.THETA]
        vx, vy = sensed[ph.VX], sensed[ph.VY]
        front = sensed[ph.X] + st.reach_along(state, theta, 1.0, 0.0)
        rear = sensed[ph.X] - st.reach_along(state, theta, -1.0, 0.0)
        left = sensed[ph.Y] + st.reach_along(state, theta, 0.0, 1.0)
        right = sensed[ph.Y] - st.reach_along(state, theta, 0.0, -1.0)
        zone, elements = state.zone, state.elements
        first_row, first_column = zone[st.FIRST_ROW], zone[st.FIRST_COLUMN]
        x0, y0 = elements.x0, elements.y0
        low_x = (rear + min(0.0, vx * ahead) - x0) / elements.pitch_x
        high_x = (front + max(0.0, vx * ahead) - x0) / elements.pitch_x
        low_y = (right + min(0.0, vy * ahead) - y0) / elements.pitch_y
        high_y = (left + max(0.0, vy * ahead) - y0) / elements.pitch_y
        if not (abs(low_x) < 1e6 and abs(high_x) < 1e6 and abs(low_y) < 1e6 and abs(high_y) < 1e6):
            return  # an estimate that has lost the parcel
        for row in range(
            max(first_row, math.ceil(low_y)), min(first_row + zone[st.ROWS], math.floor(high_y) + 1)
        ):
            y = y0 + elements.pitch_y * row
            until_y = _until(y, right, left, vy)
            after_y = _after(y, right, left, vy)
            for column in range(
                max(first_column, math.ceil(low_x)),
                min(first_column + zone[st.COLUMNS], math.floor(high_x) + 1),
            ):
                x = x0 + elements.pitch_x * column
                until = max(until_y, _until(x, rear, front, vx))
                if until > min(ahead, after_y, _after(x, rear, front, vx)):
                    continue
                until += NEARER * ((x - sensed[ph.X]) ** 2 + (y - sensed[ph.Y]) ** 2)
                until += outside(state, x, y) / CLOSING
                if until < soonest[row, column]:
                    soonest[row, column] = until
                    owner[row, column] = slot

    return claim_modules


# Which part of the command a module follows; negative if none.


@inlined
def part_of_module(
    state: EnvState, parcels: ParcelState, owner: Places, rows: int, row: int, column: int
) -> int:
    """Let each module follow a part of its own."""
    return (
        (row - state.zone[st.FIRST_ROW]) * state.zone[st.COLUMNS]
        + column
        - state.zone[st.FIRST_COLUMN]
    )


@inlined
def part_of_owner(
    state: EnvState, parcels: ParcelState, owner: Places, rows: int, row: int, column: int
) -> int:
    """Let a module follow the half of the parcel that it obeys; without one it stays as it is.

    `rows` is the first row of the surface's parcels in `parcels`.
    """
    slot = owner[row, column]
    if slot < 0:
        return -1
    x = state.elements.x0 + state.elements.pitch_x * column
    return HALVES * slot + (1 if x < parcels.sensed[rows + slot, ph.X] else 0)


# The axis angle [rad] that a part of the command sets.


@inlined
def commanded_choice(acting: Acting, surfaces: SurfaceState, surface: int, part: int) -> float:
    """Get the angle of the orientation that the part counts."""
    return acting.orientations[surfaces.command[surface, part]]


@inlined
def commanded_angle(acting: Acting, surfaces: SurfaceState, surface: int, part: int) -> float:
    """Get the angle that the part is."""
    return surfaces.command[surface, part]


@inlined
def is_turn(angle: float, before: float) -> bool:
    """Whether an axis has to turn from one angle to the other; one turned by pi is the same."""
    apart = angle - before
    return abs(apart - math.pi * math.floor(apart / math.pi + 0.5)) > 1e-9


APART = 0.2  # [s] two that have not pushed each other for so long touch anew
MEAN_OVER = 0.1  # [s] over which the force between two is a mean, weighted exponentially


@inlined
def note_touches(
    parcels: ParcelState,
    streams: StreamState,
    scratch: WorldScratch,
    i: int,
    pairs: int,
    apart: int,
    dt: float,
) -> None:
    """Count the pairs of parcels that begin to touch, and note how hard they press."""
    rows = streams.number.shape[1]
    for k in range(pairs):
        a, b = scratch.pair[k, 0], scratch.pair[k, 1]
        since = streams.steps[i] - streams.touched_at[i, a, b]
        # Rows' order in a pair is theirs in the table: the pair is always the same way round.
        force = streams.pressing[i, a, b] * math.exp(-dt * since / MEAN_OVER)
        force += scratch.impulse[k] / MEAN_OVER
        streams.pressing[i, a, b] = force
        streams.impulse[i] = max(streams.impulse[i], scratch.impulse[k])
        streams.squeeze[i] = max(streams.squeeze[i], force)
        if since > apart:
            streams.tally[i, fs.TOUCHES] += 1
            streams.touches[i, streams.number[i, a]] += 1
            streams.touches[i, streams.number[i, b]] += 1
            parcels.memory[i * rows + a, fs.TOUCHED] += 1.0
            parcels.memory[i * rows + b, fs.TOUCHED] += 1.0
        streams.touched_at[i, a, b] = streams.steps[i]
        streams.touched_at[i, b, a] = streams.steps[i]


@inlined
def _nearest(streams: StreamState, parcels: ParcelState, i: int, slot: int, ahead: bool) -> int:
    """Find the slot of the nearest parcel ahead along x, or behind, as sensed; or NOBODY.

    Of two at the same x the one that came first is ahead.
    """
    first = i * streams.number.shape[1]
    x = parcels.sensed[first + slot, ph.X]
    nearest = fs.NOBODY
    least = 0.0
    for k in range(streams.number.shape[1]):
        if not streams.present[i, k] or k == slot:
            continue
        apart = parcels.sensed[first + k, ph.X] - x
        is_ahead = apart > 0.0 or (apart == 0.0 and streams.number[i, k] < streams.number[i, slot])
        if is_ahead == ahead and (nearest == fs.NOBODY or abs(apart) < least):
            nearest = k
            least = abs(apart)
    return nearest


class StreamFunctions(NamedTuple):
    """Functions that a kernel is built from."""

    label: str  # of its files in the cache
    begin: Function  # the task's
    outside: Function
    has_room: Function
    has_departed: Function
    exit_taken: Function
    deliver: Function
    inform: Function
    reward: Function
    observe: Function
    observe_neighbour: Function
    observe_no_neighbour: Function
    begin_sensor: Function  # the sensor's
    update_sensor: Function
    read_sensor: Function
    watches: bool
    part_of: Function  # the kind of action's
    commanded: Function
    actuation: Actuation


def _assigning(functions: StreamFunctions) -> Any:
    """Build `assign_modules`, which writes whom each of surface i's modules obeys."""
    claim_modules = claiming(functions.outside)

    @inlined
    def assign_modules(
        params: EnvParams,
        stream_params: StreamParams,
        surfaces: SurfaceState,
        parcels: ParcelState,
        bodies: BodyTable,
        streams: StreamState,
        i: int,
    ) -> None:
        rows = streams.number.shape[1]
        first = i * rows
        owner, soonest = streams.owner[i], streams.soonest[i]
        free_modules(
            owner, soonest, st.env_state(surfaces, parcels, bodies, i, first, params.elements)
        )
        for k in range(rows):
            if streams.present[i, k]:
                parcel = st.env_state(surfaces, parcels, bodies, i, first + k, params.elements)
                claim_modules(owner, soonest, parcel, k, stream_params.ahead)

    return assign_modules


def _obeying(functions: StreamFunctions) -> Any:
    """Build `obey_command`, which turns surface i's modules by its command, and counts them."""
    assign_modules = _assigning(functions)
    part_of, commanded, obey = functions.part_of, functions.commanded, functions.actuation.obey

    @inlined
    def obey_command(
        params: EnvParams,
        stream_params: StreamParams,
        surfaces: SurfaceState,
        parcels: ParcelState,
        bodies: BodyTable,
        streams: StreamState,
        i: int,
    ) -> None:
        rows = streams.number.shape[1]
        first = i * rows
        state = st.env_state(surfaces, parcels, bodies, i, first, params.elements)
        owner = streams.owner[i]
        assign_modules(params, stream_params, surfaces, parcels, bodies, streams, i)
        obeys = streams.obeys[i if streams.obeys.shape[0] > 1 else 0]
        zone = state.zone
        for row in range(zone[st.FIRST_ROW], zone[st.FIRST_ROW] + zone[st.ROWS]):
            for column in range(zone[st.FIRST_COLUMN], zone[st.FIRST_COLUMN] + zone[st.COLUMNS]):
                part = part_of(state, parcels, owner, first, row, column)
                if part < 0 or not obeys[row, column]:
                    continue
                angle = commanded(params.acting, surfaces, i, part)
                if is_turn(angle, streams.commanded[i, row, column]):
                    streams.tally[i, fs.TURNS] += 1
                streams.commanded[i, row, column] = angle
                obey(params.acting, surfaces, i, row, column, part)

    return obey_command


def _observing(functions: StreamFunctions) -> Any:
    """Build `observe_parcels`, which writes surface i's table: a row a parcel."""
    observe, observe_neighbour = functions.observe, functions.observe_neighbour
    inform, observe_no_neighbour = functions.inform, functions.observe_no_neighbour

    @inlined
    def observe_parcels(
        params: EnvParams,
        stream_params: StreamParams,
        surfaces: SurfaceState,
        parcels: ParcelState,
        bodies: BodyTable,
        streams: StreamState,
        i: int,
    ) -> None:
        rows = streams.number.shape[1]
        slots = count_slots(stream_params, streams)
        first = i * rows
        runs = takes_away(streams, i)
        stops = runs and changes_within(streams, i, stream_params.notice)
        for k in range(rows):
            state = st.env_state(surfaces, parcels, bodies, i, first + k, params.elements)
            waits = k >= slots and streams.number[i, k] != fs.NOBODY
            if not (streams.present[i, k] or waits):
                for feature in range(state.observation.shape[0]):
                    state.observation[feature] = 0.0
                continue
            inform(stream_params, state, streams.passed[i], streams.belt[i], runs, stops)
            observe(state, waits)
            x, theta = state.sensed[ph.X], state.sensed[ph.THETA]
            front = x + st.reach_along(state, theta, 1.0, 0.0)
            rear = x - st.reach_along(state, theta, -1.0, 0.0)
            for way in range(2):
                ahead = way == 1
                slot = _nearest(streams, parcels, i, k, ahead)
                if slot == fs.NOBODY:
                    observe_no_neighbour(state, ahead)
                    continue
                other = st.env_state(surfaces, parcels, bodies, i, first + slot, params.elements)
                other_x, other_theta = other.sensed[ph.X], other.sensed[ph.THETA]
                if ahead:
                    gap = other_x - st.reach_along(other, other_theta, -1.0, 0.0) - front
                else:
                    gap = rear - other_x - st.reach_along(other, other_theta, 1.0, 0.0)
                observe_neighbour(state, other, gap, ahead)

    return observe_parcels


@lru_cache(maxsize=64)
def make_stream_kernel(functions: StreamFunctions) -> Any:
    """Build `step_streams(params, stream_params, *arrays, scratch, sensor's scratch, chosen)`.

    Of the chosen surfaces (count,) those placed begin, those that run are stepped by one control
    period, and those that have ended stay. It returns how many have a fault.
    """
    task_begin, task_reward, task_exit = functions.begin, functions.reward, functions.exit_taken
    has_departed, deliver, let_in = (
        functions.has_departed,
        functions.deliver,
        entering(functions.has_room),
    )
    sensor_begin, sensor_update = functions.begin_sensor, functions.update_sensor
    sensor_read, watches = functions.read_sensor, functions.watches
    _, turn, straighten, turns = functions.actuation
    obey_command, observe_parcels = _obeying(functions), _observing(functions)

    def step_streams(
        params: EnvParams,
        stream_params: StreamParams,
        surfaces: SurfaceState,
        parcels: ParcelState,
        bodies: BodyTable,
        streams: StreamState,
        scratch: WorldScratch,
        sensor_scratch: Scratch,
        chosen: Integers,
    ) -> int:
        faults = 0
        dt = params.timing.dt
        apart = int(APART / dt)
        rows = streams.number.shape[1]
        slots = count_slots(stream_params, streams)
        gate = surfaces.command.shape[1] - 1
        gated = stream_params.queue > 0
        jam_term = streams.terms.shape[1] - 1
        waiting_term = jam_term - 1
        physics = Physics(params.assumed, params.stiffness, sensor_scratch, dt)
        shapes = Bodies(bodies.body, bodies.edges, bodies.corners)
        for i in chosen:
            first = i * rows
            begins = streams.outcome[i] == st.STARTING
            if begins:
                straighten(params.acting, surfaces, i)
                for row in range(streams.commanded.shape[1]):
                    for column in range(streams.commanded.shape[2]):
                        streams.commanded[i, row, column] = ROLLING
                        streams.owner[i, row, column] = fs.NOBODY
                streams.outcome[i] = st.RUNNING
            elif streams.outcome[i] != st.RUNNING:
                continue
            streams.fault[i] = st.NO_FAULT
            for k in range(streams.terms.shape[1]):
                streams.terms[i, k] = 0.0
            for k in range(rows):
                parcels.reward[first + k] = 0.0
                parcels.period[first + k] = 0.0
                if not streams.present[i, k]:
                    streams.number[i, k] = fs.NOBODY
            if not begins:
                obey_command(params, stream_params, surfaces, parcels, bodies, streams, i)
            invalidate_world(scratch)
            invalidate_contacts(sensor_scratch)
            grid = st.read_grid(surfaces, bodies, i, 0, params.elements, params.friction)
            world = World(
                parcels.state[first : first + rows],
                streams.present[i],
                parcels.body[first : first + rows],
                shapes,
            )
            zone = bodies.zone[0]
            opens = int(surfaces.command[i, gate]) if gated else 1
            entered = False
            # Parcels may enter at a start, which is step 0 alone, and after every step.
            for step in range(0 if begins else 1, 1 if begins else params.timing.steps + 1):
                if not begins:
                    if turns:
                        turn(params.acting, surfaces, i, zone)
                        invalidate_world(scratch)
                        invalidate_contacts(sensor_scratch)
                    pairs = step_world(grid, world, stream_params.touching, scratch, dt)
                    streams.clock[i] += dt
                    streams.steps[i] += 1
                    note_touches(parcels, streams, scratch, i, pairs, apart, dt)
                    move_take_away(stream_params, streams, i, dt)
                    for k in range(slots):
                        if not streams.present[i, k]:
                            continue
                        row = first + k
                        on_surface = scratch.report[k] < OFF_SURFACE
                        parcels.on_surface[row] = on_surface
                        parcels.on_rotors[row] = on_surface and scratch.rotors[k] > 0
                        parcels.clock[row] += dt
                        parcels.steps[row] += 1
                        parcels.period[row] += dt
                        state = st.env_state(surfaces, parcels, bodies, i, row, params.elements)
                        if has_departed(stream_params, state):
                            st.read_truth(state)
                            taken = task_exit(stream_params, state)
                            correct, gap, misalignment = deliver(
                                stream_params, state, taken, streams.passed[i, max(taken, 0)],
                                streams.belt[i], takes_away(streams, i),
                            )  # fmt: skip
                            leave(streams, parcels, i, k, taken, correct, gap, misalignment)
                        elif watches:
                            st.read_truth(state)
                            sensor_update(params.sensor, state, physics)
                    waiting = count_waiting(streams, i)
                    streams.waited[i] += dt * waiting
                    streams.terms[i, waiting_term] += stream_params.waiting_reward * dt * waiting
                count_due(streams, i)
                # A gate opens at a physics step of the period, for one parcel; or not at all.
                if gated and (entered or opens == 0 or step < opens):
                    continue
                slot = let_in(params, stream_params, surfaces, parcels, bodies, streams, i)
                if slot != fs.NOBODY:
                    entered = True
                    state = st.env_state(
                        surfaces, parcels, bodies, i, first + slot, params.elements
                    )
                    state.memory[fs.TOUCHED] = 0.0
                    task_begin(state)
                    sensor_begin(params.sensor, state)
            occupied = False
            moves = False
            for k in range(slots):
                if streams.number[i, k] == fs.NOBODY:
                    continue
                state = st.env_state(surfaces, parcels, bodies, i, first + k, params.elements)
                st.read_truth(state)
                task_reward(state, parcels.outcome[first + k])
                state.memory[fs.TOUCHED] = 0.0
                reward = 0.0
                for term in range(state.terms.shape[0]):
                    reward += state.terms[term]
                    streams.terms[i, term] += state.terms[term]
                parcels.reward[first + k] = reward
                if streams.present[i, k]:
                    occupied = True
                    moves |= not st.is_slower(state, STALL_SPEED)
                    sensor_read(params.sensor, state)
            if occupied and not moves and not begins and takes_away(streams, i):
                streams.still[i] += dt * params.timing.steps
            else:
                streams.still[i] = 0.0
            if streams.still[i] >= stream_params.patience:
                streams.outcome[i] = fs.JAM
                streams.terms[i, jam_term] = stream_params.jam_reward
            elif streams.clock[i] >= stream_params.duration - 0.5 * dt:
                streams.outcome[i] = st.OUT_OF_TIME
            reward = 0.0
            for k in range(streams.terms.shape[1]):
                reward += streams.terms[i, k]
            streams.reward[i] = reward
            if not math.isfinite(reward):
                streams.fault[i] = st.BAD_REWARD
            if gated:
                show_waiting(params, stream_params, surfaces, parcels, bodies, streams, i)
                parcels.reward[first + slots] = streams.terms[i, waiting_term]
            observe_parcels(params, stream_params, surfaces, parcels, bodies, streams, i)
            for k in range(rows):
                for feature in range(parcels.observation.shape[1]):
                    if not math.isfinite(parcels.observation[first + k, feature]):
                        streams.fault[i] = st.BAD_OBSERVATION
            faults += streams.fault[i] != st.NO_FAULT
        return faults

    return compiled(step_streams, functions.label)


@lru_cache(maxsize=64)
def make_assigning_kernel(functions: StreamFunctions) -> Any:
    """Build `assign_streams`, which takes what `step_streams` takes, steps nothing, and writes whom
    the modules of the chosen surfaces (count,) obey in the next control period. It returns 0.
    """
    assign_modules = _assigning(functions)

    def assign_streams(
        params: EnvParams,
        stream_params: StreamParams,
        surfaces: SurfaceState,
        parcels: ParcelState,
        bodies: BodyTable,
        streams: StreamState,
        scratch: WorldScratch,
        sensor_scratch: Scratch,
        chosen: Integers,
    ) -> int:
        for i in chosen:
            assign_modules(params, stream_params, surfaces, parcels, bodies, streams, i)
        return 0

    return compiled(assign_streams, functions.label)
