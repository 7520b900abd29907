"""The policy of parcels: conversion of its choices, its masked network, and files."""

from pathlib import Path

import numpy as np
import pytest
import torch

from surface_gym import agents
from surface_gym.agents import policy as parcel_policy
from surface_gym.agents.base import SIDE
from surface_gym.agents.learning.parcels import training_env_config
from surface_gym.agents.library import CARD, PolicyCard
from surface_gym.agents.policy import save_policy
from surface_gym.agents.rules.streams import StreamEventRule
from surface_gym.config import EnvConfig
from surface_gym.flow.batch import StreamBatch
from surface_gym.flow.state import RIGHT
from surface_gym.flow.task import PRESENT, WAITS
from tests.agents.test_policy import sign

CONFIG = training_env_config(0.04)
FLOW_CARD = PolicyCard("SmartSurface/Flow-v0", "parcels", "parcels", 0.04, (8,))


def test_mirrored_choices_come_back_as_they_were() -> None:
    batch = StreamBatch(CONFIG, 2)
    for i in range(2):
        batch.seed(i, np.random.default_rng(i))
    batch.reset(np.arange(2))
    tables = batch.observation.copy()
    tables[..., SIDE] = np.random.default_rng(0).integers(-1, 2, tables.shape[:2])
    actions = parcel_policy.ParcelActions(CONFIG)
    choices = np.random.default_rng(1).integers(0, [4, 4, 9], (*tables.shape[:2], 3))
    back = actions.to_parcels(tables, actions.to_env(tables, choices))
    assert np.array_equal(back[:, :-1, :2], choices[:, :-1, :2])
    assert np.array_equal(back[:, -1, 2], choices[:, -1, 2])


def test_choices_and_actions_are_inverse() -> None:
    """An event rule delivers the same by either."""
    plain = EnvConfig(
        "flow", stream=CONFIG.stream_task.stream, exits="sides", actions="parcels", gate=True
    )
    batch = StreamBatch(plain, 1)
    batch.seed(0, np.random.default_rng(3))
    batch.reset(np.arange(1))
    rule, state = StreamEventRule(plain), None
    mirror = parcel_policy.ParcelActions(plain)
    for _ in range(120):
        tables = batch.observation.copy()
        action, state = rule.predict(tables, state)
        choices = mirror.to_parcels(tables, action)
        assert np.array_equal(mirror.to_env(tables, choices), action)
        batch.step(plain.action_kind.commands(action, 1))
    assert batch.streams.tally[0, RIGHT] > 0


@pytest.fixture
def policy() -> parcel_policy.ParcelNetwork:
    torch.manual_seed(0)
    return parcel_policy.ParcelNetwork(
        *parcel_policy.parcel_spaces(CONFIG), lambda _: 0.0, net_arch=[8]
    )


class TestPolicy:
    @staticmethod
    def rows(present: float, waits: float) -> torch.Tensor:
        seen = torch.rand((5, parcel_policy.parcel_spaces(CONFIG)[0].shape[0]))
        seen[:, PRESENT], seen[:, WAITS] = present, waits
        return seen

    @pytest.mark.parametrize(
        ("present", "waits", "counts"), [(1.0, 0.0, [0, 1]), (1.0, 1.0, [2]), (0.0, 0.0, [])]
    )
    def test_only_the_choices_of_a_parcel_count(self, policy, present, waits, counts) -> None:
        seen = self.rows(present, waits)
        for place, part in enumerate(policy.distributions(seen)):
            even = part.probs.allclose(torch.full_like(part.probs, 1.0 / part.probs.shape[1]))
            assert even == (place not in counts)
        actions = torch.zeros((5, 3))
        policy.zero_grad()
        _, likelihood, _ = policy.evaluate_actions(seen, actions)
        likelihood.sum().backward()
        assert bool(policy.action_net.weight.grad.any()) == bool(counts)

    def test_a_deterministic_choice_is_the_likeliest(self, policy) -> None:
        seen = self.rows(1.0, 0.0)
        chosen, _, likelihood = policy(seen, deterministic=True)
        _, again, _ = policy.evaluate_actions(seen, chosen)
        assert torch.allclose(likelihood, again)
        for place, part in enumerate(policy.distributions(seen)):
            assert torch.equal(part.probs.argmax(dim=1), chosen[:, place])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    torch.manual_seed(0)
    save_policy(parcel_policy.make_parcel_network(FLOW_CARD), FLOW_CARD, tmp_path)
    return tmp_path


def test_a_policy_file_of_another_kind_is_refused(folder) -> None:
    card = (folder / CARD).read_text()
    (folder / CARD).write_text(card.replace("algo: parcels", "algo: ppo"))
    sign(folder)
    with pytest.raises(ValueError, match="algo must be 'parcels'"):
        agents.read(folder)


def test_an_observation_of_one_stream_or_of_many(folder) -> None:
    policy = agents.read(folder)
    assert isinstance(policy, parcel_policy.ParcelPolicy)
    assert policy.env_kwargs == {"actions": "parcels", "gate": True, "control_period": 0.04}
    tables = np.random.default_rng(0).random((3, 25, 29), dtype=np.float32)
    tables[..., PRESENT] = 1.0
    tables[..., SIDE] = -1.0
    many, _ = policy.predict(tables)
    assert many.shape == (3, 49)
    assert np.array_equal(policy.predict(tables[1])[0], many[1])
