"""A rule of modules on slopes: the best of several patterns of axes below each parcel.
A pattern gives one or two orientations to the modules below a parcel. The motion of a parcel is
predicted over a short time, which is divided into parts.

Each parcel has a wanted speed along the slope, which follows from its time slot and the parcels
ahead. It also has a wanted speed across the slope and a wanted turning speed. The modules below the
parcel follow the pattern with the predicted motion nearest to these speeds.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from surface_gym import checks
from surface_gym.actions import angle_after
from surface_gym.compiler.jit import compiled, inlined, linked
from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.flow.slope_tasks import Sequence
from surface_gym.flow.take_away import COLUMN
from surface_gym.physics.types import GRAVITY
from surface_gym.tasks.features import read

from ..base import Booleans, Integers, Numbers, Singles, find_axes
from .base import rule
from .departures import (
    ALIGNMENT,
    Parking,
    count_ready,
    is_way_clear,
    limit_speed,
    plan_by_slot,
    plan_in_order,
    sort_by_place,
    sort_by_progress,
)
from .slopes import (
    BRAKE,
    HELD,
    NOBODY,
    ROLL,
    STANDS,
    TO_LEFT,
    TO_RIGHT,
    Slope,
    SlopeParcels,
    SlopeRule,
    Slots,
    Tuning,
    find_tuning,
    forget_slots,
    read_parcels,
)  # fmt: skip

EACH = (ROLL, BRAKE, TO_LEFT, TO_RIGHT)
WHOLE, AHEAD, LEFT, IN_TURN = range(4)  # modules that follow a pattern's first action
# Braking modules beside leaning ones are hardly ever best.
TWO = [
    (one, other) for one in EACH for other in EACH
    if one != other and (ROLL in (one, other) or BRAKE not in (one, other))
]  # fmt: skip
PATTERNS = np.array(
    [(WHOLE, one, one) for one in EACH]
    + [(split, *two) for split in (AHEAD, LEFT) for two in TWO]
    + [(IN_TURN, one, other) for one, other in TWO if one < other]
)
HOLDING = EACH.index(BRAKE)  # the pattern in which all modules brake
PARTS = 2  # of the predicted time
SWEEPS = 2  # there and back over the modules below a parcel, in a part of the time
MOST_BELOW = 64  # modules below one parcel in the model
HEIGHT = 0.1  # [m] assumed height of a centre of mass
SPREAD = 1e-4  # [m^2] least variance of the modules' positions, for the balance of loads
NEAR = 0.002  # [m] smaller overlaps and remaining shifts are ignored
LONG = 15  # control periods without motion after which parcels are released together
CREEP = 0.4  # [m/s] minimum speed of released parcels
# Values of `Tuning` that differ from other rules'.
CLEAR, SHIFT, TURN = 0.06, 0.45, 0.1
# Values of `PatternTuning` for a required order.
IN_ORDER = {"aside": 2.0, "lateral": 0.6, "lateral_stop": 1.5}


class PatternTuning(NamedTuple):
    """Limits of a parcel's wanted motion, and costs of patterns. A search found the defaults."""

    lateral: float = 1.0  # [m/s] maximum wanted speed across the slope
    lateral_stop: float = 3.0  # [m/s^2] assumed deceleration across the slope
    turning: float = 4.0  # [rad/s] maximum wanted turning speed
    turning_stop: float = 15.0  # [rad/s^2] assumed deceleration of a turn
    turning_from: float = 0.3  # [m/s] speed from which a parcel may turn at the maximum
    over: float = 1.5  # [-] cost of a speed above the wanted speed
    under: float = 1.6  # [-] cost of a speed below the wanted speed
    aside: float = 1.0  # [-] cost of a wrong speed across the slope
    turns: float = 0.25  # [m] cost of a wrong turning speed
    change: float = 0.002  # [m/s] cost of turning all axes
    slot_from: float = 1.2  # [m] position from which parcels are braked for their slots
    loosening: float = 0.7  # [m] length over which the required distance of parcels grows from 0
    lag: float = 0.63  # [rad] part of axes' turns that is added to the predicted time
    sooner: float = 0.1  # [s] time before a parcel's arrival at which a module obeys it


