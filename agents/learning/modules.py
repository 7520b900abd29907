"""Shared-policy PPO per module, with the joint likelihood of an environment's choices."""

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch

from .. import module_policy
from ..base import Integers, Singles
from ..module_policy import GROUPS, SortModuleView
from ..tensors import check_like, load_optimizer
from ..vec_env import ConcatVecEnv
from . import ppo
from .algorithms import ModulesConfig
from .config import make_card
from .learner import learning_rate, train_learner
from .runs import Curve, OnProgress, TrainResult
from .sb3 import make_training_envs

ADAM_EPS = 1e-5  # as in Stable-Baselines3's PPO


def step_envs(envs: ConcatVecEnv, actions: Integers) -> ppo.Transition:
    """Step all environments by one control period."""
    observations, rewards, ended, infos = envs.step(actions)
    seen = np.asarray(observations)
    last, terminated = seen.copy(), ended.copy()
    for i in np.nonzero(ended)[0]:
        last[i] = infos[i]["terminal_observation"]
        terminated[i] = not infos[i]["TimeLimit.truncated"]
    return ppo.Transition(seen, rewards.astype(np.float64), terminated, ended, last, infos)


@dataclass(frozen=True, eq=False)
class ModuleSamples:
    """Samples, one per environment and control period, with their modules concatenated."""

    observations: torch.Tensor  # (samples, features)
    shared: torch.Tensor  # (samples, shared features) features shared by a sample's modules
    log_prob: torch.Tensor  # (samples,) joint log probability of the choices when made
    count: torch.Tensor  # (samples,) number of modules
    place: torch.Tensor  # (modules, place features)
    group: torch.Tensor  # (modules,) group within the sample
    choice: torch.Tensor  # (modules,)

    @property
    def sample(self) -> torch.Tensor:
        """(modules,) index of each module's sample."""
        return torch.arange(len(self.count)).repeat_interleave(self.count)

    def select(self, samples: Integers) -> "ModuleSamples":
        chosen = torch.from_numpy(samples)
        counts = self.count[chosen]
        first = (self.count.cumsum(0) - self.count)[chosen]
        skipped = counts.cumsum(0) - counts
        modules = torch.arange(int(counts.sum())) + (first - skipped).repeat_interleave(counts)
        tensors = self._tensors()
        return ModuleSamples(
            *(tensor[chosen] for tensor in tensors[:4]),
            *(tensor[modules] for tensor in tensors[4:]),
        )

    @staticmethod
    def concatenate(parts: "list[ModuleSamples]") -> "ModuleSamples":
        tensors = zip(*(part._tensors() for part in parts), strict=True)
        return ModuleSamples(*map(torch.cat, tensors))

    def _tensors(self) -> list[torch.Tensor]:
        return [getattr(self, field.name) for field in fields(self)]


