"""Actor and critic of a seat, of whose three choices only those count that the parcel has."""

import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.type_aliases import PyTorchObs
from torch.distributions import Categorical

from surface_gym.flow.features import PRESENT, WAITS

GATE = 2  # place of the gate among the choices


class SeatPolicy(ActorCriticPolicy):
    """Stable-Baselines3's actor and critic. A parcel on the line chooses for its halves, one at the
    gate when it opens: the other choices are drawn evenly and teach nothing.
    """

    def choices(self, obs: torch.Tensor) -> list[Categorical]:
        """Each choice's own distribution for observations (seats, features)."""
        policy, _ = self._latents(obs)
        return self._masked(obs, self.action_net(policy))

    def _masked(self, obs: torch.Tensor, logits: torch.Tensor) -> list[Categorical]:
        present = obs[:, PRESENT : PRESENT + 1]
        waits = obs[:, WAITS : WAITS + 1]
        sizes = self.action_space.nvec.tolist()  # type: ignore[attr-defined]
        counts = [present - waits, present - waits, present * waits]
        return [
            Categorical(logits=part * count, validate_args=False)
            for part, count in zip(torch.split(logits, sizes, dim=1), counts, strict=True)
        ]

    def _latents(self, obs: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        features = self.extract_features(obs, self.features_extractor)
        policy, value = self.mlp_extractor(features)
        return policy, value

    def forward(
        self, obs: torch.Tensor, deterministic: bool = False
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Actions, values and log probabilities."""
        policy, value = self._latents(obs)
        parts = self._masked(obs, self.action_net(policy))
        actions = _chosen(parts, deterministic)
        return actions, self.value_net(value), _log_prob(parts, actions)

    def evaluate_actions(
        self, obs: PyTorchObs, actions: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Values, log probabilities and entropies."""
        assert isinstance(obs, torch.Tensor)
        policy, value = self._latents(obs)
        parts = self._masked(obs, self.action_net(policy))
        each = [part.entropy() for part in parts]  # type: ignore[no-untyped-call]
        entropy = torch.stack(each, dim=1).sum(dim=1)
        return self.value_net(value), _log_prob(parts, actions), entropy

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> torch.Tensor:
        assert isinstance(observation, torch.Tensor)
        return _chosen(self.choices(observation), deterministic)


def _chosen(parts: list[Categorical], deterministic: bool) -> torch.Tensor:
    """(seats, choices) the likeliest, or drawn."""
    if deterministic:
        return torch.stack([part.probs.argmax(dim=1) for part in parts], dim=1)
    drawn = [part.sample() for part in parts]  # type: ignore[no-untyped-call]
    return torch.stack(drawn, dim=1)


def _log_prob(parts: list[Categorical], actions: torch.Tensor) -> torch.Tensor:
    each = [
        part.log_prob(actions[:, k].long())  # type: ignore[no-untyped-call]
        for k, part in enumerate(parts)
    ]
    return torch.stack(each, dim=1).sum(dim=1)
