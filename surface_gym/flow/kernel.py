"""Compiled kernel of streams: one control period of a surface with its parcels.

The order is: command, axes, entries, physics, exits, sensors, rewards, observation. The kernel
contains only the functions of the batch's task, sensor and kind of action.
"""

import math
from functools import lru_cache
from typing import Any, NamedTuple

from surface_gym import state as st
from surface_gym.compiler.jit import compiled, inlined
from surface_gym.core.kernel import (
    Actuation,
    EnvParams,
    Function,
    add_energy,
    add_loads,
    clear_loads,
)
from surface_gym.flow import state as fs
from surface_gym.flow.claims import assigning, obeying
from surface_gym.flow.entry import count_due, count_waiting, depart, entering, show_waiting
from surface_gym.flow.state import StreamParams, StreamState, StreamView, view_parcel, view_task
from surface_gym.layouts import ROLLING
from surface_gym.physics import types as ph
from surface_gym.physics.collision import World, WorldScratch, invalidate_world
from surface_gym.physics.contact_solver import step_world
from surface_gym.physics.contacts import invalidate_contacts
from surface_gym.physics.step import OFF_SURFACE
from surface_gym.physics.types import Bodies, Integers, Scratch
from surface_gym.physics.world_forces import is_among
from surface_gym.sensors.base import Physics
from surface_gym.state import BodyTable, ParcelState, SurfaceState
from surface_gym.tasks.base import STALL_SPEED


class StreamFunctions(NamedTuple):
    """Functions of task, sensor and kind of action for a kernel of streams."""

    label: str  # name of its files in the cache
    begin: Function  # task
    base_distance: Function
    has_room: Function
    has_departed: Function
    exit_taken: Function
    deliver: Function
    advance: Function
    may_jam: Function
    inform: Function
    reward: Function
    observe: Function
    observe_neighbour: Function
    observe_no_neighbour: Function
    begin_sensor: Function  # sensor
    update_sensor: Function
    read_sensor: Function
    watches: bool
    meters: bool  # whether energies are summed
    weighs: bool  # whether loads are computed
    part_of: Function  # kind of action
    commanded: Function
    actuation: Actuation


@inlined
def view_surface(
    params: EnvParams,
    stream_params: StreamParams,
    surfaces: SurfaceState,
    parcels: ParcelState,
    bodies: BodyTable,
    streams: StreamState,
    i: int,
) -> StreamView:
    """Return the view of surface i of a batch."""
    rows = streams.number.shape[1]
    slots = rows - stream_params.queue
    return StreamView(
        params, stream_params, surfaces, parcels, bodies, streams, i, i * rows, rows, slots
    )


@inlined
def begin_period(view: StreamView) -> None:
    """Clear the results of the last control period, and the rows of departed parcels."""
    parcels, streams, i = view.parcels, view.streams, view.i
    streams.fault[i] = st.NO_FAULT
    for k in range(streams.terms.shape[1]):
        streams.terms[i, k] = 0.0
    for k in range(view.rows):
        parcels.reward[view.first + k] = 0.0
        parcels.period[view.first + k] = 0.0
        if not streams.present[i, k]:
            streams.number[i, k] = fs.NOBODY


@inlined
def begin_episode(view: StreamView) -> None:
    """Let no module obey a parcel, and set all commanded axes to 90 deg, as on a conveyor."""
    streams, i = view.streams, view.i
    for row in range(streams.commanded.shape[1]):
        for column in range(streams.commanded.shape[2]):
            streams.commanded[i, row, column] = ROLLING
            streams.owner[i, row, column] = fs.NOBODY
    energy = view.parcels.energy
    for row in range(view.first, view.first + view.rows):
        for k in range(energy.shape[1]):
            energy[row, k] = 0.0
    streams.outcome[i] = st.RUNNING


APART = 0.2  # [s] a push after a longer break counts as a new touch
MEAN_OVER = 0.1  # [s] time constant of the exponential mean of forces


@inlined
def note_touches(view: StreamView, scratch: WorldScratch, pairs: int) -> None:
    """Record the force of every pair, and count new touches. `scratch.pair` has `pairs` pairs."""
    streams, memory, i, dt = view.streams, view.parcels.memory, view.i, view.params.timing.dt
    for k in range(pairs):
        a, b = scratch.pair[k, 0], scratch.pair[k, 1]
        since = streams.steps[i] - streams.touched_at[i, a, b]
        # A pair's rows are in the order of the table, so each pair has one form.
        force = streams.pressing[i, a, b] * math.exp(-dt * since / MEAN_OVER)
        force += scratch.impulse[k] / MEAN_OVER
        streams.pressing[i, a, b] = force
        streams.impulse[i] = max(streams.impulse[i], scratch.impulse[k])
        streams.squeeze[i] = max(streams.squeeze[i], force)
        if since > int(APART / dt):
            streams.tally[i, fs.TOUCHES] += 1
            streams.touches[i, streams.number[i, a]] += 1
            streams.touches[i, streams.number[i, b]] += 1
            memory[view.first + a, fs.TOUCHED] += 1.0
            memory[view.first + b, fs.TOUCHED] += 1.0
        streams.touched_at[i, a, b] = streams.steps[i]
        streams.touched_at[i, b, a] = streams.steps[i]


