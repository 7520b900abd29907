"""Actions and their effect on the modules.

An action becomes a command. A command has one entry for each part of the surface, e.g. one for all
modules ahead of the parcel. An entry is an angle, or the index of an orientation or of a mode.
Compiled functions find a module's part, set the axis by the entry of this part, and turn the axis.
Only rotors in the zone that are not stuck obey; all other axes stay.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from surface_gym import checks, state as st
from surface_gym.compiler.jit import inlined
from surface_gym.layouts import ROLLING
from surface_gym.modules import ACROSS, ALONG, ANGLE, DRIVEN
from surface_gym.physics.contacts import bounded
from surface_gym.physics.step import axis_direction
from surface_gym.physics.types import Array, Integers, X, Y
from surface_gym.state import EnvState, SurfaceState

WINDOW_SIDE = 5  # modules
JUST_OVER_HALF = 0.5 + 1e-9  # midway between two rows, with round-off
SAME = 1e-9  # [rad] angles that differ by less are the same
CONVEYOR = (0.0, 1.0)  # cosine and sine of `ROLLING`, an axis without a command


class ActionParams(NamedTuple):
    """Parameters that compiled functions need to set and turn axes."""

    zone_rows: int  # rows of the widest zone, and of the commands
    orientations: Array  # (choices,) [rad] available axis angles
    turn: float  # [rad] turn of an axis per physics step; infinite: at once
    modes: Array  # (choices + 1, 4) the `Mode` of each choice, then of a module without a command
    ramp: float  # [m/s] change of a driven surface's velocity per physics step; infinite: at once
    step: float = 0.0  # [rad] between positions of an axis, counted from 90 deg; 0: any angle
    play: float = 0.0  # [rad] half of an axis's backlash


class Corner(NamedTuple):
    """Row and column of the first module of the window, the 5 x 5 modules around a parcel."""

    row: int
    column: int


@inlined
def window_corner(state: EnvState, mirror: float) -> Corner:
    """Return the first module of the window, the 5 x 5 modules around the sensed parcel.

    The parcel's row is the middle row of the window. A parcel midway between two rows belongs to
    the left row, or to the right row if `mirror` is negative. So an environment and its mirror
    image have mirrored windows.
    """
    rows, columns = state.rotor.shape
    up = (state.sensed[Y] - state.elements.y0) / state.elements.pitch_y
    along = (state.sensed[X] - state.elements.x0) / state.elements.pitch_x
    # A window beyond the surface contains none of its modules.
    up = bounded(up, -WINDOW_SIDE, rows + WINDOW_SIDE)
    along = bounded(along, -WINDOW_SIDE, columns + WINDOW_SIDE)
    row = math.floor(up + JUST_OVER_HALF) if mirror > 0.0 else math.ceil(up - JUST_OVER_HALF)
    column = math.floor(along + 0.5)
    return Corner(int(row) - WINDOW_SIDE // 2, int(column) - WINDOW_SIDE // 2)


# Index of the command's part for a module; negative if none.


@inlined
def part_of_modules(
    acting: ActionParams, state: EnvState, corner: Corner, row: int, column: int
) -> int:
    """Return the index of the command's entry for the module at `row` and `column`.

    A command has `acting.zone_rows` rows. A zone with fewer rows uses the command's middle rows.
    """
    margin = (acting.zone_rows - state.zone[st.ROWS]) // 2
    place = margin + row - state.zone[st.FIRST_ROW]
    return place * state.zone[st.COLUMNS] + column - state.zone[st.FIRST_COLUMN]


@inlined
def part_of_halves(
    acting: ActionParams, state: EnvState, corner: Corner, row: int, column: int
) -> int:
    """Return 0 if the module's centre is ahead of the parcel's sensed centre (in x), else 1."""
    return 1 if state.elements.x0 + state.elements.pitch_x * column < state.sensed[X] else 0


@inlined
def part_of_quadrants(
    acting: ActionParams, state: EnvState, corner: Corner, row: int, column: int
) -> int:
    """Return 0, 1, 2 or 3 for a module ahead left, ahead right, behind left or behind right.

    The directions are from the parcel's sensed centre.
    """
    behind = state.elements.x0 + state.elements.pitch_x * column < state.sensed[X]
    right = state.elements.y0 + state.elements.pitch_y * row < state.sensed[Y]
    return (2 if behind else 0) + (1 if right else 0)


@inlined
def part_of_window(
    acting: ActionParams, state: EnvState, corner: Corner, row: int, column: int
) -> int:
    """Return a module's index in the window that begins at `corner`, or -1 outside the window."""
    down = row - corner.row
    along = column - corner.column
    inside = 0 <= down < WINDOW_SIDE and 0 <= along < WINDOW_SIDE
    return down * WINDOW_SIDE + along if inside else -1


