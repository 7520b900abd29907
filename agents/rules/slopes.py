"""Common parts of rules on slopes: decoded parcels, braking, turning and leading aside.
Parcels roll down a slope onto a take-away conveyor, through one of the mouths at the slope's end. A
time slot is a time for passing the end. To lead a parcel aside is to move it across the slope, to
be in front of its mouth. A rule reads a table with a row for each parcel. It chooses two actions
for each parcel (halves): one for the modules ahead of its centre, and one for the modules behind.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from surface_gym import checks
from surface_gym.compiler.jit import inlined, linked
from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.flow.take_away import COLUMN, TakeAwayTask
from surface_gym.physics.types import GRAVITY
from surface_gym.sensors import Exact
from surface_gym.tasks.features import read

from ..base import Booleans, Integers, Numbers, Singles, is_fresh
from .base import BaseStreamRule, CompiledController

NOBODY = -1
HELD = 0.1  # [m/s] speed below which all modules may hold a parcel
URGENT = 2.0  # [m] distance from the end at which both halves turn a parcel
LAST = 1.0  # [m] distance from the end at which a standing parcel is led aside at once if possible
STANDS = 0.02  # [m/s] speed below which a parcel counts as standing
TRIES = 10  # control periods for which a standing parcel is led aside, then let roll, in turn
DWELL = 0.375 * math.pi  # [rad] possible turn of an axis between two choices of brakes
ROLL, BRAKE, TO_LEFT, TO_RIGHT = range(4)  # action of a half of a parcel


class Slope(NamedTuple):
    """Parameters of the surface, the take-away and the required departures."""

    length: float  # [m] length of the rotors
    half_width: float  # [m] of the surface
    rolls: float  # [m/s^2] acceleration of a rolling parcel
    brakes: float  # [m/s^2] loss of acceleration by full braking
    take_away: float  # [m/s]
    gap: float  # [m]
    alignment: float  # [rad]
    period: float  # [s] between decisions
    dwell: int  # minimum control periods between two choices of brakes
    mouths: Numbers  # (mouths, 2) [m] y of both sides of a mouth from the line's middle


class Tuning(NamedTuple):
    """Parameters of the rules, found by search: see docs/material-flow.md."""

    swap: float = 0.03  # [m] minimum lead of a parcel to overtake in the order
    margin: float = 0.004  # [m] distance from the sides of a mouth
    spare_gap: float = 0.014  # [m] reserve of the gap
    shift_time: float = 0.01  # [s] time lost by leading a parcel aside
    shift_cost: float = 0.68  # [s/m] time lost per metre aside
    turn_cost: float = 0.23  # [s/rad] time lost by turning a parcel
    clear: float = 0.11  # [m] distance between successive parcels
    following: float = 0.38  # [-] share of full braking assumed for a follower
    shifting: float = 0.4  # [-] the same for a parcel that waits to be led aside
    shift_room: float = 0.33  # [m] distance from the end at which leading aside must be done
    least_speed: float = 0.08  # [m/s] minimum speed of a parcel to be turned
    turned: float = 0.08  # [rad] tolerance of a parcel's angle
    unturning: float = 10.8  # [rad/s^2] assumed deceleration of a turn
    most_turning: float = 4.0  # [rad/s]
    ahead: float = 0.1  # [m] clearance ahead of a parcel that is led aside
    behind: float = 0.21  # [m] clearance behind it
    beside: float = 0.003  # [m] clearance beside it
    merged: float = 0.52  # [-] share of the length after which parcels for one mouth are in a row
    headway: float = 0.02  # [s] time between parcels in a row
    yielding: float = 0.96  # [1/m] share of speed lost per metre of missing distance


LATE_ROOM = 0.6  # [m] `shift_room` with slow axes
SPARE = 0.02  # [m] `spare_gap` with inexact sensors


def find_tuning(config: EnvConfig) -> Tuning:
    """Return the parameters tuned for the sensors (exact or not) and the axes (fast or slow)."""
    tuning = Tuning() if isinstance(config.sensors, Exact) else Tuning(spare_gap=SPARE)
    if math.isinf(config.actuators.axis_speed):
        return tuning
    return tuning._replace(shift_room=LATE_ROOM)


class SlopeParcels(NamedTuple):
    """Decoded parcels of a surface, in arrays (rows,)."""

    x: Numbers  # [m] x of the middle of its extent, from the surface's start
    y: Numbers  # [m] y of the middle of its extent, from the line's middle
    vx: Numbers  # [m/s]
    vy: Numbers  # [m/s]
    omega: Numbers  # [rad/s]
    front: Numbers  # [m] distance from its centre to its front
    rear: Numbers  # [m] distance from its centre to its rear
    along: Numbers  # [m] half extent along x
    across: Numbers  # [m] half extent along y
    shift: Numbers  # [m] remaining lateral shift, positive to the left; 0: it is within a mouth
    turn: Numbers  # [rad] remaining turn
    mouth: Integers  # index of the nearest mouth
    clear: Numbers  # [m] distance to the last departed parcel of its mouth, minus the required gap
    runs: Booleans  # whether the take-away conveyor runs


def make_parcels(rows: int) -> SlopeParcels:
    """Allocate the arrays of a surface's parcels."""
    kinds = SlopeParcels.__annotations__
    types = {"mouth": np.int64, "runs": np.bool_}
    arrays: dict[str, Any] = {name: np.zeros(rows, types.get(name, np.float64)) for name in kinds}
    return SlopeParcels(**arrays)


