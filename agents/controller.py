"""What every controller can do, whether it learned or not."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


class Controller(Protocol):
    """Decides axes from what the sensors say, as Stable-Baselines3's models do."""

    def predict(
        self,
        observation: NDArray[np.float32],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = True,
    ) -> tuple[Any, Any]:
        """Action for an observation (features,), or actions for (lanes, features); and the state.

        Args:
            observation: one, or one a lane.
            state: what the last call gave; None at first, and always for one without memory.
            episode_start: (lanes,) whether an episode has just begun; None: only if `state` is.
            deterministic: choose the best action, or draw one.
        """
