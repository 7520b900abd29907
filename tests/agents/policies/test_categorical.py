"""One categorical over an array against Stable-Baselines3's list of them."""

import numpy as np
import pytest
import torch
from gymnasium import spaces
from stable_baselines3.common.distributions import MultiCategoricalDistribution
from stable_baselines3.common.policies import ActorCriticPolicy

from agents.policies.categorical import EqualCategoricals, EqualChoicesPolicy

CHOICES, OPTIONS, LANES = 25, 4, 7


@pytest.fixture
def logits() -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return 2.0 * torch.randn((LANES, CHOICES * OPTIONS), generator=generator)


def both(logits: torch.Tensor) -> tuple[EqualCategoricals, MultiCategoricalDistribution]:
    ours = EqualCategoricals(CHOICES, OPTIONS).proba_distribution(logits)
    return ours, MultiCategoricalDistribution([OPTIONS] * CHOICES).proba_distribution(logits)


def test_log_prob_entropy_and_mode_are_theirs(logits: torch.Tensor) -> None:
    ours, theirs = both(logits)
    actions = theirs.sample()
    torch.testing.assert_close(ours.log_prob(actions), theirs.log_prob(actions))
    torch.testing.assert_close(ours.entropy(), theirs.entropy())
    assert torch.equal(ours.mode(), theirs.mode())


def test_gradients_are_theirs(logits: torch.Tensor) -> None:
    actions = both(logits)[1].sample()
    gradients = []
    for of in (0, 1):
        leaf = logits.clone().requires_grad_()
        distribution = both(leaf)[of]
        (distribution.log_prob(actions).sum() + 0.1 * distribution.entropy().sum()).backward()
        gradients.append(leaf.grad)
    torch.testing.assert_close(gradients[0], gradients[1])


def test_samples_fall_as_often_as_they_should() -> None:
    """Each option's share lies within 5 standard errors of its probability."""
    torch.manual_seed(0)
    draws = 20_000
    row = torch.randn((1, CHOICES * OPTIONS), generator=torch.Generator().manual_seed(1))
    ours, theirs = both(row.expand(draws, -1))
    wanted = torch.stack([each.probs[0] for each in theirs.distribution])
    samples = ours.sample()
    assert samples.shape == (draws, CHOICES)
    share = torch.nn.functional.one_hot(samples, OPTIONS).double().mean(dim=0)
    error = (wanted * (1.0 - wanted) / draws).sqrt()
    assert bool(((share - wanted).abs() < 5.0 * error).all())


def test_a_policy_is_theirs_to_the_weights() -> None:
    observations, actions = spaces.Box(-1.0, 1.0, (3,)), spaces.MultiDiscrete([OPTIONS] * CHOICES)
    ours = EqualChoicesPolicy(observations, actions, lambda _: 1e-3, net_arch=[8])
    theirs = ActorCriticPolicy(observations, actions, lambda _: 1e-3, net_arch=[8])
    theirs.load_state_dict(ours.state_dict())
    assert isinstance(ours.action_dist, EqualCategoricals)
    seen = np.random.default_rng(0).normal(size=(LANES, 3)).astype(np.float32)
    chosen, _ = ours.predict(seen, deterministic=True)
    np.testing.assert_array_equal(chosen, theirs.predict(seen, deterministic=True)[0])
    given = torch.from_numpy(seen), torch.from_numpy(chosen)
    for mine, other in zip(
        ours.evaluate_actions(*given), theirs.evaluate_actions(*given), strict=True
    ):
        torch.testing.assert_close(mine, other)
    single, _ = ours.predict(seen[0], deterministic=True)
    np.testing.assert_array_equal(single, chosen[0])


@pytest.mark.parametrize("space", [spaces.Discrete(4), spaces.MultiDiscrete([2, 3])])
def test_other_spaces_keep_their_distribution(space: spaces.Space[object]) -> None:
    policy = EqualChoicesPolicy(spaces.Box(-1.0, 1.0, (3,)), space, lambda _: 1e-3, net_arch=[8])
    assert not isinstance(policy.action_dist, EqualCategoricals)
