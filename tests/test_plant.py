"""The plants: lines as in the paper's Figure 6, and fields of rotors."""

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.layouts import LEAD_IN, LINE_ROWS
from surface_gym.plant import Field, Line


@pytest.mark.parametrize("size", ["S", "B"])
class TestTheLineOfAPapersBox:
    def test_has_the_rotors_of_the_papers_layout(self, size: str) -> None:
        site = Line().site(sg.layouts.box(size).base, None)
        layout = sg.layouts.sorting(size, task_columns=16, columns=30)
        np.testing.assert_array_equal(site.rotor, layout.rotor)

    def test_obeys_after_the_papers_lead_in(self, size: str) -> None:
        first_row, rows, first_column, columns = Line().site(sg.layouts.box(size).base, None).zone
        assert (rows, first_column, columns) == (LINE_ROWS[size], LEAD_IN[size], 16)
        layout = sg.layouts.sorting(size, task_columns=16, columns=30)
        obeying = np.zeros_like(layout.rotor)
        obeying[first_row : first_row + rows, first_column : first_column + columns] = True
        np.testing.assert_array_equal(obeying, layout.rotor & (layout.axis != np.pi / 2))

    def test_obeys_where_asked(self, size: str) -> None:
        assert Line().site(sg.layouts.box(size).base, (7, 7)).zone[2:] == (7, 1)
        assert Line().site(sg.layouts.box(size).base, (0, 29)).zone[2:] == (0, 30)


@pytest.mark.parametrize(
    ("base", "rows", "lead_in"),
    [
        (sg.Rectangle(0.3, 0.15), 2, 3),
        (sg.Rectangle(0.31, 0.39), 2, 4),
        (sg.Rectangle(0.2, 0.4), 4, 2),
        (sg.Rectangle(1.4, 0.59), 4, 14),
        (sg.Disc(0.2), 4, 4),
    ],
)
def test_other_bases_get_rows_within_their_width_and_a_lead_in_of_their_length(
    base: object, rows: int, lead_in: int
) -> None:
    zone = Line().site(base, None).zone
    assert (zone[1], zone[2]) == (rows, lead_in)
    assert zone[0] == 10 - rows // 2


@pytest.mark.parametrize(
    "base", [sg.Rectangle(1.41, 0.2), sg.Rectangle(0.2, 0.6), sg.Disc(0.3), sg.Disc(1.0)]
)
def test_a_base_that_does_not_fit_the_line_is_refused(base: object) -> None:
    with pytest.raises(ValueError, match=r"parcel must be at most 1\.4 m long"):
        Line().site(base, None)


def test_a_field_is_all_rotors_and_obeys_all_over() -> None:
    field = Field(rows=6, columns=9)
    site = field.site(sg.Disc(3.0), None)
    assert site.rotor.shape == (6, 9)
    assert site.rotor.all()
    assert site.zone == (0, 6, 0, 9)
    assert field.site(sg.Disc(3.0), (2, 4)).zone == (0, 6, 2, 3)
