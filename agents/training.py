"""PPO on Sort by Stable-Baselines3, with a progress bar that shows success."""

from collections import deque
from pathlib import Path

import gymnasium as gym
import numpy as np
import torch
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import configure

from agents.config import TrainConfig
from agents.mirror import ActionMirror, MirrorVecEnv
from agents.policy import Policy, PolicyCard
from agents.vec_env import SurfaceVecEnv
from surface_gym.settings import Settings
from surface_gym.tasks.sort import Sort

ENV_ID = "SmartSurface/Sort-v0"
RECENT_EPISODES = 1000


class _Progress(BaseCallback):
    """A bar with the success of the latest episodes, which it also logs."""

    def __init__(self, bar: Progress, steps: int) -> None:
        super().__init__()
        self._bar = bar
        self._task = bar.add_task("learning", total=steps, success="-")
        self._recent: deque[bool] = deque(maxlen=RECENT_EPISODES)

    def _on_step(self) -> bool:
        self._recent.extend(info["is_success"] for info in self.locals["infos"] if info)
        return True

    def _on_rollout_end(self) -> None:
        success = float(np.mean(self._recent)) if self._recent else float("nan")
        self.logger.record("rollout/success_rate", success)
        self._bar.update(self._task, completed=self.num_timesteps, success=f"{success:.3f}")


def train(config: TrainConfig, folder: Path, console: Console) -> tuple[Policy, PolicyCard, PPO]:
    """Learn as the config says, logging to `folder`; an interrupt keeps what was learned."""
    torch.set_num_threads(1)  # the networks are small: more threads only wait for each other
    settings = Settings(actions=config.actions, control_period=config.control_period)
    env = gym.make_vec(
        ENV_ID,
        num_envs=config.lanes,
        task=Sort(slow_share=config.slow_share),
        actions=config.actions,
        control_period=config.control_period,
        autoreset_mode=gym.vector.AutoresetMode.SAME_STEP,
    )
    mirror = ActionMirror(settings.action_kind, settings.orientations)
    model = PPO(
        "MlpPolicy",
        MirrorVecEnv(SurfaceVecEnv(env), mirror),  # type: ignore[arg-type]
        n_steps=config.rollout,
        batch_size=config.batch_size,
        n_epochs=config.epochs,
        learning_rate=lambda left: config.learning_rate * left,
        gamma=config.gamma,
        gae_lambda=config.gae_lambda,
        ent_coef=config.entropy,
        policy_kwargs={"net_arch": list(config.hidden)},
        seed=config.seed,
        device="cpu",
    )
    model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.completed:,.0f} of {task.total:,.0f} steps"),
        TextColumn("success {task.fields[success]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console) as bar:
        try:
            model.learn(config.steps, callback=_Progress(bar, config.steps))
        except KeyboardInterrupt:
            console.print("interrupted: going on with what was learned so far")
    card = PolicyCard(ENV_ID, config.actions, config.control_period, config.hidden)
    return Policy(model.policy, card), card, model
