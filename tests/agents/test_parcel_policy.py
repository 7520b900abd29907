"""The policy of parcels: it corrects a rule, by a parcel's own row and by those around it."""

from collections.abc import Iterator
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from surface_gym.agents.library import PolicyCard
from surface_gym.agents.rules.singulation import TimeSlots
from surface_gym.agents.slope_policy import (
    ParcelNetwork,
    ParcelPolicy,
    ParcelValues,
    Proposer,
    suited,
    to_halves,
)
from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.registration import env_id

CARD = PolicyCard(env_id("singulate"), "parcels", "parcels", 0.04, (8,))
CONFIG = CARD.env_config()
FEATURES, CHOICES = CONFIG.features, 4


@pytest.fixture
def network() -> Iterator[ParcelNetwork]:
    torch.manual_seed(0)
    made = ParcelNetwork(FEATURES, CHOICES, (8,))
    with torch.no_grad():
        made.actor[-1].weight.mul_(500.0)  # far from the rule
        yield made


def ask(network: ParcelNetwork, tables: np.ndarray, proposed: int = 5) -> ParcelValues:
    """What a network says where the rule proposes one choice for all."""
    rule = torch.full(tables.shape[:2], proposed)
    return network(torch.from_numpy(tables), rule)


def test_rows_may_stand_in_any_order_and_others_may_be_empty(network, tables) -> None:
    rows = tables.shape[1]
    order = np.random.default_rng(0).permutation(rows)
    plain, mixed = (ask(network, each) for each in (tables, tables[:, order]))
    wide = np.concatenate([tables, np.zeros_like(tables)], axis=1)
    padded = ask(network, wide)
    place = {int(k): n for n, k in enumerate(plain.row)}
    same = [place[int(k) // rows * rows + order[int(k) % rows]] for k in mixed.row]
    for name in ("logits", "value"):
        ours = getattr(plain, name)
        torch.testing.assert_close(getattr(mixed, name), ours[same])
        torch.testing.assert_close(getattr(padded, name), ours)


def test_a_parcel_heeds_those_of_its_surface_alone(network, tables) -> None:
    before = ask(network, tables)
    rows = tables.shape[1]
    moved = tables.copy()
    (chosen,) = np.nonzero(moved[0, :, ta.COLUMN.present.place] > 0.5)[0][:1]
    moved[0, chosen, ta.COLUMN.offset.place] += 1.0
    after = ask(network, moved)
    changed = (before.logits != after.logits).any(dim=1)
    of_first = before.row < rows
    assert changed[of_first].all()
    assert not changed[~of_first].any()


def test_nobody_there_is_no_error(network) -> None:
    found = ask(network, np.zeros((2, 5, len(FEATURES)), dtype=np.float32))
    assert found.logits.shape == (0, CHOICES**2)


def constant(network: ParcelNetwork, monkeypatch: pytest.MonkeyPatch) -> ParcelPolicy:
    policy = ParcelPolicy(network, CARD, CONFIG)
    brake = SimpleNamespace(predict=lambda seen, *_: (np.zeros((*seen.shape[:2], 2), int), None))
    monkeypatch.setattr(policy._proposer, "_rule", brake)
    return policy


def test_before_learning_it_is_nearly_the_rule(tables) -> None:
    torch.manual_seed(0)
    policy = ParcelPolicy(ParcelNetwork(FEATURES, CHOICES, (8,)), CARD, CONFIG)
    seen = tables[:, : CONFIG.task.max_parcels]
    proposed, _ = Proposer(CONFIG).propose(seen, None, np.ones(3, dtype=bool))
    probability, index = policy.probabilities(seen, proposed)
    of_rule = probability[np.arange(len(index)), proposed.flatten()[index]]
    assert ((of_rule > 0.9) & (of_rule < 0.99)).all()
    wanted, _ = TimeSlots(CONFIG).predict(seen)
    chosen, _ = policy.predict(seen)
    np.testing.assert_array_equal(chosen.reshape(-1, 2)[index], wanted.reshape(-1, 2)[index])


def test_choices_follow_their_probabilities_over_time(network, tables, monkeypatch) -> None:
    policy = constant(network, monkeypatch)
    probability, index = policy.probabilities(tables, np.zeros(tables.shape[:2], dtype=np.int64))
    state, seen = None, np.zeros_like(probability)
    moving = tables.copy()
    for period in range(200):
        moving[..., ta.COLUMN.time.place] += 0.01
        actions, state = policy.predict(moving, state, np.full(3, period == 0))
        halves = actions.reshape(-1, 2)[index]
        seen[np.arange(len(index)), CHOICES * halves[:, 0] + halves[:, 1]] += 1.0
    assert np.abs(seen - 200 * probability).max() < CHOICES**2
    assert np.abs(seen - 200 * probability).mean() < 1.0


def test_what_is_owed_ends_with_the_parcel_and_with_the_episode(network, tables) -> None:
    policy = ParcelPolicy(network, CARD, CONFIG)
    first, state = policy.predict(tables)
    anew, _ = policy.predict(tables, state, np.ones(3, dtype=bool))
    np.testing.assert_array_equal(anew, first)
    others = tables.copy()
    others[..., ta.COLUMN.time.place] -= 1.0  # they entered later than those that were there
    anew, _ = policy.predict(others, state, np.zeros(3, dtype=bool))
    again, _ = policy.predict(others)
    np.testing.assert_array_equal(anew, again)


def test_a_batch_decides_as_each_alone(network, tables) -> None:
    policy = ParcelPolicy(network, CARD, CONFIG)
    together, _ = policy.predict(tables)
    alone = [policy.predict(each)[0] for each in tables]
    np.testing.assert_array_equal(together, alone)


def test_halves_are_the_digits_of_a_choice() -> None:
    np.testing.assert_array_equal(to_halves(np.array([0, 5, 14]), 4), [[0, 0], [1, 1], [3, 2]])


def test_draws_follow_the_probabilities(network, tables, monkeypatch) -> None:
    policy = constant(network, monkeypatch)
    probability, index = policy.probabilities(tables, np.zeros(tables.shape[:2], dtype=np.int64))
    torch.manual_seed(0)
    seen = np.zeros_like(probability)
    for _ in range(2000):
        halves = policy.predict(tables, deterministic=False)[0].reshape(-1, 2)[index]
        seen[np.arange(len(index)), CHOICES * halves[:, 0] + halves[:, 1]] += 1.0
    assert np.abs(seen / 2000 - probability).max() < 0.06


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"task": "merge"}, "task must be one of 'singulate', got 'merge'"),
        ({"task": "singulate", "gate": True}, "gate must be one of False, got True"),
        ({"task": "singulate", "actions": "modules"}, "actions must be one of 'parcels'"),
        ({"task": "singulate", "orientations": (0.0, 0.5)}, "orientations must be"),
    ],
)
def test_it_is_for_the_environment_of_its_card(given, message) -> None:
    config = EnvConfig(**{"actions": "parcels", **given})
    with pytest.raises(ValueError, match=message):
        suited(CONFIG, config)


def test_layers_that_cannot_be_shared_among_heads_are_refused() -> None:
    for hidden in ((6,), (8, 8)):
        with pytest.raises(ValueError, match="hidden must be one multiple of 4"):
            ParcelNetwork(FEATURES, CHOICES, hidden)
