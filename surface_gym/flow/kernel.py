"""A batch of flows' compiled code: one control period of a surface with all the parcels on it.

Command, axes, entries, physics, exits, sensors, rewards: every face of a flow calls this.
"""

import math
from functools import lru_cache
from typing import Any, NamedTuple

from surface_gym.core.kernel import Actuation, EnvParams, Function
from surface_gym.flow.claims import claim_modules, free_modules
from surface_gym.flow.entering import count_due, let_in, places_of, show_next
from surface_gym.flow.leaving import exit_taken, leave
from surface_gym.flow.memory import (
    JAM,
    NOBODY,
    TURNS,
    FlowRules,
    Flows,
)
from surface_gym.flow.obeying import is_turn
from surface_gym.flow.rewards import JAM_REWARD, JAMMED, WAITING, WAITING_REWARD, reward_parcel
from surface_gym.flow.seeing import show_parcels
from surface_gym.flow.touches import APART, note_touches
from surface_gym.layouts import ROLLING
from surface_gym.physics.collision import World, WorldScratch, invalidate_world
from surface_gym.physics.contact_solver import step_world
from surface_gym.physics.contacts import invalidate_contacts
from surface_gym.physics.jit import compiled, inlined
from surface_gym.physics.step import OFF_SURFACE
from surface_gym.physics.types import Bodies, Integers, Scratch
from surface_gym.sensors.base import Physics
from surface_gym.state import (
    BAD_OBSERVATION,
    COLUMNS,
    FIRST_COLUMN,
    FIRST_ROW,
    NO_FAULT,
    OUT_OF_TIME,
    ROWS,
    RUNNING,
    STARTING,
    BodyTable,
    ParcelState,
    SurfaceState,
    env_state,
    is_slower,
    read_grid,
    read_truth,
)
from surface_gym.tasks.line import STALL_SPEED


class FlowFunctions(NamedTuple):
    """What a kernel is built from."""

    label: str  # of its files in the cache
    begin_sensor: Function  # the sensor's
    update_sensor: Function
    read_sensor: Function
    watches: bool
    part_of: Function  # the kind of action's
    told: Function
    actuation: Actuation


