"""What vector environments of every device have in common: their arguments, checked."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.faces.single import RENDER_FPS, checked_mode
from surface_gym.physics.types import Integers
from surface_gym.tasks.base import check_options

Booleans = NDArray[np.bool_]


class Asked(NamedTuple):
    """What a reset is called with."""

    mask: Booleans  # (lanes,) which begin
    lanes: Integers  # (count,) the same by their numbers
    seeds: list[int | None]  # of all lanes
    options: list[dict[str, Any]]  # of those that begin; none at all: none has any


class LanesEnv(gym.vector.VectorEnv[Any, Any, Any]):
    """Takes the arguments of a vector environment, and those of its resets.

    Args:
        num_envs: number of lanes.
        autoreset_mode: as in Gymnasium: NEXT_STEP, SAME_STEP or DISABLED.
        max_episode_steps: control periods after which a lane is truncated; None for no limit.
        render_mode: "rgb_array" or None.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": RENDER_FPS}

    def __init__(
        self,
        num_envs: int,
        autoreset_mode: AutoresetMode | str,
        max_episode_steps: int | None,
        render_mode: str | None,
    ) -> None:
        self.num_envs = checks.integer("num_envs", num_envs, least=1)
        if max_episode_steps is not None:
            checks.integer("max_episode_steps", max_episode_steps, least=1)
        modes = [mode.value for mode in AutoresetMode]
        if not isinstance(autoreset_mode, AutoresetMode):
            checks.one_of("autoreset_mode", autoreset_mode, modes)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**type(self).metadata, "autoreset_mode": self.autoreset_mode}
        self.render_mode = checked_mode(render_mode, type(self).metadata["render_modes"])
        self._limit = np.iinfo(np.int64).max if max_episode_steps is None else max_episode_steps
        self._started = False

    def _show(self, observations: gym.Space[Any], actions: gym.Space[Any]) -> None:
        """Take the spaces of one lane."""
        self.single_observation_space = observations
        self.single_action_space = actions
        self.observation_space = batch_space(observations, self.num_envs)
        self.action_space = batch_space(actions, self.num_envs)

    def _asked(
        self,
        seed: int | Sequence[int | None] | None,
        options: dict[str, Any] | Sequence[dict[str, Any] | None] | None,
        allowed: tuple[str, ...],
    ) -> Asked:
        """What a reset is called with, or an error that names what is not `allowed`."""
        mask = np.ones(self.num_envs, dtype=np.bool_)
        if isinstance(options, dict) and "reset_mask" in options:
            mask = self._checked_mask(options["reset_mask"])
            options = {name: value for name, value in options.items() if name != "reset_mask"}
        elif not self._started and seed is None:
            seed = int(np_random()[0].integers(2**31))
        if not self._started and not mask.all():
            raise gym.error.ResetNeeded(
                "The first reset must be of every lane, without reset_mask."
            )
        seeds = self._seed_of_each(seed)
        given = self._options_of_each(options, allowed)
        lanes = np.nonzero(mask)[0]
        some = [given[lane] for lane in lanes.tolist()] if any(given) else []
        return Asked(mask, lanes, seeds, some)

    def _seed_of_each(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, (int, np.integer)):
            return [int(seed) + lane for lane in range(self.num_envs)]
        if not isinstance(seed, (Sequence, np.ndarray)) or len(seed) != self.num_envs:
            raise ValueError(f"seed must be one number or {self.num_envs} of them, got {seed!r}")
        return list(seed)

    def _options_of_each(
        self,
        options: dict[str, Any] | Sequence[dict[str, Any] | None] | None,
        allowed: tuple[str, ...],
    ) -> list[dict[str, Any]]:
        if options is None or isinstance(options, dict):
            return [check_options(options, allowed)] * self.num_envs
        if not isinstance(options, Sequence) or len(options) != self.num_envs:
            raise ValueError(
                f"options must be a dict or {self.num_envs} of dict or None, got {options!r}"
            )
        return [check_options(choice, allowed) for choice in options]

    def _checked_mask(self, mask: Any) -> Booleans:
        if not (
            isinstance(mask, np.ndarray)
            and mask.dtype == np.bool_
            and mask.shape == (self.num_envs,)
            and mask.any()
        ):
            raise ValueError(
                f"reset_mask must be a boolean array of shape ({self.num_envs},) "
                f"with a True in it, got {mask!r}"
            )
        return mask
