"""Policies of weights at random, of kinds that no shipped agent need have."""

import numpy as np
import torch
from stable_baselines3.common.policies import BasePolicy

from surface_gym.agents.export.policy import Integers, Singles, Source, Training
from surface_gym.agents.library import PolicyCard
from surface_gym.agents.module_policy import ModulePolicy, SharedNetwork
from surface_gym.agents.policy import Policy, make_network

GROUPS = ("parcel", "rotors")
CARDS = {
    "quadrants": PolicyCard("SmartSurface/Sort-v0", "ppo", "quadrants", 0.08, (24, 16, 8), GROUPS),
    "window": PolicyCard("SmartSurface/Sort-v0", "ppo", "window", 0.04, (12,)),
    "stop": PolicyCard("SmartSurface/Stop-v0", "dqn", "halves", 0.05, (32, 8), ("parcel",)),
    "modules": PolicyCard("SmartSurface/Sort-v0", "modules", "modules", 0.04, (16, 8), GROUPS),
    "by-clearance": PolicyCard("SmartSurface/Sort-v0", "modules", "modules", 0.04, (8, 8)),
}


def made(name: str) -> Source:
    """The policy of a card, its weights at random."""
    card = CARDS[name]
    config = card.env_config()
    network = network_of(name)
    policy: Policy | ModulePolicy
    if isinstance(network, SharedNetwork):
        policy = ModulePolicy(network, card)
    else:
        assert isinstance(network, BasePolicy)
        policy = Policy(network, card, config)
    weights = network.state_dict()
    return Source(name, 0, policy, config, weights, "none", Training("nominal"))


def network_of(name: str) -> torch.nn.Module:
    """The network of a card, its weights at random."""
    card = CARDS[name]
    torch.manual_seed(0)
    network: torch.nn.Module = (
        SharedNetwork(4, card.hidden, card.observe)
        if card.algo == "modules"
        else make_network(card, card.env_config())
    )
    with torch.no_grad():
        for weights in network.parameters():
            weights.normal_(std=0.5)
    return network


def wanted(source: Source, observations: Singles) -> Integers:
    """What the policy chooses."""
    actions, _ = source.policy.predict(observations)
    chosen: Integers = source.config.action_kind.commands(actions, len(observations))
    return chosen


def count_of_each(choices: Integers) -> list[int]:
    """(choices,) how often each is chosen."""
    counts: list[int] = np.bincount(choices.ravel(), minlength=4).tolist()
    return counts
