"""Configurations of streams, for the tests of their controllers."""

from typing import Any

import numpy as np

from surface_gym.config import EnvConfig
from surface_gym.flow.arrivals import Steady
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import RIGHT, TOUCHES, WRONG
from surface_gym.flow.stream import Stream
from surface_gym.state import RUNNING
from tests.flow.flows import SHORT

EVERYBODY = Stream(Steady(2000.0), parcels=("S", "B"), speeds=1.5)


def line(stream: Stream = EVERYBODY, **config: Any) -> EnvConfig:
    """Of a short line with a chute on either side."""
    given = {"exits": "sides", "actions": "parcels", "duration": 6.0, "line": SHORT}
    return EnvConfig("flow", stream=stream, **{**given, **config})


def gated(stream: Stream = EVERYBODY, **config: Any) -> EnvConfig:
    """The same with a gate."""
    return line(stream, **{"gate": True, **config})


def zoned(stream: Stream = EVERYBODY, **config: Any) -> EnvConfig:
    """The same with a gate and actions for modules."""
    return gated(stream, **{"actions": "modules", **config})


def counts(controller: Any, config: EnvConfig, num_envs: int = 4) -> dict[str, int]:
    """Count the parcels of some episodes that left right and wrong, and touches of two."""
    batch = StreamBatch(config, num_envs)
    for i in range(num_envs):
        batch.seed(i, np.random.default_rng((1, i)))
    batch.reset(np.arange(num_envs))
    state = None
    while (batch.outcome == RUNNING).any():
        action, state = controller.predict(batch.observation, state)
        batch.step(config.action_kind.commands(action, num_envs))
    tally = batch.streams.tally.sum(axis=0)
    return {"right": int(tally[RIGHT]), "wrong": int(tally[WRONG]), "touches": int(tally[TOUCHES])}
