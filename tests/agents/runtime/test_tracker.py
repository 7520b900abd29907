"""Parcels keep their numbers, though pictures do not name them."""

import math
from dataclasses import replace

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.agents.rules import find_rules
from surface_gym.agents.runtime.tracker import GONE_AFTER, MOST_ARRIVALS
from surface_gym.agents.runtime.worlds import steered_config, unchanged_turn
from surface_gym.config import EnvConfig
from surface_gym.flow.state import CORRECT, NOBODY
from surface_gym.flow.take_away import Stops
from surface_gym.flow.task import COLUMN
from surface_gym.machine import messages as ms
from tests.agents.runtime import streams
from tests.agents.runtime.streams import CONFIG, entry, fresh, picture

FRAME = 0.02  # [s]
SMALL = sg.Parcel(sg.Rectangle(0.2, 0.2))


def place_of(held, number: int) -> np.ndarray:
    """x and y [m] of the parcel with a number."""
    (row,) = np.flatnonzero(held.numbers == number)
    return held.estimates[row, :2]


def is_shown(table: np.ndarray) -> np.ndarray:
    return COLUMN.present.of(table) > 0.5


def test_poses_go_to_the_parcels_that_they_show() -> None:
    held = fresh()
    held.enter(entry(7, 0.0, x=0.8))
    held.enter(entry(3, 0.1, x=0.2))
    held.observe(0.1)
    for k in range(5, 15):
        at = FRAME * k
        assert held.correct(picture(at, (0.2 + at - 0.1, 1.004), (0.8 + at, 0.99)))
    held.observe(0.3)
    np.testing.assert_allclose(place_of(held, 7), (1.1, 0.99), atol=0.003)
    np.testing.assert_allclose(place_of(held, 3), (0.4, 1.004), atol=0.003)


def test_false_and_missing_poses_move_no_parcel() -> None:
    held = fresh()
    held.enter(entry())
    for k in range(1, 11):
        far = (1.5, 1.1) if k % 2 else (1.2, 0.9)
        held.correct(picture(FRAME * k, far, *([(0.2 + FRAME * k, 1.0)] if k % 3 else [])))
    held.observe(0.2)
    np.testing.assert_allclose(place_of(held, 0), (0.4, 1.0), atol=0.004)
    assert (held.numbers >= 0).sum() == 1


def test_an_angle_may_be_off_by_a_turn_that_leaves_the_base_unchanged() -> None:
    held = fresh()
    held.enter(entry())
    for k in range(1, 6):
        turned = 0.05 + 0.5 * math.pi * (-1) ** k
        held.correct(ms.Detections(FRAME * k, ((0.2 + FRAME * k, 1.0, turned),)))
    held.observe(0.1)
    assert held.estimates[0, 2] == pytest.approx(0.05, abs=0.01)


def test_the_angle_of_a_disc_does_not_matter() -> None:
    held = fresh()
    held.enter(replace(entry(), parcel=sg.Parcel(sg.Disc(0.15))))
    for k in range(1, 6):
        held.correct(ms.Detections(FRAME * k, ((0.2 + FRAME * k, 1.002, 2.0 * k),)))
    held.observe(0.1)
    np.testing.assert_allclose(held.estimates[0, :2], (0.3, 1.002), atol=0.002)
    assert abs(held.estimates[0, 2]) < 0.05


@pytest.mark.parametrize(
    ("base", "turn"),
    [
        (sg.Rectangle(0.3, 0.2), math.pi),
        (sg.Rectangle(0.2, 0.2), 0.5 * math.pi),
        (sg.Disc(0.15), 0.0),
        (sg.Polygon([(0.0, 0.0), (0.4, 0.0), (0.1, 0.3)]), math.tau),
        (
            sg.Polygon([(math.cos(k), math.sin(k)) for k in np.arange(7) * math.tau / 7]),
            math.tau / 7,
        ),
    ],
)
def test_turns_that_leave_a_base_unchanged(base, turn) -> None:
    assert unchanged_turn(sg.Parcel(base)) == pytest.approx(turn)


