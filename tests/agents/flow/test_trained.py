"""What the policies of a flow's run come to, on one small stream."""

from pathlib import Path
from shutil import copytree
from typing import Any

import pytest
import yaml
from rich.console import Console

from agents.evaluation.command import EvaluateConfig, evaluate
from agents.flow import capacity, contenders, results, study, tables, trained
from agents.flow.cases import Case
from agents.flow.contenders import RESERVATION
from agents.learning import finish, flow_card
from agents.learning.config import ParcelsConfig
from agents.learning.legs import Learned
from agents.library import SHELF

SHIPPED = SHELF / "flow-ppo"


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    def one(condition: str = "exact") -> list[Case]:
        return [Case("S", 2.0, condition)]

    for module in (study, results, tables, flow_card):
        monkeypatch.setattr(module, "cases", one)
    monkeypatch.setattr(tables, "CURVE", Case("S", 2.0))
    monkeypatch.setattr(capacity, "REPLICATIONS", 2)
    monkeypatch.setattr(capacity, "WARM_UP", 4.0)
    monkeypatch.setattr(contenders, "SECONDS", 12.0)


def run_of(tmp_path: Path, seeds: tuple[int, ...] = (0, 1)) -> Path:
    run = tmp_path / "run"
    for seed in seeds:
        copytree(SHIPPED / f"seed-{seed}", run / f"seed-{seed}")
    return run


def test_every_seed_is_measured_beside_the_reservation(tmp_path: Path) -> None:
    run = run_of(tmp_path)
    found = trained.compare_parcels(run, 1, Console(quiet=True))
    assert set(found.names) == {RESERVATION, "seed 0", "seed 1"}
    case = Case("S", 2.0)
    for name in found.names:
        assert found.rate(name, case) > 0.7 * found.rate(results.BOUND, case)
    assert "seed 1" in (run / trained.TABLE).read_text()


def test_a_run_ends_with_a_card(tmp_path: Path) -> None:
    run = run_of(tmp_path)
    learned = [Learned(steps=100, seconds=1.0, interrupted=False)] * 2
    finish.finish(ParcelsConfig(seeds=2), run, learned, Console(quiet=True), 1)
    card = yaml.safe_load((run / "card.yaml").read_text())
    assert card["command"].startswith("python train.py --task flow")
    assert card["seeds"] == [0, 1]
    for condition in ("exact", "camera"):
        (stream,) = card["results"][condition].values()
        assert len(stream["capacity_of_each_seed"]) == 2
        assert min(stream["right_at_80_percent"]) > 0.99


def test_the_comparison_takes_a_run_of_a_flow(tmp_path: Path) -> None:
    run = run_of(tmp_path, (2,))
    evaluate(EvaluateConfig(run=run, workers=1), Console(quiet=True))
    assert (run / trained.TABLE).is_file()


@pytest.mark.parametrize("text", ["", "[1", "env_id: SmartSurface/Sort-v0", "- a"])
def test_what_is_of_no_flow(tmp_path: Path, text: str) -> None:
    (tmp_path / "policy.yaml").write_text(text)
    assert not trained.is_of_flow(tmp_path)
    empty: Any = tmp_path / "empty"
    empty.mkdir()
    assert not trained.is_of_flow(empty)
