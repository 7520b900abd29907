"""Reservation: lone trajectories, how close they can follow, their booking, and the rule of all."""

import math
from typing import Any

import numpy as np
import pytest

from surface_gym.agents.rules import reservation
from surface_gym.agents.rules.reservation import Reservation, least_gap
from surface_gym.agents.rules.streams import StreamEventRule
from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.stream import Stream
from surface_gym.flow.task import FEATURES, PRESENT, WAITS
from surface_gym.layouts import box
from surface_gym.randomisation import Randomisation
from surface_gym.sensors import Camera
from tests.agents.rules.runs import counts, gated, line
from tests.flow.flows import BOX, trace

ALL_LEFT = {"left": 1.0}


@pytest.mark.parametrize(
    ("stream", "asked"),
    [
        (
            Stream(Steady(1000.0), parcels=("S", "B"), destinations=ALL_LEFT),
            [(box("S"), 1.5, "left"), (box("B"), 1.5, "left")],
        ),
        (
            Stream(Steady(1000.0), destinations=ALL_LEFT, parcels=("S",), speeds=(1.0, 1.15)),
            [(box("S"), speed, "left") for speed in (1.0, 1.075, 1.15)],
        ),
        (
            trace((0.0, "left"), (1.0, "right"), (2.0, "left")),
            [(BOX, 1.5, "left"), (BOX, 1.5, "right")],
        ),
    ],
    ids=["parcels", "speeds", "trace"],
)
def test_every_parcel_speed_and_exit_is_asked_for_once(stream, asked) -> None:
    assert reservation.list_asked(line(stream)) == asked
    without_destinations = reservation.list_asked(line(Stream(Steady(1000.0))))
    assert {name for _, _, name in without_destinations} == {"left", "right", "straight"}


def found(config: EnvConfig) -> reservation.Trajectories:
    """Find the trajectories of a stream that the event rule leads."""
    return reservation.find_trajectories(StreamEventRule, config, reservation.list_asked(config))


def test_trajectories_lead_to_the_exits_and_are_mirror_images() -> None:
    """They are those of exact sensors, whatever varies."""
    stream = Stream(Steady(1000.0), speeds=1.5)
    config = line(stream)
    trajectories = found(config)
    assert trajectories.right == (True, True, True)
    left, right, straight = trajectories.each
    middle = config.chosen_line.line_y
    np.testing.assert_allclose(left.pose[:, 1] - middle, middle - right.pose[:, 1], atol=1e-9)
    np.testing.assert_allclose(left.time, right.time)
    np.testing.assert_allclose(straight.pose[:, 1], middle, atol=1e-9)
    assert straight.pose[-1, 0] > config.rotors_end
    varied = line(stream, sensors=Camera(), randomisation=Randomisation(friction=0.2), gate=True)
    for each, other in zip(trajectories.each, found(varied).each, strict=True):
        assert each.time[0] >= 0.0
        assert (np.diff(each.time) > 0.0).all()
        assert each.outline.shape == (len(BOX.base.outline), 2)
        np.testing.assert_array_equal(each.pose, other.pose)
    # A parcel that comes to rest is not right.
    slow = line(Stream(Steady(1000.0), speeds=0.05), duration=3.0)
    assert found(slow).right == (False, False, False)


def test_signatures_tell_them_apart() -> None:
    config = line(Stream(Steady(1000.0), parcels=("S", "B"), speeds=(1.0, 1.2)))
    signature = found(config).signature
    apart = np.abs(signature[:, None] - signature[None]).max(axis=2)
    assert apart[~np.eye(len(apart), dtype=bool)].min() > 0.05


SQUARE = np.array([(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)])  # [m]


def straight(
    speed: float, aside: float = 0.0, angle: float = 0.0, seconds: float = 4.0
) -> reservation.ParcelTrajectory:
    """At a constant speed [m/s] along x, off the middle by a distance [m]."""
    time = np.linspace(0.0, seconds, 41)
    pose = np.column_stack([speed * time, np.full(41, aside), np.full(41, angle)])
    return reservation.ParcelTrajectory(SQUARE, time, pose)


def test_a_trajectory_interpolates_the_parcel_between_moments() -> None:
    corners = straight(1.0, angle=math.pi / 2).corners(np.array([0.33]))
    np.testing.assert_allclose(corners[0], [(0.43, -0.1), (0.43, 0.1), (0.23, 0.1), (0.23, -0.1)])


