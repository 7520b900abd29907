"""The paper's fixed layout, and the comparison that others are held against."""

from pathlib import Path

import numpy as np
import pytest

import surface_gym as sg
from agents import comparison
from agents.comparison import SortRecord, sort_by_speed
from agents.fixed_layout import FixedLayout
from agents.report import write_table
from surface_gym.actions import KINDS
from surface_gym.settings import Settings


@pytest.fixture(autouse=True)
def few_speeds(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparison, "SPEEDS", np.array([0.6, 0.7, 0.8, 1.1, 1.5]))


@pytest.mark.parametrize("actions", KINDS)
@pytest.mark.parametrize("parcel", ["S", "B"])
def test_it_sorts_what_the_paper_says(actions: str, parcel: str) -> None:
    settings = Settings(actions=actions)
    record = sort_by_speed("fixed", FixedLayout(settings), settings, parcel)
    slowest = {"S": 0.8, "B": 1.1}[parcel]
    np.testing.assert_array_equal(
        record.success, np.repeat(record.speed[:, None] >= slowest, 2, axis=1)
    )
    assert record.minimum_speed == slowest
    for speed, time in zip(record.speed, record.slowest_time, strict=True):
        if speed >= slowest:
            layout = sg.layouts.sorting(parcel, 1, task_columns=16, columns=30)
            box, start = sg.layouts.box(parcel), sg.layouts.start(parcel)
            before, after = (
                sg.simulate(layout, box, start, (speed, 0.0, 0.0), duration=time + shift)
                for shift in (-0.02, 0.0)
            )
            assert before.pose[-1, 1] < after.pose[-1, 1]  # on its way off, at that very time


def test_it_needs_its_axes() -> None:
    settings = Settings(orientations=(0.0, np.pi / 2))
    with pytest.raises(ValueError, match="orientations"):
        FixedLayout(settings)


def test_the_minimum_is_above_every_failure() -> None:
    def minimum(*fails: int) -> float | None:
        success = np.ones((5, 2), dtype=bool)
        success[list(fails), 1] = False
        time = np.ones((5, 2))
        return SortRecord("x", "S", np.arange(1.0, 6.0), success, time, ()).minimum_speed

    assert minimum() == 1.0
    assert minimum(0, 2) == 4.0
    assert minimum(4) is None


def test_a_table_is_the_same_twice(tmp_path: Path) -> None:
    settings = Settings(actions="halves")
    texts = []
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        record = sort_by_speed("fixed layout", FixedLayout(settings), settings, "S")
        write_table([record], tmp_path / name)
        texts.append([(tmp_path / name / f).read_bytes() for f in ("table.md", "table.json")])
    assert texts[0] == texts[1]
    assert b"fails" in texts[0][0]
