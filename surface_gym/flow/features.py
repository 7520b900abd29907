"""What a controller sees of a flow: a row of numbers for each place on the surface.

The row of a parcel that is to leave to y < 0 is mirrored, so that it always asks for y > 0: what
is learned for one side serves both.
"""

import math

from surface_gym.flow.memory import FIRST, LAST, SIDE
from surface_gym.physics.jit import inlined
from surface_gym.physics.types import HALF_LENGTH, OMEGA, THETA, VX, VY, X, Y
from surface_gym.state import ROWS, EnvState, reach_along, zone_start
from surface_gym.tasks.base import Feature
from surface_gym.tasks.sort import FEATURES as SORT_FEATURES
from surface_gym.tasks.sort import HORIZON

FAR = 4.0  # [m] to a neighbour that is not there, and the farthest that is told of one
NEIGHBOUR = (
    ("gap", -20.0, 20.0, "clear along x / 0.5 m; 8: there is none"),
    ("speed", -20.0, 20.0, "its vx over the own / 0.5 m/s"),
    ("offset", -20.0, 20.0, "its y over the own, towards the asked side / 0.3 m"),
    ("side", -1.0, 1.0, "it is to leave by: 1 as this one, -1 the other, 0 straight on"),
    ("size", -10.0, 100.0, "of it, as of this one"),
)
NEIGHBOUR_SIZE = len(NEIGHBOUR)

# The first are those of Sort, so that what sorts one parcel can sort each of a flow.
OWN = len(SORT_FEATURES)
FEATURES: tuple[Feature, ...] = (
    *SORT_FEATURES[:12],
    Feature("time", -1000.0, 1000.0, "since it entered / 4 s; negative: since its time came"),
    Feature(
        "past the exit's start", -20.0, 20.0, "of its rear / 0.5 m; straight on: of the zone's"
    ),
    Feature("side", -1.0, 1.0, "of its exit: 1 for y > 0, -1 for y < 0, 0 for straight on"),
    Feature("present", 0.0, 1.0, "1: there is a parcel; 0: none, and so is all else"),
    Feature("width", -10.0, 100.0, "(half width - 0.175 m) / 0.05 m"),
    Feature("to the exit's end", -20.0, 20.0, "from its centre / 0.5 m; straight on: 20"),
    Feature("waits", 0.0, 1.0, "1: at the gate, to enter next; 0: on the line"),
    *(
        Feature(f"{name} {where}", low, high, meaning)
        for where in ("ahead", "behind")
        for name, low, high, meaning in NEIGHBOUR
    ),
)
PRESENT = OWN
WAITS = OWN + 3
AHEAD = OWN + 4  # place of the first number of the neighbour ahead
BEHIND = AHEAD + NEIGHBOUR_SIZE


@inlined
def mirror_of(state: EnvState) -> float:
    """-1 where a parcel's row is mirrored, else 1."""
    return -1.0 if state.goal[SIDE] < 0.0 else 1.0


@inlined
def _within(value: float, most: float) -> float:
    return min(most, max(-most, value))


@inlined
def exit_start(state: EnvState) -> float:
    """[m] x that a parcel's rear must be past before it may be turned off: its exit's first, or the
    zone's where that comes later or it goes straight on.
    """
    start = zone_start(state)
    return start if state.goal[SIDE] == 0.0 else max(start, state.goal[FIRST])


@inlined
def show_nobody(state: EnvState) -> None:
    """The row of a place that is free."""
    for k in range(state.observation.shape[0]):
        state.observation[k] = 0.0


@inlined
def show_parcel(state: EnvState, waits: bool) -> None:
    """What the sensor says of a parcel, its neighbours apart; and whether it waits to enter."""
    sensed = state.sensed
    mirror = mirror_of(state)
    x, theta = sensed[X], sensed[THETA]
    offset = mirror * (sensed[Y] - state.elements.line_y)
    turn_x = 2.0 * math.pi / state.elements.pitch_x
    turn_y = 2.0 * math.pi / state.elements.pitch_y
    half_line = 0.5 * state.elements.pitch_y * (state.zone[ROWS] - 1)
    half_width = reach_along(state, 0.0, 0.0, 1.0)
    rear = x - reach_along(state, theta, -1.0, 0.0)
    side = state.goal[SIDE]
    see = state.observation
    see[0] = _within(offset / 0.3, 10.0)
    see[1] = mirror * math.sin(theta)
    see[2] = math.cos(theta)
    see[3] = _within(sensed[VX] - 1.0, 10.0)
    see[4] = _within(mirror * sensed[VY] / 0.5, 20.0)
    see[5] = _within(mirror * sensed[OMEGA] / 3.0, 50.0)
    see[6] = (state.body[HALF_LENGTH] - 0.175) / 0.05
    clearance = offset - reach_along(state, theta, 0.0, -mirror) - half_line
    see[7] = _within(clearance / 0.2, 20.0)
    see[8] = math.sin(turn_x * (x - state.elements.x0))
    see[9] = math.cos(turn_x * (x - state.elements.x0))
    see[10] = math.sin(turn_y * offset)
    see[11] = math.cos(turn_y * offset)
    see[12] = state.clock / HORIZON
    see[13] = _within((rear - exit_start(state)) / 0.5, 20.0)
    see[14] = side
    see[PRESENT] = 1.0
    see[PRESENT + 1] = (half_width - 0.175) / 0.05
    see[PRESENT + 3] = 1.0 if waits else 0.0
    see[PRESENT + 2] = 20.0 if side == 0.0 else _within((state.goal[LAST] - x) / 0.5, 20.0)


@inlined
def show_neighbour(state: EnvState, first: int, gap: float, other: EnvState) -> None:
    """A neighbour, clear by a gap [m] along x, into the row from `first` on."""
    mirror = mirror_of(state)
    see = state.observation
    see[first] = _within(gap / 0.5, 2.0 * FAR)
    see[first + 1] = _within((other.sensed[VX] - state.sensed[VX]) / 0.5, 20.0)
    see[first + 2] = _within(mirror * (other.sensed[Y] - state.sensed[Y]) / 0.3, 20.0)
    see[first + 3] = mirror * other.goal[SIDE]
    see[first + 4] = (other.body[HALF_LENGTH] - 0.175) / 0.05


@inlined
def show_no_neighbour(state: EnvState, first: int) -> None:
    """There is none that way."""
    see = state.observation
    see[first] = 2.0 * FAR
    for k in range(1, NEIGHBOUR_SIZE):
        see[first + k] = 0.0
