"""Observations of one parcel in SI units, and the modules around it, for compiled rules. A window
is the block of modules around a parcel that Track's actions set.

Python and the playground call the same compiled functions. So this file decodes observations in
compiled code, as the tasks' `decode` does for arrays.
"""

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym.compiler.jit import inlined
from surface_gym.config import EnvConfig
from surface_gym.tasks import track
from surface_gym.tasks.features import Column, read

from ..base import Integers, Numbers, Singles

ABSENT = Column(-1, 0.0, 0.0, 0.0, 0.0)  # column of an unobserved quantity
MIDWAY = 1e-9  # [m] tolerance of positions midway between two rows or columns
# Quantities of a line in the order of `LINE`, and of a path in the order of `PATH`.
(SIDE, SINE, COSINE, SIZE, INTO_ZONE, FRONT, REAR, OFFSET, FORWARD, LATERAL, TURNING, RATIO, ENTRY,
 TO_GO, ANGLE, WIDTH, FILL, FRICTION, LOAD_X, LOAD_Y) = range(20)  # fmt: skip
LINE = (
    "side", "sine of theta", "cosine of theta", "size", "distance into zone", "front in zone",
    "rear to go", "lateral offset", "forward speed", "lateral speed", "turning speed",
    "asked ratio", "entry speed", "to go", "asked angle", "width", "fill", "friction learned",
    "load learned, x", "load learned, y",
)  # fmt: skip
(ERROR, ACROSS, ASKED, SLOPE, SLOPE_AHEAD, TILT, P_SINE, P_COSINE, P_TURNING, P_SIZE, SPEED_ERROR,
 SINE_X, COSINE_X, SINE_Y, COSINE_Y) = range(15)  # fmt: skip
PATH = (
    "cross error", "lateral speed", "asked speed",
    *(f"slope {ahead:g} m ahead" for ahead in track.AHEAD[:2]),
    "tilt", "sine of theta", "cosine of theta", "turning speed", "size", "speed error",
    "sine of phase x", "cosine of phase x", "sine of phase y", "cosine of phase y",
)  # fmt: skip
# Quantities of a parcel that parks; the first are in the order of `PARK`.
(K_SINE, K_COSINE, K_TURNING, K_SIZE, K_FORWARD, K_LATERAL, K_ALONG, K_ACROSS, K_TURN, K_FRICTION,
 K_SINE_X, K_COSINE_X, K_SINE_Y, K_COSINE_Y, K_WIDTH, K_FILL, K_LOAD_X, K_LOAD_Y,
 ) = range(18)  # fmt: skip
PARK = (
    "sine of theta", "cosine of theta", "turning speed", "size", "forward speed", "lateral speed",
    "to go along", "to go across", "angle to turn", "friction learned",
    "sine of phase x", "cosine of phase x", "sine of phase y", "cosine of phase y", "width", "fill",
    "load learned, x", "load learned, y",
)  # fmt: skip


class Sight(NamedTuple):
    """Columns and scales of the quantities in an observation, and dimensions of the line."""

    place: Integers  # (quantities,) column of the observation; -1: unobserved
    offset: Numbers  # (quantities,) quantity at the feature 0, in its unit
    scale: Numbers  # (quantities,) difference of the quantity at the features 1 and 0
    pitch_x: float  # [m] between modules
    pitch_y: float  # [m]
    zone_length: float  # [m] length of the widest zone
    friction_spread: float  # [-] scale of the estimated friction; 0: no estimate
    load_spread: float  # [m] scale of the estimated load position
    x: Numbers  # (columns,) [m] of the modules from the zone's first edge or the window's middle
    y: Numbers  # (rows,) [m] from the line's middle or the window's


def look_at_line(config: EnvConfig) -> Sight:
    """Make the `Sight` of an environment on a line, with the modules of its zone."""
    line, kind = config.chosen_line, config.action_kind
    rows, columns = kind.shape
    x = line.pitch_x * (np.arange(columns) + 0.5)
    return _look(config, LINE, x, line.pitch_y * (np.arange(rows) - (rows - 1) / 2.0))


