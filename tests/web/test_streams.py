"""Streams of parcels in a WebAssembly module equal those on the CPU to the bit."""

import pytest

from surface_gym.config import EnvConfig

pytest.importorskip("wasmtime", reason="wasmtime is not installed (extra 'web')")

from benchmarks.web import ARGUMENTS, Twins
from surface_gym.flow.state import CORRECT, TOUCHES
from tests.environments import STREAMS


@pytest.mark.parametrize("task", STREAMS)
def test_a_stream_is_equal_in_which_parcels_touch_or_leave(task, modules):
    config = EnvConfig(task, **ARGUMENTS.get(task, {}))
    twins = Twins(config, 1, file=modules / f"{task}.wasm")
    twins.begin()
    assert twins.differences() == []
    for period in range(120):
        assert twins.step(twins.sample()) == 0
        if period % 20 == 19:
            assert twins.differences() == []
        if twins.are_over:
            break
    assert twins.batch.streams.tally[0, [CORRECT, TOUCHES]].any()
    assert twins.differences() == []
