"""A batch's compiled code: one control period of a lane, built from what the batch is made of.

Command, axes, physics, sensor, task: all faces call this. Only the functions of the batch's own
task, sensor and kind of action are compiled into it.
"""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

from surface_gym.actions.commands import Acting, window_corner
from surface_gym.actions.more import Shown
from surface_gym.dynamics.compiled import compiled, inlined
from surface_gym.dynamics.contacts import forget_contacts
from surface_gym.dynamics.step import OFF_SURFACE, step_implicit
from surface_gym.dynamics.types import Array, Integers, Scratch
from surface_gym.lanes.lane import Lane, lane_of, read_truth
from surface_gym.lanes.memory import (
    BAD_OBSERVATION,
    BAD_REWARD,
    COLUMNS,
    FIRST_COLUMN,
    FIRST_ROW,
    OUT_OF_TIME,
    PLACED,
    ROWS,
    RUNNING,
    SOUND,
    UNKNOWN_OUTCOME,
    Geometry,
    Lanes,
    Sites,
    Surfaces,
    Timing,
)
from surface_gym.lanes.views import body_of, grid_of
from surface_gym.sensors.sensor import Physics

Function = Callable[..., Any]


class Actuation(NamedTuple):
    """How axes obey."""

    obey: Function  # what a part of the command does to an axis
    turn: Function  # what all axes do in a physics step
    straighten: Function  # how all become the conveyor's
    turns: bool  # whether axes take time


class Functions(NamedTuple):
    """What a kernel is built from."""

    label: str  # of its files in the cache
    begin: Function  # the task's
    over: Function
    judge: Function
    reward: Function
    observe: Function
    mirror: Function
    begin_sensor: Function  # the sensor's
    look: Function
    estimate: Function
    watches: bool
    part_of: Function  # the kind of action's
    actuation: Actuation
    show_modules: Function  # what is observed after the task's features
    show_axes: Function
    learned: Function  # the sensor's
    more: tuple[Shown, ...]  # what is observed at the end, by groups


class Rules(NamedTuple):
    """What all lanes of a batch have in common."""

    elements: Geometry
    timing: Timing
    acting: Acting
    friction: Array  # (rows, columns, 3) [-] of the elements
    assumed: Array  # (rows, columns, 3) [-] as the sensor has it
    stiffness: Array  # (rows, columns) [-] as the sensor has it
    sensor: Array  # its settings
    features: int  # that the task observes
    axes_from: int  # place in the observation from which axes are shown
    outcomes: int  # that there are


@lru_cache(maxsize=64)
def obeying(part_of: Function, obey: Function) -> Any:
    """Build `obey_command(rules, surfaces, lane, i, mirror)`: what surface i's command does to the
    axes of a lane's zone.
    """

    @inlined
    def obey_command(rules: Rules, surfaces: Surfaces, lane: Lane, i: int, mirror: float) -> None:
        corner = window_corner(lane, mirror)
        zone = lane.zone
        for row in range(zone[FIRST_ROW], zone[FIRST_ROW] + zone[ROWS]):
            for column in range(zone[FIRST_COLUMN], zone[FIRST_COLUMN] + zone[COLUMNS]):
                part = part_of(rules.acting, lane, corner, row, column)
                if part >= 0 and lane.obeys[row, column]:
                    obey(rules.acting, surfaces, i, row, column, part)

    return obey_command


@lru_cache(maxsize=256)
def showing(functions: Functions) -> Any:
    """Build `show_more(rules, lane, mirror)`: what is observed after the task's features."""
    show_modules, show_axes = functions.show_modules, functions.show_axes
    (show_parcel, parcel_size), (show_rotors, rotors_size), (_, load_size) = functions.more
    show_learned, learns = functions.learned, load_size > 0

    @inlined
    def show_more(rules: Rules, lane: Lane, mirror: float) -> None:
        show_modules(rules.acting, lane, rules.features, mirror)
        show_axes(rules.acting, lane, rules.axes_from, mirror)
        load_from = lane.observation.shape[0] - load_size
        rotors_from = load_from - rotors_size
        show_parcel(rules.acting, lane, rotors_from - parcel_size, mirror)
        show_rotors(rules.acting, lane, rotors_from, mirror)
        if learns:
            show_learned(rules.sensor, lane, load_from, mirror)

    return show_more


