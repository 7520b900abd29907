"""What cannot be done: limits that hold whatever a controller does."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym import checks
from surface_gym.settings import Settings
from surface_gym.state import RUNNING
from surface_gym.tasks import stop

from .known import KnownModel

FAR = 1000.0  # [m] beyond any line: what is not to be passed


def stops_past(
    settings: Settings, starts: Sequence[dict[str, Any]], seed: int
) -> NDArray[np.float64]:
    """How far past the asked x starts of Stop end if every axis is at 0 deg all along.

    Nothing takes more speed from a parcel that runs straight. Where this is more than the task
    allows, only a parcel that could turn onto more rotors might be stopped.

    Args:
        settings: of the environment, with "halves" for actions.
        starts: options of each start; what they leave open is drawn.
        seed: start i draws from `seed` + i.

    Returns:
        (starts,) [m], negative short of it.

    Raises:
        ValueError: another task, or other actions.
    """
    checks.one_of("task", settings.task_name, ("stop",))
    checks.one_of("actions", settings.actions, ("halves",))
    model = KnownModel(settings, 1)
    brake = model.uniform_action(0.0)
    past = []
    for k, options in enumerate(starts):
        model.begin(options, seed + k)
        asked = float(model.parcels.goal[0, stop.POSITION])
        model.parcels.goal[0, stop.POSITION] = FAR
        for _ in range(settings.chosen_task.periods):
            if model.go_on(brake).lanes.outcome[0] != RUNNING:
                break
        past.append(float(model.parcels.truth[0, 0]) - asked)
    return np.array(past)
