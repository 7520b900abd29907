"""Kernels compile for data-centre GPUs, on a machine that has none."""

from types import SimpleNamespace

import numpy as np
import pytest
from numba import typeof, types

from surface_gym.config import EnvConfig
from surface_gym.core.batch import Batch
from surface_gym.flow.batch import StreamBatch
from surface_gym.tasks import TASKS
from tests.cuda.cases import needs_numba_cuda, settings_of

pytestmark = needs_numba_cuda

CAPABILITIES = ((8, 0), (9, 0))  # A100, H100 and H200


@pytest.fixture
def without_a_device(monkeypatch):
    """Functions that kernels call ask for the device at hand; none is, so it is made up."""
    from numba.cuda import dispatcher

    device = SimpleNamespace(compute_capability=CAPABILITIES[0])
    monkeypatch.setattr(dispatcher, "get_current_device", lambda: device)


def strided(kind):
    """The type of an argument, its arrays of any layout."""
    if isinstance(kind, types.Array):
        return kind.copy(layout="A")
    if isinstance(kind, types.NamedTuple):
        return types.NamedTuple([strided(each) for each in kind.types], kind.instance_class)
    return kind


def ptx_of(kernel, arguments, capability, opt=True):
    from numba import cuda

    signature = types.void(*(strided(typeof(argument)) for argument in arguments))
    ptx, _ = cuda.compile_ptx(kernel.py_func, signature, cc=capability, opt=opt)
    return ptx


@pytest.mark.usefixtures("without_a_device")
@pytest.mark.parametrize("name", TASKS)
def test_every_task_compiles_for_every_capability(name):
    from surface_gym.cuda.kernels import move_kernel

    settings = settings_of(name)
    batch = Batch(settings, 2)
    order, mask = np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.bool_)
    kernel = move_kernel(settings)
    for major, minor in CAPABILITIES:
        # One as it is made fast: that takes the compiler seconds, and no other code.
        fast = name == "sort"
        ptx = ptx_of(kernel, (*batch._arrays, order, mask), (major, minor), opt=fast)
        assert f".target sm_{major}{minor}" in ptx
        assert ".visible .entry" in ptx
        assert ".local" in ptx  # a thread's scratch


@pytest.mark.usefixtures("without_a_device")
def test_a_flow_compiles_for_every_capability():
    from surface_gym.cuda.kernels import make_scratch, move_flow_kernel, stream_capacity

    settings = EnvConfig(places=16)
    flows = StreamBatch(settings, 2)
    one = make_scratch(stream_capacity(settings, settings.stream.kinds), settings.rows)
    scratches = type(one)._make(np.stack([values, values]) for values in one)
    memory = (flows.surfaces, flows.lanes, flows.sites, flows.flows, scratches)
    order, mask = np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.bool_)
    arguments = (flows.rules, flows.flow_rules, *memory, order, mask)
    for major, minor in CAPABILITIES:
        # As it is written: to make it fast takes the compiler half a minute, and no other code.
        ptx = ptx_of(move_flow_kernel(settings), arguments, (major, minor), opt=False)
        assert f".target sm_{major}{minor}" in ptx


@pytest.mark.usefixtures("without_a_device")
def test_placing_compiles():
    from surface_gym.cuda.kernels import place
    from surface_gym.cuda.prefetch import Starts

    batch = Batch(settings_of("track"), 2)
    starts = Starts(np.zeros((2, 4), dtype=np.int64), *(np.zeros((2, 4, 8)) for _ in range(4)))
    taken, mask = np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.bool_)
    for capability in CAPABILITIES:
        assert ".visible .entry" in ptx_of(
            place, (batch.surfaces, batch.parcels, starts, taken, mask), capability
        )
