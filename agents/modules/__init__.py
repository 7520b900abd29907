"""One agent for surfaces of any size: each module chooses its own axis, by weights all share."""

from agents.modules.config import ModulesConfig
from agents.modules.policy import ModulesPolicy, load_modules
from agents.modules.training import train_modules

__all__ = ["ModulesConfig", "ModulesPolicy", "load_modules", "train_modules"]
