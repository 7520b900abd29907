"""A rule that brings parcels into an order on a slope: a passage in the middle, parking beside it.

A parcel that must wait is led aside and held. Other parcels roll past it: straight on if the way is
free, else through the passage.
"""

import math
from typing import Any, NamedTuple

from surface_gym import checks
from surface_gym.compiler.jit import compiled, inlined, linked
from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.flow.slope_tasks import PLACE, Sequence
from surface_gym.tasks.features import read

from ..base import Integers, Numbers, Singles
from .base import rule
from .slopes import (
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
)

ALIGNMENT = math.radians(8.0)  # angle limit: aligned parcels are narrower


class Parking(NamedTuple):
    """Places for waiting parcels."""

    beside: float = 0.47  # [m] distance of waiting parcels from the middle
    passage: float = 0.22  # [m] half width of the passage
    spacing: float = 0.08  # [m] distance behind a predecessor
    leading_out: float = 0.07  # [m] additional distance behind a parcel to be passed
    stop: float = 0.35  # [m] distance of the first waiting parcel from the end
    near: float = 0.02  # [m] tolerance of a waiting position


@linked
def sort_by_place(table: Singles, order: Integers) -> int:
    """Write the rows of parcels in order of departure; return their number."""
    count = 0
    for k in range(table.shape[0]):
        if not ta.is_there(table[k]):
            continue
        place = count
        own = read(table[k], PLACE)
        while place > 0 and read(table[order[place - 1]], PLACE) > own:
            order[place] = order[place - 1]
            place -= 1
        order[place] = k
        count += 1
    for place in range(count, order.shape[0]):
        order[place] = NOBODY
    return count


@inlined
def _overlap(parcels: SlopeParcels, j: int, k: int) -> bool:
    """Return whether two parcels overlap across the line, so that they would meet."""
    across = parcels.across[j] + parcels.across[k]
    return abs(parcels.y[j] - parcels.y[k]) < across - 0.005


@inlined
def _must_wait(parcels: SlopeParcels, order: Integers, ready: int, place: int) -> bool:
    """Return whether a predecessor of a parcel has not arrived, or is behind it."""
    if place >= ready:
        return True
    k = order[place]
    for before in range(place):
        j = order[before]
        if parcels.x[j] < parcels.x[k] + 0.5 * (parcels.along[k] - parcels.along[j]):
            return True
    return False


@linked
def find_parking(
    slope: Slope, parking: Parking, parcels: SlopeParcels, order: Integers, count: int, place: int
) -> tuple[float, float]:
    """Find the waiting position of a parcel: y [m], and maximum x [m] of its front.

    A parcel keeps its side. In the middle, it chooses the side with fewer waiting predecessors.
    """
    k = order[place]
    room_left = room_right = slope.length - parking.stop
    cost_left = cost_right = 0.0
    for other in range(count):
        j = order[other]
        if j == k or parcels.x[j] <= parcels.x[k]:
            continue
        passes = other > place
        rear = parcels.x[j] - parcels.along[j]
        rear -= parking.spacing
        if passes:
            rear -= parking.leading_out + parcels.across[j] + parcels.across[k]
        if parcels.y[j] + parcels.across[j] > parking.passage:
            room_left = min(room_left, rear)
            cost_left += 1.0 if passes else 0.0
        if parcels.y[j] - parcels.across[j] < -parking.passage:
            room_right = min(room_right, rear)
            cost_right += 1.0 if passes else 0.0
    front = parcels.x[k] + parcels.along[k] + parking.beside
    cost_left += 10.0 * max(0.0, front - room_left) - 0.1 * room_left
    cost_right += 10.0 * max(0.0, front - room_right) - 0.1 * room_right
    if abs(parcels.y[k]) > 0.08:
        side = math.copysign(1.0, parcels.y[k])
    else:
        side = 1.0 if cost_left <= cost_right else -1.0
    y = min(parking.beside, slope.half_width - parcels.across[k] - 0.01)
    y = max(y, min(slope.half_width - parcels.across[k], parking.passage + parcels.across[k]))
    return side * y, room_left if side > 0.0 else room_right


@linked
def limit_in_order(
    slope: Slope,
    tuning: Tuning,
    parcels: SlopeParcels,
    order: Integers,
    count: int,
    k: int,
    free: bool,
) -> float:
    """Return the speed limit [m/s] at which a parcel keeps clear of parcels ahead.

    Behind a parcel to be passed, it keeps room for the lateral motion until its way is free.
    """
    limit = math.inf
    for place in range(count):
        j = order[place]
        if j == k or parcels.x[j] <= parcels.x[k] or not _overlap(parcels, j, k):
            continue
        room = parcels.x[j] - parcels.x[k] - parcels.along[j] - parcels.along[k]
        shift = parcels.shift[k]
        if shift != 0.0:
            aside = parcels.y[k] + shift - parcels.y[j]
            past = parcels.across[j] + parcels.across[k]
            away = past - math.copysign(1.0, shift) * (parcels.y[k] - parcels.y[j])
            if abs(aside) >= past - 0.005:
                if free and away + 0.02 < room:
                    continue
                room -= away + 0.03
        room -= 0.3 * tuning.clear
        limit = min(limit, follow(slope, tuning, room, max(0.0, parcels.vx[j])))
    return limit


