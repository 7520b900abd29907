"""Views of the table of results: tables, their numbers, and their look at any width."""

import io
import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from matplotlib.figure import Figure
from rich.console import Console

from surface_gym.agents.evaluation import pictures, streams as ladder, views
from surface_gym.agents.evaluation.method import PLANNER, stream_benchmark
from surface_gym.agents.evaluation.results import Results, interval
from surface_gym.agents.evaluation.scenario import FACTORS, LAB, SHAPES, STARTS, TRAINED
from surface_gym.agents.evaluation.streams import UNSEEN
from surface_gym.agents.evaluation.tables import Table
from tests.agents.evaluation import made

SLOW = made.results(
    made.slow_rows("fixed layout", [0.1, 0.004, 0.02, 0.2], kind="baseline"),
    made.slow_rows("fixed layout", [0.1, 0.1, 0.02, 0.2], preset="camera", kind="baseline"),
    made.slow_rows("a <rule>", [0.001, 0.004, 0.002, 0.02]),
    made.slow_rows("a <rule>", [0.001, 0.04, 0.002, 0.02], preset="camera"),
    made.slow_rows("planner", [0.0, 0.001], kind=PLANNER),
)
SORT = made.results(
    made.sort_rows("fixed layout", {"S": 0.72, "B": 1.0}),
    made.sort_rows("b", {"S": 0.36, "B": 0.52}),
)
SQUARE = FACTORS["square"]
SWEPT = made.results(
    *made.whole_sweep("slow", {"fixed layout": 0.25, "PPO": 0.5, "PPO, lab": 1.0}, seeds=2),
    *made.whole_sweep("track", {"PPO": 0.75}),
    made.sweep_rows("slow", PLANNER, TRAINED, 1.0, starts=6),
    made.sweep_rows("slow", PLANNER, "square", 1.0, levels=SQUARE.shown, starts=6),
)
SWEEP = views.Sweep("slow", SWEPT)
FLOW = made.results(*made.capacity_rows())
MERGED = ("merge", "three lines", "exact")
UNKNOWN = ("flow", stream_benchmark("flow").held_out[0].scenario, UNSEEN)


def merged(one: list[float], other: list[float]) -> Results:
    return made.results(
        made.stream_rows((*MERGED, "one"), one), made.stream_rows((*MERGED, "other"), other),
        made.stream_rows((*MERGED, "planner"), [1000.0] * 3, kind=PLANNER),
    )  # fmt: skip


def unknown(rule: list[float], *agents: list[float], touches: float = 0.0) -> Results:
    return made.results(
        made.stream_rows((*UNKNOWN, ladder.SCHEDULER), rule),
        *(
            made.stream_rows((*UNKNOWN, "agent"), each, k, touches_per_1000=touches)
            for k, each in enumerate(agents)
        ),
    )


ONE = merged([1.0, 2.0, 3.0], [0.9, 1.89, 2.91])
TABLES: dict[str, Callable[[], list[Table]]] = {
    "task": lambda: [*views.task_tables("slow", SLOW), *views.speed_tables("sort", SORT)],
    "sweep": lambda: views.sweep_tables("slow", SWEPT),
    "capacity": lambda: views.stream_tables("flow", FLOW),
    "offers": lambda: views.stream_tables("merge", ONE),
    "unseen": lambda: views.unseen_tables("flow", unknown([20, 22, 24], [21, 23, 25])),
}


@pytest.mark.parametrize("make", TABLES.values(), ids=TABLES)
def test_no_width_loses_a_cell(make) -> None:
    """The commands, `train.py` as well, print no other tables."""
    for table, width in itertools.product(make(), range(60, 161)):
        screen = io.StringIO()
        table.show(Console(file=screen, width=width))
        text = screen.getvalue()
        assert max(map(len, text.splitlines())) <= width
        words = text.replace("\n", " ")
        for row in table.rows:
            for cell in row:
                assert " ".join(cell.strip("*").split()) in " ".join(words.split()), cell
        for head in table.header:
            assert all(word in words for word in head.split())


def test_a_row_for_each_method() -> None:
    (table,) = views.task_tables("slow", SLOW)
    assert table.header[:4] == ("controller", "seeds", "success (95 % interval)", "camera")
    fixed, rule, planner = table.rows
    assert fixed[0] == "fixed layout"
    assert fixed[2].startswith("0.250 (")
    assert rule[3:5] == ("0.500", "0.0030")  # the median's
    assert (planner[0], planner[3]) == ("planner (2 starts)", "-")


