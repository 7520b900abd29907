"""What the tasks of a line share: entering it, being seen on it, leaving its zone, failing."""

import math

from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.types import GRAVITY, X
from surface_gym.lanes.memory import (
    COLUMNS,
    FIRST_COLUMN,
    HALF_LENGTH,
    OFF_LINE,
    OFF_SURFACE,
    RUNNING,
    STALLED,
    Geometry,
    Lanes,
)
from surface_gym.lanes.views import reach_along, read_truth
from surface_gym.layouts import LINE_Y
from surface_gym.parcel import Parcel
from surface_gym.plant import ORIGIN, PITCH, Line
from surface_gym.tasks.task import Feature

BRAKING = 0.5 * GRAVITY  # [m/s^2] mu_max g of Table 1: every axis at 0 deg under a parcel
ROLLING_LOSS = 0.01 * GRAVITY  # [m/s^2] mu_min g of Table 1: every axis at 90 deg
STALL_SPEED = 1e-3  # [m/s] slower than this, friction has won on a flat surface

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


def zone_of(plant: Line, parcel: Parcel, zone: tuple[int, int] | None) -> tuple[float, float]:
    """[m] where the zone of a parcel starts and ends; `zone` holds its columns, None: the plant's.

    Raises:
        ValueError: the parcel does not fit the line.
    """
    _, _, first, columns = plant.site(parcel.base, zone).zone
    start = ORIGIN + PITCH * (first - 0.5)
    return start, start + PITCH * columns


def entry(parcel: Parcel) -> tuple[float, float, float]:
    """Pose [m, m, rad] at which a parcel enters: its rear at x = 0, on the line's middle."""
    return (parcel.rear, LINE_Y, 0.0)


@inlined
def zone_end(lanes: Lanes, lane: int, geometry: Geometry) -> float:
    """[m] half a pitch past the centres of the zone's last column."""
    after = lanes.zone[lane, FIRST_COLUMN] + lanes.zone[lane, COLUMNS]
    return geometry.x0 + geometry.pitch * (after - 0.5)


@inlined
def rear_to_go(lanes: Lanes, lane: int, geometry: Geometry, x: float, theta: float) -> float:
    """[m] from the rear of a parcel at x, turned by theta, to the zone's end."""
    return zone_end(lanes, lane, geometry) - x + reach_along(lanes, lane, theta, -1.0, 0.0)


@inlined
def has_left(lanes: Lanes, lane: int, geometry: Geometry) -> bool:
    """Whether the parcel's rear is past the zone's end, by the state a physics step left."""
    if lanes.state[lane, X] <= zone_end(lanes, lane, geometry):
        return False
    read_truth(lanes, lane)
    return rear_to_go(lanes, lane, geometry, lanes.truth[lane, 0], lanes.truth[lane, 2]) < 0.0


@inlined
def is_at_rest(lanes: Lanes, lane: int) -> bool:
    """Whether no point of the parcel moves faster than `STALL_SPEED`."""
    truth = lanes.truth[lane]
    speed = math.sqrt(truth[3] * truth[3] + truth[4] * truth[4])
    return speed + abs(truth[5]) * lanes.body[lane, HALF_LENGTH] < STALL_SPEED


@inlined
def failure(lanes: Lanes, lane: int, on_rotors: bool, on_surface: bool) -> int:
    """Which failure of every line task has happened; RUNNING if none."""
    if not on_surface:
        return OFF_SURFACE
    if not on_rotors:
        return OFF_LINE
    return STALLED if is_at_rest(lanes, lane) else RUNNING


@inlined
def see_parcel(lanes: Lanes, lane: int, geometry: Geometry) -> None:
    """Write `PARCEL_FEATURES` from what the sensors say."""
    sensed = lanes.sensed[lane]
    x, y, theta = sensed[0], sensed[1], sensed[2]
    offset = y - geometry.line_y
    turn = 2.0 * math.pi / geometry.pitch
    zone_start = geometry.x0 + geometry.pitch * (lanes.zone[lane, FIRST_COLUMN] - 0.5)
    see = lanes.observation[lane]
    see[0] = offset / 0.3
    see[1] = math.sin(theta)
    see[2] = math.cos(theta)
    see[3] = sensed[3] - 1.0
    see[4] = sensed[4] / 0.5
    see[5] = sensed[5] / 3.0
    see[6] = (lanes.body[lane, HALF_LENGTH] - 0.175) / 0.05
    see[7] = math.sin(turn * (x - geometry.x0))
    see[8] = math.cos(turn * (x - geometry.x0))
    see[9] = math.sin(turn * offset)
    see[10] = math.cos(turn * offset)
    see[11] = (x + reach_along(lanes, lane, theta, 1.0, 0.0) - zone_start) / 0.5
    see[12] = rear_to_go(lanes, lane, geometry, x, theta) / 0.5
