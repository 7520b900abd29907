"""What an observation shows beside the task's features, on request: `observe`.

Each group says what a real controller needs to know of it; see `GROUPS`.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

from surface_gym.actions.commands import Acting
from surface_gym.actions.showing import show_nothing
from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.indexing import bounded
from surface_gym.dynamics.types import RADIUS, THETA, X, Y
from surface_gym.lanes.lane import Lane, reach_along
from surface_gym.tasks.task import Feature

QUADRANT_SIZE = 3  # numbers that a quadrant of the parcel shows of its rotors
QUADRANTS = ("ahead left", "ahead right", "behind left", "behind right")

PARCEL_FEATURES = (
    Feature("length", -10.0, 100.0, "(half of it - 0.175 m) / 0.05 m, along the base's x"),
    Feature("width", -10.0, 100.0, "(half of it - 0.175 m) / 0.05 m, along the base's y"),
    Feature("fill", 0.0, 1.0, "share of the base in the rectangle around it"),
)
ROTOR_FEATURES = tuple(
    Feature(f"{name} {quadrant}", low, 1.0, meaning)
    for quadrant in QUADRANTS
    for name, low, meaning in (
        ("rotors", 0.0, "share of the elements under the base that are rotors there"),
        ("cosine of rotors", -1.0, "of twice their angles, mean; 0: none"),
        ("sine of rotors", -1.0, "of twice their angles, mean; 0: none"),
    )
)

LOAD_FEATURES = (
    Feature("friction learned", -100.0, 100.0, "factor of mu_max - 1, over what it was known to"),
    Feature("load learned, x", -100.0, 100.0, "in the base, over what it was known to"),
    Feature("load learned, y", -100.0, 100.0, "in the base, over what it was known to"),
    Feature("doubt of friction", 0.0, 1.0, "share that is left of what was unknown"),
    Feature("doubt of load, x", 0.0, 1.0, "share that is left of what was unknown"),
    Feature("doubt of load, y", 0.0, 1.0, "share that is left of what was unknown"),
)


@inlined
def show_parcel(acting: Acting, lane: Lane, first: int, mirror: float) -> None:
    """Write `PARCEL_FEATURES` into the observation from `first` on."""
    front, rear = reach_along(lane, 0.0, 1.0, 0.0), reach_along(lane, 0.0, -1.0, 0.0)
    left, right = reach_along(lane, 0.0, 0.0, 1.0), reach_along(lane, 0.0, 0.0, -1.0)
    corners = lane.corners
    last = corners.shape[0] - 1
    twice = 0.0  # the area
    for k in range(corners.shape[0]):
        twice += corners[last, 0] * corners[k, 1] - corners[k, 0] * corners[last, 1]
        last = k
    if lane.edges[0, 2] > lane.body[RADIUS]:  # a disc, which has neither edges nor corners
        twice = 2.0 * math.pi * lane.body[RADIUS] ** 2
    lane.observation[first] = (0.5 * (front + rear) - 0.175) / 0.05
    lane.observation[first + 1] = (0.5 * (left + right) - 0.175) / 0.05
    lane.observation[first + 2] = min(1.0, 0.5 * twice / ((front + rear) * (left + right)))


@inlined
def show_rotors(acting: Acting, lane: Lane, first: int, mirror: float) -> None:
    """Write `ROTOR_FEATURES` into the observation from `first` on, left and right exchanged if
    `mirror` is negative.
    """
    see = lane.observation
    for k in range(4 * QUADRANT_SIZE):
        see[first + k] = 0.0
    rows, columns = lane.rotor.shape
    sensed, radius, elements, edges = lane.sensed, lane.body[RADIUS], lane.elements, lane.edges
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
            x, y = cosine * dx + sine * dy, cosine * dy - sine * dx
            under = dx * dx + dy * dy <= radius * radius
            for k in range(edges.shape[0]):
                under = under and edges[k, 0] * x + edges[k, 1] * y <= edges[k, 2]
            if not under:
                continue
            total += 1
            if lane.rotor[row, column]:
                right = mirror * dy < 0.0
                place = first + QUADRANT_SIZE * ((2 if dx < 0.0 else 0) + (1 if right else 0))
                axis = lane.axis[row, column]
                ux, uy = lane.direction[axis, 0], lane.direction[axis, 1]
                see[place] += 1.0
                see[place + 1] += ux * ux - uy * uy
                see[place + 2] += mirror * 2.0 * ux * uy
    for quadrant in range(4):
        place = first + QUADRANT_SIZE * quadrant
        count = see[place]
        if count > 0.0:
            see[place] = count / total
            see[place + 1] = bounded(see[place + 1] / count, -1.0, 1.0)
            see[place + 2] = bounded(see[place + 2] / count, -1.0, 1.0)


class Group(NamedTuple):
    """Features that are shown together."""

    features: tuple[Feature, ...]
    show: Callable[..., None]  # the compiled function that writes them


GROUPS = {
    # The parcel's outline, by a scale drawing or a picture; not where its load lies.
    "parcel": Group(PARCEL_FEATURES, show_parcel),
    # Each axis' angle, by encoders or reckoned from what it was told; and where supports are.
    "rotors": Group(ROTOR_FEATURES, show_rotors),
    # What a sensor that learns has learned; its own function writes it.
    "load": Group(LOAD_FEATURES, show_nothing),
}


class Shown(NamedTuple):
    """A group as a kernel is built from it."""

    show: Callable[..., None]
    size: int  # numbers it writes


def shown(observe: tuple[str, ...]) -> tuple[Shown, ...]:
    """Every group in order, one that is not asked for with nothing to write."""
    return tuple(
        Shown(group.show, len(group.features)) if name in observe else Shown(show_nothing, 0)
        for name, group in GROUPS.items()
    )


def features_of(observe: tuple[str, ...]) -> tuple[Feature, ...]:
    """What the groups asked for show."""
    return tuple(
        feature for name, group in GROUPS.items() if name in observe for feature in group.features
    )