class ModuleGrid(NamedTuple):
    """The modules of a surface, and constants of the model that predicts motion."""

    x: Numbers  # (columns,) [m] from the surface's start
    y: Numbers  # (rows,) [m] from the line's middle
    rotor: Booleans  # (rows, columns) a rotor, else a support
    along: float  # [m/s^2] acceleration by friction along all axes
    angles: Numbers  # (actions,) [rad] axis of each action
    turn: float  # [rad] turn of an axis in a part of the predicted time
    period: float  # [rad] turn of an axis in a control period
    part: float  # [s] duration of a part of the predicted time


class Below(NamedTuple):
    """The modules below one parcel, in arrays (MOST_BELOW, ...)."""

    x: Numbers  # [m] from the parcel's centre
    y: Numbers  # [m]
    angle: Numbers  # [rad] of the axis now
    load: Numbers  # [-] share of the weight
    impulse: Numbers  # [m/s] of friction along the axis in a part of the time
    # (parts, MOST_BELOW, actions, 5) cosine and sine of an axis; [m] its arm; [1/m] turning speed
    # by an impulse; [-] share of a slip that the contact stops
    axes: Numbers
    place: Integers  # bits of `find_place`
    action: Integers  # action in a pattern


@inlined
def find_place(x: float, y: float, number: int) -> int:
    """Return a number from 0 to 7 that describes a module's place.

    The result is the sum of 1 if the module is left of the parcel's centre, 2 if the module is
    ahead of the centre, and 4 if `number` is odd. `number` is the sum of the module's row and
    column. `x` and `y` [m] are the module's position relative to the parcel's centre.
    """
    return (1 if y > 0.0 else 0) + (2 if x > 0.0 else 0) + 4 * (number % 2)


@inlined
def choose_action(pattern: int, place: int) -> int:
    """Return a module's action in a pattern; `place` holds the bits that `find_place` returns."""
    split = PATTERNS[pattern, 0]
    bit = 2 if split == AHEAD else (1 if split == LEFT else 4)
    return PATTERNS[pattern, 1 if split == WHOLE or place & bit != 0 else 2]


@inlined
def find_outside(row: Singles, dx: float, dy: float, turned: float) -> float:
    """Return a point's distance [m] from a parcel's base. Inside, the distance is negative.

    `row` (features,) is the parcel's row. `dx` and `dy` [m] run from the parcel's centre to the
    point. The base is first turned by the small angle `turned` [rad].
    """
    sine, cosine = row[COLUMN.sine_of_theta.place], row[COLUMN.cosine_of_theta.place]
    sine, cosine = sine + turned * cosine, cosine - turned * sine
    along, across = abs(cosine * dx + sine * dy), abs(cosine * dy - sine * dx)
    return max(along - read(row, COLUMN.length), across - read(row, COLUMN.width))


@linked
def find_below(
    grid: ModuleGrid, parcels: SlopeParcels, row: Singles, k: int, axes: Numbers, below: Below
) -> int:
    """Find the modules that will be below parcel `k` halfway through the prediction.

    The function writes the modules to `below`, and returns their number. `row` (features,) is the
    parcel's row of the observation. `axes` (modules,) [rad] are the present angles of all axes.
    """
    count, columns, half = 0, grid.x.shape[0], 0.5 * PARTS * grid.part
    x, y = find_centre(parcels, row, k)
    ahead, aside = half * parcels.vx[k], half * parcels.vy[k]
    reach = parcels.along[k] + parcels.across[k]
    for c in range(columns):
        dx = grid.x[c] - x - ahead
        if abs(dx) > reach:
            continue
        for r in range(grid.y.shape[0]):
            dy = grid.y[r] - y - aside
            if not grid.rotor[r, c] or abs(dy) > reach or count == MOST_BELOW:
                continue
            if find_outside(row, dx, dy, half * parcels.omega[k]) > 0.0:
                continue
            below.x[count], below.y[count] = dx, dy
            below.angle[count] = axes[r * columns + c]
            below.place[count] = find_place(dx + ahead, dy + aside, r + c)
            count += 1
    return count


