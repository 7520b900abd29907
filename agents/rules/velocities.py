"""A rule of driven modules for Singulate and Merge: velocities of a rigid motion.
A drive moves the surfaces of one module or of a column; a mode is a velocity of the surface.

Each parcel has wanted speeds along and across the line and a wanted turning speed, as in
`patterns`. They give a wanted velocity for each point of the parcel. A drive takes the mode that
brings the points above its modules nearest to their wanted velocities.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from surface_gym import checks
from surface_gym.compiler.jit import compiled, inlined, linked
from surface_gym.config import EnvConfig
from surface_gym.flow.take_away import COLUMN, is_there
from surface_gym.modules import surface_velocities
from surface_gym.sensors import Exact
from surface_gym.tasks.features import read

from ..base import Booleans, Integers, Numbers, Singles
from .base import Commands
from .patterns import (
    LONG,
    NEAR,
    SHIFT,
    TURN,
    PatternTuning,
    find_centre,
    find_outside,
    find_stuck,
    read_places,
    sort_parcels,
    want_motion,
)
from .slopes import (
    NOBODY,
    Slope,
    SlopeParcels,
    SlopeRule,
    Slots,
    Tuning,
    find_distance,
    forget_slots,
    read_parcels,
)

# Found by search, on other streams than the reported ones.
AIM = PatternTuning(lateral=1.0, lateral_stop=3.0, turning_from=0.1)
ALIGNMENT = math.radians(10.0)  # turned parcels are shorter, also where any angle is allowed
SHORTER = 0.03  # [m] least difference of a parcel's sides for which it is turned
LATEST = 1.5  # [m] least distance from the end at which it is turned
AXIS_COST = 0.005  # [m^2/s^2] of an axis that turns
INEXACT = 0.02  # [m] reserve of the gap that is added with inexact sensors
STEP = 0.5  # [m/s] between two speeds of a drive that merely runs or stands


class DriveTuning(NamedTuple):
    """Parameters of the rule that depend on the drives."""

    pull: float  # [m/s^2] planned acceleration of a parcel on its way to the end
    slot_from: float  # [m] position from which parcels are braked for their slots
    clear: float  # [m] distance between successive parcels
    spare_gap: float  # [m] reserve of the gap
    slip_cost: float  # [-] cost of a squared slip


MANY_SPEEDS = DriveTuning(1.5, 0.8, 0.06, 0.01, 0.002)
ONE_SPEED = DriveTuning(3.5, 0.8, 0.12, 0.025, 0.0001)
TOGETHER = DriveTuning(4.9, 4.0, 0.3, 0.01, 0.002)  # a drive for a column
MODULES, COLUMNS = "modules", "columns"  # parts of the surface with their own drive


class DriveGrid(NamedTuple):
    """The modules of a surface, and what their drives can do."""

    x: Numbers  # (columns,) [m] from the surface's start
    y: Numbers  # (rows,) [m] from the line's middle
    rotor: Booleans  # (rows, columns) a module, else a support
    drive: Integers  # (modules,) index of the drive that moves a module
    velocity: Numbers  # (modes, 2) [m/s] of a surface
    axis: Numbers  # (modes,) [rad] angle of an axis, with period 2 pi
    rest: int  # mode of a drive without a parcel
    aside: bool  # whether parcels may be led aside
    change: float  # [m/s] of a parcel by friction in a control period
    slip_cost: float  # [-] of a squared slip


class DriveScratch(NamedTuple):
    """Scratch arrays, which every decision of the rule overwrites."""

    wanted: Numbers  # (rows, 3) [m/s, m/s, rad/s] motion of each parcel
    nearest: Numbers  # (modules,) [m] distance of the obeyed parcel
    owner: Integers  # (modules,) row of the obeyed parcel; NOBODY: none
    leader: Integers  # (drives,) row of the first parcel in order that a drive moves
    cost: Numbers  # (drives, modes) [m^2/s^2]


@linked
def own_modules(
    grid: DriveGrid, parcels: SlopeParcels, row: Singles, k: int, nearest: Numbers, owner: Integers
) -> None:
    """Assign to parcel `k` the modules that the parcel covers now or soon.

    Skip a module if another parcel is nearer. For the assigned modules, `owner` (modules,) gets
    `k`, and `nearest` (modules,) gets the distances [m] to the parcel. `row` (features,) is the
    parcel's observation.
    """
    x, y = find_centre(parcels, row, k)
    ahead, aside = parcels.vx[k] * AIM.sooner, parcels.vy[k] * AIM.sooner
    columns = grid.x.shape[0]
    for c in range(columns):
        dx = grid.x[c] - parcels.x[k]
        if not min(0.0, ahead) - parcels.along[k] <= dx <= max(0.0, ahead) + parcels.along[k]:
            continue
        for r in range(grid.y.shape[0]):
            dy, m = grid.y[r] - parcels.y[k], r * columns + c
            reach = parcels.across[k]
            if not (grid.rotor[r, c] and min(0.0, aside) - reach <= dy <= max(0.0, aside) + reach):
                continue
            dx_centre, dy_centre = grid.x[c] - x, grid.y[r] - y
            far = max(0.0, find_outside(row, dx_centre, dy_centre, 0.0))
            far += 1e-3 * math.sqrt(dx_centre * dx_centre + dy_centre * dy_centre)
            if far < nearest[m]:
                nearest[m], owner[m] = far, k


@inlined
def turn_narrow(slope: Slope, row: Singles, parcels: SlopeParcels, k: int) -> None:
    """Change `parcels.turn[k]` so that the shorter side of parcel `k` will lie along the line.

    Nothing changes if the sides differ by `SHORTER` or less, or if the slope's end is nearer than
    `LATEST`. `row` (features,) is the parcel's observation.
    """
    length, width = read(row, COLUMN.length), read(row, COLUMN.width)
    lies_along = abs(row[COLUMN.cosine_of_theta.place]) > abs(row[COLUMN.sine_of_theta.place])
    longer = 2.0 * (length - width) if lies_along else 2.0 * (width - length)
    if longer > SHORTER and find_distance(slope, parcels, k) > LATEST:
        parcels.turn[k] -= math.copysign(0.5 * math.pi, parcels.turn[k])


@linked
def choose_modes(
    grid: DriveGrid, parcels: SlopeParcels, table: Singles, scratch: DriveScratch, chosen: Integers
) -> None:
    """Write the mode with the least cost for each drive to `chosen` (drives,).

    A drive obeys its foremost parcel. The cost of a mode is a sum over the drive's modules under
    this parcel. Each module adds the square of the error in the parcel's velocity at the module,
    and small costs of slip and of a turn of the axis. The entries of drives without a parcel do not
    change.
    """
    modes, columns, cost = grid.velocity.shape[0], grid.x.shape[0], scratch.cost
    cost[:] = 0.0
    for m in range(scratch.owner.shape[0]):
        k, drive = scratch.owner[m], grid.drive[m]
        if k == NOBODY or k != scratch.leader[drive]:
            continue
        x, y = find_centre(parcels, table[k], k)
        dx, dy, wanted = grid.x[m % columns] - x, grid.y[m // columns] - y, scratch.wanted[k]
        vx, vy = parcels.vx[k] - parcels.omega[k] * dy, parcels.vy[k] + parcels.omega[k] * dx
        want_x, want_y = wanted[0] - wanted[2] * dy, wanted[1] + wanted[2] * dx
        for mode in range(modes):
            slip_x, slip_y = grid.velocity[mode, 0] - vx, grid.velocity[mode, 1] - vy
            slip = math.sqrt(slip_x * slip_x + slip_y * slip_y)
            share = min(1.0, grid.change / max(slip, 1e-9))
            off_x, off_y = vx + share * slip_x - want_x, vy + share * slip_y - want_y
            cost[drive, mode] += off_x * off_x + off_y * off_y + grid.slip_cost * slip * slip
            if grid.axis[mode] != grid.axis[chosen[drive]]:
                cost[drive, mode] += AXIS_COST
    for drive in range(chosen.shape[0]):
        if scratch.leader[drive] != NOBODY:
            chosen[drive] = cost[drive].argmin()


@compiled
def choose_velocities(
    tables: Singles, slope: Slope, tuning: Tuning, aim: PatternTuning, grid: DriveGrid,
    parcels: SlopeParcels, slots: Slots, scratch: DriveScratch, order: Integers, came: Numbers,
    stood: Integers, chosen: Integers, commands: Integers,
) -> None:  # fmt: skip
    """Write modes `commands` (num_envs, modules), so that parcels depart one by one.

    `tables` are (num_envs, rows, features). A `DriveMemory` holds `order`, `came`, `stood` and
    `chosen`.
    """
    for i in range(tables.shape[0]):
        table = tables[i]
        read_parcels(table, slope, tuning, parcels)
        for k in range(table.shape[0]):
            if abs(parcels.shift[k]) < NEAR or not grid.aside:
                parcels.shift[k] = 0.0
            if is_there(table[k]):
                turn_narrow(slope, table[k], parcels, k)
        count = sort_parcels(table, tuning, parcels, order[i], came[i], stood[i])
        stuck = find_stuck(parcels, order[i], count, stood[i])
        forget_slots(slots)
        scratch.nearest[:] = math.inf
        scratch.owner[:] = scratch.leader[:] = NOBODY
        for place in range(count):
            k = order[i, place]
            goes = stuck and stood[i, k] > LONG
            speed, lateral, turning = want_motion(
                slope, tuning, aim, parcels, slots, order[i], count, place, goes
            )
            scratch.wanted[k, 0], scratch.wanted[k, 1] = max(0.0, speed), lateral
            scratch.wanted[k, 2] = turning
            own_modules(grid, parcels, table[k], k, scratch.nearest, scratch.owner)
        for place in range(count - 1, -1, -1):
            for m in range(scratch.owner.shape[0]):
                if scratch.owner[m] == order[i, place]:
                    scratch.leader[grid.drive[m]] = order[i, place]
        choose_modes(grid, parcels, table, scratch, chosen[i])
        for m in range(commands.shape[1]):
            drive = grid.drive[m]
            commands[i, m] = chosen[i, drive] if scratch.leader[drive] != NOBODY else grid.rest


class DriveMemory(NamedTuple):
    """Memory of the rule, in arrays (num_envs, ...)."""

    order: Integers  # (num_envs, rows) rows in order of departure; NOBODY: end of the list
    came: Numbers  # (num_envs, rows) [s] last observed time since entry; -inf: empty
    stood: Integers  # (num_envs, rows) control periods without motion
    chosen: Integers  # (num_envs, drives) mode of each drive below a parcel


class VelocityRule(SlopeRule):
    """Give each parcel a time slot. The modules' surfaces below a parcel move like a rigid body.

    Args:
        config: configuration with actions "modules" and driven modules.
        drives: "modules" for one drive per module, "columns" for one drive per column.
    """

    kernel = staticmethod(choose_velocities)
    acts_by = "modules"

    def __init__(self, config: EnvConfig, drives: str = MODULES) -> None:
        checks.one_of("modules", config.module_kind.drives, (True,))
        checks.one_of("drives", drives, (MODULES, COLUMNS))
        super().__init__(config)
        velocity = surface_velocities(config.modes[:-1])
        own = TOGETHER if drives == COLUMNS else MANY_SPEEDS
        speeds = np.unique(np.hypot(*velocity.T).round(6))
        if drives == MODULES and np.diff(speeds).max(initial=0.0) > STEP:
            own = ONE_SPEED
        spare = own.spare_gap + (0.0 if isinstance(config.sensors, Exact) else INEXACT)
        self._tuning = self._tuning._replace(
            clear=own.clear, spare_gap=spare, shift_cost=SHIFT, turn_cost=TURN
        )
        self._aim = AIM._replace(slot_from=own.slot_from)
        grip, alignment = 0.5 * self._slope.brakes, min(ALIGNMENT, self._slope.alignment)
        pull = min(own.pull, self._slope.rolls)
        self._slope = self._slope._replace(rolls=pull, alignment=alignment)
        x, y, rotor = read_places(config)
        self._modules = config.action_kind.size
        number = np.arange(self._modules)
        ahead = np.abs(velocity - [self._slope.take_away, 0.0]).sum(axis=1)
        self._grid = DriveGrid(
            x, y, rotor, number if drives == MODULES else number % len(x), velocity,
            np.array(config.chosen_orientations), int(ahead.argmin()),
            bool((np.abs(velocity[:, 1]) > NEAR).any()), grip * config.control_period,
            own.slip_cost,
        )  # fmt: skip
        self._scratch = self._make_scratch(self._rows)

    def _list_choices(self, config: EnvConfig) -> Commands:
        return np.arange(config.choices)

    def _make_scratch(self, rows: int) -> DriveScratch:
        count = 1 + int(self._grid.drive.max())
        return DriveScratch(
            np.zeros((rows, 3)), np.zeros(self._modules), np.zeros(self._modules, dtype=np.int64),
            np.zeros(count, dtype=np.int64), np.zeros((count, len(self._grid.velocity))),
        )  # fmt: skip

    def make_memory(self, num_envs: int, rows: int) -> Any:
        shape = (num_envs, rows)
        return DriveMemory(
            np.full(shape, NOBODY), np.full(shape, -np.inf), np.zeros(shape, dtype=np.int64),
            np.full((num_envs, len(self._scratch.leader)), self._grid.rest),
        )  # fmt: skip

    def make_commands(self, num_envs: int, rows: int) -> Integers:
        if len(self._scratch.wanted) != rows:
            self._scratch = self._make_scratch(rows)
        return np.full((num_envs, self._modules), self._grid.rest)

    def arguments(self, tables: Singles, memory: Any, commands: Integers) -> tuple[Any, ...]:
        tables, slope, tuning, parcels, slots, *more = super().arguments(tables, memory, commands)
        return (tables, slope, tuning, self._aim, self._grid, parcels, slots, self._scratch, *more)