# Effect of a part of the command on an axis.


@inlined
def set_choice(
    acting: ActionParams, surfaces: SurfaceState, i: int, row: int, column: int, part: int
) -> None:
    """Set a module's axis at once to the orientation in entry `part` of the command.

    Surface `i` of `surfaces` holds the module, at `row` and `column`.
    """
    surfaces.axis[i, row, column] = surfaces.command[i, part]


@inlined
def set_angle(
    acting: ActionParams, surfaces: SurfaceState, i: int, row: int, column: int, part: int
) -> None:
    """Set an axis at once to the angle [rad] in entry `part` of the command; see `set_choice`."""
    angle = surfaces.command[i, part]
    axis = surfaces.axis[i, row, column]
    cosine, sine = axis_direction(angle)
    surfaces.direction[i, axis, 0] = cosine
    surfaces.direction[i, axis, 1] = sine


@inlined
def aim_at_choice(
    acting: ActionParams, surfaces: SurfaceState, i: int, row: int, column: int, part: int
) -> None:
    """Set the target of a slow axis to the orientation in entry `part` of the command."""
    surfaces.target[i, row, column] = acting.orientations[surfaces.command[i, part]]


@inlined
def aim_at_angle(
    acting: ActionParams, surfaces: SurfaceState, i: int, row: int, column: int, part: int
) -> None:
    """Set the target of a slow axis to the angle [rad] in entry `part` of the command."""
    surfaces.target[i, row, column] = surfaces.command[i, part]


@inlined
def aim_at_mode(
    acting: ActionParams, surfaces: SurfaceState, i: int, row: int, column: int, part: int
) -> None:
    """Set the target mode of a driven module. Entry `part` of the command is the mode's index."""
    surfaces.target[i, row, column] = surfaces.command[i, part]


@inlined
def leave_axes(acting: ActionParams, surfaces: SurfaceState, i: int, zone: Integers) -> bool:
    """Turn no axis, because commands set axes without delay. Return False: no axis turned."""
    return False


@inlined
def angle_after(came: float, target: float, turned: float) -> float:
    """Return the angle [rad] of an axis after a turn from the angle `came` towards `target`.

    The axis turns the shorter way to the target, by at most `turned` [rad]. Axes have period pi.
    """
    apart = target - came
    apart -= math.pi * math.floor(apart / math.pi + 0.5)
    return target if turned >= abs(apart) else came + math.copysign(turned, apart)


@inlined
def played_angle(came: float, target: float, step: float, play: float) -> float:
    """Return the angle [rad] at which an axis comes to rest after a turn from `came` to `target`.

    The motor can stop at 90 deg plus multiples of `step` [rad]. The motor takes the position
    nearest to the target. If `step` is 0, the motor stops at the target. The axis stays `play`
    [rad] behind the motor. If the motor stops at most `play` away from the axis, the axis does not
    turn.
    """
    if step > 0.0:
        nearest = ROLLING + step * math.floor((target - ROLLING) / step + 0.5)
        if abs(nearest - target) > SAME:  # a smaller difference is round-off
            target = nearest
    apart = target - came
    apart -= math.pi * math.floor(apart / math.pi + 0.5)
    return came if abs(apart) <= play else target - math.copysign(play, apart)


