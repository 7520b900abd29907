"""The single face of a batch: one lane as a Gymnasium environment."""

from abc import abstractmethod
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.faces.batch import Acts, Driven
from surface_gym.state import OUT_OF_TIME, RUNNING
from surface_gym.tasks.base import check_options

RENDER_FPS = 25  # pictures a second at the default control period of 40 ms: real time


class BatchEnv(gym.Env[Any, Any]):
    """Drives the only lane of a batch; subclasses say what `info` tells and what is drawn."""

    metadata = {"render_modes": ["rgb_array", "human"], "render_fps": RENDER_FPS}

    def __init__(self, batch: Driven, kind: Acts, render_mode: str | None) -> None:
        self.render_mode = checked_mode(render_mode, self.metadata["render_modes"])
        self._driven = batch
        self._actions = kind
        self._lane = np.zeros(1, dtype=np.int64)
        self._started = False
        self._window: Any = None

    @abstractmethod
    def _info(self) -> dict[str, Any]:
        """What is told of the episode."""

    @abstractmethod
    def _record(self, begins: bool) -> None:
        """Keep what a picture shows of the past, as an episode begins or goes on."""

    @abstractmethod
    def _picture(self) -> NDArray[np.uint8]:
        """The picture (height, width, 3) of now."""

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        batch = self._driven
        options = check_options(options, batch.options)
        if options:
            batch.check([options])
        super().reset(seed=seed)
        batch.seed(0, self.np_random)
        batch.start(self._lane, [options] if options else ())
        self._started = True
        self._follow(begins=True)
        return batch.observation[0].copy(), self._info()

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        batch = self._driven
        if not self._started:
            raise gym.error.ResetNeeded("Call reset before step.")
        if batch.outcome[0] != RUNNING:
            raise gym.error.ResetNeeded("The episode has ended: call reset before the next step.")
        batch.advance(self._actions.commands([action], 1))
        self._follow(begins=False)
        outcome = batch.outcome[0]
        return (
            batch.observation[0].copy(),
            float(batch.reward[0]),
            bool(outcome > OUT_OF_TIME),
            bool(outcome == OUT_OF_TIME),
            self._info(),
        )

    def render(self) -> NDArray[np.uint8] | None:
        """The picture (height, width, 3) in "rgb_array" mode; None in "human" mode, and without."""
        if self.render_mode != "rgb_array":
            return None
        if not self._started:
            raise gym.error.ResetNeeded("Call reset before render.")
        return self._picture()

    def close(self) -> None:
        if self._window is not None:
            self._window.close()
            self._window = None

    def _follow(self, begins: bool) -> None:
        """Keep what is drawn up to date."""
        if self.render_mode is None:
            return
        self._record(begins)
        if self.render_mode == "human":
            from surface_gym.rendering import Window

            if self._window is None:
                self._window = Window(frame_rate=RENDER_FPS)
            self._window.show(self._picture())


def checked_mode(render_mode: str | None, modes: list[str]) -> str | None:
    """A render mode, or an error that names those there are."""
    checks.one_of("render_mode", render_mode, (None, *modes))
    return render_mode
