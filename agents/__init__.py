"""Everything that decides axes: fixed layouts, rules, a planner, agents that learn, their files and
their comparison.

`names()` lists the agents that come with the package, `load(name)` gives one to act, and
`read(folder)` one of your own:

    >>> import agents
    >>> "sort-ppo" in agents.names()
    True
"""

from .library import load, names, read, seeds

__all__ = ["load", "names", "read", "seeds"]
