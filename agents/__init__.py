"""Agents: fixed layouts, rules, planners and learned policies, and their comparison.

`names()` lists the shipped agents, `load(name)` loads one, and `read(folder)` reads the policy of a
training run:

    >>> from surface_gym import agents
    >>> "sort-ppo" in agents.names()
    True
"""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .library import load, names, read, seeds
    from .policy import GridPolicy

__all__ = ["GridPolicy", "load", "names", "read", "seeds"]


def __getattr__(name: str) -> Any:
    """Import a public name on first use, so that `import surface_gym.agents` is quick."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    if name == "GridPolicy":
        from .policy import GridPolicy

        return GridPolicy
    from . import library

    return getattr(library, name)