class ModuleLearner:
    """Training of the modules' policy and value."""

    def __init__(self, config: ModulesConfig) -> None:
        self._config = config
        self._envs = make_training_envs(config)
        env_config = make_card(config).env_config()
        self._view = SortModuleView(env_config)
        torch.manual_seed(config.seed)
        self.network = module_policy.SharedNetwork(
            len(env_config.chosen_orientations), config.hidden, env_config.observe
        )
        self.value = module_policy.ValueNetwork(config.hidden, env_config.observe)
        self._networks = (self.network, self.value)
        self._optimisers = [
            torch.optim.Adam(network.parameters(), config.learning_rate, eps=ADAM_EPS)
            for network in self._networks
        ]
        self.steps = 0
        self._rng = np.random.default_rng(config.seed)
        self._seen: Singles = np.empty((0, 0), dtype=np.float32)

    def begin(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._envs.seed(seed)
        self._seen = np.asarray(self._envs.reset())

    def learn(self, curve: Curve) -> None:
        for optimiser in self._optimisers:
            optimiser.param_groups[0]["lr"] = learning_rate(self._config, self.steps)
        samples, advantage, returns, infos = self._roll_out()
        count = len(returns)
        for _ in range(self._config.n_epochs):
            order = self._rng.permutation(count)
            for first in range(0, count, self._config.batch_size):
                chosen = order[first : first + self._config.batch_size]
                self._step(samples.select(chosen), advantage[chosen], returns[chosen])
        self.steps += count
        curve.add_episodes(infos)

    def state(self) -> dict[str, Any]:
        return {
            "network": self.network.state_dict(),
            "value": self.value.state_dict(),
            "optimisers": [optimiser.state_dict() for optimiser in self._optimisers],
            "steps": self.steps,
        }

    def restore(self, state: dict[str, Any]) -> None:
        own = {"network": self.network.state_dict(), "value": self.value.state_dict(), "steps": 0}
        for name, values in own.items():
            check_like(name, state[name], values)
        self.network.load_state_dict(state["network"])
        self.value.load_state_dict(state["value"])
        for optimiser, saved in zip(self._optimisers, state["optimisers"], strict=True):
            load_optimizer(optimiser, saved)
        self.steps = state["steps"]

    @torch.no_grad()
    def _decide(self) -> tuple[ModuleSamples, Integers]:
        """Draw the choices of all modules; return samples and actions."""
        num_envs = len(self._seen)
        seen = self._view(self._seen)
        shared, env, place = map(torch.from_numpy, (seen.shared, seen.env, seen.place))
        log_probability = self.network(shared, env, place)
        probability = self._config.split_probability
        groups = module_policy.draw_groups(seen.env, seen.place, num_envs, probability, self._rng)
        group = torch.from_numpy(groups)
        uniform = torch.from_numpy(self._rng.random(GROUPS * num_envs, dtype=np.float32))
        choice = module_policy.draw_choices(log_probability, group, uniform)
        samples = ModuleSamples(
            torch.from_numpy(self._seen),
            shared,
            module_policy.log_likelihood(log_probability, choice, group, GROUPS * num_envs),
            torch.bincount(env, minlength=num_envs),
            place,
            group - GROUPS * env,
            choice,
        )
        return samples, self._view.actions(self._seen, seen, choice.numpy())

    @torch.no_grad()
    def _roll_out(self) -> tuple[ModuleSamples, torch.Tensor, torch.Tensor, list[dict[str, Any]]]:
        """Collect samples, normalised advantages, returns and infos."""
        parts, rewards, ended, next_value = [], [], [], []
        infos: list[dict[str, Any]] = []
        for _ in range(self._config.n_steps):
            part, actions = self._decide()
            moved = step_envs(self._envs, actions)
            self._seen = moved.observations
            infos += moved.infos
            parts.append(part)
            rewards.append(moved.rewards)
            ended.append(moved.ended)
            next_value.append(~moved.terminated * self.value(torch.from_numpy(moved.last)).numpy())
        samples = ModuleSamples.concatenate(parts)
        value = self.value(samples.observations).numpy().reshape(len(parts), -1).astype(np.float64)
        advantage = ppo.compute_advantages(
            torch.from_numpy(np.stack(rewards)),
            torch.from_numpy(np.stack(ended)),
            torch.from_numpy(value),
            torch.from_numpy(np.stack(next_value)),
            self._config.gamma,
            self._config.gae_lambda,
        ).numpy()
        returns = torch.from_numpy((advantage + value).ravel().astype(np.float32))
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
        return samples, torch.from_numpy(advantage.ravel().astype(np.float32)), returns, infos

    def _step(self, samples: ModuleSamples, advantage: torch.Tensor, returns: torch.Tensor) -> None:
        sample = samples.sample
        log_probability = self.network(samples.shared, sample, samples.place)
        group = GROUPS * sample + samples.group
        loss = ppo.ppo_loss(
            module_policy.log_likelihood(
                log_probability, samples.choice, group, GROUPS * len(samples.count)
            ),
            samples.log_prob,
            advantage,
            self.value(samples.observations),
            returns,
            -(log_probability.exp() * log_probability).sum(dim=1).mean(),
            self._config.ent_coef,
            value_coef=1.0,  # the networks share no weights
        )
        for optimiser in self._optimisers:
            optimiser.zero_grad()
        torch.autograd.backward(loss)
        for network, optimiser in zip(self._networks, self._optimisers, strict=True):
            torch.nn.utils.clip_grad_norm_(network.parameters(), ppo.MAX_GRAD_NORM)
            optimiser.step()


def train_modules(
    config: ModulesConfig, folder: Path, on_progress: OnProgress = lambda *_: None
) -> TrainResult:
    """Train one policy shared by all modules; see `train_learner`."""
    return train_learner(config, folder, on_progress, ModuleLearner)
