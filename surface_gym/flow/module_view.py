"""Local observations of modules for streams on a slope.

An idle rotor senses whether a parcel is on it, and the parcel's speed. Modules under one parcel
exchange these data, so they agree on the parcel's base and motion. They send the data in eight
directions to the modules around them, up to `REACH` [m]. Each parcel passes a time to the next
parcel behind: how long the conveyor after the slope (take-away) is occupied. Nothing else is
known of distant parcels.

All observations are computed from the table of parcels reported by the sensors.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.compiler.jit import compiled, inlined, linked
from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.flow.state import NOBODY
from surface_gym.flow.take_away import COLUMN, TakeAwayTask
from surface_gym.physics.types import Array, Booleans, Integers
from surface_gym.tasks.features import read

Singles = NDArray[np.float32]

REACH = 1.0  # [m] maximum gap between two parcels whose modules communicate
MOST = 20.0  # bound of every feature

# Features of a module, of the parcel on it, and of each neighbouring parcel.
OWN = (
    "to the end, from the module along x / 1 m",
    "the module's y / 0.5 m, from the line's middle",
    "1: a parcel lies on it; 0: one is about to, or none is near",
    "how far the module is ahead of the parcel's centre / 0.2 m",
    "and to the left of it / 0.2 m",
    "from the parcel's base to the module / 0.1 m",
)
PARCEL = (
    "1: there is a parcel",
    "to the end, from its centre along x / 1 m",
    "its y / 0.5 m",
    "vx / 1 m/s - 1",
    "vy / 0.5 m/s",
    "omega / 3 rad/s",
    "half of its extent along x / 0.2 m",
    "half of its extent along y / 0.2 m",
    "to move along y until it is within the nearest mouth / 0.3 m",
    "to turn until it is aligned / 45 deg",
    "until it has left if it rolls / 4 s",
    "how early it then is, before the take-away is free for it / 1 s; negative: late",
    "1: the take-away runs; 0: it stands, or is about to",
    "what only the task shows, such as the line it came by / 8; 0: nothing",
)
NEIGHBOUR = (
    "clear to it along x / 0.5 m; 2: there is none",
    "clear to it along y / 0.5 m",
    "its vx over that of this one / 0.5 m/s",
    "its vy over that of this one / 0.5 m/s",
    "1: it is to leave before this one; -1: after it; 0: there is none",
)
DIRECTIONS = 8  # behind right, behind, behind left, right, left, ahead right, ahead, ahead left
EARLY = 11  # index in `PARCEL`
PASSED = len(PARCEL) + DIRECTIONS * len(NEIGHBOUR)  # features shared by modules under a parcel
SIZE = len(OWN) + PASSED

# Columns of a decoded parcel, in SI units.
_X, _Y, _VX, _VY, _FRONT, _REAR, _LEFT, _RIGHT, _READY, _NEXT_IN_ORDER = range(10)
_DECODED = 10


class _Surface(NamedTuple):
    """The surface and its modules, for compiled code."""

    x: Array  # (columns,) [m] x of the modules from the end, negative
    y: Array  # (rows,) [m] from the line's middle
    rotor: Booleans  # (rows, columns) a rotor, else a support, which senses no parcels
    mouths: Array  # (mouths, 2) [m] y of both sides from the line's middle
    take_away: float  # [m/s]
    gap: float  # [m]
    ahead: float  # [s] time before a parcel's arrival at which a module sees it
    place: int  # feature with the order of departure; negative: order by x
    own: int  # task-specific feature of the table; negative: none


class ModuleObservations(NamedTuple):
    """Observations of the modules of surfaces."""

    owner: Integers  # (num_envs, modules) row of the parcel on a module (now or soon), or NOBODY
    own: Singles  # (num_envs, modules, len(OWN))
    passed: Singles  # (num_envs, rows, PASSED) shared features of the modules under each parcel

    def of_modules(self) -> Singles:
        """Return all modules' observations (num_envs, modules, SIZE).

        For a module without a parcel, all features except the module's position are 0.
        """
        num_envs, _modules = self.owner.shape
        passed = self.passed[np.arange(num_envs)[:, np.newaxis], self.owner]
        passed[self.owner == NOBODY] = 0.0
        return np.concatenate([self.own, passed], axis=2)


@inlined
def _within(value: float) -> float:
    return min(MOST, max(-MOST, value))


@linked
def _decode(surface: _Surface, table: Singles, order: Integers, decoded: Array) -> int:
    """Decode a table (rows, features) of parcels to SI units; return the number of parcels.

    Row k of `decoded` gets the parcel in row k of `table`. The array `order` gets the rows of the
    parcels, in the required order of departure. If the task requires no order, `order` is sorted
    by x, with the largest x first.
    """
    count = 0
    for k in range(table.shape[0]):
        row = table[k]
        if not ta.is_there(row):
            continue
        parcel = decoded[k]
        parcel[_X], parcel[_Y] = -read(row, COLUMN.to_the_end), read(row, COLUMN.offset)
        parcel[_VX], parcel[_VY] = read(row, COLUMN.forward_speed), read(row, COLUMN.lateral_speed)
        parcel[_FRONT], parcel[_REAR] = read(row, COLUMN.front), read(row, COLUMN.rear)
        parcel[_LEFT], parcel[_RIGHT] = read(row, COLUMN.left), read(row, COLUMN.right)
        place = count
        while place > 0:
            other = order[place - 1]
            sooner = parcel[_X] > decoded[other, _X]
            if surface.place >= 0:
                apart = table[other, surface.place] - row[surface.place]
                sooner = apart > 0.0 or (apart == 0.0 and sooner)
            if not sooner:
                break
            order[place] = other
            place -= 1
        order[place] = k
        count += 1
    for place in range(count):
        decoded[order[place], _NEXT_IN_ORDER] = place
    return count


@linked
def _write_early(
    surface: _Surface, table: Singles, order: Integers, count: int, decoded: Array, seen: Singles
) -> None:
    """Write how many seconds too early each rolling parcel would reach the take-away.

    This number is the time until the take-away is free for the parcel, minus the time that the
    parcel needs to roll off the slope. The column EARLY of `seen` (rows, PASSED) gets the number.
    The column _READY of `decoded` gets the time [s] until the parcel can depart. `order` and
    `decoded` are from `_decode`.
    """
    for place in range(count):
        k = order[place]
        parcel = decoded[k]
        rolls = read(table[k], COLUMN.rolling)
        mouth = ta.nearest_mouth(surface.mouths, 0, parcel[_Y])
        free = (parcel[_FRONT] - read(table[k], COLUMN.clear)) / surface.take_away
        for before in range(place - 1, -1, -1):
            other = decoded[order[before]]
            if ta.nearest_mouth(surface.mouths, 0, other[_Y]) == mouth:
                apart = other[_REAR] + parcel[_FRONT] + surface.gap
                free = other[_READY] + apart / surface.take_away
                break
        parcel[_READY] = max(rolls, free)
        seen[k, EARLY] = _within(free - rolls)


@linked
def _write_parcel(surface: _Surface, row: Singles, seen: Singles) -> None:
    """Write a parcel's features except EARLY to `seen` (PASSED,). `_write_early` writes EARLY."""
    seen[0] = 1.0
    seen[1] = _within(row[COLUMN.to_the_end.place])
    seen[2] = row[COLUMN.offset.place]
    seen[3] = row[COLUMN.forward_speed.place]
    seen[4] = row[COLUMN.lateral_speed.place]
    seen[5] = _within(row[COLUMN.turning_speed.place])
    seen[6] = _within(1.0 + 0.25 * (row[COLUMN.front.place] + row[COLUMN.rear.place]))
    seen[7] = _within(1.0 + 0.25 * (row[COLUMN.left.place] + row[COLUMN.right.place]))
    seen[8] = row[COLUMN.to_the_mouth.place]
    seen[9] = row[COLUMN.to_turn.place]
    seen[10] = row[COLUMN.rolling.place]
    seen[12] = row[COLUMN.takes_away.place]
    seen[13] = _within(row[surface.own]) if surface.own >= 0 else 0.0


