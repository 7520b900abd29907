"""The single environment."""

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from surface_gym.lanes.memory import OUTCOMES, RUNNING, SUCCESS
from surface_gym.settings import ORIENTATIONS, Settings
from surface_gym.tasks.task import Task, check_options


class SmartSurfaceEnv(gym.Env[Any, Any]):
    """A smart surface under a parcel."""

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": 25}

    def __init__(
        self,
        task: str | Task = "sort",
        actions: str = "modules",
        control_period: float = 0.04,
        zone: tuple[int, int] | None = None,
        orientations: tuple[float, ...] = ORIENTATIONS,
        render_mode: str | None = None,
    ) -> None:
        self.settings = Settings(task, actions, control_period, zone, orientations)
        self.render_mode = render_mode
        self.observation_space = self.settings.observation_space()
        self.action_space = self.settings.action_space()
        self._task = self.settings.chosen_task
        self._kind = self.settings.action_kind
        self._batch = self.settings.make_batch(1)
        self._started = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        options = check_options(options, self._task.options)
        super().reset(seed=seed)
        self._batch.place(0, self._task.start(self.np_random, options))
        self._started = True
        return self._batch.lanes.observation[0].copy(), self._info()

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        if not self._started:
            raise gym.error.ResetNeeded("Call reset before step.")
        lanes = self._batch.lanes
        if lanes.outcome[0] != RUNNING:
            raise gym.error.ResetNeeded("The episode has ended: call reset before the next step.")
        self._batch.advance(self._kind.commands(np.asarray(action)[np.newaxis], 1))
        return (
            lanes.observation[0].copy(),
            float(lanes.terms[0].sum()),
            bool(lanes.outcome[0] != RUNNING),
            False,
            self._info(),
        )

    def _info(self) -> dict[str, Any]:
        lanes = self._batch.lanes
        outcome = int(lanes.outcome[0])
        return {
            "is_success": outcome == SUCCESS,
            "outcome": OUTCOMES[outcome],
            "time": float(lanes.clock[0]),
            "pose": lanes.truth[0, :3].copy(),
            "velocity": lanes.truth[0, 3:].copy(),
            "reward_terms": dict(zip(self._task.terms, lanes.terms[0].tolist(), strict=True)),
        }
