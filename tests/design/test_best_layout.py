"""The best fixed layout, beside the study's and beside all there are."""

import itertools
import math
from pathlib import Path

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import layouts
from surface_gym.design.best_layout import best_layout, over_speeds
from surface_gym.design.case import NOTHING, Case, Unknown
from surface_gym.design.every_layout import every_layout
from surface_gym.design.purposes import Slow, Sort, Stop, Turn
from surface_gym.design.runs import make_runs, run_all
from surface_gym.design.search import Effort
from surface_gym.design.shortfall import shortfall
from surface_gym.lines import ORIENTATIONS

S = layouts.box("S")
QUICK = Effort(members=12, generations=3, epochs=2, rounds=1)
SPEEDS = [0.5, 0.7, 0.9, 1.5]


def case(**others) -> Case:
    return Case(**{"parcel": S, "unknown": NOTHING, **others})


def left_at(axis: np.ndarray, speed: float) -> float:
    """[m] across where a box that `simulate` sends over a zone (rows, columns) [rad] gets to."""
    line = case().line(axis.shape[1])
    run = sg.simulate(line.surface(axis), S, line.start(S), (speed, 0.0, 0.0), duration=6.0)
    return float(run.pose[-1, 1]) - line.line_y


def test_any_angle_sorts_slower_boxes_than_the_study_s_four() -> None:
    """Held against `simulate`, which knows nothing of a design."""
    found = best_layout(case(), SPEEDS, orientations=None, effort=QUICK)
    assert found.study.success.tolist() == [False, False, True, True]
    assert found.best.success.tolist() == [True] * 4
    assert (found.best.least_speed, found.study.least_speed) == (0.5, 0.9)
    half_line = 0.1
    for speed in SPEEDS[:2]:
        assert left_at(found.best.axis, speed) < -(half_line + 0.125) + 0.05
        assert left_at(found.study.axis, speed) > -half_line - 0.125


def test_no_layout_of_the_four_orientations_sorts_below_the_study_s_least_speed() -> None:
    """All 4^32 of them, the S-box; one that sorts from 0.72 m/s on is the study's."""
    tried = [every_layout(case(speed=speed / 100)) for speed in (30, 40, 50, 60, 66, 68, 70)]
    assert all(each.complete and each.axis is None for each in tried)
    found = every_layout(case(speed=0.72))
    assert found.axis is not None
    study = Sort().layouts(case().line(16), 16)[0]
    over = over_speeds("study", study.axis, case(), case().line(16), np.arange(30, 271, 2) / 100)
    assert over.least_speed == 0.72


def test_every_layout_is_really_every_one() -> None:
    """Beside trying them blindly, on a zone so short that it can be done."""
    own = case(speed=0.9)
    columns = 3
    line = own.line(columns)
    every = np.array(list(itertools.product(ORIENTATIONS, repeat=2 * columns)))
    axes = every.reshape(-1, 2, columns)
    for purpose in (Sort(), Turn(math.radians(40.0)), Turn(math.radians(80.0))):
        asked = case(speed=0.9, purpose=purpose)
        runs = make_runs(0.9, layout=np.arange(len(axes)), columns=columns)
        ends = run_all(line, axes, [S], runs)
        any_does = bool(purpose.succeeds(line, runs, ends).any())
        found = every_layout(asked, columns)
        assert found.complete
        assert (found.axis is not None) == any_does
        if found.axis is not None:
            over = over_speeds("it", found.axis, asked, line, np.array([0.9]))
            assert over.success.tolist() == [True]


def test_what_is_not_known_is_not_claimed() -> None:
    tried = every_layout(case(speed=0.7), most=100)
    assert tried.axis is None
    assert not tried.complete
    assert tried.runs <= 100


@pytest.mark.parametrize(
    "purpose",
    [Slow(0.5, tolerance=0.01), Stop(0.4, tolerance=0.01), Turn(math.radians(20.0), 0.03)],
    ids=lambda purpose: purpose.name,
)
def test_other_purposes_are_met_more_nearly_than_by_the_study_s_layouts(purpose) -> None:
    found = best_layout(case(purpose=purpose), [1.0], 6, orientations=None, effort=QUICK)
    assert found.best.successes >= found.study.successes

    def error(over) -> float:
        line = found.line
        runs = make_runs(over.speeds, columns=6)
        ends = run_all(line, over.axis[np.newaxis], [S], runs)
        return float(shortfall(purpose, line, runs, ends).mean())

    assert error(found.best) < error(found.study)


