"""One policy shared by all parcels of a stream: its network, its actions, and the policy itself.

Each parcel, and the one that waits at the gate, decides by its own row of the observation.
"""

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import PyTorchObs
from torch.distributions import Categorical

from surface_gym.config import EnvConfig
from surface_gym.flow.task import PRESENT, WAITS, StreamActions

from .base import SIDE, BatchController, mirrored_orientations
from .library import PolicyCard


def mirrored_rows(rows: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return rows of parcels (..., features) with the asked side mirrored to y > 0."""
    seen = rows.copy()
    seen[..., SIDE] = np.abs(rows[..., SIDE])
    return seen


def parcel_spaces(config: EnvConfig) -> tuple[spaces.Box, spaces.MultiDiscrete]:
    """Build a parcel's observation space and its action space.

    An action has three choices: the axes ahead, the axes behind, and the opening of the gate.
    """
    kind = config.action_kind
    assert isinstance(kind, StreamActions)
    return config.row_space(), spaces.MultiDiscrete([kind.choices, kind.choices, kind.gates])


class ParcelActions:
    """Conversion between the parcels' mirrored choices and actions of the stream's environment."""

    def __init__(self, config: EnvConfig) -> None:
        self._image = mirrored_orientations(config.chosen_orientations)

    def to_env(self, rows: NDArray[np.float32], choices: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert choices (num_envs, rows, 3) to actions (num_envs, 2 max_parcels + 1).

        Args:
            rows: observations (num_envs, rows, features), not mirrored.
        """
        axes = self._mirror(rows, choices[:, :-1, :2])
        return np.concatenate([axes.reshape(len(choices), -1), choices[:, -1:, 2]], axis=1)

    def to_parcels(
        self, rows: NDArray[np.float32], actions: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        num_envs, count, _ = rows.shape
        choices = np.zeros((num_envs, count, 3), dtype=np.int64)
        axes = actions[:, :-1].reshape(num_envs, count - 1, 2)
        choices[:, :-1, :2] = self._mirror(rows, axes)
        choices[:, -1, 2] = actions[:, -1]
        return choices

    def _mirror(self, rows: NDArray[np.float32], axes: NDArray[np.int64]) -> NDArray[np.int64]:
        mirrored = (rows[:, :-1, SIDE] < 0.0)[..., np.newaxis]
        return np.where(mirrored, self._image[axes], axes)


class ParcelNetwork(ActorCriticPolicy):
    """Stable-Baselines3's actor and critic of a parcel, with a mask on its three choices.

    A parcel on the line chooses its axes, one at the gate the opening of the gate. The other
    choices are drawn evenly and teach nothing.
    """

    def distributions(self, obs: torch.Tensor) -> list[Categorical]:
        """Compute each choice's distribution for observations (parcels, features)."""
        policy, _ = self._latents(obs)
        return self._masked(obs, self.action_net(policy))

    def _masked(self, obs: torch.Tensor, logits: torch.Tensor) -> list[Any]:
        present = obs[:, PRESENT : PRESENT + 1]
        waits = obs[:, WAITS : WAITS + 1]
        space: Any = self.action_space
        masks = [present - waits, present - waits, present * waits]
        return [
            Categorical(logits=part * mask, validate_args=False)
            for part, mask in zip(
                torch.split(logits, space.nvec.tolist(), dim=1), masks, strict=True
            )
        ]

    def _latents(self, obs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        features = self.extract_features(obs, self.features_extractor)
        policy, value = self.mlp_extractor(features)
        return policy, value

    def forward(
        self, obs: torch.Tensor, deterministic: bool = False
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        policy, value = self._latents(obs)
        parts = self._masked(obs, self.action_net(policy))
        actions = _choose(parts, deterministic)
        return actions, self.value_net(value), _log_prob(parts, actions)

    def evaluate_actions(
        self, obs: PyTorchObs, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        assert isinstance(obs, torch.Tensor)
        policy, value = self._latents(obs)
        parts = self._masked(obs, self.action_net(policy))
        entropy = torch.stack([part.entropy() for part in parts], dim=1).sum(dim=1)
        return self.value_net(value), _log_prob(parts, actions), entropy

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> torch.Tensor:
        assert isinstance(observation, torch.Tensor)
        return _choose(self.distributions(observation), deterministic)


def _choose(parts: list[Any], deterministic: bool) -> torch.Tensor:
    """Return the likeliest choices (parcels, choices), or draw them."""
    chosen = [part.probs.argmax(dim=1) if deterministic else part.sample() for part in parts]
    return torch.stack(chosen, dim=1)


def _log_prob(parts: list[Any], actions: torch.Tensor) -> torch.Tensor:
    each = [part.log_prob(actions[:, k].long()) for k, part in enumerate(parts)]
    return torch.stack(each, dim=1).sum(dim=1)


def make_parcel_network(card: PolicyCard) -> ParcelNetwork:
    """Build the network of a card, its weights not set."""
    space = parcel_spaces(EnvConfig("flow", **card.env_kwargs))
    return ParcelNetwork(*space, lambda _: 0.0, net_arch=list(card.hidden))


class ParcelPolicy(BatchController):
    """A policy of parcels with shared weights."""

    _dims = 2

    def __init__(self, network: ParcelNetwork, card: PolicyCard) -> None:
        torch.set_num_threads(1)  # the network is small: more threads only wait for each other
        self._network = network
        self._network.set_training_mode(False)
        self._actions = ParcelActions(EnvConfig("flow", **card.env_kwargs))
        self.card = card
        self.env_id = card.env_id
        self.env_kwargs = card.env_kwargs

    def _predict(self, batch: Any, *_: Any, deterministic: bool) -> tuple[Any, None]:
        present = batch[..., PRESENT] > 0.5
        choices = np.zeros((*present.shape, 3), dtype=np.int64)
        if present.any():
            choices[present], _ = self._network.predict(
                mirrored_rows(batch[present]), deterministic=deterministic
            )
        return self._actions.to_env(batch, choices), None
