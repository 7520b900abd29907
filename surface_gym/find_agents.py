"""Where the agents are: `surface_gym.agents` once installed, the folder beside in a checkout.

`from surface_gym import agents` finds them in both.
"""

from importlib import import_module
from pathlib import Path
from types import ModuleType

INSTALLED = "surface_gym.agents"
BESIDE = "agents"
PACKAGE = Path(__file__).parent


def agents_name() -> str:
    """The name that the package of agents is imported by."""
    return INSTALLED if (PACKAGE / BESIDE).is_dir() else BESIDE


def import_agents(module: str = "") -> ModuleType:
    """The package of agents, or a module of it.

    Args:
        module: below the package, as "evaluation.command"; empty: the package itself.

    Raises:
        ImportError: the package or a library of its own is missing, or another has its name.
    """
    name = agents_name()
    package = import_module(name)
    if name == BESIDE and Path(str(package.__file__)).parent != PACKAGE.parent / BESIDE:
        raise ImportError(
            f"agents must be the folder beside {PACKAGE}, got {package.__file__}: another package "
            "of that name is in the way; surface_gym installed from its wheel gets along with it"
        )
    return import_module(f"{name}.{module}") if module else package