@pytest.mark.parametrize(
    "purpose", [Sort(), Sort(1), Slow(), Slow(0.5, 0.1), Stop(), Stop(0.3), Turn()], ids=repr
)
def test_a_shortfall_is_0_where_all_is_as_asked_and_more_where_it_fails(purpose) -> None:
    line = case().line(8)
    rng = np.random.default_rng(4)
    axes = np.array(ORIENTATIONS)[rng.integers(0, 4, (300, 2, 8))]
    axes[:30] = purpose.layouts(line, 4)[0].axis
    runs = make_runs(rng.uniform(0.3, 2.5, 300), layout=np.arange(300), columns=8)
    ends = run_all(line, axes, [S], runs)
    short = shortfall(purpose, line, runs, ends)
    done = purpose.succeeds(line, runs, ends)
    assert ((short >= 0.0) & (short <= 1.0)).all()
    assert done.any()
    assert not done.all()
    assert (short[~done] > 0.0).all()
    assert short[done].max() < short[~done].max()
    if isinstance(purpose, Sort):
        assert (short[done] == 0.0).all()


def test_a_purpose_of_one_s_own_is_told_by_success_alone() -> None:
    class Fast(Stop):
        """Anything at all."""

    shown = shortfall.dispatch(object)
    line = case().line(4)
    runs = make_runs([0.3, 2.0], columns=4)
    ends = run_all(line, Sort().layouts(line, 4)[0].axis[np.newaxis], [S], runs)
    np.testing.assert_array_equal(shown(Stop(), line, runs, ends), [0.0, 1.0])


def test_threads_change_nothing_and_a_search_goes_on_where_it_was(tmp_path: Path) -> None:
    class Broken(Exception):
        pass

    def stop(done: int, _: int) -> None:
        if done == 2:
            raise Broken

    file = tmp_path / "S.npz"
    whole = best_layout(case(), SPEEDS, 6, orientations=None, effort=QUICK)
    with pytest.raises(Broken):
        best_layout(
            case(), SPEEDS, 6, orientations=None, effort=QUICK, checkpoint=file, advance=stop
        )
    found = best_layout(
        case(), SPEEDS, 6, orientations=None, effort=QUICK, checkpoint=file, workers=2
    )
    np.testing.assert_array_equal(found.best.axis, whole.best.axis)
    np.testing.assert_array_equal(found.best.time, whole.best.time)
    assert found.evaluations == whole.evaluations


def test_what_is_not_known_costs_speed() -> None:
    """Of the draws, fewer are sorted near the least speed than with nothing unknown."""
    line = case().line(16)
    axis = Sort().layouts(line, 16)[0].axis
    speeds = np.arange(60, 101, 4) / 100
    own = case(unknown=Unknown(), draws=40)
    over = over_speeds("study", axis, own, line, speeds, workers=2)
    assert over.least_sure_speed >= over.least_speed
    assert 0.0 < over.share[over.success][0] < 1.0
    nothing = over_speeds("study", axis, case(), line, speeds)
    np.testing.assert_array_equal(nothing.share, nothing.success)
    assert math.isnan(over_speeds("study", axis, case(), line, np.array([0.3])).least_speed)
    assert math.isnan(over_speeds("study", axis, case(), line, np.array([0.3])).mean_time)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("speeds", []),
        ("speeds", [0.0, 1.0]),
        ("speeds", [math.nan]),
        ("columns", 0),
        ("workers", 0),
        ("orientations", (0.0,)),
    ],
)
def test_what_is_not_allowed_is_named(name: str, value: object) -> None:
    arguments = {"speeds": SPEEDS, "effort": QUICK, name: value}
    with pytest.raises(ValueError, match=name):
        best_layout(case(), **arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("name", "value"),
    [("columns", 0), ("workers", 0), ("most", 0), ("most", 15), ("orientations", (0.0,))],
)
def test_what_is_not_allowed_is_named_where_all_are_tried(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=name):
        every_layout(case(), **{name: value})  # type: ignore[arg-type]
