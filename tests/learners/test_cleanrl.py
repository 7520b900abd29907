"""PPO in one file: it learns, and its measure is the environment's."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import surface_gym as sg
from tests.learners.runs import EXAMPLES, check_sort, run


@pytest.fixture
def fresh_starts(monkeypatch: pytest.MonkeyPatch) -> Any:
    monkeypatch.syspath_prepend(EXAMPLES)
    import fresh_starts

    return fresh_starts


def test_it_learns(tmp_path: Path) -> None:
    check_sort(run("cleanrl_sort", 106_496, tmp_path), "gymnasium", "torch")


def test_success_is_that_of_single_episodes(fresh_starts: Any) -> None:
    """Axes at -45 deg everywhere sort whoever is to leave to y > 0, if quick enough."""
    num_envs = 40
    shares = fresh_starts.success(lambda seen: np.full(len(seen), 10), num_envs)
    for name, task in fresh_starts.STARTS.items():
        env = sg.SmartSurfaceEnv(task, actions="halves")
        won: dict[str, list[bool]] = {"S": [], "B": []}
        for i in range(num_envs):
            seen, _ = env.reset(seed=1_000_000 + i)
            ended = False
            while not ended:
                _, _, ended, _, info = env.step(10)
            won["S" if seen[fresh_starts.SIZE] < 0.0 else "B"].append(info["is_success"])
        assert 0 < sum(won["S"]) < len(won["S"])
        won["both"] = won["S"] + won["B"]
        assert shares[name] == {
            box: pytest.approx(np.mean(each), abs=5e-4) for box, each in won.items()
        }


def test_speeds_are_even_or_as_they_come(fresh_starts: Any) -> None:
    slow = {}
    for name, task in fresh_starts.STARTS.items():
        env = sg.SmartSurfaceVectorEnv(2000, task, actions="halves")
        _, info = env.reset(seed=0)
        slow[name] = float((info["velocity"][:, 0] < 1.1).mean())
    assert slow["as they come"] == pytest.approx(0.5 + 0.5 / 3, abs=0.03)
    assert slow["0.3 to 2.7 m/s evenly"] == pytest.approx(1 / 3, abs=0.03)
