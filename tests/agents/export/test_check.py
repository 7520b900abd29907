"""Mistakes are found, and kept apart from ties."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from torch import nn

from surface_gym.agents.export import policy
from surface_gym.agents.export.check import compare, random_observations
from tests.agents.export.made import made, wanted


@pytest.fixture
def stop() -> policy.Source:
    return made("stop")


def deciding(
    choices: policy.Integers, source: policy.Source
) -> Callable[[policy.Singles], tuple[policy.Integers, policy.Numbers]]:
    angles: policy.Numbers = np.array(source.config.chosen_orientations)
    return lambda _: (choices, angles[choices])


def test_one_other_choice_is_an_error_that_names_it(stop) -> None:
    seen = random_observations(stop, 200, seed=0)
    choices = wanted(stop, seen)
    choices[13, 1] = (choices[13, 1] + 1) % 4
    with pytest.raises(ValueError, match="must decide as the policy of stop does, got 1 of 200"):
        compare("it", policy.network_decision(stop), stop, seen, deciding(choices, stop))


def test_another_angle_is_an_error(stop) -> None:
    seen = random_observations(stop, 200, seed=0)
    choices = wanted(stop, seen)
    angles = choices.astype(np.float64)
    with pytest.raises(ValueError, match="must give the angles of what it chooses"):
        compare("it", policy.network_decision(stop), stop, seen, lambda _: (choices, angles))


def with_equal_options(decision: policy.NetworkDecision) -> policy.NetworkDecision:
    """All scores the same, so that any decision is right."""
    *first, last = decision.network.layers
    flat = replace(last, weights=np.zeros_like(last.weights), bias=np.zeros_like(last.bias))
    return replace(decision, network=replace(decision.network, layers=(*first, flat)))


def test_ties_are_counted_apart_but_not_without_limit(stop) -> None:
    seen = random_observations(stop, 200, seed=0)
    choices = wanted(stop, seen)
    decision = with_equal_options(policy.network_decision(stop))
    agreement = compare("it", decision, stop, seen, deciding(choices, stop))
    assert (agreement.ties, agreement.close) == (0, 400)
    choices[13, 1] = (choices[13, 1] + 1) % 4
    agreement = compare("it", decision, stop, seen, deciding(choices, stop))
    assert agreement.ties == 1
    assert "1 of them otherwise, all ties" in agreement.summary()
    with pytest.raises(ValueError, match="though all where scores are close"):
        compare("it", decision, stop, seen, deciding((choices + 1) % 4, stop))


def test_a_network_of_another_kind_is_refused() -> None:
    for modules in (
        nn.Sequential(nn.Linear(2, 2), nn.Sigmoid(), nn.Linear(2, 2)),
        nn.Sequential(nn.Linear(2, 2), nn.Tanh()),
        nn.Sequential(nn.Linear(2, 2), nn.Tanh(), nn.Linear(2, 2), nn.ReLU(), nn.Linear(2, 2)),
    ):
        with pytest.raises(ValueError, match="network must be linear layers"):
            policy.read_network(modules)
