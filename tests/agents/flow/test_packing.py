"""Packing of ways, held against what plain geometry says."""

import math

import numpy as np
import pytest

from agents.flow.packing import (
    FINE,
    Way,
    clearance,
    gaps_between,
    least_gap,
    packed_rate,
    steady_rate,
)

SQUARE = np.array([(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)])  # [m]


def straight(speed: float, aside: float = 0.0, angle: float = 0.0, seconds: float = 4.0) -> Way:
    """At a constant speed [m/s] along x, off the middle by a distance [m]."""
    time = np.linspace(0.0, seconds, 41)
    pose = np.column_stack([speed * time, np.full(41, aside), np.full(41, angle)])
    return Way(SQUARE, time, pose)


def test_a_way_is_where_the_parcel_is_between_moments() -> None:
    corners = straight(1.0, angle=math.pi / 2).at(np.array([0.33]))
    np.testing.assert_allclose(corners[0], [(0.43, -0.1), (0.43, 0.1), (0.23, 0.1), (0.23, -0.1)])


@pytest.mark.parametrize("apart", [0.05, -0.03])
def test_the_clearance_of_sides_that_face_each_other_is_their_distance(apart: float) -> None:
    other = SQUARE + np.array([0.2 + apart, 0.05])
    assert clearance(SQUARE[None], other[None])[0] == pytest.approx(apart)


def perimeter(base: np.ndarray) -> np.ndarray:
    """(points, 2) along its sides."""
    share = np.linspace(0.0, 1.0, 40)[:, np.newaxis]
    ends = np.roll(base, -1, axis=0)
    return np.concatenate([a + share * (b - a) for a, b in zip(base, ends, strict=True)])


def test_the_clearance_of_corners_is_never_too_large() -> None:
    turn = math.pi / 4
    rotation = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    rng = np.random.default_rng(0)
    for _ in range(50):
        shift = rng.uniform(-0.6, 0.6, 2)
        other = SQUARE @ rotation + shift
        first, second = perimeter(SQUARE), perimeter(other)
        distance = np.hypot(*(first[:, None] - second[None]).transpose(2, 0, 1)).min()
        found = clearance(SQUARE[None], other[None])[0]
        assert found <= distance + 1e-9
        if found > 0.0:
            assert distance > 0.0


@pytest.mark.parametrize(("speed", "margin"), [(1.0, 0.0), (2.0, 0.0), (1.0, 0.05)])
def test_equal_speeds_need_a_length_and_the_margin(speed: float, margin: float) -> None:
    gap = least_gap(straight(speed), straight(speed), margin)
    assert gap == pytest.approx((0.2 + margin) / speed, abs=2.0 * FINE)


def test_a_faster_one_must_not_catch_up() -> None:
    """It may only be a length behind as the slower one leaves, after 4 s at x = 4 m."""
    gap = least_gap(straight(1.0), straight(2.0, seconds=2.0))
    assert gap == pytest.approx(4.0 - (4.0 - 0.2) / 2.0, abs=2.0 * FINE)


def test_ways_beside_each_other_need_no_gap() -> None:
    assert least_gap(straight(1.0, aside=0.0), straight(1.0, aside=0.3)) <= FINE


def test_who_never_leaves_lets_nobody_in() -> None:
    stands = Way(SQUARE, np.array([0.0, 60.0]), np.zeros((2, 3)))
    with pytest.raises(ValueError, match="ways must have a gap of at most 20 s, got none"):
        least_gap(stands, straight(1.0))


def test_rates_are_those_of_the_gaps() -> None:
    gaps = gaps_between([straight(1.0), straight(1.0, aside=0.3)])
    assert gaps.shape == (2, 2)
    # Each behind itself 0.2 s, behind the other next to none.
    both = packed_rate(gaps, np.array([1.0, 1.0]))
    assert both == pytest.approx(3600.0 / 0.1, rel=0.05)
    assert packed_rate(gaps, np.array([3.0, 0.0])) == pytest.approx(3600.0 / 0.2, rel=0.02)
    assert steady_rate(gaps) == pytest.approx(3600.0 / 0.2, rel=0.02)
