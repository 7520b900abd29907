"""Functions are translated for less scratch, and compile for data-centre GPUs where there is none.

`test_simulated.py` holds what they do against the compiled ones.
"""

from types import SimpleNamespace

import numpy as np
import pytest
from numba import typeof, types as numba_types

from surface_gym.compiler.jit import inlined
from surface_gym.compiler.translator import Translator
from surface_gym.config import EnvConfig
from surface_gym.cuda import has_numba_cuda
from surface_gym.cuda.memory import scratch_layout
from surface_gym.flow.batch import StreamBatch
from surface_gym.physics import types
from surface_gym.tasks import TASKS
from tests.cuda.cases import UncompiledBatch, make_config


def make_translator():
    return Translator(lambda copy, _: copy, scratch_layout(8), types)


def test_a_function_is_translated_once_with_those_it_calls():
    translator = make_translator()
    translated = translator.translate(twice)
    assert translated is translator.translate(twice)
    assert translated(3) == 2 * (3 + 8)
    assert translated.__globals__["once"] is translator.translate(once)
    assert twice.py_func.__globals__["once"] is once  # the original is as before


def test_only_constants_of_the_scratch_are_replaced_and_functions_may_call_themselves():
    translator = make_translator()
    assert translator.translate(other_constant)() == "mine"
    assert translator.translate(make_closure(ARM_Y))() == 8
    assert make_translator().translate(factorial)(5) == 120


CAPACITY = types.CAPACITY
ARM_Y = types.ARM_Y
NORMAL = "mine"


@inlined
def once(value):
    return value + CAPACITY


@inlined
def twice(value):
    return 2 * once(value)


@inlined
def other_constant():
    return NORMAL


@inlined
def factorial(n):
    return 1 if n < 2 else n * factorial(n - 1)


def make_closure(ARM_Y):
    @inlined
    def row():
        return ARM_Y

    return row


CAPABILITIES = ((8, 0), (9, 0))  # A100, H100 and H200
ORDER_AND_MASK = np.zeros(2, dtype=np.int64), np.zeros(2, dtype=np.bool_)


def strided(kind):
    """Return the type of an argument, its arrays of any layout."""
    if isinstance(kind, numba_types.Array):
        return kind.copy(layout="A")
    if isinstance(kind, numba_types.NamedTuple):
        return numba_types.NamedTuple([strided(each) for each in kind.types], kind.instance_class)
    return kind


def check_ptx(kernel, arguments, opt=True):
    """Compile a kernel for every capability, and return the code of each."""
    from numba import cuda

    signature = numba_types.void(*(strided(typeof(argument)) for argument in arguments))
    found = []
    for major, minor in CAPABILITIES:
        ptx, _ = cuda.compile_ptx(kernel.py_func, signature, cc=(major, minor), opt=opt)
        assert f".target sm_{major}{minor}" in ptx
        assert ".visible .entry" in ptx
        found.append(ptx)
    return found


@pytest.mark.skipif(not has_numba_cuda(), reason="numba.cuda is not numba-cuda's (extra 'gpu')")
class TestPtx:
    @pytest.fixture(autouse=True)
    def _assumed_device(self, monkeypatch):
        """Answer functions that ask for the device's capability, where there is none."""
        from numba.cuda import dispatcher

        device = SimpleNamespace(compute_capability=CAPABILITIES[0])
        monkeypatch.setattr(dispatcher, "get_current_device", lambda: device)

    @pytest.mark.parametrize("name", TASKS)
    def test_every_task_compiles(self, name):
        from surface_gym.cuda.kernels import step_kernel

        config = make_config(name)
        arguments = (*UncompiledBatch(config, 2)._arrays, *ORDER_AND_MASK)
        # One task optimised: that takes the compiler seconds, for the same code.
        for ptx in check_ptx(step_kernel(config), arguments, opt=name == "sort"):
            assert ".local" in ptx  # a thread's scratch

    def test_streams_compile(self):
        from surface_gym.cuda import kernels

        config = EnvConfig("flow", max_parcels=16)
        task = config.stream_task
        batch = StreamBatch(config, 2, compiles=False)
        capacity = kernels.stream_capacity(config, task.stream.kinds)
        one = kernels.make_stream_scratch(capacity, task.rows)
        scratches = type(one)._make(np.stack([values, values]) for values in one)
        arguments = (*batch._arrays, scratches, *ORDER_AND_MASK)
        # Not optimised: that takes the compiler half a minute, for the same code.
        check_ptx(kernels.stream_step_kernel(config), arguments, opt=False)

    def test_placing_compiles(self):
        from surface_gym.cuda.kernels import place_starts
        from surface_gym.cuda.prefetch import StartRings

        batch = UncompiledBatch(make_config("track"), 2)
        values = (np.zeros((2, 4, 8)) for _ in range(4))
        rings = StartRings(np.zeros((2, 4), dtype=np.int64), *values)
        check_ptx(place_starts, (batch.surfaces, batch.parcels, rings, *ORDER_AND_MASK))