@inlined
def move_axis(surfaces: SurfaceState, i: int, row: int, column: int, angle: float) -> None:
    """Set the present angle [rad] and the direction (unit vector) of a slow axis."""
    axis = surfaces.axis[i, row, column]
    surfaces.angle[i, row, column] = angle
    cosine, sine = axis_direction(angle)
    surfaces.direction[i, axis, 0] = cosine
    surfaces.direction[i, axis, 1] = sine


@inlined
def turn_axes(acting: ActionParams, surfaces: SurfaceState, i: int, zone: Integers) -> bool:
    """Turn the axes of surface `i`'s zone towards their targets for a physics step.

    Return whether any axis turned. `zone` (4,) is as in `EnvState`.
    """
    turned = False
    for row in range(zone[st.FIRST_ROW], zone[st.FIRST_ROW] + zone[st.ROWS]):
        for column in range(zone[st.FIRST_COLUMN], zone[st.FIRST_COLUMN] + zone[st.COLUMNS]):
            came, target = surfaces.angle[i, row, column], surfaces.target[i, row, column]
            if target - came == 0.0:
                continue
            turned = True
            move_axis(surfaces, i, row, column, angle_after(came, target, acting.turn))
    return turned


@lru_cache(maxsize=2)
def turning_with_limits(loaded: bool) -> Any:
    """Build a function that does what `turn_axes` does, but with motor steps and gear play.

    `loaded` says whether the axis of a module turns while a parcel presses on the module.
    """

    @inlined
    def turn_limited_axes(
        acting: ActionParams, surfaces: SurfaceState, i: int, zone: Integers
    ) -> bool:
        turned = False
        for row in range(zone[st.FIRST_ROW], zone[st.FIRST_ROW] + zone[st.ROWS]):
            for column in range(zone[st.FIRST_COLUMN], zone[st.FIRST_COLUMN] + zone[st.COLUMNS]):
                came, target = surfaces.angle[i, row, column], surfaces.target[i, row, column]
                rest = played_angle(came, target, acting.step, acting.play)
                if rest == came or not (loaded or surfaces.load[i, row, column, st.NOW] == 0.0):
                    continue
                turned = True
                move_axis(surfaces, i, row, column, angle_after(came, rest, acting.turn))
        return turned

    return turn_limited_axes


@inlined
def ramp_modules(acting: ActionParams, surfaces: SurfaceState, i: int, zone: Integers) -> bool:
    """Move the modules in the zone of surface `i` towards their target modes by one physics step.

    Return whether any module changed. `zone` (4,) is as in `EnvState`.
    """
    changed = False
    known, cosine, sine = ROLLING, CONVEYOR[0], CONVEYOR[1]  # modules often turn alike
    for row in range(zone[st.FIRST_ROW], zone[st.FIRST_ROW] + zone[st.ROWS]):
        for column in range(zone[st.FIRST_COLUMN], zone[st.FIRST_COLUMN] + zone[st.COLUMNS]):
            mode = acting.modes[int(surfaces.target[i, row, column])]
            axis = surfaces.axis[i, row, column]
            apart = mode[ANGLE] - surfaces.angle[i, row, column]
            if apart != 0.0:
                changed = True
                # A driven axis has period 2 pi, since its surface has a direction.
                apart -= 2.0 * math.pi * math.floor(apart / (2.0 * math.pi) + 0.5)
                angle = mode[ANGLE]
                if abs(apart) > acting.turn:
                    angle = surfaces.angle[i, row, column] + math.copysign(acting.turn, apart)
                surfaces.angle[i, row, column] = angle
                if angle != known:
                    known = angle
                    cosine, sine = axis_direction(angle)
                surfaces.direction[i, axis, 0] = cosine
                surfaces.direction[i, axis, 1] = sine
            drive = surfaces.drive[i, axis]
            if drive[st.DRIVEN] != mode[DRIVEN]:  # it rolled as an idle rotor
                changed = True
                drive[st.DRIVEN] = mode[DRIVEN]
            along, across = mode[ALONG] - drive[st.ALONG], mode[ACROSS] - drive[st.ACROSS]
            if along != 0.0 or across != 0.0:
                changed = True
                share = min(1.0, acting.ramp / math.sqrt(along * along + across * across))
                if share == 1.0:
                    drive[st.ALONG], drive[st.ACROSS] = mode[ALONG], mode[ACROSS]
                else:
                    drive[st.ALONG] += share * along
                    drive[st.ACROSS] += share * across
    return changed


