"""The learning curve: means over the latest episodes, and what a broken run left of it."""

import math
from pathlib import Path
from typing import Any

from agents.learning.curve import FILE, RECENT_EPISODES, Curve, read_curve


def episode(success: bool, gained: float) -> dict[str, Any]:
    return {
        "is_success": success,
        "episode": {"r": gained, "l": 10, "t": 0.4},
        "reward_terms": {"success": 2.0 * success, "reach": gained + 1.0},
    }


def test_a_row_holds_means_of_the_latest_episodes(tmp_path: Path) -> None:
    curve = Curve(tmp_path, ("success", "reach"), 0, [])
    assert math.isnan(curve.success)
    curve.take([{}, episode(True, 2.0), {}, episode(False, 4.0)])
    curve.write(64)
    curve.take([episode(True, 1.0)] * RECENT_EPISODES)  # which push the first two out
    curve.write(128)
    curve.close()
    first, second = read_curve(tmp_path)
    assert first == {
        "steps": 64, "success": 0.5, "return": 3.0, "length": 10, "reward_success": 1.0,
        "reward_reach": 4.0,
    }  # fmt: skip
    assert second["success"] == second["return"] == 1.0
    assert list((tmp_path / "tensorboard").glob("events.*"))


def test_rows_after_the_checkpoint_are_dropped(tmp_path: Path) -> None:
    curve = Curve(tmp_path, ("success", "reach"), 0, [])
    curve.take([episode(True, 1.0)])
    for steps in (10, 20, 30):
        curve.write(steps)
    curve.close()
    with (tmp_path / FILE).open("a") as file:
        file.write("40,1")  # a line broken off
    assert [row["steps"] for row in read_curve(tmp_path)] == [10, 20, 30]
    again = Curve(tmp_path, ("success", "reach"), 20, list(curve.recent))
    assert [row["steps"] for row in read_curve(tmp_path)] == [10, 20]
    assert again.success == 1.0
    again.close()


def test_no_curve_yet(tmp_path: Path) -> None:
    assert read_curve(tmp_path) == []
