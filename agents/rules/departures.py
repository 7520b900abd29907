"""Rules on a slope: time slots, hold and release, and a required order by parking.
Parcels roll down the slope and leave through a mouth, an exit at the slope's end, onto a take-away
conveyor. The order lists parcels by departure. A time slot is a time for passing the slope's end.
To move aside is to move across the slope. A parcel moves aside to be in front of its mouth, or to
wait (park) beside the passage. The passage is a free way in the middle of the slope.

`TimeSlots` and `HoldAndRelease` turn parcels and lead them to the mouth in the same way, but brake
differently. `PassAndPark` brings parcels into a required order. If a parcel must wait, the rule
leads it aside and holds it. Other parcels pass it, straight on or through the passage.
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
ALIGNMENT = math.radians(8.0)  # angle limit of an order: aligned parcels are narrower


@linked
def sort_by_progress(
    table: Singles,
    parcels: SlopeParcels,
    order: Integers,
    came: Numbers,
    stood: Integers,
    swap: float,
) -> int:
    """Update the order of departure (rows,); return the number of parcels in the order.

    Departed parcels are removed, and new parcels are added at the end. Two neighbours in the order
    are exchanged if the later parcel is more than `swap` [m] farther down the slope. Suppose that
    the earlier parcel has stood for long and must still move aside. If the later parcel is close
    behind and need not move aside, the two parcels are also exchanged. The array `came` (rows,) [s]
    holds the time on the surface that each parcel had at the last call. This call updates `came`.
    The array `stood` (rows,) counts control periods without motion.
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
    slope: Slope, tuning: Tuning, parcels: SlopeParcels, order: Integers, count: int, place: int,
    clear: float,
) -> float:  # fmt: skip
    """Compute the speed limit [m/s] of the parcel at position `place` of the order.

    `order` (rows,) lists the rows of `count` parcels. The parcel keeps a distance `clear` [m] from
    parcels ahead. The predecessor is the previous parcel of the order with the same mouth. The
    parcel keeps a gap to the predecessor, and this gap grows down the slope. If the parcel must
    still move aside, the parcel stops with enough room for this motion. If the take-away conveyor
    stands still, the parcel stays on the surface.
    """
    k = order[place]
    x, y, vx = parcels.x[k], parcels.y[k], parcels.vx[k]
    limit = math.inf
    for other in range(count):
        j = order[other]
        beside = abs(parcels.y[j] - y) >= parcels.across[j] + parcels.across[k] - 0.01
        if j == k or parcels.x[j] <= x or beside:
            continue
        room = parcels.x[j] - x - parcels.along[j] - parcels.along[k] - clear
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
    tuning: Tuning, parcels: SlopeParcels, order: Integers, count: int, place: int, yields: float
) -> bool:
    """Return whether the parcel at position `place` of the order can move aside without contact.

    A following parcel is no obstacle if the following parcel departs later, and if its speed
    exceeds the moving parcel's speed by less than `yields` [m/s].
    """
    k = order[place]
    shift = parcels.shift[k]
    for other in range(count):
        j = order[other]
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
        faster = parcels.vx[j] - parcels.vx[k]
        if ahead > long and faster > 0.0:
            continue
        if ahead < -long and faster < yields and other > place:
            continue
        return False
    return True


@inlined
def move(
    slope: Slope, tuning: Tuning, parcels: SlopeParcels, order: Integers, count: int, place: int,
    speed: float, brakes: Brakes, i: int, halves: Integers,
) -> None:  # fmt: skip
    """Write the actions `halves[i, k]` for the parcel `k = order[place]` in environment `i`.

    `speed` [m/s] is the parcel's goal speed; other parcels may lower this speed. `halves` has the
    shape (num_envs, rows, 2). Action 0 is for the modules ahead of a parcel's centre, and action 1
    is for the modules behind the centre.
    """
    k = order[place]
    speed = min(speed, limit_speed(slope, tuning, parcels, order, count, place, tuning.clear))
    clear = is_way_clear(tuning, parcels, order, count, place, -math.inf)
    choose_halves(slope, tuning, parcels, k, speed, clear, brakes, i, halves[i, k])
    aside = clear and parcels.shift[k] != 0.0
    if not parcels.runs[k] or (slope.dwell > 1 and not aside):
        hold(parcels, k, speed, halves[i, k])


@inlined
def arrive_in_slot(
    slope: Slope, tuning: Tuning, parcels: SlopeParcels, slots: Slots, k: int, late: float
) -> float:
    """Give parcel `k` the next time slot of its mouth; return the speed [m/s] to arrive in time.

    `late` [s] is the time that the parcel will lose by turning and moving aside.
    """
    distance = find_distance(slope, parcels, k)
    slot = rolling_time(slope, distance, parcels.vx[k]) + late
    slot = max(slot, find_slot(slope, tuning, parcels, slots, k))
    give_slot(slope, parcels, slots, k, slot)
    # Aim a little early, since a delay cannot be made up.
    time = slot - late - min(0.02, 0.02 * distance)
    speed = speed_for(slope, distance, time)
    return min(slope.take_away, speed + slope.rolls * slope.period) if speed > 0.0 else 0.0


