"""The environments that the tests of the GPU's batch loop over: every task, and among them kinds of
action and ways in which axes obey. Other tests compile the same for the CPU: it takes seconds each.
"""

from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest

from surface_gym.config import EnvConfig
from surface_gym.randomisation import Actuators
from surface_gym.registration import env_id
from surface_gym.tasks import TASKS
from tests.flow.flows import DENSE, SHORT

SETTINGS: dict[str, dict[str, Any]] = {
    "sort": {"actions": "halves", "orientations": "any"},
    "slow": {"actions": "window"},
    "stop": {"actions": "halves", "actuators": Actuators(stuck=((10, 12), (9, 13)))},
}
TURNING: dict[str, Any] = {"actions": "modules", "actuators": Actuators(axis_speed=8.0)}
# By name: the task and the environment's settings.
CASES: dict[str, tuple[str, dict[str, Any]]] = {
    **{task: (task, SETTINGS.get(task, {})) for task in TASKS},
    "axes that turn": ("sort", TURNING),
}
# Short lines with more parcels than can pass: some touch.
DENSE_FLOW: dict[str, Any] = {
    "line": SHORT, "stream": DENSE, "places": 6, "duration": 0.8, "control_period": 0.04,
}  # fmt: skip
FLOWS: dict[str, dict[str, Any]] = {
    "a flow of modules": {**DENSE_FLOW, "actions": "modules"},
    "a flow of parcels": {**DENSE_FLOW, "actions": "parcels"},
}
every_case = pytest.mark.parametrize("name", CASES)
every_case_and_flow = pytest.mark.parametrize("name", [*CASES, *FLOWS])
needs_numba_cuda = pytest.mark.skipif(
    find_spec("numba_cuda") is None, reason="numba-cuda is not installed (extra 'gpu')"
)


def settings_of(name: str) -> EnvConfig:
    task, settings = CASES[name]
    return EnvConfig(task=task, **settings)


def id_of(name: str) -> str:
    return env_id(CASES[name][0])


def actions_of(env: Any, periods: int, seed: int = 0) -> list[np.ndarray]:
    """Random actions of all lanes for some control periods."""
    env.action_space.seed(seed)
    return [np.asarray(env.action_space.sample()) for _ in range(periods)]