def test_a_late_picture_leads_to_the_same_estimate_as_one_in_time() -> None:
    found = []
    for late in (False, True):
        held = fresh()
        resolver = held.resolver(CONFIG.action_kind)
        held.enter(entry(velocity=(1.5, 0.0, 0.0), x=0.6))
        pictures = [picture(FRAME * k, (0.6 + 1.45 * FRAME * k, 1.002)) for k in range(1, 11)]
        for k in range(5):
            at = 2 * FRAME * k
            for each in () if late else pictures[max(0, 2 * k - 2) : 2 * k]:
                held.correct(each)
            held.observe(at)
            command = np.full(CONFIG.action_kind.size, 0 if k in (1, 2) else 3)
            held.resolve(resolver, command)
            held.note_sent(k, at)
        for each in pictures if late else pictures[8:]:
            held.correct(each)
        held.observe(0.22)
        found.append(held.estimates[0])
    # The parcel brakes where it was thought to be when the commands were resolved.
    np.testing.assert_allclose(*found, atol=2e-3)
    assert found[0][3] < 1.42


def test_a_row_is_empty_once_before_another_parcel_uses_it() -> None:
    before: dict[int, int] = {}
    counts = {"reused": 0}
    empty = np.ones(CONFIG.stream_task.max_parcels, dtype=bool)

    def look(_: float) -> None:
        nonlocal empty
        for row, number in enumerate(held.numbers.tolist()):
            if number == NOBODY:
                empty[row] = True
            elif before.get(row) != number:
                assert empty[row], f"row {row} went from {before.get(row)} to {number}"
                counts["reused"] += row in before
                before[row], empty[row] = number, False

    held = streams.tracker()
    streams.lead(streams.world(lost=0.1, false=0.1), streams.Rolls(), look, 20.0)
    assert counts["reused"] > 10


def test_what_departed_in_the_prediction_does_not_come_back() -> None:
    held = fresh()
    held.enter(entry(x=1.75, velocity=(1.5, 0.0, 0.0)))
    held.correct(picture(0.01, (1.765, 1.0)))
    assert is_shown(held.observe(0.01)).any()
    assert not is_shown(held.observe(0.6)).any()
    held.correct(picture(0.02, (1.77, 1.0)))  # a picture that was long under way
    assert not is_shown(held.observe(0.03)).any()
    held.enter(entry(1, 0.03))
    assert (held.observe(0.05) != 0.0).any(axis=1).tolist() == [False, True, *[False] * 6]


def test_a_parcel_that_was_pushed_away_is_found_again_and_a_lost_one_is_dropped() -> None:
    held = fresh()
    held.enter(entry(0, x=0.3, velocity=(0.0, 0.0, 0.0)))
    for k in range(1, 12):
        held.correct(picture(FRAME * k, (0.45, 1.05)))
    held.observe(0.22)
    np.testing.assert_allclose(place_of(held, 0), (0.45, 1.05), atol=0.01)
    for k in range(12, 11 + GONE_AFTER):
        held.correct(picture(FRAME * k))
    assert is_shown(held.observe(FRAME * k)).any()
    held.correct(picture(FRAME * (k + 1)))
    assert not is_shown(held.observe(FRAME * (k + 1))).any()


def test_one_pose_of_two_touching_parcels_moves_neither() -> None:
    held = fresh()
    for number, x in ((0, 0.6), (1, 0.851)):
        held.enter(entry(number, x=x, velocity=(0.0, 0.0, 0.0)))
    for k in range(1, 15):
        held.correct(picture(FRAME * k, (0.7255, 1.0)))
    held.observe(0.28)
    np.testing.assert_allclose(place_of(held, 0), (0.6, 1.0), atol=0.02)
    np.testing.assert_allclose(place_of(held, 1), (0.851, 1.0), atol=0.02)


def test_more_parcels_than_rows_wait_for_one() -> None:
    held = fresh()
    slots = CONFIG.stream_task.max_parcels
    for number in range(slots + 1):
        small = replace(entry(number, x=1.8 - 0.21 * number), parcel=SMALL)
        held.enter(replace(small, velocity=(0.1, 0.0, 0.0)))
    held.observe(0.02)
    assert held.numbers.tolist() == list(range(slots))
    for k in range(1, GONE_AFTER + 5):  # the first one is taken away
        held.correct(
            picture(FRAME * k, *((1.8 - 0.21 * each, 1.0) for each in range(1, slots + 1)))
        )
        held.observe(FRAME * k)
    assert held.numbers.tolist() == [slots, *range(1, slots)]


