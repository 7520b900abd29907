"""Films of material flow, and the card of a run on a slope."""

import imageio.v2 as imageio
import pytest
from rich.console import Console

from surface_gym import agents
from surface_gym.agents.evaluation import material_flow as mf, material_flow_report as report
from surface_gym.agents.library import SHELF, read_files


def test_methods_are_filmed_side_by_side(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(report, "LENGTH", 0.2)
    monkeypatch.setattr(report, "SHOWN_AT", 0.08)
    (picture, drawn), (video, filmed) = report.film("merge", "lab", tmp_path)
    assert imageio.imread(picture).std() > 10.0
    with imageio.get_reader(video) as frames:
        assert frames.count_frames() >= 5
    assert drawn.startswith(report.AGENTS)
    assert "time slots" in filmed


@pytest.mark.parametrize("task", ["merge", "sequence"])
def test_a_card_has_each_seed_beside_the_rules(task, tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(mf, "SECONDS", 6.0)
    monkeypatch.setattr(mf, "REPLICATIONS", 2)
    name = f"{task}-parcels"
    files = {k: read_files(SHELF / name / f"seed-{k}") for k in agents.seeds(name)[:2]}
    card = report.compare_run(task, files, tmp_path, 1, Console(quiet=True))
    assert set(card) == set(mf.COMPARED)
    for scenarios in card.values():
        for each in scenarios.values():
            assert len(each["right_an_hour_of_each_seed"]) == 2
            assert mf.ROLL_ON.name not in each["rules"]
            assert each["rules"]
    assert (tmp_path / "table.md").read_text().count("PPO per parcel") == 6