@lru_cache(maxsize=256)
def make_kernel(functions: Functions) -> Any:
    """Build `move_lanes(rules, surfaces, lanes, sites, scratch, sensor's scratch, chosen)`.

    Of the chosen lanes (count,) those placed begin, those that run move over one control period,
    and those that have ended stay. It returns how many a task's function has gone wrong on, and is
    compiled for a batch's arrays by `entry_of`.
    """
    task_begin, task_over, task_judge = functions.begin, functions.over, functions.judge
    task_reward, task_observe, task_mirror = functions.reward, functions.observe, functions.mirror
    sensor_begin, sensor_look = functions.begin_sensor, functions.look
    sensor_estimate, watches = functions.estimate, functions.watches
    obey, turn, straighten, turns = functions.actuation
    obey_command = obeying(functions.part_of, obey)
    show_more = showing(functions)

    def move_lanes(
        rules: Rules,
        surfaces: Surfaces,
        lanes: Lanes,
        sites: Sites,
        scratch: Scratch,
        sensor_scratch: Scratch,
        chosen: Integers,
    ) -> int:
        faults = 0
        dt = rules.timing.dt
        physics = Physics(rules.assumed, rules.stiffness, sensor_scratch, dt)
        for i in chosen:
            if lanes.outcome[i] == PLACED:
                straighten(rules.acting, surfaces, i)
                lanes.clock[i] = 0.0
                lanes.steps[i] = 0
            elif lanes.outcome[i] != RUNNING:
                continue
            lanes.fault[i] = SOUND
            lanes.period[i] = 0.0
            lanes.on_rotors[i] = True
            lanes.on_surface[i] = True
            lane = lane_of(surfaces, lanes, sites, i, i, rules.elements)
            mirror = task_mirror(lane)
            if lanes.outcome[i] == PLACED:
                lanes.outcome[i] = RUNNING
                lanes.reward[i] = 0.0
                for k in range(lane.terms.shape[0]):
                    lane.terms[k] = 0.0
                read_truth(lane)
                sensor_begin(rules.sensor, lane)
                task_begin(lane)
            else:
                obey_command(rules, surfaces, lane, i, mirror)
                site = lanes.site[i]
                grid = grid_of(surfaces, sites, i, site, rules.elements, rules.friction)
                body = body_of(sites, site)
                start = lanes.clock[i]
                forget_contacts(scratch)
                forget_contacts(sensor_scratch)
                for _ in range(rules.timing.steps):
                    if turns and turn(rules.acting, surfaces, i, lane.zone):
                        forget_contacts(scratch)
                        forget_contacts(sensor_scratch)
                    report, contacts = step_implicit(grid, body, lane.state, scratch, dt)
                    on_surface = report < OFF_SURFACE
                    lanes.on_surface[i] = on_surface
                    if on_surface:
                        lanes.clock[i] += dt
                        lanes.steps[i] += 1
                        lanes.period[i] = lanes.clock[i] - start
                        lanes.on_rotors[i] = contacts.total > contacts.supports
                    lane = lane_of(surfaces, lanes, sites, i, i, rules.elements)
                    if not on_surface:
                        break
                    if watches:
                        read_truth(lane)
                        sensor_look(rules.sensor, lane, physics)
                    if task_over(lane):
                        break
                read_truth(lane)
                outcome = task_judge(lane)
                task_reward(lane, outcome)
                lanes.outcome[i] = outcome
                reward = 0.0
                for k in range(lane.terms.shape[0]):
                    reward += lane.terms[k]
                lanes.reward[i] = reward
                if not math.isfinite(reward):
                    lanes.fault[i] = BAD_REWARD
                if not 0 <= outcome < rules.outcomes or outcome == OUT_OF_TIME:
                    lanes.fault[i] = UNKNOWN_OUTCOME
            sensor_estimate(rules.sensor, lane)
            task_observe(lane)
            show_more(rules, lane, mirror)
            for k in range(lane.observation.shape[0]):
                if not math.isfinite(lane.observation[k]):
                    lanes.fault[i] = BAD_OBSERVATION
            faults += lanes.fault[i] != SOUND
        return faults

    return compiled(move_lanes, functions.label)
