"""The best fixed layout, beside the study's and beside all there are; those that ship."""

import itertools
import math

import numpy as np
import pytest

import surface_gym as sg
from surface_gym import layouts
from surface_gym.design import (
    Case,
    Purpose,
    SlowPurpose,
    SortPurpose,
    StopPurpose,
    TurnPurpose,
    Unknown,
    fixed_layout as shipped,
)
from surface_gym.design.case import NOTHING
from surface_gym.design.fixed_layout import (
    Effort,
    LayoutSpace,
    best_layout,
    evaluate_layout,
    every_layout,
    search,
)
from surface_gym.design.runs import make_runs, run_all
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


def evaluate_study(speeds: np.ndarray, own: Case | None = None, workers: int = 1):
    """How the study's layout does over a zone of 16 columns."""
    line = case().line(16)
    axis = SortPurpose().layouts(line, 16)[0].axis
    return evaluate_layout("study", axis, own or case(), line, speeds, workers=workers)


def test_any_angle_sorts_slower_boxes_than_the_study_s_four():
    found = best_layout(case(), SPEEDS, orientations=None, effort=QUICK)
    assert found.study.success.tolist() == [False, False, True, True]
    assert found.best.success.tolist() == [True] * 4
    assert (found.best.least_speed, found.study.least_speed) == (0.5, 0.9)
    half_line = 0.1
    for speed in SPEEDS[:2]:
        assert left_at(found.best.axis, speed) < -(half_line + 0.125) + 0.05
        assert left_at(found.study.axis, speed) > -half_line - 0.125


def test_no_layout_of_the_four_orientations_sorts_below_the_study_s_least_speed():
    """All 4^32 of them, the S-box; one that sorts from 0.72 m/s on is the study's."""
    for speed in (30, 40, 50, 60, 66, 68, 70):
        assert every_layout(case(speed=speed / 100)) is None
    assert every_layout(case(speed=0.72)) is not None
    assert evaluate_study(np.arange(30, 271, 2) / 100).least_speed == 0.72


def test_every_layout_is_really_every_one_unless_there_is_no_time_to_try_them():
    columns = 3
    line = case().line(columns)
    axes = np.array(list(itertools.product(ORIENTATIONS, repeat=6))).reshape(-1, 2, columns)
    for purpose in (
        SortPurpose(),
        TurnPurpose(math.radians(40.0)),
        TurnPurpose(math.radians(80.0)),
    ):
        asked = case(speed=0.9, purpose=purpose)
        runs = make_runs(0.9, layout=np.arange(len(axes)), columns=columns)
        ends = run_all(line, axes, [S], runs)
        found = every_layout(asked, columns)
        assert (found is not None) == purpose.succeeds(ends).any()
        if found is not None:
            over = evaluate_layout("it", found, asked, line, np.array([0.9]))
            assert over.success.tolist() == [True]
    with pytest.raises(ValueError, match=r"most must be more than the \d+ runs so far, got 100"):
        every_layout(case(speed=0.7), most=100)


@pytest.mark.parametrize(
    "purpose",
    [
        SlowPurpose(0.5, tolerance=0.01),
        StopPurpose(0.4, tolerance=0.01),
        TurnPurpose(math.radians(20.0), 0.03),
    ],
    ids=lambda purpose: purpose.name,
)
def test_other_purposes_are_met_more_nearly_than_by_the_study_s_layouts(purpose):
    found = best_layout(case(purpose=purpose), [1.0], 6, orientations=None, effort=QUICK)
    assert found.best.successes >= found.study.successes

    def error(over) -> float:
        ends = run_all(found.line, over.axis[None], [S], make_runs(over.speeds, columns=6))
        return float(purpose.shortfall(ends).mean())

    assert error(found.best) < error(found.study)


@pytest.mark.parametrize(
    "purpose",
    [
        SortPurpose(),
        SortPurpose(1),
        SlowPurpose(),
        SlowPurpose(0.5, 0.1),
        StopPurpose(),
        StopPurpose(0.3),
        TurnPurpose(),
    ],
    ids=repr,
)
def test_a_shortfall_is_0_where_all_is_as_asked_and_more_where_it_fails(purpose):
    line = case().line(8)
    rng = np.random.default_rng(4)
    axes = np.array(ORIENTATIONS)[rng.integers(0, 4, (300, 2, 8))]
    axes[:30] = purpose.layouts(line, 4)[0].axis
    runs = make_runs(rng.uniform(0.3, 2.5, 300), layout=np.arange(300), columns=8)
    ends = run_all(line, axes, [S], runs)
    short = purpose.shortfall(ends)
    done = purpose.succeeds(ends)
    assert ((short >= 0.0) & (short <= 1.0)).all()
    assert done.any()
    assert not done.all()
    assert (short[~done] > 0.0).all()
    assert short[done].max() < short[~done].max()
    if isinstance(purpose, SortPurpose):
        assert (short[done] == 0.0).all()


