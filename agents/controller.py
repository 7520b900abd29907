"""What every controller can do, whether it learned or not."""

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


class Controller(Protocol):
    """Decides axes from what the sensors say."""

    def predict(
        self, observation: NDArray[np.float32], deterministic: bool = True
    ) -> tuple[Any, None]:
        """Action for an observation (features,), or actions for (lanes, features); and no state."""
