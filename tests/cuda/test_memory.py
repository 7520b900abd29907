"""State arrays, scratch and prefetched starts as a device holds them, in tensors of the CPU."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, strategies as st

import surface_gym as sg
from surface_gym.config import EnvConfig
from surface_gym.core.assembly import make_env_params, make_state
from surface_gym.cuda import memory
from surface_gym.cuda.batch import CudaBatch
from surface_gym.cuda.prefetch import STARTS_AHEAD
from surface_gym.physics import types
from surface_gym.tasks import TASKS
from tests.cuda.cases import UncompiledBatch, every_case, make_config, needs_numba_cuda
from tests.environments import PARCELS

pytestmark = needs_numba_cuda

CPU = torch.device("cpu")
NUM_ENVS = 64


@every_case
def test_device_state_equals_the_cpus_with_environments_adjacent_except_in_grids(name):
    config = make_config(name)
    device = memory.make_device_state(config, NUM_ENVS, CPU)
    for tensors, arrays in zip(device, make_state(config, NUM_ENVS), strict=True):
        for field, tensor, array in zip(tensors._fields, tensors, arrays, strict=True):
            assert tensor.numel() > 0  # a kernel takes no empty array
            if array.size:
                np.testing.assert_array_equal(tensor, array, field)
                assert tensor.numpy().dtype == array.dtype
            if len(tensor) > 1:  # not shared by all
                stride = tensor[0].numel() if field in memory.GRIDS else 1
                assert tensor.stride(0) == stride, field


def test_a_kernel_sees_the_same_memory_and_an_empty_array_as_a_zero():
    tensor = torch.zeros(3, 4)
    memory.kernel_view(tensor)[1, 2] = 5.0
    assert tensor[1, 2] == 5.0
    params = make_env_params(make_config("sort"))
    assert memory.to_device(params, CPU).timing == params.timing
    assert memory.to_device(params, CPU).outcomes == params.outcomes
    for shape in ((0,), (2, 0), (2, 0, 4)):
        tensor = memory.to_device(np.zeros(shape), CPU)
        assert tensor.numel() > 0
        assert not tensor.any()


@pytest.mark.parametrize("capacity", [4, 31, 4096])
def test_rows_follow_one_another(capacity):
    layout = memory.scratch_layout(capacity)
    for names, size in ((memory.TABLE_ROWS, "TABLE_SIZE"), (memory.MARK_ROWS, "MARKS_SIZE")):
        rows = [layout[name] for name in names]
        assert rows == list(range(0, capacity * len(rows), capacity))
        assert layout[size] > rows[-1]
    assert layout["TABLE_SIZE"] == layout["KINKS"] + 4 * capacity
    counts = [layout[name] - layout["COUNTS"] for name in ("SPANS", "ISOTROPICS", "SUPPORTS")]
    assert counts == [0, 1, 2]
    assert layout["MARKS_SIZE"] == layout["COUNTS"] + 3


def test_every_size_is_among_the_layout_s_and_the_tasks_boxes_need_little():
    larger = {name for name, value in vars(types).items() if isinstance(value, int) and value > 50}
    assert larger | {"ARM_X", "KIND"} <= set(memory.scratch_layout(4))  # the first rows, at 0
    for task in TASKS:
        assert 20 <= memory.task_capacity(EnvConfig(task)) <= 40
    angles = np.arange(60) * 2.0 * math.pi / 60
    parcel = sg.Parcel(sg.Polygon(0.1 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)))
    assert memory.task_capacity(EnvConfig(task=sg.tasks.Sort(parcels=(parcel,)))) == 60


@given(
    st.sampled_from(sorted(PARCELS)),
    st.floats(0.0, 2.0 * math.pi),
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
    st.sampled_from([(0.1, 0.1), (0.05, 0.1), (0.07, 0.03)]),
)
def test_no_base_covers_more_elements_than_its_capacity(name, theta, x, y, pitches):
    base = PARCELS[name].base
    reach = base.reach + max(pitches)
    along, across = (
        (np.arange(-math.ceil(reach / pitch), math.ceil(reach / pitch) + 1) + shift) * pitch
        for pitch, shift in zip(pitches, (x, y), strict=True)
    )
    points = np.stack(np.meshgrid(along, across), axis=-1).reshape(-1, 2)
    c, s = math.cos(theta), math.sin(theta)
    turned = points @ np.array([[c, -s], [s, c]])
    covered = (base.functions(*(turned + np.array(base.centroid)).T) <= 1e-9).all(axis=0)
    assert covered.sum() <= memory.max_contacts(base, pitches)


PAIRED = 3  # environments of a batch and a prefetch
ALL = np.arange(PAIRED)


class Pair:
    """A batch of the CPU and the prefetch of one on a device, seeded alike."""

    def __init__(self, task):
        config = EnvConfig(task)
        self.batch = UncompiledBatch(config, PAIRED)
        self.prefetch = CudaBatch(config, PAIRED, CPU).prefetch
        for i in range(PAIRED):
            self.batch.seed(i, np.random.default_rng(i))
        self.prefetch.refill({i: np.random.default_rng(i) for i in range(PAIRED)}, ALL, ())

    def place(self, chosen=ALL, options=()):
        self.batch.place_drawn(chosen, options)
        slots = self.prefetch.starts_taken[chosen] % STARTS_AHEAD  # as the kernel does
        self.prefetch.starts_taken[chosen] += 1
        parcels = self.batch.parcels
        placed = (
            parcels.body, parcels.state, self.batch.surfaces.conditions, parcels.goal, parcels.path
        )  # fmt: skip
        for values, ring in zip(placed, self.prefetch.rings, strict=True):
            drawn = ring[chosen, slots].numpy()
            # The ring of an empty array holds a zero.
            expected = drawn[:, : values.shape[1]] if values.ndim > 1 else drawn
            np.testing.assert_array_equal(values[chosen], expected)


@pytest.fixture
def make_pair():
    made = []

    def make(task):
        made.append(Pair(task))
        return made[-1]

    yield make
    for pair in made:
        pair.prefetch.close()


@pytest.mark.parametrize("task", TASKS)
def test_environments_that_end_at_random_get_the_cpus_starts(make_pair, task):
    pair = make_pair(task)
    rng = np.random.default_rng(1)
    for _ in range(2 * STARTS_AHEAD):
        chosen = np.nonzero(rng.random(PAIRED) < 0.7)[0]
        if len(chosen) > 0:
            pair.place(chosen)
        pair.prefetch.update()


def test_rings_stay_full_where_every_environment_ends_in_every_period(make_pair):
    pair = make_pair("slow")
    for _ in range(5 * STARTS_AHEAD):
        pair.place()
        pair.prefetch.update()


def test_a_new_generator_begins_anew_and_an_option_changes_no_later_starts(make_pair):
    pair = make_pair("sort")
    for _ in range(STARTS_AHEAD // 2 + 3):  # starts are being prepared at the reset
        pair.place()
        pair.prefetch.update()
    pair.batch.seed(1, np.random.default_rng(9))
    pair.prefetch.refill({1: np.random.default_rng(9)}, ALL, ())
    pair.place()
    options = [{"speed": 1.1}, {}, {"side": -1, "parcel": "B"}]
    pair.prefetch.refill({}, ALL, options)
    pair.place(options=options)
    pair.place()
