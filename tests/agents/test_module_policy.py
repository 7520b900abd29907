"""The policy of modules, its shared draws, and their likelihood, by counting uniform numbers."""

import itertools
from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
import torch

from surface_gym.agents import module_policy, tensors
from surface_gym.agents.base import SIDE
from surface_gym.agents.library import PolicyCard
from surface_gym.feature_groups import group_features
from tests.agents.test_policy import policy_of

MODULES, CHOICES = 3, 4
GRID = (torch.arange(20_000) + 0.5) / 20_000  # uniforms, evenly spread


@pytest.fixture
def logits() -> torch.Tensor:
    return torch.randn((MODULES, CHOICES), generator=torch.Generator().manual_seed(3))


def draws(logits: torch.Tensor) -> torch.Tensor:
    together = logits.log_softmax(dim=1).repeat(len(GRID), 1)
    group = torch.arange(len(GRID)).repeat_interleave(MODULES)
    return tensors.draw_choices(together, group, GRID).reshape(len(GRID), MODULES)


def likelihood(logits: torch.Tensor, choice: torch.Tensor) -> torch.Tensor:
    group = torch.zeros(MODULES, dtype=torch.int64)
    return tensors.log_likelihood(logits.log_softmax(dim=1), choice, group, tensors.GROUPS).exp()[0]


def test_each_module_follows_its_own_probabilities_and_equal_ones_choose_alike(logits) -> None:
    share = torch.nn.functional.one_hot(draws(logits), CHOICES).float().mean(dim=0)
    torch.testing.assert_close(share, logits.softmax(dim=1), atol=1e-4, rtol=0.0)
    choices = draws(logits[:1].expand(MODULES, -1))
    assert (choices == choices[:, :1]).all()
    assert len(choices.unique()) == CHOICES


def test_the_likelihood_is_the_share_of_uniforms(logits) -> None:
    choices = draws(logits)
    for each in itertools.product(range(CHOICES), repeat=MODULES):
        choice = torch.tensor(each)
        share = (choices == choice).all(dim=1).float().mean()
        torch.testing.assert_close(likelihood(logits, choice), share, atol=2e-4, rtol=0.0)


def test_groups_and_environments_count_apart(logits) -> None:
    log_probability = logits.log_softmax(dim=1)
    group = torch.tensor([0, 1, 4])
    choice = torch.tensor([2, 0, 3])
    found = tensors.log_likelihood(log_probability, choice, group, 3 * tensors.GROUPS)
    each = log_probability.gather(1, choice.unsqueeze(1)).squeeze(1)
    torch.testing.assert_close(found, torch.stack([each[0] + each[1], torch.tensor(0.0), each[2]]))


def test_a_line_splits_the_modules_of_an_environment() -> None:
    rng = np.random.default_rng(0)
    env = np.repeat(np.arange(50), 9)
    place = np.tile(np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), -1).reshape(9, 2), (50, 1))
    together = tensors.draw_groups(env, place.astype(np.float32), 50, 0.0, rng)
    np.testing.assert_array_equal(together, tensors.GROUPS * env)
    split = tensors.draw_groups(env, place.astype(np.float32), 50, 1.0, rng)
    np.testing.assert_array_equal(split // tensors.GROUPS, env)
    side = (split % tensors.GROUPS).reshape(50, 9)
    assert ((side.sum(axis=1) > 0) & (side.sum(axis=1) < 9)).mean() > 0.5
    for one in side:
        beyond, short = place[:9][one == 1], place[:9][one == 0]
        if len(beyond) and len(short):  # convex sets: their middles lie on different sides
            assert np.abs(beyond.mean(axis=0) - short.mean(axis=0)).max() > 0.5


THE_CARD = PolicyCard("SmartSurface/Sort-v0", "modules", "modules", 0.04, (8, 8))


def observations(zone: tuple[int, int] | None = None) -> np.ndarray:
    env = gym.make_vec("SmartSurface/Sort-v0", num_envs=12, zone=zone)
    seen, _ = env.reset(seed=0, options={"speed": 2.0})
    for _ in range(6):
        seen, *_ = env.step(np.full(env.action_space.shape, 3))
    return seen


@pytest.mark.parametrize("zone", [None, (3, 29), (5, 9)])
def test_it_takes_and_gives_what_an_environment_of_any_zone_does(zone) -> None:
    policy = policy_of(THE_CARD).for_zone(zone)
    seen = observations(zone)
    chosen, _ = policy.predict(seen)
    envs = gym.make_vec(policy.env_id, num_envs=12, **policy.env_kwargs)
    assert chosen in envs.action_space
    for i, one in enumerate(seen):
        np.testing.assert_array_equal(policy.predict(one)[0], chosen[i])


@pytest.mark.usefixtures("uncompiled")
@pytest.mark.parametrize("observe", [("parcel",), ("rotors",), ("parcel", "rotors")])
def test_it_observes_the_groups_of_its_card(observe) -> None:
    policy = policy_of(replace(THE_CARD, observe=observe))
    env = gym.make_vec(policy.env_id, num_envs=12, **policy.env_kwargs)
    seen, _ = env.reset(seed=0)
    assert policy.predict(seen)[0] in env.action_space
    assert seen.shape[1] == 15 + len(group_features(observe))


def test_the_value_of_an_observation_is_the_same_for_either_side() -> None:
    seen = torch.rand((5, 15), generator=torch.Generator().manual_seed(7))
    network, side = module_policy.ValueNetwork((8, 4)), torch.eye(15)[SIDE]
    assert network(seen).shape == (5,)
    assert torch.equal(network(seen - side), network(seen))
    assert (network(seen + 1.0 - side) != network(seen)).all()


def test_a_draw_is_shared_by_the_modules_of_an_environment() -> None:
    policy, seen, chosen = policy_of(THE_CARD), observations(), set()
    alike = policy._network
    for weights in (alike._apart.weight, alike._logits.weight, alike._logits.bias):
        torch.nn.init.zeros_(weights)
    for _ in range(20):
        for action in policy.predict(seen, deterministic=False)[0]:
            choices = set(action.tolist()) - {3}
            assert len(choices) <= 1
            chosen |= choices
    assert chosen == {0, 1, 2}