@linked
def read_parcels(table: Singles, slope: Slope, tuning: Tuning, parcels: SlopeParcels) -> None:
    """Decode the occupied rows of `table` (rows, features) into `parcels`."""
    for k in range(table.shape[0]):
        row = table[k]
        if not ta.is_there(row):
            continue
        parcels.x[k] = slope.length - read(row, COLUMN.to_the_end)
        parcels.y[k] = read(row, COLUMN.offset)
        parcels.vx[k] = read(row, COLUMN.forward_speed)
        parcels.vy[k] = read(row, COLUMN.lateral_speed)
        parcels.omega[k] = read(row, COLUMN.turning_speed)
        front, rear = read(row, COLUMN.front), read(row, COLUMN.rear)
        left, right = read(row, COLUMN.left), read(row, COLUMN.right)
        parcels.front[k], parcels.rear[k] = front, rear
        parcels.along[k], parcels.across[k] = 0.5 * (front + rear), 0.5 * (left + right)
        parcels.x[k] += 0.5 * (front - rear)
        parcels.y[k] += 0.5 * (left - right)
        parcels.turn[k] = read(row, COLUMN.to_turn)
        parcels.clear[k] = read(row, COLUMN.clear)
        parcels.runs[k] = read(row, COLUMN.takes_away) > 0.5
        nearest = ta.nearest_mouth(slope.mouths, 0, parcels.y[k])
        parcels.mouth[k] = nearest
        reach = parcels.across[k] + tuning.margin
        low, high = slope.mouths[nearest, 0] + reach, slope.mouths[nearest, 1] - reach
        if low > high:
            low = high = 0.5 * (low + high)
        parcels.shift[k] = max(0.0, low - parcels.y[k]) - max(0.0, parcels.y[k] - high)


class Slots(NamedTuple):
    """The last assigned time slot of each mouth, in arrays (mouths,)."""

    ready: Numbers  # [s] until its parcel's centre passes the end; -inf: no slot is assigned
    # [m] from where that centre would be on the take-away without sliding, to the parcel's rear
    reach: Numbers


@inlined
def forget_slots(slots: Slots) -> None:
    """Clear all slots."""
    for mouth in range(slots.ready.shape[0]):
        slots.ready[mouth] = -math.inf


@inlined
def find_distance(slope: Slope, parcels: SlopeParcels, k: int) -> float:
    """Return the distance [m] from the centre of parcel `k` to the slope's end."""
    return slope.length - parcels.x[k] + 0.5 * (parcels.front[k] - parcels.rear[k])


