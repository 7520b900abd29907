"""A schedule at run time, as compiled functions for Python and the web site. A maneuver is a
position and an angle at which a parcel turns off to its exit. To book an entry is to note the
entering parcel's maneuver and time. To lead a parcel is to control the modules under the parcel by
the parcel's maneuver. A kind is a combination of parcel, speed and exit.

The functions follow parcels from the gate on, book entries, and lead parcels.
"""

import math
from typing import NamedTuple

import numpy as np

from surface_gym.compiler.jit import compiled, inlined, linked
from surface_gym.flow.task import COLUMN
from surface_gym.tasks.features import read

from ..base import Booleans, Integers, Numbers, Singles
from .trajectories import SIGNATURE

BOOKED = 24  # number of booked entries that limit a new one
WIDTH = 16  # width of the beam search
DEPTH = 8  # maximum waiting parcels in the search
SHUT = 0
LONG_AGO = -1e6  # [s]
NOBODY = -1
SEEN = np.array(SIGNATURE)


class Way(NamedTuple):
    """Parameters for leading parcels: maneuvers, and groups of modules that turn together."""

    roll: int  # orientation of 90 deg
    kind: Integers  # (maneuvers,), like `place`, `choice` and `turned`; see `Maneuvers`
    place: Numbers
    choice: Integers
    turned: Integers  # (maneuvers, 2) first and last turned group
    origin: Numbers  # (kinds,) [m] x of the origin of a row's rear position
    first: Numbers  # (groups,) [m] x of each group's first column
    last: Numbers  # (groups,) [m] x of its last column; no groups: single modules
    spans: Integers  # (groups, 2) first column of a group, and the column after its last
    ahead: float  # [s] time between turning a group and its use
    rows: int  # rows of obeying modules
    columns: int


class Orders(NamedTuple):
    """Parameters of booking; see `Library`."""

    gaps: Numbers  # (maneuvers, maneuvers) [s]
    delay: Numbers  # (maneuvers,) [s]
    options: Integers  # (kinds, most)
    signature: Numbers  # (kinds, features)
    parcels: int  # rows of the table for parcels on the line
    dt: float  # [s]
    steps: int  # of a control period
    period: float  # [s]


class Book(NamedTuple):
    """Memory of a scheduler, per environment."""

    clock: Numbers  # (num_envs,) [s] since the episode began
    booked: Integers  # (num_envs, BOOKED) maneuvers of the latest entries, the last first
    entered: Numbers  # (num_envs, BOOKED) [s]
    due: Numbers  # (num_envs,) [s] arrival of the last parcel let in
    pending: Booleans  # (num_envs,) whether that parcel's entry has yet to be observed
    rows: Integers  # (num_envs, parcels) maneuver of the parcel in each row, or NOBODY
    stands: Integers  # (num_envs, groups) orientation of each group


class Workspace(NamedTuple):
    """Sequences of maneuvers in a search. Row k has sequences of k + 1 maneuvers, best first."""

    maneuver: Integers  # (DEPTH, WIDTH) maneuver of the last parcel
    time: Numbers  # (DEPTH, WIDTH) [s] its time of entry
    before: Integers  # (DEPTH, WIDTH) index of the sequence without it
    cost: Numbers  # (DEPTH, WIDTH) [s] expected entry of one more parcel


def make_workspace() -> Workspace:
    """Allocate the arrays of a search."""
    shape = (DEPTH, WIDTH)
    return Workspace(
        np.zeros(shape, dtype=np.int64), np.zeros(shape), np.zeros(shape, dtype=np.int64),
        np.zeros(shape),
    )  # fmt: skip


@linked
def find_next(
    gaps: Numbers, delay: Numbers, options: Integers, queue: Integers, booked: Integers,
    entered: Numbers, now: float, space: Workspace,
) -> tuple[int, float]:  # fmt: skip
    """Find the maneuver and the time of entry [s] of the next parcel.

    Args:
        gaps: gaps between entries, shape (maneuvers, maneuvers) [s].
        delay, options: see `Library`.
        queue: (parcels,) kinds of the waiting parcels; the next parcel is first.
        booked, entered: maneuvers and entry times [s] of the latest parcels, shapes (BOOKED,).
        now: [s] earliest time of entry.
        space: scratch arrays. Afterwards the arrays hold the best sequences of maneuvers.
    """
    count = 1
    for depth in range(queue.shape[0]):
        maneuver, entry = space.maneuver[depth], space.time[depth]
        before, cost = space.before[depth], space.cost[depth]
        kept = 0
        for sequence in range(count):
            for column in range(options.shape[1]):
                option = options[queue[depth], column]
                if option < 0:
                    break
                time = now
                for k in range(booked.shape[0]):
                    time = max(time, entered[k] + gaps[booked[k], option])
                at = sequence
                for k in range(depth - 1, -1, -1):
                    time = max(time, space.time[k, at] + gaps[space.maneuver[k, at], option])
                    at = space.before[k, at]
                place = kept
                while place > 0 and time + delay[option] < cost[place - 1]:
                    place -= 1
                if place == WIDTH:
                    continue
                kept = min(WIDTH, kept + 1)
                for k in range(kept - 1, place, -1):
                    maneuver[k], entry[k] = maneuver[k - 1], entry[k - 1]
                    before[k], cost[k] = before[k - 1], cost[k - 1]
                maneuver[place], entry[place] = option, time
                before[place], cost[place] = sequence, time + delay[option]
        count = kept
    at = 0
    for k in range(queue.shape[0] - 1, 0, -1):
        at = space.before[k, at]
    return space.maneuver[0, at], space.time[0, at]