def test_by_speed() -> None:
    (table,) = views.speed_tables("sort", SORT)
    rows = {row[0]: row[1:] for row in table.rows}
    assert rows["0.5"] == ("fails", "2.000", "fails", "fails")
    assert rows["2.7"][0] == f"{1 / 2.7:.3f}"
    assert rows["minimum [m/s]"] == ("0.72", "0.36", "1.00", "0.52")


class TestSweep:
    def test_the_level_that_is_as_trained_is_the_same_for_every_factor(self) -> None:
        sample = SWEEP.find("PPO", "load", 1)
        assert sample is not None
        assert sample.success.shape == (2, made.COUNT)
        assert sample.interval == interval(sample.success)
        trained = SWEEP.rate("PPO", TRAINED, TRAINED)
        for factor in FACTORS.values():
            if factor.trained is not None:
                assert SWEEP.rate("PPO", factor.name, factor.trained) == trained
        assert SWEEP.rate("nobody", TRAINED, TRAINED) is None
        assert views.Sweep("track", SWEPT).rate("PPO", "zone", 8) is None

    def test_a_row_for_each_method_and_a_column_for_each_factor(self) -> None:
        (table,) = views.factor_tables("slow", SWEPT)
        assert [row[0] for row in table.rows] == ["fixed layout", "PPO", "PPO, lab", PLANNER]
        squares = "square: 0.15 / 0.2 / 0.3 / 0.35 / 0.4 / 0.5 m"
        assert table.header[1:3] == ("as trained", squares)
        fixed = dict(zip(table.header, table.rows[0], strict=True))
        assert (fixed["as trained"], fixed["stuck modules: 2 / 10 %"]) == ("0.25", "0.25 / 0.12")
        assert table.rows[-1][-1] == "-"
        assert "24 starts (planner: 6)" in table.caption
        (track,) = views.factor_tables("track", SWEPT)
        assert not any("zone" in name for name in track.header)

    def test_squares_beside_the_planners(self) -> None:
        rows = {row[0]: row[1:] for row in views.square_tables("slow", SWEPT)[0].rows}
        assert (rows["PPO, lab"][0], rows[PLANNER][2]) == ("0.50 at 0.49", "1.00")
        shares = []
        for level in SQUARE.shown:
            own, best = (SWEEP.find(name, "square", level) for name in ("PPO", PLANNER))
            assert own is not None
            assert best is not None
            assert best.success.shape == (1, 6)
            shares.append(own.success[:, :6].mean() / best.rate)
        assert rows["PPO"][2] == f"{min(shares):.2f}"
        assert views.square_tables("track", SWEPT)[0].rows[0][-1] == "-"

    def test_the_lab_by_shape(self) -> None:
        shapes = np.array([SHAPES[k % 3] for k in range(made.COUNT)])  # no polygon was drawn
        sample, found = SWEEP.find("PPO", LAB, LAB), SWEEP.by_shape("PPO")
        assert sample is not None
        success = sample.success
        assert set(found) == set(shapes)
        for shape, some in found.items():
            assert some.mean() == success[:, shapes == shape].mean()
        (table,) = views.shape_tables("slow", SWEPT)
        assert table.header[2:] == SHAPES
        assert table.rows[0][-1] == "-"
        assert PLANNER not in [row[0] for row in table.rows]


