"""The lines: as in the paper's Figure 6, and fields of rotors."""

from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from surface_gym.layouts import LEAD_IN, LINE_ROWS
from surface_gym.lines import BaseLine, Field, Line, Pattern
from tests.environments import CELLS_BY_DAY, bare, steps


@pytest.mark.parametrize("size", ["S", "B"])
def test_a_papers_box_has_the_rotors_of_its_layout_and_a_zone_after_its_lead_in(size):
    base, layout = sg.layouts.box(size).base, sg.layouts.sorting(size, task_columns=16, columns=30)
    site = Line().site(base, None)
    np.testing.assert_array_equal(site.rotor, layout.rotor)
    first_row, rows, first_column, columns = site.zone
    assert (rows, first_column, columns) == (LINE_ROWS[size], LEAD_IN[size], 16)
    obeying = np.zeros_like(layout.rotor)
    obeying[first_row : first_row + rows, first_column : first_column + columns] = True
    np.testing.assert_array_equal(obeying, layout.rotor & (layout.axis != np.pi / 2))
    assert Line().site(base, (7, 7)).zone[2:] == (7, 1)
    assert Line().site(base, (0, 29)).zone[2:] == (0, 30)


@pytest.mark.parametrize(
    ("base", "rows", "lead_in"),
    [
        (sg.Rectangle(0.3, 0.15), 2, 3), (sg.Rectangle(0.31, 0.39), 2, 4),
        (sg.Rectangle(0.2, 0.4), 4, 2), (sg.Rectangle(1.4, 0.59), 4, 14), (sg.Disc(0.2), 4, 4),
    ],
)  # fmt: skip
def test_other_bases_get_rows_within_their_width_and_a_lead_in_of_their_length(base, rows, lead_in):
    zone = Line().site(base, None).zone
    assert (zone[1], zone[2]) == (rows, lead_in)
    assert zone[0] == 10 - rows // 2


@pytest.mark.parametrize(
    "base", [sg.Rectangle(1.41, 0.2), sg.Rectangle(0.2, 0.6), sg.Disc(0.3), sg.Disc(1.0)]
)
def test_a_base_that_does_not_fit_the_line_is_refused(base):
    with pytest.raises(ValueError, match=r"parcel must be at most 1\.4 m long"):
        Line().site(base, None)


def test_a_field_is_all_rotors_and_obeys_all_over():
    field = Field(rows=6, columns=9)
    site = field.site(sg.Disc(3.0), None)
    assert site.rotor.shape == (6, 9)
    assert site.rotor.all()
    assert site.zone == (0, 6, 0, 9)
    assert field.site(sg.Disc(3.0), (2, 4)).zone == (0, 6, 2, 3)


ROTORS = np.random.default_rng(0).random((14, 40)) < 0.7
WORN = np.random.default_rng(1).uniform(0.2, 0.6, ROTORS.shape)
OWN = {
    "pattern": Pattern(ROTORS, lead_in=3, pitch=(0.08, 0.11), mu_max=WORN, mu_support=0.05 * WORN),
    "field": Field(rows=12, columns=40, pitch=(0.12, 0.07), mu_min=0.1 * WORN[:12]),
    "line": Line(rows=24, columns=40, line_y=1.6, origin=(0.3, 0.1), pitch=0.12, mu_max=0.4),
}


@pytest.mark.parametrize("line", OWN.values(), ids=OWN)
class TestACustomLine:
    def test_moves_a_parcel_as_simulate_does(self, line):
        env = sg.SmartSurfaceEnv("sort", actions="quadrants", line=line)
        box = sg.layouts.box("B")
        _, info = env.reset(seed=0, options={"speed": 1.6, "parcel": box, "side": 1})
        site = line.site(box.base)
        first_row, rows, first_column, columns = site.zone
        axis = np.full(site.rotor.shape, line.orientations[3])
        zone = np.s_[first_row : first_row + rows, first_column : first_column + columns]
        axis[zone] = line.orientations[2]
        surface = line.surface(axis, site.rotor)
        run = sg.simulate(surface, box, info["pose"], info["velocity"], duration=1.0)
        for period in range(1, 25):
            *_, terminated, _, info = env.step([2, 2, 2, 2])
            if terminated:
                break
            np.testing.assert_array_equal(info["pose"], run.pose[8 * period])
        assert period > 8

    def test_is_drawn(self, line):
        env = sg.SmartSurfaceEnv("sort", line=line, render_mode="rgb_array")
        env.reset(seed=0)
        picture = env.render()
        assert picture is not None
        width, height = line.pitch_x * line.columns, line.pitch_y * line.rows
        assert (picture.shape[1] > picture.shape[0]) == (width > 1.2 * height)

    def test_every_task_and_sensor_runs_on_it(self, line):
        for env_id, actions, sensor in CELLS_BY_DAY:
            env = bare(env_id, line=line, actions=actions, sensors=sensor())
            for observation, *_ in steps(env, seed=0, longest=10):
                assert observation in env.observation_space


def test_a_line_elsewhere_is_entered_at_its_middle():
    for line in (Line(), Line(line_y=0.7, origin=(1.05, 0.05))):
        env = sg.SmartSurfaceEnv("sort", actions="quadrants", line=line)
        pose = env.reset(seed=0, options={"speed": 1.2, "parcel": "B", "side": 0})[1]["pose"]
        assert pose[1] == line.line_y


def test_lines_compare_and_hash():
    assert Pattern(ROTORS) == Pattern(ROTORS.tolist())
    assert hash(Pattern(ROTORS)) == hash(Pattern(ROTORS.copy()))
    assert Field(mu_max=WORN[:2, :3], rows=2, columns=3) != Field(rows=2, columns=3)


BAD_LINES: tuple[tuple[type[BaseLine], dict[str, Any], str], ...] = (
    (Field, {"rows": 0}, "rows"),
    (Field, {"pitch": (0.1, -0.1)}, "pitch"),
    (Field, {"pitch": (0.1, 0.1, 0.1)}, "pitch"),
    (Field, {"mu_max": np.ones((3, 3))}, r"mu_max must have the shape \(20, 60\)"),
    (Field, {"orientations": (0.0,)}, "orientations"),
    (Field, {"origin": (0.0,)}, "origin"),
    (Line, {"line_y": 1.05}, "line_y must lie halfway between two rows"),
    (Line, {"zone_rows": 3}, "zone_rows must be even"),
    (Line, {"zone_columns": 30}, "zone_columns"),
    (Pattern, {"rotor": np.ones((3, 4))}, "rotor must be an array of booleans"),
    (Pattern, {"rotor": np.ones(4, dtype=bool)}, "rotor must have"),
    (Pattern, {"rotor": np.zeros((3, 4), dtype=bool)}, "lead_in must leave a rotor"),
    (Pattern, {"rotor": np.ones((3, 4), dtype=bool), "lead_in": 4}, "lead_in"),
)


@pytest.mark.parametrize(("kind", "fields", "named"), BAD_LINES)
def test_bad_fields_are_named(kind, fields, named):
    with pytest.raises(ValueError, match=named):
        kind(**fields)


def test_a_parcel_of_too_many_elements_is_refused():
    fine = Field(rows=400, columns=400, pitch=0.005)
    with pytest.raises(ValueError, match="elements"):
        sg.SmartSurfaceEnv("track", line=fine)
