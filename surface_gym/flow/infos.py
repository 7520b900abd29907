"""What `info` tells of flows, as arrays of all lanes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surface_gym.flow.batch import FlowBatch
from surface_gym.flow.memory import ENTERED, JAM, RIGHT, TOUCHES, TURNS, WRONG
from surface_gym.flow.statistics import NAMES, statistics_of


def infos_of(batch: FlowBatch) -> dict[str, NDArray[Any]]:
    """By name, each (lanes, ...): of the episode so far; views. The outcome is its number."""
    flows = batch.streams
    return {
        "outcome": flows.outcome,
        "time": flows.clock,
        "parcels": np.where(flows.present, flows.number, -1)[:, : batch.places],
        "entered": flows.tally[:, ENTERED],
        "right": flows.tally[:, RIGHT],
        "wrong": flows.tally[:, WRONG],
        "touches": flows.tally[:, TOUCHES],
        "turns": flows.tally[:, TURNS],
        "waiting": flows.due - flows.coming,
    }


def episodes_of(batch: FlowBatch, ended: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    """Figures by name, each (lanes,), of the lanes (lanes,) whose episodes have ended; nan else."""
    figures = {name: np.full(len(ended), np.nan) for name in NAMES}
    obeys = batch.streams.obeys
    for lane in np.nonzero(ended)[0].tolist():
        obeying = int(obeys[lane if len(obeys) > 1 else 0].sum())
        jammed = bool(batch.streams.outcome[lane] == JAM)
        found = statistics_of(batch.streams, lane, jammed, obeying)
        for name in NAMES:
            figures[name][lane] = getattr(found, name)
    return figures