@inlined
def add_energies(view: StreamView, scratch: WorldScratch, pairs: int) -> None:
    """Add the work and heat [J] of a physics step to the energies of all parcels on the surface.

    The first `pairs` rows of `scratch.pair` are pairs of parcels that pushed each other. For these
    parcels, `scratch` holds the surface's friction after the push. The work of this friction is
    computed as if the friction acted during the whole step.
    """
    parcels, dt = view.parcels, view.params.timing.dt
    for slot in range(view.slots):
        if not view.streams.present[view.i, slot] or scratch.report[slot] >= OFF_SURFACE:
            continue
        row, before = view.first + slot, scratch.before[slot]
        mass = view.bodies.body[parcels.body[row], ph.MASS]
        if is_among(scratch, pairs, slot):
            mass *= dt / max(dt - scratch.since[slot], 1e-3 * dt)
        marks = scratch.marks[slot]
        contacts = ph.Contacts(scratch.floor[slot], marks[ph.ISOTROPICS], marks[ph.SUPPORTS])
        under = Scratch(scratch.tables[slot], marks)
        velocity = before[ph.VX], before[ph.VY], before[ph.OMEGA]
        add_energy(parcels, row, mass, dt, under, contacts, *velocity)


@inlined
def weigh_parcels(view: StreamView, grid: ph.Grid, scratch: WorldScratch) -> None:
    """Write the normal force [N] on every element under the parcels, at their present poses."""
    load = view.surfaces.load[view.i]
    clear_loads(load, 1)
    for slot in range(view.slots):
        if view.streams.present[view.i, slot]:
            row = view.first + slot
            parcel = view.parcels.body[row]
            body, mass = st.read_body(view.bodies, parcel), view.bodies.body[parcel, ph.MASS]
            under = Scratch(scratch.tables[slot], scratch.marks[slot])
            add_loads(grid, body, view.parcels.state[row], mass, under, load)


# Functions built below are cached, so that kernels with the same parts share their code.


@lru_cache(maxsize=64)
def _moving(
    has_departed: Function,
    task_exit: Function,
    deliver: Function,
    advance: Function,
    sensor_update: Function,
    watches: bool,
    turn: Function,
    turns: bool,
    meters: bool,
    weighs: bool,
) -> Any:
    """Build `move(view, grid, world, physics, scratch)`, one physics step of a surface.

    The arguments of `_moving` are fields of `StreamFunctions` or of `StreamFunctions.actuation`.
    The argument `task_exit` is the field `exit_taken`.
    """

    @inlined
    def follow(view: StreamView, slot: int, physics: Physics) -> None:
        """If the parcel has departed, remove the parcel. Otherwise update its sensor state."""
        streams, i = view.streams, view.i
        state = view_parcel(view, slot)
        surface = view_task(view)
        if has_departed(surface, state):
            st.read_truth(state)
            taken = task_exit(surface, state)
            results = streams.results[i, streams.number[i, slot]]
            depart(view, slot, taken, deliver(surface, state, taken, results))
        elif watches:
            st.read_truth(state)
            sensor_update(view.params.sensor, state, physics)

    @inlined
    def move(
        view: StreamView, grid: ph.Grid, world: World, physics: Physics, scratch: WorldScratch
    ) -> None:
        parcels, streams, i, dt = view.parcels, view.streams, view.i, view.params.timing.dt
        if weighs:
            weigh_parcels(view, grid, scratch)
        if turns:
            if turn(view.params.acting, view.surfaces, i, view.bodies.zone[0]):
                invalidate_world(scratch)
            invalidate_contacts(physics.scratch)
        pairs = step_world(grid, world, view.stream_params.touching, scratch, dt)
        streams.clock[i] += dt
        streams.steps[i] += 1
        note_touches(view, scratch, pairs)
        if meters:
            add_energies(view, scratch, pairs)
        advance(view_task(view), dt)
        for slot in range(view.slots):
            if streams.present[i, slot]:
                row = view.first + slot
                on_surface = scratch.report[slot] < OFF_SURFACE
                parcels.on_surface[row] = on_surface
                parcels.on_rotors[row] = on_surface and scratch.rotors[slot] > 0
                parcels.clock[row] += dt
                parcels.steps[row] += 1
                parcels.period[row] += dt
                follow(view, slot, physics)
        waiting = count_waiting(streams, i)
        streams.waited[i] += dt * waiting
        waiting_term = streams.terms.shape[1] - 2
        streams.terms[i, waiting_term] += view.stream_params.waiting_reward * dt * waiting

    return move


