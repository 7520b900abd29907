"""What rules on slopes share: how they see parcels, and how they brake, turn and lead them aside.

They see the table of parcels and choose, for each, the modules ahead of its centre and those behind
it.
"""

import copy
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

from ..base import BatchController, Booleans, Integers, Numbers, Singles, find_axes, is_fresh
from .base import CompiledController

NOBODY = -1
HELD = 0.1  # [m/s] slower than this, all modules may hold a parcel
URGENT = 2.0  # [m] before the end, from where on both halves turn a parcel
LAST = 1.0  # [m] before the end, where one that stands is led aside at once if it may be
STANDS = 0.02  # [m/s] slower than this, a parcel counts as one that stands
TRIES = 10  # control periods for which one that stands is led aside, or let roll, in turn
DWELL = 0.375 * math.pi  # [rad] that an axis could turn while a choice of brakes stays
ROLL, BRAKE, TO_LEFT, TO_RIGHT = range(4)  # of a half, before they become choices


class Slope(NamedTuple):
    """The surface, the take-away and what is asked, as rules count on them."""

    length: float  # [m] of the rotors
    half_width: float  # [m] of the surface
    rolls: float  # [m/s^2] gained by a parcel that rolls
    brakes: float  # [m/s^2] that full braking takes from that
    take_away: float  # [m/s]
    gap: float  # [m]
    alignment: float  # [rad]
    period: float  # [s] between decisions
    dwell: int  # control periods for which a choice of brakes stays
    mouths: Numbers  # (mouths, 2) [m] y of their sides from the line's middle


class Tuning(NamedTuple):
    """Constants of the rules, found by search: see docs/material-flow.md."""

    swap: float = 0.03  # [m] that a parcel must be ahead of another to go first
    margin: float = 0.004  # [m] kept from the sides of a mouth
    spare_gap: float = 0.014  # [m] beyond the asked gap
    shift_time: float = 0.01  # [s] that it costs to be led aside,
    shift_cost: float = 0.68  # [s/m] and for each metre
    turn_cost: float = 0.23  # [s/rad] that it costs to be turned
    clear: float = 0.11  # [m] between two, one behind the other
    following: float = 0.38  # [-] share of full braking that one counts on that follows another
    shifting: float = 0.4  # [-] and one that waits to be led aside
    shift_room: float = 0.33  # [m] before the end by which it must be led aside
    least_speed: float = 0.08  # [m/s] at which modules may turn a parcel
    turned: float = 0.08  # [rad] that a parcel is left turned by
    unturning: float = 10.8  # [rad/s^2] at which a turn can be stopped
    most_turning: float = 4.0  # [rad/s]
    ahead: float = 0.1  # [m] to be clear ahead of one that is led aside,
    behind: float = 0.21  # [m] behind it,
    beside: float = 0.003  # [m] and beside it
    merged: float = 0.52  # [-] of the length, by which parcels for one mouth follow each other
    headway: float = 0.02  # [s] that they then are apart
    yielding: float = 0.96  # [1/m] share of its speed that one yields that is too near


LATE_ROOM = 0.6  # [m] before the end by which it must be led aside where axes turn late
SPARE = 0.02  # [m] beyond the asked gap where sensors err


def find_tuning(config: EnvConfig) -> Tuning:
    """Find the constants for an environment's sensors."""
    tuning = Tuning() if isinstance(config.sensors, Exact) else Tuning(spare_gap=SPARE)
    if math.isinf(config.actuators.axis_speed):
        return tuning
    return tuning._replace(shift_room=LATE_ROOM)


