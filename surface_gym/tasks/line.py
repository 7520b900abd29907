"""What the tasks of a line share: entering it, being seen on it, leaving its zone, failing."""

import math

from surface_gym.dynamics.compiled import lane_function
from surface_gym.dynamics.types import GRAVITY, HALF_LENGTH, OMEGA, THETA, VX, VY, X, Y
from surface_gym.lanes.lane import (
    Lane,
    is_slower,
    reach_along,
    read_truth,
    zone_end,
    zone_start,
)
from surface_gym.lanes.memory import RUNNING, SUCCESS
from surface_gym.parcel import Parcel
from surface_gym.plants import Plant
from surface_gym.tasks.start import Draw, Numbers, Parcels
from surface_gym.tasks.task import Feature, failures

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


def zone_of(plant: Plant, parcel: Parcel, zone: tuple[int, int] | None) -> tuple[float, float]:
    """[m] where the zone of a parcel starts and ends; `zone` holds its columns, None: the plant's.

    Raises:
        ValueError: the parcel does not fit the plant.
    """
    _, _, first, columns = plant.site(parcel.base, zone).zone
    start = plant.column_edge(first)
    return start, start + plant.pitch_x * columns


def entry(draw: Draw, parcels: Parcels) -> tuple[Numbers, float, float]:
    """Pose [m, m, rad] at which parcels enter: the rear at the plant's edge, x = 0 where nothing
    else is said, on the line's middle.
    """
    return (draw.plant.column_edge(0) + parcels.rear, draw.plant.line_y, 0.0)


@lane_function
def rear_to_go(lane: Lane, x: float, theta: float) -> float:
    """[m] from the rear of a parcel at x, turned by theta, to the zone's end."""
    return zone_end(lane) - x + reach_along(lane, theta, -1.0, 0.0)


@lane_function
def over_zone_end(lane: Lane) -> bool:
    """Off the rotors, or with the rear past the zone's end."""
    if not lane.on_rotors:
        return True
    if lane.state[X] <= zone_end(lane):
        return False
    read_truth(lane)
    return rear_to_go(lane, lane.truth[X], lane.truth[THETA]) < 0.0


@lane_function
def failure(lane: Lane) -> int:
    """Which failure of every line task has happened; RUNNING if none."""
    if not lane.on_surface:
        return OFF_SURFACE
    if not lane.on_rotors:
        return OFF_LINE
    return STALLED if is_slower(lane, STALL_SPEED) else RUNNING


@lane_function
def leaving(lane: Lane, reached: bool, missed: int) -> int:
    """SUCCESS or `missed`, as the goal is reached or not, where the parcel's rear is past the zone's
    end; before that a `failure`, if any.
    """
    truth = lane.truth
    if lane.on_rotors and lane.on_surface and rear_to_go(lane, truth[X], truth[THETA]) < 0.0:
        return SUCCESS if reached else missed
    return failure(lane)


@lane_function
def see_parcel(lane: Lane) -> None:
    """Write `PARCEL_FEATURES` from what the sensor says."""
    sensed = lane.sensed
    x, theta = sensed[X], sensed[THETA]
    offset = sensed[Y] - lane.elements.line_y
    turn_x = 2.0 * math.pi / lane.elements.pitch_x
    turn_y = 2.0 * math.pi / lane.elements.pitch_y
    see = lane.observation
    see[0] = offset / 0.3
    see[1] = math.sin(theta)
    see[2] = math.cos(theta)
    see[3] = sensed[VX] - 1.0
    see[4] = sensed[VY] / 0.5
    see[5] = sensed[OMEGA] / 3.0
    see[6] = (lane.body[HALF_LENGTH] - 0.175) / 0.05
    see[7] = math.sin(turn_x * (x - lane.elements.x0))
    see[8] = math.cos(turn_x * (x - lane.elements.x0))
    see[9] = math.sin(turn_y * offset)
    see[10] = math.cos(turn_y * offset)
    see[11] = (x + reach_along(lane, theta, 1.0, 0.0) - zone_start(lane)) / 0.5
    see[12] = rear_to_go(lane, x, theta) / 0.5
