"""The layouts for sorting that ship with the package."""

import math
from pathlib import Path

import numpy as np
import pytest

from surface_gym import layouts
from surface_gym.design import sorting_layouts as module
from surface_gym.design.best_layout import over_speeds
from surface_gym.design.case import NOTHING, Case
from surface_gym.design.search import Effort
from surface_gym.design.sorting_layouts import (
    COLUMNS,
    OFFERS,
    SIZES,
    SPEEDS,
    SortingLayout,
    find_sorting_layouts,
    sorting_layouts,
    write_sorting_layouts,
)

SHIPPED = sorting_layouts()
each = pytest.mark.parametrize("layout", SHIPPED, ids=lambda own: f"{own.box}-{own.offer}")


def test_there_is_one_for_every_box_and_offer() -> None:
    assert sorted((own.box, own.offer) for own in SHIPPED) == sorted(
        (box, offer) for box in SIZES for offer in OFFERS
    )


@each
def test_it_does_what_its_file_says(layout: SortingLayout) -> None:
    case = Case(layouts.box(layout.box), unknown=NOTHING)
    line = case.line(COLUMNS)
    found = over_speeds("it", layout.axis, case, line, SPEEDS, workers=2)
    study = over_speeds("study", np.full_like(layout.axis, math.pi / 4), case, line, SPEEDS)
    assert (found.least_speed, study.least_speed) == (layout.least_speed, layout.study_least_speed)
    assert found.mean_time == pytest.approx(layout.mean_time, abs=1e-6)
    assert layout.least_speed <= layout.least_sure_speed
    assert layout.half_length == {"S": 0.125, "B": 0.225}[layout.box]


@each
def test_its_axes_are_on_offer(layout: SortingLayout) -> None:
    offered = OFFERS[layout.offer]
    if offered is not None:
        apart = np.abs(np.sin(layout.axis[..., np.newaxis] - np.array(offered)))
        assert apart.min(axis=-1).max() < 1e-9


@pytest.mark.parametrize("box", SIZES)
def test_the_more_axes_there_are_the_slower_a_box_may_come(box: str) -> None:
    least = {own.offer: own.least_speed for own in SHIPPED if own.box == box}
    assert least["any"] < least["eight"] < least["four"]


def test_layouts_found_anew_are_read_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    effort = Effort(members=6, generations=1, epochs=1, rounds=0)
    told: list[tuple[int, int]] = []
    found = find_sorting_layouts(
        ("eight", "any"), ("S",), effort, checkpoints=tmp_path / "kept",
        advance=lambda *at: told.append(at),
    )  # fmt: skip
    again = find_sorting_layouts(("any",), ("S",), effort, checkpoints=tmp_path / "kept")
    np.testing.assert_array_equal(again["S", "any"].best.axis, found["S", "any"].best.axis)
    assert told[-1] == (2, 2)
    write_sorting_layouts(tmp_path / "new" / "sorting.json", found)
    monkeypatch.setattr(module.resources, "files", lambda _: tmp_path)
    monkeypatch.setattr(module, "FILE", "new/sorting.json")
    read = sorting_layouts.__wrapped__()
    assert [own.offer for own in read] == ["eight", "any"]
    for own in read:
        np.testing.assert_array_equal(own.axis, found["S", own.offer].best.axis)
        assert own.least_speed == found["S", own.offer].best.least_speed
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["sorting.json"]


@pytest.mark.parametrize(
    ("name", "arguments"), [("offers", {"offers": ("two",)}), ("sizes", {"sizes": ("M",)})]
)
def test_what_there_is_not_is_refused(name: str, arguments: dict) -> None:
    with pytest.raises(ValueError, match=name):
        find_sorting_layouts(**arguments)
