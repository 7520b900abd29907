"""PPO with tensors on the environments' device, e.g. a GPU.

Loss, network and optimiser are the same as in Stable-Baselines3's PPO.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import gymnasium as gym
import numpy as np
import torch
from gymnasium import spaces

from surface_gym.config import REWARD, EnvConfig
from surface_gym.registration import DEFAULT_TASK, TASKS, env_id

from ..base import SIDE, ActionMirror
from ..policy import EqualCategoricals, EqualChoicesPolicy, make_network
from ..tensors import check_like, load_optimizer
from .algorithms import PPOConfig
from .config import make_card
from .learner import MAX_GRAD_NORM, compute_advantages, learning_rate, ppo_loss, train_learner
from .runs import EPISODES, RECENT_EPISODES, Curve, OnProgress, TrainResult
from .sb3 import training_task

if TYPE_CHECKING:
    from surface_gym.cuda.env import CudaVectorEnv

VALUE_COEF = 0.5  # as in Stable-Baselines3's PPO


# function from a configuration and a number of environments
MakeDeviceEnvs = Callable[[PPOConfig, int], "CudaVectorEnv"]


def make_device_envs(config: PPOConfig, num_envs: int) -> "CudaVectorEnv":
    """Make `num_envs` environments on the device `config.device`."""
    task = training_task(config.task)
    try:
        made: Any = gym.make_vec(
            # your own task has no id; the task is given in any case
            env_id(config.task if config.task in TASKS else DEFAULT_TASK),
            num_envs=num_envs,
            device=config.device,
            task=task,
            max_episode_steps=task.periods,
            actions=config.actions,
            control_period=config.control_period,
            observe=config.observe,
            autoreset_mode="SameStep",
        )
    except (ImportError, RuntimeError) as error:
        raise ValueError(f"device {config.device!r} cannot be used: {error}") from error
    return made


def check_device(config: PPOConfig) -> None:
    """Check that the device can run an environment; otherwise raise a ValueError."""
    make_device_envs(config, 1).close()


class TensorMirror:
    """`ActionMirror` for tensors. Only actions for a negative goal side are mirrored."""

    def __init__(self, env_config: EnvConfig, device: torch.device) -> None:
        kind = env_config.action_kind
        space = kind.space()
        if isinstance(space, spaces.Discrete):
            every = np.arange(space.n)
            images = ActionMirror(env_config)(every, -np.ones(len(every), np.float32))
            sources = np.zeros(1, dtype=np.int64)
        else:
            images = env_config.images
            sources = kind.flip(np.arange(kind.size)[np.newaxis])[0]
        self._images = torch.from_numpy(images).to(device)  # (options,) mirror image of each option
        self._sources = torch.from_numpy(sources).to(device)  # (parts,) mirror image of each part

    def __call__(self, actions: torch.Tensor, side: torch.Tensor) -> torch.Tensor:
        """Return actions (num_envs, ...), mirrored where the goal side (num_envs,) is negative."""
        parts = actions.reshape(len(actions), -1)
        images = self._images[parts[:, self._sources]]
        # Side 0, straight ahead, is not mirrored.
        return torch.where((side >= 0.0).unsqueeze(1), parts, images).reshape(actions.shape)


class EpisodeTotals:
    """Sums over all episodes that ended after the last `fetch`. The device holds the sums.

    Tens of thousands of episodes end per rollout, so single episodes are not recorded.
    """

    def __init__(self, terms: tuple[str, ...], num_envs: int, device: torch.device) -> None:
        self._terms = tuple(REWARD + term for term in terms)
        self._names = (EPISODES, "success", "return", "length", *self._terms)
        self._running = torch.zeros((2 + len(terms), num_envs), dtype=torch.float64, device=device)
        self._ended = torch.zeros(len(self._names), dtype=torch.float64, device=device)

    def reset(self) -> None:
        self._running.zero_()

    def add(self, rewards: torch.Tensor, ended: torch.Tensor, infos: dict[str, Any]) -> None:
        """Add the rewards (num_envs,), ended episodes (num_envs,) and infos of a control period."""
        final = infos["final_info"]
        terms = [torch.where(ended, final[name], infos[name]) for name in self._terms]
        self._running += torch.stack([rewards, torch.ones_like(rewards), *terms])
        sums = torch.where(ended, self._running, 0.0).sum(dim=1)
        counts = torch.stack([ended.sum(), (ended & final["is_success"]).sum()])
        self._ended += torch.cat([counts, sums])
        self._running = torch.where(ended, 0.0, self._running)

    def fetch(self) -> dict[str, float]:
        """Return the number and the sums of the ended episodes. Then set all totals to 0."""
        totals = dict(zip(self._names, self._ended.tolist(), strict=True))
        self._ended.zero_()
        return totals


class Transition(NamedTuple):
    """Result of a control period, as tensors on the environments' device."""

    observations: torch.Tensor  # (num_envs, features) observations; the next start's after an end
    rewards: torch.Tensor  # (num_envs,) float64
    terminated: torch.Tensor  # (num_envs,) whether ended by success or failure
    ended: torch.Tensor  # (num_envs,) whether ended, also by the time limit
    last: (
        torch.Tensor
    )  # (num_envs, features) observations at the period's end, also of ended episodes