@inlined
def find_centre(parcels: SlopeParcels, row: Singles, k: int) -> tuple[float, float]:
    """Return x and y [m] of the centre of parcel `k`, whose observation is `row` (features,)."""
    return parcels.x[k] - 0.5 * (parcels.front[k] - parcels.rear[k]), read(row, COLUMN.offset)


@inlined
def find_moments(below: Below, count: int) -> tuple[float, ...]:
    """Return the upper triangle of the inverse of the modules' moment matrix (3 x 3).

    The matrix holds the moments of orders 0, 1 and 2 of the positions of the first `count` modules
    in `below`. `predict_motion` uses the inverse to share the weight among these modules.
    """
    n = float(count)
    sx = sy = sxy = 0.0
    sxx = syy = SPREAD * n
    for m in range(count):
        x, y = below.x[m], below.y[m]
        sx += x
        sy += y
        sxx += x * x
        sxy += x * y
        syy += y * y
    first, second, third = sxx * syy - sxy * sxy, sxy * sy - sx * syy, sx * sxy - sxx * sy
    scale = 1.0 / (n * first + sx * second + sy * third)
    return (
        first * scale, second * scale, third * scale, (n * syy - sy * sy) * scale,
        (sx * sy - n * sxy) * scale, (n * sxx - sx * sx) * scale,
    )  # fmt: skip


@linked
def prepare_axes(grid: ModuleGrid, below: Below, count: int, gyration: float) -> None:
    """Write the axes of `count` modules to `below.axes`, for each orientation and time.

    The times are the middles of the parts of a prediction. `gyration` [m^2] is the parcel's inertia
    divided by its mass.
    """
    for m in range(count):
        for action in range(len(EACH)):
            for part in range(PARTS):
                target, turned = grid.angles[action], grid.turn * (part + 0.5)
                angle = angle_after(below.angle[m], target, turned)
                axis = below.axes[part, m, action]
                axis[0], axis[1] = math.cos(angle), math.sin(angle)
                axis[2] = below.x[m] * axis[1] - below.y[m] * axis[0]
                axis[3] = axis[2] / gyration
                axis[4] = 1.0 / (1.0 + axis[2] * axis[3])


@linked
def predict_motion(
    grid: ModuleGrid, rolls: float, below: Below, count: int, moments: tuple[float, ...], vx: float,
    vy: float, omega: float, pattern: int,
) -> tuple[float, float, float]:  # fmt: skip
    """Predict a parcel's velocity [m/s, m/s, rad/s] at the end of the prediction.

    `vx`, `vy` and `omega` are the velocity now. The `count` modules in `below` follow the row
    `pattern` of `PATTERNS`. `moments` is the result of `find_moments`. At each module, friction
    reduces the slip along the axis, to 0 if possible. The load shifts in the direction opposite to
    the force of friction. Thus braking shifts the load to the front. A rolling parcel accelerates
    by `rolls` [m/s^2].
    """
    for m in range(count):
        below.action[m] = choose_action(pattern, below.place[m])
    force_x = force_y = 0.0
    for part in range(PARTS):
        lean_x, lean_y = -HEIGHT / GRAVITY * force_x, -HEIGHT / GRAVITY * force_y
        level = moments[0] + moments[1] * lean_x + moments[2] * lean_y
        slope_x = moments[1] + moments[3] * lean_x + moments[4] * lean_y
        slope_y = moments[2] + moments[4] * lean_x + moments[5] * lean_y
        total = 0.0
        for m in range(count):
            below.load[m] = max(0.0, level + slope_x * below.x[m] + slope_y * below.y[m])
            below.impulse[m] = 0.0
            total += below.load[m]
        scale = grid.part * grid.along / max(total, 1e-9)
        vx += grid.part * rolls
        before_x, before_y = vx, vy
        for n in range(SWEEPS * count):
            m = n if n < count else 2 * count - 1 - n
            axis, most = below.axes[part, m, below.action[m]], scale * below.load[m]
            slip = axis[0] * vx + axis[1] * vy + axis[2] * omega
            impulse = min(most, max(-most, below.impulse[m] - slip * axis[4]))
            push = impulse - below.impulse[m]
            below.impulse[m] = impulse
            vx += push * axis[0]
            vy += push * axis[1]
            omega += push * axis[3]
        force_x, force_y = (vx - before_x) / grid.part, (vy - before_y) / grid.part
    return vx, vy, omega


