"""Goal environments: checkers, goals, and a reward that is the environment's own success."""

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from surface_gym.goal_env import GoalEnv
from surface_gym.tasks import Park, Stop

STOP, PARK = "SmartSurface/Stop-v0", "SmartSurface/Park-v0"
both = pytest.mark.parametrize("env_id", [STOP, PARK])
BRAKE = 0  # the action "halves" with every axis at 0 deg
ROLL = 15


def goals(env_id: str) -> GoalEnv:
    return GoalEnv(gym.make(env_id, actions="halves"))


def braked(env: GoalEnv, goal: dict[str, float]):
    """Steps of a parcel that rolls for six periods, and then brakes to rest."""
    seen, _ = env.reset(seed=3, options={"speed": 1.3, "parcel": "S", **goal})
    steps, over = [(seen, 0.0, {"outcome": "running"})], False
    while not over:
        action = ROLL if len(steps) < 7 else BRAKE
        seen, reward, terminated, truncated, info = env.step(action)
        steps.append((seen, reward, info))
        over = terminated or truncated
    return steps


@both
@pytest.mark.filterwarnings("ignore:.*(infinity|unwrapped version):UserWarning")
def test_checkers_have_nothing_to_say(env_id):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = goals(env_id)
    check_env(env, skip_render_check=True)
    checker.check_env(env)


@pytest.mark.parametrize(
    ("env_id", "missed"),
    [(STOP, {"position": 1.0}), (PARK, {"ahead": 0.6, "aside": 0.01, "angle": 0.05})],
)
def test_the_goal_that_was_reached_is_a_success_of_the_same_episode(env_id, missed):
    """As HER relabels it; the environment itself says so when it is asked for that goal."""
    env = goals(env_id)
    steps = braked(env, missed)
    assert steps[-1][2]["outcome"] == "missed"
    assert not any(reward for _, reward, _ in steps)
    x, *rest = steps[-1][0]["achieved_goal"][:-1].tolist()
    reached = {"position": x} if env_id == STOP else {
        "ahead": x - 0.4, "aside": rest[0] - 0.8, "angle": rest[1]
    }  # fmt: skip
    asked = np.array([*steps[-1][0]["achieved_goal"][:-1], 0.0])
    again = braked(env, reached)
    assert [reward for _, reward, _ in again[:-1]] == [0.0] * (len(again) - 1)
    assert (again[-1][1], again[-1][2]["outcome"]) == (1.0, "success")
    np.testing.assert_allclose(again[-1][0]["desired_goal"], asked, atol=1e-9)
    # Another goal does not change the observation; `compute_reward` returns the steps' rewards.
    for (seen, _, _), (other, _, _) in zip(steps, again, strict=True):
        np.testing.assert_array_equal(seen["observation"], other["observation"])
    achieved = np.array([seen["achieved_goal"] for seen, _, _ in steps])
    rewards = env.compute_reward(achieved, np.tile(asked, (len(steps), 1)), [{}] * len(steps))
    np.testing.assert_array_equal(rewards, [reward for _, reward, _ in again])


@pytest.mark.parametrize(
    ("task", "tolerances"),
    [(Stop(), (0.005, 1e-3)), (Park(), (0.005, 0.005, np.radians(2.0), 1e-3))],
)
def test_reached_is_within_each_tolerance(task, tolerances):
    asked = np.linspace(0.3, 0.9, len(tolerances))
    asked[-1] = 0.0
    assert task.reached(asked, asked)
    for k, tolerance in enumerate(tolerances):
        for share, wanted in ((0.99, True), (1.01, False)):
            off = np.zeros(len(tolerances))
            off[k] = share * tolerance
            assert task.reached(asked + off, asked) == wanted
    if len(tolerances) == 4:  # the distance counts, not x and y alone
        assert not task.reached(asked + np.array([0.004, 0.004, 0.0, 0.0]), asked)


@pytest.mark.usefixtures("uncompiled")
def test_a_task_without_goal_features_is_named():
    with pytest.raises(
        ValueError, match=r"env must have a task with goal_features, got .*'orient'"
    ):
        goals("SmartSurface/Orient-v0")
