"""Sharing the work: the same cells whatever the processes, and none computed twice."""

from dataclasses import replace
from pathlib import Path

import pytest

from agents.evaluation import cell as cell_module
from agents.evaluation.cell import Cell
from agents.evaluation.contenders import Contender, contenders, only, rules
from agents.evaluation.work import FILE, compute_cells, orders, read_cells
from surface_gym.tasks import TASKS


def few() -> list[Contender]:
    return [replace(only(contender, ("exact", "stuck")), starts=6) for contender in rules("slow")]


def apart_from_time(cells: list[Cell]) -> list[Cell]:
    return [replace(cell, decision_time=0.0) for cell in cells]


def test_processes_make_no_difference(tmp_path: Path) -> None:
    alone = compute_cells(few(), 1)
    shared = compute_cells(few(), 2, tmp_path)
    assert apart_from_time(alone) == apart_from_time(shared)
    names = ("fixed layout", "best fixed layout", "braking rule")
    assert [cell.contender for cell in alone] == [name for name in names for _ in range(2)]
    assert [cell.condition for cell in alone] == ["exact", "stuck"] * 3


def test_what_is_there_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = compute_cells(few()[:1], 1, tmp_path)
    with (tmp_path / FILE).open("a") as file:
        file.write('{"task": "slow", "contender"')  # a line broken off
    assert read_cells(tmp_path) == first
    seen: list[tuple[int, int]] = []
    again = compute_cells(few(), 1, tmp_path, lambda done, total, _: seen.append((done, total)))
    assert again[:2] == first
    assert seen == [(3, 6), (4, 6), (5, 6), (6, 6)]
    monkeypatch.setattr(cell_module, "run_episodes", None)  # nothing is left to compute
    assert compute_cells(few(), 1, tmp_path) == again


@pytest.mark.parametrize("task", TASKS)
def test_who_is_compared(task: str) -> None:
    everyone = contenders(task)
    names = [contender.name for contender in everyone]
    assert names[:2] == ["fixed layout", "best fixed layout"]
    assert names[-1] == "planner"
    assert {"PPO", "DQN"} < set(names)
    assert len(set(names)) == len(names)
    assert all(len(c.seeds) >= 3 for c in everyone if c.name in ("PPO", "DQN"))
    planned = [condition for who, _, condition in orders(everyone) if who.name == "planner"]
    assert planned == ["exact"]
    searching = [who.starts is not None for who, _, _ in orders(everyone)]
    assert searching == sorted(searching, reverse=True)  # the slowest first
