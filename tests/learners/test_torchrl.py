"""TorchRL on the native vector env: it is fed what that env shows and pays, and learns."""

from pathlib import Path

import gymnasium as gym
import pytest
from gymnasium.vector import AutoresetMode

import surface_gym as sg
from tests.learners.runs import check_sort, run

pytest.importorskip("torchrl")


def test_it_learns(tmp_path: Path) -> None:
    check_sort(run("torchrl_sort", 106_496, tmp_path), "torchrl", "tensordict")


def test_a_rollout_is_that_of_single_environments() -> None:
    from torchrl.envs import GymWrapper

    mode = AutoresetMode.DISABLED
    envs = gym.make_vec("SmartSurface/Sort-v0", 4, actions="halves", autoreset_mode=mode)
    env = GymWrapper(envs, categorical_action_encoding=True)
    env.set_seed(0)
    rollout = env.rollout(150, break_when_any_done=False)
    assert int(rollout["next", "done"].sum()) > 8
    for i, way in enumerate(rollout):
        single = sg.SmartSurfaceEnv("sort", actions="halves")
        single.reset(seed=i)  # set_seed resets too
        seen, _ = single.reset()
        for step in way:
            assert step["observation"].tolist() == seen.tolist()
            seen, reward, terminated, *_ = single.step(int(step["action"]))
            assert step["next", "observation"].tolist() == seen.tolist()
            assert step["next", "reward"].item() == pytest.approx(reward)
            assert bool(step["next", "terminated"]) == terminated
            if bool(step["next", "done"]):
                seen, _ = single.reset()
