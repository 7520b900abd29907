"""Policies on slopes: parcels correct a rule by their own row and those around; modules act by what
they see and what is passed on to them.
"""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from surface_gym.agents.library import PolicyCard
from surface_gym.agents.rules.departures import TimeSlots
from surface_gym.agents.slope_policy import (
    HOLD,
    LocalNetwork,
    LocalPolicy,
    ParcelNetwork,
    ParcelPolicy,
    ParcelValues,
    Proposer,
    see_modules,
    suited,
    to_halves,
)
from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.flow.module_view import OWN, ModuleView
from surface_gym.registration import env_id

CARDS = {
    "parcels": PolicyCard(env_id("singulate"), "parcels", "parcels", 0.04, (8,)),
    "local": PolicyCard(env_id("singulate"), "local", "modules", 0.04, (8,)),
}
CONFIG = CARDS["parcels"].env_config()
FEATURES, CHOICES, ROLL = CONFIG.features, 4, 3
VIEW = ModuleView(EnvConfig("singulate"))


@pytest.fixture
def network() -> ParcelNetwork:
    torch.manual_seed(0)
    made = ParcelNetwork(FEATURES, CHOICES, (8,)).requires_grad_(False)
    made.actor[-1].weight.mul_(500.0)  # far from the rule
    return made


@pytest.fixture
def local() -> LocalNetwork:
    torch.manual_seed(0)
    return LocalNetwork(CHOICES, (8,)).requires_grad_(False)


@pytest.fixture(params=CARDS)
def policy(request: pytest.FixtureRequest, network, local) -> ParcelPolicy | LocalPolicy:
    if request.param == "parcels":
        return ParcelPolicy(network, CARDS["parcels"], CONFIG)
    return local_policy(local)


def local_policy(network: LocalNetwork) -> LocalPolicy:
    return LocalPolicy(network, CARDS["local"], CARDS["local"].env_config())


def test_a_batch_decides_as_each_alone_and_nobody_there_is_no_error(policy, tables) -> None:
    together, _ = policy.predict(tables)
    alone = [policy.predict(each)[0] for each in tables]
    np.testing.assert_array_equal(together, alone)
    actions, _ = policy.predict(np.zeros_like(tables))
    if isinstance(policy, LocalPolicy):
        assert (actions == ROLL).all()


@pytest.mark.parametrize(
    ("algo", "given", "message"),
    [
        ("parcels", {"task": "merge"}, "task must be one of 'singulate', got 'merge'"),
        ("parcels", {"gate": True}, "gate must be one of False, got True"),
        ("parcels", {"actions": "modules"}, "actions must be one of 'parcels'"),
        ("parcels", {"orientations": (0.0, 0.5)}, "orientations must be"),
        ("local", {"actions": "parcels"}, "actions must be one of 'modules'"),
    ],
)
def test_it_is_for_the_environment_of_its_card(algo, given, message) -> None:
    card = CARDS[algo]
    with pytest.raises(ValueError, match=message):
        suited(
            card.env_config(),
            EnvConfig(**{"task": "singulate", "actions": card.actions, **given}),
        )


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
    moved = tables.copy()
    (chosen,) = np.nonzero(moved[0, :, ta.COLUMN.present.place] > 0.5)[0][:1]
    moved[0, chosen, ta.COLUMN.offset.place] += 1.0
    after = ask(network, moved)
    changed = (before.logits != after.logits).any(dim=1)
    of_first = before.row < tables.shape[1]
    assert changed[of_first].all()
    assert not changed[~of_first].any()


def test_before_learning_it_is_nearly_the_rule(tables) -> None:
    torch.manual_seed(0)
    policy = ParcelPolicy(ParcelNetwork(FEATURES, CHOICES, (8,)), CARDS["parcels"], CONFIG)
    seen = tables[:, : CONFIG.task.max_parcels]
    proposed, _ = Proposer(CONFIG).propose(seen, None, np.ones(3, dtype=bool))
    probability, index = policy.probabilities(seen, proposed)
    of_rule = probability[np.arange(len(index)), proposed.flatten()[index]]
    assert ((of_rule > 0.9) & (of_rule < 0.99)).all()
    wanted, _ = TimeSlots(CONFIG).predict(seen)
    chosen, _ = policy.predict(seen)
    np.testing.assert_array_equal(chosen.reshape(-1, 2)[index], wanted.reshape(-1, 2)[index])


@pytest.mark.parametrize("deterministic", [True, False])
def test_choices_of_parcels_follow_their_probabilities(
    deterministic, network, tables, monkeypatch
) -> None:
    """Over time and without random numbers, or by draws."""
    policy = ParcelPolicy(network, CARDS["parcels"], CONFIG)
    brake = SimpleNamespace(predict=lambda seen, *_: (np.zeros((*seen.shape[:2], 2), int), None))
    monkeypatch.setattr(policy._proposer, "_rule", brake)
    probability, index = policy.probabilities(tables, np.zeros(tables.shape[:2], dtype=np.int64))
    torch.manual_seed(0)
    periods = 200 if deterministic else 2000
    state, seen, moving = None, np.zeros_like(probability), tables.copy()
    for period in range(periods):
        moving[..., ta.COLUMN.time.place] += 0.01
        fresh = np.full(3, period == 0)
        actions, state = policy.predict(moving, state, fresh, deterministic=deterministic)
        halves = actions.reshape(-1, 2)[index]
        seen[np.arange(len(index)), CHOICES * halves[:, 0] + halves[:, 1]] += 1.0
    apart = np.abs(seen - periods * probability)
    if deterministic:
        assert apart.max() < CHOICES**2
        assert apart.mean() < 1.0
    else:
        assert apart.max() < 0.06 * periods