def look_at_path(config: EnvConfig) -> Sight:
    """Make the `Sight` that describes observations of a path, and the modules of the window."""
    line, kind = config.chosen_line, config.action_kind
    rows, columns = kind.shape
    x = line.pitch_x * (np.arange(columns) - columns // 2)
    return _look(config, PATH, x, line.pitch_y * (np.arange(rows) - rows // 2))


def look_at_park(config: EnvConfig, reach: int) -> Sight:
    """Make the `Sight` for the task Park.

    For each observed quantity, the `Sight` has the column in the observation, and the scale. It
    also has the positions of `reach` modules on each side of the parcel.
    """
    line = config.chosen_line
    near = np.arange(-reach, reach + 1)
    return _look(config, PARK, line.pitch_x * near, line.pitch_y * near)


def _look(config: EnvConfig, names: Iterable[str], x: NDArray[Any], y: NDArray[Any]) -> Sight:
    shown = [config.columns.get(name, ABSENT) for name in names]
    line, zone = config.chosen_line, config.zone
    friction_spread, load_spread = config.sensors.learned_spreads
    columns = line.zone_columns if zone is None else zone[1] - zone[0] + 1
    return Sight(
        place=np.array([each.place for each in shown]),
        offset=np.array([each.offset for each in shown], dtype=np.float64),
        scale=np.array([each.scale for each in shown], dtype=np.float64),
        pitch_x=line.pitch_x,
        pitch_y=line.pitch_y,
        zone_length=line.pitch_x * columns,
        friction_spread=friction_spread,
        load_spread=load_spread,
        x=x,
        y=y,
    )


def find_directions(config: EnvConfig) -> Numbers:
    """Return cosine and sine (choices, 2) of the available orientations."""
    angles = np.array(config.chosen_orientations)
    return np.stack([np.cos(angles), np.sin(angles)], axis=-1)


@inlined
def _read(row: Singles, sight: Sight, quantity: int) -> float:
    """Read a quantity from the observation `row`; return 0 if the quantity is not observed.

    `quantity` is the quantity's index in `sight.place`.
    """
    place = sight.place[quantity]
    if place < 0:
        return 0.0
    return read(row, Column(place, sight.offset[quantity], sight.scale[quantity], 0.0, 0.0))


class LineReading(NamedTuple):
    """Decoded observation of a parcel on a line; see `tasks.planning.LineObservation`."""

    x: float  # [m] of its centre past the zone's first edge
    y: float  # [m] of its centre from the line's middle
    theta: float  # [rad]
    cosine: float  # of theta
    sine: float
    vx: float  # [m/s]
    vy: float  # [m/s]
    omega: float  # [rad/s]
    half_length: float  # [m] of the base, taken as a square
    reach: float  # [m] of the base along x, from its centre
    side: float  # goal side: +1 for y > 0, -1 for y < 0, 0 for straight ahead or no side
    ratio: float  # [-] goal ratio to the entry speed; else 0
    entry_speed: float  # [m/s] with a goal ratio; else 0
    to_go: float  # [m] distance to the goal x; else 0
    angle: float  # [rad] goal theta; else 0
    front_in_zone: float  # [m] foremost point past the zone's first edge
    rear_to_go: float  # [m] from the rearmost point to the zone's end
    half_width: float  # [m]
    fill: float  # [-] share of the base in the rectangle around it
    friction: float  # [-] estimated factor of mu_max
    load_ahead: float  # [m] estimated x of the load from the base's centre
    wholly_in_zone: bool  # whether no module of the lead-in is under it


@inlined
def see_line(row: Singles, sight: Sight) -> LineReading:
    """Decode an observation (features,) of a parcel on a line; `sight` is from `look_at_line`."""
    side = _read(row, sight, SIDE)
    mirror = -1.0 if side < 0.0 else 1.0  # a goal at y < 0 is observed in a mirror
    shown = math.atan2(_read(row, sight, SINE), _read(row, sight, COSINE))
    theta = mirror * shown
    half_length = _read(row, sight, SIZE)
    cosine, sine = math.cos(theta), math.sin(theta)
    reach = half_length * (abs(cosine) + abs(sine))
    if sight.place[INTO_ZONE] >= 0:  # front and rear are bounds for a square
        x = _read(row, sight, INTO_ZONE) + reach
        front_in_zone = x + reach
        rear_to_go = sight.zone_length - x + reach
    else:
        front_in_zone, rear_to_go = _read(row, sight, FRONT), _read(row, sight, REAR)
        x = front_in_zone - reach
    ratio = _read(row, sight, RATIO)
    load_x, load_y = _read(row, sight, LOAD_X), _read(row, sight, LOAD_Y)
    ahead = math.cos(shown) * load_x - math.sin(shown) * load_y
    is_shown = sight.place[WIDTH] >= 0
    return LineReading(
        x,
        mirror * _read(row, sight, OFFSET),
        theta,
        cosine,
        sine,
        _read(row, sight, FORWARD),
        mirror * _read(row, sight, LATERAL),
        mirror * _read(row, sight, TURNING),
        half_length,
        reach,
        side,
        ratio,
        _read(row, sight, ENTRY) if ratio > 0.0 else 0.0,
        _read(row, sight, TO_GO),
        _read(row, sight, ANGLE),
        front_in_zone,
        rear_to_go,
        _read(row, sight, WIDTH) if is_shown else half_length,
        _read(row, sight, FILL) if is_shown else 1.0,
        1.0 + sight.friction_spread * _read(row, sight, FRICTION),
        sight.load_spread * ahead,
        x - reach > -sight.pitch_x / 2.0,
    )


class PathReading(NamedTuple):
    """Decoded observation of a parcel beside its path; see `tasks.track.PathObservation`."""

    x: float  # [m] of its centre past the middle module of the window
    y: float  # [m]
    theta: float  # [rad]
    cosine: float  # of theta
    sine: float
    vx: float  # [m/s]
    vy: float  # [m/s]
    omega: float  # [rad/s]
    half_length: float  # [m] of the base, taken as a square
    cross_error: float  # [m] offset from the path, positive to its left
    cross_speed: float  # [m/s] speed perpendicular to the path
    asked_speed: float  # [m/s]
    slope: float  # dy/dx of the path at the parcel's centre
    slope_ahead: float  # dy/dx ahead of it
    tilt: float  # [rad]


@inlined
def see_path(row: Singles, sight: Sight) -> PathReading:
    """Decode an observation (features,) of a parcel on a path. `look_at_path` returns `sight`."""
    theta = math.atan2(_read(row, sight, P_SINE), _read(row, sight, P_COSINE))
    slope = _read(row, sight, SLOPE)
    cross_speed, asked_speed = _read(row, sight, ACROSS), _read(row, sight, ASKED)
    along = asked_speed + _read(row, sight, SPEED_ERROR)
    cosine = 1.0 / math.sqrt(1.0 + slope * slope)
    sine = slope * cosine
    return PathReading(
        _read_place(row, sight, SINE_X, COSINE_X, sight.pitch_x),
        _read_place(row, sight, SINE_Y, COSINE_Y, sight.pitch_y),
        theta,
        math.cos(theta),
        math.sin(theta),
        along * cosine - cross_speed * sine,
        along * sine + cross_speed * cosine,
        _read(row, sight, P_TURNING),
        _read(row, sight, P_SIZE),
        _read(row, sight, ERROR),
        cross_speed,
        asked_speed,
        slope,
        _read(row, sight, SLOPE_AHEAD),
        math.asin(_read(row, sight, TILT)),
    )


class ParkReading(NamedTuple):
    """Decoded observation of a parcel that parks."""

    x: float  # [m] of its centre past the nearest module
    y: float  # [m]
    cosine: float  # of theta
    sine: float
    vx: float  # [m/s]
    vy: float  # [m/s]
    omega: float  # [rad/s]
    half_length: float  # [m]
    half_width: float  # [m]
    fill: float  # [-] share of the base in the rectangle around it
    along: float  # [m] x to the goal
    across: float  # [m] y to the goal
    turn: float  # [rad] goal theta - theta
    friction: float  # [-] estimated factor of mu_max
    load_x: float  # [m] estimated place of the load in the base's frame
    load_y: float  # [m]


@inlined
def see_park(row: Singles, sight: Sight) -> ParkReading:
    """Decode an observation (features,) of a parcel that parks; `sight` is from `look_at_park`."""
    half_length, is_shown = _read(row, sight, K_SIZE), sight.place[K_WIDTH] >= 0
    return ParkReading(
        _read_place(row, sight, K_SINE_X, K_COSINE_X, sight.pitch_x),
        # Phases in y count from the line's middle, halfway between two rows.
        _read_place(row, sight, K_SINE_Y, K_COSINE_Y, sight.pitch_y) - 0.5 * sight.pitch_y,
        _read(row, sight, K_COSINE),
        _read(row, sight, K_SINE),
        _read(row, sight, K_FORWARD),
        _read(row, sight, K_LATERAL),
        _read(row, sight, K_TURNING),
        half_length,
        _read(row, sight, K_WIDTH) if is_shown else half_length,
        _read(row, sight, K_FILL) if is_shown else 1.0,
        _read(row, sight, K_ALONG),
        _read(row, sight, K_ACROSS),
        _read(row, sight, K_TURN),
        1.0 + sight.friction_spread * _read(row, sight, K_FRICTION),
        sight.load_spread * _read(row, sight, K_LOAD_X),
        sight.load_spread * _read(row, sight, K_LOAD_Y),
    )


@inlined
def _read_place(row: Singles, sight: Sight, sine: int, cosine: int, pitch: float) -> float:
    """Decode a coordinate [m] of the parcel's centre, measured from the nearest module.

    The observation shows sine and cosine of a phase, which grows by 2 pi from module to module.
    `sine` and `cosine` are the indices of these two features. `pitch` [m] is the distance between
    neighbouring modules.
    """
    phase = math.atan2(_read(row, sight, sine), _read(row, sight, cosine))
    return _past(pitch * phase / (2.0 * math.pi), pitch)


@inlined
def _past(in_pitch: float, pitch: float) -> float:
    """Return a position [m] relative to the nearest module.

    `in_pitch` [m] is the position relative to the next module with a smaller coordinate. If two
    modules are equally near, the result is relative to the module with the larger coordinate.
    """
    return in_pitch - pitch if in_pitch > pitch / 2.0 - MIDWAY else in_pitch


class Motion(NamedTuple):
    """A planar velocity of the parcel."""

    vx: float  # [m/s]
    vy: float  # [m/s]
    omega: float  # [rad/s]


@inlined
def is_under(seen: LineReading | PathReading, x: float, y: float) -> bool:
    """Return whether a module is under an observed parcel, whose base is modelled as a square.

    `x` and `y` [m] are the module's position relative to the parcel's centre.
    """
    along, across = seen.cosine * x + seen.sine * y, seen.cosine * y - seen.sine * x
    return max(abs(along), abs(across)) <= seen.half_length


@inlined
def add(values: Numbers, count: int) -> float:
    """Sum the first `count` numbers, at most 128, in NumPy's order of summation."""
    if count < 8:
        total = -0.0
        for k in range(count):
            total += values[k]
        return total
    a, b, c, d = values[0], values[1], values[2], values[3]
    e, f, g, h = values[4], values[5], values[6], values[7]
    whole = count - count % 8
    for k in range(8, whole, 8):
        a += values[k]
        b += values[k + 1]
        c += values[k + 2]
        d += values[k + 3]
        e += values[k + 4]
        f += values[k + 5]
        g += values[k + 6]
        h += values[k + 7]
    total = ((a + b) + (c + d)) + ((e + f) + (g + h))
    for k in range(whole, count):
        total += values[k]
    return total