@inlined
def plan_by_slot(
    slope: Slope, tuning: Tuning, parcels: SlopeParcels, slots: Slots, k: int
) -> float:
    """Return the speed [m/s] that brings parcel `k` to the slope's end in its time slot.

    The parcel gets the earliest slot that it can reach with the required gap to the previous slot.
    A parcel that would arrive early is braked, and arrives on time at the take-away's speed.
    """
    late = 0.0
    if parcels.shift[k] != 0.0:
        late += tuning.shift_time + abs(parcels.shift[k]) * tuning.shift_cost
    if slope.alignment < ta.EIGHTH - 1e-9 and abs(parcels.turn[k]) > tuning.turned:
        late += tuning.turn_cost * abs(parcels.turn[k])
    return arrive_in_slot(slope, tuning, parcels, slots, k, late)


@inlined
def plan_by_release(
    slope: Slope, tuning: Tuning, parcels: SlopeParcels, slots: Slots, k: int
) -> float:
    """Return the speed [m/s] from which parcel `k` can stop `HOLD` [m] before the slope's end.

    If the parcel is released, return the take-away's speed instead. The parcel is released if it
    has passed the stopping point. The parcel is also released if it need not move aside and will
    keep the required gap.
    """
    distance = find_distance(slope, parcels, k)
    after = find_slot(slope, tuning, parcels, slots, k)
    slot = rolling_time(slope, distance, parcels.vx[k])
    room = distance - HOLD - parcels.along[k]
    speed = slope.take_away
    if room > -0.02 and (slot < after or parcels.shift[k] != 0.0):
        speed = stopping_speed(slope, tuning, room)
    give_slot(slope, parcels, slots, k, max(slot, after))
    return speed


def _make_kernel(plan: Any) -> Any:
    def choose_one_by_one(
        tables: Singles, slope: Slope, tuning: Tuning, parcels: SlopeParcels, slots: Slots,
        order: Integers, came: Numbers, brakes: Brakes, halves: Integers,
    ) -> None:  # fmt: skip
        """Write actions `halves` (num_envs, rows, 2), so that parcels depart one by one.

        A parcel has an action for the modules ahead of its centre, and an action for the modules
        behind its centre. `tables` has the shape (num_envs, rows, features). `order`, `came` and
        `brakes` are the fields of a `SlopeMemory`.
        """
        for i in range(tables.shape[0]):
            read_parcels(tables[i], slope, tuning, parcels)
            count = sort_by_progress(
                tables[i], parcels, order[i], came[i], brakes.stood[i], tuning.swap
            )
            forget_slots(slots)
            for place in range(count):
                speed = plan(slope, tuning, parcels, slots, order[i, place])
                move(slope, tuning, parcels, order[i], count, place, speed, brakes, i, halves)

    return compiled(choose_one_by_one)


@rule("time slots", "singulate", "merge", actions="parcels", is_prior=True)
class TimeSlots(SlopeRule):
    """Give each parcel a time slot for passing the slope's end, and brake early parcels."""

    kernel = staticmethod(_make_kernel(plan_by_slot))


@rule("hold and release", "singulate", "merge", actions="parcels")
class HoldAndRelease(SlopeRule):
    """Zero-pressure accumulation: hold parcels before the slope's end, release them one by one."""

    kernel = staticmethod(_make_kernel(plan_by_release))


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
    """Write parcels' rows to `order`, in the required order of departure. Return the row count."""
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
    """Return whether the ranges in y of parcels `j` and `k` overlap, so that they could touch."""
    across = parcels.across[j] + parcels.across[k]
    return abs(parcels.y[j] - parcels.y[k]) < across - 0.005


@inlined
def _must_wait(parcels: SlopeParcels, order: Integers, ready: int, place: int) -> bool:
    """Return whether the parcel at position `place` of the order must wait for a predecessor.

    The parcel waits if a predecessor is farther up the slope or has not entered yet. `ready` is the
    result of `count_ready`.
    """
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
    """Find where the parcel `order[place]` waits. Return y [m] and the maximum x [m] of its front.

    A parcel beside the middle keeps its side. A parcel in the middle gets the side with the lower
    cost. The cost decreases with the room on a side. The cost increases with the number of parcels
    on this side that are ahead and depart later.
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
    """Return the speed limit [m/s] at which parcel `k` keeps clear of parcels ahead.

    To pass a parcel ahead by moving aside, parcel `k` needs a certain distance to that parcel. If
    `free` is true and the distance suffices, the parcel ahead sets no limit. Otherwise the limit
    preserves this distance.
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
    """Return whether the area into which parcel `k` moves aside is free, now and during the move.

    Parcels directly ahead of or directly behind parcel `k` are ignored.
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


@inlined
def count_ready(table: Singles, order: Integers, count: int) -> int:
    """Count entered parcels from the order's start to the first parcel that has not entered."""
    ready = 0
    while ready < count and read(table[order[ready]], PLACE) < ready + 0.5:
        ready += 1
    return ready


