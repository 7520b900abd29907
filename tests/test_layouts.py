"""The paper's layouts, element by element (Figures 6 and 9)."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import layouts

DEG = math.pi / 180.0
LINE_Y = {"S": [0.95, 1.05], "B": [0.85, 0.95, 1.05, 1.15]}  # [m] of the rotors' rows
LEAD_IN = {"S": 3, "B": 5}


def line_of(surface: sg.Surface) -> np.ndarray:
    """(line rows, columns) [deg] axes of the rotors."""
    rows = surface.rotor.all(axis=1)
    assert not surface.rotor[~rows].any()
    return surface.axis[rows] / DEG


@pytest.mark.parametrize("size", ["S", "B"])
@pytest.mark.parametrize("side", [-1, 1])
def test_sorting(size: str, side: int) -> None:
    surface = layouts.sorting(size, side, task_columns=7, columns=20)
    np.testing.assert_allclose(surface.y[surface.rotor.all(axis=1)], LINE_Y[size])
    axis = line_of(surface)
    lead_in = LEAD_IN[size]
    np.testing.assert_allclose(axis[:, :lead_in], 90.0)
    np.testing.assert_allclose(axis[:, lead_in : lead_in + 7], -45.0 * side)
    np.testing.assert_allclose(axis[:, lead_in + 7 :], 90.0)
    assert axis.shape[1] == 20


@pytest.mark.parametrize("size", ["S", "B"])
def test_the_box_starts_wholly_on_the_lead_in(size: str) -> None:
    surface, box, pose = layouts.sorting(size), layouts.box(size), layouts.start(size)
    assert pose == pytest.approx((box.base.length / 2.0, 1.0, 0.0))
    right = pose[0] + box.base.length / 2.0
    first_of_task = surface.x[LEAD_IN[size]]
    assert surface.x[LEAD_IN[size] - 1] <= right + 1e-9 < first_of_task


def test_slowing_alternates_from_row_to_row() -> None:
    axis = line_of(layouts.slowing("B", angle=45.0 * DEG, task_columns=3))
    np.testing.assert_allclose(np.abs(axis[:, 5:8]), 45.0)
    np.testing.assert_allclose(axis[:-1, 5:8], -axis[1:, 5:8])
    np.testing.assert_allclose(axis[:, 8:], 90.0)


@pytest.mark.parametrize("size", ["S", "B"])
@pytest.mark.parametrize("angle", [0.0, 45.0])
def test_stopping_is_slowing_with_one_more_column_at_0_deg(size: str, angle: float) -> None:
    slowing = line_of(layouts.slowing(size, angle * DEG, task_columns=2))
    stopping = line_of(layouts.stopping(size, angle * DEG, task_columns=2))
    extra = LEAD_IN[size] + 2
    np.testing.assert_allclose(stopping[:, extra], 0.0)
    np.testing.assert_array_equal(
        np.delete(stopping, extra, axis=1), np.delete(slowing, extra, axis=1)
    )


def test_a_line_takes_one_row_for_all_or_each() -> None:
    one = line_of(layouts.line([[0.1, 0.2]], "B"))
    np.testing.assert_allclose(one[:, 5:7] * DEG, [[0.1, 0.2]] * 4)
    each = line_of(layouts.line([[0.1], [0.2], [0.3], [0.4]], "B"))
    np.testing.assert_allclose(each[:, 5] * DEG, [0.1, 0.2, 0.3, 0.4])


def test_boxes_and_tilt() -> None:
    assert layouts.box("S") == sg.Parcel(sg.Rectangle(0.25, 0.25))
    assert layouts.box("B") == sg.Parcel(sg.Rectangle(0.45, 0.45))
    for layout in (layouts.sorting, layouts.slowing, layouts.stopping):
        assert layout(tilt=0.1).tilt == 0.1


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: layouts.box("M"), "size must be one of 'S', 'B', got 'M'"),
        (lambda: layouts.start(None), "size must be one of 'S', 'B', got None"),
        (lambda: layouts.sorting("s"), "size must be one of 'S', 'B', got 's'"),
        (lambda: layouts.slowing(1), "size must be one of 'S', 'B', got 1"),
        (lambda: layouts.sorting(side=0), "side must be one of -1, 1, got 0"),
        (lambda: layouts.sorting(task_columns=0), "task_columns must be a whole number"),
        (lambda: layouts.slowing(task_columns=1.5), "task_columns must be a whole number"),
        (lambda: layouts.slowing(angle=math.nan), "angle must be a finite number"),
        (lambda: layouts.sorting(columns=32), "columns must be a whole number of at least 33"),
        (lambda: layouts.slowing(columns=4), "columns must be a whole number of at least 5"),
        (lambda: layouts.stopping(columns=5), "columns must be a whole number of at least 6"),
        (lambda: layouts.stopping("B", columns=7), "columns must be a whole number of at least 8"),
        (lambda: layouts.line([0.0, 1.0]), r"task_axis must have the shape \(any, any\)"),
        (lambda: layouts.line(np.zeros((3, 2))), "task_axis must have 1 or 2 rows, got 3"),
        (lambda: layouts.line([[np.inf]]), "task_axis must be finite, got inf"),
    ],
)
def test_what_is_not_allowed_is_refused(call: object, message: str) -> None:
    with pytest.raises(ValueError, match=f"^{message}"):
        call()
