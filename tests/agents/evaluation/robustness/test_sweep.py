"""The sweep: the same cells whatever the processes, and none computed twice."""

from dataclasses import replace
from pathlib import Path

import pytest

from agents.evaluation.contenders import PLANNER, contenders, rules
from agents.evaluation.robustness import sweep
from agents.evaluation.robustness.factors import FACTORS, TRAINED
from agents.evaluation.robustness.sweep import (
    FILE,
    LEFT_OUT,
    PLANNED,
    compute_sweep,
    levels_for,
    starts_for,
    sweep_jobs,
    swept,
)
from agents.evaluation.work import compute_kept
from surface_gym.tasks import TASKS

FIXED = rules("slow")[0]


@pytest.fixture
def two_factors(monkeypatch: pytest.MonkeyPatch) -> None:
    few = {
        TRAINED: FACTORS[TRAINED],
        "square": replace(FACTORS["square"], levels=(0.2, 0.4), told=(0.4,)),
    }
    monkeypatch.setattr(sweep, "FACTORS", few)


@pytest.mark.usefixtures("two_factors")
def test_what_is_there_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cells = compute_sweep([FIXED], 1, tmp_path, starts=6)
    assert [(cell.factor, cell.levels) for cell in cells] == [
        (TRAINED, [TRAINED]),
        ("square", [0.2, 0.4]),
    ]
    assert all(len(row) == cell.starts == 6 for cell in cells for row in cell.success)
    monkeypatch.setattr(sweep, "run_episodes", None)  # nothing is left to compute
    assert compute_sweep([FIXED], 1, tmp_path, starts=6) == cells
    assert len((tmp_path / FILE).read_text().splitlines()) == 2


@pytest.mark.usefixtures("two_factors")
def test_other_starts_make_other_cells() -> None:
    assert not sweep_jobs([FIXED], 6).keys() & sweep_jobs([FIXED], 7).keys()


def test_processes_make_no_difference(tmp_path: Path) -> None:
    few = [each for each in rules("stop") if each.name == "fixed layout"]
    factors = ("trained", "aside")
    alone = [sweep.compute_swept(few[0], 0, name, FACTORS[name].swept, 4) for name in factors]
    jobs = {key: job for key, job in sweep_jobs(few, 4).items() if key[2] in factors}
    shared = compute_kept(jobs, sweep.SweptCell, 2, tmp_path / FILE, lambda *_: None)
    assert list(shared.values()) == alone


def test_the_planner_knows_the_truth() -> None:
    """By what is observed it takes squares of 0.5 m, partly on supports, to brake as boxes do."""
    planner = contenders("stop")[-1]
    assert planner.name == PLANNER
    cell = sweep.compute_swept(planner, 0, "square", (0.5,), 3)
    assert cell.success == ["111"]
    assert cell.error[0] < 1e-3  # [m]


@pytest.mark.parametrize("task", TASKS)
def test_who_runs_on_any_parcel(task: str) -> None:
    chosen = swept(contenders(task))
    names = [each.name for each in chosen]
    assert not set(names) & set(LEFT_OUT)
    assert {"fixed layout", "PPO", "DQN", PLANNER} <= set(names)
    for who in chosen:
        tried = {name for name, factor in FACTORS.items() if levels_for(who, factor)}
        wanted = set(FACTORS) - ({"zone"} if task == "track" else set())
        assert tried == (set(PLANNED) if who.name == PLANNER else wanted)


def test_who_thinks_long_is_tried_on_fewer() -> None:
    planner = contenders("slow")[-1]
    assert starts_for(planner, 240) == 40
    assert starts_for(planner, 5) == 1
    assert starts_for(FIXED, 240) == 240
    first = next(iter(sweep_jobs([FIXED, planner], 240)))
    assert first[1] == PLANNER