# Reset of all axes to the conveyor's, at once.


@inlined
def straighten_choices(acting: ActionParams, surfaces: SurfaceState, i: int) -> None:
    """Set each axis of surface `i` to 90 deg.

    This angle is the last entry of `surfaces.direction`.
    """
    conveyor = surfaces.direction.shape[1] - 1
    for row in range(surfaces.axis.shape[1]):
        for column in range(surfaces.axis.shape[2]):
            surfaces.axis[i, row, column] = conveyor


@inlined
def straighten_angles(acting: ActionParams, surfaces: SurfaceState, i: int) -> None:
    """Set the directions of all axes of surface `i` to 90 deg, in `surfaces.direction`."""
    for axis in range(surfaces.direction.shape[1]):
        surfaces.direction[i, axis, 0] = CONVEYOR[0]
        surfaces.direction[i, axis, 1] = CONVEYOR[1]


@inlined
def straighten_targets(acting: ActionParams, surfaces: SurfaceState, i: int) -> None:
    """Set the angle and the target of each axis of surface `i` to 90 deg."""
    straighten_angles(acting, surfaces, i)
    for row in range(surfaces.angle.shape[1]):
        for column in range(surfaces.angle.shape[2]):
            surfaces.angle[i, row, column] = ROLLING
            surfaces.target[i, row, column] = ROLLING


@inlined
def straighten_modes(acting: ActionParams, surfaces: SurfaceState, i: int) -> None:
    """Set each module of surface `i` to the last mode in `acting.modes`.

    Modules that get no command have this mode.
    """
    conveyor = acting.modes.shape[0] - 1
    mode = acting.modes[conveyor]
    cosine, sine = axis_direction(mode[ANGLE])
    for row in range(surfaces.axis.shape[1]):
        for column in range(surfaces.axis.shape[2]):
            axis = surfaces.axis[i, row, column]
            surfaces.angle[i, row, column] = mode[ANGLE]
            surfaces.target[i, row, column] = conveyor
            surfaces.direction[i, axis, 0] = cosine
            surfaces.direction[i, axis, 1] = sine
            for k in range(st.ALONG, st.DRIVEN + 1):
                surfaces.drive[i, axis, k] = mode[ALONG + k]


# Function that returns a module's part, by kind of action.
KINDS: dict[str, Callable[..., Any]] = {
    "modules": part_of_modules,
    "halves": part_of_halves,
    "quadrants": part_of_quadrants,
    "window": part_of_window,
}
ANY = "any"  # in place of orientations: every angle
RIGHT_ANGLE = np.float32(math.pi / 2.0)  # [rad] largest angle of an axis


