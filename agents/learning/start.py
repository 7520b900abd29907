"""A run by the algorithm that its configuration names."""

from pathlib import Path

from agents.learning.config import DQNConfig, ModulesConfig, PPOConfig, TrainConfig
from agents.learning.legs import Learned, Progress
from agents.learning.modules.training import train_modules
from agents.learning.training import train


def start(config: TrainConfig, folder: Path, progress: Progress) -> Learned:
    """Learn as the configuration says, from a checkpoint in the folder if there is one.

    Raises:
        ValueError: the checkpoint is damaged, or of another configuration.
    """
    if isinstance(config, ModulesConfig):
        return train_modules(config, folder, progress)
    assert isinstance(config, PPOConfig | DQNConfig)
    return train(config, folder, progress)