@linked
def is_free(parcels: SlopeParcels, order: Integers, count: int, k: int) -> bool:
    """Return whether the way aside of parcel `k` is free, now and when it arrives.

    Parcels that overlap parcel `k` across the slope do not count, since they are ahead of it or
    behind it.
    """
    shift = parcels.shift[k]
    for place in range(count):
        j = order[place]
        ahead = parcels.x[j] - parcels.x[k]
        aside = math.copysign(1.0, shift) * (parcels.y[j] - parcels.y[k])
        long, wide = parcels.along[j] + parcels.along[k], parcels.across[j] + parcels.across[k]
        if j == k or aside < wide - 0.005 or aside >= abs(shift) + wide + 0.01:
            continue
        nears = 0.5 * max(0.0, parcels.vx[j] - parcels.vx[k])
        if -(long + 0.02 + nears) < ahead < long + 0.05 + aside - wide:
            return False
    return True


@compiled
def choose_in_order(
    tables: Singles, slope: Slope, tuning: Tuning, parking: Parking, parcels: SlopeParcels,
    slots: Slots, order: Integers, came: Numbers, brakes: Brakes, halves: Integers,
) -> None:  # fmt: skip
    """Choose halves (num_envs, rows, 2) so that parcels depart in order."""
    for i in range(tables.shape[0]):
        table = tables[i]
        read_parcels(table, slope, tuning, parcels)
        count = sort_by_place(table, order[i])
        for k in range(table.shape[0]):
            time = read(table[k], ta.COLUMN.time)
            if read(table[k], ta.COLUMN.present) > 0.5 and time < came[i, k]:
                brakes.due[i, k] = 0.5
            came[i, k] = time
        ready = 0  # number of parcels at the head of the order that have arrived
        while ready < count and read(table[order[i, ready]], PLACE) < ready + 0.5:
            ready += 1
        forget_slots(slots)
        for place in range(count):
            k = order[i, place]
            distance = find_distance(slope, parcels, k)
            parcels.shift[k] = 0.0
            waits = _must_wait(parcels, order[i], ready, place)
            if waits:
                y, front = find_parking(slope, parking, parcels, order[i], count, place)
                if abs(y - parcels.y[k]) > parking.near:
                    parcels.shift[k] = y - parcels.y[k]
                # It moves equally far along the line and aside.
                room = front - parcels.x[k] - parcels.along[k] - abs(parcels.shift[k])
                speed = stopping_speed(slope, tuning, room)
                free = is_free(parcels, order[i], count, k)
                if parcels.shift[k] != 0.0 and free:
                    speed = max(speed, 0.25)
                room = slope.length - 0.1 - parcels.x[k] - parcels.along[k]
                speed = min(speed, stopping_speed(slope, tuning, room))
            else:
                _lead_out(parking, parcels, order[i], count, place)
                free = is_free(parcels, order[i], count, k)
                late = abs(parcels.shift[k]) * tuning.shift_cost
                slot = rolling_time(slope, distance, parcels.vx[k]) + late
                slot = max(slot, find_slot(slope, tuning, parcels, slots, k))
                give_slot(slope, parcels, slots, k, slot)
                time = slot - late - min(0.02, 0.02 * distance)
                speed = speed_for(slope, distance, time)
                gained = min(slope.take_away, speed + slope.rolls * slope.period)
                speed = gained if speed > 0.0 else 0.0
            limit = limit_in_order(slope, tuning, parcels, order[i], count, k, free)
            speed = min(speed, limit)
            choose_halves(slope, tuning, parcels, k, speed, free, brakes, i, halves[i, k])
            if not free or parcels.shift[k] == 0.0:
                hold(parcels, k, speed, halves[i, k])


@inlined
def _lead_out(
    parking: Parking, parcels: SlopeParcels, order: Integers, count: int, place: int
) -> None:
    """Lead a parcel into the passage if a waiting parcel is ahead of it."""
    k = order[place]
    for after in range(place + 1, count):
        j = order[after]
        if parcels.x[j] > parcels.x[k] and _overlap(parcels, j, k):
            if abs(parcels.y[k]) > parking.near:
                parcels.shift[k] = -parcels.y[k]
            break


@rule("pass and park", "sequence", actions="parcels", is_prior=True)
class PassAndPark(SlopeRule):
    """Bring parcels into order: a parcel that must wait is parked beside a passage."""

    kernel = staticmethod(choose_in_order)

    def __init__(
        self, config: EnvConfig, tuning: Tuning | None = None, parking: Parking | None = None
    ) -> None:
        checks.instance("task", config.task, Sequence, "a Sequence")
        super().__init__(config, tuning)
        self._slope = self._slope._replace(alignment=min(self._slope.alignment, ALIGNMENT))
        self._parking = Parking() if parking is None else parking

    def arguments(self, tables: Singles, memory: SlopeMemory, halves: Integers) -> tuple[Any, ...]:
        tables, slope, tuning, *more = super().arguments(tables, memory, halves)
        return (tables, slope, tuning, self._parking, *more)