@linked
def choose_pattern(
    slope: Slope, aim: PatternTuning, grid: ModuleGrid, parcels: SlopeParcels, row: Singles, k: int,
    axes: Numbers, below: Below, speed: float, lateral: float, turning: float,
) -> int:  # fmt: skip
    """Return the row of `PATTERNS` whose predicted velocity is nearest to the wanted velocity.

    The wanted velocity is `speed` [m/s] along the slope, `lateral` [m/s] to the left, and `turning`
    [rad/s]. `row` (features,) is the observation of parcel `k`. `axes` (modules,) [rad] are the
    present angles of all axes.
    """
    count = find_below(grid, parcels, row, k, axes, below)
    if count == 0:
        return 0
    length, width = read(row, COLUMN.length), read(row, COLUMN.width)
    prepare_axes(grid, below, count, (length * length + width * width) / 3.0)
    moments = find_moments(below, count)
    reached = min(speed, parcels.vx[k] + PARTS * grid.part * slope.rolls)
    best, least = 0, math.inf
    for pattern in range(PATTERNS.shape[0]):
        vx, vy, omega = predict_motion(
            grid, slope.rolls, below, count, moments, parcels.vx[k], parcels.vy[k],
            parcels.omega[k], pattern,
        )  # fmt: skip
        turned = 0
        for m in range(count):
            turned += abs(grid.angles[below.action[m]] - below.angle[m]) > 1e-6
        cost = aim.over * max(0.0, vx - speed) + aim.under * max(0.0, reached - vx)
        cost += aim.aside * abs(vy - lateral) + aim.turns * abs(omega - turning)
        cost += aim.change * turned / count
        if cost < least:
            best, least = pattern, cost
    return best


@linked
def claim_modules(
    aim: PatternTuning, grid: ModuleGrid, parcels: SlopeParcels, row: Singles, k: int, pattern: int,
    nearest: Numbers, commands: Integers,
) -> None:  # fmt: skip
    """Assign to parcel `k` the modules that the parcel covers now or soon.

    Skip a module if another parcel is nearer. For the assigned modules, `commands` (modules,) gets
    the actions of row `pattern` of `PATTERNS`, and `nearest` (modules,) gets the distances [m] to
    the parcel. `row` (features,) is the parcel's observation.
    """
    ahead, aside = parcels.vx[k] * aim.sooner, parcels.vy[k] * aim.sooner
    low_x, high_x = parcels.x[k] - parcels.along[k], parcels.x[k] + parcels.along[k]
    low_y, high_y = parcels.y[k] - parcels.across[k], parcels.y[k] + parcels.across[k]
    x, y = find_centre(parcels, row, k)
    columns = grid.x.shape[0]
    for c in range(columns):
        if not low_x + min(0.0, ahead) <= grid.x[c] <= high_x + max(0.0, ahead):
            continue
        for r in range(grid.y.shape[0]):
            if not low_y + min(0.0, aside) <= grid.y[r] <= high_y + max(0.0, aside):
                continue
            dx, dy, m = grid.x[c] - x, grid.y[r] - y, r * columns + c
            far = max(0.0, find_outside(row, dx, dy, 0.0)) + 1e-3 * math.sqrt(dx * dx + dy * dy)
            if far < nearest[m]:
                nearest[m] = far
                commands[m] = choose_action(pattern, find_place(dx, dy, r + c))


