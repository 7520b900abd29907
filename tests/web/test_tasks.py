"""WebAssembly modules of environments equal those on the CPU to the bit, in all their arrays."""

from typing import Any

import pytest

from surface_gym.config import EnvConfig
from surface_gym.flow.state import CORRECT, TOUCHES
from surface_gym.randomisation import Actuators
from surface_gym.tasks import TASKS
from tests.environments import STREAMS

pytest.importorskip("wasmtime", reason="wasmtime is not installed (extra 'web')")

from benchmarks.web import ARGUMENTS as CROWDED, Twins

PERIODS = 120  # in which parcels of Sort have left, and others come
# One of them with a camera, and axes that take their time.
ARGUMENTS: dict[str, dict[str, Any]] = {"slow": {"preset": "lab", "actions": "halves"}}


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("driven", {"modules": "omni"}),
        ("driven", {"modules": "steered"}),
        ("limits", {"actuators": Actuators(9.0, turns_loaded=False, step=0.12, backlash=0.05)}),
    ],
)
def test_driven_modules_are_equal_too(name, given, modules):
    config = EnvConfig("sort", actions="halves", **given)
    twins = Twins(config, 2, file=modules / f"sort-{name}.wasm")
    twins.begin()
    assert not twins.differences()
    for _ in range(30):
        assert twins.step(twins.sample()) == 0
        assert not twins.differences()


@pytest.mark.parametrize("task", TASKS)
def test_episodes_are_equal_from_their_starts_to_their_ends(task, modules):
    config = EnvConfig(task, **ARGUMENTS.get(task, {}))
    twins = Twins(config, 2, file=modules / f"{'-'.join([task, *ARGUMENTS.get(task, {})])}.wasm")
    episodes = 0
    for period in range(PERIODS):
        if period == 0 or twins.are_over:
            twins.begin()
            episodes += 1
        else:
            assert twins.step(twins.sample()) == 0
        assert twins.differences() == []
    assert episodes > 1 or task != "sort"


@pytest.mark.parametrize("task", STREAMS)
def test_a_stream_is_equal_in_which_parcels_touch_or_leave(task, modules):
    config = EnvConfig(task, **CROWDED.get(task, {}))
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
