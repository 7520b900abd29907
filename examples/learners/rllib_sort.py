"""RLlib's PPO on the native vector env of Sort.

pip install -r examples/learners/rllib.txt -e ".[agents]"
python examples/learners/rllib_sort.py
"""

from collections.abc import Callable
from typing import Any

import ray
import torch
from fresh_starts import Act, run, success
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.rl_module.default_model_config import DefaultModelConfig

ROLLOUT = 64 * 64  # control periods: of 64 environments, 64 each


def ppo(steps: int, rollout: int, seed: int) -> PPOConfig:
    """Configure PPO with a small network and a learning rate that falls to 0, in this process."""
    ray.init(address="local", num_cpus=1, include_dashboard=False)
    torch.set_num_threads(1)  # the network is small
    network = DefaultModelConfig([64, 64], fcnet_activation="tanh", vf_share_layers=False)
    config = PPOConfig().debugging(seed=seed).rl_module(model_config=network)
    return config.training(
        train_batch_size_per_learner=rollout,
        minibatch_size=rollout // 4,
        num_epochs=5,
        lr=[[0, 1e-3], [steps, 0.0]],
        gamma=0.99,
        lambda_=0.95,
        clip_param=0.2,
        vf_clip_param=1e6,
        use_kl_loss=False,
        entropy_coeff=0.005,
        grad_clip=0.5,
    )


def train(config: PPOConfig, steps: int, rollout: int, policy: str) -> Callable[[Any], Any]:
    """Train; return a function from observations (num_envs, features) to logits of actions."""
    algo = config.build_algo()
    for turn in range(-(-steps // rollout)):
        report = algo.train()
        if turn % 25 == 0:
            mean = report["env_runners"]["episode_return_mean"]
            loss = report["learners"][policy]["total_loss"]
            print(f"{(turn + 1) * rollout:8} periods: return {mean:.2f}, loss {loss:.3f}")
    module: Any = algo.get_module(policy)
    algo.stop()
    odds = "action_dist_inputs"
    return lambda seen: module.forward_inference({"obs": torch.from_numpy(seen)})[odds]


def learn(steps: int, seed: int) -> Act:
    """Train for `steps` control periods; return the policy."""
    config = ppo(steps, ROLLOUT, seed)
    config.environment("SmartSurface/Sort-v0", env_config={"actions": "halves"})
    config.env_runners(
        num_env_runners=0,
        num_envs_per_env_runner=64,
        gym_env_vectorize_mode="vector_entry_point",
        rollout_fragment_length=64,
    )
    logits = train(config, steps, ROLLOUT, "default_policy")
    return lambda seen: logits(seen).argmax(dim=1).numpy()


def main() -> None:
    """Train, and run the policy with its most likely actions on fresh starts."""
    run(learn, success, 2_500_000, "ray")


if __name__ == "__main__":
    main()
