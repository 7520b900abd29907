"""Assignment of modules to parcels, and commands of modules (compiled)."""

import math
from functools import lru_cache
from typing import Any

import numpy as np

from surface_gym import state as st
from surface_gym.compiler.jit import inlined
from surface_gym.core.kernel import Function
from surface_gym.flow import state as fs
from surface_gym.flow.base import HALVES
from surface_gym.flow.state import StreamView, view_parcel
from surface_gym.physics import types as ph
from surface_gym.physics.types import Array, Places
from surface_gym.state import EnvState

NEARER = 1e-6  # [s/m^2] weight of the distance, by which the parcel with the nearer centre wins
CLOSING = 1.0  # [m/s] assumed closing speed of a base towards a module outside it


@inlined
def _until(point: float, low: float, high: float, speed: float) -> float:
    """Return the time [s] until a moving interval contains a point.

    The interval is now from `low` to `high` [m], and moves at `speed` [m/s]. If the interval never
    contains the point, the time is infinite.
    """
    if point > high:
        return (point - high) / speed if speed > 0.0 else np.inf
    if point < low:
        return (low - point) / -speed if speed < 0.0 else np.inf
    return 0.0


@inlined
def _after(point: float, low: float, high: float, speed: float) -> float:
    """Return the time [s] until a moving interval (see `_until`) has passed a point."""
    if speed > 0.0:
        return (point - low) / speed
    return (high - point) / -speed if speed < 0.0 else np.inf


@lru_cache(maxsize=64)
def assigning(base_distance: Function) -> Any:
    """Build `assign_modules(view)`, which writes the parcel that each module obeys.

    `assign_modules` calls the task's function `base_distance(state, x, y)`.
    """

    @inlined
    def claim_modules(
        owner: Places, soonest: Array, state: EnvState, slot: int, ahead: float
    ) -> None:
        """Let the parcel in row `slot` claim each module that no other parcel reaches sooner.

        The parcel's sensed box moves at the sensed velocity, and must reach the module within
        `ahead` [s]. The compared time is the time until the box reaches the module, plus a term
        that grows with the parcel's distance from the module. A claim writes `slot` to the array
        `owner` (rows, columns), and the compared time [s] to the array `soonest` (rows, columns).
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
            return  # the estimate has lost the parcel
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
                until += base_distance(state, x, y) / CLOSING
                if until < soonest[row, column]:
                    soonest[row, column] = until
                    owner[row, column] = slot

    @inlined
    def assign_modules(view: StreamView) -> None:
        streams, i, zone = view.streams, view.i, view.bodies.zone[0]
        owner, soonest = streams.owner[i], streams.soonest[i]
        for row in range(zone[st.FIRST_ROW], zone[st.FIRST_ROW] + zone[st.ROWS]):
            for column in range(zone[st.FIRST_COLUMN], zone[st.FIRST_COLUMN] + zone[st.COLUMNS]):
                owner[row, column] = fs.NOBODY
                soonest[row, column] = np.inf
        for slot in range(view.rows):
            if streams.present[i, slot]:
                ahead = view.stream_params.ahead
                claim_modules(owner, soonest, view_parcel(view, slot), slot, ahead)

    return assign_modules


# Index of the number in a surface's command that a module obeys; negative if none.


@inlined
def part_of_module(view: StreamView, row: int, column: int) -> int:
    """Return the index of a module in the command. A command lists the zone row by row."""
    zone = view.bodies.zone[0]
    return (row - zone[st.FIRST_ROW]) * zone[st.COLUMNS] + column - zone[st.FIRST_COLUMN]


@inlined
def part_of_owner(view: StreamView, row: int, column: int) -> int:
    """Return the index, in the command, of the number that a module obeys.

    A command has two numbers for each parcel. Modules under the parcel's front half obey the first
    number. Modules under the parcel's rear half obey the second number. If a module obeys no
    parcel, return -1.
    """
    slot = view.streams.owner[view.i, row, column]
    if slot < 0:
        return -1
    x = view.params.elements.x0 + view.params.elements.pitch_x * column
    return HALVES * slot + (1 if x < view.parcels.sensed[view.first + slot, ph.X] else 0)


@inlined
def part_of_none(view: StreamView, row: int, column: int) -> int:
    """Return -1: every module keeps its axis."""
    return -1


# The axis angle [rad] that a number of the command sets.


@inlined
def commanded_choice(view: StreamView, part: int) -> float:
    """Return the angle [rad] of the orientation whose index is entry `part` of the command."""
    return view.params.acting.orientations[view.surfaces.command[view.i, part]]


@inlined
def commanded_angle(view: StreamView, part: int) -> float:
    """Return the number at index `part` of the command. This number is an angle [rad]."""
    return view.surfaces.command[view.i, part]


@inlined
def is_turn(angle: float, before: float) -> bool:
    """Return whether an axis angle [rad] differs from `before`. A half turn is no difference."""
    apart = angle - before
    return abs(apart - math.pi * math.floor(apart / math.pi + 0.5)) > 1e-9


@lru_cache(maxsize=64)
def obeying(base_distance: Function, part_of: Function, commanded: Function, obey: Function) -> Any:
    """Build `obey_command(view)`, which sets a surface's modules and counts their turns.

    `base_distance` is a function of the task. `part_of` and `commanded` are functions of this file.
    `part_of` returns the index of a module's entry in the command. `obey` sets the module by this
    entry.
    """
    assign_modules = assigning(base_distance)

    @inlined
    def obey_command(view: StreamView) -> None:
        streams, i = view.streams, view.i
        assign_modules(view)
        obeys = streams.obeys[i if streams.obeys.shape[0] > 1 else 0]
        zone = view.bodies.zone[0]
        for row in range(zone[st.FIRST_ROW], zone[st.FIRST_ROW] + zone[st.ROWS]):
            for column in range(zone[st.FIRST_COLUMN], zone[st.FIRST_COLUMN] + zone[st.COLUMNS]):
                part = part_of(view, row, column)
                if part < 0 or not obeys[row, column]:
                    continue
                angle = commanded(view, part)
                if is_turn(angle, streams.commanded[i, row, column]):
                    streams.tally[i, fs.TURNS] += 1
                streams.commanded[i, row, column] = angle
                obey(view.params.acting, view.surfaces, i, row, column, part)

    return obey_command
