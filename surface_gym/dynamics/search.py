"""The line search of the friction step: where along a Newton direction the potential is least."""

import math

from surface_gym.dynamics.compiled import inlined, linked
from surface_gym.dynamics.types import (
    ARM_X,
    ARM_Y,
    AXIS_X,
    AXIS_Y,
    KINK_1,
    KINK_2,
    KINK_3,
    KINK_4,
    KINKS,
    MU_ACROSS,
    MU_ALONG,
    NORMAL,
    RATE_ACROSS,
    RATE_ALONG,
    SLIDE_ACROSS,
    SLIDE_ALONG,
    SLOPE,
    SUPPORT,
    Contacts,
    Scratch,
)

MAX_SEARCHES = 60
SEARCH_SLOPE = 0.01  # share of the starting slope that may be left


@inlined
def _prepare(
    scratch: Scratch,
    contacts: Contacts,
    vx: float,
    vy: float,
    omega: float,
    dx: float,
    dy: float,
    dw: float,
    rounding: float,
) -> None:
    """Write each contact's velocity, its change along the search, and its kinks."""
    table = scratch.table
    for i in range(contacts.total):
        x = table[ARM_X + i]
        y = table[ARM_Y + i]
        ax = table[AXIS_X + i]
        ay = table[AXIS_Y + i]
        ux = vx - omega * y
        uy = vy + omega * x
        sx = dx - dw * y
        sy = dy + dw * x
        along = ax * ux + ay * uy
        along_rate = ax * sx + ay * sy
        across = ax * uy - ay * ux
        across_rate = ax * sy - ay * sx
        table[SLIDE_ALONG + i] = along
        table[RATE_ALONG + i] = along_rate
        table[SLIDE_ACROSS + i] = across
        table[RATE_ACROSS + i] = across_rate
        # Where a rate is 0 these are infinite or not a number, so near to nothing.
        table[KINK_1 + i] = (-rounding - along) / along_rate
        table[KINK_2 + i] = (rounding - along) / along_rate
        table[KINK_3 + i] = (-rounding - across) / across_rate
        table[KINK_4 + i] = (rounding - across) / across_rate


@inlined
def _slope(scratch: Scratch, contacts: Contacts, t: float, rounding: float) -> float:
    """Derivative of Phi along the search at t."""
    table = scratch.table
    per_rounding = 1.0 / rounding
    for i in range(contacts.total):
        u = table[SLIDE_ALONG + i] + t * table[RATE_ALONG + i]
        v = table[SLIDE_ACROSS + i] + t * table[RATE_ACROSS + i]
        along = table[MU_ALONG + i] * min(1.0, max(-1.0, u * per_rounding))
        across = table[MU_ACROSS + i] * min(1.0, max(-1.0, v * per_rounding))
        table[SLOPE + i] = table[NORMAL + i] * (
            along * table[RATE_ALONG + i] + across * table[RATE_ACROSS + i]
        )
    for k in range(contacts.supports):
        i = scratch.marks[SUPPORT + k]
        u = table[SLIDE_ALONG + i] + t * table[RATE_ALONG + i]
        v = table[SLIDE_ACROSS + i] + t * table[RATE_ACROSS + i]
        share = table[MU_ALONG + i] / max(rounding, math.sqrt(u * u + v * v))
        along = share * u
        across = share * v
        table[SLOPE + i] = table[NORMAL + i] * (
            along * table[RATE_ALONG + i] + across * table[RATE_ACROSS + i]
        )
    total = 0.0
    for i in range(contacts.total):
        total += table[SLOPE + i]
    return total


@inlined
def _keep_kinks(scratch: Scratch, count: int) -> int:
    """Write the kinks within the search one after the other; how many there are.

    A kink is where a contact passes between sliding and held.
    """
    table = scratch.table
    kept = 0
    for i in range(count):
        for kink in (KINK_1, KINK_2, KINK_3, KINK_4):
            t = table[kink + i]
            table[KINKS + kept] = t
            kept += (t > 0.0) & (t < 1.0)
    return kept


@inlined
def _kink_nearest_middle(scratch: Scratch, kinks: int, low: float, high: float) -> float:
    """The kink nearest to the middle of (low, high); negative if there is none."""
    middle = 0.5 * (low + high)
    distance = 0.5 * (high - low) * (1.0 - 1e-9)
    nearest = -1.0
    for k in range(kinks):
        t = scratch.table[KINKS + k]
        if abs(t - middle) < distance:
            distance = abs(t - middle)
            nearest = t
    return nearest


@linked
def step_length(
    scratch: Scratch,
    contacts: Contacts,
    dt: float,
    vx: float,
    vy: float,
    omega: float,
    dx: float,
    dy: float,
    dw: float,
    start: float,
    rate: float,
    end: float,
    rounding: float,
) -> float:
    """Step length in (0, 1) at the minimum along a Newton direction (dx, dy, dw).

    The slope increases and, over rotors, is linear between its kinks: bracket it between two
    kinks and the secant is exact. Over supports it is nearly so, and the secant repeats.

    Args:
        start: slope of the whole objective at 0, negative.
        rate: growth of the inertial part's slope from 0 to 1.
        end: slope at 1, positive.
        rounding: [m/s] contact speed below which a rotor is held.
    """
    _prepare(scratch, contacts, vx, vy, omega, dx, dy, dw, rounding)
    kinks = _keep_kinks(scratch, contacts.total)
    low, high = 0.0, 1.0
    at_low, at_high = start, end
    inertial = start - dt * _slope(scratch, contacts, 0.0, rounding)
    t = -1.0
    kinks_left = True
    for _ in range(MAX_SEARCHES):
        if kinks_left:
            t = _kink_nearest_middle(scratch, kinks, low, high)
            kinks_left = t >= 0.0
        if not kinks_left:
            t = low - at_low * (high - low) / (at_high - at_low)
        slope = inertial + t * rate + dt * _slope(scratch, contacts, t, rounding)
        if abs(slope) <= -SEARCH_SLOPE * start:
            break
        if slope < 0.0:
            low, at_low = t, slope
        else:
            high, at_high = t, slope
    return t
