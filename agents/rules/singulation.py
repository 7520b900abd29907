"""Rules that singulate parcels on a slope: time slots at the end, and hold-and-release.

Both turn parcels and lead them to the mouth in the same way. They brake differently.
"""

import math
from typing import Any

from surface_gym import checks
from surface_gym.compiler.jit import compiled, inlined, linked
from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.tasks.features import read

from ..base import Integers, Numbers, Singles
from .base import rule
from .slopes import (
    HELD,
    NOBODY,
    Brakes,
    Slope,
    SlopeMemory,
    SlopeParcels,
    SlopeRule,
    Slots,
    Tuning,
    choose_halves,
    find_distance,
    find_slot,
    follow,
    forget_slots,
    give_slot,
    hold,
    read_parcels,
    rolling_time,
    speed_for,
    stopping_speed,
)  # fmt: skip

NEAR = 0.3  # [m] distance behind a standing parcel from which another may pass it
LONG = 15  # standing periods after which a parcel lets another pass
HOLD_AT = 0.15  # [m] distance of a parcel's middle from the end while the take-away stands
HOLD = 0.5  # [m] distance from the end at which parcels are held


@linked
def sort_by_progress(
    table: Singles,
    parcels: SlopeParcels,
    order: Integers,
    came: Numbers,
    stood: Integers,
    swap: float,
) -> int:
    """Update the order of departure (rows,); return the number of parcels in it.

    Departed parcels are removed, and new ones are added at the end. A parcel sufficiently far ahead
    of its predecessor overtakes it in the order. A parcel with a remaining way aside that has stood
    for long lets the next parcel pass, if that parcel is near and has no way aside.

    Args:
        came: (rows,) last observed time since entry.
        stood: (rows,) control periods without motion.
    """
    count = 0
    for place in range(order.shape[0]):
        k = order[place]
        if k == NOBODY:
            break
        row = table[k]
        if ta.is_there(row) and read(row, ta.COLUMN.time) > came[k]:
            order[count] = k
            count += 1
        else:
            came[k] = -math.inf
    for k in range(table.shape[0]):
        row = table[k]
        if not ta.is_there(row):
            came[k] = -math.inf
            continue
        if came[k] == -math.inf:
            order[count] = k
            count += 1
        came[k] = read(row, ta.COLUMN.time)
    for place in range(count, order.shape[0]):
        order[place] = NOBODY
    for place in range(1, count):
        j = place
        while j > 0 and parcels.x[order[j]] > parcels.x[order[j - 1]] + swap:
            order[j], order[j - 1] = order[j - 1], order[j]
            j -= 1
    for place in range(count - 1):
        k, other = order[place], order[place + 1]
        near = parcels.x[k] - parcels.x[other] < parcels.along[k] + parcels.along[other] + NEAR
        if parcels.shift[k] != 0.0 and stood[k] >= LONG and parcels.shift[other] == 0.0 and near:
            order[place], order[place + 1] = other, k
    return count


@linked
def limit_speed(
    slope: Slope, tuning: Tuning, parcels: SlopeParcels, order: Integers, count: int, place: int
) -> float:
    """Compute the speed limit [m/s] of the parcel at a place of the order.

    The parcel keeps clear of parcels ahead. It follows its predecessor into the same mouth; the
    required gap grows with its progress down the slope. It waits before the point where it can no
    longer be led aside, and stays on the surface while the take-away stands still.
    """
    k = order[place]
    x, y, vx = parcels.x[k], parcels.y[k], parcels.vx[k]
    limit = math.inf
    for other in range(count):
        j = order[other]
        beside = abs(parcels.y[j] - y) >= parcels.across[j] + parcels.across[k] - 0.01
        if j == k or parcels.x[j] <= x or beside:
            continue
        room = parcels.x[j] - x - parcels.along[j] - parcels.along[k] - tuning.clear
        limit = min(limit, follow(slope, tuning, room, max(0.0, parcels.vx[j])))
    for before in range(place - 1, -1, -1):
        j = order[before]
        meet = abs(parcels.y[j] + parcels.shift[j] - y - parcels.shift[k])
        if parcels.mouth[j] != parcels.mouth[k]:
            continue
        if meet < parcels.across[j] + parcels.across[k]:
            near = min(1.0, max(0.0, (x - 0.3) / (tuning.merged * slope.length)))
            room = (parcels.along[j] + parcels.along[k]) * (2.0 * near - 1.0)
            room += near * (tuning.clear + tuning.headway * max(0.0, vx))
            room = parcels.x[j] - x - room
            speed = max(0.0, parcels.vx[j])
            if room > 0.0:
                limit = min(limit, follow(slope, tuning, room, speed))
            else:
                limit = min(limit, max(0.0, speed * (1.0 + tuning.yielding * room)))
        break
    if parcels.shift[k] != 0.0:
        room = slope.length - tuning.shift_room - x - abs(parcels.shift[k])
        limit = min(limit, stopping_speed(slope, tuning, room))
    if not parcels.runs[k]:
        room = slope.length - HOLD_AT - x
        limit = min(limit, stopping_speed(slope, tuning, room))
    return limit