@linked
def _write_neighbours(
    table: Singles, k: int, decoded: Array, nearest: Array, seen: Singles
) -> None:
    """Write features of the nearest parcel in each of eight directions from parcel `k`.

    The array `seen` (PASSED,) gets the features. `decoded` is from `_decode`. `nearest`
    (DIRECTIONS,) is scratch. Parcels farther away than `REACH` [m] are left out.
    """
    size = len(NEIGHBOUR)
    first = len(PARCEL)
    for way in range(DIRECTIONS):
        nearest[way] = REACH
        for n in range(size):
            seen[first + way * size + n] = 2.0 * REACH if n < 2 else 0.0
    one = decoded[k]
    for j in range(table.shape[0]):
        if j == k or not ta.is_there(table[j]):
            continue
        other = decoded[j]
        ahead, aside = other[_X] - one[_X], other[_Y] - one[_Y]
        if ahead > 0.0:
            clear_x = ahead - one[_FRONT] - other[_REAR]
        else:
            clear_x = -ahead - one[_REAR] - other[_FRONT]
        if aside > 0.0:
            clear_y = aside - one[_LEFT] - other[_RIGHT]
        else:
            clear_y = -aside - one[_RIGHT] - other[_LEFT]
        along = 0
        if clear_x > 0.0 or clear_x >= clear_y:
            along = 1 if ahead > 0.0 else -1
        across = 0
        if clear_y > 0.0 or clear_y > clear_x:
            across = 1 if aside > 0.0 else -1
        way = 3 * (along + 1) + across + 1
        if way > 4:
            way -= 1
        if max(clear_x, clear_y) >= nearest[way]:
            continue
        nearest[way] = max(clear_x, clear_y)
        at = first + way * size
        seen[at] = 2.0 * max(-REACH, min(REACH, clear_x))
        seen[at + 1] = 2.0 * max(-REACH, min(REACH, clear_y))
        seen[at + 2] = _within(2.0 * (other[_VX] - one[_VX]))
        seen[at + 3] = _within(2.0 * (other[_VY] - one[_VY]))
        seen[at + 4] = 1.0 if other[_NEXT_IN_ORDER] < one[_NEXT_IN_ORDER] else -1.0