class SlopeParcels(NamedTuple):
    """Parcels of a surface, decoded from their rows; an array (rows,) each."""

    x: Numbers  # [m] along the line from the surface's start, of the middle of its extent
    y: Numbers  # [m] from the line's middle, of the middle of its extent
    vx: Numbers  # [m/s]
    vy: Numbers  # [m/s]
    omega: Numbers  # [rad/s]
    front: Numbers  # [m] from its centre along x
    rear: Numbers  # [m] from its centre against x
    along: Numbers  # [m] half of its extent along x
    across: Numbers  # [m] half of its extent along y
    shift: Numbers  # [m] to be led aside, positive to the left; 0: it is within a mouth
    turn: Numbers  # [rad] to be turned
    mouth: Integers  # nearest mouth
    clear: Numbers  # [m] that its mouth's last parcel is past the asked gap
    runs: Booleans  # whether the take-away runs


def make_parcels(rows: int) -> SlopeParcels:
    """Make room for the parcels of a surface."""
    kinds = SlopeParcels.__annotations__
    types = {"mouth": np.int64, "runs": np.bool_}
    arrays: dict[str, Any] = {name: np.zeros(rows, types.get(name, np.float64)) for name in kinds}
    return SlopeParcels(**arrays)


@linked
def read_parcels(table: Singles, slope: Slope, tuning: Tuning, parcels: SlopeParcels) -> None:
    """Decode the rows of a table (rows, features) that hold a parcel."""
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
    """The last slots given away, an array (mouths,) each."""

    ready: Numbers  # [s] until that parcel's centre passes the end; -inf: none was given away
    # [m] from where its centre would be on the take-away, without sliding, to its rear
    reach: Numbers


@inlined
def forget_slots(slots: Slots) -> None:
    """Forget all slots that were given away."""
    for mouth in range(slots.ready.shape[0]):
        slots.ready[mouth] = -math.inf


@inlined
def find_distance(slope: Slope, parcels: SlopeParcels, k: int) -> float:
    """Find how far [m] a parcel's centre is from the end."""
    return slope.length - parcels.x[k] + 0.5 * (parcels.front[k] - parcels.rear[k])


@inlined
def find_slot(slope: Slope, tuning: Tuning, parcels: SlopeParcels, slots: Slots, k: int) -> float:
    """Find how soon [s] a parcel's centre may pass the end, for the gap to those before it."""
    mouth = parcels.mouth[k]
    front = parcels.front[k] - find_lag(slope, parcels, k) + tuning.spare_gap
    if slots.ready[mouth] == -math.inf:
        return (front - parcels.clear[k]) / slope.take_away
    between = front + slots.reach[mouth] + slope.gap
    return slots.ready[mouth] + between / slope.take_away


@inlined
def find_lag(slope: Slope, parcels: SlopeParcels, k: int) -> float:
    """Find how far [m] a parcel falls back on the take-away until it has its speed."""
    gained = 2.0 * slope.rolls * max(0.0, find_distance(slope, parcels, k))
    speed = math.sqrt(max(0.0, parcels.vx[k]) ** 2 + gained)
    slower = max(0.0, slope.take_away - speed)
    return slower * slower / (2.0 * ta.GRIP * GRAVITY)


@inlined
def give_slot(slope: Slope, parcels: SlopeParcels, slots: Slots, k: int, slot: float) -> None:
    """Give a parcel a slot [s] from now."""
    slots.ready[parcels.mouth[k]] = slot
    slots.reach[parcels.mouth[k]] = parcels.rear[k] + find_lag(slope, parcels, k)


@inlined
def rolling_time(slope: Slope, distance: float, speed: float) -> float:
    """[s] over a distance [m] for one that rolls, but no faster than the take-away."""
    start = max(0.0, speed)
    if start >= slope.take_away:
        return distance / slope.take_away
    gained = (slope.take_away * slope.take_away - start * start) / (2.0 * slope.rolls)
    if gained >= distance:
        return (math.sqrt(start * start + 2.0 * slope.rolls * distance) - start) / slope.rolls
    return (slope.take_away - start) / slope.rolls + (distance - gained) / slope.take_away


