"""Snapshots and forks of environments: what was taken goes on as it would have, to the bit."""

from typing import Any

import numpy as np
import pytest

from surface_gym.config import EnvConfig
from surface_gym.core.batch import BaseBatch
from surface_gym.env import make_batch
from surface_gym.flow.arrivals import Poisson
from surface_gym.flow.stream import Stream
from surface_gym.sensors import Camera, Presence
from tests.environments import EVERYTHING_VARIES
from tests.flow.flows import DENSE, SHORT

ENVS, BEFORE, AFTER = 3, 10, 20  # control periods
CROWD = Stream(Poisson(15000.0), parcels=("S", "B"), speeds=(1.0, 2.0))
VARIED: dict[str, Any] = {"sensors": Camera(), **EVERYTHING_VARIES}
CONFIGS = {
    "one parcel": EnvConfig("sort", actions="halves"),
    "one parcel, all varies": EnvConfig(
        "sort", actions="quadrants", sensors=Presence(), **EVERYTHING_VARIES
    ),
    "one parcel, seen by a camera": EnvConfig("sort", actions="quadrants", **VARIED),
    "a stream": EnvConfig("flow", actions="parcels", stream=DENSE, line=SHORT, duration=3.0),
    "a queue at a gate": EnvConfig(
        "flow", actions="parcels", stream=CROWD, line=SHORT, gate=True, queue=3
    ),
    "a stream, all varies": EnvConfig(
        "flow", actions="parcels", stream=DENSE, line=SHORT, duration=3.0, **VARIED
    ),
    "a queue at a gate, all varies": EnvConfig(
        "flow", actions="parcels", stream=CROWD, line=SHORT, gate=True, queue=3, **VARIED
    ),
}
every_config = pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)


def begun(config: EnvConfig, seed: int) -> BaseBatch:
    batch = make_batch(config, ENVS, max_episode_steps=25)
    for i in range(ENVS):
        batch.seed(i, np.random.default_rng((seed, i)))
    batch.reset(np.arange(ENVS))
    return batch


def drawn(config: EnvConfig, periods: int) -> list[Any]:
    kind, space = config.action_kind, config.action_space()
    space.seed(0)
    actions = [np.array([space.sample() for _ in range(ENVS)]) for _ in range(periods)]
    return [kind.commands(each, ENVS) for each in actions]


def ran(batch: BaseBatch, commands: list[Any]) -> list[tuple[Any, ...]]:
    seen = []
    for each in commands:
        batch.step(each)
        arrays = (batch.observation, batch.reward, batch.outcome, batch.terms, batch.truncated)
        seen.append(tuple(array.copy() for array in arrays))
    return seen


def assert_equal(first: list[Any], second: list[Any], one: int, other: int) -> None:
    for seen, again in zip(first, second, strict=True):
        for array, copied in zip(seen, again, strict=True):
            np.testing.assert_array_equal(array[one], copied[other])


@every_config
def test_a_restored_environment_goes_on_as_it_did(config):
    batch, stranger = begun(config, 0), begun(config, 1)
    commands = drawn(config, BEFORE + AFTER)
    ran(batch, commands[:BEFORE])
    snapshot = batch.snapshot()
    first = ran(batch, commands[BEFORE:])
    batch.reset(np.arange(ENVS))  # other parcels take the place of those held
    for each in (batch, stranger):
        each.restore(snapshot)
        again = ran(each, commands[BEFORE:])
        for i in range(ENVS):
            assert_equal(first, again, i, i)


@every_config
def test_a_fork_goes_on_as_its_parent_and_the_others_stop(config):
    batch = begun(config, 0)
    commands = drawn(config, BEFORE + AFTER)
    ran(batch, commands[:BEFORE])
    snapshot = batch.snapshot()
    first = ran(batch, commands[BEFORE:])
    batch.restore(snapshot)
    batch.fork(np.array([2, 0]))
    assert batch.truncated.tolist() == [False, False, True]
    given = []
    for each in commands[BEFORE:]:
        given.append(each.copy())
        given[-1][:2] = each[[2, 0]]
    again = ran(batch, given)
    assert_equal(first, again, 2, 0)
    assert_equal(first, again, 0, 1)


def test_a_snapshot_of_another_size_is_refused():
    batch = begun(CONFIGS["one parcel"], 0)
    with pytest.raises(ValueError, match="snapshot must be of 1 or 3 environments, got 2"):
        batch.restore(batch.snapshot(np.array([0, 1])))
