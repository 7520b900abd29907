"""Trajectories of parcels alone on a line, and how close they can follow each other."""

import math

import numpy as np
import pytest

from surface_gym.agents.scheduling import trajectories
from surface_gym.agents.scheduling.trajectories import DT, TimedRuns, find_gaps, list_asked
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.stream import Stream
from surface_gym.layouts import box
from tests.agents.rules.runs import gated, line
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
            [(box("S"), speed, "left") for speed in (1.0375, 1.1125)],
        ),
        (
            trace((0.0, "left"), (1.0, "right"), (2.0, "left")),
            [(BOX, 1.5, "left"), (BOX, 1.5, "right")],
        ),
    ],
    ids=["parcels", "speeds", "trace"],
)
def test_every_parcel_speed_and_exit_is_asked_for_once(stream, asked) -> None:
    assert list_asked(line(stream)) == asked
    without_destinations = list_asked(line(Stream(Steady(1000.0))))
    assert {name for _, _, name in without_destinations} == {"left", "right", "straight"}


def runs(opens: list[int], config=None) -> trajectories.LoneRuns:
    """Run S-boxes that nobody steers, each entering at a physics step."""
    config = gated(Stream(Steady(1000.0), speeds=1.5)) if config is None else config
    asked = [(box("S"), 1.5, "straight")] * len(opens)

    def roll(tables: np.ndarray) -> np.ndarray:
        return np.full((len(tables), 2), 3)

    return trajectories.run_alone(roll, config, asked, np.array(opens), range(len(opens)))


class TestLoneRuns:
    def test_they_begin_where_a_parcel_enters_whenever_that_is(self) -> None:
        found = runs([1, 4, 8])
        assert found.correct.all()
        config = gated()
        np.testing.assert_allclose(found.pose[:, 0, 0], config.entry_x + box("S").rear)
        np.testing.assert_allclose(found.pose[1, :200], found.pose[0, :200], atol=2e-4)
        np.testing.assert_allclose(found.pose[2, :200], found.pose[0, :200], atol=2e-4)

    def test_their_moments_are_evenly_apart(self) -> None:
        found = runs([1])
        count = found.moments[0]
        speed = np.diff(found.pose[0, :count, 0]) / DT
        np.testing.assert_allclose(speed, 1.5, rtol=0.02)

    def test_a_queue_that_is_shown_makes_no_difference(self) -> None:
        more = runs([1], gated(Stream(Steady(1000.0), speeds=1.5), queue=4))
        np.testing.assert_array_equal(more.pose, runs([1]).pose)


SQUARE = np.array([(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)])  # [m]


def straight(
    *speeds: float, aside: float = 0.0, seconds: float = 4.0, turns: float = math.inf
) -> TimedRuns:
    """Squares at constant speeds [m/s] along x, the modules under them turned after a time [s]."""
    time = DT * np.arange(round(seconds / DT))
    pose = np.zeros((len(speeds), len(time), 3))
    pose[..., 0] = np.outer(speeds, time)
    pose[..., 1] = aside
    count = len(speeds)
    return TimedRuns(
        pose, np.full(count, len(time)), np.tile(SQUARE, (count, 1, 1)),
        np.full(count, math.hypot(0.1, 0.1)), np.tile(np.where(time > turns, 1, 0), (count, 1)),
    )  # fmt: skip


def gap(one: TimedRuns, other: TimedRuns, margin: float = 0.0, late: float = 0.0) -> float:
    """Find the gap [s] of the first of one behind the first of another."""
    found = np.zeros((len(one.moments), len(other.moments)))
    find_gaps(one, other, margin, late, found)
    return float(found[0, 0])


class TestGaps:
    @pytest.mark.parametrize(("speed", "margin"), [(1.0, 0.0), (2.0, 0.0), (1.0, 0.05)])
    def test_equal_speeds_need_a_length_and_the_margin(self, speed, margin) -> None:
        found = gap(straight(speed), straight(speed), margin)
        assert found == pytest.approx((0.2 + margin) / speed, abs=2.0 * DT)

    def test_a_gap_is_for_all_the_way(self) -> None:
        """A faster one may only be a length behind as the slower one leaves, after 4 s."""
        found = gap(straight(1.0), straight(2.0))
        assert found == pytest.approx(4.0 - (4.0 - 0.2) / 2.0, abs=2.0 * DT)
        assert gap(straight(1.0), straight(1.0, aside=0.3)) == 0.0  # beside each other
        stands = straight(0.0, seconds=60.0)
        assert gap(stands, straight(1.0)) == math.inf

    def test_a_gap_is_raised_never_lowered(self) -> None:
        found = np.array([[3.0]])
        find_gaps(straight(1.0), straight(1.0), 0.0, 0.0, found)
        assert found[0, 0] == 3.0

    def test_the_one_behind_waits_for_modules_that_were_turned(self) -> None:
        """It rolls where the one ahead was turned: it needs the way of 0.04 s more."""
        ahead, behind = straight(1.0, turns=1.0), straight(1.0)
        assert gap(ahead, behind, late=0.04) == pytest.approx(0.24, abs=2.0 * DT)
        assert gap(ahead, straight(1.0, turns=0.5), late=0.04) > 0.2
        assert gap(straight(1.0), behind, late=0.04) == pytest.approx(0.2, abs=2.0 * DT)

    def test_turned_bases_are_held_apart_by_their_corners(self) -> None:
        """A square turned by 45 deg is longer by a factor of sqrt(2) along the line."""
        turned = straight(1.0)
        turned.pose[..., 2] = math.pi / 4.0
        expected = 0.1 + 0.1 * math.sqrt(2.0)
        assert gap(turned, straight(1.0)) == pytest.approx(expected, abs=2.0 * DT)
