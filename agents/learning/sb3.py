"""Stable-Baselines3: training environments, PPO and DQN."""

import os
from dataclasses import replace
from multiprocessing import parent_process
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import DQN, PPO
from stable_baselines3.common import buffers, logger, utils, vec_env
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.type_aliases import TrainFreq

import surface_gym as sg
from surface_gym import checks
from surface_gym.config import PRESETS, EnvConfig, Preset
from surface_gym.parallel import usable_cores
from surface_gym.parcel import assortment

from ..base import ActionMirror, action_mirror, time_for, with_zone
from ..library import find_task
from ..policy import EqualChoicesPolicy
from ..tensors import check_like, load_optimizer
from ..vec_env import SurfaceVecEnv
from .algorithms import DQNConfig, PPOConfig
from .config import ParcelConfig, make_card
from .learner import ADAM_EPS, CLIP_RANGE, PlainAdam
from .runs import CURVE_EVERY, TENSORBOARD, Curve

# For the lab: other parcels than in its evaluation, from a slightly wider distribution.
_PARCELS, _PARCELS_SEED, _PARCEL_SIZES = 256, 14, (0.18, 0.47)  # [m]
# With exact sensors: squares of all sizes, and equally often the study's boxes.
_SQUARES = tuple(sg.Parcel(sg.Rectangle(0.01 * side, 0.01 * side)) for side in range(15, 51))
_EXACT_PARCELS = (*_SQUARES, *(sg.layouts.box("S"), sg.layouts.box("B")) * (len(_SQUARES) // 2))


def training_task(name: str) -> sg.tasks.Task:
    """Return the task for training. Its starts may differ from the starts of the task `name`."""
    return find_task(name).training_tasks()[0]


def make_mirrored_envs(config: ParcelConfig) -> SurfaceVecEnv:
    """Make the training environments. If the task is mirrored, the environments mirror actions."""
    env_config = make_card(config).env_config(find_task(config.task))
    return make_training_envs(config, action_mirror(env_config))


def make_training_envs(config: ParcelConfig, mirror: ActionMirror | None = None) -> SurfaceVecEnv:
    """Make the training environments. Unless `mirror` is None, `mirror` mirrors all actions."""
    by_camera = round(config.camera_share * config.num_envs)
    exact, other = _presets(config)
    with_exact = config.num_envs - by_camera
    each_zone = with_exact // (2 * len(config.zones)) if config.zones else 0
    shares = [
        (with_exact - each_zone * len(config.zones), exact, None),
        *((each_zone, exact, columns) for columns in config.zones),
        (by_camera, other, None),
    ]
    envs = [_make_envs(config, *share) for share in shares if share[0]]
    return SurfaceVecEnv(*envs, mirror=mirror)


def _presets(config: ParcelConfig) -> tuple[Preset, Preset]:
    """Return the presets of environments with exact sensors and of environments with a camera."""
    exact = PRESETS["exact"]
    if config.preset == "lab":
        lab = PRESETS["lab"]
        parcels = assortment(_PARCELS, _PARCELS_SEED, _PARCEL_SIZES)
        return replace(exact, parcels=_EXACT_PARCELS), replace(lab, parcels=parcels)
    camera = PRESETS["camera"]
    return exact, replace(camera, randomisation=sg.Randomisation(friction=config.friction))


def _count_threads() -> int:
    """Return the number of threads: 1 if other runs share the cores, else the number of cores."""
    is_alone = parent_process() is None and "OMP_NUM_THREADS" not in os.environ
    return usable_cores() if is_alone else 1


def _make_envs(
    config: ParcelConfig, num_envs: int, preset: Preset, columns: int | None
) -> sg.SmartSurfaceVectorEnv:
    """Make environments under a preset, with `columns` columns in the zone.

    If `columns` is None, the zone is the task's own zone.
    """
    task = training_task(config.task)
    line, periods = task.line, task.periods
    if columns is not None:
        assert isinstance(line, sg.lines.Line)
        periods = round(periods * time_for(line, columns))
        line = with_zone(line, columns)
    env_config = EnvConfig(
        task,
        line=line,
        actions=config.actions,
        control_period=config.control_period,
        observe=config.observe,
        preset=preset,
    )
    if config.estimate is not None:
        env_config = sg.Estimate.load(config.estimate).adapt(env_config)
    return sg.SmartSurfaceVectorEnv(
        num_envs=num_envs,
        threads=_count_threads(),
        max_episode_steps=periods,
        autoreset_mode=gym.vector.AutoresetMode.SAME_STEP,
        **env_config.arguments(),
    )


# Fields of a configuration that are arguments of Stable-Baselines3.
_OF_BOTH = ("gamma", "batch_size", "n_steps", "seed")
_OF_PPO = ("n_epochs", "gae_lambda", "ent_coef")
_OF_DQN = (
    "buffer_size", "learning_starts", "gradient_steps", "tau", "exploration_fraction",
    "exploration_final_eps", "max_grad_norm",
)  # fmt: skip
LOG_EVERY = 4  # episodes between entries of DQN in TensorBoard
_COUNTERS = ("num_timesteps", "_n_updates", "_episode_num")
_REPLAYED = ("observations", "next_observations", "actions", "rewards", "dones", "timeouts")


class DoubleDQN(DQN):
    """Stable-Baselines3's DQN with double-Q targets."""

    def train(self, gradient_steps: int, batch_size: int = 100) -> None:
        """Do gradient steps on batches of the replay buffer."""
        assert self.replay_buffer is not None
        self.policy.set_training_mode(True)
        self._update_learning_rate(self.policy.optimizer)
        losses = []
        for _ in range(gradient_steps):
            batch = self.replay_buffer.sample(batch_size, env=self._vec_normalize_env)
            discount = self.gamma if batch.discounts is None else batch.discounts
            with torch.no_grad():
                chosen = self.q_net(batch.next_observations).argmax(dim=1, keepdim=True)
                next_value = self.q_net_target(batch.next_observations).gather(1, chosen)
                target = batch.rewards + (1.0 - batch.dones) * discount * next_value
            value = self.q_net(batch.observations).gather(1, batch.actions.long())
            loss = torch.nn.functional.smooth_l1_loss(value, target)
            losses.append(loss.detach())
            self.policy.optimizer.zero_grad()
            torch.autograd.backward(loss)
            torch.nn.utils.clip_grad_norm_(self.policy.parameters(), self.max_grad_norm)
            self.policy.optimizer.step()
        self._n_updates += gradient_steps
        self.logger.record("train/n_updates", self._n_updates, exclude="tensorboard")
        self.logger.record("train/loss", float(np.mean(torch.stack(losses).numpy())))

    @property
    def memory(self) -> buffers.ReplayBuffer:
        assert self.replay_buffer is not None
        return self.replay_buffer

    def remembered(self, pos: int, full: bool) -> dict[str, torch.Tensor]:
        """Return the replay buffer's arrays by name. If `full` is false, cut the rows at `pos`."""
        filled = self.memory.buffer_size if full else pos
        return {name: torch.from_numpy(getattr(self.memory, name)[:filled]) for name in _REPLAYED}

    def restore_memory(self, calls: Any, memory: dict[str, Any]) -> None:
        """Restore the replay buffer `memory` and the number of steps `calls` from a checkpoint."""
        check_like("calls", calls, 0)
        check_like("full", memory["full"], self.memory.full)
        pos = checks.integer("pos", memory["pos"], least=0, most=self.memory.buffer_size - 1)
        arrays = self.remembered(pos, memory["full"])
        check_like("arrays", memory["arrays"], arrays)
        self._n_calls, self.memory.pos, self.memory.full = calls, pos, memory["full"]
        for name, values in arrays.items():
            values[:] = memory["arrays"][name]


def truncate_last(model: DoubleDQN) -> None:
    """Mark the latest transitions in the model's memory as truncated, before episodes restart.

    Otherwise, n-step returns would extend into other episodes.
    """
    buffer = model.memory
    last = buffer.pos - 1
    buffer.timeouts[last] = np.logical_or(buffer.timeouts[last], buffer.dones[last] == 0.0)


def make_model(config: PPOConfig | DQNConfig, env: vec_env.VecEnv) -> PPO | DoubleDQN:
    """Build PPO or DQN for training environments; `config.seed` sets the initial weights."""
    names = _OF_PPO if isinstance(config, PPOConfig) else _OF_DQN
    given: dict[str, Any] = {
        **{name: getattr(config, name) for name in (*_OF_BOTH, *names)},
        # remaining share of the run, from 1 to 0
        "learning_rate": lambda left: config.learning_rate * left,
        "policy_kwargs": {"net_arch": list(config.hidden), "optimizer_class": PlainAdam},
        "device": "cpu",
    }
    if isinstance(config, PPOConfig):
        given["policy_kwargs"]["optimizer_kwargs"] = {"eps": ADAM_EPS}
        return PPO(EqualChoicesPolicy, env, clip_range=CLIP_RANGE, **given)
    # The target is updated at every control period of all environments.
    every = config.num_envs
    return DoubleDQN("MlpPolicy", env, train_freq=1, target_update_interval=every, **given)


class ModelLearner:
    """`Learner` of a Stable-Baselines3 model, with the model's rollouts and gradient steps."""

    row_every = CURVE_EVERY

    def __init__(self, config: PPOConfig | DQNConfig) -> None:
        self._config = config
        self._model = make_model(config, make_mirrored_envs(config))
        self._callback: BaseCallback | None = None
        self._rollouts = 0

    @property
    def steps(self) -> int:
        return self._model.num_timesteps

    @property
    def network(self) -> torch.nn.Module:
        return self._model.policy

    def begin(self, seed: int) -> None:
        model: Any = self._model
        utils.set_random_seed(seed)
        model.action_space.seed(seed)
        model.env.seed(seed)
        model._last_obs = model.env.reset()
        model._last_episode_starts = np.ones(model.env.num_envs, dtype=np.bool_)
        if isinstance(model, DoubleDQN):
            truncate_last(model)

    def learn(self, curve: Curve) -> None:
        model, config = self._model, self._config
        if self._callback is None:
            model.set_logger(logger.configure(str(curve.folder / TENSORBOARD), ["tensorboard"]))
            _, self._callback = model._setup_learn(
                config.steps - self.steps, _Episodes(curve), reset_num_timesteps=False
            )
        assert model.env is not None
        if isinstance(model, PPO):
            model.collect_rollouts(model.env, self._callback, model.rollout_buffer, model.n_steps)
            self._rollouts += 1
            model._update_current_progress_remaining(self.steps, config.steps)
            model.dump_logs(self._rollouts)
            model.train()
            return
        assert isinstance(model.train_freq, TrainFreq)
        model.collect_rollouts(
            model.env, self._callback, model.train_freq, model.memory,
            learning_starts=model.learning_starts, log_interval=LOG_EVERY,
        )  # fmt: skip
        if self.steps > model.learning_starts:
            model.train(model.gradient_steps, model.batch_size)

    def state(self) -> dict[str, Any]:
        model = self._model
        state: dict[str, Any] = {
            "policy": model.policy.state_dict(),
            "optimizer": model.policy.optimizer.state_dict(),
            "counters": {name: getattr(model, name) for name in _COUNTERS},
        }
        if isinstance(model, DoubleDQN):
            pos, full = model.memory.pos, model.memory.full
            state["calls"] = model._n_calls
            arrays = model.remembered(pos, full)
            state["memory"] = {"pos": pos, "full": full, "arrays": arrays}
        return state

    def restore(self, state: dict[str, Any]) -> None:
        model = self._model
        check_like("policy", state["policy"], model.policy.state_dict())
        check_like("counters", state["counters"], dict.fromkeys(_COUNTERS, 0))
        if isinstance(model, DoubleDQN):
            model.restore_memory(state["calls"], state["memory"])
        model.policy.load_state_dict(state["policy"])
        load_optimizer(model.policy.optimizer, state["optimizer"])
        for name in _COUNTERS:
            setattr(model, name, state["counters"][name])


class _Episodes(BaseCallback):
    """Callback that adds ended episodes to the learning curve."""

    def __init__(self, curve: Curve) -> None:
        super().__init__()
        self._curve = curve

    def _on_step(self) -> bool:
        self._curve.add_episodes(self.locals["infos"])
        return True