def test_for_other_purposes_success_alone_counts():
    line = case().line(4)
    axes = SortPurpose().layouts(line, 4)[0].axis[None]
    ends = run_all(line, axes, [S], make_runs([0.3, 2.0], columns=4))
    np.testing.assert_array_equal(Purpose.shortfall(StopPurpose(), ends), [0.0, 1.0])


def test_what_is_not_known_costs_speed():
    speeds = np.arange(60, 101, 4) / 100
    over = evaluate_study(speeds, case(unknown=Unknown(), draws=40), workers=2)
    assert over.least_sure_speed >= over.least_speed
    assert 0.0 < over.share[over.success][0] < 1.0
    nothing = evaluate_study(speeds)
    np.testing.assert_array_equal(nothing.share, nothing.success)
    slow = evaluate_study(np.array([0.3]))
    assert math.isnan(slow.least_speed)
    assert math.isnan(slow.mean_time)


@pytest.mark.parametrize(
    ("find", "wrong"),
    [
        (best_layout, {"speeds": ([], [0.0, 1.0], [math.nan])}),
        (best_layout, {"columns": (0,), "workers": (0,), "orientations": ((0.0,),)}),
        (every_layout, {"columns": (0,), "orientations": ((0.0,),)}),
        (every_layout, {"most": (0, 15)}),
    ],
)
def test_an_argument_that_is_not_allowed_is_named(find, wrong):
    given = {best_layout: {"speeds": SPEEDS, "effort": QUICK}}.get(find, {})
    for name, values in wrong.items():
        for value in values:
            with pytest.raises(ValueError, match=name):
                find(case(), **{**given, name: value})


FEW = np.array([0.5, 0.7, 0.72, 1.5])  # [m/s]; the study's layout sorts at the last two
SHIPPED = shipped.sorting_layouts()
each = pytest.mark.parametrize("layout", SHIPPED, ids=lambda own: f"{own.box}-{own.offer}")


@each
def test_it_does_what_its_file_says(layout):
    case = Case(layouts.box(layout.box), unknown=NOTHING)
    line = case.line(shipped.COLUMNS)
    found = evaluate_layout("it", layout.axis, case, line, shipped.SPEEDS, workers=2)
    axis = np.full_like(layout.axis, math.pi / 4)
    study = evaluate_layout("study", axis, case, line, shipped.SPEEDS)
    assert (found.least_speed, study.least_speed) == (layout.least_speed, layout.study_least_speed)
    assert found.mean_time == pytest.approx(layout.mean_time, abs=1e-6)
    assert layout.least_speed <= layout.least_sure_speed
    assert layout.half_length == {"S": 0.125, "B": 0.225}[layout.box]
    offered = shipped.OFFERS[layout.offer]
    if offered is not None:
        apart = np.abs(np.sin(layout.axis[..., np.newaxis] - np.array(offered)))
        assert apart.min(axis=-1).max() < 1e-9


def test_there_is_one_for_every_box_and_offer_the_more_axes_the_slower_may_it_come():
    least = {(own.box, own.offer): own.least_speed for own in SHIPPED}
    assert set(least) == set(itertools.product(shipped.SIZES, shipped.OFFERS))
    assert len(least) == len(SHIPPED)
    for box in shipped.SIZES:
        assert least[box, "any"] < least[box, "eight"] < least[box, "four"]


def test_layouts_found_anew_are_read_back(tmp_path, monkeypatch, capsys):
    effort = Effort(members=6, generations=1, epochs=1, rounds=0)
    monkeypatch.setattr(shipped, "SPEEDS", FEW)
    monkeypatch.setattr(shipped.resources, "files", lambda _: tmp_path)
    monkeypatch.setattr(shipped, "FILE", "new/sorting.json")
    file = tmp_path / "new" / "sorting.json"
    shipped.write_sorting_layouts(file, ("four", "any"), ("S",), effort)
    four, _ = capsys.readouterr().out.splitlines()
    assert four == "S-box, four: sorts from 0.72 m/s on"
    read = shipped.sorting_layouts.__wrapped__()
    assert [(own.box, own.offer) for own in read] == [("S", "four"), ("S", "any")]
    wanted = best_layout(Case(S), FEW, orientations=None, effort=effort)
    np.testing.assert_allclose(read[1].axis, wanted.best.axis, rtol=0.0, atol=1e-12)
    assert read[1].least_speed == wanted.best.least_speed
    assert [path.name for path in file.parent.iterdir()] == ["sorting.json"]