@inlined
def speed_for(slope: Slope, distance: float, time: float) -> float:
    """[m/s] from which one that rolls covers a distance [m] in a time [s]; negative: hold it."""
    spare = slope.take_away * time - distance
    if spare <= 0.0:
        return slope.take_away
    less = math.sqrt(2.0 * slope.rolls * spare)
    if less <= slope.rolls * time:
        return slope.take_away - less
    return distance / time - 0.5 * slope.rolls * time


@inlined
def stopping_speed(slope: Slope, tuning: Tuning, room: float) -> float:
    """[m/s] from which a parcel stops within a room [m]."""
    return math.sqrt(2.0 * tuning.shifting * slope.brakes * max(0.0, room))


@inlined
def follow(slope: Slope, tuning: Tuning, room: float, speed: float) -> float:
    """[m/s] at most for one that follows another of a speed [m/s] with room [m] between them."""
    if room <= 0.0:
        return 0.9 * speed
    return math.sqrt(speed * speed + 2.0 * tuning.following * slope.brakes * room)


class Brakes(NamedTuple):
    """How parcels are braked, an array (num_envs, rows) each."""

    due: Numbers  # halves that are yet to be braked, as a choice of none, one or both rounds
    halves: Integers  # that are braked
    since: Integers  # control periods since that was chosen
    stood: Integers  # control periods for which it has stood


