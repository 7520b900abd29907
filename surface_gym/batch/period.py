"""One control period of a lane: command, axes, physics, sensors, task. All faces call this."""

from surface_gym.batch import judgement
from surface_gym.batch.commands import obey
from surface_gym.dynamics.compiled import compiled, inlined
from surface_gym.dynamics.step import OFF_SURFACE, step_implicit
from surface_gym.dynamics.types import Array, Scratch
from surface_gym.lanes.memory import RUNNING, Geometry, Lanes, Timing
from surface_gym.lanes.views import body_of, grid_of, read_truth, scratch_of


@inlined
def _sense(lanes: Lanes, lane: int) -> None:
    for k in range(6):
        lanes.sensed[lane, k] = lanes.truth[lane, k]


@compiled
def begin_lane(task: int, lanes: Lanes, lane: int, geometry: Geometry) -> None:
    """First sensing and observation after a start was placed on a lane."""
    lanes.clock[lane] = 0.0
    lanes.outcome[lane] = RUNNING
    for k in range(lanes.terms.shape[1]):
        lanes.terms[lane, k] = 0.0
    read_truth(lanes, lane)
    _sense(lanes, lane)
    judgement.begin(task, lanes, lane, geometry)
    judgement.observe(task, lanes, lane, geometry)


@compiled
def advance_lanes(
    task: int,
    action: int,
    lanes: Lanes,
    first: int,
    last: int,
    geometry: Geometry,
    timing: Timing,
    orientations: Array,
    scratches: Scratch,
    thread: int,
) -> None:
    """Move the lanes in [first, last) over one control period; those that have ended stay."""
    scratch = scratch_of(scratches, thread)
    for lane in range(first, last):
        if lanes.outcome[lane] != RUNNING:
            continue
        obey(action, lanes, lane, geometry, orientations)
        grid = grid_of(lanes, lane, geometry)
        body = body_of(lanes, lane)
        state = lanes.state[lane]
        start = lanes.clock[lane]
        on_surface = True
        on_rotors = True
        for _ in range(timing.steps):
            report, contacts = step_implicit(grid, body, state, scratch, timing.dt)
            if report >= OFF_SURFACE:
                on_surface = False
                break
            lanes.clock[lane] += timing.dt
            on_rotors = False
            for i in range(contacts):
                on_rotors = on_rotors or scratch.rotor[i]
            if judgement.over(task, on_rotors):
                break
        read_truth(lanes, lane)
        _sense(lanes, lane)
        period = lanes.clock[lane] - start
        judgement.judge(task, lanes, lane, geometry, period, on_rotors, on_surface)
        judgement.observe(task, lanes, lane, geometry)
