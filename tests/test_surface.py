"""Surfaces, what they refuse, and the paper's layouts, element by element (Figures 6, 9)."""

import dataclasses
import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import layouts

AXIS = np.zeros((3, 4))
ROTOR = np.ones((3, 4), dtype=bool)
DEG = math.pi / 180.0
LINE_Y = {"S": [0.95, 1.05], "B": [0.85, 0.95, 1.05, 1.15]}  # [m] of the rotors' rows
LEAD_IN = {"S": 3, "B": 5}


class TestSurface:
    def test_places_of_the_elements_and_defaults_of_table_1(self):
        surface = sg.Surface(AXIS, ROTOR, pitch=0.2, origin=(1.0, -1.0))
        assert (surface.rows, surface.columns) == (3, 4)
        np.testing.assert_allclose(surface.x, [1.0, 1.2, 1.4, 1.6])
        np.testing.assert_allclose(surface.y, [-1.0, -0.8, -0.6])
        surface = sg.Surface(AXIS, ROTOR)
        assert (surface.mu_max, surface.mu_min, surface.mu_support) == (0.5, 0.01, 0.005)
        assert (surface.pitch, surface.origin, surface.tilt) == (0.1, (0.05, 0.05), 0.0)
        surface = sg.Surface([[0, 1]], [[True, False]], pitch=1, tilt=0)
        assert surface.axis.dtype == np.float64
        assert surface.rotor.tolist() == [[True, False]]

    def test_the_arrays_are_read_only_copies(self):
        axis, rotor = AXIS.copy(), ROTOR.copy()
        surface = sg.Surface(axis, rotor)
        axis[:] = 1.0
        rotor[:] = False
        assert (surface.axis == 0.0).all()
        assert surface.rotor.all()
        with pytest.raises(ValueError, match="read-only"):
            surface.axis[0, 0] = 1.0
        with pytest.raises(ValueError, match="read-only"):
            surface.rotor[0, 0] = False
        with pytest.raises(dataclasses.FrozenInstanceError):
            surface.tilt = 0.1

    def test_replace_makes_another_surface_with_another_grid(self):
        flat = sg.Surface(AXIS, ROTOR)
        assert flat.grid.gravity_x == 0.0
        tilted = dataclasses.replace(flat, tilt=0.1)
        assert tilted.grid.gravity_x == pytest.approx(9.81 * math.sin(0.1))
        assert tilted.grid.gravity_normal == pytest.approx(9.81 * math.cos(0.1))
        assert flat.grid.gravity_x == 0.0

    @pytest.mark.parametrize("tilt", [0.1, -0.1])
    @pytest.mark.parametrize(
        ("degrees", "x", "y"),
        [
            (0.0, 1.0, 0.0), (90.0, 0.0, 1.0), (180.0, -1.0, 0.0), (270.0, 0.0, -1.0),
            (-90.0, 0.0, -1.0), (360.0, 1.0, 0.0),
        ],
    )  # fmt: skip
    def test_at_right_angles_all_of_gravity_lies_along_one_axis(self, tilt, degrees, x, y):
        surface = sg.Surface(AXIS, ROTOR, tilt=tilt, tilt_direction=math.radians(degrees))
        downhill = 9.81 * math.sin(tilt)
        assert (surface.grid.gravity_x, surface.grid.gravity_y) == (x * downhill, y * downhill)
        assert surface.grid.gravity_normal == 9.81 * math.cos(tilt)

    def test_between_them_it_is_split_by_the_direction(self):
        grid = sg.Surface(AXIS, ROTOR, tilt=0.1, tilt_direction=2.5).grid
        downhill = 9.81 * math.sin(0.1)
        assert grid.gravity_x == pytest.approx(downhill * math.cos(2.5), rel=1e-15)
        assert grid.gravity_y == pytest.approx(downhill * math.sin(2.5), rel=1e-15)

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"axis": np.zeros((3, 5))}, r"rotor must have the shape of axis, \(3, 5\), got"),
            ({"axis": np.zeros(4)}, r"axis must have the shape \(any, any\), got \(4,\)"),
            ({"axis": np.zeros((0, 4))}, "axis must have at least one row and one column"),
            ({"axis": ROTOR}, "axis must be an array of numbers"),
            ({"rotor": ROTOR[:2]}, r"rotor must have the shape of axis, \(3, 4\), got \(2, 4\)"),
            ({"rotor": ROTOR.astype(float)}, "rotor must be an array of booleans, got .*float64"),
            ({"rotor": [[True], [True, False]]}, "rotor must be an array of booleans"),
            ({"stiffness": np.ones((3, 5))}, r"stiffness must have the shape \(3, 4\), got \(3, 5"),
            ({"stiffness": np.zeros((3, 4))}, "stiffness must be greater than 0, got 0.0"),
            ({"stiffness": 1.0}, r"stiffness must have the shape \(3, 4\), got \(\)"),
            ({"origin": (0.0,)}, r"origin must have the shape \(2\), got \(1,\)"),
            ({"mu_max": [[0.5], [0.5, 0.5]]}, "mu_max must be an array of numbers"),
            ({"mu_max": np.ones((3, 5))}, r"mu_max must have the shape \(3, 4\), got \(3, 5\)"),
            ({"tilt": -1.0}, "tilt must be between -pi/4 and pi/4 .*, got -1.0"),
            (
                {"tilt_direction": 90.0},
                "tilt_direction must be between -6.28319 and 6.28319 rad, got 90.0; degrees become",
            ),
            ({"tilt_direction": None}, "tilt_direction must be a finite number, got None"),
        ],
    )
    def test_what_is_not_allowed_is_refused(self, changes, message):
        fields: dict[str, object] = {"axis": AXIS, "rotor": ROTOR, **changes}
        with pytest.raises(ValueError, match=f"^{message}"):
            sg.Surface(**fields)


