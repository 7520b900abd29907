"""Which parcels starts draw."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.utils.seeding import np_random

from surface_gym.core.resets import each_parcel
from surface_gym.parcel import Parcel
from surface_gym.settings import Settings
from surface_gym.tasks.base import Draw


def drawn_parcels(
    settings: Settings, starts: Sequence[dict[str, Any]], seed: int
) -> tuple[Parcel, ...]:
    """The parcel of each start, before the randomisation, as an environment draws it.

    Args:
        settings: of the environment.
        starts: options of each; what they leave open is drawn.
        seed: start k draws from `seed` + k.
    """
    task = settings.chosen_task
    numbers = np.array([np_random(seed + k)[0].random(task.draws) for k in range(len(starts))])
    draw = Draw(numbers, starts, settings.chosen_plant, settings.zone)
    parcels = each_parcel(task.start(draw).parcel, len(starts))
    return tuple(parcels.kinds[kind] for kind in parcels.which.tolist())