@lru_cache(maxsize=64)
def make_flow_kernel(functions: FlowFunctions) -> Any:
    """Build `move_flows(rules, flow_rules, surfaces, lanes, sites, flows, scratch, sensor's
    scratch, chosen)`.

    Of the chosen surfaces (count,) those placed begin, those that run move over one control
    period, and those that have ended stay. It returns how many something has gone wrong on.
    """
    sensor_begin, sensor_update = functions.begin_sensor, functions.update_sensor
    sensor_read, watches = functions.read_sensor, functions.watches
    part_of, told = functions.part_of, functions.told
    obey, turn, straighten, turns = functions.actuation

    @inlined
    def obey_command(
        rules: EnvParams,
        flow_rules: FlowRules,
        surfaces: SurfaceState,
        lanes: ParcelState,
        sites: BodyTable,
        flows: Flows,
        i: int,
    ) -> None:
        """Turn what the command turns, and count it."""
        rows = flows.number.shape[1]
        first = i * rows
        lane = env_state(surfaces, lanes, sites, i, first, rules.elements)
        owner, soonest = flows.owner[i], flows.soonest[i]
        free_modules(owner, soonest, lane)
        for k in range(rows):
            if flows.present[i, k]:
                parcel = env_state(surfaces, lanes, sites, i, first + k, rules.elements)
                claim_modules(owner, soonest, parcel, k, flow_rules.ahead)
        obeys = flows.obeys[i if flows.obeys.shape[0] > 1 else 0]
        zone = lane.zone
        for row in range(zone[FIRST_ROW], zone[FIRST_ROW] + zone[ROWS]):
            for column in range(zone[FIRST_COLUMN], zone[FIRST_COLUMN] + zone[COLUMNS]):
                part = part_of(lane, lanes, owner, first, row, column)
                if part < 0 or not obeys[row, column]:
                    continue
                angle = told(rules.acting, surfaces, i, part)
                if is_turn(angle, flows.told[i, row, column]):
                    flows.tally[i, TURNS] += 1
                flows.told[i, row, column] = angle
                obey(rules.acting, surfaces, i, row, column, part)

    def move_flows(
        rules: EnvParams,
        flow_rules: FlowRules,
        surfaces: SurfaceState,
        lanes: ParcelState,
        sites: BodyTable,
        flows: Flows,
        scratch: WorldScratch,
        sensor_scratch: Scratch,
        chosen: Integers,
    ) -> int:
        faults = 0
        dt = rules.timing.dt
        apart = int(APART / dt)
        rows = flows.number.shape[1]
        places = places_of(flow_rules, flows)
        gate = surfaces.command.shape[1] - 1
        physics = Physics(rules.assumed, rules.stiffness, sensor_scratch, dt)
        bodies = Bodies(sites.body, sites.edges, sites.corners)
        for i in chosen:
            first = i * rows
            begins = flows.outcome[i] == STARTING
            if begins:
                straighten(rules.acting, surfaces, i)
                for row in range(flows.told.shape[1]):
                    for column in range(flows.told.shape[2]):
                        flows.told[i, row, column] = ROLLING
                        flows.owner[i, row, column] = NOBODY
                flows.outcome[i] = RUNNING
            elif flows.outcome[i] != RUNNING:
                continue
            flows.fault[i] = NO_FAULT
            for k in range(flows.terms.shape[1]):
                flows.terms[i, k] = 0.0
            for k in range(rows):
                lanes.reward[first + k] = 0.0
                lanes.period[first + k] = 0.0
                if not flows.present[i, k]:
                    flows.number[i, k] = NOBODY
            if not begins:
                obey_command(rules, flow_rules, surfaces, lanes, sites, flows, i)
            invalidate_world(scratch)
            invalidate_contacts(sensor_scratch)
            grid = read_grid(surfaces, sites, i, 0, rules.elements, rules.friction)
            company = World(
                lanes.state[first : first + rows],
                flows.present[i],
                lanes.body[first : first + rows],
                bodies,
            )
            zone = sites.zone[0]
            opens = int(surfaces.command[i, gate]) if flow_rules.gated else 1
            entered = False
            # Who may enter does so at a start, which is step 0 alone, and after every step.
            for step in range(0 if begins else 1, 1 if begins else rules.timing.steps + 1):
                if not begins:
                    if turns:
                        turn(rules.acting, surfaces, i, zone)
                        invalidate_world(scratch)
                        invalidate_contacts(sensor_scratch)
                    pairs = step_world(grid, company, flow_rules.sides, scratch, dt)
                    flows.clock[i] += dt
                    flows.steps[i] += 1
                    note_touches(lanes, flows, scratch, i, pairs, apart)
                    for k in range(places):
                        if not flows.present[i, k]:
                            continue
                        row = first + k
                        on_surface = scratch.report[k] < OFF_SURFACE
                        lanes.on_surface[row] = on_surface
                        lanes.on_rotors[row] = on_surface and scratch.rotors[k] > 0
                        lanes.clock[row] += dt
                        lanes.steps[row] += 1
                        lanes.period[row] += dt
                        lane = env_state(surfaces, lanes, sites, i, row, rules.elements)
                        if not lane.on_rotors:
                            read_truth(lane)
                            leave(flows, lanes, i, k, exit_taken(flow_rules, lane))
                        elif watches:
                            read_truth(lane)
                            sensor_update(rules.sensor, lane, physics)
                    waiting = flows.due[i] - flows.coming[i]
                    flows.waited[i] += dt * waiting
                    flows.terms[i, WAITING] += WAITING_REWARD * dt * waiting
                count_due(flows, i)
                # A gate opens at a physics step of the period, for one parcel; or not at all.
                if flow_rules.gated and (entered or opens == 0 or step < opens):
                    continue
                place = let_in(rules, flow_rules, surfaces, lanes, sites, flows, i)
                if place != NOBODY:
                    entered = True
                    lane = env_state(surfaces, lanes, sites, i, first + place, rules.elements)
                    sensor_begin(rules.sensor, lane)
            anybody = False
            moves = False
            for k in range(places):
                if flows.number[i, k] == NOBODY:
                    continue
                lane = env_state(surfaces, lanes, sites, i, first + k, rules.elements)
                read_truth(lane)
                outcome = lanes.outcome[first + k]
                lanes.reward[first + k] = reward_parcel(lane, outcome)
                for term in range(lane.terms.shape[0]):
                    flows.terms[i, term] += lane.terms[term]
                if flows.present[i, k]:
                    anybody = True
                    moves |= not is_slower(lane, STALL_SPEED)
                    sensor_read(rules.sensor, lane)
            if anybody and not moves and not begins:
                flows.still[i] += dt * rules.timing.steps
            else:
                flows.still[i] = 0.0
            if flows.still[i] >= flow_rules.patience:
                flows.outcome[i] = JAM
                flows.terms[i, JAMMED] = JAM_REWARD
            elif flows.clock[i] >= flow_rules.duration - 0.5 * dt:
                flows.outcome[i] = OUT_OF_TIME
            reward = 0.0
            for k in range(flows.terms.shape[1]):
                reward += flows.terms[i, k]
            flows.reward[i] = reward
            if flow_rules.gated:
                show_next(rules, flow_rules, surfaces, lanes, sites, flows, i)
                lanes.reward[first + places] = flows.terms[i, WAITING]
            show_parcels(rules, flow_rules, surfaces, lanes, sites, flows, i)
            for k in range(rows):
                for feature in range(lanes.observation.shape[1]):
                    if not math.isfinite(lanes.observation[first + k, feature]):
                        flows.fault[i] = BAD_OBSERVATION
            faults += flows.fault[i] != NO_FAULT
        return faults

    return compiled(move_flows, functions.label)
