"""How a batch's memory lies on a device, here in tensors of the CPU."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.core.assembly import make_rules, make_state
from surface_gym.cuda.memory import (
    GRIDS,
    ROWS_OF_MARKS,
    ROWS_OF_TABLE,
    capacity_of,
    layout,
    make_memory,
    most_contacts,
    seen,
    to_device,
)
from surface_gym.physics import types
from surface_gym.tasks import TASKS
from tests.cuda.cases import every_case, needs_numba_cuda, settings_of
from tests.environments import PARCELS

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
    pairs = zip(make_memory(settings, LANES, CPU), make_state(settings, LANES), strict=True)
    for here, there in pairs:
        for field, one, other in zip(here._fields, here, there, strict=True):
            if other.size:
                np.testing.assert_array_equal(one, other, field)
                assert one.numpy().dtype == other.dtype


@every_case
def test_no_array_that_a_kernel_takes_is_empty(name):
    settings = settings_of(name)
    for part in (*make_memory(settings, LANES, CPU), to_device(make_rules(settings), CPU)):
        assert all(values.numel() for values in part if torch.is_tensor(values))


def test_a_kernel_sees_the_same_memory():
    tensor = torch.zeros(3, 4)
    view = seen(tensor)
    view[1, 2] = 5.0
    assert tensor[1, 2] == 5.0


def test_what_is_no_array_stays_as_it_is():
    rules = make_rules(settings_of("sort"))
    assert to_device(rules, CPU).timing == rules.timing
    assert to_device(rules, CPU).outcomes == rules.outcomes


@pytest.mark.parametrize("shape", [(0,), (2, 0), (2, 0, 4)])
def test_what_is_empty_gets_a_zero(shape):
    tensor = to_device(np.zeros(shape), CPU)
    assert tensor.numel() > 0
    assert not tensor.any()


@pytest.mark.parametrize("capacity", [4, 31, 4096])
def test_rows_follow_one_another(capacity):
    places = layout(capacity)
    for names, size in ((ROWS_OF_TABLE, "TABLE_SIZE"), (ROWS_OF_MARKS, "MARKS_SIZE")):
        rows = [places[name] for name in names]
        assert rows == list(range(0, capacity * len(rows), capacity))
        assert places[size] > rows[-1]
    assert places["TABLE_SIZE"] == places["KINKS"] + 4 * capacity
    assert (places["SPANS"], places["SUPPORTS"]) == (places["COUNTS"], places["COUNTS"] + 1)
    assert places["MARKS_SIZE"] == places["COUNTS"] + 2


def test_every_constant_that_depends_on_the_capacity_is_among_them():
    larger = {name for name, value in vars(types).items() if isinstance(value, int) and value > 50}
    assert larger <= set(layout(4))
    assert {"ARM_X", "ROTOR"} <= set(layout(4))  # the first rows, at 0


@given(
    st.sampled_from(sorted(PARCELS)),
    st.floats(0.0, 2.0 * math.pi),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
    st.sampled_from([(0.1, 0.1), (0.05, 0.1), (0.07, 0.03)]),
)
def test_no_base_covers_more_elements_than_there_is_room_for(name, theta, x, y, pitches):
    base = PARCELS[name].base
    px, py = pitches
    reach = base.reach + max(pitches)
    places = np.stack(
        np.meshgrid(
            (np.arange(-math.ceil(reach / px), math.ceil(reach / px) + 1) + x) * px,
            (np.arange(-math.ceil(reach / py), math.ceil(reach / py) + 1) + y) * py,
        ),
        axis=-1,
    ).reshape(-1, 2)
    turned = places @ np.array(
        [[math.cos(theta), -math.sin(theta)], [math.sin(theta), math.cos(theta)]]
    )
    covered = (base.functions(*(turned + np.array(base.centroid)).T) <= 1e-9).all(axis=0)
    assert covered.sum() <= most_contacts(base, pitches)


@pytest.mark.parametrize("task", TASKS)
def test_the_boxes_of_the_tasks_need_little(task):
    assert 20 <= capacity_of(EnvConfig(task=task)) <= 40


def test_a_base_of_many_edges_has_room_for_them():
    angles = np.arange(60) * 2.0 * math.pi / 60
    parcel = sg.Parcel(sg.Polygon(0.1 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)))
    assert capacity_of(EnvConfig(task=sg.tasks.Sort(parcels=(parcel,)))) == 60
