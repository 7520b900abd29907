"""The policy of modules on a slope: each is led by what it sees and what is passed on to it."""

from collections.abc import Iterator

import numpy as np
import pytest
import torch

from surface_gym.agents.library import PolicyCard
from surface_gym.agents.slope_policy import HOLD, LocalNetwork, LocalPolicy, see_modules, suited
from surface_gym.config import EnvConfig
from surface_gym.flow import take_away as ta
from surface_gym.flow.module_view import OWN, ModuleView
from surface_gym.registration import env_id

CARD = PolicyCard(env_id("singulate"), "local", "modules", 0.04, (8,))
OWN_CONFIG = CARD.env_config()
CONFIG = EnvConfig("singulate")
CHOICES, ROLL = 4, 3


@pytest.fixture
def network() -> Iterator[LocalNetwork]:
    torch.manual_seed(0)
    with torch.no_grad():
        yield LocalNetwork(CHOICES, (8,))


def test_modules_see_what_the_view_says_and_those_of_a_parcel_are_in_a_row(tables) -> None:
    view = ModuleView(CONFIG)
    seen, whole = see_modules(view, tables), view(tables)
    assert (np.diff(seen.parcel.numpy()) >= 0).all()
    np.testing.assert_array_equal(
        seen.row[seen.parcel.numpy()] % CONFIG.rows, whole.owner[seen.env, seen.module]
    )
    both = torch.cat([seen.own, seen.passed[seen.parcel]], dim=1)
    expected = whole.of_modules()[seen.env, seen.module].clip(-5.0, 5.0)
    np.testing.assert_array_equal(both.numpy(), expected)
    assert len(seen.own) == (whole.owner >= 0).sum() > 50


def test_a_module_without_a_parcel_lets_it_roll_on(network, tables) -> None:
    actions, _ = LocalPolicy(network, CARD, OWN_CONFIG).predict(tables)
    owner = ModuleView(CONFIG)(tables).owner
    assert (actions[owner < 0] == ROLL).all()
    assert len(np.unique(actions[owner >= 0])) > 1


def test_a_parcel_far_behind_changes_nothing_and_one_near_does(network, tables) -> None:
    table = np.zeros_like(tables[:1])
    table[0, :2] = tables[0, np.flatnonzero(tables[0, :, ta.COLUMN.present.place] > 0.5)[:2]]
    table[0, :2, ta.COLUMN.offset.place] = 0.0
    table[0, 0, ta.COLUMN.to_the_end.place] = 1.0
    found = []
    for behind in (2.9, 3.4, 0.9):
        table[0, 1, ta.COLUMN.to_the_end.place] = 1.0 + behind
        seen = see_modules(ModuleView(CONFIG), table)
        of_first = seen.parcel == 0
        found.append(network(seen.passed[seen.parcel], seen.own)[of_first])
    assert torch.equal(found[0], found[1])
    assert not torch.equal(found[0], found[2])


def test_modules_that_see_alike_choose_alike(network, tables) -> None:
    network.actor[0].weight[:, -len(OWN) :] = 0.0  # they see nothing of themselves
    for deterministic in (True, False):
        actions, _ = LocalPolicy(network, CARD, OWN_CONFIG).predict(
            tables, deterministic=deterministic
        )
        owner = ModuleView(CONFIG)(tables).owner
        for i in range(3):
            for k in np.unique(owner[i][owner[i] >= 0]):
                assert len(np.unique(actions[i, owner[i] == k])) == 1


def test_choices_follow_their_probabilities_and_stay_for_some_periods(network, tables) -> None:
    policy, seen = (
        LocalPolicy(network, CARD, OWN_CONFIG),
        see_modules(ModuleView(CONFIG), tables),
    )
    probability = network(seen.passed[seen.parcel], seen.own).exp().numpy()
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


def test_a_batch_decides_as_each_alone(network, tables) -> None:
    policy = LocalPolicy(network, CARD, OWN_CONFIG)
    together, _ = policy.predict(tables)
    alone = [policy.predict(each)[0] for each in tables]
    np.testing.assert_array_equal(together, alone)


def test_nobody_there_is_no_error(network) -> None:
    actions, _ = LocalPolicy(network, CARD, OWN_CONFIG).predict(
        np.zeros((2, 32, 29), dtype=np.float32)
    )
    assert (actions == ROLL).all()


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"task": "merge"}, "task must be one of 'singulate', got 'merge'"),
        ({"task": "singulate", "actions": "parcels"}, "actions must be one of 'modules'"),
        ({"task": "singulate", "orientations": (0.0, 0.5)}, "orientations must be"),
    ],
)
def test_it_is_for_the_environment_of_its_card(given, message) -> None:
    with pytest.raises(ValueError, match=message):
        suited(OWN_CONFIG, EnvConfig(**given))
