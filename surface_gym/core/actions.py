"""Actions: their meaning for the modules, and features of the modules in the observation.

A command is one number a part: an index into the orientations on offer, or an angle. Which part a
module follows, what a number says and how an axis turns are functions that a batch's kernel is
built from. Only rotors that obey turn; every other axis stays as it is.

Each group says what a real controller needs to know of it; see `GROUPS`.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces

from surface_gym import checks, state as st
from surface_gym.compiler.jit import inlined, is_compiled
from surface_gym.layouts import ROLLING
from surface_gym.physics.contacts import bounded
from surface_gym.physics.step import axis_direction
from surface_gym.physics.types import RADIUS, THETA, Array, Integers, X, Y
from surface_gym.sensors.base import Group, Sensor, Singles
from surface_gym.state import EnvState, SurfaceState
from surface_gym.tasks.base import LENGTH, WIDTH
from surface_gym.tasks.features import Feature, columns, show

WINDOW_SIDE = 5  # modules
JUST_OVER_HALF = 0.5 + 1e-9  # midway between two rows, whatever the round-off
CONVEYOR = (0.0, 1.0)  # cosine and sine of `ROLLING`, an axis without a command


class ActionParams(NamedTuple):
    """Parameters by which commands turn axes."""

    zone_rows: int  # rows of the widest zone, for which there are commands
    orientations: Array  # (choices,) [rad] axis angles on offer
    turn: float  # [rad] an axis turns in a physics step; infinite: at once


class Corner(NamedTuple):
    """Row and column of the window's first module."""

    row: int
    column: int


