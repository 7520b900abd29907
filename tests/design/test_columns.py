"""Tables 3 and 4 are special cases of what a design answers."""

import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import layouts
from surface_gym.design.case import NOTHING, Case, Slow, Sort, Stop, Turn, Unknown
from surface_gym.design.columns import columns_by_rows, columns_by_speed, least_columns
from surface_gym.paper.runs import SlowingLayout, load_targets

TARGETS = load_targets()
FINE = 0.0005  # [s]


@pytest.mark.parametrize("size", ["S", "B"])
def test_table_3(size):
    """The S-box at 1.5 m/s takes 5 (the study 4); the B-box is sorted at 1.0 m/s (there not)."""
    case = Case(layouts.box(size), Sort(), unknown=NOTHING, step=FINE)
    ours = [each.columns for each in columns_by_speed(case, TARGETS.sorting_speeds)]
    same = [one == other for one, other in zip(ours, TARGETS.sorting_columns[size], strict=True)]
    assert sum(same) == 19


@pytest.mark.parametrize(("size", "agree"), [("S", 18), ("B", 17)])
def test_table_4(size, agree):
    case = Case(layouts.box(size), Slow(0.5), unknown=NOTHING, step=FINE)
    found = columns_by_speed(case, TARGETS.slowing_speeds, most=8)
    angle = {"0 deg": 0, "+-45 deg": 45}
    same = [
        ours.columns is not None and SlowingLayout(ours.columns, angle[ours.layout]) == theirs
        for ours, theirs in zip(found, TARGETS.slowing_layouts[size], strict=True)
    ]
    assert sum(same) == agree


def test_the_columns_found_are_enough_and_one_less_is_not():
    """Held against `simulate`, which knows nothing of a design."""
    parcel = sg.Parcel(sg.Rectangle(0.3, 0.4), mass=12.0)
    case = Case(parcel, Sort(), speed=1.2, unknown=NOTHING)
    found = least_columns(case)

    def aside(columns: int) -> float:
        """[m] that the parcel gets from the line's middle within 3 s."""
        line = case.line(30)
        surface = line.surface(case.purpose.layouts(line, columns)[0].axis)
        run = sg.simulate(surface, parcel, line.start(parcel), (1.2, 0.0, 0.0), duration=3.0)
        return float(np.abs(run.pose[-1, 1] - line.line_y))

    clear = 0.5 * 0.4 + 0.15  # half the parcel and half the line
    assert aside(found.fewest) > clear
    assert aside(found.fewest - 1) < clear
    assert found.fewest <= found.columns
    assert found.modules == 4 * found.columns


def test_mass_alone_changes_nothing_and_worse_draws_take_more_columns():
    base = sg.Rectangle(0.3, 0.4)
    light, heavy = (least_columns(Case(sg.Parcel(base, mass=mass), speed=1.2)) for mass in (1, 50))
    assert light == heavy
    case = Case(layouts.box("S"), speed=1.45, unknown=Unknown(friction=0.6), draws=60)
    found = least_columns(case)
    friction = next(worst for worst in found.worst if worst.group == "friction")
    assert friction.columns > found.columns
    assert friction.success < 0.95


def test_too_slow_a_parcel_is_never_sorted_and_no_columns_are_refused():
    found = least_columns(Case(layouts.box("B"), speed=0.5, draws=5))
    assert found.columns is found.fewest is found.modules is None
    assert math.isnan(found.measure)
    assert all(worst.columns is None and worst.success == 0.0 for worst in found.worst)
    with pytest.raises(ValueError, match="most must be a whole number of at least 1, got 0"):
        least_columns(Case(layouts.box("S")), most=0)


def test_rows_from_one_to_the_parcel_s_width():
    found = columns_by_rows(Case(layouts.box("B"), speed=1.5, unknown=NOTHING))
    assert [each.rows for each in found] == [1, 2, 3, 4]
    assert all(each.columns for each in found)


@pytest.mark.parametrize(
    ("purpose", "speed", "low", "high"),
    [
        (Stop(), 1.5, 0.0, math.inf),
        (Turn(tolerance=0.2), 1.5, 0.3, 0.8),
        (Stop(place=0.2, tolerance=0.05), 1.2, 0.15, 0.25),
    ],
)
def test_other_purposes(purpose, speed, low, high):
    found = least_columns(Case(layouts.box("S"), purpose, speed, unknown=Unknown(), draws=10))
    assert found.columns
    assert low < found.measure < high