@inlined
def _lead_out(
    parking: Parking, parcels: SlopeParcels, order: Integers, count: int, place: int
) -> None:
    """Lead parcel `order[place]` into the passage if a parcel later in the order blocks the way."""
    k = order[place]
    for after in range(place + 1, count):
        j = order[after]
        if parcels.x[j] > parcels.x[k] and _overlap(parcels, j, k):
            if abs(parcels.y[k]) > parking.near:
                parcels.shift[k] = -parcels.y[k]
            break


@linked
def plan_in_order(
    slope: Slope, tuning: Tuning, parking: Parking, parcels: SlopeParcels, slots: Slots,
    order: Integers, count: int, ready: int, place: int,
) -> tuple[float, bool]:  # fmt: skip
    """Plan the motion of parcel `order[place]` to its waiting place or to the slope's end.

    Writes into `parcels.shift` how far [m] the parcel moves aside. `count_ready` returns `ready`.

    Returns:
        The parcel's wanted speed [m/s], and whether it can move aside (`is_free`).
    """
    k = order[place]
    parcels.shift[k] = 0.0
    if _must_wait(parcels, order, ready, place):
        y, front = find_parking(slope, parking, parcels, order, count, place)
        if abs(y - parcels.y[k]) > parking.near:
            parcels.shift[k] = y - parcels.y[k]
        # It moves equally far along the line and aside.
        room = front - parcels.x[k] - parcels.along[k] - abs(parcels.shift[k])
        speed = stopping_speed(slope, tuning, room)
        free = is_free(parcels, order, count, k)
        if parcels.shift[k] != 0.0 and free:
            speed = max(speed, 0.25)
        room = slope.length - 0.1 - parcels.x[k] - parcels.along[k]
        speed = min(speed, stopping_speed(slope, tuning, room))
    else:
        _lead_out(parking, parcels, order, count, place)
        free = is_free(parcels, order, count, k)
        late = abs(parcels.shift[k]) * tuning.shift_cost
        speed = arrive_in_slot(slope, tuning, parcels, slots, k, late)
    return min(speed, limit_in_order(slope, tuning, parcels, order, count, k, free)), free


@compiled
def choose_in_order(
    tables: Singles, slope: Slope, tuning: Tuning, parking: Parking, parcels: SlopeParcels,
    slots: Slots, order: Integers, came: Numbers, brakes: Brakes, halves: Integers,
) -> None:  # fmt: skip
    """Write actions `halves` (num_envs, rows, 2), so that parcels depart in the required order.

    The other arguments are as in `choose_one_by_one`.
    """
    for i in range(tables.shape[0]):
        table = tables[i]
        read_parcels(table, slope, tuning, parcels)
        count = sort_by_place(table, order[i])
        for k in range(table.shape[0]):
            time = read(table[k], ta.COLUMN.time)
            if read(table[k], ta.COLUMN.present) > 0.5 and time < came[i, k]:
                brakes.due[i, k] = 0.5
            came[i, k] = time
        ready = count_ready(table, order[i], count)
        forget_slots(slots)
        for place in range(count):
            k = order[i, place]
            speed, free = plan_in_order(
                slope, tuning, parking, parcels, slots, order[i], count, ready, place
            )
            choose_halves(slope, tuning, parcels, k, speed, free, brakes, i, halves[i, k])
            if not free or parcels.shift[k] == 0.0:
                hold(parcels, k, speed, halves[i, k])


@rule("pass and park", "sequence", actions="parcels", is_prior=True)
class PassAndPark(SlopeRule):
    """Bring parcels into a required order: a parcel that must wait is parked beside a passage."""

    kernel = staticmethod(choose_in_order)

    def __init__(self, config: EnvConfig) -> None:
        checks.instance("task", config.task, Sequence, "a Sequence")
        super().__init__(config)
        self._slope = self._slope._replace(alignment=min(self._slope.alignment, ALIGNMENT))

    def arguments(self, tables: Singles, memory: SlopeMemory, halves: Integers) -> tuple[Any, ...]:
        tables, slope, tuning, *more = super().arguments(tables, memory, halves)
        return (tables, slope, tuning, Parking(), *more)