@inlined
def find_slot(slope: Slope, tuning: Tuning, parcels: SlopeParcels, slots: Slots, k: int) -> float:
    """Return the earliest time [s] from now at which the centre of parcel `k` may pass the end."""
    mouth = parcels.mouth[k]
    front = parcels.front[k] - find_lag(slope, parcels, k) + tuning.spare_gap
    if slots.ready[mouth] == -math.inf:
        return (front - parcels.clear[k]) / slope.take_away
    between = front + slots.reach[mouth] + slope.gap
    return slots.ready[mouth] + between / slope.take_away


@inlined
def find_lag(slope: Slope, parcels: SlopeParcels, k: int) -> float:
    """Return how far [m] parcel `k` falls behind the take-away while it slides on the take-away."""
    gained = 2.0 * slope.rolls * max(0.0, find_distance(slope, parcels, k))
    speed = math.sqrt(max(0.0, parcels.vx[k]) ** 2 + gained)
    slower = max(0.0, slope.take_away - speed)
    return slower * slower / (2.0 * ta.GRIP * GRAVITY)


@inlined
def give_slot(slope: Slope, parcels: SlopeParcels, slots: Slots, k: int, slot: float) -> None:
    """Give parcel `k` a time slot. The parcel's centre is due at the mouth in `slot` seconds."""
    slots.ready[parcels.mouth[k]] = slot
    slots.reach[parcels.mouth[k]] = parcels.rear[k] + find_lag(slope, parcels, k)


@inlined
def rolling_time(slope: Slope, distance: float, speed: float) -> float:
    """Return the time [s] in which a parcel, now at a speed [m/s], rolls a distance [m].

    The parcel accelerates, up to the speed of the take-away.
    """
    start = max(0.0, speed)
    if start >= slope.take_away:
        return distance / slope.take_away
    gained = (slope.take_away * slope.take_away - start * start) / (2.0 * slope.rolls)
    if gained >= distance:
        return (math.sqrt(start * start + 2.0 * slope.rolls * distance) - start) / slope.rolls
    return (slope.take_away - start) / slope.rolls + (distance - gained) / slope.take_away


@inlined
def speed_for(slope: Slope, distance: float, time: float) -> float:
    """Return the speed [m/s] from which a rolling parcel covers a distance [m] in a time [s].

    If the result is negative, the parcel must be held.
    """
    spare = slope.take_away * time - distance
    if spare <= 0.0:
        return slope.take_away
    less = math.sqrt(2.0 * slope.rolls * spare)
    if less <= slope.rolls * time:
        return slope.take_away - less
    return distance / time - 0.5 * slope.rolls * time


@inlined
def stopping_speed(slope: Slope, tuning: Tuning, room: float) -> float:
    """Return the highest speed [m/s] from which a parcel stops within `room` [m]."""
    return math.sqrt(2.0 * tuning.shifting * slope.brakes * max(0.0, room))


@inlined
def follow(slope: Slope, tuning: Tuning, room: float, speed: float) -> float:
    """Return the speed limit [m/s] if the next parcel is `room` [m] ahead at `speed` [m/s]."""
    if room <= 0.0:
        return 0.9 * speed
    return math.sqrt(speed * speed + 2.0 * tuning.following * slope.brakes * room)


class Brakes(NamedTuple):
    """State of braking, in arrays (num_envs, rows)."""

    due: Numbers  # number of halves still to be braked; its whole part is braked next
    halves: Integers  # number of braked halves
    since: Integers  # control periods since `halves` was chosen
    stood: Integers  # control periods without motion


@inlined
def choose_brakes(brakes: Brakes, i: int, k: int, share: float, dwell: int) -> int:
    """Choose how many halves of parcel `k` brake in environment `i`: 0, 1 or 2.

    `share` [-] is the wanted part of full braking, on average over time. A choice lasts for at
    least `dwell` control periods. If `share` becomes 0 or 1, the choice ends at once.
    """
    brakes.since[i, k] += 1
    if share <= 0.0 or share >= 1.0:
        if dwell > 1:
            brakes.halves[i, k] = 0 if share <= 0.0 else 2
            brakes.since[i, k] = dwell
            return brakes.halves[i, k]
    elif brakes.since[i, k] < dwell:
        return brakes.halves[i, k]
    brakes.since[i, k] = 0
    brakes.due[i, k] += 2.0 * min(1.0, max(0.0, share))
    brakes.halves[i, k] = min(2, int(brakes.due[i, k]))
    brakes.due[i, k] = min(1.0, brakes.due[i, k] - brakes.halves[i, k])
    return brakes.halves[i, k]