def test_what_is_owed_ends_with_the_parcel_and_with_the_episode(network, tables) -> None:
    policy = ParcelPolicy(network, CARDS["parcels"], CONFIG)
    first, state = policy.predict(tables)
    anew, _ = policy.predict(tables, state, np.ones(3, dtype=bool))
    np.testing.assert_array_equal(anew, first)
    others = tables.copy()
    others[..., ta.COLUMN.time.place] -= 1.0  # they entered later than those that were there
    anew, _ = policy.predict(others, state, np.zeros(3, dtype=bool))
    again, _ = policy.predict(others)
    np.testing.assert_array_equal(anew, again)


def test_halves_are_the_digits_of_a_choice() -> None:
    np.testing.assert_array_equal(to_halves(np.array([0, 5, 14]), 4), [[0, 0], [1, 1], [3, 2]])


def test_layers_that_cannot_be_shared_among_heads_are_refused() -> None:
    for hidden in ((6,), (8, 8)):
        with pytest.raises(ValueError, match="hidden must be one multiple of 4"):
            ParcelNetwork(FEATURES, CHOICES, hidden)


def test_modules_see_what_the_view_says_and_those_of_a_parcel_are_in_a_row(tables) -> None:
    seen, whole = see_modules(VIEW, tables), VIEW(tables)
    assert (np.diff(seen.parcel.numpy()) >= 0).all()
    np.testing.assert_array_equal(
        seen.row[seen.parcel.numpy()] % tables.shape[1], whole.owner[seen.env, seen.module]
    )
    both = torch.cat([seen.own, seen.passed[seen.parcel]], dim=1)
    expected = whole.of_modules()[seen.env, seen.module].clip(-5.0, 5.0)
    np.testing.assert_array_equal(both.numpy(), expected)
    assert len(seen.own) == (whole.owner >= 0).sum() > 50


def test_a_module_without_a_parcel_lets_it_roll_on(local, tables) -> None:
    actions, _ = local_policy(local).predict(tables)
    owner = VIEW(tables).owner
    assert (actions[owner < 0] == ROLL).all()
    assert len(np.unique(actions[owner >= 0])) > 1


def test_a_parcel_far_behind_changes_nothing_and_one_near_does(local, tables) -> None:
    table = np.zeros_like(tables[:1])
    table[0, :2] = tables[0, np.flatnonzero(tables[0, :, ta.COLUMN.present.place] > 0.5)[:2]]
    table[0, :2, ta.COLUMN.offset.place] = 0.0
    table[0, 0, ta.COLUMN.to_the_end.place] = 1.0
    found: list[Any] = []
    for behind in (2.9, 3.4, 0.9):
        table[0, 1, ta.COLUMN.to_the_end.place] = 1.0 + behind
        seen = see_modules(VIEW, table)
        found.append(local(seen.passed[seen.parcel], seen.own)[seen.parcel == 0])
    assert torch.equal(found[0], found[1])
    assert not torch.equal(found[0], found[2])


def test_modules_that_see_alike_choose_alike(local, tables) -> None:
    local.actor[0].weight[:, -len(OWN) :] = 0.0  # they see nothing of themselves
    owner = VIEW(tables).owner
    for deterministic in (True, False):
        actions, _ = local_policy(local).predict(tables, deterministic=deterministic)
        for i in range(3):
            for k in np.unique(owner[i][owner[i] >= 0]):
                assert len(np.unique(actions[i, owner[i] == k])) == 1


def test_choices_of_modules_follow_their_probabilities_and_stay_for_some_periods(
    local, tables
) -> None:
    policy, seen = local_policy(local), see_modules(VIEW, tables)
    probability = local(seen.passed[seen.parcel], seen.own).exp().numpy()
    count, moving, chosen = np.zeros_like(probability), tables.copy(), []
    moving[..., ta.COLUMN.time.place] = np.ceil(moving[..., ta.COLUMN.time.place] * 50.0) / 50.0
    for _ in range(2000):
        moving[..., ta.COLUMN.time.place] += 0.01
        actions, _ = policy.predict(moving)
        chosen.append(actions[seen.env, seen.module])
        count[np.arange(len(count)), chosen[-1]] += 1.0
    assert np.abs(count / 2000 - probability).max() < 0.06
    changes = (np.diff(chosen, axis=0) != 0).mean(axis=1)
    assert changes[::HOLD].max() == 0.0 or changes[1::HOLD].max() == 0.0
