from surface_gym.paper.comparison import Cell, Found, SlowingLayout, Table


def cell(paper, *ours, **options):
    """A cell of the S-box, with ours one an integration."""
    return Cell("r", "c", "S", paper, tuple(Found(value, 0.0) for value in ours), **options)


def test_numbers_agree_as_the_paper_prints_them():
    compared = cell(0.23, 0.2265, 0.184, decimals=2)

    assert compared.agrees(0)
    assert not compared.agrees(1)


def test_numbers_agree_within_the_tolerance():
    compared = cell(-0.515, -0.525, -0.526, decimals=3, tolerance=0.01)

    assert compared.agrees(0)
    assert not compared.agrees(1)


def test_a_failure_agrees_with_a_failure_only():
    compared = cell(None, None, 7)

    assert compared.agrees(0)
    assert not compared.agrees(1)


def test_layouts_agree_in_columns_and_axes():
    compared = cell(SlowingLayout(2, 45), SlowingLayout(2, 45), SlowingLayout(2, 0))

    assert compared.agrees(0)
    assert not compared.agrees(1)


def test_a_table_counts_its_cells():
    table = Table("key", "title", "rule", (cell(3, 3, 3), cell(3, 3, 4), cell(3, 4, 4)))

    assert table.agreeing(0) == 2
    assert table.agreeing(1) == 1


def test_a_table_gives_the_range_of_the_runs_that_tip():
    def of(size, share):
        return Cell("r", "c", size, 0.0, (Found(0.0, share),))

    table = Table("key", "title", "rule", (of("S", 0.3), of("S", 0.1), of("S", None), of("B", 0.0)))

    assert table.tipping(0) == {"S": (0.1, 0.3), "B": (0.0, 0.0)}
