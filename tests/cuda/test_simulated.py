"""In Numba's CUDA simulator, which runs kernels as plain Python, the device's vector env equals the
CPU's to the bit.

The simulator is chosen as Numba is imported, so the comparison runs in a process of its own:
`NUMBA_ENABLE_CUDASIM=1 python -m tests.cuda.test_simulated NAME...` prints their differences.
"""

import json
import sys
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode

import surface_gym as sg
from surface_gym.flow.batch import list_figures
from surface_gym.flow.task import Flow
from surface_gym.vector_env import make_device_env
from tests.cuda.cases import CASES, STREAMS, needs_numba_cuda, sample_actions
from tests.environments import run_python

LIMIT, PERIODS = 4, 9  # control periods of an episode, and of a comparison
COUNTS = {**dict.fromkeys(CASES, 3), **dict.fromkeys(STREAMS, 2)}  # of environments
FINAL = {"final_obs", "final_info", "_final_obs", "_final_info"}
FIGURES = list_figures(Flow())
HOST_ONLY = {*FIGURES, *(f"_{name}" for name in FIGURES)}


@pytest.fixture(scope="module")
def differences(request):
    """Differences of the cases whose tests run."""
    items = (each for each in request.session.items if each.path == request.path)
    names = [each.callspec.params["name"] for each in items]
    module = "tests.cuda.test_simulated"
    return json.loads(run_python("-W", "error", "-m", module, *names, NUMBA_ENABLE_CUDASIM="1"))


@needs_numba_cuda
@pytest.mark.parametrize("name", COUNTS)
def test_the_device_equals_the_cpu(differences, name):
    assert differences[name] == []


class Comparison:
    """The same episodes on the CPU and on a device: differences are kept in `found`."""

    def __init__(self, name: str, **arguments: Any) -> None:
        num_envs = COUNTS[name]
        self.cpu = sg.SmartSurfaceVectorEnv(num_envs=num_envs, **arguments)
        self.device = make_device_env(num_envs, "cpu", **arguments)
        self.found: list[str] = []
        self.reset("reset", seed=3)

    def reset(self, place: str, **arguments: Any) -> None:
        self._compare(self.cpu.reset(**arguments), self.device.reset(**arguments), place)

    def step(self, action: np.ndarray, place: str) -> dict[str, Any]:
        expected = self.cpu.step(action)
        self._compare(expected, self.device.step(torch.from_numpy(action)), place)
        return expected[4]

    def _compare(self, expected: Any, given: Any, place: str) -> None:
        if isinstance(expected, tuple):
            for k, pair in enumerate(zip(expected, given, strict=True)):
                self._compare(*pair, f"{place} {k}")
        elif isinstance(expected, dict):
            expected = {n: value for n, value in expected.items() if n not in HOST_ONLY}
            if set(expected) - FINAL != set(given) - FINAL:
                self.found.append(f"{place}: {sorted(set(expected) ^ set(given))} in one only")
            else:
                for name in set(expected) - FINAL:
                    self._compare(expected[name], given[name], f"{place} {name}")
                self._compare_final(expected, given, place)
        else:
            if expected.dtype == object:
                given = np.array(self.device.outcomes, dtype=object)[given.numpy()]
            if not np.array_equal(expected, given):
                self.found.append(f"{place}: {expected} is {given}")

    def _compare_final(self, expected: dict[str, Any], given: dict[str, Any], place: str) -> None:
        """Compare the episodes that ended in a step."""
        if "final_obs" not in expected:
            if "_final_obs" in given and given["_final_obs"].any():
                self.found.append(f"{place}: episodes ended")
            return
        ended = expected["_final_obs"]
        last = np.stack(expected["final_obs"][ended]), given["final_obs"].numpy()[ended]
        self._compare(ended, given["_final_obs"], f"{place} _final_obs")
        self._compare(*last, f"{place} final_obs")
        self._compare(expected["final_info"], given["final_info"], f"{place} final_info")


def compare_parcels(name: str, mode: AutoresetMode) -> list[str]:
    both = Comparison(name, max_episode_steps=LIMIT, autoreset_mode=mode, **CASES[name])
    num_envs = COUNTS[name]
    for period, action in enumerate(sample_actions(both.cpu, PERIODS)):
        place = f"period {period}"
        if period == LIMIT + 3:  # one environment, in the middle of its episode
            mask = np.arange(num_envs) == 1
            both.reset(place, options={"reset_mask": mask, "speed": 0.9})
        elif mode == AutoresetMode.DISABLED and period == LIMIT:
            both.reset(place, options={"reset_mask": np.ones(num_envs, dtype=np.bool_)})
        else:
            both.step(action, place)
    both.device.close()
    return both.found


def compare_streams(name: str, mode: AutoresetMode) -> list[str]:
    arguments = STREAMS[name]
    both = Comparison(name, autoreset_mode=mode, **arguments)
    periods = round(1.5 * arguments["duration"] / arguments["control_period"])
    touches = 0
    for period, action in enumerate(sample_actions(both.cpu, periods)):
        infos = both.step(action, f"period {period}")
        touches = max(touches, int(infos["touches"].max()))
    return both.found if touches else [*both.found, "no parcels touched"]


def main() -> None:
    modes, found = list(AutoresetMode), {}
    for cases, compare, count in ((CASES, compare_parcels, 3), (STREAMS, compare_streams, 2)):
        for k, name in enumerate(cases):
            if name in sys.argv:
                found[name] = compare(name, modes[k % count])
    print(json.dumps(found))


if __name__ == "__main__":
    main()
