"""What the sweep leaves: tables that agree with each other, and the picture."""

import csv
import io
import json
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from agents.evaluation import command
from agents.evaluation.command import EvaluateConfig, evaluate
from agents.evaluation.contenders import PLANNER, rules
from agents.evaluation.robustness.factors import FACTORS, LAB, TRAINED
from agents.evaluation.robustness.picture import LOOKS, draw_sweep, look_of
from agents.evaluation.robustness.report import PICTURE, write_sweep
from agents.evaluation.robustness.results import SHAPES, Sweep, lab_shapes, shape_of
from agents.evaluation.robustness.sweep import FILE
from agents.evaluation.robustness.tables import factor_table, shape_table, square_table
from agents.evaluation.statistics import interval
from surface_gym.parcel import Disc, Rectangle
from tests.agents.evaluation.robustness.cells import STARTS, swept_cell, swept_cells

SQUARE = FACTORS["square"]
CELLS = [
    *swept_cells("slow", {"fixed layout": 0.25, "PPO": 0.5, "PPO, lab": 1.0}, seeds=2),
    *swept_cells("track", {"PPO": 0.75}),
    swept_cell("slow", PLANNER, FACTORS[TRAINED], 1.0, starts=6),
    swept_cell("slow", PLANNER, SQUARE, 1.0, levels=SQUARE.told, starts=6),
]
SWEEP = Sweep(tuple(CELLS))


def test_rates_have_the_interval_of_their_seeds_and_starts() -> None:
    success = SWEEP.success("slow", "PPO", "load", 1)
    assert success is not None
    assert success.shape == (2, STARTS)
    rate = SWEEP.rate("slow", "PPO", "load", 1)
    assert rate is not None
    assert (rate.value, rate.low, rate.high) == (success.mean(), *interval(success))


def test_the_level_that_is_as_trained_is_the_same_for_every_factor() -> None:
    trained = SWEEP.rate("slow", "PPO", TRAINED, TRAINED)
    for factor in FACTORS.values():
        if factor.trained is not None:
            assert SWEEP.rate("slow", "PPO", factor.name, factor.trained) == trained
    assert SWEEP.rate("slow", "nobody", TRAINED, TRAINED) is None
    assert SWEEP.rate("track", "PPO", "zone", 8) is None


def test_a_row_a_contender_and_a_column_a_factor() -> None:
    table = factor_table(SWEEP, "slow")
    assert [row[0] for row in table.rows] == ["fixed layout", "PPO", "PPO, lab", PLANNER]
    assert table.header[1:3] == ("as trained", "square: 0.15 / 0.2 / 0.3 / 0.35 / 0.4 / 0.5 m")
    fixed = dict(zip(table.header, table.rows[0], strict=True))
    assert fixed["as trained"] == "0.25"
    assert fixed["stuck modules: 2 / 10 %"] == "0.25 / 0.12"
    assert table.rows[-1][-1] == "-"
    assert "24 starts (planner: 6)" in table.told
    assert not any("zone" in name for name in factor_table(SWEEP, "track").header)


def test_squares_beside_the_planners() -> None:
    rows = {row[0]: row[1:] for row in square_table(SWEEP, "slow").rows}
    assert rows["PPO, lab"][0] == "0.50 at 0.49"
    assert rows[PLANNER][2] == "1.00"
    shares = []
    for level in SQUARE.told:
        own, best = (SWEEP.success("slow", who, "square", level) for who in ("PPO", PLANNER))
        assert own is not None
        assert best is not None
        assert best.shape == (1, 6)
        shares.append(own[:, :6].mean() / best.mean())
    least = min(shares)
    assert rows["PPO"][2] == f"{least:.2f}"
    assert square_table(SWEEP, "track").rows[0][-1] == "-"


def test_the_lab_by_shape() -> None:
    shapes = lab_shapes("slow", STARTS)
    success = SWEEP.success("slow", "PPO", LAB, LAB)
    assert success is not None
    found = SWEEP.by_shape("slow", "PPO")
    assert set(found) == set(shapes)
    for shape, rate in found.items():
        assert rate.value == success[:, np.array(shapes) == shape].mean()
    table = shape_table(SWEEP, "slow")
    assert table.header[2:] == SHAPES
    assert PLANNER not in [row[0] for row in table.rows]


def test_shapes_have_names() -> None:
    assert shape_of(Rectangle(0.2, 0.2)) == "square"
    assert shape_of(Rectangle(0.2, 0.3)) == "rectangle"
    assert shape_of(Disc(0.2)) == "disc"
    assert set(lab_shapes("sort", 64)) == set(SHAPES)


def test_files_agree(tmp_path: Path) -> None:
    write_sweep(CELLS, tmp_path, Console(file=io.StringIO(), width=160))
    numbers = json.loads((tmp_path / "robustness.json").read_text())
    with (tmp_path / "robustness.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["success"] for line in lines] == [str(number["success"]) for number in numbers]
    squares = {
        number["level"]: number["success"]
        for number in numbers
        if (number["task"], number["controller"], number["factor"]) == ("slow", "PPO", "square")
    }
    assert list(squares) == list(SQUARE.levels)
    text = (tmp_path / "robustness.md").read_text()
    assert "## Slow: lab" in text
    assert "## Track: squares" in text
    assert (tmp_path / PICTURE).read_bytes().startswith(b"\x89PNG")


def test_the_picture_is_the_same_each_time(tmp_path: Path) -> None:
    small = Sweep(tuple(cell for cell in CELLS if cell.task == "track"))
    for name in ("a.png", "b.png"):
        draw_sweep(small, tmp_path / name)
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_an_agent_of_the_lab_has_its_algorithms_colour() -> None:
    nominal, lab = look_of("PPO"), look_of("PPO, lab")
    assert nominal.colour == lab.colour
    assert lab.width > nominal.width
    assert lab.label == "PPO, trained for the lab"
    assert look_of("all at 45").label == "all at 45"
    others = [look.colour for look in LOOKS.values()]
    assert len(set(others)) == 8  # rules of a task share one


def test_the_command_sweeps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fixed = rules("slow")[:1]
    monkeypatch.setattr(command, "contenders", lambda _: fixed)
    lines = [json.dumps(cell.plain()) + "\n" for cell in swept_cells("slow", {"fixed layout": 0.5})]
    (tmp_path / FILE).write_text("".join(lines))
    screen = io.StringIO()
    config = EvaluateConfig(
        out=tmp_path, tasks=("slow",), workers=1, resume=True, robustness=True, starts=STARTS
    )
    evaluate(config, Console(file=screen, width=160))
    assert "fixed layout" in screen.getvalue()
    assert (tmp_path / "robustness.csv").is_file()
    assert not (tmp_path / "comparison.md").exists()


def test_what_it_cannot_sweep() -> None:
    with pytest.raises(ValueError, match=r"^starts must be .* at least 1, got 0"):
        EvaluateConfig(starts=0)
    with pytest.raises(ValueError, match=r"^run must be None where robustness is swept, got runs"):
        EvaluateConfig(robustness=True, run=Path("runs/a"))
