"""Settings of flows for the tests of who controls them."""

from typing import Any

import numpy as np

from surface_gym.flow.arrivals import Steady
from surface_gym.flow.batch import FlowBatch
from surface_gym.flow.memory import RIGHT, TOUCHES, WRONG
from surface_gym.flow.settings import FlowSettings
from surface_gym.flow.stream import Stream
from surface_gym.state import RUNNING
from tests.flow.flows import SHORT

EVERYBODY = Stream(Steady(2000.0), parcels=("S", "B"), speeds=1.5)


def line(stream: Stream = EVERYBODY, **settings: Any) -> FlowSettings:
    """Of a short line with a chute on either side."""
    given = {"exits": "sides", "actions": "parcels", "duration": 6.0, "plant": SHORT}
    return FlowSettings(stream, **{**given, **settings})


def gated(stream: Stream = EVERYBODY, **settings: Any) -> FlowSettings:
    """The same with a gate."""
    return line(stream, **{"gate": True, **settings})


def zoned(stream: Stream = EVERYBODY, **settings: Any) -> FlowSettings:
    """The same with a gate and actions for modules."""
    return gated(stream, **{"actions": "modules", **settings})


def counts(controller: Any, settings: FlowSettings, lanes: int = 4) -> dict[str, int]:
    """How many parcels of some episodes left right and wrong, and how often two touched."""
    batch = FlowBatch(settings, lanes)
    for lane in range(lanes):
        batch.seed(lane, np.random.default_rng((1, lane)))
    batch.start(np.arange(lanes))
    state = None
    while (batch.outcome == RUNNING).any():
        action, state = controller.predict(batch.observation, state)
        batch.advance(settings.flow_actions.commands(action, lanes))
    tally = batch.streams.tally.sum(axis=0)
    return {
        "right": int(tally[RIGHT]),
        "wrong": int(tally[WRONG]),
        "touches": int(tally[TOUCHES]),
    }