def test_a_clearance_is_the_distance_of_facing_sides_and_never_too_large_of_corners() -> None:
    """Held against the least distance between points of both perimeters."""
    for apart in (0.05, -0.03):
        other = SQUARE + np.array([0.2 + apart, 0.05])
        assert reservation.clearance(SQUARE[None], other[None])[0] == pytest.approx(apart)
    turned = SQUARE @ np.array([[1.0, 1.0], [-1.0, 1.0]]) * math.sqrt(0.5)
    share = np.linspace(0.0, 1.0, 40)[:, np.newaxis]

    def perimeter(base: np.ndarray) -> np.ndarray:
        sides = zip(base, np.roll(base, -1, 0), strict=True)
        return np.concatenate([a + share * (b - a) for a, b in sides])

    for shift in np.random.default_rng(0).uniform(-0.6, 0.6, (50, 2)):
        one, other = perimeter(SQUARE), perimeter(turned + shift)
        distance = np.hypot(*(one[:, None] - other[None]).transpose(2, 0, 1)).min()
        assert reservation.clearance(SQUARE[None], turned[None] + shift)[0] <= distance + 1e-9


@pytest.mark.parametrize(("speed", "margin"), [(1.0, 0.0), (2.0, 0.0), (1.0, 0.05)])
def test_equal_speeds_need_a_length_and_the_margin(speed, margin) -> None:
    gap = least_gap(straight(speed), straight(speed), margin)
    assert gap == pytest.approx((0.2 + margin) / speed, abs=2.0 * reservation.FINE)


def test_a_gap_is_for_all_the_way() -> None:
    """A faster one may only be a length behind as the slower one leaves, after 4 s at x = 4 m."""
    gap = least_gap(straight(1.0), straight(2.0, seconds=2.0))
    assert gap == pytest.approx(4.0 - (4.0 - 0.2) / 2.0, abs=2.0 * reservation.FINE)
    # Beside each other they need none, and behind one that never leaves there is none.
    assert least_gap(straight(1.0, aside=0.0), straight(1.0, aside=0.3)) <= reservation.FINE
    stands = reservation.ParcelTrajectory(SQUARE, np.array([0.0, 60.0]), np.zeros((2, 3)))
    with pytest.raises(ValueError, match="trajectories must have a gap of at most 20 s, got none"):
        least_gap(stands, straight(1.0))


def test_rates_are_those_of_the_gaps() -> None:
    gaps = reservation.least_gaps([straight(1.0), straight(1.0, aside=0.3)])
    assert gaps.shape == (2, 2)
    # Each behind itself 0.2 s, behind the other next to none.
    both = reservation.packed_rate(gaps, np.array([1.0, 1.0]))
    assert both == pytest.approx(3600.0 / 0.1, rel=0.05)
    assert reservation.packed_rate(gaps, np.array([3.0, 0.0])) == pytest.approx(
        3600.0 / 0.2, rel=0.02
    )


CONFIG = gated()
PERIOD, DT = CONFIG.control_period, CONFIG.timing.dt
GAPS = np.array([[0.3, 0.05], [1.0, 0.5]])  # [s] of way 0 and 1 (column) behind each (row)
FRESH, GOES_ON = np.ones(1, dtype=bool), np.zeros(1, dtype=bool)


def booking() -> reservation.Booking:
    """Of two ways that are kept apart by the parcel's size."""
    signature = np.zeros((2, len(reservation.SIGNATURE)))
    signature[1, reservation.SIGNATURE.index(6)] = 2.0
    return reservation.Booking(CONFIG, signature, GAPS)


def waiting(way: int | None, since: float = 0.0) -> np.ndarray:
    """A table with a parcel at the gate that is to go a way, its time come so long ago [s]."""
    table = np.zeros((1, CONFIG.stream_task.rows, len(FEATURES)), dtype=np.float32)
    if way is not None:
        table[0, -1, [PRESENT, WAITS]] = 1.0
        table[0, -1, 6] = 2.0 * way
        table[0, -1, 12] = -since / 4.0
    return table


