"""Maneuvers: which there are, what they do, and what a group of columns asks for."""

import math
from dataclasses import replace

import numpy as np
import pytest

from surface_gym.agents.base import find_orientation
from surface_gym.agents.scheduling.maneuvers import ColumnGroups, Lead, Library, make_library
from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.exits import Exit, Exits, flow_line
from surface_gym.flow.stream import Stream
from surface_gym.flow.task import COLUMN, FEATURES
from surface_gym.randomisation import Randomisation
from tests.agents.rules.runs import gated, line, zoned

S_BOXES = Stream(Steady(1000.0), speeds=1.5)
GENTLE = tuple(np.radians([0.0, 45.0, -45.0, 90.0, 80.0, -80.0]))


def library(config: EnvConfig | None = None, *given, **settings) -> Library:
    return make_library(
        gated(S_BOXES) if config is None else config, *given, place_count=4, **settings
    )


def pair(found: Library, ahead: str, behind: str) -> np.ndarray:
    """Pick the gaps of the maneuvers to one exit behind those to another."""
    names = [name for _, _, name in found.lead.kinds]
    one, other = (
        np.isin(found.maneuvers.kind, [k for k, each in enumerate(names) if each == name])
        for name in (ahead, behind)
    )
    return found.gaps[np.ix_(one, other)]


class TestLibrary:
    def test_every_kind_has_maneuvers_that_lead_it_right(self) -> None:
        found = library()
        assert found.correct.all()
        assert set(found.maneuvers.kind) == {0, 1, 2}
        assert (found.options[2] >= 0).sum() == 1  # straight on there is one way
        own = found.options[0][found.options[0] >= 0]
        assert (np.diff(found.maneuvers.place[own]) > 0.0).all()

    def test_both_sides_are_alike(self) -> None:
        found = library()
        np.testing.assert_allclose(pair(found, "left", "right"), pair(found, "right", "left"))
        np.testing.assert_allclose(pair(found, "left", "left"), pair(found, "right", "right"))

    def test_who_turns_off_upstream_of_the_one_ahead_never_meets_it(self) -> None:
        gaps = pair(library(), "left", "left")
        least = (0.25 + 0.02) / 1.5
        assert least - 1e-6 < gaps[-1, 0] < 1.3 * least
        assert gaps[0, -1] > 1.5 * least

    def test_a_gentle_turn_costs_less(self) -> None:
        both = make_library(gated(S_BOXES, orientations=GENTLE, line=flow_line(4.0)), place_count=4)
        angles = np.array(GENTLE)[both.maneuvers.choice]
        gentle = np.abs(np.abs(angles) - math.radians(80.0)) < 1e-6
        straight = both.options[2, 0]
        assert both.gaps[gentle, straight].max() < both.gaps[~gentle, straight].max() - 0.05

    def test_exits_are_met_and_what_misses_them_is_left_out(self) -> None:
        few = Exits([Exit("left", 1, 0.6, 1.0), Exit("straight", 0)])
        found = library(gated(S_BOXES, exits=few))
        assert found.correct.all()
        assert len(found.options[0]) < 4

    def test_what_nothing_leads_right_is_said_and_still_led(self) -> None:
        slow = Stream(Steady(1000.0), speeds=0.05)
        found = library(gated(slow, duration=3.0))
        assert not found.correct.any()
        assert (found.options[:, 0] >= 0).all()

    def test_what_varies_asks_for_wider_gaps(self) -> None:
        varied = gated(S_BOXES, randomisation=Randomisation(friction=0.3))
        assert library(varied).gaps.max() > library().gaps.max()

    def test_the_delay_is_what_a_long_queue_pays(self) -> None:
        """The mean gap under the policy that it leads to is the same from every start."""
        found = library()
        delay = found.delay
        assert delay.min() == 0.0
        behind = [(found.gaps + delay)[:, own[own >= 0]].min(axis=1) for own in found.options]
        gain = np.mean(behind, axis=0) - delay
        np.testing.assert_allclose(gain, gain[0], atol=1e-6)


class TestGroups:
    def test_groups_follow_each_other_from_the_first_column_that_obeys(self) -> None:
        assert ColumnGroups(4, 2).spans(15).tolist() == [[0, 4], [4, 8]]
        assert len(ColumnGroups().spans(15)) == 15
        assert len(ColumnGroups(4).spans(15)) == 3

    @pytest.mark.parametrize(
        ("made", "message"),
        [
            (lambda: ColumnGroups(0), "columns must be"),
            (lambda: ColumnGroups(exclusive=1), "exclusive must be one of"),  # type: ignore[arg-type]
            (lambda: ColumnGroups(20).spans(15), "columns must fit on the 15 that obey"),
            (lambda: library(gated(actions="modules")), "actions must be one of"),
            (lambda: library(gated(), ColumnGroups()), "actions must be one of"),
            (lambda: library(line()), "gate must be True for a schedule, got False"),
            (lambda: make_library(gated(), place_count=0), "place_count must be"),
            (lambda: make_library(gated(), slack=-0.1), "slack must be"),
        ],
    )
    def test_what_does_not_fit_is_refused(self, made, message) -> None:
        with pytest.raises(ValueError, match=message):
            made()

    def test_who_shares_actuators_waits_longer(self) -> None:
        config = zoned(S_BOXES)
        same, other = [], []
        for groups in (ColumnGroups(), ColumnGroups(10, 1), ColumnGroups(10, 1, exclusive=True)):
            found = library(config, groups)
            assert found.correct.all()
            same.append(pair(found, "left", "left").min())
            other.append(pair(found, "left", "right").min())
        assert same[0] <= same[1] < same[2]
        assert other[0] < other[1] <= other[2]
        assert same[1] < other[1]  # one for the same exit may follow at once

    def test_a_group_stands_as_the_parcel_over_it_asks_until_it_has_left(self) -> None:
        config = zoned(S_BOXES)
        lead = Lead(config, ColumnGroups(5))
        tried = lead.candidates(config, 1)
        left = int(np.nonzero(tried.kind == 0)[0][0])
        table = np.zeros((1, config.stream_task.rows, len(FEATURES)), dtype=np.float32)
        shown = [COLUMN.present.place, COLUMN.forward_speed.place, COLUMN.size.place]
        table[0, 0, shown] = 1.0, 0.5, -1.0
        booked = np.full((1, config.stream_task.max_parcels), -1)
        booked[0, 0] = left

        def at(past: float, stands: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
            table[0, 0, 13] = past / 0.5
            return lead.choose(table, tried, booked, stands)

        left_axis = find_orientation(config, -0.25 * np.pi)
        before, stands = at(-1.0, None)
        assert (before == lead.roll).all()
        action, stands = at(0.1, stands)
        assert stands[0].tolist() == [left_axis, lead.roll, lead.roll]
        grid = action.reshape(4, -1)
        assert (grid[:, :5] == left_axis).all()
        assert (grid[:, 5:] == lead.roll).all()
        # It has gone: the group stays as it is, and no axis turns for nothing.
        booked[0, 0] = -1
        _, after = at(0.4, stands)
        np.testing.assert_array_equal(after, stands)


def test_any_angle_is_refused_where_the_gate_needs_choices() -> None:
    config = replace(gated(), orientations=tuple(np.radians([0.0, 90.0])))
    with pytest.raises(ValueError, match="orientations must hold -45 deg"):
        library(config)
