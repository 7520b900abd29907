"""Which parcel a module obeys: the one it bears, or else the one it is about to bear first."""

import math

import numpy as np

from surface_gym.flow.memory import NOBODY
from surface_gym.physics.jit import inlined
from surface_gym.physics.types import THETA, VX, VY, Array, Places, X, Y
from surface_gym.state import COLUMNS, FIRST_COLUMN, FIRST_ROW, ROWS, EnvState, reach_along

NEARER = 1e-6  # [s/m^2] of two that a module bears at once, it obeys the one with the nearer centre


@inlined
def free_modules(owner: Places, soonest: Array, state: EnvState) -> None:
    """No module of the zone obeys anybody, and any may be claimed."""
    zone = state.zone
    for row in range(zone[FIRST_ROW], zone[FIRST_ROW] + zone[ROWS]):
        for column in range(zone[FIRST_COLUMN], zone[FIRST_COLUMN] + zone[COLUMNS]):
            owner[row, column] = NOBODY
            soonest[row, column] = np.inf


@inlined
def _until(place: float, low: float, high: float, speed: float) -> float:
    """[s] until an interval that moves at a speed [m/s] holds a place; 0 if it does, else infinite
    where it never will.
    """
    if place > high:
        return (place - high) / speed if speed > 0.0 else np.inf
    if place < low:
        return (low - place) / -speed if speed < 0.0 else np.inf
    return 0.0


@inlined
def _after(place: float, low: float, high: float, speed: float) -> float:
    """[s] until an interval that moves at a speed [m/s] has passed a place; infinite if never."""
    if speed > 0.0:
        return (place - low) / speed
    return (high - place) / -speed if speed < 0.0 else np.inf


@inlined
def claim_modules(owner: Places, soonest: Array, state: EnvState, place: int, ahead: float) -> None:
    """Let the parcel of a place claim every module of the zone that it bears, or is the first to
    bear within `ahead` seconds, by its box as it is sensed and moves on.
    """
    sensed = state.sensed
    theta = sensed[THETA]
    vx, vy = sensed[VX], sensed[VY]
    front = sensed[X] + reach_along(state, theta, 1.0, 0.0)
    rear = sensed[X] - reach_along(state, theta, -1.0, 0.0)
    left = sensed[Y] + reach_along(state, theta, 0.0, 1.0)
    right = sensed[Y] - reach_along(state, theta, 0.0, -1.0)
    zone, elements = state.zone, state.elements
    first_row, first_column = zone[FIRST_ROW], zone[FIRST_COLUMN]
    x0, y0 = elements.x0, elements.y0
    low_x = (rear + min(0.0, vx * ahead) - x0) / elements.pitch_x
    high_x = (front + max(0.0, vx * ahead) - x0) / elements.pitch_x
    low_y = (right + min(0.0, vy * ahead) - y0) / elements.pitch_y
    high_y = (left + max(0.0, vy * ahead) - y0) / elements.pitch_y
    if not (abs(low_x) < 1e6 and abs(high_x) < 1e6 and abs(low_y) < 1e6 and abs(high_y) < 1e6):
        return  # an estimate that has lost the parcel
    for row in range(
        max(first_row, math.ceil(low_y)), min(first_row + zone[ROWS], math.floor(high_y) + 1)
    ):
        y = y0 + elements.pitch_y * row
        until_y = _until(y, right, left, vy)
        after_y = _after(y, right, left, vy)
        for column in range(
            max(first_column, math.ceil(low_x)),
            min(first_column + zone[COLUMNS], math.floor(high_x) + 1),
        ):
            x = x0 + elements.pitch_x * column
            until = max(until_y, _until(x, rear, front, vx))
            if until > min(ahead, after_y, _after(x, rear, front, vx)):
                continue
            until += NEARER * ((x - sensed[X]) ** 2 + (y - sensed[Y]) ** 2)
            if until < soonest[row, column]:
                soonest[row, column] = until
                owner[row, column] = place