search = compiled(find_next.py_func)  # for calls from Python


@inlined
def _is_there(row: Singles) -> bool:
    """Return whether a row of the table holds a parcel."""
    return read(row, COLUMN.present) > 0.5


@linked
def recognise(row: Singles, signature: Numbers) -> int:
    """Return the kind whose features in `signature` are closest to a parcel's features `row`."""
    kind, least = 0, math.inf
    for k in range(signature.shape[0]):
        apart = 0.0
        for n in range(SEEN.shape[0]):
            apart = max(apart, abs(row[SEEN[n]] - signature[k, n]))
        if apart < least:
            kind, least = k, apart
    return kind


@inlined
def _turn(values: Numbers | Integers, back: bool) -> None:
    """Move the last value to the front; if `back` is true, move the first value to the end."""
    last = values.shape[0] - 1
    if back:
        first = values[0]
        for k in range(last):
            values[k] = values[k + 1]
        values[last] = first
    else:
        end = values[last]
        for k in range(last, 0, -1):
            values[k] = values[k - 1]
        values[0] = end


@linked
def follow_parcels(tables: Singles, orders: Orders, book: Book) -> None:
    """Update `book.rows`, the maneuver of the parcel in each row of the table.

    A parcel that has just entered gets its booked maneuver. If a booked parcel still waits, its
    booking is undone.
    """
    for i in range(tables.shape[0]):
        gate = tables[i, orders.parcels]
        due = book.clock[i] + read(gate, COLUMN.time)
        stayed = book.pending[i] and _is_there(gate) and abs(due - book.due[i]) < 1e-3
        if stayed:
            _turn(book.booked[i], True)
            _turn(book.entered[i], True)
            book.entered[i, BOOKED - 1] = LONG_AGO
        entered = book.pending[i] and not stayed
        for row in range(orders.parcels):
            # A row of a machine may pass to the entered parcel without having been empty.
            is_new = entered and read(tables[i, row], COLUMN.time) < orders.period - 0.5 * orders.dt
            if not _is_there(tables[i, row]):
                book.rows[i, row] = NOBODY
            elif book.rows[i, row] == NOBODY or is_new:
                if entered:
                    book.rows[i, row] = book.booked[i, 0]
                else:  # on the line before the scheduler began
                    kind = recognise(tables[i, row], orders.signature)
                    book.rows[i, row] = orders.options[kind, 0]


@linked
def enter_parcels(
    tables: Singles, orders: Orders, book: Book, maneuver: Integers, opens: Integers
) -> None:
    """If an environment's gate opens, book the `maneuver` (num_envs,) of the entering parcel.

    `opens` (num_envs,) is the physics step at which a gate opens, or SHUT if the gate stays shut.
    """
    for i in range(tables.shape[0]):
        book.pending[i] = opens[i] != SHUT
        if opens[i] != SHUT:
            _turn(book.booked[i], False)
            _turn(book.entered[i], False)
            book.booked[i, 0] = maneuver[i]
            book.entered[i, 0] = book.clock[i] + orders.dt * opens[i]
            book.due[i] = book.clock[i] + read(tables[i, orders.parcels], COLUMN.time)


