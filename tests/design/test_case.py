import numpy as np
import pytest

import surface_gym as sg
from surface_gym import layouts
from surface_gym.design.case import GROUPS, NOTHING, TOGETHER, Case, Unknown, draw
from surface_gym.design.purposes import Slow

BOX = layouts.box("S")


def test_a_group_varies_alone() -> None:
    unknown = Unknown(lateral=0.01)
    assert unknown.groups == (*GROUPS, TOGETHER)
    friction = unknown.only("friction")
    assert (friction.friction, friction.rolling) == (0.2, 0.2)
    assert friction.stiffness == friction.com_offset == friction.lateral == 0.0
    assert unknown.only(TOGETHER) == unknown
    assert NOTHING.groups == ()


def test_draws_follow_their_laws() -> None:
    line = Case(BOX).line(4)
    unknown = Unknown(speed=0.1, tilt=0.02, lateral=0.03)
    drawn = draw(unknown, BOX, line, 2000, 0)
    assert np.abs(drawn.friction - 1.0).max() <= 0.2
    assert drawn.friction.std(axis=0) == pytest.approx(0.4 / np.sqrt(12.0), rel=0.05)
    assert drawn.faster.std() == pytest.approx(0.1, rel=0.05)
    assert drawn.steeper.std() == pytest.approx(0.02, rel=0.05)
    assert drawn.aside.std() == pytest.approx(0.03, rel=0.05)
    assert drawn.stiffness is not None
    assert np.log(drawn.stiffness).std() == pytest.approx(0.35, rel=0.01)
    offsets = np.array([parcel.com_offset for parcel in drawn.parcels])
    assert np.abs(offsets).max() <= 0.1 * 0.125


def test_a_draw_does_not_depend_on_how_many_there_are() -> None:
    line = Case(BOX).line(4)
    few, many = (draw(Unknown(), BOX, line, count, 3) for count in (2, 5))
    np.testing.assert_array_equal(few.friction, many.friction[:2])
    np.testing.assert_array_equal(few.stiffness, many.stiffness[:2])
    assert few.parcels == many.parcels[:2]


def test_draws_become_runs() -> None:
    drawn = draw(Unknown(speed=0.5), BOX, Case(BOX).line(4), 50, 0)
    runs = drawn.runs(0.6, 0.0, columns=4, layout=2)
    assert runs.speed.min() >= 0.0
    np.testing.assert_allclose(runs.speed, np.maximum(0.0, 0.6 + drawn.faster))
    np.testing.assert_array_equal(runs.ground, np.arange(50))
    assert (runs.layout == 2).all()
    assert (runs.columns == 4).all()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"parcel": "S"}, "parcel must be a Parcel, got 'S'"),
        ({"purpose": "sort"}, "purpose must be a Purpose, got 'sort'"),
        ({"unknown": sg.Randomisation()}, "unknown must be an Unknown"),
        ({"speed": -1.0}, "speed must be between 0 and 20, got -1.0"),
        ({"speed": 0.0}, "speed must be greater than 0 on a level surface"),
        ({"tilt": 1.0}, r"tilt must be from 0 to below pi/4 \(45 deg\), got 1.0"),
        ({"draws": 0}, "draws must be a whole number of at least 1, got 0"),
        ({"step": 1.0}, "step must be between 1e-05 and 0.02, got 1.0"),
    ],
)
def test_what_is_not_allowed_is_named(arguments: dict[str, object], told: str) -> None:
    with pytest.raises(ValueError, match=told):
        Case(**{"parcel": BOX, **arguments})  # type: ignore[arg-type]


def test_sizes_belong_to_a_map() -> None:
    with pytest.raises(ValueError, match=r"size must be 0, got 0.1: a map goes over sizes"):
        Unknown(size=0.1)


def test_a_case_at_another_speed() -> None:
    case = Case(BOX, Slow(0.4), speed=1.0)
    assert case.at(2.0) == Case(BOX, Slow(0.4), speed=2.0)