def test_a_long_run_remembers_a_bounded_number_of_parcels() -> None:
    held = fresh()
    for number in range(MOST_ARRIVALS + 200):
        held.enter(entry(number, 0.4 * number, x=1.9))
        held.correct(picture(0.4 * number + 0.3))
        held.observe(0.4 * number + 0.31)
    held.enter(entry(number + 1, 0.4 * number + 0.32))
    held.observe(0.4 * number + 0.34)
    assert (held.numbers >= 0).sum() == 1
    assert held.numbers.max() == number + 1
    assert held._streams.time.shape[1] <= 2 * MOST_ARRIVALS


def test_parcels_that_leave_the_gate_or_never_enter_are_forgotten() -> None:
    held = fresh()
    for number in range(2 * MOST_ARRIVALS + 5):
        held.enter(entry(number, waits=True))
        held.depart(number)
        with pytest.raises(ValueError, match="pose"):
            held.enter(replace(entry(10**6 + number), pose=(math.nan, 0.0, 0.0)))
    held.enter(entry(10**7, 0.01))
    held.observe(0.02)
    assert held.numbers.max() == 10**7


def test_an_estimate_that_is_no_number_is_dropped() -> None:
    held = fresh()
    held.enter(entry())
    held.enter(entry(1, x=0.6))
    held.correct(picture(0.02, (0.22, 1.0), (0.62, 1.0)))
    held._parcels.state[0, 3] = math.nan
    held.correct(picture(0.04, (0.24, 1.0), (0.64, 1.0)))
    assert np.isfinite(held.observe(0.05)).all()
    assert held.numbers.tolist() == [NOBODY, 1, *[NOBODY] * 6]


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        ({"goal": (9.0, 0.0, 0.0)}, "goal"),
        ({"goal": (0.5, 0.0, 0.0)}, "goal"),
        ({"goal": (0.0,)}, "goal"),
        ({"velocity": (1e9, 0.0, 0.0)}, "velocity"),
    ],
)
def test_impossible_entries_are_refused(changed, name) -> None:
    with pytest.raises(ValueError, match=name):
        fresh().enter(entry(**changed))


def test_a_number_enters_once() -> None:
    held = fresh()
    held.enter(entry())
    held.observe(0.02)
    held.correct(picture(0.02, (0.22, 1.0)))
    with pytest.raises(ValueError, match="number must be a new one"):
        held.enter(entry(0, 0.03))


def test_a_parcel_too_large_for_the_line_is_refused() -> None:
    with pytest.raises(ValueError, match="parcels must be"):
        fresh().enter(replace(entry(), parcel=sg.Parcel(sg.Rectangle(9.0, 0.2))))


def test_driven_modules_and_a_take_away_that_stops_are_refused() -> None:
    with pytest.raises(ValueError, match="demand must be None"):
        steered_config(EnvConfig("singulate", demand=Stops()))
    with pytest.raises(ValueError, match="modules must be idle"):
        steered_config(EnvConfig("flow", modules="belt"))


def test_a_rule_delivers_as_with_known_parcels() -> None:
    rule = find_rules("flow")[0].make(CONFIG)
    swapped = []

    def look(_: float) -> None:
        numbers, poses = machine.poses
        for number, pose in zip(numbers.tolist(), poses, strict=True):
            row = np.flatnonzero(held.numbers == number)
            if len(row) and np.linalg.norm(held.estimates[row[0], :2] - pose[:2]) > 0.1:
                swapped.append(number)

    held, machine = streams.tracker(), streams.world(3, lost=0.05, false=0.05)
    loop = streams.lead(machine, rule, look, 20.0)
    tally = machine.streams.tally[0]
    assert not swapped
    assert loop.counts.parcels["success"] == tally[CORRECT] > 10
    assert not loop.counts.faults
