from surface_gym.paper.comparison import SlowingLayout
from surface_gym.paper.targets import SIZES, load_targets


def test_the_tables_are_whole():
    targets = load_targets()

    assert len(targets.sorting_runs) == 5
    for size in SIZES:
        assert len(targets.sorting_columns[size]) == len(targets.sorting_speeds) == 20
        assert len(targets.slowing_layouts[size]) == len(targets.slowing_speeds) == 19


def test_entries_stand_where_the_paper_prints_them():
    targets = load_targets()

    assert targets.sorting_columns["B"][targets.sorting_speeds.index(1.0)] is None
    assert targets.sorting_columns["S"][targets.sorting_speeds.index(2.7)] == 8
    assert targets.slowing_layouts["B"][targets.slowing_speeds.index(2.6)] == SlowingLayout(5, 0)
    assert targets.slowing_ratios["S"] == {0: 0.23, 45: 0.53}
    assert [run.side for run in targets.sorting_runs] == [1, -1, -1, -1, -1]