@linked
def _claim(
    surface: _Surface, row: Singles, k: int, parcel: Array, owner: Integers, least: Array,
    own: Singles,
) -> None:  # fmt: skip
    """Assign parcel `k` to the modules that the parcel covers now or will soon reach.

    A module is left out if another parcel is nearer to the module. `row` holds the parcel's sensed
    features, and `parcel` has the same values in SI units. For each assigned module, `owner` gets
    k, `least` gets the parcel's distance [m], and `own` gets the module's features.
    """
    reach = surface.ahead
    low_x = -parcel[_REAR] + min(0.0, parcel[_VX] * reach)
    high_x = parcel[_FRONT] + max(0.0, parcel[_VX] * reach)
    low_y = -parcel[_RIGHT] + min(0.0, parcel[_VY] * reach)
    high_y = parcel[_LEFT] + max(0.0, parcel[_VY] * reach)
    length, width = read(row, COLUMN.length), read(row, COLUMN.width)
    sine, cosine = row[COLUMN.sine_of_theta.place], row[COLUMN.cosine_of_theta.place]
    columns = len(surface.x)
    for c in range(columns):
        x = surface.x[c] - parcel[_X]
        if x < low_x or x > high_x:
            continue
        for r in range(len(surface.y)):
            y = surface.y[r] - parcel[_Y]
            if y < low_y or y > high_y or not surface.rotor[r, c]:
                continue
            along = abs(cosine * x + sine * y) - length
            across = abs(cosine * y - sine * x) - width
            outside = max(0.0, along, across)
            far = outside + 1e-3 * math.sqrt(x * x + y * y)
            m = r * columns + c
            if far >= least[m]:
                continue
            least[m], owner[m] = far, k
            own[m, 2] = 1.0 if outside == 0.0 else 0.0
            own[m, 3] = _within(5.0 * x)
            own[m, 4] = _within(5.0 * y)
            own[m, 5] = _within(10.0 * outside)


