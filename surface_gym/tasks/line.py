"""Parts that tasks on a line share: entry, features, the way out of the zone, failures."""

import math

from surface_gym import state as st
from surface_gym.lines import BaseLine
from surface_gym.parcel import Parcel
from surface_gym.physics.jit import kernel_function
from surface_gym.physics.types import GRAVITY, HALF_LENGTH, OMEGA, THETA, VX, VY, X, Y
from surface_gym.state import EnvState
from surface_gym.tasks.base import Feature, failures
from surface_gym.tasks.start import Draw, Numbers, Parcels

BRAKING = 0.5 * GRAVITY  # [m/s^2] mu_max g of Table 1: every axis at 0 deg under a parcel
ROLLING_LOSS = 0.01 * GRAVITY  # [m/s^2] mu_min g of Table 1: every axis at 90 deg
STALL_SPEED = 1e-3  # [m/s] slower than this, friction has won on a flat surface

# How every task of a line may fail; each goes on with its own.
LINE_OUTCOMES = ("off the surface", "off the line", "stalled")
OFF_SURFACE, OFF_LINE, STALLED = failures(LINE_OUTCOMES)

# What `see_parcel` writes.
PARCEL_FEATURES = (
    Feature("lateral offset", -10.0, 10.0, "from the line's middle / 0.3 m"),
    Feature("sine of theta", -1.0, 1.0, ""),
    Feature("cosine of theta", -1.0, 1.0, ""),
    Feature("forward speed", -10.0, 10.0, "vx / 1 m/s - 1"),
    Feature("lateral speed", -20.0, 20.0, "vy / 0.5 m/s"),
    Feature("turning speed", -50.0, 50.0, "omega / 3 rad/s"),
    Feature(
        "size", -10.0, 100.0, "(half length - 0.175 m) / 0.05 m: -1 for the S-box, 1 for the B"
    ),
    Feature("sine of phase x", -1.0, 1.0, "of the position within a pitch"),
    Feature("cosine of phase x", -1.0, 1.0, ""),
    Feature("sine of phase y", -1.0, 1.0, ""),
    Feature("cosine of phase y", -1.0, 1.0, ""),
    Feature("front in zone", -20.0, 20.0, "of the parcel's front past the zone's start / 0.5 m"),
    Feature("rear to go", -20.0, 20.0, "from the parcel's rear to the zone's end / 0.5 m"),
)


def zone_span(line: BaseLine, parcel: Parcel, zone: tuple[int, int] | None) -> tuple[float, float]:
    """Return where [m] the zone of a parcel starts and ends; `zone`: its columns, or None."""
    _, _, first, columns = line.site(parcel.base, zone).zone
    start = line.column_edge(first)
    return start, start + line.pitch_x * columns


def entry(draw: Draw, parcels: Parcels) -> tuple[Numbers, float, float]:
    """Return the pose [m, m, rad] of parcels as they enter: the rear at the edge, in the middle."""
    return (draw.line.column_edge(0) + parcels.rear, draw.line.line_y, 0.0)


@kernel_function
def rear_to_go(state: EnvState, x: float, theta: float) -> float:
    """Return the distance [m] from the rear of a parcel at x, turned by theta, to the zone's end."""
    return st.zone_end(state) - x + st.reach_along(state, theta, -1.0, 0.0)


@kernel_function
def over_zone_end(state: EnvState) -> bool:
    """Return whether the parcel is off the rotors, or its rear past the zone's end."""
    if not state.on_rotors:
        return True
    if state.com[X] <= st.zone_end(state):
        return False
    st.read_truth(state)
    return rear_to_go(state, state.truth[X], state.truth[THETA]) < 0.0


@kernel_function
def failure(state: EnvState) -> int:
    """Return the failure that has happened, of those every line task has; RUNNING if none."""
    if not state.on_surface:
        return OFF_SURFACE
    if not state.on_rotors:
        return OFF_LINE
    return STALLED if st.is_slower(state, STALL_SPEED) else st.RUNNING


@kernel_function
def leaving(state: EnvState, reached: bool, missed: int) -> int:
    """Return SUCCESS or `missed` where the parcel's rear is past the zone's end, as the goal is
    reached or not; before that a `failure`, if any.
    """
    truth = state.truth
    if state.on_rotors and state.on_surface and rear_to_go(state, truth[X], truth[THETA]) < 0.0:
        return st.SUCCESS if reached else missed
    return failure(state)


@kernel_function
def see_parcel(state: EnvState) -> None:
    """Write `PARCEL_FEATURES` from the sensor's pose and velocity."""
    sensed = state.sensed
    x, theta = sensed[X], sensed[THETA]
    offset = sensed[Y] - state.elements.line_y
    turn_x = 2.0 * math.pi / state.elements.pitch_x
    turn_y = 2.0 * math.pi / state.elements.pitch_y
    see = state.observation
    see[0] = offset / 0.3
    see[1] = math.sin(theta)
    see[2] = math.cos(theta)
    see[3] = sensed[VX] - 1.0
    see[4] = sensed[VY] / 0.5
    see[5] = sensed[OMEGA] / 3.0
    see[6] = (state.body[HALF_LENGTH] - 0.175) / 0.05
    see[7] = math.sin(turn_x * (x - state.elements.x0))
    see[8] = math.cos(turn_x * (x - state.elements.x0))
    see[9] = math.sin(turn_y * offset)
    see[10] = math.cos(turn_y * offset)
    see[11] = (x + st.reach_along(state, theta, 1.0, 0.0) - st.zone_start(state)) / 0.5
    see[12] = rear_to_go(state, x, theta) / 0.5