# The search alone, held against costs whose least is known.

FOUR = tuple(np.radians([-45.0, 0.0, 45.0, 90.0]).tolist())
SMALL = Effort(members=16, generations=5, epochs=4, rounds=2)
ROLLING = np.full((1, 2, 5), math.pi / 2)
SPACE = LayoutSpace(2, 5, FOUR)


def target(space: LayoutSpace = SPACE) -> np.ndarray:
    """A layout (rows, columns) [rad] drawn by chance."""
    return space.axes(space.sample(np.random.default_rng(5), 1))[0]


def apart(wanted: np.ndarray):
    """A cost that is least, 0, at the wanted axes; its slope tells little: modules that differ."""

    def score(axes: np.ndarray) -> np.ndarray:
        return np.abs(np.sin(axes - wanted)).sum(axis=(1, 2))

    return score


def test_it_finds_the_least_of_a_sum_over_modules_and_keeps_what_it_begins_with():
    found = search(SPACE, apart(target()), ROLLING, SMALL, seed=0)
    np.testing.assert_array_equal(found, target())
    found = search(SPACE, apart(target()), target()[None], Effort(5, 1, 1, 0), seed=3)
    np.testing.assert_array_equal(found, target())


def test_it_finds_what_no_single_module_tells_by_all_of_a_column():
    def score(axes: np.ndarray) -> np.ndarray:
        right = (np.abs(axes - target()) < 1e-9).all(axis=1)
        return -right.sum(axis=1).astype(float)

    found = search(SPACE, score, ROLLING, Effort(5, 1, 0, 1), seed=0)
    np.testing.assert_array_equal(found, target())


def test_any_angle_may_be_found():
    space = LayoutSpace(2, 3, None)
    wanted = np.radians([[10.0, -20.0, 33.0], [5.0, 80.0, -61.0]])
    effort = Effort(members=30, generations=40, epochs=5, rounds=10)
    found = search(space, apart(wanted), ROLLING[:, :, :3], effort, seed=0)
    assert np.abs(np.sin(found - wanted)).max() < math.radians(2.0)


def test_the_seed_alone_is_left_to_chance_and_progress_is_reported():
    space = LayoutSpace(2, 5, None)
    score, effort = apart(target(space)), Effort(8, 2, 2, 0)
    one, same, other = (search(space, score, ROLLING, effort, seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(one, same)
    assert (one != other).any()
    calls = []
    search(SPACE, apart(target()), ROLLING, SMALL, 0, on_progress=lambda *at: calls.append(at))
    done = [at for at, _ in calls]
    assert done == sorted(done)
    assert {steps for _, steps in calls} == {4 + 2 * 5}
    assert (done[0], done[-1]) == (0, 14)


def test_members_and_axes_are_each_other_s_inverse_but_for_a_turn_by_pi():
    for orientations in (FOUR, None):
        space = LayoutSpace(3, 4, orientations)
        axes = space.axes(space.sample(np.random.default_rng(0), 20))
        np.testing.assert_array_equal(space.axes(space.members(axes)), axes)
    axes = np.radians([[[135.0, -90.0, 180.0]]])
    places = LayoutSpace(1, 3, FOUR).members(axes)
    np.testing.assert_array_equal(places, [[0.0, 3.0, 1.0]])
    angles = LayoutSpace(1, 3, None).members(axes)[0, [0, 2]]
    np.testing.assert_allclose(angles, [-math.pi / 4, 0.0], atol=1e-12)


@pytest.mark.parametrize(("rows", "count"), [(2, 16), (4, 256), (5, 20)])
def test_neighbours_differ_in_one_column(rows, count):
    """All arrangements of it, or single modules where these are too many."""
    space = LayoutSpace(rows, 3, FOUR)
    member = space.sample(np.random.default_rng(2), 1)[0]
    around = space.neighbours(member, 1).reshape(count, rows, 3)
    differs = around != member.reshape(rows, 3)
    assert not differs[:, :, [0, 2]].any()
    if rows < 5:
        assert len(np.unique(around, axis=0)) == 4**rows
    else:
        assert (differs.sum(axis=(1, 2)) <= 1).all()


def test_an_effort_that_is_none_is_refused():
    for name, value in (("members", 4), ("generations", 0), ("epochs", -1), ("rounds", 1.5)):
        with pytest.raises(ValueError, match=name):
            Effort(**{name: value})
