"""A policy of one of Stable-Baselines3's networks."""

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.dqn.policies import DQNPolicy

from surface_gym.settings import Settings
from surface_gym.tasks import TASKS, Sort

from ..mirror import SIDE, ActionMirror
from ..policy_card import PolicyCard
from .categorical import EqualChoicesPolicy

NETWORKS = {"ppo": EqualChoicesPolicy, "dqn": DQNPolicy}


def make_network(card: PolicyCard, settings: Settings) -> BasePolicy:
    """The network of a card for an environment, its weights not set."""
    return NETWORKS[card.algo](
        settings.observation_space(),
        settings.action_space(),
        lambda _: 0.0,
        net_arch=list(card.hidden),
    )


class Policy:
    """A trained policy. `predict` takes and gives what the environment does.

    Attributes:
        env_id: the environment it was trained on.
        env_kwargs: that environment's arguments.
    """

    def __init__(self, network: BasePolicy, card: PolicyCard, settings: Settings) -> None:
        torch.set_num_threads(1)  # the network is small: more threads only wait for each other
        self._network = network
        self._network.set_training_mode(False)
        # Sort shows its parcel in a mirror where it is to go to y < 0.
        self._mirror = (
            ActionMirror(settings.action_kind, settings.chosen_orientations)
            if isinstance(settings.task, Sort)
            else None
        )
        self.card = card
        self.env_id = card.env_id
        own = {} if card.task in TASKS else {"task": settings.task}
        self.env_kwargs = {**own, **card.env_kwargs}

    def predict(
        self,
        observation: NDArray[np.float32],
        state: None = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, None]:
        """Action for an observation (features,), or actions for (lanes, features); and no state."""
        del state, episode_start  # it has no memory
        single = observation.ndim == 1
        observations = observation[np.newaxis] if single else observation
        actions, _ = self._network.predict(observations, deterministic=deterministic)
        if self._mirror is not None:
            actions = self._mirror(actions, observations[:, SIDE])
        return (actions[0] if single else actions), None