@linked
def choose_halves(
    slope: Slope, tuning: Tuning, parcels: SlopeParcels, k: int, speed: float, clear: bool,
    brakes: Brakes, i: int, halves: Integers,
) -> None:  # fmt: skip
    """Write actions `halves` (2,) of the modules ahead of and behind the centre of parcel `k`.

    Args:
        speed: [m/s] goal speed after the control period.
        clear: whether the parcel may be led aside.
        brakes: braking state of all environments. The parcel's environment has the index `i`.
    """
    vx, vy, omega = parcels.vx[k], parcels.vy[k], parcels.omega[k]
    shift, turn = parcels.shift[k], parcels.turn[k]
    share = ((vx - speed) / slope.period + slope.rolls) / slope.brakes
    braked = choose_brakes(brakes, i, k, share, slope.dwell)
    brakes.stood[i, k] = brakes.stood[i, k] + 1 if abs(vx) + abs(vy) < STANDS else 0
    halves[0] = BRAKE if braked > 0 else ROLL
    halves[1] = BRAKE if braked > 1 else ROLL
    tolerance = min(tuning.turned, slope.alignment)
    # Without a required alignment, parcels are not turned.
    turns = slope.alignment < ta.EIGHTH - 1e-9 and vx > tuning.least_speed
    if turns and (abs(turn) > tolerance or abs(omega) > 0.8):
        asked = math.sqrt(2.0 * tuning.unturning * max(0.0, abs(turn) - 0.5 * tolerance))
        asked = math.copysign(min(asked, tuning.most_turning), turn)
        if abs(asked - omega) > 0.35:
            if (asked - omega) * asked > 0.0 and abs(asked) > abs(omega):
                near = slope.length - parcels.x[k] < URGENT
                _turn(halves, asked > 0.0, shift, near)
            else:  # rolling stops a turn
                halves[0] = halves[1] = ROLL
            return
    if shift != 0.0 and clear:
        # [m] lateral distance until rolling stops the lateral motion
        coasts = vy * vy / 8.0 + abs(vy) * slope.period
        if vy * shift > 0.0 and abs(shift) <= coasts:
            halves[0] = halves[1] = ROLL
        elif brakes.stood[i, k] % (2 * TRIES) >= TRIES:
            halves[0] = halves[1] = ROLL  # stuck modules may hold a parcel that is led aside
        elif braked < 2 or (vx < HELD and parcels.x[k] > slope.length - LAST):
            halves[0] = halves[1] = TO_LEFT if shift > 0.0 else TO_RIGHT


@inlined
def hold(parcels: SlopeParcels, k: int, speed: float, halves: Integers) -> None:
    """Let both `halves` (2,) of parcel `k` brake if the parcel hardly moves and must stand still.

    The parcel must stand still if its goal speed `speed` [m/s] is close to 0.
    """
    if speed < 0.2 * HELD and parcels.vx[k] < HELD:
        halves[0] = halves[1] = BRAKE


@inlined
def _turn(halves: Integers, left: bool, shift: float, both: bool) -> None:
    """Write actions `halves` (2,) that turn a parcel, anti-clockwise if `left` is true.

    If `both` is false, one half turns the parcel, and the other half lets the parcel roll, so that
    the parcel loses less speed. If the parcel must also move aside by `shift` [m], the half that
    turns the parcel also pushes the parcel towards the side of the shift.
    """
    ahead, behind = (TO_LEFT, TO_RIGHT) if left else (TO_RIGHT, TO_LEFT)
    leads_aside = shift == 0.0 or (shift > 0.0) == left
    halves[0] = ahead if both or leads_aside else ROLL
    halves[1] = ROLL if leads_aside and not both else behind


class SlopeMemory(NamedTuple):
    """What a rule remembers of each row of the parcel table, in arrays (num_envs, rows)."""

    order: Integers  # rows in order of departure; NOBODY: end of the list
    came: Numbers  # [s] last observed time since entry; -inf: empty
    brakes: Brakes