@inlined
def is_in_way(parcels: SlopeParcels, j: int, k: int) -> bool:
    """Return whether parcel `j` is ahead of parcel `k` and blocks the way of parcel `k`."""
    wide = parcels.across[j] + parcels.across[k] - NEAR
    return parcels.x[j] > parcels.x[k] and abs(parcels.y[j] - parcels.y[k]) < wide


@linked
def sort_parcels(
    table: Singles, tuning: Tuning, parcels: SlopeParcels, order: Integers, came: Numbers,
    stood: Integers,
) -> int:  # fmt: skip
    """Update the order of the parcels by `sort_by_progress`, and return the number of parcels.

    Then, if a parcel blocks its predecessor in the order, swap the two parcels in the order. `came`
    and `stood` (rows,) are as in `sort_by_progress`.
    """
    count = sort_by_progress(table, parcels, order, came, stood, tuning.swap)
    for place in range(1, count):
        at = place
        while at > 0 and is_in_way(parcels, order[at], order[at - 1]):
            order[at], order[at - 1] = order[at - 1], order[at]
            at -= 1
    return count


@inlined
def find_stuck(parcels: SlopeParcels, order: Integers, count: int, stood: Integers) -> bool:
    """Return whether the first parcel of the order is stuck while the take-away conveyor runs.

    The array `stood` (rows,) counts the successive periods in which a parcel rests. A parcel is
    stuck if its count is above `LONG`. The count of a stuck parcel grows in every period, even if
    the parcel moves. After 2 `LONG`, the count restarts at 0. While the first parcel is stuck, the
    caller lets the parcel creep to end the jam.
    """
    for place in range(count):
        k = order[place]
        moves = abs(parcels.vx[k]) + abs(parcels.vy[k]) > STANDS
        stood[k] = 0 if (moves and stood[k] <= LONG) or stood[k] >= 2 * LONG else stood[k] + 1
    return count > 0 and parcels.runs[order[0]] and stood[order[0]] > LONG


@inlined
def want_sideways(
    slope: Slope, tuning: Tuning, aim: PatternTuning, parcels: SlopeParcels, k: int, clear: bool
) -> tuple[float, float]:
    """Return the wanted speed [m/s] across the slope and turning speed [rad/s] of parcel `k`.

    If `clear` is false, other parcels are in the way, and the speed across the slope is 0.
    """
    shift, lateral, turning = parcels.shift[k], 0.0, 0.0
    if clear and shift != 0.0:
        lateral = min(aim.lateral, math.sqrt(2.0 * aim.lateral_stop * abs(shift)))
    room = abs(parcels.turn[k]) - 0.5 * min(tuning.turned, slope.alignment)
    # Without a required alignment, parcels are not turned.
    if room > 0.0 and slope.alignment < ta.EIGHTH - 1e-9:
        turning = min(aim.turning, math.sqrt(2.0 * aim.turning_stop * room))
        turning *= min(1.0, max(0.0, parcels.vx[k]) / aim.turning_from)
    return math.copysign(lateral, shift), math.copysign(turning, parcels.turn[k])


@inlined
def want_motion(
    slope: Slope, tuning: Tuning, aim: PatternTuning, parcels: SlopeParcels, slots: Slots,
    order: Integers, count: int, place: int, goes: bool,
) -> tuple[float, float, float]:  # fmt: skip
    """Return the wanted speeds [m/s] along and across the slope, and the turning speed [rad/s].

    The speeds are for parcel `order[place]`, which gets the next time slot. If `goes` is true, this
    parcel must end a jam, and the speed along the slope is at least `CREEP`.
    """
    k = order[place]
    speed = plan_by_slot(slope, tuning, parcels, slots, k)
    if parcels.x[k] < aim.slot_from:
        speed = slope.take_away
    gap = tuning.clear * min(1.0, parcels.x[k] / aim.loosening)
    speed = min(speed, limit_speed(slope, tuning, parcels, order, count, place, gap))
    if goes:
        speed = max(speed, CREEP)
    clear = is_way_clear(tuning, parcels, order, count, place, HELD)
    lateral, turning = want_sideways(slope, tuning, aim, parcels, k, clear)
    return speed, lateral, turning


