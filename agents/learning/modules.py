"""Shared-policy PPO per module, with the joint likelihood of all choices in an environment."""

from pathlib import Path
from typing import Any

import numpy as np
import torch

from .. import module_policy
from ..base import Integers, Numbers, Singles
from ..module_policy import GROUPS, SortModuleView
from ..vec_env import ConcatVecEnv
from .algorithms import ModulesConfig
from .config import make_card
from .learner import train_learner
from .runs import OnProgress, TrainResult
from .sb3 import make_training_envs
from .shared import Decision, Evaluation, SharedLearner, SlotOutcome, mean_entropy


class ModulesNetwork(torch.nn.Module):
    """Actor of the modules, and critic of their environment."""

    def __init__(self, choices: int, config: ModulesConfig) -> None:
        super().__init__()
        self.actor = module_policy.SharedNetwork(choices, config.hidden, config.observe)
        self.critic = module_policy.ValueNetwork(config.hidden, config.observe)


class ModuleLearner(SharedLearner[ModulesNetwork, ModulesConfig]):
    """Training of the modules' policy and value.

    A slot is an environment, since its modules share one reward. Their choices are one sample.
    """

    value_coef = 1.0  # the networks share no weights
    adam_eps = 1e-5  # as in Stable-Baselines3's PPO

    def __init__(self, config: ModulesConfig) -> None:
        self._envs: ConcatVecEnv = make_training_envs(config)
        env_config = make_card(config).env_config()
        self._view = SortModuleView(env_config)
        torch.manual_seed(config.seed)
        super().__init__(config, ModulesNetwork(len(env_config.chosen_orientations), config))
        self._seen: Singles = np.empty((0, 0), dtype=np.float32)
        # Place, group and choice of the modules of all samples.
        self._modules: list[torch.Tensor] = []

    @property
    def network(self) -> torch.nn.Module:
        """Network of the policy, as it is now."""
        return self._learning.actor

    def begin(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._envs.seed(seed)
        self._seen = np.asarray(self._envs.reset())

    def roll_out(self) -> list[torch.Tensor]:
        self._parts: list[tuple[torch.Tensor, ...]] = []
        batch = super().roll_out()
        self._modules = [torch.cat(each) for each in zip(*self._parts, strict=True)]
        return batch

    def _decide(self) -> Decision:
        num_envs = len(self._seen)
        seen = self._view(self._seen)
        shared, env, place = map(torch.from_numpy, (seen.shared, seen.env, seen.place))
        log_probability = self._learning.actor(shared, env, place)
        probability = self._config.split_probability
        groups = module_policy.draw_groups(seen.env, seen.place, num_envs, probability, self._rng)
        group = torch.from_numpy(groups)
        uniform = torch.from_numpy(self._rng.random(GROUPS * num_envs, dtype=np.float32))
        choice = module_policy.draw_choices(log_probability, group, uniform)
        count = torch.bincount(env, minlength=num_envs)
        first = sum(len(choice) for _, _, choice in self._parts) + count.cumsum(0) - count
        self._parts.append((place, group - GROUPS * env, choice))
        return Decision(
            self._view.actions(self._seen, seen, choice.numpy()),
            self._value(),
            (torch.from_numpy(self._seen), shared, first, count),
            np.arange(num_envs),
            torch.ones(num_envs, dtype=torch.bool),
            module_policy.log_likelihood(log_probability, choice, group, GROUPS * num_envs),
        )

    def _move(self, actions: Integers) -> SlotOutcome:
        observations, rewards, ended, infos = self._envs.step(actions)
        self._seen = np.asarray(observations)
        self.infos += infos
        after = np.zeros(len(ended))
        timed = [i for i in np.nonzero(ended)[0] if infos[i]["TimeLimit.truncated"]]
        if timed:  # truncated episodes have a value
            after[timed] = self._compute_values(
                np.stack([infos[i]["terminal_observation"] for i in timed])
            )
        return SlotOutcome(rewards.astype(np.float64), ended, after)

    def _value(self) -> Numbers:
        return self._compute_values(self._seen)

    def _compute_values(self, observations: Singles) -> Any:
        return self._learning.critic(torch.from_numpy(observations)).numpy()

    def _evaluate(self, samples: list[torch.Tensor]) -> Evaluation:
        observations, shared, first, count = samples
        sample = torch.arange(len(count)).repeat_interleave(count)
        skipped = count.cumsum(0) - count
        index = torch.arange(int(count.sum())) + (first - skipped).repeat_interleave(count)
        place, group, choice = (each[index] for each in self._modules)
        log_probability = self._learning.actor(shared, sample, place)
        log_prob = module_policy.log_likelihood(
            log_probability, choice, GROUPS * sample + group, GROUPS * len(count)
        )
        value = self._learning.critic(observations)
        return Evaluation(log_prob, value, mean_entropy(log_probability))


def train_modules(
    config: ModulesConfig, folder: Path, on_progress: OnProgress = lambda *_: None
) -> TrainResult:
    """Train one policy shared by all modules; see `train_learner`."""
    return train_learner(config, folder, on_progress, ModuleLearner)
