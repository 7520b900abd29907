"""The sorting comparison, with the fixed layout, whose results are known."""

import math

import numpy as np
import pytest

import surface_gym as sg
from agents.comparison import SIDES, SPEEDS, SortRecord, compare_sorting, sort_by_speed
from agents.fixed_layout import FixedLayout
from surface_gym.actions import KINDS
from surface_gym.settings import Settings


@pytest.fixture(scope="module")
def records() -> dict[str, SortRecord]:
    """The fixed layout at every speed, by parcel."""
    settings = Settings(actions="halves")
    done = compare_sorting({"fixed layout": (FixedLayout(settings), settings)})
    return {record.parcel: record for record in done}


@pytest.mark.parametrize(("parcel", "minimum"), [("S", 0.72), ("B", 1.00)])
def test_minimum_speeds_are_those_of_an_independent_prototype(
    records: dict[str, SortRecord], parcel: str, minimum: float
) -> None:
    assert records[parcel].minimum_speed == minimum


@pytest.mark.parametrize(
    ("parcel", "speed", "time"),
    [
        ("S", 0.8, 1.10),
        ("S", 1.5, 0.51),
        ("S", 2.7, 0.42),
        ("B", 1.1, 1.72),
        ("B", 1.5, 1.03),
        ("B", 2.7, 0.64),
    ],
)
def test_times_to_sort_are_too(
    records: dict[str, SortRecord], parcel: str, speed: float, time: float
) -> None:
    record = records[parcel]
    found = record.slowest_time[np.argmin(np.abs(record.speed - speed))]
    assert found == pytest.approx(time, rel=0.03)


@pytest.mark.parametrize("parcel", ["S", "B"])
def test_paths_are_those_of_simulate(records: dict[str, SortRecord], parcel: str) -> None:
    record = records[parcel]
    box = sg.layouts.box(parcel)
    for row in range(0, len(SPEEDS), 8):
        for column, side in enumerate(SIDES):
            path = record.path[row * len(SIDES) + column]
            layout = sg.layouts.sorting(parcel, side, task_columns=16, columns=30)
            run = sg.simulate(layout, box, path[0], (SPEEDS[row], 0.0, 0.0), duration=4.0)
            whole = path[:-1]  # the last control period ended early
            np.testing.assert_array_equal(whole, run.pose[: 8 * len(whole) : 8])
            if record.success[row, column]:
                end = round(record.time[row, column] / 0.005)
                np.testing.assert_array_equal(path[-1], run.pose[end])


@pytest.mark.parametrize("parcel", ["S", "B"])
def test_both_sides_are_mirror_images(records: dict[str, SortRecord], parcel: str) -> None:
    record = records[parcel]
    np.testing.assert_array_equal(record.success[:, 0], record.success[:, 1])
    np.testing.assert_allclose(record.time[:, 0], record.time[:, 1])


def test_every_controller_meets_every_parcel_in_turn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agents.comparison.SPEEDS", np.array([1.0, 2.0]))
    controllers = {
        name: (FixedLayout(settings), settings)
        for name, settings in (("a", Settings(actions="halves")), ("b", Settings()))
    }
    told: list[str] = []
    records = compare_sorting(controllers, told.append)
    assert told == ["a, S-box", "a, B-box", "b, S-box", "b, B-box"]
    assert [(record.controller, record.parcel) for record in records] == [
        ("a", "S"), ("a", "B"), ("b", "S"), ("b", "B"),
    ]  # fmt: skip


def test_a_record_sums_up() -> None:
    success = np.array([[True, True], [False, True], [True, True], [True, True]])
    time = np.where(success, [[0.9, 0.8]] * 4, np.inf)
    record = SortRecord("x", "S", np.array([0.5, 1.0, 1.5, 2.0]), success, time, ())
    assert record.success_rate == 7 / 8
    assert record.slowest_time.tolist() == [0.9, math.inf, 0.9, 0.9]
    assert record.minimum_speed == 1.5


@pytest.mark.parametrize("actions", KINDS)
def test_the_controller_is_asked_in_the_settings_it_acts_under(actions: str) -> None:
    """Its actions may be of any kind, its orientations in any order."""
    settings = Settings(
        actions=actions,
        orientations=(math.pi / 2, -math.pi / 4, 0.0, math.pi / 4),
        control_period=0.02,
    )
    plain = Settings(actions="modules")
    found, wanted = (
        sort_by_speed("fixed", FixedLayout(each), each, "S") for each in (settings, plain)
    )
    sorted_in_time = wanted.time < 1.9  # the shorter control periods end at 2 s
    np.testing.assert_allclose(found.time[sorted_in_time], wanted.time[sorted_in_time])
