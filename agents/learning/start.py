"""A run by the algorithm that its configuration names."""

from pathlib import Path

from .config import DQNConfig, ModulesConfig, PPOConfig, TrainConfig, on_device
from .device.training import train_on_device
from .legs import Learned, Progress
from .modules.training import train_modules
from .training import train


def start(config: TrainConfig, folder: Path, progress: Progress) -> Learned:
    """Learn as the configuration says, from a checkpoint in the folder if there is one.

    Raises:
        ValueError: the checkpoint is damaged, or of another configuration; or the device cannot be
            used.
    """
    if isinstance(config, ModulesConfig):
        return train_modules(config, folder, progress)
    if on_device(config):
        return train_on_device(config, folder, progress)
    assert isinstance(config, PPOConfig | DQNConfig)
    return train(config, folder, progress)
