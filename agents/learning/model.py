"""The learning algorithms as a configuration asks for them."""

from collections.abc import Callable
from functools import partial

from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

from ..flow.seat_policy import SeatPolicy
from ..policies.categorical import EqualChoicesPolicy
from .config import DQNConfig, ParcelsConfig, PPOConfig
from .double_dqn import DoubleDQN

Model = PPO | DoubleDQN
CLIP_RANGE = 0.2  # Stable-Baselines3's


def _falling(first: float, left: float) -> float:
    """Learning rate where the share `left` of the run lies ahead."""
    return first * left


def make_model(config: PPOConfig | DQNConfig, env: VecEnv) -> Model:
    """PPO or DQN, its weights drawn from the seed."""
    learning_rate: Callable[[float], float] = partial(_falling, config.learning_rate)
    if isinstance(config, PPOConfig):
        return PPO(
            SeatPolicy if isinstance(config, ParcelsConfig) else EqualChoicesPolicy,
            env,
            clip_range=config.clip_range if isinstance(config, ParcelsConfig) else CLIP_RANGE,
            n_steps=config.n_steps,
            batch_size=config.batch_size,
            n_epochs=config.n_epochs,
            learning_rate=learning_rate,
            gamma=config.gamma,
            gae_lambda=config.gae_lambda,
            ent_coef=config.ent_coef,
            policy_kwargs={"net_arch": list(config.hidden)},
            seed=config.seed,
            device="cpu",
        )
    return DoubleDQN(
        "MlpPolicy",
        env,
        learning_rate=learning_rate,
        buffer_size=config.buffer_size,
        learning_starts=config.learning_starts,
        batch_size=config.batch_size,
        n_steps=config.n_steps,
        gradient_steps=config.gradient_steps,
        train_freq=1,
        tau=config.tau,
        target_update_interval=config.lanes,  # in control periods: at every one of all lanes
        gamma=config.gamma,
        exploration_fraction=config.exploration_fraction,
        exploration_final_eps=config.exploration_final_eps,
        max_grad_norm=config.max_grad_norm,
        policy_kwargs={"net_arch": list(config.hidden)},
        seed=config.seed,
        device="cpu",
    )
