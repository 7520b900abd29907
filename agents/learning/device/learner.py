"""PPO on tensors that stay on the lanes' device.

Schulman et al., Proximal policy optimization algorithms, 2017; the clipped objective, Eq. (7).
Losses, network and optimiser are those of Stable-Baselines3's PPO.
"""

from dataclasses import dataclass, fields
from typing import Any

import torch
from torch.nn.utils import clip_grad_norm_

from ...policies.policy import make_network
from ..config import PPOConfig, card_of
from ..model import CLIP_RANGE
from ..rollouts import advantages
from .lanes import Practice
from .policy import DevicePolicy

# As Stable-Baselines3's PPO has them.
VALUE_WEIGHT = 0.5  # of the value's loss beside the policy's
MAX_GRAD_NORM = 0.5  # gradients longer than this are shortened


@dataclass(frozen=True, eq=False)
class Samples:
    """Control periods of lanes, in a row."""

    observations: torch.Tensor  # (samples, features)
    actions: torch.Tensor  # (samples, choices)
    likelihood: torch.Tensor  # (samples,) log of the actions' likelihood as they were chosen
    advantage: torch.Tensor  # (samples,)
    worth: torch.Tensor  # (samples,) of what was seen, as it turned out

    def pick(self, chosen: torch.Tensor) -> "Samples":
        """Some of them, by number (count,)."""
        return Samples(*(getattr(self, field.name)[chosen] for field in fields(self)))


def ppo_loss(policy: DevicePolicy, samples: Samples, ent_coef: float) -> torch.Tensor:
    """What a gradient step lessens.

    Args:
        policy: that learns.
        samples: to learn from; their advantages are normalised here.
        ent_coef: weight of the entropy bonus.
    """
    value, likelihood, entropy = policy.evaluate_actions(samples.observations, samples.actions)
    assert entropy is not None
    advantage = samples.advantage
    if len(advantage) > 1:
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    ratio = (likelihood - samples.likelihood).exp()
    clipped = ratio.clamp(1.0 - CLIP_RANGE, 1.0 + CLIP_RANGE)
    gain = torch.min(ratio * advantage, clipped * advantage).mean()
    error = (value.flatten() - samples.worth).square().mean()
    return VALUE_WEIGHT * error - gain - ent_coef * entropy.mean()


def gradient_step(policy: DevicePolicy, samples: Samples, ent_coef: float) -> None:
    """Change a policy by one step of its optimiser."""
    policy.optimizer.zero_grad()
    ppo_loss(policy, samples, ent_coef).backward()  # type: ignore[no-untyped-call]
    clip_grad_norm_(policy.parameters(), MAX_GRAD_NORM)
    policy.optimizer.step()


class Learner:
    """The policy, and how it learns from the lanes.

    Args:
        config: of the run.
        practice: its lanes.
    """

    def __init__(self, config: PPOConfig, practice: Practice) -> None:
        self._config = config
        self._practice = practice
        torch.manual_seed(config.seed)
        # Drawn on the CPU: one seed gives the same first weights wherever it learns.
        self._policy = DevicePolicy(
            practice.lanes.single_observation_space,
            practice.lanes.single_action_space,
            lambda _: config.learning_rate,
            net_arch=list(config.hidden),
        ).to(practice.device)
        self.steps = 0  # control periods learned from
        self._seen = torch.empty(0)

    @property
    def network(self) -> torch.nn.Module:
        """The policy on the CPU, as files hold it."""
        network = make_network(card_of(self._config), self._practice.lanes.settings)
        network.load_state_dict(self._policy.state_dict())
        return network

    def begin(self, seed: int) -> None:
        """Start all lanes and all draws anew."""
        torch.manual_seed(seed)
        self._seen = self._practice.reset(seed)

    def learn(self) -> dict[str, float]:
        """Learn from one rollout; the totals of the episodes that ended in it."""
        config = self._config
        left = max(0.0, 1.0 - self.steps / config.steps)
        self._policy.optimizer.param_groups[0]["lr"] = left * config.learning_rate
        samples = self.roll_out()
        count = len(samples.worth)
        for _ in range(config.n_epochs):
            order = torch.randperm(count, device=self._practice.device)
            for chosen in torch.split(order, config.batch_size):
                gradient_step(self._policy, samples.pick(chosen), config.ent_coef)
        self.steps += count
        return self._practice.totals.fetch()

    def state(self, recent: list[dict[str, float]]) -> dict[str, Any]:
        """All that a run goes on from at the beginning of a leg, with its latest episodes."""
        return {
            "policy": self._policy.state_dict(),
            "optimizer": self._policy.optimizer.state_dict(),
            "steps": self.steps,
            "recent": recent,
        }

    def restore(self, state: dict[str, Any]) -> list[dict[str, float]]:
        """Take on what `state` gave; the latest episodes."""
        self._policy.load_state_dict(state["policy"])
        self._policy.optimizer.load_state_dict(state["optimizer"])
        self.steps = int(state["steps"])
        recent: list[dict[str, float]] = state["recent"]
        return recent

    @torch.no_grad()
    def roll_out(self) -> Samples:
        """What all lanes do in `n_steps` control periods; no number leaves the device."""
        config = self._config
        seen, actions, likelihood = [], [], []
        value, rewards, ended, after = [], [], [], []
        for _ in range(config.n_steps):
            chosen, worth, log_likelihood = self._policy(self._seen)
            moved = self._practice.step(chosen)
            next_worth = self._policy.predict_values(moved.last).flatten() * ~moved.terminated
            seen.append(self._seen)
            actions.append(chosen.reshape(len(chosen), -1))
            likelihood.append(log_likelihood)
            value.append(worth.flatten())
            rewards.append(moved.rewards)
            ended.append(moved.ended)
            after.append(next_worth)
            self._seen = moved.observations
        values = torch.stack(value)
        advantage = advantages(
            torch.stack(rewards), torch.stack(ended), values, torch.stack(after),
            config.gamma, config.gae_lambda,
        )  # fmt: skip
        return Samples(
            torch.cat(seen),
            torch.cat(actions),
            torch.cat(likelihood),
            advantage.flatten().float(),
            (advantage + values).flatten().float(),
        )
