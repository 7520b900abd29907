"""One control period of a lane: command, axes, physics, sensors, task. All faces call this."""

import math
from typing import NamedTuple

from numba import prange

from surface_gym.batch import judgement
from surface_gym.batch.commands import WINDOW, Acting, obey, show_window, straighten, turn_axes
from surface_gym.dynamics.compiled import compiled, compiled_for_threads, inlined
from surface_gym.dynamics.step import OFF_SURFACE, step_implicit
from surface_gym.dynamics.types import Scratch
from surface_gym.lanes.memory import RUNNING, Geometry, Integers, Lanes, Timing
from surface_gym.lanes.views import body_of, grid_of, read_truth, scratch_of
from surface_gym.sensors import reading
from surface_gym.sensors.sensor import Sensing


class Rules(NamedTuple):
    """What all lanes of a batch have in common."""

    task: int  # its number
    features: int  # that the task observes
    geometry: Geometry
    timing: Timing
    acting: Acting
    sensing: Sensing


@inlined
def _observe(rules: Rules, lanes: Lanes, lane: int) -> None:
    reading.estimate(rules.sensing, lanes, lane)
    judgement.observe(rules.task, lanes, lane, rules.geometry)
    if rules.acting.kind == WINDOW:
        mirror = judgement.mirror(rules.task, lanes, lane)
        show_window(lanes, lane, rules.geometry, rules.features, mirror)


@compiled
def begin_lanes(rules: Rules, lanes: Lanes, chosen: Integers) -> None:
    """Axes as the conveyor's, first sensing and observation of the chosen lanes (count,)."""
    for lane in chosen:
        straighten(rules.acting, lanes, lane)
        lanes.clock[lane] = 0.0
        lanes.steps[lane] = 0
        lanes.outcome[lane] = RUNNING
        for k in range(lanes.terms.shape[1]):
            lanes.terms[lane, k] = 0.0
        read_truth(lanes, lane)
        reading.begin(rules.sensing, lanes, lane)
        judgement.begin(rules.task, lanes, lane, rules.geometry)
        _observe(rules, lanes, lane)


@inlined
def advance_lane(rules: Rules, lanes: Lanes, lane: int, scratch: Scratch) -> None:
    """Move one lane over a control period; one that has ended stays."""
    if lanes.outcome[lane] != RUNNING:
        return
    dt = rules.timing.dt
    mirror = judgement.mirror(rules.task, lanes, lane)
    obey(rules.acting, lanes, lane, rules.geometry, mirror)
    grid = grid_of(lanes, lane, rules.geometry)
    body = body_of(lanes, lane)
    state = lanes.state[lane]
    start = lanes.clock[lane]
    on_surface = True
    on_rotors = True
    for _ in range(rules.timing.steps):
        if rules.acting.turn != math.inf:
            turn_axes(rules.acting, lanes, lane)
        report, contacts = step_implicit(grid, body, state, scratch, dt)
        if report >= OFF_SURFACE:
            on_surface = False
            break
        lanes.clock[lane] += dt
        lanes.steps[lane] += 1
        on_rotors = False
        for i in range(contacts):
            on_rotors = on_rotors or scratch.rotor[i]
        # A sensor may predict by the physics, in the same scratch: it comes after.
        if reading.watches(rules.sensing):
            read_truth(lanes, lane)
            reading.look(rules.sensing, lanes, lane, rules.geometry, scratch, dt)
        if judgement.over(rules.task, lanes, lane, rules.geometry, on_rotors):
            break
    read_truth(lanes, lane)
    period = lanes.clock[lane] - start
    judgement.judge(rules.task, lanes, lane, rules.geometry, period, on_rotors, on_surface)
    _observe(rules, lanes, lane)


@compiled
def advance_lanes(rules: Rules, lanes: Lanes, scratches: Scratch) -> None:
    """Move all lanes over a control period."""
    scratch = scratch_of(scratches, 0)
    for lane in range(lanes.clock.shape[0]):
        advance_lane(rules, lanes, lane, scratch)


@compiled_for_threads
def advance_lanes_on_threads(
    task: int,
    features: int,
    geometry: Geometry,
    timing: Timing,
    acting: Acting,
    sensing: Sensing,
    lanes: Lanes,
    scratches: Scratch,
) -> None:
    """`advance_lanes` on as many threads as there are scratches, each with lanes of its own.

    The rules come one by one, since Numba hands no nested tuple to a thread.
    """
    count = lanes.clock.shape[0]
    threads = scratches.normal.shape[0]
    for thread in prange(threads):
        rules = Rules(task, features, geometry, timing, acting, sensing)
        scratch = scratch_of(scratches, thread)
        for lane in range(thread * count // threads, (thread + 1) * count // threads):
            advance_lane(rules, lanes, lane, scratch)
