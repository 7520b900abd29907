"""One run of PPO or DQN."""

import time
from pathlib import Path

import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure
from stable_baselines3.common.utils import set_random_seed

from surface_gym.flow.rewards import PARCEL_TERMS

from ..policies.files import save_policy
from ..tasks import find_task
from .checkpoint import FILE, load_checkpoint, save_checkpoint
from .config import DQNConfig, ParcelsConfig, PPOConfig, card_of
from .curve import Curve
from .double_dqn import DoubleDQN, cut_memory
from .legs import CURVE_EVERY, Learned, Progress, leg_at, leg_seed
from .model import Model, make_model
from .parcels import CriticFirst, begin, make_seats
from .practice import make_practice


class _Legs(BaseCallback):
    """Begins the legs of a run, and keeps its curve."""

    def __init__(
        self, config: PPOConfig | DQNConfig, folder: Path, curve: Curve, progress: Progress
    ) -> None:
        super().__init__()
        self._config = config
        self._folder = folder
        self._curve = curve
        self._progress = progress
        self._leg = -1
        self._row = 0

    def _on_training_start(self) -> None:
        self._row = self.num_timesteps // CURVE_EVERY

    def _on_rollout_start(self) -> None:
        leg = leg_at(self._config, self.model.num_timesteps)
        if leg == self._leg:
            return
        self._leg = leg
        assert isinstance(self.model, Model)
        save_checkpoint(self.model, list(self._curve.recent), self._folder)
        seed = leg_seed(self._config, leg)
        set_random_seed(seed)
        self.model.action_space.seed(seed)
        assert self.model.env is not None
        self.model.env.seed(seed)
        self.model._last_obs = self.model.env.reset()  # type: ignore[assignment]
        self.model._last_episode_starts[:] = True  # type: ignore[index]
        if isinstance(self.model, DoubleDQN):
            cut_memory(self.model)

    def _on_step(self) -> bool:
        self._curve.take(self.locals["infos"])
        return True

    def _on_rollout_end(self) -> None:
        if self.num_timesteps // CURVE_EVERY > self._row:
            self._row = self.num_timesteps // CURVE_EVERY
            self._curve.write(self.num_timesteps)
            self._progress(self.num_timesteps, self._curve.success)


def train(
    config: PPOConfig | DQNConfig, folder: Path, progress: Progress = lambda *_: None
) -> Learned:
    """Learn as the configuration says and leave a policy in `folder`.

    A checkpoint found there is gone on from. An interrupt keeps what was learned so far.

    Raises:
        ValueError: the checkpoint is damaged, or of another configuration.
    """
    torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
    started = time.perf_counter()
    callbacks: list[BaseCallback] = []
    if isinstance(config, ParcelsConfig):
        model, terms = make_model(config, make_seats(config)), PARCEL_TERMS
        callbacks.append(CriticFirst(config.critic_first))
        if not (folder / FILE).is_file():
            begin(model, config)
    else:
        model, terms = make_model(config, make_practice(config)), find_task(config.task).terms
    recent = load_checkpoint(model, folder) if (folder / FILE).is_file() else []
    curve = Curve(folder, terms, model.num_timesteps, recent)
    model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))
    callback = _Legs(config, folder, curve, progress)
    interrupted = False
    try:
        if model.num_timesteps < config.steps:
            callbacks.insert(0, callback)
            model.learn(config.steps - model.num_timesteps, callbacks, reset_num_timesteps=False)
            save_checkpoint(model, list(curve.recent), folder)
    except KeyboardInterrupt:
        interrupted = True
    curve.close()
    save_policy(model.policy, card_of(config), folder)
    return Learned(model.num_timesteps, time.perf_counter() - started, interrupted)
