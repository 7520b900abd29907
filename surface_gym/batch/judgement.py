"""The compiled half of every task, by its number."""

from surface_gym.dynamics.compiled import inlined
from surface_gym.lanes.memory import Geometry, Lanes
from surface_gym.tasks import line, orient, slow, sort, stop, track

SORT, SLOW, STOP, TRACK, ORIENT = range(5)


@inlined
def begin(task: int, lanes: Lanes, lane: int, geometry: Geometry) -> None:
    """Set the task's memory at a start."""
    if task == SORT:
        sort.begin(lanes, lane, geometry)
    elif task == SLOW:
        slow.begin(lanes, lane, geometry)
    elif task == STOP:
        stop.begin(lanes, lane)
    elif task == TRACK:
        track.begin(lanes, lane)
    elif task == ORIENT:
        orient.begin(lanes, lane)


@inlined
def over(task: int, lanes: Lanes, lane: int, geometry: Geometry, on_rotors: bool) -> bool:
    """Whether a physics step ended the episode in the middle of a control period.

    It is asked after every step: cheap tests on `lanes.state` come first. `judge` then says why.
    """
    if task == TRACK:
        return False
    if not on_rotors:
        return True
    return task in (SLOW, ORIENT) and line.has_left(lanes, lane, geometry)


@inlined
def judge(
    task: int,
    lanes: Lanes,
    lane: int,
    geometry: Geometry,
    period: float,
    on_rotors: bool,
    on_surface: bool,
) -> None:
    """Write reward terms and outcome after a control period of `period` [s]."""
    if task == SORT:
        sort.judge(lanes, lane, geometry, period, on_rotors, on_surface)
    elif task == SLOW:
        slow.judge(lanes, lane, geometry, on_rotors, on_surface)
    elif task == STOP:
        stop.judge(lanes, lane, on_rotors, on_surface)
    elif task == TRACK:
        track.judge(lanes, lane, period, on_surface)
    elif task == ORIENT:
        orient.judge(lanes, lane, geometry, on_rotors, on_surface)


@inlined
def observe(task: int, lanes: Lanes, lane: int, geometry: Geometry) -> None:
    """Write the task's features into the observation, from `lanes.sensed`."""
    if task == SORT:
        sort.observe(lanes, lane, geometry)
    elif task == SLOW:
        slow.observe(lanes, lane, geometry)
    elif task == STOP:
        stop.observe(lanes, lane, geometry)
    elif task == TRACK:
        track.observe(lanes, lane, geometry)
    elif task == ORIENT:
        orient.observe(lanes, lane, geometry)


@inlined
def mirror(task: int, lanes: Lanes, lane: int) -> float:
    """-1 where the observation is mirrored in y, else 1."""
    return sort.mirror_of(lanes, lane) if task == SORT else 1.0