@inlined
def expect_axes(grid: ModuleGrid, commands: Integers, axes: Numbers) -> None:
    """Update the expected angles `axes` (modules,) [rad] by one period of turning to `commands`."""
    for m in range(commands.shape[0]):
        axes[m] = angle_after(axes[m], grid.angles[commands[m]], grid.period)


@compiled
def choose_patterns(
    tables: Singles, slope: Slope, tuning: Tuning, aim: PatternTuning, grid: ModuleGrid,
    parcels: SlopeParcels, slots: Slots, below: Below, nearest: Numbers, order: Integers,
    came: Numbers, stood: Integers, axes: Numbers, commands: Integers,
) -> None:  # fmt: skip
    """Write commands (num_envs, modules), so that parcels depart one by one.

    `tables` have shape (num_envs, rows, features). `order`, `came`, `stood` and `axes` are the
    arrays of a `PatternMemory`. `below` and `nearest` (modules,) are scratch arrays.
    """
    for i in range(tables.shape[0]):
        table = tables[i]
        read_parcels(table, slope, tuning, parcels)
        for k in range(table.shape[0]):
            if abs(parcels.shift[k]) < NEAR:
                parcels.shift[k] = 0.0
        count = sort_parcels(table, tuning, parcels, order[i], came[i], stood[i])
        stuck = find_stuck(parcels, order[i], count, stood[i])
        forget_slots(slots)
        nearest[:], commands[i, :] = math.inf, ROLL
        for place in range(count):
            k = order[i, place]
            goes = stuck and stood[i, k] > LONG
            speed, lateral, turning = want_motion(
                slope, tuning, aim, parcels, slots, order[i], count, place, goes
            )
            pattern = choose_pattern(
                slope, aim, grid, parcels, table[k], k, axes[i], below, speed, lateral, turning
            )
            claim_modules(aim, grid, parcels, table[k], k, pattern, nearest, commands[i])
        expect_axes(grid, commands[i], axes[i])


@compiled
def choose_patterns_in_order(
    tables: Singles, slope: Slope, tuning: Tuning, aim: PatternTuning, parking: Parking,
    grid: ModuleGrid, parcels: SlopeParcels, slots: Slots, below: Below, nearest: Numbers,
    order: Integers, axes: Numbers, commands: Integers,
) -> None:  # fmt: skip
    """Write commands (num_envs, modules), so that parcels depart in a required order.

    All arguments except `parking` are as in `choose_patterns`.
    """
    for i in range(tables.shape[0]):
        table = tables[i]
        read_parcels(table, slope, tuning, parcels)
        count = sort_by_place(table, order[i])
        ready = count_ready(table, order[i], count)
        forget_slots(slots)
        nearest[:], commands[i, :] = math.inf, ROLL
        for place in range(count):
            k = order[i, place]
            speed, free = plan_in_order(
                slope, tuning, parking, parcels, slots, order[i], count, ready, place
            )
            lateral, turning = want_sideways(slope, tuning, aim, parcels, k, free)
            moves_aside = free and parcels.shift[k] != 0.0
            if speed < 0.2 * HELD and parcels.vx[k] < HELD and not moves_aside:
                pattern = HOLDING  # a standing parcel does not creep
            else:
                pattern = choose_pattern(
                    slope, aim, grid, parcels, table[k], k, axes[i], below, speed, lateral, turning
                )
            claim_modules(aim, grid, parcels, table[k], k, pattern, nearest, commands[i])
        expect_axes(grid, commands[i], axes[i])


class PatternMemory(NamedTuple):
    """Memory of the rule, in arrays (num_envs, ...)."""

    order: Integers  # (num_envs, rows) rows in order of departure; NOBODY: end of the list
    came: Numbers  # (num_envs, rows) [s] last observed time since entry; -inf: empty
    stood: Integers  # (num_envs, rows) control periods without motion
    axes: Numbers  # (num_envs, modules) [rad] expected axes


