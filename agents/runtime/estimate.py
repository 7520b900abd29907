"""Compiled half of the shadow: the package's own prediction, correction and observation, a call
each.

Nothing of the physics, the filter or an observation is written here. A lane is moved by the sensor
of the environment, as a batch moves one: it is told when it looks, and that what it looks at is the
pose of a frame.
"""

from functools import lru_cache
from typing import Any

import numpy as np

from surface_gym.core.actions import (
    Acting,
    ActionKind,
    aim_at_angle,
    aim_at_choice,
    straighten_targets,
    turn_axes,
)
from surface_gym.core.kernel import EnvParams, Function, KernelFunctions, obeying, showing
from surface_gym.physics.contacts import invalidate_contacts
from surface_gym.physics.jit import compiled
from surface_gym.physics.step import axis_direction
from surface_gym.physics.types import Array, Scratch
from surface_gym.sensors.base import Physics
from surface_gym.sensors.camera import EVERY, LAG
from surface_gym.state import (
    COLUMNS,
    FIRST_COLUMN,
    FIRST_ROW,
    ROWS,
    BodyTable,
    ParcelState,
    SurfaceState,
    env_state,
    read_truth,
)

NEVER = 2.0**40  # physics steps from frame to frame: none is taken


def looks_of(numbers: Array) -> tuple[Array, Array]:
    """A camera's settings with which it takes no frame, and with which it takes one at each step
    and uses it at once.
    """
    coasting, looking = np.array(numbers), np.array(numbers)
    coasting[EVERY], coasting[LAG] = NEVER, 0.0
    looking[EVERY], looking[LAG] = 1.0, 0.0
    return coasting, looking


@compiled
def use_encoders(
    surfaces: SurfaceState, sites: BodyTable, site: int, i: int, angles: Array
) -> None:
    """Put the axes of a lane's zone to angles (rows, columns) [rad] of the widest zone's."""
    zone = sites.zone[site]
    margin = (angles.shape[0] - zone[ROWS]) // 2
    for down in range(zone[ROWS]):
        for along in range(zone[COLUMNS]):
            row, column = zone[FIRST_ROW] + down, zone[FIRST_COLUMN] + along
            angle = angles[margin + down, along]
            axis = surfaces.axis[i, row, column]
            surfaces.angle[i, row, column] = angle
            cosine, sine = axis_direction(angle)
            surfaces.direction[i, axis, 0] = cosine
            surfaces.direction[i, axis, 1] = sine


@lru_cache(maxsize=16)
def make_begin(functions: KernelFunctions) -> Any:
    """`begin(rules, surfaces, lanes, sites, i)`: axes as the conveyor's, the estimate what is known
    of the entry, which is in `lanes.state`.
    """
    task_begin, sensor_begin = functions.begin, functions.begin_sensor

    def begin_lane(
        rules: EnvParams, surfaces: SurfaceState, lanes: ParcelState, sites: BodyTable, i: int
    ) -> None:
        straighten_targets(rules.acting, surfaces, i)
        lanes.clock[i] = 0.0
        lanes.steps[i] = 0
        lanes.period[i] = 0.0
        lanes.noise_row[i, 0] = 0
        lane = env_state(surfaces, lanes, sites, i, i, rules.elements)
        read_truth(lane)
        sensor_begin(rules.sensor, lane)
        task_begin(lane)

    return compiled(begin_lane, f"shadow-begin-{functions.label}")


@lru_cache(maxsize=16)
def make_move(look: Function, label: str) -> Any:
    """`move(rules, surfaces, lanes, sites, scratch, i, length, steps, axis_speed, looks, coasting,
    looking)`: turn a lane's axes at a speed [rad/s] and predict, over some steps of a length [s];
    where it looks, correct at the end by the frame whose pose is in `lanes.truth`.
    """

    def move_lane(
        rules: EnvParams,
        surfaces: SurfaceState,
        lanes: ParcelState,
        sites: BodyTable,
        scratch: Scratch,
        i: int,
        length: float,
        steps: int,
        axis_speed: float,
        looks: bool,
        coasting: Array,
        looking: Array,
    ) -> None:
        physics = Physics(rules.assumed, rules.stiffness, scratch, length)
        acting = Acting(rules.acting.zone_rows, rules.acting.orientations, axis_speed * length)
        invalidate_contacts(scratch)
        lanes.noise_row[i, 0] = 0
        for k in range(steps):
            lanes.clock[i] += length
            lanes.steps[i] += 1
            lane = env_state(surfaces, lanes, sites, i, i, rules.elements)
            if turn_axes(acting, surfaces, i, lane.zone):
                invalidate_contacts(scratch)
            look(looking if looks and k == steps - 1 else coasting, lane, physics)

    return compiled(move_lane, f"shadow-move-{label}")


@lru_cache(maxsize=16)
def make_show(functions: KernelFunctions) -> Any:
    """`show(rules, surfaces, lanes, sites, i)`: the observation of a lane's estimate."""
    task_observe, task_mirror = functions.observe, functions.mirror
    estimate, show_more = functions.estimate, showing(functions)

    def show_lane(
        rules: EnvParams, surfaces: SurfaceState, lanes: ParcelState, sites: BodyTable, i: int
    ) -> None:
        lane = env_state(surfaces, lanes, sites, i, i, rules.elements)
        estimate(rules.sensor, lane)
        mirror = task_mirror(lane)
        task_observe(lane)
        show_more(rules, lane, mirror)

    return compiled(show_lane, f"shadow-show-{functions.label}")


@lru_cache(maxsize=16)
def make_obey(kind: ActionKind, mirror_of: Function) -> Any:
    """`obey(rules, surfaces, lanes, sites, i)`: what a lane's command has its modules turn to."""
    obey_command = obeying(kind.part_of, aim_at_angle if kind.continuous else aim_at_choice)

    def obey_lane(
        rules: EnvParams, surfaces: SurfaceState, lanes: ParcelState, sites: BodyTable, i: int
    ) -> None:
        lane = env_state(surfaces, lanes, sites, i, i, rules.elements)
        obey_command(rules, surfaces, lane, i, mirror_of(lane))

    return compiled(obey_lane, f"shadow-{kind.name}-{'angles' if kind.continuous else 'choices'}")
