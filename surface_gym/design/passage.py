"""Parcels sent over a line, compiled: each run until the parcel has left, passed or come to rest.

Nothing is recorded on the way but what a design asks for. The step is the one of `simulate`.
"""

from typing import NamedTuple

from surface_gym.physics.collision import read_body
from surface_gym.physics.contacts import invalidate_contacts
from surface_gym.physics.jit import compiled, inlined
from surface_gym.physics.step import OFF_SURFACE, TIPPING, step_implicit
from surface_gym.physics.types import (
    AX,
    AY,
    OMEGA,
    RADIUS,
    SPAN_FIRST,
    SPAN_LAST,
    SPAN_ROW,
    SPANS,
    VX,
    VY,
    Array,
    Bodies,
    Booleans,
    Grid,
    Integers,
    Places,
    Scratch,
)
from surface_gym.state import (
    ACROSS_FACTOR,
    ALONG_FACTOR,
    GRAVITY_ALONG,
    GRAVITY_NORMAL,
    SUPPORT_FACTOR,
)

# How a run ends.
OUT, PAST, AT_REST, OFF, OUT_OF_TIME = range(5)
ENDS = (
    "out of the line",  # no rotor bears the parcel
    "past the zone",  # every rotor that bears it lies behind the zone
    "at rest",
    "off the surface",
    "out of time",
)

# Columns of `Passages.number`.
LAYOUT, GROUND, PARCEL, EXIT, STEPS = range(5)
HOW, TOUCHED, DONE, TIPPED = range(4)  # columns of `Passages.end`

REST_SPEED = 1e-4  # [m/s] below which a parcel may be at rest: rolling takes it in 1 ms
REST_CHANGE = 1e-3  # [m/s^2] below which it stays so


class Deck(NamedTuple):
    """Surfaces that differ in their axes and in how stiff their elements are."""

    axis: Places  # (layouts, rows, columns) the place of each rotor's axis in `direction`
    direction: Array  # (directions, 2) cosine and sine
    rotor: Booleans  # (rows, columns)
    stiffness: Array  # (grounds, rows, columns) [-]
    friction: Array  # (rows, columns, 3) [-] as `Grid.friction`
    x0: float  # [m] centre of element [0, 0]
    y0: float  # [m]
    pitch_x: float  # [m]
    pitch_y: float  # [m]


class Passages(NamedTuple):
    """Runs, a row each: what they are given, and what comes of them."""

    # (runs, 5) layout, ground and parcel by their rows; first column behind the zone; most steps
    number: Integers
    condition: Array  # (runs, 5) as `Surfaces.conditions`
    state: Array  # (runs, STATE_SIZE) at the start, and in its place at the end
    # (runs, 4) how it ended; last column with a rotor that bore it; steps done, steps tipping
    end: Integers


@inlined
def grid_of(deck: Deck, number: Integers, condition: Array) -> Grid:
    """The surface of a run."""
    return Grid(
        deck.axis[number[LAYOUT]],
        deck.direction,
        deck.rotor,
        deck.stiffness[number[GROUND]],
        deck.friction,
        deck.x0,
        deck.y0,
        deck.pitch_x,
        deck.pitch_y,
        condition[ALONG_FACTOR],
        condition[ACROSS_FACTOR],
        condition[SUPPORT_FACTOR],
        condition[GRAVITY_ALONG],
        condition[GRAVITY_NORMAL],
    )


@inlined
def rotor_span(deck: Deck, scratch: Scratch) -> tuple[int, int]:
    """First and last column with a rotor under the parcel; the first exceeds if there is none."""
    marks = scratch.marks
    lowest = deck.rotor.shape[1]
    highest = -1
    for k in range(marks[SPANS]):
        row = marks[SPAN_ROW + k]
        first = marks[SPAN_FIRST + k]
        last = marks[SPAN_LAST + k]
        while first <= last and not deck.rotor[row, first]:
            first += 1
        while first <= last and not deck.rotor[row, last]:
            last -= 1
        if first <= last:
            lowest = min(lowest, first)
            highest = max(highest, last)
    return lowest, highest


@compiled
def send(
    deck: Deck,
    bodies: Bodies,
    passages: Passages,
    scratch: Scratch,
    dt: float,
    first: int,
    last: int,
) -> int:
    """Carry out the runs `first` to `last` - 1.

    Args:
        deck: the surfaces.
        bodies: the parcels.
        passages: the runs, of which these are written.
        scratch: of the physics, for one thread.
        dt: [s] step.
        first: run.
        last: run, not carried out.

    Returns:
        The steps done.
    """
    done = 0
    for run in range(first, last):
        number = passages.number[run]
        state = passages.state[run]
        grid = grid_of(deck, number, passages.condition[run])
        body = read_body(bodies, number[PARCEL])
        radius = bodies.body[number[PARCEL], RADIUS]
        invalidate_contacts(scratch)
        how = OUT_OF_TIME
        touched = -1
        tipped = 0
        steps = 0
        while steps < number[STEPS]:
            omega = state[OMEGA]
            report, _ = step_implicit(grid, body, state, scratch, dt)
            if report >= OFF_SURFACE:
                how = OFF
                break
            steps += 1
            tipped += report == TIPPING
            lowest, highest = rotor_span(deck, scratch)
            if highest < 0:
                how = OUT
                break
            touched = max(touched, highest)
            if lowest >= number[EXIT]:
                how = PAST
                break
            speed = abs(state[VX]) + abs(state[VY]) + abs(state[OMEGA]) * radius
            change = abs(state[AX]) + abs(state[AY]) + abs(state[OMEGA] - omega) * radius / dt
            if speed < REST_SPEED and change < REST_CHANGE:
                how = AT_REST
                break
        passages.end[run, HOW] = how
        passages.end[run, TOUCHED] = touched
        passages.end[run, DONE] = steps
        passages.end[run, TIPPED] = tipped
        done += steps
    return done
