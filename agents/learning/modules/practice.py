"""What modules practise on: lanes of Sort in a row, each begun anew when its episode ends."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...modules.outline import Numbers
from ...modules.view import Integers, Singles
from ..config import ModulesConfig
from ..practice import make_lanes

Booleans = NDArray[np.bool_]


class Moved(NamedTuple):
    """What a control period brought."""

    observations: Singles  # (lanes, features) of the next start where an episode ended
    rewards: Numbers  # (lanes,)
    terminated: Booleans  # (lanes,) ended by success or failure
    ended: Booleans  # (lanes,) or ran out of time
    last: Singles  # (lanes, features) seen at the period's end, of the episode that ended too
    infos: list[dict[str, Any]]  # of the episodes that ended, as SurfaceVecEnv gives them


class Practice:
    """The lanes a configuration asks for.

    Args:
        config: of the run.
    """

    def __init__(self, config: ModulesConfig) -> None:
        self._lanes = make_lanes(config)

    def reset(self, seed: int) -> Singles:
        """Start all lanes, lane i from `seed` + i; observations (lanes, features)."""
        self._lanes.seed(seed)
        return np.asarray(self._lanes.reset())

    def step(self, actions: Integers) -> Moved:
        """Move all lanes by one control period."""
        observations, rewards, ended, infos = self._lanes.step(actions)
        seen = np.asarray(observations)
        last, terminated = seen.copy(), ended.copy()
        for lane in np.nonzero(ended)[0]:
            last[lane] = infos[lane]["terminal_observation"]
            terminated[lane] = not infos[lane]["TimeLimit.truncated"]
        return Moved(seen, rewards.astype(np.float64), terminated, ended, last, infos)
