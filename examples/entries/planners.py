"""Entry of the benchmark: planners that search with the simulator, from observations only.

surface-gym benchmark --policy examples/entries/planners.py:Planned --kind planner --seconds 3600
"""

from typing import Any

import numpy as np

from surface_gym.agents.planning.belief import BeliefPlanner
from surface_gym.agents.planning.planner import Planner
from surface_gym.config import EnvConfig

LAB = "lab"


class Planned:
    """The planner on exact observations; in the lab, the planner on beliefs.

    Only the first episode of each environment counts, so later episodes are not planned.
    """

    @staticmethod
    def env_kwargs(task: str, preset: str | None) -> dict[str, Any]:
        """Return the arguments of the environment that the planner needs."""
        del task
        return {"actions": "halves", "observe": ["parcel", "load"] if preset == LAB else []}

    def __init__(self, config: EnvConfig, seed: int) -> None:
        del seed
        self._planner: Any = (BeliefPlanner if config.observe else Planner)(config)

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:  # fmt: skip
        """Return actions (num_envs,) for observations (num_envs, features)."""
        num_envs = len(observation)
        memory, ended = ([None] * num_envs, np.zeros(num_envs, bool)) if state is None else state
        ended = ended if state is None else ended | np.asarray(episode_start, dtype=bool)
        actions, going = np.zeros(num_envs, dtype=np.int64), np.nonzero(~ended)[0]
        if len(going):
            known = None if state is None else [memory[i] for i in going]
            actions[going], latest = self._planner.predict(observation[going], known)
            memory = list(memory)
            for i, each in zip(going, latest, strict=True):
                memory[i] = each
        return actions, (memory, ended)
