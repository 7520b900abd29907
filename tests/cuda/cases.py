"""Environments that the tests of the GPU's batches loop over: every task, and among them kinds of
action and of actuator. Other tests compile the same for the CPU, which takes seconds each.
"""

from importlib.util import find_spec
from typing import Any

import numpy as np
import pytest

from surface_gym.config import EnvConfig
from surface_gym.core.batch import Batch
from surface_gym.randomisation import Actuators
from surface_gym.tasks import TASKS
from tests.flow.flows import DENSE, SHORT

ARGUMENTS: dict[str, dict[str, Any]] = {
    "sort": {"actions": "quadrants", "orientations": "any"},
    "slow": {"actions": "window"},
    "stop": {"actions": "halves", "actuators": Actuators(stuck=((10, 12), (9, 13)))},
}
# By name: the environment's arguments.
CASES: dict[str, dict[str, Any]] = {
    **{task: {"task": task, **ARGUMENTS.get(task, {})} for task in TASKS},
    "axes that turn": {
        "task": "sort", "actions": "quadrants", "actuators": Actuators(axis_speed=8.0),
    },
    "axes that wait": {
        "task": "sort", "actions": "quadrants",
        "actuators": Actuators(8.0, turns_loaded=False, step=0.12, backlash=0.05),
    },
    "driven modules": {"task": "sort", "actions": "halves", "modules": "steered"},
}  # fmt: skip
# Short lines with more parcels than can pass: some touch.
DENSE_STREAM: dict[str, Any] = {
    "task": "flow", "line": SHORT, "stream": DENSE, "max_parcels": 6, "duration": 0.8,
    "control_period": 0.04, "tilt": 0.03, "tilt_direction": 0.6,
}  # fmt: skip
STREAMS: dict[str, dict[str, Any]] = {
    "a stream of modules": {**DENSE_STREAM, "actions": "modules"},
    "a stream of parcels": {**DENSE_STREAM, "actions": "parcels"},
    "a stream at a gate": {**DENSE_STREAM, "actions": "parcels", "gate": True, "queue": 3},
}
every_case = pytest.mark.parametrize("name", CASES)
needs_numba_cuda = pytest.mark.skipif(
    find_spec("numba_cuda") is None, reason="numba-cuda is not installed (extra 'gpu')"
)


class UncompiledBatch(Batch):
    """Draws starts and steps nothing, so that nothing is compiled."""

    def _compile(self) -> None:
        return None


def make_config(name: str) -> EnvConfig:
    return EnvConfig(**CASES[name])


def sample_actions(env: Any, periods: int, seed: int = 0) -> list[np.ndarray]:
    """Sample random actions of all environments for some control periods."""
    env.action_space.seed(seed)
    return [np.asarray(env.action_space.sample()) for _ in range(periods)]
