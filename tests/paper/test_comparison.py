from surface_gym.paper.comparison import Cell, SlowingLayout, Table


def test_numbers_agree_as_the_paper_prints_them():
    cell = Cell("r", "c", paper=0.23, paper_step=0.2265, converged=0.184, decimals=2)

    assert cell.paper_step_agrees
    assert not cell.converged_agrees


def test_numbers_agree_within_the_tolerance():
    cell = Cell("r", "c", -0.515, paper_step=-0.525, converged=-0.526, decimals=3, tolerance=0.01)

    assert cell.paper_step_agrees
    assert not cell.converged_agrees


def test_a_failure_agrees_with_a_failure_only():
    cell = Cell("r", "c", paper=None, paper_step=None, converged=7)

    assert cell.paper_step_agrees
    assert not cell.converged_agrees


def test_layouts_agree_in_columns_and_axes():
    cell = Cell("r", "c", SlowingLayout(2, 45), SlowingLayout(2, 45), SlowingLayout(2, 0))

    assert cell.paper_step_agrees
    assert not cell.converged_agrees


def test_a_table_counts_its_cells():
    cells = (Cell("r", "c", 3, 3, 3), Cell("r", "c", 3, 3, 4), Cell("r", "c", 3, 4, 4))
    table = Table("key", "title", "rule", cells)

    assert table.paper_step_agreeing == 2
    assert table.converged_agreeing == 1
