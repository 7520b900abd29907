"""Shared draws: what is chosen, and how likely it was, by counting uniforms."""

import itertools

import numpy as np
import pytest
import torch

from agents.modules.draw import GROUPS, draw_choices, draw_groups, log_likelihood

MODULES, CHOICES = 3, 4
GRID = (torch.arange(20_000) + 0.5) / 20_000  # uniforms, evenly spread


@pytest.fixture
def logits() -> torch.Tensor:
    return torch.randn((MODULES, CHOICES), generator=torch.Generator().manual_seed(3))


def draws(logits: torch.Tensor) -> torch.Tensor:
    """Choices (uniforms, modules) of one group at every uniform of the grid."""
    together = logits.log_softmax(dim=1).repeat(len(GRID), 1)
    group = torch.arange(len(GRID)).repeat_interleave(MODULES)
    return draw_choices(together, group, GRID).reshape(len(GRID), MODULES)


def likelihood(logits: torch.Tensor, choice: torch.Tensor) -> torch.Tensor:
    """Of the choices of one lane, all modules in one group."""
    group = torch.zeros(MODULES, dtype=torch.int64)
    return log_likelihood(logits.log_softmax(dim=1), choice, group, GROUPS).exp()[0]


def test_each_module_follows_its_own_probabilities(logits: torch.Tensor) -> None:
    share = torch.nn.functional.one_hot(draws(logits), CHOICES).float().mean(dim=0)
    torch.testing.assert_close(share, logits.softmax(dim=1), atol=1e-4, rtol=0.0)


def test_alike_modules_choose_alike(logits: torch.Tensor) -> None:
    choices = draws(logits[:1].expand(MODULES, -1))
    assert (choices == choices[:, :1]).all()
    assert len(choices.unique()) == CHOICES


def test_the_likelihood_is_the_share_of_uniforms(logits: torch.Tensor) -> None:
    choices = draws(logits)
    for choice in choices.unique(dim=0):
        share = (choices == choice).all(dim=1).float().mean()
        torch.testing.assert_close(likelihood(logits, choice), share, atol=2e-4, rtol=0.0)


def test_likelihoods_of_all_choices_sum_to_one(logits: torch.Tensor) -> None:
    every = itertools.product(range(CHOICES), repeat=MODULES)
    total = sum(float(likelihood(logits, torch.tensor(choice))) for choice in every)
    assert total == pytest.approx(1.0, abs=1e-3)


def test_its_gradient_is_that_of_the_pay_to_expect(logits: torch.Tensor) -> None:
    """The pay's mean over uniforms, by finite differences, against the sum over likelihoods."""
    pay = torch.randn((CHOICES,) * MODULES, generator=torch.Generator().manual_seed(5))
    leaf = logits.clone().requires_grad_()
    every = [torch.tensor(choice) for choice in draws(logits).unique(dim=0).tolist()]
    expected = torch.stack([pay[tuple(choice)] * likelihood(leaf, choice) for choice in every])
    expected.sum().backward()
    step = 0.05
    for place in itertools.product(range(MODULES), range(CHOICES)):
        means = []
        for way in (step, -step):
            moved = logits.clone()
            moved[place] += way
            means.append(pay[tuple(draws(moved).T)].mean())
        slope = (means[0] - means[1]) / (2.0 * step)
        assert leaf.grad is not None
        assert float(leaf.grad[place]) == pytest.approx(float(slope), abs=0.01)


def test_groups_and_lanes_count_apart(logits: torch.Tensor) -> None:
    """Lane 0 has its modules in two groups, lane 1 none, lane 2 one module."""
    log_probability = logits.log_softmax(dim=1)
    group = torch.tensor([0, 1, 4])
    choice = torch.tensor([2, 0, 3])
    lanes = log_likelihood(log_probability, choice, group, 3 * GROUPS)
    each = log_probability.gather(1, choice.unsqueeze(1)).squeeze(1)
    torch.testing.assert_close(lanes, torch.stack([each[0] + each[1], torch.tensor(0.0), each[2]]))


def test_a_line_parts_the_modules_of_a_lane() -> None:
    rng = np.random.default_rng(0)
    lane = np.repeat(np.arange(50), 9)
    place = np.tile(np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), -1).reshape(9, 2), (50, 1))
    together = draw_groups(lane, place.astype(np.float32), 50, 0.0, rng)
    np.testing.assert_array_equal(together, GROUPS * lane)
    parted = draw_groups(lane, place.astype(np.float32), 50, 1.0, rng)
    np.testing.assert_array_equal(parted // GROUPS, lane)
    side = (parted % GROUPS).reshape(50, 9)
    assert ((side.sum(axis=1) > 0) & (side.sum(axis=1) < 9)).mean() > 0.5
    for one in side:
        beyond, short = place[:9][one == 1], place[:9][one == 0]
        if len(beyond) and len(short):  # convex sets: their middles lie on different sides
            assert np.abs(beyond.mean(axis=0) - short.mean(axis=0)).max() > 0.5
