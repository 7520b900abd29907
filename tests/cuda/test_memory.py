"""State arrays and scratch as a device holds them, here in tensors of the CPU."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.core.assembly import make_env_params, make_state
from surface_gym.cuda.memory import (
    GRIDS,
    MARK_ROWS,
    TABLE_ROWS,
    kernel_view,
    make_device_state,
    max_contacts,
    scratch_layout,
    task_capacity,
    to_device,
)
from surface_gym.physics import types
from surface_gym.tasks import TASKS
from tests.cuda.cases import every_case, make_config, needs_numba_cuda
from tests.environments import PARCELS

pytestmark = needs_numba_cuda

CPU = torch.device("cpu")
NUM_ENVS = 64


@every_case
def test_device_state_equals_the_cpus_with_environments_adjacent_except_in_grids(name):
    config = make_config(name)
    pairs = zip(make_device_state(config, NUM_ENVS, CPU), make_state(config, NUM_ENVS), strict=True)
    for tensors, arrays in pairs:
        for field, tensor, array in zip(tensors._fields, tensors, arrays, strict=True):
            assert tensor.numel() > 0  # a kernel takes no empty array
            if array.size:
                np.testing.assert_array_equal(tensor, array, field)
                assert tensor.numpy().dtype == array.dtype
            if len(tensor) > 1:  # not shared by all
                assert tensor.stride(0) == (tensor[0].numel() if field in GRIDS else 1), field


def test_a_kernel_sees_the_same_memory():
    tensor = torch.zeros(3, 4)
    view = kernel_view(tensor)
    view[1, 2] = 5.0
    assert tensor[1, 2] == 5.0


def test_numbers_stay_as_they_are():
    params = make_env_params(make_config("sort"))
    assert to_device(params, CPU).timing == params.timing
    assert to_device(params, CPU).outcomes == params.outcomes


@pytest.mark.parametrize("shape", [(0,), (2, 0), (2, 0, 4)])
def test_an_empty_array_becomes_a_zero(shape):
    tensor = to_device(np.zeros(shape), CPU)
    assert tensor.numel() > 0
    assert not tensor.any()


@pytest.mark.parametrize("capacity", [4, 31, 4096])
def test_rows_follow_one_another(capacity):
    layout = scratch_layout(capacity)
    for names, size in ((TABLE_ROWS, "TABLE_SIZE"), (MARK_ROWS, "MARKS_SIZE")):
        rows = [layout[name] for name in names]
        assert rows == list(range(0, capacity * len(rows), capacity))
        assert layout[size] > rows[-1]
    assert layout["TABLE_SIZE"] == layout["KINKS"] + 4 * capacity
    assert (layout["SPANS"], layout["SUPPORTS"]) == (layout["COUNTS"], layout["COUNTS"] + 1)
    assert layout["MARKS_SIZE"] == layout["COUNTS"] + 2


def test_every_constant_that_depends_on_the_capacity_is_among_them():
    larger = {name for name, value in vars(types).items() if isinstance(value, int) and value > 50}
    assert larger <= set(scratch_layout(4))
    assert {"ARM_X", "ROTOR"} <= set(scratch_layout(4))  # the first rows, at 0


@given(
    st.sampled_from(sorted(PARCELS)),
    st.floats(0.0, 2.0 * math.pi),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
    st.sampled_from([(0.1, 0.1), (0.05, 0.1), (0.07, 0.03)]),
)
def test_no_base_covers_more_elements_than_its_capacity(name, theta, x, y, pitches):
    base = PARCELS[name].base
    px, py = pitches
    reach = base.reach + max(pitches)
    points = np.stack(
        np.meshgrid(
            (np.arange(-math.ceil(reach / px), math.ceil(reach / px) + 1) + x) * px,
            (np.arange(-math.ceil(reach / py), math.ceil(reach / py) + 1) + y) * py,
        ),
        axis=-1,
    ).reshape(-1, 2)
    turned = points @ np.array(
        [[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]]
    )
    covered = (base.functions(*(turned + np.array(base.centroid)).T) <= 1e-9).all(axis=0)
    assert covered.sum() <= max_contacts(base, pitches)


@pytest.mark.parametrize("task", TASKS)
def test_the_boxes_of_the_tasks_need_little(task):
    assert 20 <= task_capacity(EnvConfig(task)) <= 40


def test_a_base_of_many_edges_has_room_for_them():
    angles = np.arange(60) * 2.0 * math.pi / 60
    parcel = sg.Parcel(sg.Polygon(0.1 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)))
    assert task_capacity(EnvConfig(task=sg.tasks.Sort(parcels=(parcel,)))) == 60