def entries(ways: list[int], periods: int) -> list[float]:
    """[s] when each of a queue of parcels is let in, all of which have waited from the start."""
    book, times, gate = None, [], booking()
    for period in range(periods):
        clock = period * PERIOD
        head = ways[len(times)] if len(times) < len(ways) else None
        # Each in turn comes to the gate a moment after the one before.
        table = waiting(head, clock - 1e-2 * len(times))
        opens, book = gate.open(table, book, GOES_ON if period else FRESH)
        if opens[0]:
            times.append(clock + opens[0] * DT)
    return times


def opened(gate: reservation.Booking, table: np.ndarray, book: Any, begins: Any) -> list[Any]:
    """When the gate opens, and what is booked then."""
    opens, book = gate.open(table, book, begins)
    return [opens.tolist(), book]


def test_the_first_enters_at_once_and_the_gate_stays_shut_where_none_waits() -> None:
    shut, book = opened(booking(), waiting(None), None, FRESH)
    assert shut == [0]
    assert opened(booking(), waiting(0), book, GOES_ON)[0] == [1]
    # One that found no room is let in again, and need not keep a gap to itself.
    first, book = opened(booking(), waiting(0), None, FRESH)
    again, book = opened(booking(), waiting(0, since=PERIOD), book, GOES_ON)
    # Now it has entered, and another has come.
    later, _ = opened(booking(), waiting(0, since=0.0), book, GOES_ON)
    assert (first, again, later) == ([1], [1], [0])


@pytest.mark.parametrize("ways", [[0, 0], [0, 1], [1, 0], [1, 1]])
def test_the_next_keeps_its_gap_to_a_physics_step(ways) -> None:
    first, second = entries(ways, 40)
    gap = GAPS[ways[0], ways[1]]
    assert gap - 1e-6 <= second - first <= gap + PERIOD + DT


def test_gaps_hold_to_all_before_not_only_to_the_last() -> None:
    """Way 1, then 0 at once would be 1 s later; way 1 behind way 1 has to wait for the first."""
    first, second, third = entries([1, 1, 0], 60)
    assert second - first >= 0.5 - 1e-6
    assert third - second >= 1.0 - 1e-6
    first, second, third = entries([0, 1, 0], 60)
    assert third - second >= 1.0 - 1e-6
    assert third - first >= 0.3


def test_environments_and_episodes_are_booked_apart() -> None:
    gate, all_begin = booking(), np.ones(3, dtype=bool)
    _, book = opened(gate, waiting(1), None, FRESH)
    opens, again = opened(gate, waiting(1), book, FRESH)
    assert (opens, again.clock.tolist()) == ([1], [PERIOD])
    tables = np.concatenate([waiting(0), waiting(None), waiting(1)])
    opens, book = opened(gate, tables, None, all_begin)
    assert opens == [1, 0, 1]
    later = np.concatenate([waiting(0), waiting(0), waiting(1)])
    assert opened(gate, later, book, ~all_begin)[0] == [0, 1, 0]


CROWD = Stream(Steady(15000.0), parcels=("S",), speeds=1.5)


def test_more_than_a_line_takes_is_sorted_without_a_touch() -> None:
    """On the line it does what its lead does, which alone is not enough."""
    config = gated(CROWD)
    count = counts(Reservation(config), config)
    assert (count["wrong"], count["touches"]) == (0, 0)
    assert count["right"] > 4 * 12
    assert counts(Reservation(config, margin=0.2), config)["right"] < count["right"]
    rows = np.random.default_rng(0).normal(size=(20, 29)).astype(np.float32)
    rule, lead = Reservation(config), StreamEventRule(config)
    np.testing.assert_array_equal(rule.halves(rows), lead.halves(rows))
    assert counts(StreamEventRule(line(CROWD)), line(CROWD))["touches"] > 0
    with pytest.raises(ValueError, match="gate must be True for a reservation, got False"):
        Reservation(line())


def test_it_enters_who_is_next_however_many_of_a_queue_are_shown() -> None:
    found = []
    for queue in (1, 3):
        config = gated(CROWD, queue=queue)
        found.append(counts(Reservation(config), config))
    assert found[0] == found[1]


def test_it_comes_near_the_packed_ways_and_not_above() -> None:
    config = gated(CROWD, duration=20.0)
    gaps = reservation.least_gaps(found(config).each, reservation.MARGIN)
    bound = reservation.packed_rate(gaps, np.ones(len(gaps)))
    count = counts(Reservation(config), config, num_envs=8)
    rate = 3600.0 * count["right"] / (8 * config.stream_task.duration)
    assert 0.8 * bound < rate < 1.02 * bound