@inlined
def choose_brakes(brakes: Brakes, i: int, k: int, share: float, dwell: int) -> int:
    """Choose how many halves of a parcel are to be braked, so that they make up a share over time.

    A choice stays for some control periods, unless all or nothing is to be braked.
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
    """Choose (2,) for the modules ahead of a parcel's centre and behind it.

    Args:
        speed: [m/s] that it is to have after the control period.
        clear: whether it may be led aside.
        brakes: of all environments.
        i: the environment.
    """
    vx, vy, omega = parcels.vx[k], parcels.vy[k], parcels.omega[k]
    shift, turn = parcels.shift[k], parcels.turn[k]
    share = ((vx - speed) / slope.period + slope.rolls) / slope.brakes
    braked = choose_brakes(brakes, i, k, share, slope.dwell)
    brakes.stood[i, k] = brakes.stood[i, k] + 1 if abs(vx) + abs(vy) < STANDS else 0
    halves[0] = BRAKE if braked > 0 else ROLL
    halves[1] = BRAKE if braked > 1 else ROLL
    tolerance = min(tuning.turned, slope.alignment)
    # With no alignment asked parcels stay as they are.
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
        coasts = vy * vy / 8.0 + abs(vy) * slope.period  # [m] until rolling has stopped it
        if vy * shift > 0.0 and abs(shift) <= coasts:
            halves[0] = halves[1] = ROLL
        elif brakes.stood[i, k] % (2 * TRIES) >= TRIES:
            halves[0] = halves[1] = ROLL  # modules that are stuck may hold one that is led aside
        elif braked < 2 or (vx < HELD and parcels.x[k] > slope.length - LAST):
            halves[0] = halves[1] = TO_LEFT if shift > 0.0 else TO_RIGHT


@inlined
def hold(parcels: SlopeParcels, k: int, speed: float, halves: Integers) -> None:
    """Let all modules hold a parcel that is to stand, so that it does not creep."""
    if speed < 0.2 * HELD and parcels.vx[k] < HELD:
        halves[0] = halves[1] = BRAKE


@inlined
def _turn(halves: Integers, left: bool, shift: float, both: bool) -> None:
    """Turn a parcel anti-clockwise (`left`) or clockwise, by both halves or by one.

    One half brakes less. A parcel with a `shift` is turned by the half that also leads it aside.
    """
    ahead, behind = (TO_LEFT, TO_RIGHT) if left else (TO_RIGHT, TO_LEFT)
    leads_aside = shift == 0.0 or (shift > 0.0) == left
    halves[0] = ahead if both or leads_aside else ROLL
    halves[1] = ROLL if leads_aside and not both else behind


class SlopeMemory(NamedTuple):
    """What a rule remembers, an array (num_envs, rows) each."""

    order: Integers  # rows in which parcels are to leave; NOBODY: no more
    came: Numbers  # time since each entered, as seen last; -inf: nobody
    brakes: Brakes


def make_memory(num_envs: int, rows: int) -> SlopeMemory:
    """Make the memory of a rule."""
    shape = (num_envs, rows)
    brakes = Brakes(np.zeros(shape), *np.zeros((3, *shape), dtype=np.int64))
    return SlopeMemory(np.full(shape, NOBODY), np.full(shape, -np.inf), brakes)


def forget(memory: SlopeMemory, fresh: Booleans) -> None:
    """Forget the parcels of environments (num_envs,) that have begun anew."""
    memory.order[fresh] = NOBODY
    memory.came[fresh] = -np.inf
    memory.brakes.due[fresh] = 0.5
    memory.brakes.halves[fresh] = memory.brakes.since[fresh] = memory.brakes.stood[fresh] = 0


class SlopeRule(BatchController, CompiledController):
    """A rule for tasks on a slope with a take-away, by `actions="parcels"`.

    Its function leaves the halves of free rows as they are.
    """

    def __init__(self, config: EnvConfig, tuning: Tuning | None = None) -> None:
        checks.one_of("actions", config.actions, ("parcels",))
        checks.instance("task", config.task, TakeAwayTask, "one with a take-away")
        if config.action_kind.continuous:
            raise ValueError(f"orientations must be some on offer, got {config.orientations!r}")
        axes = find_axes(config)
        self.choices = np.array([axes.roll, axes.brake, axes.left, axes.right])  # by half
        self._slope = read_slope(config)
        self._tuning = find_tuning(config) if tuning is None else tuning
        # Rows of another environment serve as well.
        self._shape: tuple[int | None, int] = (None, len(config.features))
        self._rows = config.rows
        self._parcels = make_parcels(self._rows)
        self._slots = Slots(*np.zeros((2, len(self._slope.mouths))))

    def arguments(self, tables: Singles, memory: SlopeMemory, halves: Integers) -> tuple[Any, ...]:
        """List what the kernel takes, to decide by tables (num_envs, rows, features)."""
        return (tables, self._slope, self._tuning, self._parcels, self._slots, *memory, halves)

    def begin(self) -> tuple[Any, ...]:
        rows, memory = self._rows, make_memory(1, self._rows)
        forget(memory, np.ones(1, dtype=np.bool_))
        tables = np.zeros((1, rows, self._shape[1]), dtype=np.float32)
        return self.arguments(tables, memory, np.zeros((1, rows, 2), dtype=np.int64))

    def _predict(
        self, batch: Singles, state: Any, episode_start: Any, **_: bool
    ) -> tuple[Integers, SlopeMemory]:
        num_envs, rows, _features = batch.shape
        fresh = is_fresh(num_envs, state, episode_start)
        memory = make_memory(num_envs, rows)
        if state is not None:
            memory = copy.deepcopy(checks.alike("state", state, memory))
        forget(memory, fresh)
        if len(self._parcels.x) != rows:
            self._parcels = make_parcels(rows)
        halves = np.full((num_envs, rows, 2), ROLL)
        self.kernel(*self.arguments(batch, memory, halves))
        return self.choices[halves].reshape(num_envs, -1), memory


def read_slope(config: EnvConfig) -> Slope:
    """Read the surface, the take-away and what is asked from a configuration."""
    task = checks.instance("task", config.task, TakeAwayTask, "one with a take-away")
    line = config.chosen_line
    low, high = line.extent[2] - line.line_y, line.extent[3] - line.line_y
    sine, cosine = math.sin(task.tilt), math.cos(task.tilt)
    along, across = float(np.max(line.mu_max)), float(np.max(line.mu_min))
    speed = config.actuators.axis_speed
    rolls, brakes = GRAVITY * (sine - across * cosine), GRAVITY * cosine * (along - across)
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