class DeviceTrainingEnvs:
    """Environments that add up results of episodes, and mirror actions if the goal is mirrored."""

    def __init__(self, envs: "CudaVectorEnv") -> None:
        self.device = torch.device(envs.device)
        self.envs = envs
        env_config = envs.config
        self.totals = EpisodeTotals(env_config.task.terms, envs.num_envs, self.device)
        mirrored = env_config.task.mirrored
        self._mirror = TensorMirror(env_config, self.device) if mirrored else None
        self._side = torch.ones(envs.num_envs, device=self.device)

    def reset(self, seed: int) -> torch.Tensor:
        observations, _ = self.envs.reset(seed=seed)
        self.totals.reset()
        return self._keep(observations)

    def step(self, actions: torch.Tensor) -> Transition:
        """Step all environments by one control period, without a copy to the host."""
        if self._mirror is not None:
            actions = self._mirror(actions, self._side)
        observations, rewards, terminated, truncated, infos = self.envs.step(actions)
        ended = terminated | truncated
        self.totals.add(rewards, ended, infos)
        last = torch.where(ended.unsqueeze(1), infos["final_obs"], observations)
        return Transition(
            self._keep(observations), rewards.clone(), terminated.clone(), ended, last
        )

    def _keep(self, observations: torch.Tensor) -> torch.Tensor:
        kept = observations.clone()
        if self._mirror is not None:
            self._side = kept[:, SIDE]
        return kept


class DevicePolicy(EqualChoicesPolicy):
    """`EqualChoicesPolicy` that uses `EqualCategoricals` even if an action has only one choice.

    PyTorch's own distribution would check probabilities on the host, and wait for the device in
    each control period. `evaluate_actions` takes actions (num_envs, choices). The parameters have
    the same names and shapes as in `EqualChoicesPolicy`.
    """

    def _build(self, lr_schedule: Any) -> None:
        if isinstance(self.action_space, spaces.Discrete):
            self.action_dist = EqualCategoricals(1, int(self.action_space.n))
        super()._build(lr_schedule)


class Samples(NamedTuple):
    """Samples of a rollout: one row for each control period of each environment."""

    observations: torch.Tensor  # (samples, features)
    actions: torch.Tensor  # (samples, choices)
    log_prob: torch.Tensor  # (samples,) log probability of the actions when chosen
    advantage: torch.Tensor  # (samples,)
    returns: torch.Tensor  # (samples,)

    def select(self, chosen: torch.Tensor) -> "Samples":
        return Samples(*(each[chosen] for each in self))


def policy_loss(policy: DevicePolicy, samples: Samples, ent_coef: float) -> torch.Tensor:
    """Compute PPO's loss of a policy on samples, after normalising advantages; see `ppo_loss`."""
    value, log_prob, entropy = policy.evaluate_actions(samples.observations, samples.actions)
    assert entropy is not None
    advantage = samples.advantage
    if len(advantage) > 1:
        advantage = (advantage - advantage.mean()) / (advantage.std() + 1e-8)
    return ppo_loss(
        log_prob, samples.log_prob, advantage, value.flatten(), samples.returns, entropy.mean(),
        ent_coef, VALUE_COEF,
    )  # fmt: skip


