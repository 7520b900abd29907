"""Stable-Baselines3: training environments, PPO and DQN."""

import os
import time
from dataclasses import replace
from multiprocessing import parent_process
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import DQN, PPO
from stable_baselines3.common import buffers, logger, utils, vec_env
from stable_baselines3.common.callbacks import BaseCallback

import surface_gym as sg
from surface_gym import checks
from surface_gym.config import PRESETS, Preset
from surface_gym.parallel import usable_cores
from surface_gym.parcel import assortment

from ..base import ActionMirror, action_mirror, time_for, with_zone
from ..library import find_task, save_policy
from ..policy import EqualChoicesPolicy
from ..tensors import check_like, load_optimizer
from ..vec_env import SurfaceVecEnv
from . import runs
from .algorithms import DQNConfig, PPOConfig
from .config import ParcelConfig, make_card
from .learner import CLIP_RANGE

# For the lab: other parcels than in its evaluation, from a slightly wider distribution.
_PARCELS, _PARCELS_SEED, _PARCEL_SIZES = 256, 14, (0.18, 0.47)  # [m]
# With exact sensors: squares of all sizes, and equally often the study's boxes.
_SQUARES = tuple(sg.Parcel(sg.Rectangle(0.01 * side, 0.01 * side)) for side in range(15, 51))
_EXACT_PARCELS = (*_SQUARES, *(sg.layouts.box("S"), sg.layouts.box("B")) * (len(_SQUARES) // 2))


def training_task(name: str) -> sg.tasks.Task:
    """Return the training task, which may be narrower than the named task."""
    return find_task(name).training_tasks()[0]


def make_mirrored_envs(config: ParcelConfig) -> SurfaceVecEnv:
    """Make the environments of a configuration, with mirrored actions for mirrored tasks."""
    env_config = make_card(config).env_config(find_task(config.task))
    return make_training_envs(config, action_mirror(env_config))


def make_training_envs(config: ParcelConfig, mirror: ActionMirror | None = None) -> SurfaceVecEnv:
    """Make the environments of a configuration, by default without mirrored actions."""
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
    """Return two presets: for the environments with exact sensors, and for the other ones."""
    exact = PRESETS["exact"]
    if config.preset == "lab":
        lab = PRESETS["lab"]
        parcels = assortment(_PARCELS, _PARCELS_SEED, _PARCEL_SIZES)
        return replace(exact, parcels=_EXACT_PARCELS), replace(lab, parcels=parcels)
    camera = PRESETS["camera"]
    return exact, replace(camera, randomisation=sg.Randomisation(friction=config.friction))


def _count_threads() -> int:
    """Return the number of threads for environments: all cores, unless other runs share them."""
    is_alone = parent_process() is None and "OMP_NUM_THREADS" not in os.environ
    return usable_cores() if is_alone else 1


def _make_envs(
    config: ParcelConfig, num_envs: int, preset: Preset, columns: int | None
) -> sg.SmartSurfaceVectorEnv:
    """Make environments under a preset, with a number of zone columns or the task's zone."""
    task = training_task(config.task)
    line, periods = task.line, task.periods
    if columns is not None:
        assert isinstance(line, sg.lines.Line)
        periods = round(periods * time_for(line, columns))
        line = with_zone(line, columns)
    return sg.SmartSurfaceVectorEnv(
        num_envs=num_envs,
        threads=_count_threads(),
        max_episode_steps=periods,
        task=task,
        line=line,
        actions=config.actions,
        control_period=config.control_period,
        observe=config.observe,
        preset=preset,
        autoreset_mode=gym.vector.AutoresetMode.SAME_STEP,
    )


# Fields of a configuration that are arguments of Stable-Baselines3.
_OF_BOTH = ("gamma", "batch_size", "n_steps", "seed")
_OF_PPO = ("n_epochs", "gae_lambda", "ent_coef")
_OF_DQN = (
    "buffer_size", "learning_starts", "gradient_steps", "tau", "exploration_fraction",
    "exploration_final_eps", "max_grad_norm",
)  # fmt: skip
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


def truncate_last(model: DoubleDQN) -> None:
    """Mark the latest transitions as truncated, since the environments restart after them.

    Otherwise, n-step returns would extend into other episodes.
    """
    buffer = model.memory
    last = buffer.pos - 1
    buffer.timeouts[last] = np.logical_or(buffer.timeouts[last], buffer.dones[last] == 0.0)


def make_model(config: PPOConfig | DQNConfig, env: vec_env.VecEnv) -> PPO | DoubleDQN:
    """Build PPO or DQN, with weights drawn from the seed."""
    names = _OF_PPO if isinstance(config, PPOConfig) else _OF_DQN
    given: dict[str, Any] = {
        **{name: getattr(config, name) for name in (*_OF_BOTH, *names)},
        # remaining share of the run, from 1 to 0
        "learning_rate": lambda left: config.learning_rate * left,
        "policy_kwargs": {"net_arch": list(config.hidden)},
        "device": "cpu",
    }
    if isinstance(config, PPOConfig):
        return PPO(EqualChoicesPolicy, env, clip_range=CLIP_RANGE, **given)
    # The target is updated at every control period of all environments.
    every = config.num_envs
    return DoubleDQN("MlpPolicy", env, train_freq=1, target_update_interval=every, **given)


def save_checkpoint(model: PPO | DoubleDQN, recent: list[dict[str, float]], folder: Path) -> None:
    """Write networks, optimiser, counters, replay buffer and latest episodes to a folder."""
    state: dict[str, Any] = {
        "policy": model.policy.state_dict(),
        "optimizer": model.policy.optimizer.state_dict(),
        "counters": {name: getattr(model, name) for name in _COUNTERS},
        "recent": recent,
    }
    if isinstance(model, DoubleDQN):
        buffer = model.memory
        filled = buffer.buffer_size if buffer.full else buffer.pos
        arrays = {name: torch.from_numpy(getattr(buffer, name)[:filled]) for name in _REPLAYED}
        state["calls"] = model._n_calls
        state["memory"] = {"pos": buffer.pos, "full": buffer.full, "arrays": arrays}
    runs.write_state(state, folder)


def load_checkpoint(model: PPO | DoubleDQN, folder: Path) -> list[dict[str, float]]:
    """Restore a model from a checkpoint; return the latest episodes."""

    def restore(state: dict[str, Any]) -> list[dict[str, float]]:
        check_like("policy", state["policy"], model.policy.state_dict())
        check_like("counters", state["counters"], dict.fromkeys(_COUNTERS, 0))
        if isinstance(model, DoubleDQN):
            _restore_memory(model, state)
        model.policy.load_state_dict(state["policy"])
        load_optimizer(model.policy.optimizer, state["optimizer"])
        for name in _COUNTERS:
            setattr(model, name, state["counters"][name])
        return state["recent"]

    return runs.read_state(folder, restore)


def _restore_memory(model: DoubleDQN, state: dict[str, Any]) -> None:
    buffer, memory = model.memory, state["memory"]
    check_like("calls", state["calls"], 0)
    check_like("full", memory["full"], buffer.full)
    pos = checks.integer("pos", memory["pos"], least=0, most=buffer.buffer_size - 1)
    filled = buffer.buffer_size if memory["full"] else pos
    arrays = {name: torch.from_numpy(getattr(buffer, name)[:filled]) for name in _REPLAYED}
    check_like("arrays", memory["arrays"], arrays)
    model._n_calls, buffer.pos, buffer.full = state["calls"], pos, memory["full"]
    for name, values in arrays.items():
        values[:] = memory["arrays"][name]


class _Checkpoints(BaseCallback):
    """Callback for checkpoints, at which everything restarts, and for the learning curve."""

    def __init__(
        self,
        config: PPOConfig | DQNConfig,
        folder: Path,
        curve: runs.Curve,
        on_progress: runs.OnProgress,
    ) -> None:
        super().__init__()
        self._config = config
        self._folder = folder
        self._curve = curve
        self._on_progress = on_progress
        self._interval = -1
        self._row = 0

    def _on_training_start(self) -> None:
        self._row = self.num_timesteps // runs.CURVE_EVERY

    def _on_rollout_start(self) -> None:
        model: Any = self.model
        interval = runs.interval_at(self._config, model.num_timesteps)
        if interval == self._interval:
            return
        self._interval = interval
        save_checkpoint(model, list(self._curve.recent), self._folder)
        seed = runs.interval_seed(self._config, interval)
        utils.set_random_seed(seed)
        model.action_space.seed(seed)
        model.env.seed(seed)
        model._last_obs = model.env.reset()
        model._last_episode_starts[:] = True
        if isinstance(model, DoubleDQN):
            truncate_last(model)

    def _on_step(self) -> bool:
        self._curve.add_episodes(self.locals["infos"])
        return True

    def _on_rollout_end(self) -> None:
        if self.num_timesteps // runs.CURVE_EVERY > self._row:
            self._row = self.num_timesteps // runs.CURVE_EVERY
            self._curve.write(self.num_timesteps)
            self._on_progress(self.num_timesteps, self._curve.success)


def train_sb3(
    config: PPOConfig | DQNConfig, folder: Path, on_progress: runs.OnProgress = lambda *_: None
) -> runs.TrainResult:
    """Train PPO or DQN by a configuration, and write a policy to `folder`.

    A run with a checkpoint is resumed. An interrupt saves the current policy.
    """
    torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
    started = time.perf_counter()
    resumed = (folder / runs.CHECKPOINT).is_file()
    model = make_model(config, make_mirrored_envs(config))
    recent = load_checkpoint(model, folder) if resumed else []
    curve = runs.Curve(folder, find_task(config.task).terms, model.num_timesteps, recent)
    model.set_logger(logger.configure(str(folder / "tensorboard"), ["tensorboard"]))
    callback = _Checkpoints(config, folder, curve, on_progress)
    interrupted = False
    try:
        if model.num_timesteps < config.steps:
            model.learn(config.steps - model.num_timesteps, callback, reset_num_timesteps=False)
            save_checkpoint(model, list(curve.recent), folder)
    except (KeyboardInterrupt, runs.StopTraining):
        interrupted = True
    curve.close()
    save_policy(model.policy.state_dict(), make_card(config), folder)
    return runs.TrainResult(model.num_timesteps, time.perf_counter() - started, interrupted)