@dataclass(frozen=True)
class ActionKind:
    """A kind of action. It maps each module of the zone to an entry of a command."""

    name: str  # "modules", "halves", "quadrants" or "window"
    choices: int  # number of orientations; 0: any angle
    rows: int  # rows of the widest zone
    columns: int  # columns of the zone

    def __post_init__(self) -> None:
        checks.one_of("actions", self.name, KINDS)

    @property
    def part_of(self) -> Callable[..., Any]:
        """Return the compiled function that finds the index of a module's entry in a command."""
        return KINDS[self.name]

    @cached_property
    def continuous(self) -> bool:
        """Whether the entries of a command are angles, not indices of choices."""
        return self.choices == 0

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Number of rows and number of columns of a command. The first row has the lowest y."""
        return {
            "modules": (self.rows, self.columns),
            "halves": (1, 2),
            "quadrants": (2, 2),
            "window": (WINDOW_SIDE, WINDOW_SIDE),
        }[self.name]

    @cached_property
    def size(self) -> int:
        return self.shape[0] * self.shape[1]

    @property
    def window_size(self) -> int:
        """Number of features that this kind adds to observations. Only "window" adds features."""
        return self.size if self.name == "window" else 0

    @cached_property
    def _single(self) -> bool:
        """Whether an action is one number that encodes the choices ahead of and behind a parcel."""
        return self.name == "halves" and not self.continuous

    def space(self) -> spaces.Space[Any]:
        if self.continuous:
            return spaces.Box(-RIGHT_ANGLE, RIGHT_ANGLE, (self.size,))
        if self._single:
            return spaces.Discrete(self.choices**2)
        return spaces.MultiDiscrete(np.full(self.size, self.choices))

    def commands(self, actions: Any, num_envs: int | None) -> np.ndarray:
        """Convert actions to commands (num_envs, size). A forbidden action raises a ValueError.

        If `num_envs` is None, `actions` is one environment's action, and the result has one row.
        """
        try:
            given = np.asarray(actions)
        except ValueError:  # parts of different lengths
            raise ValueError(f"action must be an array, got {actions!r}") from None
        if isinstance(actions, np.ma.MaskedArray):
            raise ValueError("action must be an array, got a masked one")
        own = () if self._single else (self.size,)
        if given.shape != (own if num_envs is None else (num_envs, *own)):
            each = "" if num_envs is None else " an environment"
            raise ValueError(f"action must have the shape {own}{each}, got {given.shape}")
        if num_envs is None:
            given = given[np.newaxis]
        if self.continuous:
            return _angles(given, actions)
        most = self.choices**2 if self._single else self.choices
        if given.dtype.kind not in "iu":
            raise ValueError(f"action must be whole numbers, got {given.dtype}: {actions!r}")
        chosen = given.astype(np.int64)
        # As unsigned numbers, negative numbers are the largest.
        if np.maximum.reduce(chosen.view(np.uint64), axis=None) >= most:
            raise ValueError(f"action must be between 0 and {most - 1}, got {actions!r}")
        if self._single:
            halves = np.empty((len(chosen), 2), dtype=np.int64)
            np.divmod(chosen, self.choices, out=(halves[:, 0], halves[:, 1]))
            return halves
        return chosen

    def encode(self, commands: np.ndarray) -> np.ndarray:
        """Convert commands (num_envs, size) to actions, as the inverse of the method `commands`."""
        if self._single:
            return commands[:, 0] * self.choices + commands[:, 1]
        return commands

    def flip(self, commands: np.ndarray) -> np.ndarray:
        """Swap the entries of left and right modules in commands (num_envs, size)."""
        if self.name == "quadrants":
            return commands[:, [1, 0, 3, 2]]
        return commands.reshape(-1, *self.shape)[:, ::-1].reshape(commands.shape)


def _angles(given: np.ndarray, actions: Any) -> Array:
    if given.dtype.kind not in "iuf":
        raise ValueError(f"action must be angles, got {given.dtype}: {actions!r}")
    angles = given.astype(np.float64)
    if not (np.abs(angles) <= RIGHT_ANGLE).all():
        raise ValueError(
            f"action must be between -pi/2 and pi/2, got {actions!r}; {checks.DEGREES}"
        )
    return angles