class SlopeRule(BaseStreamRule, CompiledController):
    """A rule for tasks on a slope with a take-away.

    The compiled function writes commands only for rows of the table that hold a parcel.
    """

    def __init__(self, config: EnvConfig) -> None:
        super().__init__(config)
        self._slope = read_slope(config)
        self._tuning = find_tuning(config)
        self._shape: tuple[int | None, int] = (None, len(config.features))
        self._rows = config.rows
        self._parcels = make_parcels(self._rows)
        self._slots = Slots(*np.zeros((2, len(self._slope.mouths))))

    def make_memory(self, num_envs: int, rows: int) -> Any:
        """Return a named tuple of arrays (num_envs, ...), the memory of new episodes."""
        shape = (num_envs, rows)
        brakes = Brakes(np.full(shape, 0.5), *np.zeros((3, *shape), dtype=np.int64))
        return SlopeMemory(np.full(shape, NOBODY), np.full(shape, -np.inf), brakes)

    def make_commands(self, num_envs: int, rows: int) -> Integers:
        """Make commands (num_envs, rows, 2) that let all parcels roll."""
        return np.full((num_envs, rows, 2), ROLL)

    def arguments(self, tables: Singles, memory: Any, commands: Integers) -> tuple[Any, ...]:
        """Return the kernel's arguments for tables (num_envs, rows, features).

        The kernel updates `memory` (see `make_memory`) and `commands` (see `make_commands`).
        """
        return (tables, self._slope, self._tuning, self._parcels, self._slots, *memory, commands)

    def begin(self) -> tuple[Any, ...]:
        tables = np.zeros((1, self._rows, self._shape[1]), dtype=np.float32)
        memory = self.make_memory(1, self._rows)
        return self.arguments(tables, memory, self.make_commands(1, self._rows))

    def _predict(
        self, batch: Singles, state: Any, episode_start: Any, **_: bool
    ) -> tuple[Integers, Any]:
        num_envs, rows, _features = batch.shape
        fresh = is_fresh(num_envs, state, episode_start)
        memory = self.make_memory(num_envs, rows)
        if state is not None:
            known = _list_arrays(checks.alike("state", state, memory))
            for new, old in zip(_list_arrays(memory), known, strict=True):
                new[~fresh] = old[~fresh]
        if len(self._parcels.x) != rows:
            self._parcels = make_parcels(rows)
        commands = self.make_commands(num_envs, rows)
        self.kernel(*self.arguments(batch, memory, commands))
        return self.choices[commands].reshape(num_envs, -1), memory


def _list_arrays(memory: Any) -> list[Any]:
    """List the arrays of nested tuples."""
    if isinstance(memory, tuple):
        return [array for part in memory for array in _list_arrays(part)]
    return [memory]


def read_slope(config: EnvConfig) -> Slope:
    """Read the parameters of the slope from a configuration."""
    task = checks.instance("task", config.task, TakeAwayTask, "one with a take-away")
    line = config.chosen_line
    low, high = line.extent[2] - line.line_y, line.extent[3] - line.line_y
    sine, cosine = math.sin(task.tilt), math.cos(task.tilt)
    along, across = float(np.max(line.mu_max)), float(np.max(line.mu_min))
    speed = config.actuators.axis_speed
    rolls, brakes = GRAVITY * (sine - across * cosine), GRAVITY * cosine * (along - across)
    if config.module_kind.drives:  # their friction pulls as well as it brakes
        rolls, brakes = GRAVITY * (sine + along * cosine), 2.0 * GRAVITY * along * cosine
    if rolls <= 0.0 or rolls >= brakes:
        raise ValueError(
            f"tilt must let parcels roll, and brakes hold them, got {math.degrees(task.tilt):g} deg"
        )
    return Slope(
        length=config.rotors_end - config.entry_x,
        half_width=0.5 * (high - low),
        rolls=rolls,
        brakes=brakes,
        take_away=task.take_away,
        gap=task.gap,
        alignment=task.alignment,
        period=config.control_period,
        dwell=1 if math.isinf(speed) else 1 + math.ceil(DWELL / speed / config.control_period),
        mouths=np.clip([(each.first, each.last) for each in config.exits], low, high),
    )