class TestCapacities:
    FOUND = views.list_capacities("flow", FLOW)[0]

    @staticmethod
    def with_rates(*correct: list[float], offered: float = 3000.0) -> views.Capacities:
        """Of methods "0", "1" and so on, by deliveries in each replication."""
        name = stream_benchmark("flow").offers[0].scenario
        rows = [
            made.stream_rows(
                ("flow", name, "exact", str(k)), each, offered=offered if k else 3000.0,
                actuators=55, modules=4, columns=1, best=math.nan,
            )
            for k, each in enumerate(correct)
        ]  # fmt: skip
        return views.list_capacities("flow", made.results(*rows))[0]

    def test_replications_are_compared_in_pairs(self) -> None:
        """The same parcels make both fast or slow: so a small difference shows."""
        found = self.with_rates([10, 20, 30], [11, 21, 32])
        offer = found.offers[0]
        mean, margin = found.difference("1", "0", offer) or (0.0, 0.0)
        assert (mean, margin) == (pytest.approx(400.0 / 3.0), pytest.approx(143.4, abs=0.1))
        assert found.leader(offer) is None
        ahead = self.with_rates([10, 20, 30], [12, 22, 32])
        assert ahead.leader(offer) == "1"
        # Offered something else, they are not.
        apart = self.with_rates([10, 20, 30], [12, 22, 32], offered=2000.0)
        assert apart.difference("1", "0", offer) == (
            pytest.approx(200.0),
            pytest.approx(3513.0, abs=1.0),
        )
        assert apart.difference("1", "nobody", offer) is None

    def test_the_ladder(self) -> None:
        (table,) = views.ladder_tables(self.FOUND)
        rows = {row[0]: row[1:] for row in table.rows}
        best = views.BEST.format(ladder.MODULES)
        assert list(rows) == [*made.SHARES, best, views.ENTRANCE]
        assert rows[ladder.ARRANGED] == ("-", *["cannot"] * 6, "-", "-")
        assert rows[ladder.SERIES][:2] == ("8", "0")
        # 180 parcels/h either way, ten times: 2.262 * 189.7 / sqrt(10)
        assert (rows[ladder.COLUMNS][0], rows[ladder.COLUMNS][5]) == ("55", "5760 ±136")
        assert rows[ladder.COLUMNS][-1] == "2.0"  # 8 of modules, 4 of which turn together
        # As good as another: nothing is bold.
        assert rows[ladder.MODULES][1:7] == rows[ladder.EVENT][1:7]
        assert rows[best][5] == "9632"
        assert rows[views.ENTRANCE][1:7] == ("13333", "20000", "26667", "9730", "14595", "19459")
        assert "cannot; zones in series: 7, 7, 7, 7, 7, 7." in table.caption
        shares = {name: share for name, share in made.SHARES.items() if name != ladder.EVENT}
        results = made.results(*made.capacity_rows(shares))
        (table,) = views.ladder_tables(views.list_capacities("flow", results)[1])
        assert dict(zip(table.header, table.rows[3], strict=True))["S, 1 m/s"] == "**7920 ±136**"

    def test_steps_of_the_ladder(self) -> None:
        rows = {row[0]: row[1:] for row in views.step_tables(self.FOUND)[0].rows}
        step = f"{ladder.MODULES} over {ladder.COLUMNS}"
        assert (list(rows), rows[step][0]) == ([step], "+2520 ±192 (+46.7 %)")


@pytest.mark.parametrize(("other", "bold"), [([0.9, 1.89, 2.91], True), ([0.9, 2.6, 2.4], False)])
def test_only_one_that_is_ahead_of_all_others_is_bold(other, bold) -> None:
    """But for the planner, which is not compared."""
    (table,) = views.stream_tables("merge", merged([1.0, 2.0, 3.0], other))
    assert [cells[3].startswith("**") for cells in table.rows] == [bold, False, False]
    assert table.rows[0][:3] == ("three lines", "exact", "one")
    assert table.header[-2:] == ("jams", "full belt")


class TestUnseen:
    def test_rates_are_compared_in_pairs(self) -> None:
        results = unknown([20, 22, 24], *([21, 23, 25 - k] for k in range(2)), touches=45.0)
        ((_, one, _, two, touches, ratio, ahead, entrance),) = views.unseen_tables("flow", results)[
            0
        ].rows
        assert (one.split()[0], entrance) == ("2200", "4000")
        # Each delivers one more in each replication, but for one.
        assert two.split()[0] == "2283"
        assert ratio.strip("*").split()[0] == "1.038"
        assert (touches, ahead) == ("45.0", "1 of 2")

    @pytest.mark.parametrize(
        ("correct", "bold"), [([21, 23, 25], True), ([23, 19, 24], False), ([18, 20, 22], True)]
    )
    def test_only_what_is_apart_is_bold(self, correct, bold) -> None:
        (table,) = views.unseen_tables("flow", unknown([20, 22, 24], correct))
        assert table.rows[0][5].startswith("**") is bold


def test_every_plot_is_drawn(tmp_path, monkeypatch) -> None:
    saved: list[int] = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *_, **__: saved.append(len(self.axes)))
    pictures.draw_capacities(TestCapacities.FOUND, tmp_path / "a.png")
    pictures.draw_sweep(["slow", "track"], SWEPT, tmp_path / "a.png")
    assert saved == [1, 2 * (len(FACTORS) - 1)]
    assert SLOW.methods("slow", STARTS) == ["fixed layout", "a <rule>", "planner"]
