"""Practice on a device: mirrored as elsewhere, its episodes summed up as elsewhere."""

from collections import Counter
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch

from agents.learning.curve import read_curve
from agents.learning.device.lanes import Practice
from agents.learning.device.mirror import TensorMirror
from agents.learning.device.totals import TotalsCurve
from agents.mirror import ActionMirror
from agents.vec_env import SurfaceVecEnv
from surface_gym import SmartSurfaceVectorEnv
from surface_gym.settings import Settings

from .lanes_on_cpu import LanesOnCpu


@pytest.mark.parametrize("actions", ["halves", "quadrants", "window", "modules"])
def test_actions_are_mirrored_as_on_the_cpu(actions: str) -> None:
    settings = Settings(actions=actions)
    rng = np.random.default_rng(0)
    shape = (300, *settings.action_space().shape)
    given = rng.integers(len(settings.chosen_orientations), size=shape)
    side = rng.integers(-1, 2, size=300).astype(np.float32)
    expected = ActionMirror(settings.action_kind, settings.chosen_orientations)(given, side)
    mirror = TensorMirror(settings, torch.device("cpu"))
    found = mirror(torch.from_numpy(given), torch.from_numpy(side))
    np.testing.assert_array_equal(found.numpy(), expected)
    assert (expected != given).any()


def test_episodes_are_summed_up_as_they_are_told_one_by_one() -> None:
    """Stop's actions are not mirrored: both kinds of lanes may be given the same."""

    def lanes() -> SmartSurfaceVectorEnv:
        mode = gym.vector.AutoresetMode.SAME_STEP
        return SmartSurfaceVectorEnv(
            12, "stop", "halves", max_episode_steps=40, autoreset_mode=mode
        )

    practice, others = Practice(LanesOnCpu(lanes())), SurfaceVecEnv(lanes())
    practice.reset(3)
    others.seed(3)
    others.reset()
    rng = np.random.default_rng(0)
    expected: Counter[str] = Counter()
    for period in range(150):
        actions = rng.integers(others.action_space.n, size=12)
        moved = practice.step(torch.from_numpy(actions))
        observations, rewards, ended, infos = others.step(actions)
        last = np.asarray(observations).copy()
        for lane in np.nonzero(ended)[0]:
            info = infos[lane]
            last[lane] = info["terminal_observation"]
            assert moved.terminated[lane] == (not info["TimeLimit.truncated"])
            expected["episodes"] += 1
            expected["success"] += info["is_success"]
            expected["return"] += info["episode"]["r"]
            expected["length"] += info["episode"]["l"]
            expected.update({f"reward_{k}": paid for k, paid in info["reward_terms"].items()})
        np.testing.assert_array_equal(moved.observations, observations)
        np.testing.assert_array_equal(moved.last, last)
        np.testing.assert_array_equal(moved.ended, ended)
        np.testing.assert_allclose(moved.rewards, rewards, rtol=1e-6)
        if period == 100:  # fetched between, nothing is lost
            first = practice.totals.fetch()
    second = practice.totals.fetch()
    assert expected["episodes"] > 36
    for name, total in expected.items():
        assert first[name] + second[name] == pytest.approx(total, rel=1e-9), name
    assert not any(practice.totals.fetch().values())


def totals(episodes: int, successes: int) -> dict[str, float]:
    """Of episodes that each return 2 and last 10 periods."""
    return {
        "episodes": episodes, "success": successes, "return": 2.0 * episodes,
        "length": 10.0 * episodes, "reward_reach": 3.0 * episodes,
    }  # fmt: skip


def test_a_row_holds_means_over_the_latest_rollouts_of_a_thousand_episodes(tmp_path: Path) -> None:
    curve = TotalsCurve(tmp_path, ("reach",), 8, 0, [])
    curve.take_totals(totals(0, 0))  # a rollout in which none ended
    assert np.isnan(curve.success)
    curve.take_totals(totals(300, 0))
    curve.take_totals(totals(600, 300))
    curve.write(100)
    curve.take_totals(totals(500, 500))  # 600 and 500 are enough
    curve.write(200)
    curve.close()
    first, second = read_curve(tmp_path)
    assert first == {
        "steps": 100, "success": pytest.approx(1 / 3), "return": 2.0, "length": 10.0,
        "reward_reach": 3.0,
    }  # fmt: skip
    assert second["success"] == pytest.approx(800 / 1100)
    again = TotalsCurve(tmp_path, ("reach",), 8, 200, list(curve.recent))
    assert again.success == curve.success
    again.close()


def test_a_row_holds_an_episode_of_every_lane(tmp_path: Path) -> None:
    curve = TotalsCurve(tmp_path, ("reach",), 3000, 0, [])
    for _ in range(3):
        curve.take_totals(totals(1500, 0))
    curve.take_totals(totals(1500, 1500))
    assert curve.success == 0.5
    curve.close()
