"""The gap between two bases, against their extents in every direction; where they face each
other; and when they meet, against looking at every moment.
"""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

import surface_gym as sg
from surface_gym.compiler.jit import compiled
from surface_gym.parcel import make_bodies
from surface_gym.physics import signed_distance
from surface_gym.physics.references import step_implicit
from surface_gym.physics.signed_distance import BaseOutline, StepMotion
from surface_gym.physics.types import OMEGA, STATE_SIZE, THETA, VX, VY, Array, X, Y, make_scratch
from tests.strategies import angles, bases, speeds, spins

gap_between = compiled(signed_distance.signed_distance.py_func)
place_at = compiled(signed_distance.transform_at.py_func)
find_facing = compiled(signed_distance.find_manifold.py_func)
time_of_impact = compiled(signed_distance.time_of_impact.py_func)

DIRECTIONS = np.linspace(0.0, 2.0 * math.pi, 3600, endpoint=False)
NORMALS = np.column_stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)])
Triple = tuple[float, float, float]
RECTANGLE, DISC = sg.Rectangle(0.4, 0.2), sg.Disc(0.15)


def outline(base: object, com_offset: tuple[float, float] = (0.0, 0.0)) -> BaseOutline:
    return signed_distance.read_outline.py_func(
        make_bodies([sg.Parcel(base, com_offset=com_offset)]), 0
    )


def at(x: float, y: float, theta: float = 0.0, *velocity: float) -> StepMotion:
    return StepMotion(*map(float, (x, y, theta, *(velocity or (0, 0, 0)))))


def extents(base: BaseOutline, motion: StepMotion, time: float = 0.0) -> Array:
    """(directions,) [m] how far the base reaches along each."""
    place = place_at(base, motion, time)
    turn = np.array([[place.cosine, -place.sine], [place.sine, place.cosine]])
    corners = base.corners @ turn.T + [place.x, place.y]
    return (NORMALS @ corners.T).max(axis=1) + base.disc


