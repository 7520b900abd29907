"""Kinds of driven modules for streams: on a sorter, and on a surface before a take-away."""

import math
from collections.abc import Callable
from functools import partial

from surface_gym.config import QUARTER_TURN
from surface_gym.modules import Belt, DrivenModule, OmniModule, PopUp, SteeredRoller

DIAGONAL = math.sqrt(2.0)  # speed of a pop-up aside, relative to the stream's speed
GENTLE, STEEP = math.radians(10.0), math.radians(30.0)  # [rad] headings aside
RISE = QUARTER_TURN  # [s] until the belts of a pop-up have risen


def _for_stream(
    kind: Callable[..., DrivenModule], heading: float, speed: float, acceleration: float
) -> DrivenModule:
    """Return driven modules that move parcels straight on, or aside at the angle `heading` [rad].

    In either case, parcels can keep `speed` [m/s] along the line. The modules change their surface
    velocity by `acceleration` [m/s^2].
    """
    speeds, headings = (speed, speed / math.cos(heading)), (0.0, heading, -heading)
    return kind(acceleration, speeds, headings, conveyor=speed)


def _pop_up(speed: float, acceleration: float) -> DrivenModule:
    """Return pop-up modules for parcels at `speed` [m/s]. Raised belts move the parcels aside.

    A finite `acceleration` [m/s^2] is replaced by another acceleration: a change of direction then
    lasts `RISE` [s].
    """
    fast = DIAGONAL * speed
    if acceleration != math.inf:
        acceleration = math.hypot(speed, fast) / RISE
    return PopUp(acceleration, (speed, fast), conveyor=speed)


# Functions of a speed [m/s] and an acceleration [m/s^2], by name.
STREAM_KINDS: dict[str, Callable[..., DrivenModule]] = {
    "pop-up": _pop_up,
    "steered rollers, 10 deg": partial(_for_stream, SteeredRoller, GENTLE),
    "steered rollers, 30 deg": partial(_for_stream, SteeredRoller, STEEP),
    "omni-wheels, 10 deg": partial(_for_stream, OmniModule, GENTLE),
}

FINE = tuple(round(0.1 * k, 1) for k in range(1, 100))  # [m/s] speeds of a drive with many speeds
AROUND = tuple(math.radians(15.0 * k) for k in range(-6, 7))  # [rad] ahead and aside


def _to_take_away(
    kind: Callable[..., DrivenModule], headings: tuple[float, ...], speed: float,
    acceleration: float,
) -> DrivenModule:  # fmt: skip
    """Return driven modules for a surface before a take-away conveyor.

    A module's surface is at rest, or runs at a speed of up to the conveyor's `speed` [m/s].
    `headings` are directions of motion [rad], anti-clockwise from +x. The velocity of a module's
    surface changes by `acceleration` [m/s^2].
    """
    between = () if kind is PopUp else tuple(each for each in FINE if each < speed)
    return kind(acceleration, (0.0, *between, speed), headings, conveyor=speed)


AHEAD_ONLY = COLUMN_BELTS, BELTS = "belts, one a column", "belts, one a module"
# Functions of the speed of a take-away [m/s] and an acceleration [m/s^2], by name.
TAKE_AWAY_KINDS: dict[str, Callable[..., DrivenModule]] = {
    COLUMN_BELTS: partial(_to_take_away, Belt, (0.0,)),
    BELTS: partial(_to_take_away, Belt, (0.0,)),
    "pop-up": partial(_to_take_away, PopUp, PopUp.headings),
    "steered rollers": partial(_to_take_away, SteeredRoller, AROUND),
    "omni-wheels": partial(_to_take_away, OmniModule, AROUND),
}
