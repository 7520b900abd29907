"""How a batch's memory lies on a device, here in tensors of the CPU."""

import numpy as np
import pytest
import torch

from surface_gym.batch.making import memory_of, rules_of
from surface_gym.gpu.memory import GRIDS, make_memory, seen, to_device
from tests.gpu.cases import every_case, needs_numba_cuda, settings_of

pytestmark = needs_numba_cuda

CPU = torch.device("cpu")
LANES = 64


@every_case
def test_lanes_lie_side_by_side_but_for_grids_which_lie_together(name):
    surfaces, lanes = make_memory(settings_of(name), LANES, CPU)
    for field, values in (*surfaces._asdict().items(), *lanes._asdict().items()):
        if len(values) == 1:  # the same for all
            continue
        neighbour = values.stride(0)
        assert neighbour == (values[0].numel() if field in GRIDS else 1), field


@every_case
def test_it_holds_what_the_cpus_does(name):
    settings = settings_of(name)
    pairs = zip(make_memory(settings, LANES, CPU), memory_of(settings, LANES), strict=True)
    for here, there in pairs:
        for field, one, other in zip(here._fields, here, there, strict=True):
            if other.size:
                np.testing.assert_array_equal(one, other, field)
                assert one.numpy().dtype == other.dtype


@every_case
def test_no_array_that_a_kernel_takes_is_empty(name):
    settings = settings_of(name)
    for part in (*make_memory(settings, LANES, CPU), to_device(rules_of(settings), CPU)):
        assert all(values.numel() for values in part if torch.is_tensor(values))


def test_a_kernel_sees_the_same_memory():
    tensor = torch.zeros(3, 4)
    view = seen(tensor)
    view[1, 2] = 5.0
    assert tensor[1, 2] == 5.0


def test_what_is_no_array_stays_as_it_is():
    rules = rules_of(settings_of("sort"))
    assert to_device(rules, CPU).timing == rules.timing
    assert to_device(rules, CPU).outcomes == rules.outcomes


@pytest.mark.parametrize("shape", [(0,), (2, 0), (2, 0, 4)])
def test_what_is_empty_gets_a_zero(shape):
    tensor = to_device(np.zeros(shape), CPU)
    assert tensor.numel() > 0
    assert not tensor.any()
