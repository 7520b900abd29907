"""The compiled half of every task, by its number."""

from surface_gym.dynamics.compiled import inlined
from surface_gym.lanes.memory import Geometry, Lanes
from surface_gym.tasks import sort

SORT = 0


@inlined
def begin(task: int, lanes: Lanes, lane: int, geometry: Geometry) -> None:
    """Set the task's memory at a start."""
    if task == SORT:
        sort.begin(lanes, lane, geometry)


@inlined
def over(task: int, lanes: Lanes, lane: int, geometry: Geometry, on_rotors: bool) -> bool:
    """Whether a physics step ended the episode in the middle of a control period.

    It is asked after every step: cheap tests on `lanes.state` come first. `judge` then says why.
    """
    return task == SORT and not on_rotors


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


@inlined
def observe(task: int, lanes: Lanes, lane: int, geometry: Geometry) -> None:
    """Write the task's features into the observation, from `lanes.sensed`."""
    if task == SORT:
        sort.observe(lanes, lane, geometry)


@inlined
def mirror(task: int, lanes: Lanes, lane: int) -> float:
    """-1 where the observation is mirrored in y, else 1."""
    return lanes.goal[lane, sort.SIDE] if task == SORT else 1.0
