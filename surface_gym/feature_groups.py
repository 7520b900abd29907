"""Groups of features for `observe`: the outline of the parcel, and the rotors below it.

Comments in `MODULE_GROUPS` say from which source a real controller knows each group.
"""

import math
from collections.abc import Mapping

from surface_gym import checks, state as st
from surface_gym.actions import WINDOW_SIDE, ActionParams, window_corner
from surface_gym.compiler.jit import inlined, is_compiled
from surface_gym.physics.contacts import bounded
from surface_gym.physics.types import RADIUS, THETA, X, Y
from surface_gym.sensors.base import Group, Sensor, Singles
from surface_gym.state import EnvState
from surface_gym.tasks.base import LENGTH, WIDTH
from surface_gym.tasks.features import Feature, columns, show

# features of a module: cosine and sine of twice its axis angle, which has period pi; if driven, the
# velocity of its surface
AXIS_SIZE = 2
SHOWN_DRIVE = 2.0  # [m/s] scale of this velocity


@inlined
def show_nothing(acting: ActionParams, state: EnvState, first: int, mirror: float) -> None:
    """Add nothing to the task's features."""


@inlined
def _is_under(state: EnvState, cosine: float, sine: float, dx: float, dy: float) -> bool:
    """Return whether the point at (dx, dy) [m] from the sensed centroid is under the base.

    `cosine` and `sine` belong to the sensed angle of the base.
    """
    x, y = cosine * dx + sine * dy, cosine * dy - sine * dx
    edges, radius = state.edges, state.body[RADIUS]
    under = dx * dx + dy * dy <= radius * radius
    for k in range(edges.shape[0]):
        under = under and edges[k, 0] * x + edges[k, 1] * y <= edges[k, 2]
    return under


@inlined
def show_occupancy(acting: ActionParams, state: EnvState, first: int, mirror: float) -> None:
    """Write the occupancy of the 5 x 5 modules around the parcel into the observation.

    Modules that obey commands and are under the sensed parcel have occupancy 1. Other modules have
    occupancy 0. The first entry has the index `first`. If `mirror` is -1, the order of rows is
    reversed.
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
    """Write two features of the module at `row` and `column` into the observation.

    The features describe an idle module's axis, or the velocity of a driven module's surface. The
    second feature, the y component, is multiplied by `mirror` (1 or -1). A support's features are
    0. `place` is the index of the first feature in the observation.
    """
    rows, columns = state.rotor.shape
    first = second = 0.0
    if 0 <= row < rows and 0 <= column < columns and state.rotor[row, column]:
        axis = state.axis[row, column]
        cosine, sine = state.direction[axis, 0], state.direction[axis, 1]
        if state.drive[axis, st.DRIVEN] > 0.0:
            along, across = state.drive[axis, st.ALONG], state.drive[axis, st.ACROSS]
            first = (cosine * along - sine * across) / SHOWN_DRIVE
            second = mirror * (sine * along + cosine * across) / SHOWN_DRIVE
        else:
            first = cosine * cosine - sine * sine
            second = mirror * 2.0 * sine * cosine
    state.observation[place] = first
    state.observation[place + 1] = second


@inlined
def show_window_axes(acting: ActionParams, state: EnvState, first: int, mirror: float) -> None:
    """Write the axes of the 5 x 5 modules around the parcel into the observation from `first` on.

    If `mirror` is -1, the axes are mirrored in y and the order of rows is reversed.
    """
    corner = window_corner(state, mirror)
    for down in range(WINDOW_SIDE):
        for along in range(WINDOW_SIDE):
            shown = down if mirror > 0.0 else WINDOW_SIDE - 1 - down
            place = first + AXIS_SIZE * (shown * WINDOW_SIDE + along)
            _show_axis(state, corner.row + down, corner.column + along, place, mirror)


@inlined
def show_zone_axes(acting: ActionParams, state: EnvState, first: int, mirror: float) -> None:
    """Write the axes of the zone's modules into the observation, beginning at the index `first`.

    If `mirror` is -1, the axes are mirrored in y and the order of rows is reversed.
    """
    columns = state.zone[st.COLUMNS]
    margin = (acting.zone_rows - state.zone[st.ROWS]) // 2
    for place in range(acting.zone_rows):
        down = place - margin if mirror > 0.0 else state.zone[st.ROWS] - 1 - (place - margin)
        inside = 0 <= down < state.zone[st.ROWS]
        row = state.zone[st.FIRST_ROW] + down if inside else -1
        for along in range(columns):
            column = state.zone[st.FIRST_COLUMN] + along
            _show_axis(state, row, column, first + AXIS_SIZE * (place * columns + along), mirror)


QUADRANT_SIZE = 3  # features of the rotors in a quadrant of the parcel
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
    """Write `PARCEL_FEATURES` into `see`, this group's part of the observation."""
    front, rear = st.reach_along(state, 0.0, 1.0, 0.0), st.reach_along(state, 0.0, -1.0, 0.0)
    left, right = st.reach_along(state, 0.0, 0.0, 1.0), st.reach_along(state, 0.0, 0.0, -1.0)
    corners = state.corners
    last = corners.shape[0] - 1
    twice = 0.0  # the area
    for k in range(corners.shape[0]):
        twice += corners[last, 0] * corners[k, 1] - corners[k, 0] * corners[last, 1]
        last = k
    if state.edges[0, 2] > state.body[RADIUS]:  # a disc without edges and corners
        twice = 2.0 * math.pi * state.body[RADIUS] ** 2
    show(see, OUTLINE.length, 0.5 * (front + rear))
    show(see, OUTLINE.width, 0.5 * (left + right))
    show(see, OUTLINE.fill, min(1.0, 0.5 * twice / ((front + rear) * (left + right))))


@inlined
def show_rotors(acting: ActionParams, state: EnvState, see: Singles, mirror: float) -> None:
    """Write `ROTOR_FEATURES` into `see`, mirrored in y if `mirror` is -1."""
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
    # Known from a drawing or a picture of the parcel; the load's position stays unknown.
    "parcel": Group(PARCEL_FEATURES, show_parcel),
    # Known from encoders, or computed from commands; and the positions of supports.
    "rotors": Group(ROTOR_FEATURES, show_rotors),
}
# Available with every sensor, in addition to the sensor's own groups.
GROUPS: dict[str, Group] = {**MODULE_GROUPS, **Sensor().groups}


def offered_groups(sensor: Sensor) -> dict[str, Group]:
    """Return the groups that `observe` may name. Raise an error if a sensor's group is invalid."""
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
    """Return the features of the groups whose names are in `observe`, in the order of `groups`."""
    return tuple(
        feature for name, group in groups.items() if name in observe for feature in group.features
    )