@lru_cache(maxsize=64)
def _running(move: Function, let_in: Function) -> Any:
    """Build `run(view, begins, scratch, sensor's scratch)`: all physics steps of a control period.

    Parcels depart and enter during these steps. If `begins` is true, there are no steps, and one
    parcel may enter.
    """

    @inlined
    def run(view: StreamView, begins: bool, scratch: WorldScratch, sensor_scratch: Scratch) -> None:
        params, bodies, streams, i = view.params, view.bodies, view.streams, view.i
        invalidate_world(scratch)
        invalidate_contacts(sensor_scratch)
        physics = Physics(params.assumed, params.stiffness, sensor_scratch, params.timing.dt)
        grid = st.read_grid(view.surfaces, bodies, i, 0, params.elements, params.friction)
        rows = slice(view.first, view.first + view.rows)
        world = World(
            view.parcels.state[rows],
            streams.present[i],
            view.parcels.body[rows],
            Bodies(bodies.body, bodies.edges, bodies.corners),
        )
        gated = view.stream_params.queue > 0
        gate = view.surfaces.command.shape[1] - 1
        opens = int(view.surfaces.command[i, gate]) if gated else 1
        entered = False
        # Parcels may enter at a start (step 0) and after every step.
        for step in range(0 if begins else 1, 1 if begins else params.timing.steps + 1):
            if not begins:
                move(view, grid, world, physics, scratch)
            count_due(streams, i)
            # A gate opens at one physics step of the period for one parcel, or not at all.
            if gated and (entered or opens == 0 or step < opens):
                continue
            if let_in(view):
                entered = True

    return run


@lru_cache(maxsize=64)
def _earning(task_reward: Function, sensor_read: Function) -> Any:
    """Build `earn(view) -> bool`, which computes the parcels' rewards and reads the sensors.

    `earn` returns True if the line has parcels, and all these parcels are below STALL_SPEED.
    """

    @inlined
    def earn(view: StreamView) -> bool:
        parcels, streams, i = view.parcels, view.streams, view.i
        occupied = False
        moves = False
        for k in range(view.slots):
            if streams.number[i, k] == fs.NOBODY:
                continue
            state = view_parcel(view, k)
            st.read_truth(state)
            task_reward(state, parcels.outcome[view.first + k])
            state.memory[fs.TOUCHED] = 0.0
            reward = 0.0
            for term in range(state.terms.shape[0]):
                reward += state.terms[term]
                streams.terms[i, term] += state.terms[term]
            parcels.reward[view.first + k] = reward
            if streams.present[i, k]:
                occupied = True
                moves |= not st.is_slower(state, STALL_SPEED)
                sensor_read(view.params.sensor, state)
        return occupied and not moves

    return earn


@inlined
def end(view: StreamView, stands: bool) -> None:
    """End the episode after a jam or at the time limit, and add up the terms of the reward.

    `stands` is true if the line has parcels, no parcel moves, and the task can end by a jam.
    """
    streams, i, timing = view.streams, view.i, view.params.timing
    if stands:
        streams.still[i] += timing.dt * timing.steps
    else:
        streams.still[i] = 0.0
    terms = streams.terms.shape[1]
    if streams.still[i] >= view.stream_params.patience:
        streams.outcome[i] = fs.JAM
        streams.terms[i, terms - 1] = view.stream_params.jam_reward
    elif streams.clock[i] >= view.stream_params.duration - 0.5 * timing.dt:
        streams.outcome[i] = st.OUT_OF_TIME
    reward = 0.0
    for k in range(terms):
        reward += streams.terms[i, k]
    streams.reward[i] = reward
    if not math.isfinite(reward):
        streams.fault[i] = st.BAD_REWARD
    if view.stream_params.queue > 0:
        show_waiting(view)
        view.parcels.reward[view.first + view.slots] = streams.terms[i, terms - 2]


@inlined
def _nearest(view: StreamView, slot: int, ahead: bool) -> int:
    """Return the row of the parcel next to row `slot`, ahead or (if `ahead` is false) behind.

    If there is no parcel, return NOBODY. Parcels are compared by sensed x. At equal x, the earlier
    arrival is ahead.
    """
    streams, sensed, i, first = view.streams, view.parcels.sensed, view.i, view.first
    x = sensed[first + slot, ph.X]
    nearest = fs.NOBODY
    least = 0.0
    for k in range(view.rows):
        if not streams.present[i, k] or k == slot:
            continue
        apart = sensed[first + k, ph.X] - x
        is_ahead = apart > 0.0 or (apart == 0.0 and streams.number[i, k] < streams.number[i, slot])
        if is_ahead == ahead and (nearest == fs.NOBODY or abs(apart) < least):
            nearest = k
            least = abs(apart)
    return nearest


