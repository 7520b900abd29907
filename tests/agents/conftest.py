"""What tests of policies on slopes share; a search needs Optuna, of the extra `search`."""

from importlib.util import find_spec

import numpy as np
import pytest

from surface_gym.flow import take_away as ta
from surface_gym.vector_env import SmartSurfaceVectorEnv

collect_ignore = [] if find_spec("optuna") else ["test_tuning.py"]


@pytest.fixture(scope="package")
def tables() -> np.ndarray:
    """Tables of some surfaces after some seconds, parcels in them."""
    envs = SmartSurfaceVectorEnv(3, task="singulate", actions="parcels", duration=6.0)
    observation, _ = envs.reset(seed=1)
    for _ in range(80):
        observation, *_ = envs.step(np.full((3, envs.single_action_space.shape[0]), 3))
    found = np.array(observation)
    assert (found[..., ta.COLUMN.present.place].sum(axis=1) > 2).all()
    return found
