"""Starts prefetched to the device are those of the CPU's batch, in the same order."""

import numpy as np
import pytest
import torch

from surface_gym.config import EnvConfig
from surface_gym.core.batch import Batch
from surface_gym.cuda.batch import CudaBatch
from surface_gym.cuda.prefetch import STARTS_AHEAD
from surface_gym.tasks import TASKS
from tests.cuda.cases import needs_numba_cuda

pytestmark = needs_numba_cuda

NUM_ENVS = 3
CPU = torch.device("cpu")
ALL = np.arange(NUM_ENVS)


class UncompiledBatch(Batch):
    """Draws starts and steps nothing, so that nothing is compiled."""

    def _compile(self):
        return None


class Pair:
    """A batch of the CPU and the prefetch of one on a device, seeded alike."""

    def __init__(self, task):
        config = EnvConfig(task)
        self.batch = UncompiledBatch(config, NUM_ENVS)
        self.prefetch = CudaBatch(config, NUM_ENVS, CPU).prefetch
        for i in range(NUM_ENVS):
            self.batch.seed(i, np.random.default_rng(i))
        self.prefetch.refill({i: np.random.default_rng(i) for i in range(NUM_ENVS)}, ALL, ())

    def place(self, chosen=ALL, options=()):
        """Place the next starts of some environments in both, and compare them."""
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
        chosen = np.nonzero(rng.random(NUM_ENVS) < 0.7)[0]
        if len(chosen) > 0:
            pair.place(chosen)
        pair.prefetch.update()


def test_rings_stay_full_where_every_environment_ends_in_every_period(make_pair):
    pair = make_pair("slow")
    for _ in range(5 * STARTS_AHEAD):
        pair.place()
        pair.prefetch.update()


def test_a_new_generator_begins_anew_and_other_environments_go_on(make_pair):
    pair = make_pair("sort")
    for _ in range(STARTS_AHEAD // 2 + 3):  # starts are being prepared at the reset
        pair.place()
        pair.prefetch.update()
    pair.batch.seed(1, np.random.default_rng(9))
    pair.prefetch.refill({1: np.random.default_rng(9)}, ALL, ())
    pair.place()


def test_an_option_changes_what_was_drawn_and_not_later_starts(make_pair):
    pair = make_pair("sort")
    options = [{"speed": 1.1}, {}, {"side": -1, "parcel": "B"}]
    pair.prefetch.refill({}, ALL, options)
    pair.place(options=options)
    pair.place()