@inlined
def is_way_clear(
    tuning: Tuning, parcels: SlopeParcels, order: Integers, count: int, k: int
) -> bool:
    """Return whether no other parcel is beside a parcel, or where it would be led to."""
    shift = parcels.shift[k]
    for place in range(count):
        j = order[place]
        if j == k:
            continue
        ahead, aside = parcels.x[j] - parcels.x[k], parcels.y[j] - parcels.y[k]
        long, wide = parcels.along[j] + parcels.along[k], parcels.across[j] + parcels.across[k]
        if not -(long + tuning.behind) < ahead < long + tuning.ahead + abs(shift):
            continue
        # A parcel right behind does not prevent leading a standing parcel away.
        if ahead < -0.7 * long and abs(aside) < wide - 0.005 and parcels.vx[k] < HELD:
            continue
        if (aside > 0.0) != (shift > 0.0) or abs(aside) >= abs(shift) + wide + tuning.beside:
            continue
        if ahead > long and parcels.vx[j] > parcels.vx[k]:
            continue
        return False
    return True


@inlined
def move(
    slope: Slope, tuning: Tuning, parcels: SlopeParcels, order: Integers, count: int, place: int,
    speed: float, brakes: Brakes, i: int, halves: Integers,
) -> None:  # fmt: skip
    """Choose the halves of a parcel for a goal speed [m/s], limited by the parcels around it."""
    k = order[place]
    speed = min(speed, limit_speed(slope, tuning, parcels, order, count, place))
    clear = is_way_clear(tuning, parcels, order, count, k)
    choose_halves(slope, tuning, parcels, k, speed, clear, brakes, i, halves[i, k])
    aside = clear and parcels.shift[k] != 0.0
    if not parcels.runs[k] or (slope.dwell > 1 and not aside):
        hold(parcels, k, speed, halves[i, k])


@compiled
def choose_by_slots(
    tables: Singles, slope: Slope, tuning: Tuning, parcels: SlopeParcels, slots: Slots,
    order: Integers, came: Numbers, brakes: Brakes, halves: Integers,
) -> None:  # fmt: skip
    """Choose halves (num_envs, rows, 2) that bring each parcel to the end at its time slot.

    A slot begins as soon as the parcel can arrive, but at least the asked gap after the previous
    slot. An early parcel is braked, so that it arrives on time at the take-away's speed.
    """
    for i in range(tables.shape[0]):
        read_parcels(tables[i], slope, tuning, parcels)
        count = sort_by_progress(
            tables[i], parcels, order[i], came[i], brakes.stood[i], tuning.swap
        )
        forget_slots(slots)
        for place in range(count):
            k = order[i, place]
            distance = find_distance(slope, parcels, k)
            late = 0.0  # [s] time lost by remaining turns and shifts
            if parcels.shift[k] != 0.0:
                late += tuning.shift_time + abs(parcels.shift[k]) * tuning.shift_cost
            if slope.alignment < ta.EIGHTH - 1e-9 and abs(parcels.turn[k]) > tuning.turned:
                late += tuning.turn_cost * abs(parcels.turn[k])
            slot = rolling_time(slope, distance, parcels.vx[k]) + late
            slot = max(slot, find_slot(slope, tuning, parcels, slots, k))
            give_slot(slope, parcels, slots, k, slot)
            # Aim a little early, since a delay cannot be made up.
            time = slot - late - min(0.02, 0.02 * distance)
            speed = speed_for(slope, distance, time)
            speed = min(slope.take_away, speed + slope.rolls * slope.period) if speed > 0.0 else 0.0
            move(slope, tuning, parcels, order[i], count, place, speed, brakes, i, halves)


@compiled
def choose_by_release(
    tables: Singles, slope: Slope, tuning: Tuning, parcels: SlopeParcels, slots: Slots,
    order: Integers, came: Numbers, brakes: Brakes, halves: Integers, stop: float,
) -> None:  # fmt: skip
    """Choose halves (num_envs, rows, 2) that stop parcels at a distance [m] before the end.

    A parcel is released when it will depart with the required gap behind its predecessor.
    """
    for i in range(tables.shape[0]):
        read_parcels(tables[i], slope, tuning, parcels)
        count = sort_by_progress(
            tables[i], parcels, order[i], came[i], brakes.stood[i], tuning.swap
        )
        forget_slots(slots)
        for place in range(count):
            k = order[i, place]
            distance = find_distance(slope, parcels, k)
            after = find_slot(slope, tuning, parcels, slots, k)
            slot = rolling_time(slope, distance, parcels.vx[k])
            room = distance - stop - parcels.along[k]
            speed = slope.take_away
            if room > -0.02 and (slot < after or parcels.shift[k] != 0.0):
                speed = stopping_speed(slope, tuning, room)
            give_slot(slope, parcels, slots, k, max(slot, after))
            move(slope, tuning, parcels, order[i], count, place, speed, brakes, i, halves)


@rule("time slots", "singulate", "merge", actions="parcels", is_prior=True)
class TimeSlots(SlopeRule):
    """Give each parcel a time slot at the end, and brake early parcels."""

    kernel = staticmethod(choose_by_slots)


@rule("hold and release", "singulate", "merge", actions="parcels")
class HoldAndRelease(SlopeRule):
    """Hold parcels before the end, and release them one by one: zero-pressure accumulation.

    Args:
        hold: [m] distance from a held parcel's front to the end.
    """

    kernel = staticmethod(choose_by_release)

    def __init__(self, config: EnvConfig, tuning: Tuning | None = None, hold: float = HOLD) -> None:
        super().__init__(config, tuning)
        self._hold = checks.not_negative("hold", hold, self._slope.length)

    def arguments(self, tables: Singles, memory: SlopeMemory, halves: Integers) -> tuple[Any, ...]:
        return (*super().arguments(tables, memory, halves), self._hold)
