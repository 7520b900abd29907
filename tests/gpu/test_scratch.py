import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import surface_gym as sg
from surface_gym.dynamics import types
from surface_gym.gpu.scratch import (
    ROWS_OF_MARKS,
    ROWS_OF_TABLE,
    capacity_of,
    layout,
    most_contacts,
)
from surface_gym.settings import Settings
from surface_gym.tasks import TASKS
from tests.environments import PARCELS


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
    assert 20 <= capacity_of(Settings(task=task)) <= 40


def test_a_base_of_many_edges_has_room_for_them():
    angles = np.arange(60) * 2.0 * math.pi / 60
    parcel = sg.Parcel(sg.Polygon(0.1 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)))
    assert capacity_of(Settings(task=sg.tasks.Sort(parcels=(parcel,)))) == 60
