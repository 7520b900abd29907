"""Kernels compile for data-centre GPUs, on a machine that has none."""

from types import SimpleNamespace

import numpy as np
import pytest
from numba import typeof, types

from surface_gym.config import EnvConfig
from surface_gym.core.batch import Batch
from surface_gym.flow.batch import StreamBatch
from surface_gym.tasks import TASKS
from tests.cuda.cases import make_config, needs_numba_cuda

pytestmark = [needs_numba_cuda, pytest.mark.usefixtures("assumed_device")]

CAPABILITIES = ((8, 0), (9, 0))  # A100, H100 and H200


@pytest.fixture
def assumed_device(monkeypatch):
    """Answer functions that ask for the device's capability, where there is none."""
    from numba.cuda import dispatcher

    device = SimpleNamespace(compute_capability=CAPABILITIES[0])
    monkeypatch.setattr(dispatcher, "get_current_device", lambda: device)


def strided(kind):
    """Return the type of an argument, its arrays of any layout."""
    if isinstance(kind, types.Array):
        return kind.copy(layout="A")
    if isinstance(kind, types.NamedTuple):
        return types.NamedTuple([strided(each) for each in kind.types], kind.instance_class)
    return kind


def check_ptx(kernel, arguments, opt=True):
    """Compile a kernel for every capability, and return the code of each."""
    from numba import cuda

    signature = types.void(*(strided(typeof(argument)) for argument in arguments))
    found = []
    for major, minor in CAPABILITIES:
        ptx, _ = cuda.compile_ptx(kernel.py_func, signature, cc=(major, minor), opt=opt)
        assert f".target sm_{major}{minor}" in ptx
        assert ".visible .entry" in ptx
        found.append(ptx)
    return found


def order_and_mask():
    return np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.bool_)


@pytest.mark.parametrize("name", TASKS)
def test_every_task_compiles(name):
    from surface_gym.cuda.kernels import step_kernel

    config = make_config(name)
    arguments = (*Batch(config, 2)._arrays, *order_and_mask())
    # One task optimised: that takes the compiler seconds, for the same code.
    for ptx in check_ptx(step_kernel(config), arguments, opt=name == "sort"):
        assert ".local" in ptx  # a thread's scratch


def test_streams_compile():
    from surface_gym.cuda.kernels import make_stream_scratch, stream_capacity, stream_step_kernel

    config = EnvConfig("flow", max_parcels=16)
    task = config.stream_task
    batch = StreamBatch(config, 2, compiles=False)
    one = make_stream_scratch(stream_capacity(config, task.stream.kinds), task.rows)
    scratches = type(one)._make(np.stack([values, values]) for values in one)
    arguments = (*batch._arrays, scratches, *order_and_mask())
    # Not optimised: that takes the compiler half a minute, for the same code.
    check_ptx(stream_step_kernel(config), arguments, opt=False)


def test_placing_compiles():
    from surface_gym.cuda.kernels import place_starts
    from surface_gym.cuda.prefetch import StartRings

    batch = Batch(make_config("track"), 2)
    rings = StartRings(np.zeros((2, 4), dtype=np.int64), *(np.zeros((2, 4, 8)) for _ in range(4)))
    check_ptx(place_starts, (batch.surfaces, batch.parcels, rings, *order_and_mask()))