@compiled
def view_modules(
    tables: Singles, surface: _Surface, order: Integers, decoded: Array, nearest: Array,
    least: Array, owner: Integers, own: Singles, passed: Singles,
) -> None:  # fmt: skip
    """Write the observations of all modules from tables (num_envs, rows, features).

    The last three arguments are the fields of `ModuleObservations`. `order`, `decoded`, `nearest`
    and `least` are scratch.
    """
    columns = len(surface.x)
    for i in range(tables.shape[0]):
        table = tables[i]
        for m in range(owner.shape[1]):
            owner[i, m], least[m] = NOBODY, math.inf
            own[i, m, 0], own[i, m, 1] = -surface.x[m % columns], 2.0 * surface.y[m // columns]
            for n in range(2, own.shape[2]):
                own[i, m, n] = 0.0
        count = _decode(surface, table, order, decoded)
        _write_early(surface, table, order, count, decoded, passed[i])
        for k in range(table.shape[0]):
            if ta.is_there(table[k]):
                _write_parcel(surface, table[k], passed[i, k])
                _write_neighbours(table, k, decoded, nearest, passed[i, k])
                _claim(surface, table[k], k, decoded[k], owner[i], least, own[i])
            else:
                for n in range(passed.shape[2]):
                    passed[i, k, n] = 0.0


class ModuleView:
    """Converts tables of parcels to observations of the zone's modules.

    Modules are in the order of the action: row by row, beginning with the row of least y. The array
    `rotor` (rows, columns) marks modules that have a rotor.
    """

    def __init__(self, config: EnvConfig) -> None:
        task = checks.instance("task", config.task, TakeAwayTask, "one with a take-away")
        line, (first_row, rows, first, columns) = config.chosen_line, config.site.zone
        extent = line.extent
        own = len(ta.FEATURES) if len(config.features) > len(ta.FEATURES) else -1
        sides = [(each.first, each.last) for each in config.exits]
        self.modules, self._features = rows * columns, len(config.features)
        zone = config.site.rotor[first_row : first_row + rows, first : first + columns]
        self.rotor = np.ascontiguousarray(zone)
        across, along = np.arange(rows, dtype=np.float64), np.arange(columns, dtype=np.float64)
        self._surface = _Surface(
            x=line.column_edge(first + 0.5) - config.rotors_end + line.pitch_x * along,
            y=line.origin[1] - line.line_y + line.pitch_y * (first_row + across),
            rotor=self.rotor,
            mouths=np.clip(sides, extent[2] - line.line_y, extent[3] - line.line_y),
            take_away=task.take_away,
            gap=task.gap,
            ahead=task.ahead,
            place=own if task.in_order else -1,
            own=own,
        )

    def __call__(self, tables: Singles) -> ModuleObservations:
        """Compute modules' observations from tables (num_envs, rows, features)."""
        arguments = self.arguments(tables)
        view_modules(*arguments)
        return ModuleObservations(*arguments[-len(ModuleObservations._fields) :])

    def arguments(self, tables: Singles) -> tuple[Any, ...]:
        """Return arguments of `view_modules`. The last three arguments are arrays for results."""
        if tables.ndim != 3 or tables.shape[2] != self._features:
            raise ValueError(
                f"tables must have the shape (num_envs, rows, {self._features}), got {tables.shape}"
            )
        num_envs, rows, _ = tables.shape
        return (
            np.ascontiguousarray(tables, dtype=np.float32), self._surface,
            np.zeros(rows, dtype=np.int64), np.zeros((rows, _DECODED)),
            np.zeros(DIRECTIONS), np.zeros(self.modules),
            np.zeros((num_envs, self.modules), dtype=np.int64),
            np.zeros((num_envs, self.modules, len(OWN)), dtype=np.float32),
            np.zeros((num_envs, rows, PASSED), dtype=np.float32),
        )  # fmt: skip