@rule("patterns", "singulate", "merge", actions="modules")
class Patterns(SlopeRule):
    """Give each parcel a time slot; choose the pattern of axes with the best predicted motion."""

    kernel = staticmethod(choose_patterns)
    acts_by = "modules"

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config)
        self._tuning = self._tuning._replace(clear=CLEAR, shift_cost=SHIFT, turn_cost=TURN)
        self._aim = PatternTuning()
        self._grid = read_grid(config, self._aim)
        self._modules = config.action_kind.size
        numbers, places = np.zeros((5, MOST_BELOW)), np.zeros((2, MOST_BELOW), dtype=np.int64)
        axes = np.zeros((PARTS, MOST_BELOW, len(EACH), 5))
        self._below = Below(*[*numbers, axes, *places])
        self._nearest = np.zeros(self._modules)

    def make_memory(self, num_envs: int, rows: int) -> Any:
        shape = (num_envs, rows)
        return PatternMemory(
            np.full(shape, NOBODY), np.full(shape, -np.inf), np.zeros(shape, dtype=np.int64),
            np.full((num_envs, self._modules), self._grid.angles[ROLL]),
        )  # fmt: skip

    def make_commands(self, num_envs: int, rows: int) -> Integers:
        del rows
        return np.full((num_envs, self._modules), ROLL)

    def arguments(self, tables: Singles, memory: Any, commands: Integers) -> tuple[Any, ...]:
        tables, slope, tuning, *more = super().arguments(tables, memory, commands)
        parcels, slots, *memory = more
        return (
            tables, slope, tuning, self._aim, self._grid, parcels, slots, self._below,
            self._nearest, *memory,
        )  # fmt: skip


@rule("patterns", "sequence", actions="modules")
class PatternsInOrder(Patterns):
    """Bring parcels into a required order by patterns; parcels that must wait are parked aside."""

    kernel = staticmethod(choose_patterns_in_order)

    def __init__(self, config: EnvConfig) -> None:
        checks.instance("task", config.task, Sequence, "a Sequence")
        super().__init__(config)
        self._tuning = find_tuning(config)
        self._aim = self._aim._replace(**IN_ORDER)
        self._slope = self._slope._replace(alignment=min(self._slope.alignment, ALIGNMENT))

    def arguments(self, tables: Singles, memory: Any, commands: Integers) -> tuple[Any, ...]:
        tables, slope, tuning, aim, *more = super().arguments(tables, memory, commands)
        *more, order, _, _, axes, commands = more
        return (tables, slope, tuning, aim, Parking(), *more, order, axes, commands)


def read_places(config: EnvConfig) -> tuple[Numbers, Numbers, Booleans]:
    """Return x (columns,) [m] and y (rows,) [m] of the zone's modules, and an array of booleans.

    The array (rows, columns) says which modules are rotors.
    """
    line, (first_row, rows, first, columns) = config.chosen_line, config.site.zone
    place = np.arange(max(rows, columns), dtype=np.float64)
    zone = config.site.rotor[first_row : first_row + rows, first : first + columns]
    return (
        line.column_edge(first + 0.5) - config.entry_x + line.pitch_x * place[:columns],
        line.origin[1] - line.line_y + line.pitch_y * (first_row + place[:rows]),
        np.ascontiguousarray(zone),
    )


def read_grid(config: EnvConfig, aim: PatternTuning) -> ModuleGrid:
    """Read a surface's modules and the time span of predictions. `aim.lag` lengthens this span."""
    axes, (x, y, rotor) = find_axes(config), read_places(config)
    speed, period = config.actuators.axis_speed, config.control_period
    # Axes that take time are predicted until their effect shows.
    part = (period + aim.lag / speed) / PARTS
    grip = float(np.max(config.chosen_line.mu_max))
    return ModuleGrid(
        x=x,
        y=y,
        rotor=rotor,
        along=GRAVITY * math.cos(config.stream_task.tilt) * grip,
        angles=np.array(
            [config.chosen_orientations[k] for k in (axes.roll, axes.brake, axes.left, axes.right)]
        ),
        turn=min(math.pi, speed * part),
        period=min(math.pi, speed * period),
        part=part,
    )