@lru_cache(maxsize=64)
def _observing(
    inform: Function, observe: Function, observe_neighbour: Function, observe_no_neighbour: Function
) -> Any:
    """Build `observe_parcels(view)`, which writes the observation: a table, one row per parcel."""

    @inlined
    def observe_neighbours(view: StreamView, slot: int) -> None:
        """Write the features of the next parcels ahead and behind."""
        state = view_parcel(view, slot)
        x, theta = state.sensed[ph.X], state.sensed[ph.THETA]
        front = x + st.reach_along(state, theta, 1.0, 0.0)
        rear = x - st.reach_along(state, theta, -1.0, 0.0)
        for way in range(2):
            ahead = way == 1
            nearest = _nearest(view, slot, ahead)
            if nearest == fs.NOBODY:
                observe_no_neighbour(state, ahead)
                continue
            other = view_parcel(view, nearest)
            other_x, other_theta = other.sensed[ph.X], other.sensed[ph.THETA]
            if ahead:
                gap = other_x - st.reach_along(other, other_theta, -1.0, 0.0) - front
            else:
                gap = rear - other_x - st.reach_along(other, other_theta, 1.0, 0.0)
            observe_neighbour(state, other, gap, ahead)

    @inlined
    def observe_parcels(view: StreamView) -> None:
        streams, i = view.streams, view.i
        surface = view_task(view)
        for slot in range(view.rows):
            state = view_parcel(view, slot)
            waits = slot >= view.slots and streams.number[i, slot] != fs.NOBODY
            if not (streams.present[i, slot] or waits):
                for feature in range(state.observation.shape[0]):
                    state.observation[feature] = 0.0
                continue
            inform(surface, state)
            observe(state, waits)
            observe_neighbours(view, slot)
        for slot in range(view.rows):
            observation = view.parcels.observation[view.first + slot]
            for feature in range(observation.shape[0]):
                if not math.isfinite(observation[feature]):
                    streams.fault[i] = st.BAD_OBSERVATION

    return observe_parcels


@lru_cache(maxsize=64)
def make_stream_kernel(functions: StreamFunctions) -> Any:
    """Build `step_streams(params, stream_params, *arrays, scratch, sensor's scratch, chosen)`.

    `chosen` (count,) are indices of surfaces. If an episode was placed on a chosen surface, the
    kernel begins this episode. A running episode moves by one control period, and an ended episode
    does not change. The kernel returns the number of surfaces whose reward or observation is not
    finite.
    """
    f = functions
    straighten, turn, turns = f.actuation.straighten, f.actuation.turn, f.actuation.turns
    obey_command = obeying(f.base_distance, f.part_of, f.commanded, f.actuation.obey)
    let_in = entering(f.has_room, f.begin, f.begin_sensor)
    move = _moving(
        f.has_departed, f.exit_taken, f.deliver, f.advance, f.update_sensor, f.watches, turn, turns,
        f.meters, f.weighs,
    )  # fmt: skip
    run = _running(move, let_in)
    earn = _earning(f.reward, f.read_sensor)
    observe_parcels = _observing(f.inform, f.observe, f.observe_neighbour, f.observe_no_neighbour)
    may_jam, weighs = f.may_jam, f.weighs

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
        for i in chosen:
            begins = streams.outcome[i] == st.STARTING
            if not begins and streams.outcome[i] != st.RUNNING:
                continue
            view = view_surface(params, stream_params, surfaces, parcels, bodies, streams, i)
            begin_period(view)
            if begins:
                straighten(params.acting, surfaces, i)
                begin_episode(view)
                if weighs:
                    clear_loads(surfaces.load[i], 2)
            else:
                obey_command(view)
            run(view, begins, scratch, sensor_scratch)
            stands = earn(view)
            end(view, stands and not begins and may_jam(view_task(view)))
            observe_parcels(view)
            faults += streams.fault[i] != st.NO_FAULT
        return faults

    return compiled(step_streams, functions.label)


@lru_cache(maxsize=64)
def make_assigning_kernel(functions: StreamFunctions) -> Any:
    """Build `assign_streams`, which writes the parcel that each module obeys in the next period.

    `assign_streams` takes the arguments of `step_streams`, but does no step and returns 0.
    """
    assign_modules = assigning(functions.base_distance)

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
            assign_modules(
                view_surface(params, stream_params, surfaces, parcels, bodies, streams, i)
            )
        return 0

    return compiled(assign_streams, functions.label)
