"""PPO on the likelihood of what all modules of a lane chose together.

Schulman et al., Proximal policy optimization algorithms, 2017; the clipped objective, Eq. (7).
"""

from typing import Any

import numpy as np
import torch
from torch import nn
from torch.nn.utils import clip_grad_norm_

from ...modules.draw import GROUPS, draw_choices, draw_groups, log_likelihood
from ...modules.network import SharedNetwork, ValueNetwork
from ...modules.view import ModuleView, Singles
from ..config import ModulesConfig, card_of
from ..rollouts import advantages
from .practice import Practice
from .rollout import Batch, join, pick

# As Stable-Baselines3's PPO has them.
CLIP_RANGE = 0.2  # by which the likelihood of a lane's choices may change and still earn
MAX_GRAD_NORM = 0.5  # gradients longer than this are shortened
ADAM_EPS = 1e-5


class Learner:
    """The networks, and how they learn from the lanes.

    Args:
        config: of the run.
    """

    def __init__(self, config: ModulesConfig) -> None:
        self._config = config
        self._practice = Practice(config)
        settings = card_of(config).settings()
        self._view = ModuleView(settings)
        torch.manual_seed(config.seed)
        self.network = SharedNetwork(
            len(settings.chosen_orientations), config.hidden, settings.observe
        )
        self.value = ValueNetwork(config.hidden, settings.observe)
        self._optimisers = [
            torch.optim.Adam(network.parameters(), config.learning_rate, eps=ADAM_EPS)
            for network in (self.network, self.value)
        ]
        self.steps = 0  # control periods learned from
        self._rng = np.random.default_rng(config.seed)
        self._seen: Singles = np.empty((0, 0), dtype=np.float32)

    def begin(self, seed: int) -> None:
        """Start all lanes and all draws anew."""
        self._rng = np.random.default_rng(seed)
        self._seen = self._practice.reset(seed)

    def learn(self) -> list[dict[str, Any]]:
        """Learn from one rollout; the infos of the episodes that ended in it."""
        left = max(0.0, 1.0 - self.steps / self._config.steps)
        for optimiser in self._optimisers:
            optimiser.param_groups[0]["lr"] = left * self._config.learning_rate
        batch, advantage, worth, infos = self._roll_out()
        samples = len(worth)
        for _ in range(self._config.n_epochs):
            order = self._rng.permutation(samples)
            for first in range(0, samples, self._config.batch_size):
                chosen = order[first : first + self._config.batch_size]
                self._step(pick(batch, chosen), advantage[chosen], worth[chosen])
        self.steps += samples
        return infos

    def state(self, recent: list[dict[str, float]]) -> dict[str, Any]:
        """All that a run goes on from at the beginning of a leg, with its latest episodes."""
        return {
            "network": self.network.state_dict(),
            "value": self.value.state_dict(),
            "optimisers": [optimiser.state_dict() for optimiser in self._optimisers],
            "steps": self.steps,
            "recent": recent,
        }

    def restore(self, state: dict[str, Any]) -> list[dict[str, float]]:
        """Take on what `state` gave; the latest episodes."""
        self.network.load_state_dict(state["network"])
        self.value.load_state_dict(state["value"])
        for optimiser, kept in zip(self._optimisers, state["optimisers"], strict=True):
            optimiser.load_state_dict(kept)
        self.steps = int(state["steps"])
        recent: list[dict[str, float]] = state["recent"]
        return recent

    @torch.no_grad()
    def _decide(self) -> tuple[Batch, Any]:
        """What the modules of all lanes see and choose, and the actions that follow."""
        lanes = len(self._seen)
        seen = self._view(self._seen)
        shared, lane, place = map(torch.from_numpy, (seen.shared, seen.lane, seen.place))
        log_probability = self.network(shared, lane, place)
        groups = draw_groups(seen.lane, seen.place, lanes, self._config.parted, self._rng)
        group = torch.from_numpy(groups)
        uniform = torch.from_numpy(self._rng.random(GROUPS * lanes, dtype=np.float32))
        choice = draw_choices(log_probability, group, uniform)
        batch = Batch(
            torch.from_numpy(self._seen),
            shared,
            log_likelihood(log_probability, choice, group, GROUPS * lanes),
            torch.bincount(lane, minlength=lanes),
            place,
            group - GROUPS * lane,
            choice,
        )
        return batch, self._view.actions(self._seen, seen, choice.numpy())

    @torch.no_grad()
    def _roll_out(self) -> tuple[Batch, torch.Tensor, torch.Tensor, list[dict[str, Any]]]:
        """Samples, their advantages, what they turned out to be worth, and infos."""
        batches, rewards, ended, after = [], [], [], []
        infos: list[dict[str, Any]] = []
        for _ in range(self._config.n_steps):
            batch, actions = self._decide()
            moved = self._practice.step(actions)
            self._seen = moved.observations
            infos += [info for info in moved.infos if info]
            batches.append(batch)
            rewards.append(moved.rewards)
            ended.append(moved.ended)
            after.append(~moved.terminated * self.value(torch.from_numpy(moved.last)).numpy())
        batch = join(batches)
        value = self.value(batch.observations).numpy().reshape(len(batches), -1).astype(np.float64)
        config = self._config
        advantage = advantages(
            torch.from_numpy(np.stack(rewards)),
            torch.from_numpy(np.stack(ended)),
            torch.from_numpy(value),
            torch.from_numpy(np.stack(after)),
            config.gamma,
            config.gae_lambda,
        ).numpy()
        worth = torch.from_numpy((advantage + value).ravel().astype(np.float32))
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        return batch, torch.from_numpy(advantage.ravel().astype(np.float32)), worth, infos

    def _step(self, batch: Batch, advantage: torch.Tensor, worth: torch.Tensor) -> None:
        """One gradient step of each network."""
        sample = batch.sample
        log_probability = self.network(batch.shared, sample, batch.place)
        group = GROUPS * sample + batch.group
        likelihood = log_likelihood(
            log_probability, batch.choice, group, GROUPS * len(batch.modules)
        )
        ratio = (likelihood - batch.likelihood).exp()
        clipped = ratio.clamp(1.0 - CLIP_RANGE, 1.0 + CLIP_RANGE)
        gain = torch.min(ratio * advantage, clipped * advantage)
        entropy = -(log_probability.exp() * log_probability).sum(dim=1).mean()
        loss = -gain.mean() - self._config.ent_coef * entropy
        error = (self.value(batch.observations) - worth).square().mean()
        losses: tuple[tuple[nn.Module, torch.Tensor], ...] = (
            (self.network, loss),
            (self.value, error),
        )
        for (network, wrong), optimiser in zip(losses, self._optimisers, strict=True):
            optimiser.zero_grad()
            wrong.backward()  # type: ignore[no-untyped-call]
            clip_grad_norm_(network.parameters(), MAX_GRAD_NORM)
            optimiser.step()