def line_of(surface: sg.Surface) -> np.ndarray:
    """(line rows, columns) [deg] axes of the rotors."""
    rows = surface.rotor.all(axis=1)
    assert not surface.rotor[~rows].any()
    return surface.axis[rows] / DEG


class TestLayouts:
    @pytest.mark.parametrize("size", ["S", "B"])
    @pytest.mark.parametrize("side", [-1, 1])
    def test_sorting(self, size, side):
        surface = layouts.sorting(size, side, task_columns=7, columns=20)
        np.testing.assert_allclose(surface.y[surface.rotor.all(axis=1)], LINE_Y[size])
        axis = line_of(surface)
        lead_in = LEAD_IN[size]
        np.testing.assert_allclose(axis[:, :lead_in], 90.0)
        np.testing.assert_allclose(axis[:, lead_in : lead_in + 7], -45.0 * side)
        np.testing.assert_allclose(axis[:, lead_in + 7 :], 90.0)
        assert axis.shape[1] == 20

    @pytest.mark.parametrize("size", ["S", "B"])
    def test_the_box_starts_wholly_on_the_lead_in(self, size):
        surface, box, pose = layouts.sorting(size), layouts.box(size), layouts.start(size)
        assert pose == pytest.approx((box.base.length / 2.0, 1.0, 0.0))
        right = pose[0] + box.base.length / 2.0
        first_of_task = surface.x[LEAD_IN[size]]
        assert surface.x[LEAD_IN[size] - 1] <= right + 1e-9 < first_of_task

    def test_slowing_alternates_from_row_to_row(self):
        axis = line_of(layouts.slowing("B", angle=45.0 * DEG, task_columns=3))
        np.testing.assert_allclose(np.abs(axis[:, 5:8]), 45.0)
        np.testing.assert_allclose(axis[:-1, 5:8], -axis[1:, 5:8])
        np.testing.assert_allclose(axis[:, 8:], 90.0)

    @pytest.mark.parametrize("size", ["S", "B"])
    @pytest.mark.parametrize("angle", [0.0, 45.0])
    def test_stopping_is_slowing_with_one_more_column_at_0_deg(self, size, angle):
        slowing = line_of(layouts.slowing(size, angle * DEG, task_columns=2))
        stopping = line_of(layouts.stopping(size, angle * DEG, task_columns=2))
        extra = LEAD_IN[size] + 2
        np.testing.assert_allclose(stopping[:, extra], 0.0)
        np.testing.assert_array_equal(
            np.delete(stopping, extra, axis=1), np.delete(slowing, extra, axis=1)
        )

    def test_a_line_takes_one_row_for_all_or_each(self):
        one = line_of(layouts.line([[0.1, 0.2]], "B"))
        np.testing.assert_allclose(one[:, 5:7] * DEG, [[0.1, 0.2]] * 4)
        each = line_of(layouts.line([[0.1], [0.2], [0.3], [0.4]], "B"))
        np.testing.assert_allclose(each[:, 5] * DEG, [0.1, 0.2, 0.3, 0.4])

    def test_boxes_and_tilt(self):
        for size, length in (("S", 0.25), ("B", 0.45)):
            assert layouts.box(size) == sg.Parcel(sg.Rectangle(length, length))
        for layout in (layouts.sorting, layouts.slowing, layouts.stopping):
            assert layout(tilt=0.1).tilt == 0.1

    @pytest.mark.parametrize(
        ("call", "message"),
        [
            (lambda: layouts.box("M"), "size must be one of 'S', 'B', got 'M'"),
            (lambda: layouts.sorting("s"), "size must be one of 'S', 'B', got 's'"),
            (lambda: layouts.sorting(side=0), "side must be one of -1, 1, got 0"),
            (lambda: layouts.sorting(task_columns=0), "task_columns must be a whole number"),
            (lambda: layouts.slowing(angle=math.nan), "angle must be a finite number"),
            (lambda: layouts.sorting(columns=32), "columns must be a whole number of at least 33"),
            (lambda: layouts.stopping("B", columns=7), "columns must be .* of at least 8"),
            (lambda: layouts.line([0.0, 1.0]), r"task_axis must have the shape \(any, any\)"),
            (lambda: layouts.line(np.zeros((3, 2))), "task_axis must have 1 or 2 rows, got 3"),
            (lambda: layouts.line([[np.inf]]), "task_axis must be finite, got inf"),
        ],
    )
    def test_bad_arguments_of_layouts_are_refused(self, call, message):
        with pytest.raises(ValueError, match=f"^{message}"):
            call()