@linked
def open_gates(
    tables: Singles, orders: Orders, book: Book, space: Workspace, queue: Integers,
    maneuver: Integers, opens: Integers,
) -> None:  # fmt: skip
    """Decide which gates open, and book the entries. `queue` (DEPTH,) is a scratch array.

    `opens` (num_envs,) gets the physics step at which each gate opens, or SHUT. `maneuver`
    (num_envs,) gets the maneuver of each entering parcel, or NOBODY.
    """
    for i in range(tables.shape[0]):
        opens[i], maneuver[i] = SHUT, NOBODY
        count, waiting = 0, tables.shape[1] - orders.parcels
        if _is_there(tables[i, orders.parcels]):
            for k in range(min(DEPTH, waiting)):
                if _is_there(tables[i, orders.parcels + k]):
                    count += 1
        for k in range(count):
            queue[k] = recognise(tables[i, orders.parcels + k], orders.signature)
        if count > 0:
            clock = book.clock[i]
            chosen, time = find_next(
                orders.gaps, orders.delay, orders.options, queue[:count], book.booked[i],
                book.entered[i], clock + orders.dt, space,
            )  # fmt: skip
            late = (time - clock) / orders.dt - 1e-6  # steps
            if late <= orders.steps:
                opens[i], maneuver[i] = math.ceil(late), chosen
    enter_parcels(tables, orders, book, maneuver, opens)


@linked
def lead_parcels(
    tables: Singles, way: Way, rows: Integers, stands: Integers, actions: Integers
) -> None:
    """Write the actions of all modules for a control period; the gate's action is not written.

    Args:
        rows: (num_envs, parcels) maneuver of each parcel, or NOBODY.
        stands: (num_envs, groups) index of each group's present orientation.
        actions: (num_envs, size) output. If columns are grouped, the entries are the actions of all
            modules. Otherwise the entries are the actions of each parcel's two halves.
    """
    groups = way.spans.shape[0]
    for i in range(tables.shape[0]):
        if groups == 0:
            for row in range(rows.shape[1]):
                choice = _choose(tables[i, row], way, rows[i, row])
                actions[i, 2 * row] = actions[i, 2 * row + 1] = choice
            continue
        for group in range(groups):
            row = _find_leader(tables[i], way, rows[i], group)
            if row >= 0:
                maneuver = rows[i, row]
                turns = way.turned[maneuver, 0] <= group <= way.turned[maneuver, 1]
                stands[i, group] = _choose(tables[i, row], way, maneuver) if turns else way.roll
        for k in range(way.rows * way.columns):
            actions[i, k] = way.roll
        for group in range(groups):
            for column in range(way.spans[group, 0], way.spans[group, 1]):
                for row in range(way.rows):
                    actions[i, row * way.columns + column] = stands[i, group]


@inlined
def _choose(row: Singles, way: Way, maneuver: int) -> int:
    """Return the orientation to which a maneuver now turns the modules under the parcel."""
    if maneuver < 0:
        return way.roll
    past = read(row, COLUMN.past_the_exit_s_start)
    return way.choice[maneuver] if past > way.place[maneuver] else way.roll


@inlined
def _find_leader(table: Singles, way: Way, rows: Integers, group: int) -> int:
    """Return the row of the foremost parcel over a group of modules, or -1 without a parcel.

    A parcel that will soon be over the group counts, too. Entry k of `rows` (parcels,) is the
    maneuver of the parcel in row k of `table`, or NOBODY. The parcel's length and the distance that
    the parcel soon covers have single precision.
    """
    leader, farthest = -1, -math.inf
    for row in range(rows.shape[0]):
        if rows[row] < 0:
            continue
        seen = table[row]
        rear = read(seen, COLUMN.past_the_exit_s_start) + way.origin[way.kind[rows[row]]]
        size, speed = COLUMN.size, COLUMN.forward_speed
        half = np.float32(size.offset) + np.float32(size.scale) * seen[size.place]
        fast = np.float32(speed.offset) + np.float32(speed.scale) * seen[speed.place]
        soon = rear + np.float32(2.0) * half + np.float32(way.ahead) * fast
        if rear <= way.last[group] and soon >= way.first[group] and rear > farthest:
            leader, farthest = row, rear
    return leader


recognise_row = compiled(recognise.py_func)
follow, enter = compiled(follow_parcels.py_func), compiled(enter_parcels.py_func)
lead = compiled(lead_parcels.py_func)


@compiled
def schedule(
    tables: Singles, orders: Orders, way: Way, book: Book, scratch: Workspace, queue: Integers,
    maneuver: Integers, opens: Integers, actions: Integers,
) -> None:  # fmt: skip
    """Follow parcels, open gates, and write `actions` (num_envs, size of an action).

    `scratch`, `queue` (DEPTH,) and `maneuver` (num_envs,) are overwritten. `opens` (num_envs,) gets
    the physics step at which each gate opens. If a gate stays shut, its entry in `opens` is SHUT.
    The last column of `actions` is a copy of `opens`.
    """
    follow_parcels(tables, orders, book)
    open_gates(tables, orders, book, scratch, queue, maneuver, opens)
    lead_parcels(tables, way, book.rows, book.stands, actions)
    for i in range(tables.shape[0]):
        actions[i, actions.shape[1] - 1] = opens[i]
        book.clock[i] += orders.period