def gradient_step(policy: DevicePolicy, samples: Samples, ent_coef: float) -> None:
    """Take one step of a policy's optimiser on samples; `ent_coef` weights the entropy."""
    policy.optimizer.zero_grad()
    torch.autograd.backward(policy_loss(policy, samples, ent_coef))
    torch.nn.utils.clip_grad_norm_(policy.parameters(), MAX_GRAD_NORM)
    policy.optimizer.step()


class DeviceLearner:
    """A policy on the device, and its training."""

    def __init__(self, config: PPOConfig, envs: DeviceTrainingEnvs) -> None:
        self._config = config
        self._envs = envs
        torch.manual_seed(config.seed)
        # Drawn on the CPU, so that a seed gives the same initial weights on every device.
        self._policy = DevicePolicy(
            envs.envs.single_observation_space,
            envs.envs.single_action_space,
            lambda _: config.learning_rate,
            net_arch=list(config.hidden),
        ).to(envs.device)
        self.steps = 0
        self._seen = torch.empty(0)

    @property
    def network(self) -> torch.nn.Module:
        network = make_network(make_card(self._config), self._envs.envs.config)
        network.load_state_dict(self._policy.state_dict())
        return network

    def begin(self, seed: int) -> None:
        torch.manual_seed(seed)
        self._seen = self._envs.reset(seed)

    def learn(self, curve: Curve) -> None:
        config = self._config
        self._policy.optimizer.param_groups[0]["lr"] = learning_rate(config, self.steps)
        samples = self.roll_out()
        count = len(samples.returns)
        for _ in range(config.n_epochs):
            order = torch.randperm(count, device=self._envs.device)
            for chosen in torch.split(order, config.batch_size):
                gradient_step(self._policy, samples.select(chosen), config.ent_coef)
        self.steps += count
        # After a restart of all environments, only the shortest episodes have ended.
        curve.add_totals(self._envs.totals.fetch(), max(RECENT_EPISODES, config.num_envs))

    def state(self) -> dict[str, Any]:
        return {
            "policy": self._policy.state_dict(),
            "optimizer": self._policy.optimizer.state_dict(),
            "steps": self.steps,
        }

    def restore(self, state: dict[str, Any]) -> None:
        check_like("policy", state["policy"], self._policy.state_dict())
        check_like("steps", state["steps"], 0)
        self._policy.load_state_dict(state["policy"])
        load_optimizer(self._policy.optimizer, state["optimizer"])
        self.steps = state["steps"]

    @torch.no_grad()
    def roll_out(self) -> Samples:
        """Collect `n_steps` control periods of all environments, without a copy to the host."""
        periods = []
        for _ in range(self._config.n_steps):
            chosen, value, log_prob = self._policy(self._seen)
            moved = self._envs.step(chosen)
            next_value = self._policy.predict_values(moved.last).flatten() * ~moved.terminated
            decided = (self._seen, chosen.reshape(len(chosen), -1), log_prob, value.flatten())
            periods.append((*decided, moved.rewards, moved.ended, next_value))
            self._seen = moved.observations
        seen, actions, log_prob, value, *rest = map(torch.stack, zip(*periods, strict=True))
        rewards, ended, next_value = rest
        gamma, gae_lambda = self._config.gamma, self._config.gae_lambda
        advantage = compute_advantages(rewards, ended, value, next_value, gamma, gae_lambda)
        returns = (advantage + value).float()
        each = (seen, actions, log_prob, advantage.float(), returns)
        return Samples(*(values.flatten(0, 1) for values in each))


def train_on_device(
    config: PPOConfig,
    folder: Path,
    on_progress: OnProgress = lambda *_: None,
    make_envs: MakeDeviceEnvs = make_device_envs,
) -> TrainResult:
    """Train PPO on a device, in environments that `make_envs` makes; see `train_learner`."""

    def make_learner(config: PPOConfig) -> DeviceLearner:
        return DeviceLearner(config, DeviceTrainingEnvs(make_envs(config, config.num_envs)))

    return train_learner(config, folder, on_progress, make_learner)
