"""The kernel of a batch of flows on a GPU: a thread a surface, with all the parcels on it."""

from functools import lru_cache
from typing import Any

import numpy as np
from numba import cuda

from surface_gym.batch.kernels import Rules
from surface_gym.dynamics.company import TogetherScratch, make_together_scratch, scratch_of
from surface_gym.dynamics.types import Booleans, Integers, Scratch
from surface_gym.flow.kernel import FlowFunctions, make_flow_kernel
from surface_gym.flow.making import functions_of
from surface_gym.flow.memory import FlowRules, Flows
from surface_gym.flow.settings import FlowSettings
from surface_gym.gpu.kernel import device_source
from surface_gym.gpu.scratch import capacity_for, layout
from surface_gym.gpu.source import Source
from surface_gym.lanes.memory import Lanes, Sites, Surfaces
from surface_gym.parcel import Parcel


def capacity_of(settings: FlowSettings, kinds: tuple[Parcel, ...]) -> int:
    """Room for the contacts and the edges of parcels of some kinds, as large as they may be."""
    bases = [settings.randomisation.largest(parcel.base) for parcel in kinds]
    return capacity_for(bases, settings.chosen_plant)


def move_flow_kernel(settings: FlowSettings) -> Any:
    """The kernel of an environment: see `make_move_flow_kernel`."""
    capacity = capacity_of(settings, settings.stream.kinds)
    return make_move_flow_kernel(functions_of(settings), capacity)


@lru_cache(maxsize=16)
def make_move_flow_kernel(functions: FlowFunctions, capacity: int) -> Any:
    """Build `move(rules, flow_rules, surfaces, lanes, sites, flows, scratches, order, mask)`,
    compiled when it is first called.

    Thread t moves surface order[t], if it is in the mask (surfaces,): see
    `flow.kernel.make_flow_kernel`.

    Args:
        functions: of the environment.
        capacity: contacts that a parcel's scratch has room for.
    """
    places = layout(capacity)
    source = device_source(capacity)
    move_flows, own_scratch = source.remade(make_flow_kernel(functions)), source.remade(scratch_of)
    table_size, marks_size, spans = places["TABLE_SIZE"], places["MARKS_SIZE"], places["SPANS"]

    def move(
        rules: Rules,
        flow_rules: FlowRules,
        surfaces: Surfaces,
        lanes: Lanes,
        sites: Sites,
        flows: Flows,
        scratches: TogetherScratch,
        order: Integers,
        mask: Booleans,
    ) -> None:
        thread = cuda.grid(1)
        if thread >= order.shape[0] or not mask[order[thread]]:
            return
        of_sensor = Scratch(
            cuda.local.array(table_size, np.float64), cuda.local.array(marks_size, np.int64)
        )
        of_sensor.marks[spans] = -1
        scratch = own_scratch(scratches, order[thread])
        own = order[thread : thread + 1]
        move_flows(rules, flow_rules, surfaces, lanes, sites, flows, scratch, of_sensor, own)

    return cuda.jit(move)


def make_scratch(capacity: int, parcels: int) -> TogetherScratch:
    """A surface's scratch for so many parcels, with room for so many contacts of each."""
    source = Source(layout(capacity), lambda function: function)
    scratch: TogetherScratch = source.remade(make_together_scratch)(parcels)
    return scratch