def widest(
    first: BaseOutline, one: StepMotion, second: BaseOutline, other: StepMotion, time: float
) -> float:
    """[m] of the widest strip between two bases: less than none where they overlap."""
    there = extents(second, other, time)
    least = -np.roll(there, len(DIRECTIONS) // 2)
    return float((least - extents(first, one, time)).max())


def measured(
    first: BaseOutline, one: StepMotion, second: BaseOutline, other: StepMotion, time: float
) -> signed_distance.SignedDistance:
    return gap_between(first, place_at(first, one, time), second, place_at(second, other, time))


@pytest.mark.parametrize(
    "case",
    [
        (RECTANGLE, (0, 0, 0), RECTANGLE, (0.5, 0.05, 0), 0.1, (1, 0)),
        (RECTANGLE, (0, 0, 0), RECTANGLE, (0.1, 0.15, 0), -0.05, (0, 1)),
        (RECTANGLE, (0, 0, math.pi / 2), RECTANGLE, (0.4, 0, 0), 0.1, (1, 0)),
        (DISC, (0, 0, 0), DISC, (0.3, 0.4, 1), 0.2, (0.6, 0.8)),
        (DISC, (0, 0, 0), DISC, (0, 0, 0), -0.3, (1, 0)),
        (RECTANGLE, (0, 0, 0), DISC, (0.1, 0.3, 0), 0.05, (0, 1)),
        (RECTANGLE, (0, 0, 0), DISC, (0.5, 0.5, 0), 0.35, (0.6, 0.8)),  # 0.5 m off the corner
        (DISC, (0.5, 0.5, 0), RECTANGLE, (0, 0, 0), 0.35, (-0.6, -0.8)),
        (RECTANGLE, (0, 0, 0), DISC, (0.19, 0.0, 0), -0.16, (1, 0)),  # its centre inside
    ],
)
def test_gaps_that_are_known_by_hand(case: Any) -> None:
    first, one, second, other, width, normal = case
    found = measured(outline(first), at(*one), outline(second), at(*other), 0.0)
    np.testing.assert_allclose(found[:3], (width, *normal), atol=1e-12)


offsets = st.floats(-0.7, 0.7)


@given(first=bases, second=bases, x=offsets, y=offsets, one=angles, other=angles)
def test_a_gap_is_the_widest_strip_between_two(
    first: object, second: object, x: float, y: float, one: float, other: float
) -> None:
    bodies = (outline(first), at(0, 0, one), outline(second), at(x, y, other), 0.0)
    found = measured(*bodies)
    strip = widest(*bodies)
    between_polygons = found.edge >= 0
    if between_polygons and found.width > 0.0:  # apart, though maybe corner to corner
        assert 0.0 < found.width <= strip + 5e-4
    else:
        assert found.width == pytest.approx(strip, abs=5e-4)
    back = measured(*bodies[2:4], *bodies[:2], 0.0)
    assert back.width == pytest.approx(found.width, abs=1e-12)


def test_edges_face_each_other_where_both_are_and_a_corner_or_a_disc_at_a_point() -> None:
    box, disc = outline(RECTANGLE), outline(DISC)
    diamond = outline(sg.Polygon([[0.1, 0.0], [0.0, 0.1], [-0.1, 0.0], [0.0, -0.1]]))

    def points(
        first: BaseOutline, one: StepMotion, second: BaseOutline, other: StepMotion
    ) -> Array:
        places = (first, place_at(first, one, 0.0), second, place_at(second, other, 0.0))
        found = find_facing(*places, gap_between(*places))
        both = np.array([found[1:4], found[4:]])
        return both[np.lexsort(both[:, :2].T)] if found.points == 2 else both[:1]

    shifted = points(box, at(0, 0), box, at(0.3, 0.21))
    np.testing.assert_allclose(shifted, [[0.1, 0.105, 0.01], [0.2, 0.105, 0.01]], atol=1e-12)
    swapped = points(box, at(0.3, 0.21), box, at(0, 0))
    np.testing.assert_allclose(swapped, shifted, atol=1e-12)
    corner = points(box, at(0, 0), diamond, at(0.05, 0.202))
    nearest = corner[corner[:, 2].argmin()]
    np.testing.assert_allclose(nearest, [0.05, 0.101, 0.002], atol=1e-12)
    np.testing.assert_allclose(points(box, at(0, 0), disc, at(0.05, 0.27)), [[0.05, 0.11, 0.02]])
    np.testing.assert_allclose(points(disc, at(0.05, 0.27), box, at(0, 0)), [[0.05, 0.11, 0.02]])
    np.testing.assert_allclose(points(disc, at(0, 0), disc, at(0.32, 0)), [[0.16, 0.0, 0.02]])


@pytest.mark.parametrize("parts", [0.0, 0.02])
def test_edges_without_a_common_stretch_face_at_the_nearer_corner(parts: float) -> None:
    box = outline(RECTANGLE)
    places = (box, place_at(box, at(0, 0), 0.0), box, place_at(box, at(0.4 + parts, 0.3), 0.0))
    found = find_facing(*places, signed_distance.SignedDistance(0.1, 0.0, 1.0, 2))
    assert found.width == pytest.approx(0.1)
    assert 0.2 - 1e-12 <= found.x <= 0.22 + 1e-12


motions = st.tuples(speeds, speeds, spins)


@given(pair=st.tuples(bases, bases), moving=st.tuples(motions, motions), one=angles, away=angles)
def test_bases_are_apart_until_they_meet(pair: Any, moving: Any, one: float, away: float) -> None:
    (first, second), (motion, other), dt = pair, moving, 0.01
    distance = first.reach + second.reach + 1e-3
    x, y = distance * math.cos(away), distance * math.sin(away)
    bodies = (outline(first), at(0, 0, one, *motion), outline(second), at(x, y, 0.7, *other))
    time = time_of_impact(*bodies, dt)
    for moment in np.linspace(0.0, min(time, dt), 50, endpoint=False):
        assert measured(*bodies, moment).width > 0.0
    if time < math.inf:
        assert 0.0 < measured(*bodies, time).width <= signed_distance.CONTACT_DISTANCE
    box = outline(RECTANGLE)
    for x in (0.3, 0.4):  # who touches already meets at once
        assert time_of_impact(box, at(0, 0), box, at(x, 0), dt) == 0.0


def test_a_centre_of_mass_off_the_centroid_carries_the_base_around_it() -> None:
    box = outline(RECTANGLE, (0.05, 0.02))
    place = place_at(box, at(1.0, 2.0, 0.0, 0.0, 0.0, math.pi), 0.5)  # a quarter turn
    np.testing.assert_allclose((place.x, place.y), (1.02, 1.95), atol=1e-12)


def test_the_motion_of_a_step_ends_where_the_step_does() -> None:
    surface = sg.Surface(np.zeros((20, 20)), np.zeros((20, 20), dtype=bool), mu_support=0.5)
    box, dt = sg.Parcel(sg.Rectangle(0.4, 0.3)), 0.02
    before = np.zeros(STATE_SIZE)
    before[[X, Y, THETA, VX, VY, OMEGA]] = (1.0, 1.1, 0.3, 0.9, -0.4, 3.0)
    after = before.copy()
    step_implicit(surface.grid, box.body, after, make_scratch(), dt)
    motion = signed_distance.sweep_between.py_func(before, after)
    start, way = np.array(motion[:3]), dt * np.array(motion[3:])
    np.testing.assert_allclose(start + way, after[[X, Y, THETA]], rtol=0, atol=1e-12)
    assert abs(after[OMEGA] - before[OMEGA]) > 0.1
