"""In Numba's CUDA simulator, which runs kernels as plain Python, a thread a lane, the device's
vector env gives what the CPU's does, to the bit.
"""

import json
import os
import subprocess
import sys

import pytest

from tests.cuda.cases import every_case_and_flow, needs_numba_cuda

pytestmark = needs_numba_cuda


@pytest.fixture(scope="module")
def found() -> dict[str, list[str]]:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", "tests.cuda.simulated"],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "NUMBA_ENABLE_CUDASIM": "1"},  # read as Numba is imported
    )
    assert done.returncode == 0, done.stderr
    differences: dict[str, list[str]] = json.loads(done.stdout)
    return differences


@every_case_and_flow
def test_the_device_gives_what_the_cpu_does(found, name):
    assert found[name] == []