@inlined
def window_corner(state: EnvState, mirror: float) -> Corner:
    """Return the window's first module; the parcel is sensed over its middle one.

    Midway between two rows it is the one to the left, seen in the mirror if there is one: a
    mirrored environment must have the mirrored window.
    """
    rows, columns = state.rotor.shape
    up = (state.sensed[Y] - state.elements.y0) / state.elements.pitch_y
    along = (state.sensed[X] - state.elements.x0) / state.elements.pitch_x
    # A window beyond the surface has none of its modules, however far off it is.
    up = bounded(up, -WINDOW_SIDE, rows + WINDOW_SIDE)
    along = bounded(along, -WINDOW_SIDE, columns + WINDOW_SIDE)
    row = math.floor(up + JUST_OVER_HALF) if mirror > 0.0 else math.ceil(up - JUST_OVER_HALF)
    column = math.floor(along + 0.5)
    return Corner(int(row) - WINDOW_SIDE // 2, int(column) - WINDOW_SIDE // 2)


# Which part of the command a module follows; negative if none.


@inlined
def part_of_modules(
    acting: ActionParams, state: EnvState, corner: Corner, row: int, column: int
) -> int:
    """Give each module a part of its own. A narrow zone is the middle rows of the widest."""
    margin = (acting.zone_rows - state.zone[st.ROWS]) // 2
    place = margin + row - state.zone[st.FIRST_ROW]
    return place * state.zone[st.COLUMNS] + column - state.zone[st.FIRST_COLUMN]


@inlined
def part_of_halves(
    acting: ActionParams, state: EnvState, corner: Corner, row: int, column: int
) -> int:
    """Give a part to the modules ahead of the parcel's centre, and one to those behind it."""
    return 1 if state.elements.x0 + state.elements.pitch_x * column < state.sensed[X] else 0


@inlined
def part_of_quadrants(
    acting: ActionParams, state: EnvState, corner: Corner, row: int, column: int
) -> int:
    """Give parts to the modules ahead left, ahead right, behind left and behind right."""
    behind = state.elements.x0 + state.elements.pitch_x * column < state.sensed[X]
    right = state.elements.y0 + state.elements.pitch_y * row < state.sensed[Y]
    return (2 if behind else 0) + (1 if right else 0)


@inlined
def part_of_window(
    acting: ActionParams, state: EnvState, corner: Corner, row: int, column: int
) -> int:
    """Give each module of the window a part of its own."""
    down = row - corner.row
    along = column - corner.column
    inside = 0 <= down < WINDOW_SIDE and 0 <= along < WINDOW_SIDE
    return down * WINDOW_SIDE + along if inside else -1


# How an axis does what a part of the command says.


@inlined
def set_choice(
    acting: ActionParams, surfaces: SurfaceState, i: int, row: int, column: int, part: int
) -> None:
    """Set an axis to the orientation that the part counts, at once."""
    surfaces.axis[i, row, column] = surfaces.command[i, part]


@inlined
def set_angle(
    acting: ActionParams, surfaces: SurfaceState, i: int, row: int, column: int, part: int
) -> None:
    """Set an axis to the angle of the part, at once."""
    angle = surfaces.command[i, part]
    axis = surfaces.axis[i, row, column]
    cosine, sine = axis_direction(angle)
    surfaces.direction[i, axis, 0] = cosine
    surfaces.direction[i, axis, 1] = sine


@inlined
def aim_at_choice(
    acting: ActionParams, surfaces: SurfaceState, i: int, row: int, column: int, part: int
) -> None:
    """Set the orientation that the part counts as the target of an axis that turns in time."""
    surfaces.target[i, row, column] = acting.orientations[surfaces.command[i, part]]


@inlined
def aim_at_angle(
    acting: ActionParams, surfaces: SurfaceState, i: int, row: int, column: int, part: int
) -> None:
    """Set the angle of the part as the target of an axis that turns in time."""
    surfaces.target[i, row, column] = surfaces.command[i, part]


@inlined
def leave_axes(acting: ActionParams, surfaces: SurfaceState, i: int, zone: Integers) -> bool:
    """Leave axes as they are: they have turned already."""
    return False


@inlined
def turn_axes(acting: ActionParams, surfaces: SurfaceState, i: int, zone: Integers) -> bool:
    """Turn each axis of the zone towards its target for a physics step; return whether any did."""
    turned = False
    for row in range(zone[st.FIRST_ROW], zone[st.FIRST_ROW] + zone[st.ROWS]):
        for column in range(zone[st.FIRST_COLUMN], zone[st.FIRST_COLUMN] + zone[st.COLUMNS]):
            apart = surfaces.target[i, row, column] - surfaces.angle[i, row, column]
            if apart == 0.0:
                continue
            turned = True
            # An axis is the same turned by pi: go the way of at most a quarter turn.
            apart -= math.pi * math.floor(apart / math.pi + 0.5)
            if abs(apart) <= acting.turn:
                angle = surfaces.target[i, row, column]
            else:
                angle = surfaces.angle[i, row, column] + math.copysign(acting.turn, apart)
            axis = surfaces.axis[i, row, column]
            surfaces.angle[i, row, column] = angle
            cosine, sine = axis_direction(angle)
            surfaces.direction[i, axis, 0] = cosine
            surfaces.direction[i, axis, 1] = sine
    return turned


# How all axes become the conveyor's, at once.


@inlined
def straighten_choices(acting: ActionParams, surfaces: SurfaceState, i: int) -> None:
    """Set all axes to the direction that follows those on offer."""
    conveyor = surfaces.direction.shape[1] - 1
    for row in range(surfaces.axis.shape[1]):
        for column in range(surfaces.axis.shape[2]):
            surfaces.axis[i, row, column] = conveyor


@inlined
def straighten_angles(acting: ActionParams, surfaces: SurfaceState, i: int) -> None:
    """Set each axis, which has its own direction, to 90 deg."""
    for axis in range(surfaces.direction.shape[1]):
        surfaces.direction[i, axis, 0] = CONVEYOR[0]
        surfaces.direction[i, axis, 1] = CONVEYOR[1]


@inlined
def straighten_targets(acting: ActionParams, surfaces: SurfaceState, i: int) -> None:
    """Set each axis and its target to 90 deg."""
    straighten_angles(acting, surfaces, i)
    for row in range(surfaces.angle.shape[1]):
        for column in range(surfaces.angle.shape[2]):
            surfaces.angle[i, row, column] = ROLLING
            surfaces.target[i, row, column] = ROLLING


AXIS_SIZE = 2  # numbers that show an axis: cosine and sine of twice its angle, as it has no ends


@inlined
def show_nothing(acting: ActionParams, state: EnvState, first: int, mirror: float) -> None:
    """Add nothing to the task's features."""


@inlined
def _is_under(state: EnvState, cosine: float, sine: float, dx: float, dy: float) -> bool:
    """Return whether a point (dx, dy) [m] from the sensed centroid is under the base, which is
    turned by an angle of this cosine and sine.
    """
    x, y = cosine * dx + sine * dy, cosine * dy - sine * dx
    edges, radius = state.edges, state.body[RADIUS]
    under = dx * dx + dy * dy <= radius * radius
    for k in range(edges.shape[0]):
        under = under and edges[k, 0] * x + edges[k, 1] * y <= edges[k, 2]
    return under


@inlined
def show_occupancy(acting: ActionParams, state: EnvState, first: int, mirror: float) -> None:
    """Write the window's occupancy into the observation from `first` on:

    1 for each module that obeys and is sensed to lie under the parcel, rows reversed if `mirror` is
    negative.
    """
    corner = window_corner(state, mirror)
    rows, columns = state.rotor.shape
    sensed = state.sensed
    cosine = math.cos(sensed[THETA])
    sine = math.sin(sensed[THETA])
    for down in range(WINDOW_SIDE):
        for along in range(WINDOW_SIDE):
            row = corner.row + down
            column = corner.column + along
            seen = 0.0
            if 0 <= row < rows and 0 <= column < columns and state.obeys[row, column]:
                dx = state.elements.x0 + state.elements.pitch_x * column - sensed[X]
                dy = state.elements.y0 + state.elements.pitch_y * row - sensed[Y]
                seen = 1.0 if _is_under(state, cosine, sine, dx, dy) else 0.0
            shown = down if mirror > 0.0 else WINDOW_SIDE - 1 - down
            state.observation[first + shown * WINDOW_SIDE + along] = seen


@inlined
def _show_axis(state: EnvState, row: int, column: int, place: int, mirror: float) -> None:
    """Write a module's axis into the observation from `place` on; 0 where there is no rotor."""
    rows, columns = state.rotor.shape
    twice_cosine = twice_sine = 0.0
    if 0 <= row < rows and 0 <= column < columns and state.rotor[row, column]:
        cosine = state.direction[state.axis[row, column], 0]
        sine = state.direction[state.axis[row, column], 1]
        twice_cosine = cosine * cosine - sine * sine
        twice_sine = mirror * 2.0 * sine * cosine
    state.observation[place] = twice_cosine
    state.observation[place + 1] = twice_sine


@inlined
def show_window_axes(acting: ActionParams, state: EnvState, first: int, mirror: float) -> None:
    """Write the axes of the window's modules into the observation from `first` on."""
    corner = window_corner(state, mirror)
    for down in range(WINDOW_SIDE):
        for along in range(WINDOW_SIDE):
            shown = down if mirror > 0.0 else WINDOW_SIDE - 1 - down
            place = first + AXIS_SIZE * (shown * WINDOW_SIDE + along)
            _show_axis(state, corner.row + down, corner.column + along, place, mirror)


@inlined
def show_zone_axes(acting: ActionParams, state: EnvState, first: int, mirror: float) -> None:
    """Write the axes of the zone's modules into the observation from `first` on."""
    columns = state.zone[st.COLUMNS]
    margin = (acting.zone_rows - state.zone[st.ROWS]) // 2
    for place in range(acting.zone_rows):
        down = place - margin if mirror > 0.0 else state.zone[st.ROWS] - 1 - (place - margin)
        inside = 0 <= down < state.zone[st.ROWS]
        row = state.zone[st.FIRST_ROW] + down if inside else -1
        for along in range(columns):
            column = state.zone[st.FIRST_COLUMN] + along
            _show_axis(state, row, column, first + AXIS_SIZE * (place * columns + along), mirror)


QUADRANT_SIZE = 3  # numbers that a quadrant of the parcel shows of its rotors
QUADRANTS = ("ahead left", "ahead right", "behind left", "behind right")

PARCEL_FEATURES = (
    LENGTH,
    WIDTH,
    Feature("fill", 0.0, 1.0, "share of the base in the rectangle around it"),
)
OUTLINE = columns(PARCEL_FEATURES)
ROTOR_FEATURES = tuple(
    Feature(f"{name} {quadrant}", low, 1.0, meaning)
    for quadrant in QUADRANTS
    for name, low, meaning in (
        ("rotors", 0.0, "share of the elements under the base that are rotors there"),
        ("cosine of rotors", -1.0, "of twice their angles, mean; 0: none"),
        ("sine of rotors", -1.0, "of twice their angles, mean; 0: none"),
    )
)


@inlined
def show_parcel(acting: ActionParams, state: EnvState, see: Singles, mirror: float) -> None:
    """Write `PARCEL_FEATURES`."""
    front, rear = st.reach_along(state, 0.0, 1.0, 0.0), st.reach_along(state, 0.0, -1.0, 0.0)
    left, right = st.reach_along(state, 0.0, 0.0, 1.0), st.reach_along(state, 0.0, 0.0, -1.0)
    corners = state.corners
    last = corners.shape[0] - 1
    twice = 0.0  # the area
    for k in range(corners.shape[0]):
        twice += corners[last, 0] * corners[k, 1] - corners[k, 0] * corners[last, 1]
        last = k
    if state.edges[0, 2] > state.body[RADIUS]:  # a disc, which has neither edges nor corners
        twice = 2.0 * math.pi * state.body[RADIUS] ** 2
    show(see, OUTLINE.length, 0.5 * (front + rear))
    show(see, OUTLINE.width, 0.5 * (left + right))
    show(see, OUTLINE.fill, min(1.0, 0.5 * twice / ((front + rear) * (left + right))))


@inlined
def show_rotors(acting: ActionParams, state: EnvState, see: Singles, mirror: float) -> None:
    """Write `ROTOR_FEATURES`, mirrored if `mirror` < 0."""
    for k in range(4 * QUADRANT_SIZE):
        see[k] = 0.0
    rows, columns = state.rotor.shape
    sensed, radius, elements = state.sensed, state.body[RADIUS], state.elements
    cosine, sine = math.cos(sensed[THETA]), math.sin(sensed[THETA])
    up = (sensed[Y] - elements.y0) / elements.pitch_y
    along = (sensed[X] - elements.x0) / elements.pitch_x
    tall, long = radius / elements.pitch_y, radius / elements.pitch_x
    total = 0
    for row in range(
        math.ceil(bounded(up - tall, 0.0, float(rows))),
        math.floor(bounded(up + tall, -1.0, rows - 1.0)) + 1,
    ):
        for column in range(
            math.ceil(bounded(along - long, 0.0, float(columns))),
            math.floor(bounded(along + long, -1.0, columns - 1.0)) + 1,
        ):
            dx = elements.x0 + elements.pitch_x * column - sensed[X]
            dy = elements.y0 + elements.pitch_y * row - sensed[Y]
            if not _is_under(state, cosine, sine, dx, dy):
                continue
            total += 1
            if state.rotor[row, column]:
                right = mirror * dy < 0.0
                place = QUADRANT_SIZE * ((2 if dx < 0.0 else 0) + (1 if right else 0))
                axis = state.axis[row, column]
                ux, uy = state.direction[axis, 0], state.direction[axis, 1]
                see[place] += 1.0
                see[place + 1] += ux * ux - uy * uy
                see[place + 2] += mirror * 2.0 * ux * uy
    for quadrant in range(4):
        place = QUADRANT_SIZE * quadrant
        count = see[place]
        if count > 0.0:
            see[place] = count / total
            see[place + 1] = bounded(see[place + 1] / count, -1.0, 1.0)
            see[place + 2] = bounded(see[place + 2] / count, -1.0, 1.0)


# Groups of features of one parcel for `observe`, in addition to its sensor's features.
MODULE_GROUPS = {
    # The parcel's outline, by a scale drawing or a picture; not where its load lies.
    "parcel": Group(PARCEL_FEATURES, show_parcel),
    # Each axis' angle, by encoders or computed from its commands; and where supports are.
    "rotors": Group(ROTOR_FEATURES, show_rotors),
}
# With every sensor; what a sensor that learns has learned is its own.
GROUPS: dict[str, Group] = {**MODULE_GROUPS, **Sensor().groups}


def offered_groups(sensor: Sensor) -> dict[str, Group]:
    """Return the groups that `observe` may show with a sensor, or raise an error."""
    for name, group in sensor.groups.items():
        author = f"{type(sensor).__name__}.groups"
        if name in MODULE_GROUPS:
            raise ValueError(f"{author} must have names of their own, got {name!r}")
        checks.instance(f"{author}[{name!r}]", group, Group, "a Group")
        if not is_compiled(group.show):
            raise ValueError(f"{author} must show by kernel functions, got {group.show!r}")
    return {**MODULE_GROUPS, **sensor.groups}


def group_features(
    observe: tuple[str, ...], groups: Mapping[str, Group] = GROUPS
) -> tuple[Feature, ...]:
    """Return the features of the groups asked for."""
    return tuple(
        feature for name, group in groups.items() if name in observe for feature in group.features
    )


# Kinds of action by name: which part of it a module follows.
KINDS: dict[str, Callable[..., Any]] = {
    "modules": part_of_modules,
    "halves": part_of_halves,
    "quadrants": part_of_quadrants,
    "window": part_of_window,
}
ANY = "any"  # in place of orientations on offer: every angle
RIGHT_ANGLE = np.float32(math.pi / 2.0)  # [rad] an axis turned further is one turned less


@dataclass(frozen=True)
class ActionKind:
    """A kind of action: how it sets the axes of a zone's modules."""

    name: str  # "modules", "halves", "quadrants" or "window"
    choices: int  # orientations on offer; 0: any angle
    rows: int  # of the widest zone
    columns: int  # of the zone

    def __post_init__(self) -> None:
        checks.one_of("actions", self.name, KINDS)

    @property
    def part_of(self) -> Callable[..., Any]:
        """Return the compiled function that gives the part of an action that a module follows."""
        return KINDS[self.name]

    @cached_property
    def continuous(self) -> bool:
        """Return whether each part is an angle instead of a choice."""
        return self.choices == 0

    @cached_property
    def shape(self) -> tuple[int, int]:
        """Return the rows, from y < 0 to y > 0, and columns of the parts of a command."""
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
        """Return how many numbers the kind adds to the observation: the window's occupancy."""
        return self.size if self.name == "window" else 0

    @cached_property
    def _single(self) -> bool:
        """Return whether an action is one number: the choices of both halves."""
        return self.name == "halves" and not self.continuous

    def space(self) -> spaces.Space[Any]:
        if self.continuous:
            return spaces.Box(-RIGHT_ANGLE, RIGHT_ANGLE, (self.size,))
        if self._single:
            return spaces.Discrete(self.choices**2)
        return spaces.MultiDiscrete(np.full(self.size, self.choices))

    def commands(self, actions: Any, num_envs: int | None) -> np.ndarray:
        """Turn the actions of all environments into commands (num_envs, size).

        With None, `actions` is the action of the only one.
        """
        try:
            given = np.asarray(actions)
        except ValueError:  # parts of different lengths
            raise ValueError(f"action must be an array, got {actions!r}") from None
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
        # As unsigned numbers negative ones are the largest.
        if np.maximum.reduce(chosen.view(np.uint64), axis=None) >= most:
            raise ValueError(f"action must be between 0 and {most - 1}, got {actions!r}")
        if self._single:
            halves = np.empty((len(chosen), 2), dtype=np.int64)
            np.divmod(chosen, self.choices, out=(halves[:, 0], halves[:, 1]))
            return halves
        return chosen

    def encode(self, commands: np.ndarray) -> np.ndarray:
        """Return commands (num_envs, size) as actions, the inverse of `commands`."""
        if self._single:
            return commands[:, 0] * self.choices + commands[:, 1]
        return commands

    def flip(self, commands: np.ndarray) -> np.ndarray:
        """Return commands (num_envs, size) with their parts mirrored in y, choices unchanged."""
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
