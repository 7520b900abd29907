"""rl-baselines3-zoo's PPO on the native vector env of Sort.

Hyper-parameters are in agents/hyperparams/ppo.yml, but with 64 environments as in other learners.

pip install -r examples/learners/zoo.txt -e ".[agents]"
python examples/learners/zoo.py
"""

import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from fresh_starts import Act, run, success
from gymnasium.vector import AutoresetMode
from rl_zoo3.exp_manager import ExperimentManager
from rl_zoo3.train import train
from stable_baselines3 import PPO

from surface_gym import SmartSurfaceVectorEnv
from surface_gym.agents.vec_env import SurfaceVecEnv

YAML = Path(__file__).parents[2] / "agents" / "hyperparams" / "ppo.yml"


class NativeVecEnv(SurfaceVecEnv):
    """A vector env in place of the zoo's single environments, configured like the first one."""

    def __init__(self, makers: list[Callable[[], Any]]) -> None:
        single = makers[0]()
        env = SmartSurfaceVectorEnv(
            num_envs=len(makers),
            max_episode_steps=single.spec.max_episode_steps,
            autoreset_mode=AutoresetMode.SAME_STEP,
            **single.unwrapped.config.arguments(),
        )
        single.close()
        super().__init__(env)


def learn(steps: int, seed: int) -> Act:
    """Run the zoo's command, `python -m rl_zoo3.train`; return the policy from its folder."""
    ExperimentManager.default_vec_env_cls = NativeVecEnv  # else single environments, one by one
    with TemporaryDirectory() as folder:
        sys.argv = ["train", "--algo", "ppo", "--env", "SmartSurface/Sort-v0"]
        sys.argv += ["--conf-file", str(YAML), "--n-timesteps", str(steps), "--eval-freq", "-1"]
        sys.argv += ["--hyperparams", "n_envs:64", "n_steps:64", "batch_size:1024"]
        sys.argv += ["--seed", str(seed), "--num-threads", "1", "--log-folder", folder]
        train()
        model = PPO.load(next(Path(folder).rglob("SmartSurface-Sort-v0.zip")), device="cpu")
    return lambda seen: model.predict(seen, deterministic=True)[0]


def main() -> None:
    """Train, and run the policy with its most likely actions on fresh starts."""
    run(learn, success, 2_500_000, "rl_zoo3", "stable_baselines3")


if __name__ == "__main__":
    main()
