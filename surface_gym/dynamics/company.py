"""Parcels on one surface, how their sides behave, and the memory of a step of all of them."""

from typing import NamedTuple

import numpy as np

from surface_gym.dynamics.compiled import inlined
from surface_gym.dynamics.contacts import forget_contacts
from surface_gym.dynamics.sides import POINT_SIZE
from surface_gym.dynamics.types import (
    COM_HEIGHT,
    COM_X,
    COM_Y,
    GYRATION,
    MARKS_SIZE,
    RADIUS,
    SPANS,
    STATE_SIZE,
    TABLE_SIZE,
    Array,
    Bodies,
    Body,
    Booleans,
    Integers,
    Scratch,
)


class Company(NamedTuple):
    """Parcels on one surface, a row each."""

    state: Array  # (P, STATE_SIZE)
    present: Booleans  # (P,) whether there is a parcel in the row
    site: Integers  # (P,) its row in `bodies`
    bodies: Bodies


class Touching(NamedTuple):
    """How sides behave."""

    restitution: float  # [-] 0: they stay together; 1: they part as fast as they met
    friction: float  # [-] between sides


class TogetherScratch(NamedTuple):
    """Memory of a step together, for P parcels, and what it leaves there."""

    tables: Array  # (P, TABLE_SIZE) a `Scratch` a parcel
    marks: Integers  # (P, MARKS_SIZE)
    report: Integers  # (P,) of each parcel's own step
    rotors: Integers  # (P,) that bore each parcel in it
    pair: Integers  # (most pairs, 2) rows of parcels that pushed each other
    impulse: Array  # (most pairs,) [N s] along the normal
    before: Array  # (P, STATE_SIZE) states at the start
    bearing: Integers  # (P,) elements that bore each parcel
    nothing: Integers  # (P,) zeros: elements that bear parcels while sides hit each other
    reach: Array  # (P,) [m] from a centre of mass at the start to wherever its base came
    near: Integers  # (most pairs, 2) rows of parcels whose bases may meet
    when: Array  # (most pairs,) [s] from which on they touch; infinite: they do not
    push: Array  # (most pairs,) [N s] impulse along the normal
    since: Array  # (P,) [s] from which on each parcel touches another; infinite: it does not
    root: Integers  # (P,) the group of each parcel: the least row in it
    member: Integers  # (P,) and so on: as in `Group`
    slot: Integers  # (P,)
    low: Integers  # (P,)
    contact: Integers  # (most points,)
    ends: Integers  # (most points, 3)
    point: Array  # (most points, POINT_SIZE)
    met: Array  # (P, 3) [m/s, m/s, rad/s] velocities where parcels first touch
    start: Array  # (P, 3) the same, with the impulses of sides
    velocity: Array  # (P, 3)
    target: Array  # (P, 3)
    trial: Array  # (P, 3)
    gradient: Array  # (P, 3)
    direction: Array  # (P, 3)
    matrix: Array  # (3 P, 3 P)


def make_together_scratch(parcels: int) -> TogetherScratch:
    """Scratch for so many parcels, that says nothing of any contact."""
    pairs = parcels * (parcels - 1) // 2
    marks = np.zeros((parcels, MARKS_SIZE), dtype=np.int64)
    marks[:, SPANS] = -1

    def integers(*shape: int) -> Integers:
        return np.zeros(shape, dtype=np.int64)

    return TogetherScratch(
        tables=np.zeros((parcels, TABLE_SIZE)),
        marks=marks,
        report=integers(parcels),
        rotors=integers(parcels),
        pair=integers(pairs, 2),
        impulse=np.zeros(pairs),
        before=np.zeros((parcels, STATE_SIZE)),
        bearing=integers(parcels),
        nothing=integers(parcels),
        reach=np.zeros(parcels),
        near=integers(pairs, 2),
        when=np.zeros(pairs),
        push=np.zeros(pairs),
        since=np.zeros(parcels),
        root=integers(parcels),
        member=integers(parcels),
        slot=integers(parcels),
        low=integers(parcels),
        contact=integers(2 * pairs),
        ends=integers(2 * pairs, 3),
        point=np.zeros((2 * pairs, POINT_SIZE)),
        met=np.zeros((parcels, 3)),
        start=np.zeros((parcels, 3)),
        velocity=np.zeros((parcels, 3)),
        target=np.zeros((parcels, 3)),
        trial=np.zeros((parcels, 3)),
        gradient=np.zeros((parcels, 3)),
        direction=np.zeros((parcels, 3)),
        matrix=np.zeros((3 * parcels, 3 * parcels)),
    )


@inlined
def scratch_of(scratches: TogetherScratch, i: int) -> TogetherScratch:
    """The i-th of scratches whose arrays have one more dimension, the first."""
    return TogetherScratch(
        scratches.tables[i],
        scratches.marks[i],
        scratches.report[i],
        scratches.rotors[i],
        scratches.pair[i],
        scratches.impulse[i],
        scratches.before[i],
        scratches.bearing[i],
        scratches.nothing[i],
        scratches.reach[i],
        scratches.near[i],
        scratches.when[i],
        scratches.push[i],
        scratches.since[i],
        scratches.root[i],
        scratches.member[i],
        scratches.slot[i],
        scratches.low[i],
        scratches.contact[i],
        scratches.ends[i],
        scratches.point[i],
        scratches.met[i],
        scratches.start[i],
        scratches.velocity[i],
        scratches.target[i],
        scratches.trial[i],
        scratches.gradient[i],
        scratches.direction[i],
        scratches.matrix[i],
    )


@inlined
def forget_together(scratch: TogetherScratch) -> None:
    """What a scratch says of the elements is of another surface, or of axes that have turned."""
    for k in range(scratch.marks.shape[0]):
        forget_contacts(Scratch(scratch.tables[k], scratch.marks[k]))


@inlined
def body_of(bodies: Bodies, site: int) -> Body:
    """A row of the bodies as the physics of one parcel reads it."""
    row = bodies.body[site]
    return Body(
        bodies.edges[site], row[RADIUS], row[COM_X], row[COM_Y], row[COM_HEIGHT], row[GYRATION]
    )
