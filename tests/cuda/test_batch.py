"""Starts that lie ahead on the device are those of the CPU's batch, in the same order."""

import numpy as np
import pytest
import torch

from surface_gym.config import EnvConfig
from surface_gym.core.batch import Batch
from surface_gym.cuda.batch import CudaBatch
from surface_gym.cuda.prefetch import AHEAD
from surface_gym.tasks import TASKS
from tests.cuda.cases import needs_numba_cuda

pytestmark = needs_numba_cuda

LANES = 3
CPU = torch.device("cpu")
ALL = np.arange(LANES)


class StillBatch(Batch):
    """Draws starts and moves nothing: nothing is compiled for it."""

    def _compile(self):
        return None


def pair(task, seed=0):
    """A batch of each kind, seeded alike."""
    settings = EnvConfig(task=task)
    batch, device = StillBatch(settings, LANES), CudaBatch(settings, LANES, CPU)
    for lane in range(LANES):
        batch.seed(lane, np.random.default_rng(seed + lane))
    generators = {lane: np.random.default_rng(seed + lane) for lane in range(LANES)}
    device.supply.renew(generators, ALL, ())
    return batch, device.supply


def take(supply, chosen):
    """The next starts of some lanes, as the kernel that places them takes them."""
    slots = supply.taken[chosen] % AHEAD
    supply.taken[chosen] += 1
    return [ring[chosen, slots].numpy() for ring in supply.starts]


def assert_placed(batch, chosen, starts):
    lanes = batch.parcels
    placed = (lanes.site, lanes.state, batch.surfaces.conditions, lanes.goal, lanes.path)
    for one, other in zip(placed, starts, strict=True):
        # A ring of nothing holds a zero.
        np.testing.assert_array_equal(
            one[chosen], other[:, : one.shape[1]] if one.ndim > 1 else other
        )


@pytest.mark.parametrize("task", TASKS)
def test_lanes_that_end_at_random_get_the_cpus_starts(task):
    batch, supply = pair(task)
    rng = np.random.default_rng(1)
    for _ in range(2 * AHEAD):
        chosen = np.nonzero(rng.random(LANES) < 0.7)[0]
        if len(chosen) > 0:
            batch._place_drawn(chosen)
            assert_placed(batch, chosen, take(supply, chosen))
        supply.follow()
    supply.close()


def test_a_ring_holds_where_every_lane_ends_in_every_period():
    batch, supply = pair("slow")
    for _ in range(5 * AHEAD):
        batch._place_drawn(ALL)
        assert_placed(batch, ALL, take(supply, ALL))
        supply.follow()
    supply.close()


def test_a_lane_with_a_new_generator_begins_anew_and_others_go_on():
    batch, supply = pair("sort")
    for _ in range(AHEAD // 2 + 3):  # starts are on their way as lanes are seeded
        batch._place_drawn(ALL)
        take(supply, ALL)
        supply.follow()
    batch.seed(1, np.random.default_rng(9))
    supply.renew({1: np.random.default_rng(9)}, ALL, ())
    batch._place_drawn(ALL)
    assert_placed(batch, ALL, take(supply, ALL))
    supply.close()


def test_an_option_changes_what_was_drawn_and_not_what_follows():
    batch, supply = pair("sort")
    options = [{"speed": 1.1}, {}, {"side": -1, "parcel": "B"}]
    supply.renew({}, ALL, options)
    batch._place_drawn(ALL, options)
    assert_placed(batch, ALL, take(supply, ALL))
    batch._place_drawn(ALL)
    assert_placed(batch, ALL, take(supply, ALL))
    supply.close()
