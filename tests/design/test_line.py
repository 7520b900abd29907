import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import layouts
from surface_gym.design.line import DesignLine, line_for


@pytest.mark.parametrize(("size", "rows", "lead_in"), [("S", 2, 3), ("B", 4, 5)])
def test_the_study_s_boxes_get_the_study_s_lines(size: str, rows: int, lead_in: int) -> None:
    line = line_for(layouts.box(size), 30)
    assert (line.rows, line.lead_in, line.columns) == (rows, lead_in, 30)
    assert layouts.LINE_ROWS[size] == rows
    assert layouts.LEAD_IN[size] == lead_in


def test_the_zone_s_axes_are_those_given_and_all_others_roll() -> None:
    line = line_for(layouts.box("S"), 4)
    zone = np.radians([[0.0, 45.0, -45.0, 90.0], [10.0, 20.0, 30.0, 40.0]])
    surface = line.surface(zone, tilt=0.1)
    np.testing.assert_array_equal(surface.axis[line.zone], zone)
    rest = np.ones(line.shape, bool)
    rest[line.zone] = False
    assert (surface.axis[rest] == layouts.ROLLING).all()
    assert surface.rotor.sum() == 2 * line.shape[1]
    assert surface.tilt == 0.1


def test_a_parcel_starts_wholly_on_the_lead_in() -> None:
    parcel = sg.Parcel(sg.Polygon(np.array([[0.0, 0.0], [0.4, 0.0], [0.1, 0.3]])))
    line = line_for(parcel, 8, pitch=(0.08, 0.12))
    x, y, theta = line.start(parcel)
    outline = np.add(parcel.base.outline, (x, y))
    assert theta == 0.0
    assert outline[:, 0].min() == pytest.approx(0.0)
    assert outline[:, 0].max() <= line.zone_x[0] + 1e-12
    assert y + parcel.base.centroid[1] == pytest.approx(line.line_y)
    assert line.zone_x[1] - line.zone_x[0] == pytest.approx(8 * 0.08)


def test_supports_bear_a_parcel_that_has_just_left_the_line() -> None:
    parcel = layouts.box("B")
    line = line_for(parcel, 8)
    aside = line.line_y - 0.5 * line.rows * line.pitch_y  # [m] of supports on one side
    assert aside > 2.0 * parcel.base.reach


@pytest.mark.parametrize(("width", "rows"), [(0.05, 2), (0.25, 2), (0.4, 4), (0.45, 4), (0.6, 6)])
def test_rows_are_an_even_number_under_the_parcel(width: float, rows: int) -> None:
    assert line_for(sg.Parcel(sg.Rectangle(0.3, width)), 8).rows == rows


@pytest.mark.parametrize(
    ("field", "value", "told"),
    [
        ("rows", 0, "rows must be a whole number of at least 1, got 0"),
        ("columns", 1.5, "columns must be a whole number of at least 1, got 1.5"),
        ("pitch", -0.1, "pitch must be greater than 0"),
        ("mu_min", -1.0, "mu_min must be at least 0"),
    ],
)
def test_what_is_not_allowed_is_named(field: str, value: float, told: str) -> None:
    given = {"rows": 2, "columns": 8, "lead_in": 3, "run_out": 10, "beside": 5, field: value}
    with pytest.raises(ValueError, match=told):
        DesignLine(**given)


def test_axes_of_another_shape_are_refused() -> None:
    with pytest.raises(ValueError, match=r"zone_axis must have the shape \(2, 8\)"):
        line_for(layouts.box("S"), 8).surface(np.full((8, 2), math.pi / 4))
