"""The vector face of a batch: many lanes as a Gymnasium vector environment."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.faces.batch import Acts, Driven
from surface_gym.faces.lanes import Booleans, LanesEnv
from surface_gym.state import OUT_OF_TIME, RUNNING

Observations = NDArray[np.float32]


class BatchVectorEnv(LanesEnv):
    """Drives all lanes of a batch; subclasses make the batch, say what `info` tells and what is
    drawn. Arguments are those of `LanesEnv`.
    """

    def __init__(
        self,
        num_envs: int,
        autoreset_mode: AutoresetMode | str,
        max_episode_steps: int | None,
        render_mode: str | None,
    ) -> None:
        super().__init__(num_envs, autoreset_mode, max_episode_steps, render_mode)
        self._steps_left = np.zeros(self.num_envs, dtype=np.int64)
        self._all = np.ones(self.num_envs, dtype=np.bool_)

    def _drive(
        self, batch: Driven, kind: Acts, observations: gym.Space[Any], actions: gym.Space[Any]
    ) -> None:
        """Take the batch, and the spaces of one lane."""
        self._driven = batch
        self._actions = kind
        self._show(observations, actions)

    def _threads(self, threads: int) -> int:
        """Those asked for, no more than there are lanes."""
        return min(self.num_envs, checks.integer("threads", threads, least=1))

    @abstractmethod
    def _infos(self, mask: Booleans) -> dict[str, Any]:
        """Infos of the lanes in the mask, as Gymnasium lays them out: arrays and their masks."""

    @abstractmethod
    def _record(self, lane: int, begins: bool) -> None:
        """Keep what a picture shows of a lane's past, as an episode begins or goes on."""

    @abstractmethod
    def _picture(self) -> NDArray[np.uint8]:
        """The picture (height, width, 3) of all lanes."""

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | Sequence[dict[str, Any] | None] | None = None,
    ) -> tuple[Observations, dict[str, Any]]:
        asked = self._asked(seed, options, self._driven.options)
        if asked.options:  # a bad option of one lane leaves all as they were
            self._driven.check(asked.options)
        for lane in asked.lanes.tolist():
            if asked.seeds[lane] is not None or not self._driven.is_seeded(lane):
                self._driven.seed(lane, np_random(asked.seeds[lane])[0])
        self._driven.start(asked.lanes, asked.options)
        self._count_from(asked.lanes)
        self._started = True
        return self._driven.observation.copy(), self._infos(asked.mask)

    def step(
        self, actions: Any
    ) -> tuple[Observations, NDArray[np.float64], Booleans, Booleans, dict[str, Any]]:
        if not self._started:
            raise gym.error.ResetNeeded("Call reset before step.")
        batch = self._driven
        ended = batch.outcome != RUNNING
        if self.autoreset_mode == AutoresetMode.DISABLED and ended.any():
            raise gym.error.ResetNeeded(
                f"Lanes {np.nonzero(ended)[0].tolist()} have ended: reset them with reset_mask."
            )
        anew = np.nonzero(ended)[0]  # NEXT_STEP: this step is their reset
        batch.advance(self._actions.commands(actions, self.num_envs), anew)
        self._steps_left -= 1
        self._follow(~ended)
        self._count_from(anew)
        outcome = batch.outcome
        outcome[(self._steps_left <= 0) & (outcome == RUNNING)] = OUT_OF_TIME
        truncated = (outcome == OUT_OF_TIME) | (self._steps_left <= 0)
        rewards = batch.reward.copy()
        terminated = outcome > OUT_OF_TIME
        infos: dict[str, Any] = {}
        over = truncated | terminated
        if self.autoreset_mode == AutoresetMode.SAME_STEP and over.any():
            chosen = np.nonzero(over)[0]
            final = np.full(self.num_envs, None, dtype=object)
            # An array a lane: the rows, not their numbers, are the objects.
            final[chosen] = np.frompyfunc(batch.observation[chosen].__getitem__, 1, 1)(
                np.arange(len(chosen))
            )
            infos = {
                "final_obs": final,
                "_final_obs": over.copy(),
                "final_info": self._infos(over),
                "_final_info": over.copy(),
            }
            batch.start(chosen)
            self._count_from(chosen)
        infos.update(self._infos(self._all))
        return batch.observation.copy(), rewards, terminated, truncated, infos

    def _count_from(self, chosen: NDArray[np.int64]) -> None:
        """Episodes have begun on the chosen lanes (count,)."""
        self._steps_left[chosen] = self._limit
        if self.render_mode is not None:
            for lane in chosen.tolist():
                self._record(lane, begins=True)

    def _follow(self, mask: Booleans) -> None:
        """Keep what is drawn of the lanes in the mask up to date."""
        if self.render_mode is not None:
            for lane in np.nonzero(mask)[0].tolist():
                self._record(lane, begins=False)

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One picture (height, width, 3) of all lanes, tiled; None without a render mode."""
        if self.render_mode is None:
            return None
        if not self._started:
            raise gym.error.ResetNeeded("Call reset before render.")
        return (self._picture(),)


def with_masks(values: dict[str, Any], mask: Booleans) -> dict[str, Any]:
    """Arrays by name, and beside each whose they are, as Gymnasium has it."""
    return {**values, **{f"_{name}": mask.copy() for name in values}}
