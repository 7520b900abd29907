"""Goal environments, as Gymnasium-Robotics and hindsight experience replay (HER) expect them."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from surface_gym import checks
from surface_gym.physics.types import Array
from surface_gym.tasks.base import Task

GoalObservation = dict[str, Any]


class GoalEnv(gym.Wrapper[GoalObservation, Any, Any, Any], gym.utils.RecordConstructorArgs):
    """A wrapper that returns a sparse reward, and a Dict of observation, achieved and desired goal.

    It serves the tasks that name the features of their goal in `goal_features`: Stop and Park. The
    observation has only the other features, so that it does not depend on the goal. The task's
    method `achieved` returns the achieved goal, as sensed; `asked` returns the desired goal. The
    reward is 1 if the achieved goal meets the desired goal, else 0: see `compute_reward`. With
    exact sensors, the reward is 1 exactly when the episode succeeds.

    Training can replace the desired goal, since an episode that ends elsewhere is a success for
    another goal. Stable-Baselines3's `HerReplayBuffer` does so, e.g. in
    `examples/learners/her_park.py`.

        >>> import gymnasium as gym, surface_gym
        >>> from surface_gym.goal_env import GoalEnv
        >>> env = GoalEnv(gym.make("SmartSurface/Park-v0", actions="halves"))
        >>> observation, info = env.reset(seed=0)
        >>> sorted(observation), observation["desired_goal"].shape
        (['achieved_goal', 'desired_goal', 'observation'], (4,))

    Args:
        env: environment of a task with `goal_features`, from `gymnasium.make` or from a call of
            the environment's class.

    Raises:
        ValueError: the task has no `goal_features`.
    """

    def __init__(self, env: gym.Env[Any, Any]) -> None:
        gym.utils.RecordConstructorArgs.__init__(self)
        gym.Wrapper.__init__(self, env)
        config = env.get_wrapper_attr("config")
        self._task: Task = config.task
        if not self._task.goal_features:
            raise ValueError(
                f"env must have a task with goal_features, got the task {config.task_name!r}"
            )
        space = checks.instance("observation_space", env.observation_space, spaces.Box, "a Box")
        hidden = [config.columns[name].place for name in self._task.goal_features]
        self._shown = np.delete(np.arange(space.shape[0]), hidden)
        self._batch = env.get_wrapper_attr("batch")
        size = len(self._task.asked(self._batch.view(0)))
        goals = spaces.Box(-np.inf, np.inf, (size,), np.float64)
        self.observation_space = spaces.Dict(
            observation=spaces.Box(space.low[self._shown], space.high[self._shown]),
            achieved_goal=goals,
            desired_goal=goals,
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[GoalObservation, dict[str, Any]]:
        """Begin an episode with the `reset` of the wrapped environment."""
        observation, info = self.env.reset(seed=seed, options=options)
        return self._observe(observation), info

    def step(self, action: Any) -> tuple[GoalObservation, float, bool, bool, dict[str, Any]]:
        """Step by one control period, and return the sparse reward instead of the task's reward."""
        observation, _, terminated, truncated, info = self.env.step(action)
        seen = self._observe(observation)
        reward = self.compute_reward(seen["achieved_goal"], seen["desired_goal"], info)
        return seen, float(reward), terminated, truncated, info

    def compute_reward(self, achieved_goal: Array, desired_goal: Array, info: Any) -> Any:
        """Return rewards (...). A fulfilled goal (..., quantities) gives 1, other goals give 0."""
        del info
        return self._task.reached(achieved_goal, desired_goal).astype(np.float64)

    def _observe(self, observation: Any) -> GoalObservation:
        state = self._batch.view(0)
        return {
            "observation": observation[self._shown],
            "achieved_goal": np.array(self._task.achieved(state), dtype=np.float64),
            "desired_goal": np.array(self._task.asked(state), dtype=np.float64),
        }
